// What all charts share: the colours of the page, axes, and charts that follow its width, its scheme and the printer.
const NARROW = 760, PRINTED = 680; // px: a page of a phone, and a sheet of paper
const all = []; // { chart, plot, height }
let printing = false;

// Print has a palette of its own, which the style sheet does not yet apply while the browser asks for the picture.
const paper = [...document.styleSheets].flatMap((sheet) => [...sheet.cssRules])
  .filter((rule) => rule.media?.mediaText === "print").flatMap((rule) => [...rule.cssRules])
  .filter((rule) => rule.selectorText === ":root").map((rule) => rule.style).reverse();
const printed = (name) => paper.map((style) => style.getPropertyValue(name)).find(Boolean) ?? "";
const onScreen = (name) => getComputedStyle(document.documentElement).getPropertyValue(name);
const colour = (name) => (printing ? printed : onScreen)(`--${name}`).trim();

const short = (v) => String(Number(v.toPrecision(6)));
const widthOf = (plot) => (printing ? PRINTED : Math.max(plot.clientWidth, 120));
const axis = (more) => ({
  stroke: () => colour("soft"),
  font: "11px system-ui, sans-serif",
  grid: { stroke: () => colour("line"), width: 1 },
  ticks: { show: false },
  border: { show: true, stroke: () => colour("line"), width: 1 },
  gap: 5,
  ...more,
});
const upright = (more) => axis({ size: () => (innerWidth < NARROW && !printing ? 46 : 62), space: 22,
  values: (u, marks) => marks.map(short), filter: (u, marks) => marks, ...more });

const follow = (chart, plot, height) => {
  all.push({ chart, plot, height });
  new ResizeObserver(() => { if (!printing && chart.width !== widthOf(plot)) chart.setSize({ width: widthOf(plot), height }); }).observe(plot);
  return chart;
};
const again = () => all.forEach(({ chart, plot, height }) => {
  chart.setSize({ width: widthOf(plot), height });
  chart.redraw(false);
});
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", again);
for (const [when, on] of [["beforeprint", true], ["afterprint", false]]) addEventListener(when, () => { printing = on; again(); });
