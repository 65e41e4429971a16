// The figures of a page: the whole recording, and closer what the reader asks for by buttons, keys, wheel or fingers.
const overview = new Figure("overview", "whole recording", page.rows.filter((row) => row.kind !== "combination"), whole, whole.first, whole.last);
const closer = new Figure("zoom", "zoom", page.rows, whole, whole.first, whole.last), zoom = closer.place;
const choice = zoom.querySelector("select"), field = zoom.querySelector("input"), wrong = zoom.querySelector(".wrong");
let from = base + page.from, to = base + page.to, alarm = page.alarm;

const redraw = () => {
  const within = near.filter((p) => p.first <= from + hair && to <= p.last + hair);
  const piece = within.find((p) => p.combined.has(alarm)) || within[0] || whole;
  const violated = piece.combined.get(alarm) || [...piece.combined.values()][0];
  closer.move(piece, violated, from, to);
  const mean = Math.round(page.samples / page.whole.n), kept = page.alarms.length ? "alarms" : page.about;
  const coarse = piece.binned ? `; each step is the lowest and the highest of ${mean} samples, around ${kept} each one is kept` : "";
  const inside = page.alarms.some(([i, , , worst]) => i === alarm && from - hair <= base + worst && base + worst <= to + hair);
  const where = piece === whole ? "" : alarm < 0 ? `around ${page.about}: ` : inside ? `around alarm ${alarm + 1}: ` : "";
  zoom.querySelector(".said").textContent = `${where}${time(from)} to ${time(to)}${coarse}`;
  const relation = zoom.querySelector(".relation");
  relation.hidden = !violated?.relation;
  relation.firstElementChild.textContent = violated?.relation ?? "";
  for (const { chart } of overview.panels) {
    const left = chart.valToPos(from, "x"), end = chart.valToPos(to, "x");
    chart.setSelect({ left, width: Math.max(end - left, 2), top: 0, height: chart.over.clientHeight }, false);
  }
};
const show = (a, b) => {
  wrong.hidden = true;
  const least = 4 * page.step, span = Math.min(Math.max(b - a, least), whole.last - whole.first || least);
  const middle = Math.min(Math.max((a + b) / 2, whole.first + span / 2), whole.last - span / 2);
  [from, to] = [middle - span / 2, middle + span / 2];
  redraw();
};
const goto = (i) => {
  if (!page.alarms.length) return show(base + page.from, base + page.to);
  const row = Math.min(Math.max(i, 0), page.alarms.length - 1), [number, ...times] = page.alarms[row];
  const [begun, ended, worst] = times.map((t) => base + t), reach = 80 * page.step;
  alarm = number;
  choice.value = String(row);
  const piece = near.find((p) => p.combined.has(alarm)) || near.find((p) => p.first <= begun && ended <= p.last);
  if (piece) show(Math.max(piece.first, begun - 20 * page.step), piece.last);
  else show(Math.min(begun, worst) - reach, Math.max(ended, worst) + reach);
};
const part = (a, b) => () => show(from + a * (to - from), to + b * (to - from));
const deeds = {
  worst: () => {
    alarm = page.alarm;
    if (choice) choice.value = String(page.alarms.findIndex((a) => a[0] === alarm));
    show(base + page.from, base + page.to);
  },
  previous: () => goto(Number(choice.value) - 1),
  next: () => goto(Number(choice.value) + 1),
  go: () => {
    const x = asked(field.value, from), half = (to - from) / 2;
    if (whole.first - hair <= x && x <= whole.last + hair) return show(x - half, x + half);
    wrong.textContent = `this is no time of the recording, which goes from ${time(whole.first)} to ${time(whole.last)}`;
    wrong.hidden = false;
  },
  left: part(-0.25, -0.25), right: part(0.25, 0.25), in: part(0.25, -0.25), out: part(-0.5, 0.5),
  all: () => show(whole.first, whole.last),
};
const KEYS = { ArrowLeft: "left", ArrowRight: "right", "+": "in", "=": "in", "-": "out" };

zoom.querySelector(".moves").hidden = false;
zoom.addEventListener("click", (e) => {
  const pressed = e.target.closest("[data-do]");
  if (pressed) deeds[pressed.dataset.do]();
});
choice?.addEventListener("change", () => goto(Number(choice.value)));
field.addEventListener("keydown", (e) => { if (e.key === "Enter") deeds.go(); });
zoom.addEventListener("keydown", (e) => {
  if (e.target !== zoom || !KEYS[e.key]) return;
  e.preventDefault();
  deeds[KEYS[e.key]]();
});
document.addEventListener("click", (e) => { // the table of alarms comes below
  const link = e.target.closest("a[data-alarm]");
  if (link) goto(Number(link.dataset.alarm));
});

// A drag selects a time; a click in the whole recording goes there.
const DRAGGED = 4; // px
const dragged = (u) => {
  const { left, width } = u.select;
  u.setSelect({ left: 0, width: 0 }, false);
  if (width > DRAGGED) show(u.posToVal(left, "x"), u.posToVal(left + width, "x"));
  else redraw();
};
overview.select = closer.select = dragged;
for (const { chart } of overview.panels) {
  chart.over.addEventListener("click", (e) => {
    const middle = chart.posToVal(e.clientX - chart.over.getBoundingClientRect().left, "x"), half = (to - from) / 2;
    show(middle - half, middle + half);
  });
}

// The wheel zooms about the pointer, once the charts have the focus, or with Ctrl: else it scrolls the page.
const turned = (over) => (e) => {
  if (!e.ctrlKey && !e.metaKey && !zoom.contains(document.activeElement)) return;
  e.preventDefault();
  const box = over.getBoundingClientRect(), x = from + (to - from) * (e.clientX - box.left) / box.width;
  const factor = Math.exp(Math.min(Math.max(e.deltaY * (e.deltaMode ? 30 : 1), -300), 300) / 500);
  show(x - (x - from) * factor, x + (to - x) * factor);
};
// The times under one or two fingers stay under them.
const touched = (over) => {
  const fingers = new Map();
  const lifted = (e) => fingers.delete(e.pointerId);
  over.addEventListener("pointerdown", (e) => {
    zoom.focus({ preventScroll: true });
    if (e.pointerType === "touch") fingers.set(e.pointerId, e.clientX);
  });
  over.addEventListener("pointermove", (e) => {
    if (!fingers.has(e.pointerId)) return;
    const box = over.getBoundingClientRect(), span = to - from, held = [...fingers.values()];
    const [x, y] = held.map((px) => from + span * (px - box.left) / box.width);
    fingers.set(e.pointerId, e.clientX);
    const [left, right] = fingers.values(), each = held.length > 1 ? (y - x) / (right - left) : span / box.width;
    const begin = x - each * (left - box.left);
    if (held.length < 2 || each > 0) show(begin, begin + each * box.width);
  });
  for (const end of ["pointerup", "pointercancel", "pointerleave"]) over.addEventListener(end, lifted);
};
for (const { chart: { over } } of closer.panels) {
  over.addEventListener("wheel", turned(over), { passive: false });
  touched(over);
}
if (choice) choice.value = String(page.alarms.findIndex((a) => a[0] === alarm));
redraw();
