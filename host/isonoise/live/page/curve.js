// The error against time as SVG, both logarithmic, with the error that ends the render.

import { formatNumber } from "./text.js";

const WIDTH = 340, HEIGHT = 220, LEFT = 48, RIGHT = 10, TOP = 10, BOTTOM = 30;
const NAMESPACE = "http://www.w3.org/2000/svg";
const LINES = [["stated_p50", "p50", "stated p50"], ["stated_p95", "p95", "stated p95"],
  ["stated_p99", "p99", "stated p99"], ["error_bound", "bound", "bound for the target"],
  ["true_p99", "true", "true p99"]];

function element(name, attributes, text = "") {
  const result = document.createElementNS(NAMESPACE, name);
  for (const [key, value] of Object.entries(attributes)) result.setAttribute(key, value);
  result.textContent = text;
  return result;
}

// 1, 2 and 5 times powers of ten, or the powers alone if there are many, between the ends.
function ticks(low, high) {
  const result = [];
  const factors = Math.log10(high / low) > 3 ? [1] : [1, 2, 5];
  for (let power = Math.floor(Math.log10(low)); power <= Math.ceil(Math.log10(high)); power++)
    for (const factor of factors)
      if (factor * 10 ** power >= low * 0.999 && factor * 10 ** power <= high * 1.001) result.push(factor * 10 ** power);
  return result;
}

// rows: of the log; target: error that ends the render, or null. Fills the elements `box` and `key`.
export function drawCurve(box, key, rows, target) {
  const lines = LINES.map(([field, name, label]) => ({
    name, label, points: rows.filter((row) => row[field] > 0 && row.elapsed_s > 0).map((row) => [row.elapsed_s, row[field]]),
  })).filter((line) => line.points.length);
  const all = lines.flatMap((line) => line.points);
  if (!all.length) return;
  const times = all.map((point) => point[0]), errors = all.map((point) => point[1]);
  if (target) errors.push(target);
  const [first, last] = ends(times), [low, high] = ends(errors);
  const x = (time) => LEFT + ((WIDTH - LEFT - RIGHT) * Math.log(time / first)) / Math.log(last / first);
  const y = (error) => TOP + ((HEIGHT - TOP - BOTTOM) * Math.log(high / error)) / Math.log(high / low);
  const svg = element("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, role: "img", "aria-label": summary(rows, target) });
  for (const time of ticks(first, last)) {
    svg.append(element("line", { class: "grid", x1: x(time), x2: x(time), y1: TOP, y2: HEIGHT - BOTTOM }));
    svg.append(element("text", { x: x(time), y: HEIGHT - BOTTOM + 15, "text-anchor": "middle" }, `${formatNumber(time)} s`));
  }
  for (const error of ticks(low, high)) {
    svg.append(element("line", { class: "grid", x1: LEFT, x2: WIDTH - RIGHT, y1: y(error), y2: y(error) }));
    svg.append(element("text", { x: LEFT - 6, y: y(error) + 4, "text-anchor": "end" }, `${formatNumber(100 * error)} %`));
  }
  if (target) svg.append(element("line", { class: "target", x1: LEFT, x2: WIDTH - RIGHT, y1: y(target), y2: y(target) }));
  for (const { name, points } of lines) {
    const path = points.map(([time, error]) => `${x(time).toFixed(1)} ${y(error).toFixed(1)}`).join("L");
    svg.append(element("path", { class: name, d: `M${path}${points.length === 1 ? "h1" : ""}` }));
  }
  box.replaceChildren(svg);
  const entries = lines.map(({ name, label }) => [name, label]);
  if (target) entries.push(["target", `target ${formatNumber(100 * target)} %`]);
  key.replaceChildren(...entries.map(([name, label]) => {
    const item = document.createElement("li"), sample = document.createElement("i");
    sample.className = name;
    item.append(sample, label);
    return item;
  }));
}

// Ends of an axis for these numbers, at least a factor of 2 apart.
function ends(numbers) {
  const low = numbers.reduce((a, b) => Math.min(a, b)), high = numbers.reduce((a, b) => Math.max(a, b));
  const margin = Math.max(Math.sqrt(2 / (high / low)), 1.1);
  return [low / margin, high * margin];
}

function summary(rows, target) {
  const row = rows[rows.length - 1];
  const goal = target ? `; the target is ${formatNumber(100 * target)} %` : "";
  return `Stated error at p99 after ${formatNumber(row.elapsed_s)} s: ${formatNumber(100 * row.stated_p99)} %${goal}`;
}
