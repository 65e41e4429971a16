// One chart of a recording, and charts below each other in a figure.
const FAULT = 3, LINES = 5; // series: x, the ends of a band, of the line or its bins, dots, what stands in for samples
const HEIGHTS = { signal: 92, verdicts: 58 }, TALL = 140, MARKED = 13, LABEL = 22; // px; room for the triangles of alarms, and for half a label
const ENDS = 0.02, WIDE = 6; // share of a band's ends that need not be shown; its widths above and below it

const seen = (values, a, b) => values.slice(a, b + 1).filter((v) => v !== null).sort((p, q) => p - q);
const quantile = (sorted, q) => sorted[Math.round(q * (sorted.length - 1))];
const around = (bottoms, tops) => { // a chart that one huge sample does not spoil
  const bottom = quantile(bottoms, 0.002), top = quantile(tops, 0.998);
  const reach = Math.max((top - bottom) / 2, 1e-9 * Math.max(Math.abs(bottom), Math.abs(top)));
  return [Math.max(bottoms[0], bottom - reach), Math.min(tops.at(-1), top + reach)];
};
const aboutBand = (least, most, bottoms, tops) => { // nor a band as wide as it begins
  const bottom = quantile(least, ENDS), top = quantile(most, 1 - ENDS), reach = WIDE * (top - bottom);
  const lowest = bottoms[0] ?? bottom, highest = tops.at(-1) ?? top;
  return [Math.min(bottom, Math.max(lowest, bottom - reach)), Math.max(top, Math.min(highest, top + reach))];
};
const limits = (kind, data, a, b) => {
  const [least, most, bottoms, tops] = data.slice(1, LINES).map((values) => seen(values, a, b));
  if (kind === "margin") return [Math.min(1.1 * (bottoms[0] ?? 0), 0) - 0.08, 1.06];
  if (kind === "combination") {
    const reach = 1.08 * Math.min(Math.max(-(bottoms[0] ?? 0), tops.at(-1) ?? 0, 1.2), 10);
    return [-reach, reach];
  }
  if (!least.length && !bottoms.length) return [0, 1];
  const [bottom, top] = least.length ? aboutBand(least, most, bottoms, tops) : around(bottoms, tops);
  const pad = 0.06 * (top - bottom) || 0.01 * Math.abs(top) || 1;
  return [bottom - pad, top + pad];
};

// Margins below -1 are on a logarithmic scale.
const squeezed = (v) => (v < -1 ? -1 - Math.log10(Math.min(-v, 1e15)) : v);
const stretched = (v) => (v < -1 ? -(10 ** (-1 - v)) : v);
const powers = (bottom) => { // ticks below -1, too, however few decades there are
  if (bottom > -1) return [-1, -0.5, 0, 0.5, 1].filter((v) => v >= bottom);
  const decades = -1 - squeezed(bottom), marks = [1, 0], step = 1 + Math.floor(decades / 4);
  const between = decades < 0.3 ? [1.5] : decades < 1 ? [2, 4, 8] : decades < 2 ? [3] : [];
  for (let n = 0; n <= decades; n += step) marks.push(...[1, ...between].map((k) => -k * 10 ** n));
  return marks.filter((v) => v >= bottom).reverse();
};
const shares = (bottom) => (bottom < -6 ? [-10, 1, 10] : bottom < -3 ? [-1, 1] : [-1, 0, 1]);
const marks = { margin: (u, i, bottom) => powers(bottom), combination: (u, i, bottom) => shares(bottom) };

// What is painted behind the lines: a box for each stretch of points that are on.
const boxes = (u, piece, on, name) => {
  const { left, top, width, height } = u.bbox, right = left + width, begins = piece.binned ? 0 : piece.step / 2;
  const across = (t) => Math.min(Math.max(u.valToPos(t, "x", true), left), right);
  u.ctx.fillStyle = colour(name);
  for (let i = 0; i < piece.x.length; i++) {
    if (!on(i)) continue;
    const first = i;
    while (on(i + 1)) i++;
    const from = across(piece.x[first] - begins), to = across(piece.x[i] + piece.step - begins);
    if (to > left && from < right) u.ctx.fillRect(from, top, Math.max(to - from, devicePixelRatio), height);
  }
};
const untrained = (u, lo, hi) => { // where an input was not in training
  const { left, top, width, height } = u.bbox, foot = top + height;
  const at = (v) => Math.min(Math.max(u.valToPos(v, "y", true), top), foot);
  u.ctx.fillStyle = `${colour("UNTRAINED")}40`;
  u.ctx.fillRect(left, top, width, at(hi) - top);
  u.ctx.fillRect(left, at(lo), width, foot - at(lo));
};
const behind = (u, row, { piece, violated }) => {
  if (row.kind === "verdicts") return VERDICTS.forEach((name, s) => boxes(u, piece, (i) => piece.status[i] === s, name));
  const faulty = piece.low[`${row.key}:faulty`], beyond = (i) => Math.abs(violated?.values[i] ?? 0) > 1;
  const proved = (i) => (faulty ? (faulty[i] ?? null) !== null : piece.status[i] === FAULT);
  boxes(u, piece, row.key === "combination" ? beyond : proved, "shade");
  if (row.training) untrained(u, ...row.training);
  if (row.kind !== "combination") return;
  const top = u.valToPos(1, "y", true);
  u.ctx.fillStyle = colour("allowed");
  u.ctx.fillRect(u.bbox.left, top, u.bbox.width, u.valToPos(-1, "y", true) - top);
};
const alarmed = (u) => {
  const size = 5 * devicePixelRatio, foot = u.bbox.top - devicePixelRatio;
  u.ctx.fillStyle = colour("FAULT");
  const left = u.bbox.left, right = left + u.bbox.width;
  for (const [, ...times] of page.alarms) {
    const [begun, ended, x] = times.map((t) => Math.min(Math.max(u.valToPos(base + t, "x", true), left - 1), right + 1));
    if (begun < right && ended > left) u.ctx.fillRect(begun, foot - size / 2, ended - begun, size / 2); // as long as it lasts
    if (x < left || x > right) continue;
    u.ctx.beginPath();
    u.ctx.moveTo(x, foot);
    u.ctx.lineTo(x - size, foot - 1.6 * size);
    u.ctx.lineTo(x + size, foot - 1.6 * size);
    u.ctx.fill();
  }
};

const dataOf = ({ key, kind }, { piece, violated }) => {
  const nothing = piece.x.map(() => null), of = (ends, name) => ends[name] ?? nothing;
  const one = key === "combination" ? { combination: violated?.values ?? nothing } : null;
  const low = of(one ?? piece.low, key), high = of(one ?? piece.high, key), band = `${key}:band`;
  const wrong = { margin: (v, i) => piece.status[i] === FAULT, combination: (v) => Math.abs(v) > 1 }[kind];
  const dots = wrong ? low.map((v, i) => (v !== null && wrong(v, i) ? v : null)) : of(piece.low, `${key}:faulty`);
  return [piece.x, of(piece.low, band), of(piece.high, band), low, high, dots, of(piece.low, `${key}:instead`)];
};

const stepped = uPlot.paths.stepped({ align: 1, alignGaps: 1 }), linear = uPlot.paths.linear({ alignGaps: 1 });
const draw = (row, view, plot, first) => {
  const held = () => row.steps || view.piece.binned; // an input until its next sample, the extremes of a bin
  const line = (name, width, paths) => ({ stroke: () => colour(name), width, paths, points: { show: false } });
  const either = (u, ...of) => (held() ? stepped : linear)(u, ...of);
  const bins = (u, ...of) => (view.piece.binned ? stepped : linear)(u, ...of);
  const few = (u, i, a, b) => !held() && b - a < u.width / 14;
  const dots = { show: true, size: 5, width: 0, fill: () => colour("FAULT"), stroke: () => colour("FAULT") };
  const verdicts = row.kind === "verdicts", room = first ? MARKED : 0, height = (HEIGHTS[row.kind] ?? TALL) + room;
  const within = (u) => [Math.max(u.valToIdx(view.from) - 1, 0), u.valToIdx(view.to) + 1];
  const range = (u) => (verdicts ? [0, 1] : limits(row.kind, u.data, ...within(u)));
  const across = { size: 40, space: 104, values: (u, at) => at.map((t) => (t === null ? "" : lines(t))), grid: { show: false } };
  const uncut = (u, t) => t < view.to - (view.to - view.from) * LABEL / u.width; // by the edge of the chart
  across.filter = (u, at) => at.map((t) => (uncut(u, t) ? t : null));
  if (before) across.incrs = evenly(10, 0, 1).flatMap((n) => [1, 2, 5].map((k) => k * 10 ** n)); // numbers of samples
  const empty = { values: () => [], splits: () => [] };
  const chart = new uPlot({
    width: widthOf(plot), height, padding: [5 + room, 12, verdicts ? 0 : 6, 0], legend: { show: false },
    tzDate: (t) => uPlot.tzDate(new Date(1000 * t), "Etc/UTC"),
    scales: {
      x: { time: tokens.length > 0, range: () => [view.from, view.to] },
      y: { range, ...(row.kind === "margin" ? { distr: 100, fwd: squeezed, bwd: stretched } : {}) },
    },
    axes: [axis(verdicts ? across : { show: false }), upright(verdicts ? empty : { splits: marks[row.kind] })],
    series: [
      {}, line("edge", 0.7, bins), line("edge", 0.7, bins),
      { ...line("curve", 1.1, either), points: { show: few, size: 4, width: 0, fill: () => colour("curve") } },
      line("curve", 1.1, either), { paths: () => null, points: dots },
      { ...line("ok", 2.4, bins), points: { show: true, size: 3, width: 0, fill: () => colour("ok") } },
    ],
    bands: [
      { series: [2, 1], fill: () => colour("allowed") },
      { series: [4, 3], fill: () => (view.piece.binned ? `${colour("curve")}59` : null) },
    ],
    cursor: {
      y: false, points: { show: false }, drag: { x: true, y: false, setScale: false },
      sync: { key: view.id, scales: ["x", null], filters: { pub: (type) => /^mouse(move|leave)$/.test(type) } },
    },
    hooks: {
      drawClear: [(u) => behind(u, row, view)], draw: first ? [alarmed] : [],
      setCursor: [(u) => view.tell(u)], setSelect: [(u) => view.select(u)],
    },
  }, dataOf(row, view), plot);
  return follow(chart, plot, height);
};

const created = (parent, tag, name, text = "") => {
  const made = document.createElement(tag);
  made.className = name;
  made.textContent = text;
  parent.append(made);
  return made;
};
const ends = (low, high) => (low === high ? short(low) : `${short(low)} to ${short(high)}`);
const valueOf = (row, piece, [x, least, most, low, high], i) => {
  if (row.kind === "verdicts") return `${spoken(VERDICTS[piece.status[i]]) ?? "no sample"} at ${time(x[i])}`;
  const shown = low[i] === null ? "no value" : ends(low[i], high[i]);
  return least[i] === null ? shown : `${shown}, expected ${ends(least[i], most[i])}`;
};
class Figure { // charts below each other, over one axis of time
  constructor(id, label, rows, piece, from, to) {
    Object.assign(this, { id, label, piece, from, to, place: document.getElementById(id), select: () => {} });
    this.panels = [...rows, { key: "verdicts", name: "verdict", kind: "verdicts" }].map((row) => {
      const panel = created(this.place.querySelector(".charts"), "div", `panel ${row.kind}`);
      panel.dataset.key = row.key;
      const head = created(panel, "p", "of", `${row.name} `);
      created(head, "small", "", row.unit ? `[${row.unit}] ` : "");
      const value = created(head, "output", "value"), plot = created(panel, "div", "plot");
      plot.setAttribute("role", "img");
      return { row, panel, value, plot };
    });
    this.panels.forEach((panel, i) => { panel.chart = draw(panel.row, this, panel.plot, i === 0); });
    this.say();
  }

  move(piece, violated, from, to) {
    const same = piece === this.piece && violated === this.violated;
    Object.assign(this, { piece, violated, from, to });
    for (const { row, chart } of this.panels) {
      if (!same) chart.setData(dataOf(row, this), false);
      chart.setScale("x", { min: from, max: to });
    }
    this.say();
  }

  say() {
    for (const { row, panel, plot, chart } of this.panels) {
      const verdicts = row.kind === "verdicts", shown = [row.key, `${row.key}:band`].some((key) => key in this.piece.low);
      panel.hidden = !(verdicts || shown || (row.key === "combination" && this.violated));
      const empty = !verdicts && chart.data.slice(1, LINES).every((values) => values.every((v) => v === null));
      plot.dataset.none = !empty ? "" : row.kind === "margin" ? "no margin is measured" : "no data";
      plot.setAttribute("aria-label", `${this.label}: ${row.name} from ${time(this.from)} to ${time(this.to)}`);
    }
  }

  tell(u) { // the values of the sample under the pointer, or of its bin
    const panel = this.panels?.find(({ chart }) => chart === u), { piece } = this;
    if (!panel) return;
    const at = u.posToVal(u.cursor.left, "x");
    let i = u.cursor.left < 0 ? -1 : u.valToIdx(at);
    if (piece.binned && piece.x[i] > at) i--;
    if (piece.sample[i] === null) i--;
    panel.value.textContent = i < 0 ? "" : valueOf(panel.row, piece, u.data, i);
  }
}
