"use strict";
// Draws the pictures of a page anew with uPlot: drag zooms all of them, a double click shows everything again.
(() => {
  const source = document.getElementById("hilbench-data");
  if (!source || typeof uPlot === "undefined") return;
  const page = JSON.parse(source.textContent);
  const { colour, missing, minus, ticks, axis, beginning, extent, height } = window.axes;
  const AXIS_PX = 68, PLOT_PX = 230;

  const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer;
  const numbers = (text) => Array.from(new Float32Array(bytes(text)), (v) => (Number.isNaN(v) ? null : v));
  const tables = page.tables.map((t) => ({ x: Array.from(new Float64Array(bytes(t.x))), columns: t.columns.map(numbers) }));
  const first = Math.min(...tables.map((t) => t.x[0])), last = Math.max(...tables.map((t) => t.x[t.x.length - 1]));

  const plots = [];
  let shown = [first, last];
  const zoom = (from, to) => {
    shown = [from, to];
    for (const plot of plots) plot.setScale("x", { min: from, max: to });
    for (const button of document.querySelectorAll(".zooms button")) {
      const here = Math.abs(button.dataset.from - from) < 1e-6 && Math.abs(button.dataset.to - to) < 1e-6;
      button.setAttribute("aria-pressed", here ? "true" : "false");
    }
  };
  const whole = () => zoom(first, last);

  // The values of a plot over one time base; those of several are joined, with gaps where only others have samples.
  const aligned = (plot) => {
    const used = [], places = [];
    const column = (table, at) => {
      let place = used.findIndex((u) => u.table === table);
      if (place < 0) place = used.push({ table, columns: [] }) - 1;
      return [place, used[place].columns.push(tables[table].columns[at]) - 1];
    };
    for (const band of plot.bands) places.push(column(band.table, band.high), column(band.table, band.low));
    for (const curve of plot.curves) places.push(column(curve.table, curve.column));
    const parts = used.map((u) => [tables[u.table].x, ...u.columns]);
    const joined = parts.length === 1 ? parts[0] : uPlot.join(parts);
    const starts = parts.map((_, at) => parts.slice(0, at).reduce((sum, part) => sum + part.length - 1, 1));
    return [joined[0], ...places.map(([place, at]) => joined[starts[place] + at])];
  };

  const marks = (u) => {
    const { ctx, bbox } = u, ratio = devicePixelRatio;
    ctx.save();
    ctx.beginPath();
    ctx.rect(bbox.left, 0, bbox.width, bbox.top + bbox.height);
    ctx.clip();
    ctx.font = `${11 * ratio}px system-ui, sans-serif`;
    ctx.textBaseline = "bottom";
    ctx.textAlign = "left";
    let free = bbox.left;
    for (const mark of page.marks) {
      const x = u.valToPos(mark.from, "x", true), end = u.valToPos(mark.to, "x", true);
      if (end < bbox.left || x > bbox.left + bbox.width) continue;
      if (end > x) {
        ctx.fillStyle = colour("--ink", 0.06);
        ctx.fillRect(x, bbox.top, end - x, bbox.height);
      } else {
        ctx.strokeStyle = colour("--purple");
        ctx.lineWidth = 1.2 * ratio;
        ctx.setLineDash(mark.n ? [3 * ratio, 3 * ratio] : [8 * ratio, 3 * ratio, 2 * ratio, 3 * ratio]);
        ctx.beginPath();
        ctx.moveTo(x, bbox.top);
        ctx.lineTo(x, bbox.top + bbox.height);
        ctx.stroke();
      }
      const at = Math.max(x, bbox.left), next = page.marks.find((other) => other.n && other.from > mark.from);
      const room = (next ? Math.max(u.valToPos(next.from, "x", true), at) : bbox.left + bbox.width) - at;
      let text = mark.n ? `${mark.n}  ${mark.text}` : mark.text;
      if (next && ctx.measureText(text).width + 6 * ratio > room) text = mark.n; // no room before the next step
      const wide = ctx.measureText(text).width;
      if (!text || at < free) continue;
      ctx.fillStyle = colour(end > x ? "--faint" : "--purple");
      ctx.fillText(text, Math.min(at, bbox.left + bbox.width - wide), bbox.top - 2 * ratio);
      free = at + wide + 8 * ratio;
    }
    ctx.restore();
  };

  const WIDER = 2;
  const range = (least, bands) => (u, low, high) => {
    const [first, last] = u.series[0].idxs ?? [0, u.data[0].length - 1];
    return height(low, high, extent(u.data.slice(1, 1 + 2 * bands).map((edge) => edge.slice(first, last + 1))), WIDER, least);
  };

  const draw = (plot, place) => {
    const data = aligned(plot), { series, bands } = beginning(plot.bands);
    const unit = plot.y.split(" in ").pop();
    for (const curve of plot.curves) {
      series.push({
        label: curve.label, width: curve.width, dash: curve.dash, spanGaps: page.tables.length > 1,
        stroke: () => colour(curve.colour, curve.alpha), points: { show: false },
        value: (u, v) => (missing(v) ? "" : minus(v.toPrecision(6)) + " " + unit),
      });
    }
    const numbered = { ...axis(12), values: ticks };
    const u = new uPlot({
      width: place.clientWidth, height: PLOT_PX, series, bands, padding: [18, 14, 0, 0],
      scales: { x: { time: false }, y: { range: range(plot.least, plot.bands.length) } },
      axes: [{ ...numbered, label: "time in s", labelSize: 18, size: 34 }, { ...numbered, label: plot.y, labelSize: 18, size: AXIS_PX }],
      legend: { markers: { width: 2 } },
      cursor: {
        sync: { key: "hilbench", scales: ["x", null], filters: { pub: (type) => type !== "mousedown" && type !== "mouseup" } },
        drag: { x: true, y: false, setScale: true }, points: { size: 6 },
        bind: { dblclick: () => () => { whole(); return null; } },
      },
      hooks: {
        setScale: [(self, key) => {
          const { min, max } = self.scales.x;
          if (key === "x" && plots.includes(self) && (min !== shown[0] || max !== shown[1])) zoom(min, max);
        }],
        draw: [marks],
      },
    }, data, place);
    u.root.querySelectorAll(".u-legend .u-series").forEach((row, at) => {
      if (at > 0 && (at <= 2 * plot.bands.length || series[at].label === "")) row.hidden = true;
    });
    plots.push(u);
  };

  const bar = document.querySelector(".zooms");
  const button = (text, from, to) => {
    const made = document.createElement("button");
    made.type = "button";
    made.textContent = text;
    made.dataset.from = from;
    made.dataset.to = to;
    made.setAttribute("aria-pressed", from === first && to === last ? "true" : "false");
    made.addEventListener("click", () => zoom(from, to));
    bar.append(made);
  };
  if (bar) {
    button("whole run", first, last);
    for (const entry of page.zooms) button(entry.text, Math.max(first, entry.from), Math.min(last, entry.to));
    const hint = document.createElement("span");
    hint.textContent = "drag: zoom \u00b7 double click: whole run \u00b7 click a name: hide it";
    bar.append(hint);
    bar.hidden = false;
  }
  const figures = new Map([...document.querySelectorAll("figure[data-picture]")].map((f) => [f.dataset.picture, f]));
  for (const plot of page.plots) {
    const figure = figures.get(plot.picture);
    if (!figure) continue;
    figure.classList.add("live");
    const place = document.createElement("div");
    place.className = "plot";
    figure.insertBefore(place, figure.querySelector(".drawn"));
    draw(plot, place);
  }
  addEventListener("resize", () => plots.forEach((u) => u.setSize({ width: u.root.parentElement.clientWidth, height: PLOT_PX })));
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => plots.forEach((u) => u.redraw(true, true)));
  document.documentElement.dataset.live = plots.length;
})();
