"use strict";
// What plots of all pages have in common: colours of the style sheet, axes, labels of ticks, bands, and heights.
window.axes = (() => {
  const colour = (name, alpha = 1) => {
    const text = getComputedStyle(document.documentElement).getPropertyValue(name).trim();
    const part = (at) => parseInt(text.slice(at, at + 2), 16);
    return alpha === 1 ? text : `rgba(${part(1)},${part(3)},${part(5)},${alpha})`;
  };
  const missing = (value) => value === null || value === undefined;
  const minus = (text) => text.replace("-", "\u2212");
  const decimals = (step) => {
    let count = 0;  // as many as tell multiples of 2.5 apart, too
    while (count < 9 && Math.abs(step * 10 ** count - Math.round(step * 10 ** count)) > 1e-6 * step * 10 ** count) count += 1;
    return count;
  };
  const ticks = (u, values, axis, space, step) => values.map((v) => (missing(v) ? "" : minus(v.toFixed(decimals(step)))));
  const axis = (px) => {
    const rule = { stroke: () => colour("--rule"), width: 1 }, font = `${px}px system-ui, sans-serif`;
    return { stroke: () => colour("--ink"), grid: rule, ticks: rule, font, labelFont: font };
  };

  // The first series, of the times, and two for the edges of each band.
  const beginning = (bands) => ({
    series: [
      { label: "t", value: (u, v) => (missing(v) ? "" : `${v.toFixed(3)} s`) },
      ...bands.flatMap(() => ["high", "low"].map((label) => ({ label, width: 0, points: { show: false }, auto: false, class: "edge" }))),
    ],
    bands: bands.map((band, at) => ({ series: [2 * at + 1, 2 * at + 2], fill: () => colour(band.colour, band.alpha) })),
  });
  const extent = (columns) => {
    let bottom = Infinity, top = -Infinity;
    for (const column of columns) for (const value of column) if (!missing(value)) { bottom = Math.min(bottom, value); top = Math.max(top, value); }
    return bottom <= top ? [bottom, top] : null;
  };
  // Curves go from `low` to `high`. Bands, with their extent, are shown whole unless they are so many times (`wider`)
  // wider than the curves that these could not be read; `least`: height that is shown at least.
  const height = (low, high, bands, wider, least) => {
    if (missing(low) || missing(high) || !Number.isFinite(low)) return [0, 1];
    const room = wider * Math.max(high - low, least), [bottom, top] = bands ?? [low, high];
    low = Math.max(Math.min(low, bottom), low - room);
    high = Math.min(Math.max(high, top), high + room);
    const half = Math.max((high - low) / 2, least / 2, Math.abs(high) * 1e-6, 1e-12) * 1.08, middle = (low + high) / 2;
    return [middle - half, middle + half];
  };
  return { colour, missing, minus, ticks, axis, beginning, extent, height };
})();
