// The numbers of a page: the whole recording, in bins where it is long, and stretches of it sample by sample; their times.
const page = JSON.parse(document.getElementById("numbers").textContent);
const { tokens, base, digits, before, unit } = page.clock;
const VERDICTS = ["MISSING", "CONSISTENT", "UNDECIDED", "FAULT"];
const spoken = (name) => document.querySelector(`.legend .${name}`)?.parentNode.textContent ?? name; // as readers know it
const GAP = 2.5; // usual steps between two samples that are not joined
const LARGEST = 3e38; // that is drawn

const floats = (text, kind) => new kind(Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer);
const drawable = (v) => (Number.isNaN(v) ? null : Math.min(Math.max(v, -LARGEST), LARGEST)); // uPlot takes null for nothing
const evenly = (n, first, step) => Array.from({ length: n }, (_, i) => first + i * step);
const median = (values) => values.sort((a, b) => a - b)[values.length >> 1];

// A piece as uPlot takes it: where a sample or bin ends that nothing follows, there is a point without values.
const opened = (p) => {
  const at = Array.isArray(p.x) ? evenly(p.n, ...p.x) : [...floats(p.x, Float64Array)];
  const step = median(at.slice(1).map((t, i) => t - at[i])) || page.step;
  const x = [], sample = []; // the number of the sample at each point, null where there is none
  at.forEach((t, i) => {
    x.push(base + t);
    sample.push(i);
    if (i + 1 < p.n && at[i + 1] - t <= GAP * step) return;
    x.push(base + t + step);
    sample.push(null);
  });
  const placed = (values) => sample.map((i) => (i === null ? null : values[i]));
  const numbers = (text) => placed(Array.from(floats(text, Float32Array), drawable));
  const low = {}, high = {};
  for (const [key, ends] of Object.entries(p.series)) {
    low[key] = numbers(ends[0]);
    high[key] = ends[1] ? numbers(ends[1]) : low[key];
  }
  const combined = new Map(p.combined.map(([alarm, relation, values]) => [alarm, { relation, values: numbers(values) }]));
  const status = placed(Array.from(p.status, Number)), first = base + at[0], last = base + at.at(-1);
  return { x, sample, status, low, high, combined, step, binned: p.binned, first, last };
};
const whole = { ...opened(page.whole), last: base + page.last }, near = page.near.map(opened);
const hair = 1e-6 * page.step; // times are sums of steps, rounded

// Times as the recording writes them; those of the charts count from 1970 where it has dates.
const isField = (token) => /^[YmdHMSf]\d$/.test(token);
const fields = (t) => {
  const at = new Date(1000 * Math.floor(Math.round(1000 * t) / 1000)), day = { Y: at.getUTCFullYear(), m: at.getUTCMonth() + 1, d: at.getUTCDate() };
  return { ...day, H: at.getUTCHours(), M: at.getUTCMinutes(), S: at.getUTCSeconds() };
};
const time = (t) => {
  if (!tokens.length) return before + String(Number((t - base).toFixed(digits))) + unit;
  const of = fields(t), part = Math.round(1000 * t) / 1000 % 1;
  const written = ([field, least]) => (field === "f" ? part.toFixed(least).slice(2) : String(of[field]).padStart(least, "0"));
  return tokens.map((token) => (isField(token) ? written(token) : token)).join("");
};
const lines = (t) => (tokens.length ? time(t).replace(" ", "\n") : time(t)); // a date above its time
const asked = (text, day) => { // a time, perhaps as far as a day; NaN: not as the recording writes them
  if (!tokens.length) {
    const number = text.replace(before, "").replace(unit, "").trim();
    return number ? base + Number(number) : NaN;
  }
  const keys = tokens.filter(isField), between = tokens.filter((token) => !isField(token));
  const zone = (between.includes(tokens.at(-1)) ? tokens.at(-1) : "").trim();
  const body = zone && text.trim().endsWith(zone) ? text.trim().slice(0, -zone.length) : text;
  const found = body.match(/\d+/g) || [], signs = `${between.join("")} T:-./,`;
  const strange = [...body.replace(/\d/g, "")].some((c) => !signs.includes(c));
  if (!found.length || found.length > keys.length || strange) return NaN;
  const of = { ...fields(day), H: 0, M: 0, S: 0, f: 0 };
  found.forEach((number, i) => { of[keys[i][0]] = Number(keys[i][0] === "f" ? `.${number}` : number); });
  const at = Date.UTC(of.Y, of.m - 1, of.d, of.H, of.M, of.S) / 1000, back = fields(at);
  return Object.keys(back).every((k) => back[k] === of[k]) ? at + of.f : NaN; // there is no 30th of February
};
