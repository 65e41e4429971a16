// The charts of a study: shares against sizes or delays, with their intervals.
const page = JSON.parse(document.getElementById("numbers").textContent);
const SHARES = [0, 0.25, 0.5, 0.75, 1], HEIGHT = 236, DELAYS = 10; // from which delay on the axis is logarithmic
page.charts.forEach((c, k) => {
  const plot = document.querySelectorAll(".curves .plot")[k];
  const x = [...new Set(c.curves.flatMap((curve) => curve.x))].sort((a, b) => a - b);
  const spread = (curve, values) => x.map((v) => values[curve.x.indexOf(v)] ?? null);
  const series = [{}], bands = [], data = [x];
  for (const curve of c.curves) {
    const stroke = () => colour(curve.colour);
    if (curve.low) {
      for (const ends of [curve.low, curve.high]) data.push(spread(curve, ends));
      series.push({ stroke, width: 0.5, points: { show: false } }, { stroke, width: 0.5, points: { show: false } });
      bands.push({ series: [series.length - 1, series.length - 2], fill: () => `${colour(curve.colour)}33` });
    }
    data.push(spread(curve, curve.share));
    const paths = curve.low ? uPlot.paths.linear() : uPlot.paths.stepped({ align: 1 });
    series.push({ stroke, width: 1.8, paths, alpha: curve.faint, points: { show: Boolean(curve.low), size: 6, fill: stroke } });
  }
  const guaranteed = (u) => {
    if (c.guaranteed === null) return;
    const at = u.valToPos(c.guaranteed, "x", true);
    Object.assign(u.ctx, { strokeStyle: colour("CONSISTENT"), lineWidth: 2 * devicePixelRatio });
    u.ctx.setLineDash([6, 4].map((n) => n * devicePixelRatio));
    u.ctx.beginPath();
    u.ctx.moveTo(at, u.bbox.top);
    u.ctx.lineTo(at, u.bbox.top + u.bbox.height);
    u.ctx.stroke();
    u.ctx.setLineDash([]);
  };
  const chart = new uPlot({
    width: widthOf(plot), height: HEIGHT, padding: [8, 12, 0, 0], legend: { show: false }, series, bands,
    scales: { x: { time: false, range: () => c.ends, ...(c.delays ? { distr: 4, asinh: DELAYS } : {}) }, y: { range: () => [-0.03, 1.05] } },
    axes: [axis({ size: 24, values: (u, at) => at.map((v) => (v === null ? "" : short(v))), splits: c.ticks && (() => c.ticks), filter: (u, at) => at, show: c.label !== "" }), upright({ splits: () => SHARES })],
    cursor: { y: false, drag: { x: false, y: false }, points: { size: 7 } },
    hooks: { drawClear: [guaranteed] },
  }, data, plot);
  follow(chart, plot, HEIGHT);
});
