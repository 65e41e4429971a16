// Moves the zoom of a report: draws any stretch of the numbers in the page. The first picture is there without it.
(() => {
  "use strict";
  const all = JSON.parse(document.getElementById("numbers").textContent), zoom = document.getElementById("zoom");
  const names = ["MISSING", "CONSISTENT", "UNDECIDED", "FAULT"], most = 1000;
  const floats = (text, kind) => new kind(Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer);
  const read = (p) => {
    const x = Array.isArray(p.x) ? Float64Array.from({ length: p.n }, (_, i) => p.x[0] + i * p.x[1]) : floats(p.x, Float64Array);
    const low = {}, high = {};
    for (const [key, both] of Object.entries(p.series)) {
      low[key] = floats(both[0], Float32Array);
      high[key] = both[1] ? floats(both[1], Float32Array) : low[key];
    }
    const combined = new Map(p.combined.map(([i, relation, values]) => [i, { relation, values: floats(values, Float32Array) }]));
    const steps = x.slice(1).map((v, i) => v - x[i]).sort();
    return { ...p, x, low, high, combined, first: x[0], last: x[p.n - 1], step: steps[steps.length >> 1] || all.step };
  };
  const whole = { ...read(all.whole), last: all.last }, near = all.near.map(read);
  const hair = 1e-6 * all.step; // times are sums of steps, rounded
  let from = all.from, to = all.to, alarm = all.alarm;

  // times, as the recording writes them
  const two = (n, digits) => String(n).padStart(digits, "0");
  const fields = (t) => {
    const at = new Date(1000 * Math.floor(Math.round(1000 * t) / 1000));
    return { Y: at.getUTCFullYear(), m: at.getUTCMonth() + 1, d: at.getUTCDate(), H: at.getUTCHours(), M: at.getUTCMinutes(), S: at.getUTCSeconds() };
  };
  const time = (x) => {
    const { tokens, base, digits, before, unit } = all.clock;
    if (!tokens.length) return before + String(Number(x.toFixed(digits))) + unit;
    const of = fields(base + x), part = Math.round(1000 * (base + x)) / 1000 % 1;
    return tokens.map((k) => !/^[YmdHMSf]\d$/.test(k) ? k : k[0] === "f" ? part.toFixed(k[1]).slice(2) : two(of[k[0]], k[1])).join("");
  };
  const asked = (text) => { // NaN: no time as the recording writes them, or as far as a day of it
    const { tokens, base, before, unit } = all.clock;
    if (!tokens.length) {
      const number = text.replace(before, "").replace(unit, "").trim();
      return number ? Number(number) : NaN;
    }
    const keys = tokens.filter((k) => /^[YmdHMSf]\d$/.test(k)), between = tokens.filter((k) => !keys.includes(k));
    const zone = (tokens.length && between.includes(tokens.at(-1)) ? tokens.at(-1) : "").trim();
    const body = zone && text.trim().endsWith(zone) ? text.trim().slice(0, -zone.length) : text;
    const found = body.match(/\d+/g) || [], signs = between.join("") + " T:-./,";
    if (!found.length || found.length > keys.length || [...body.replace(/\d/g, "")].some((c) => !signs.includes(c))) return NaN;
    const of = { ...fields(base + from), H: 0, M: 0, S: 0, f: 0 };
    found.forEach((digits, i) => { of[keys[i][0]] = keys[i][0] === "f" ? Number("." + digits) : Number(digits); });
    const at = Date.UTC(of.Y, of.m - 1, of.d, of.H, of.M, of.S) / 1000, back = fields(at);
    return Object.keys(back).every((k) => back[k] === of[k]) ? at + of.f - base : NaN; // there is no 30th of February
  };
  const steps = [1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200, 10800, 21600, 43200, 86400, 172800, 432000, 864000];
  const months = (a, b) => {
    const base = all.clock.base, step = [1, 2, 3, 6, 12, 24, 60, 120, 240, 600, 1200].find((n) => (b - a) / (n * 2629746) < 6) || 1200;
    const begin = new Date(1000 * (a + base)), out = [];
    const month = (n) => Date.UTC(1970, n, 1) / 1000 - base;
    for (let n = Math.ceil(((begin.getUTCFullYear() - 1970) * 12 + begin.getUTCMonth()) / step) * step; month(n) <= b; n += step) if (month(n) >= a) out.push(month(n));
    return out;
  };
  const ticks = (a, b) => {
    const span = b - a, base = all.clock.base;
    let step = all.clock.tokens.length && steps.find((s) => span / s < 6);
    if (all.clock.tokens.length && !step) return months(a, b);
    if (!step) {
      const power = 10 ** Math.floor(Math.log10(span / 6));
      step = [1, 2, 5, 10, 20].map((n) => n * power).find((s) => span / s < 6);
      if (all.clock.before) step = Math.max(step, 1);
    }
    const out = [];
    for (let n = Math.ceil((a + base) / step - 1e-9); n * step <= b + base + 1e-9 * span; n++) out.push(n * step - base);
    return out;
  };

  // numbers to paths
  const squeezed = (v) => (v < -1 ? -1 - Math.log10(Math.min(-v, 1e15)) : v);
  const extremes = (p, i, j, bins, key) => {
    const n = j - i, out = { low: [], high: [] };
    for (let b = 0; b < bins; b++) {
      let lo = NaN, hi = NaN;
      for (let k = i + Math.floor(b * n / bins), end = i + Math.floor((b + 1) * n / bins); k < end; k++) {
        if (!(p.low[key][k] >= lo)) lo = Number.isNaN(p.low[key][k]) ? lo : p.low[key][k];
        if (!(p.high[key][k] <= hi)) hi = Number.isNaN(p.high[key][k]) ? hi : p.high[key][k];
      }
      out.low.push(lo);
      out.high.push(hi);
    }
    return out;
  };
  const limits = (kind, low, high) => {
    const seen = low.filter(Number.isFinite).sort((a, b) => a - b), tall = high.filter(Number.isFinite).sort((a, b) => a - b);
    const least = seen.length ? seen[0] : 0, largest = tall.length ? tall[tall.length - 1] : 0;
    if (kind === "margin") return [Math.min(least, 0) - 0.08, 1.06];
    if (kind === "combination") { const r = 1.08 * Math.min(Math.max(-least, largest, 1.2), 10); return [-r, r]; }
    if (!seen.length) return [0, 1];
    const bottom = seen[Math.floor(0.002 * seen.length)], top = tall[Math.ceil(0.998 * tall.length) - 1];
    const reach = Math.max((top - bottom) / 2, 1e-9 * Math.max(Math.abs(bottom), Math.abs(top)), 1e-300);
    const a = Math.max(least, bottom - reach), b = Math.min(largest, top + reach), pad = 0.06 * (b - a) || Math.abs(b) * 0.01 || 1;
    return [a - pad, b + pad];
  };
  const marks = (kind, bottom, top) => {
    if (kind === "combination") return top > 4 ? [[1, "1"], [-1, "-1"]] : [[1, "1"], [0, "0"], [-1, "-1"]];
    if (kind === "margin") {
      const count = Math.max(Math.floor(-bottom), 0), out = [[1, "1"], [0, "0"]];
      for (let n = 0; n < count; n += 1 + Math.floor(count / 5)) out.push([-1 - n, String(-(10 ** n))]);
      return out;
    }
    let step = 10 ** Math.floor(Math.log10((top - bottom) / 2));
    step *= [5, 2, 1].find((n) => n === 1 || (top - bottom) / (n * step) >= 2);
    const out = [];
    for (let n = Math.ceil(bottom / step); n * step <= top; n++) out.push([n * step, String(Number((n * step).toPrecision(6)))]);
    return out;
  };
  const usual = (ends) => { // without the widest of a band, as it begins
    const seen = ends.filter(Number.isFinite).sort((a, b) => a - b), cut = 0.02 * (seen.length - 1);
    return seen.slice(Math.ceil(cut), Math.floor(seen.length - 1 - cut) + 1);
  };
  const areas = ({ across, gap, half, bins }, low, high) => { // in steps where they are extremes of bins: between these nothing is known
    let out = "";
    for (let a = 0; a < low.length; a++) {
      if (Number.isNaN(low[a]) || Number.isNaN(high[a])) continue;
      let b = a;
      while (b + 1 < low.length && !Number.isNaN(low[b + 1]) && !Number.isNaN(high[b + 1]) && across[b + 1] - across[b] <= gap) b++;
      const upper = [], lower = [];
      for (let k = a; k <= b; k++) {
        const left = across[k].toFixed(1), right = (k < b ? across[k + 1] : across[k] + 2 * half).toFixed(1);
        upper.push(bins ? `V${high[k].toFixed(1)}H${right}` : `${left} ${high[k].toFixed(1)}`);
        lower.unshift(bins ? `V${low[k].toFixed(1)}H${left}` : `${left} ${low[k].toFixed(1)}`);
      }
      out += bins ? `M${across[a].toFixed(1)} ${upper.concat(lower).join("").slice(1)}Z` : `M${upper.concat(lower).join("L")}Z`;
      a = b;
    }
    return out;
  };
  const spans = ({ middle, half }, on) => {
    let out = "";
    for (let i = 0; i < on.length; i++) {
      if (!on[i] || on[i - 1]) continue;
      let j = i;
      while (on[j + 1]) j++;
      const left = Math.max(middle[i] - half, 0).toFixed(2);
      out += `M${left} 0H${Math.min(middle[j] + half, 1000).toFixed(2)}V100H${left}Z`;
    }
    return out;
  };

  const draw = () => {
    const within = near.filter((p) => p.first <= from + hair && to <= p.last + hair), piece = within.find((p) => p.combined.has(alarm)) || within[0] || whole;
    const violated = piece.combined.get(alarm) || [...piece.combined.values()][0];
    if (violated) piece.low.combination = piece.high.combination = violated.values;
    const begun = piece.x.findIndex((x) => x >= from - hair), ended = piece.x.findLastIndex((x) => x <= to + hair);
    const i = Math.max((begun < 0 ? piece.n : begun) - 1, 0), j = Math.min(ended + 2, piece.n); // lines and bins go on at either side
    const n = j - i, bins = n > most + 2 ? most : n, at = Array.from({ length: bins }, (_, b) => i + Math.floor(b * n / bins));
    const across = at.map((k) => 1000 * (piece.x[k] - from) / (to - from)), half = 500 * piece.step * n / bins / (to - from);
    const binned = piece.binned || bins < n, middle = across.map((x) => binned ? x + half : x), axis = { across, middle, half, gap: 5 * half, bins: binned };
    const worst = at.map((k, b) => { let s = 0; for (let q = k; q < (at[b + 1] ?? j); q++) s = Math.max(s, Number(piece.status[q])); return s; });
    const fault = worst.map((s) => s === 3);
    for (const panel of zoom.querySelectorAll("[data-key]")) {
      const key = panel.dataset.key, kind = panel.classList[1];
      const around = `${key}:band`, nothing = { low: Array(bins).fill(NaN), high: Array(bins).fill(NaN) };
      panel.hidden = !(key in piece.low || around in piece.low);
      if (panel.hidden) continue;
      let { low, high } = key in piece.low ? extremes(piece, i, j, bins, key) : nothing;
      const held = around in piece.low ? extremes(piece, i, j, bins, around) : nothing;
      if (kind === "margin") { low = low.map(squeezed); high = high.map(squeezed); }
      const [bottom, top] = limits(kind, low.concat(usual(held.low)), high.concat(usual(held.high))), down = (v) => 100 * Math.min(Math.max((top - v) / (top - bottom), 0), 1);
      const beyond = low.map((v, b) => Math.abs(v) > 1 || Math.abs(high[b]) > 1), shaded = kind === "combination" ? beyond : fault;
      let line = "", out = "", pen = false;
      low.forEach((v, b) => {
        if (Number.isNaN(v) || Number.isNaN(high[b])) { pen = false; return; }
        const on = pen && across[b] - across[b - 1] <= axis.gap;
        line += `${on ? "L" : "M"}${across[b].toFixed(1)} ${down(v).toFixed(1)}${on ? "" : "h0"}`;
        const peak = kind === "combination" && Math.abs(high[b]) > Math.abs(v) ? high[b] : v;
        if (kind !== "signal" && shaded[b]) out += `M${middle[b].toFixed(1)} ${down(peak).toFixed(1)}h0`;
        pen = true;
      });
      if (panel.querySelector(".hull")) panel.querySelector(".hull").setAttribute("d", areas(axis, held.low.map(down), held.high.map(down)));
      panel.querySelector(".line").setAttribute("d", binned ? areas(axis, low.map(down), high.map(down)) : line);
      panel.querySelector(".line").classList.toggle("bins", binned);
      panel.querySelector(".out").setAttribute("d", out);
      panel.querySelector(".shade").setAttribute("d", spans(axis, shaded));
      const band = panel.querySelector(".band");
      if (band) { band.setAttribute("y", down(1)); band.setAttribute("height", down(-1) - down(1)); }
      panel.querySelector(".marks").replaceChildren(...marks(kind, bottom, top).map(([v, text]) => {
        const mark = document.createElement("i"), said = document.createElement("span");
        mark.style.top = `${down(v)}%`;
        said.textContent = text;
        mark.append(said);
        return mark;
      }));
    }
    names.forEach((name, s) => zoom.querySelector(`.verdicts .${name}`).setAttribute("d", spans(axis, worst.map((w) => w === s))));
    zoom.querySelector(".axis").replaceChildren(...ticks(from, to).map((x) => {
      const tick = document.createElement("span");
      tick.style.left = `${100 * (x - from) / (to - from)}%`;
      tick.textContent = time(x);
      return tick;
    }));
    const range = `${time(from)} to ${time(to)}`, each = Math.round((piece === whole ? all.samples / whole.n : 1) * n / bins);
    const rest = whole.binned ? `around ${all.alarms.length ? "alarms" : "the tightest window"} each one is kept` : "closer each one is shown";
    const coarse = binned && each > 1 ? `; each step is the lowest and the highest of ${each} samples, ${rest}` : "";
    const inside = all.alarms.some(([i, , , worst]) => i === alarm && from - hair <= worst && worst <= to + hair);
    const where = piece === whole ? "" : alarm < 0 ? "around the tightest window: " : inside ? `around alarm ${alarm + 1}: ` : "";
    zoom.querySelector(".said").textContent = where + range + coarse;
    for (const svg of zoom.querySelectorAll("svg")) svg.setAttribute("aria-label", svg.getAttribute("aria-label").replace(/ from .*/s, ` from ${range}`));
    const relation = zoom.querySelector(".relation");
    relation.hidden = !violated;
    relation.firstElementChild.textContent = violated ? violated.relation : "";
    const shown = document.querySelector(".window");
    if (shown) {
      const span = whole.last - whole.first || 1;
      shown.style.left = `${100 * (from - whole.first) / span}%`;
      shown.style.width = `${100 * (to - from) / span}%`;
    }
  };
  const select = zoom.querySelector("select"), field = zoom.querySelector("input"), wrong = zoom.querySelector(".wrong");
  const show = (a, b) => {
    wrong.hidden = true;
    const least = 4 * all.step, span = Math.min(Math.max(b - a, least), whole.last - whole.first || least);
    const middle = Math.min(Math.max((a + b) / 2, whole.first + span / 2), whole.last - span / 2);
    [from, to] = [middle - span / 2, middle + span / 2];
    draw();
  };
  const goto = (i) => {
    if (!all.alarms.length) return show(all.from, all.to);
    const row = Math.min(Math.max(i, 0), all.alarms.length - 1), [number, begun, ended, worst] = all.alarms[row];
    alarm = number;
    select.value = String(row);
    const piece = near.find((p) => p.combined.has(alarm)) || near.find((p) => p.first <= begun && ended <= p.last), reach = 80 * all.step;
    if (piece) show(piece.first, piece.last); else show(Math.min(begun, worst) - reach, Math.max(ended, worst) + reach);
  };
  const deeds = {
    worst: () => { alarm = all.alarm; if (select) select.value = String(all.alarms.findIndex((a) => a[0] === alarm)); show(all.from, all.to); },
    previous: () => goto(Number(select.value) - 1),
    next: () => goto(Number(select.value) + 1),
    go: () => {
      const x = asked(field.value), half = (to - from) / 2;
      if (whole.first - hair <= x && x <= whole.last + hair) return show(x - half, x + half);
      wrong.textContent = `this is no time of the recording, which goes from ${time(whole.first)} to ${time(whole.last)}`;
      wrong.hidden = false;
    },
    left: () => show(from - (to - from) / 4, to - (to - from) / 4),
    right: () => show(from + (to - from) / 4, to + (to - from) / 4),
    in: () => show(from + (to - from) / 4, to - (to - from) / 4),
    out: () => show(from - (to - from) / 2, to + (to - from) / 2),
    all: () => show(whole.first, whole.last),
  };
  zoom.querySelector(".moves").hidden = false;
  zoom.addEventListener("click", (e) => { const what = e.target.closest("[data-do]"); if (what) deeds[what.dataset.do](); });
  if (select) select.addEventListener("change", () => goto(Number(select.value)));
  field.addEventListener("keydown", (e) => { if (e.key === "Enter") deeds.go(); });
  zoom.addEventListener("keydown", (e) => {
    const does = { ArrowLeft: "left", ArrowRight: "right", "+": "in", "=": "in", "-": "out" }[e.key];
    if (e.target !== zoom || !does) return;
    e.preventDefault();
    deeds[does]();
  });
  document.addEventListener("click", (e) => { // the table of alarms comes below
    const link = e.target.closest("a[data-alarm]");
    if (link) goto(Number(link.dataset.alarm));
  });
  const overview = document.querySelector("#overview .margin .plot");
  if (overview) {
    const place = (e) => { const box = overview.getBoundingClientRect(); return whole.first + (whole.last - whole.first) * (e.clientX - box.left) / box.width; };
    let begun = null;
    const shown = document.createElement("div");
    shown.className = "window";
    overview.append(shown);
    overview.addEventListener("pointerdown", (e) => { begun = place(e); });
    window.addEventListener("pointerup", (e) => {
      if (begun === null) return;
      const ended = place(e), half = (to - from) / 2, wide = Math.abs(ended - begun) > (whole.last - whole.first) / 200;
      if (wide) show(Math.min(begun, ended), Math.max(begun, ended)); else show(ended - half, ended + half);
      begun = null;
    });
  }
  if (select) select.value = String(all.alarms.findIndex((a) => a[0] === alarm));
  draw();
})();
