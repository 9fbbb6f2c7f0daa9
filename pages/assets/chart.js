// Plain charts as SVG: lines, bars, a time line. Each has a title and a sentence for who does not see it.

import { s } from "./dom.js";
import { formatNumber } from "./format.js";

const MARGIN = { top: 12, right: 12, bottom: 26, left: 62 };
let count = 0;

function frame({ width, height, label, description }) {
  const id = `chart-${(count += 1)}`;
  return s("svg", { class: "chart", viewBox: `0 0 ${width} ${height}`, width, height, role: "img", "aria-labelledby": `${id}-t ${id}-d` },
    s("title", { id: `${id}-t` }, label), s("desc", { id: `${id}-d` }, description));
}

function niceTop(value) {
  if (!(value > 0)) return 1;
  const power = 10 ** Math.floor(Math.log10(value));
  return [1, 2, 2.5, 5, 10].map((step) => step * power).find((top) => top >= value);
}

function tick(value) {
  return Math.abs(value) >= 100_000 ? `${+(value / 1000).toFixed(1)}k` : formatNumber(+value.toFixed(2));
}

function scale(from, to, start, end) {
  const span = to - from || 1;
  return (value) => start + ((value - from) / span) * (end - start);
}

/** Lines over x. series: [{name, points: [[x, y], ...]}]; `formatX` words for x; `from` and `to` bound x if given. */
export function lineChart({ series, width = 560, height = 180, label, unit = "", formatX = String, from, to }) {
  const points = series.flatMap((one) => one.points);
  const xs = points.map(([x]) => x);
  const top = niceTop(Math.max(0, ...points.map(([, y]) => y)));
  const left = from ?? Math.min(...xs);
  const right = to ?? Math.max(...xs);
  const last = series.map((one) => `${one.name}: ${one.points.length ? tick(one.points.at(-1)[1]) : "none"} ${unit}`);
  const chart = frame({ width, height, label, description: `At the end: ${last.join(", ")}.` });
  const x = scale(left, right, MARGIN.left, width - MARGIN.right);
  const y = scale(0, top, height - MARGIN.bottom, MARGIN.top);
  for (const part of [0, 0.5, 1]) {
    chart.append(s("line", { class: "rule", x1: MARGIN.left, x2: width - MARGIN.right, y1: y(top * part), y2: y(top * part) }));
    chart.append(s("text", { x: MARGIN.left - 6, y: y(top * part) + 4, "text-anchor": "end" }, tick(top * part) + (part === 1 && unit ? ` ${unit}` : "")));
  }
  if (xs.length) {
    chart.append(s("text", { x: MARGIN.left, y: height - 8 }, formatX(left)));
    chart.append(s("text", { x: width - MARGIN.right, y: height - 8, "text-anchor": "end" }, formatX(right)));
  }
  series.forEach((one, index) => {
    const path = one.points.map(([px, py]) => `${x(px).toFixed(1)},${y(py).toFixed(1)}`).join(" ");
    chart.append(s("polyline", { class: `series series-${(index % 5) + 1}`, points: path }));
  });
  return chart;
}

/** Bars: items [{name, value, tone}]. */
export function bars({ items, width = 560, height = 180, label, unit = "" }) {
  const top = niceTop(Math.max(0, ...items.map((item) => item.value)));
  const chart = frame({ width, height, label, description: items.map((item) => `${item.name}: ${tick(item.value)} ${unit}`).join(", ") });
  const y = scale(0, top, height - MARGIN.bottom, MARGIN.top);
  const step = (width - MARGIN.left - MARGIN.right) / Math.max(1, items.length);
  for (const part of [0, 0.5, 1]) {
    chart.append(s("line", { class: "rule", x1: MARGIN.left, x2: width - MARGIN.right, y1: y(top * part), y2: y(top * part) }));
    chart.append(s("text", { x: MARGIN.left - 6, y: y(top * part) + 4, "text-anchor": "end" }, tick(top * part) + (part === 1 && unit ? ` ${unit}` : "")));
  }
  items.forEach((item, index) => {
    const x = MARGIN.left + step * index + step * 0.15;
    chart.append(s("rect", { class: `mark series-1 ${item.tone ?? ""}`, x: x.toFixed(1), y: y(item.value).toFixed(1), width: (step * 0.7).toFixed(1), height: Math.max(0, y(0) - y(item.value)).toFixed(1), rx: 2 },
      s("title", {}, `${item.name}: ${tick(item.value)} ${unit}`)));
    if (items.length <= 12) chart.append(s("text", { x: (x + step * 0.35).toFixed(1), y: height - 8, "text-anchor": "middle" }, item.name));
  });
  return chart;
}

/** Marks on a line of time: events [{at, label, tone}], between `from` and `to`. */
export function timeLine({ events, from, to, width = 720, height = 64, label, formatX = String }) {
  const chart = frame({ width, height, label, description: `${events.length} events.` });
  const x = scale(from, to, MARGIN.right, width - MARGIN.right);
  const middle = height / 2 - 6;
  chart.append(s("line", { class: "axis", x1: MARGIN.right, x2: width - MARGIN.right, y1: middle, y2: middle }));
  for (const event of events) {
    chart.append(s("circle", { class: `mark ${event.tone ?? ""}`, cx: x(event.at).toFixed(1), cy: middle, r: 5 }, s("title", {}, event.label)));
  }
  chart.append(s("text", { x: MARGIN.right, y: height - 8 }, formatX(from)));
  chart.append(s("text", { x: width - MARGIN.right, y: height - 8, "text-anchor": "end" }, formatX(to)));
  return chart;
}
