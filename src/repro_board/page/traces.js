// What else changes with time, below the picture: lines over time with a cursor at the time that is shown.

import { SERIES } from "./colours.js";

const SVG = "http://www.w3.org/2000/svg";
const WIDTH = 1000; // of the coordinates inside; the drawing is stretched to the width there is
const HEIGHT = 100;
const MOST_LINES = 4; // in one panel; more are spread over panels of the same scale

/** A new element with attributes and content. */
export function make(name, attributes = {}, ...content) {
  const element = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  element.append(...content);
  return element;
}

function drawn(name, attributes) {
  const element = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  return element;
}

/** A number as a reader wants it: three digits, a real minus sign, a dash where there is none. */
export function shown(value) {
  if (value === null || value === undefined) return "–";
  return String(Number(value.toPrecision(3))).replace("-", "−");
}

/** Path of values over time; missing values leave a gap. */
function path(values, x, y) {
  let pen = "M";
  return values.map((value, i) => {
    if (value === null) {
      pen = "M";
      return "";
    }
    const piece = `${pen}${x(i).toFixed(1)} ${y(value).toFixed(1)}`;
    pen = "L";
    return piece;
  }).join("");
}

/** A trace as panels of at most `MOST_LINES` lines each, as evenly as can be; only the first has its title. */
function panelsOf({ title, unit, series }) {
  const all = series.flatMap((s) => [...s.values, ...(s.estimate ?? [])]).filter((value) => value !== null);
  const count = Math.ceil(series.length / Math.ceil(series.length / MOST_LINES));
  const panels = [];
  for (let k = 0; k < series.length; k += count) {
    const part = series.slice(k, k + count);
    panels.push({ title, unit, series: part, first: k === 0, low: Math.min(...all), high: Math.max(...all) });
  }
  return panels;
}

/**
 * Draw panels of traces into `element`.
 *
 * `pick(fraction)` is called when the reader points at a time. Returns a function that moves the cursor to a frame.
 */
export function createTraces(element, traces, time, pick) {
  const span = time.at(-1) - time[0] || 1;
  const x = (i) => (WIDTH * (time[i] - time[0])) / span;
  const panels = traces.flatMap(panelsOf).map(({ title, unit, series, first, low, high }) => {
    const y = (value) => HEIGHT - 4 - ((HEIGHT - 8) * (value - low)) / (high - low || 1);
    const names = series.map((s) => s.name).join(", ");
    const svg = drawn("svg", {
      viewBox: `0 0 ${WIDTH} ${HEIGHT}`, preserveAspectRatio: "none", role: "img",
      "aria-label": `${title} in ${unit} over time, from ${shown(low)} to ${shown(high)}: ${names}`,
    });
    const across = { d: `M0 ${HEIGHT / 2}H${WIDTH}`, stroke: "rgb(128 128 128 / 40%)" };
    svg.append(drawn("path", { ...across, "vector-effect": "non-scaling-stroke" }));
    const legend = make("ul", { class: "shape-view-legend" });
    const values = series.map((s, i) => {
      const colour = SERIES[i];
      const style = { fill: "none", stroke: colour, "vector-effect": "non-scaling-stroke", "stroke-width": 1.6 };
      svg.append(drawn("path", { ...style, d: path(s.values, x, y) }));
      if (s.estimate) svg.append(drawn("path", { ...style, "stroke-dasharray": "6 4", d: path(s.estimate, x, y) }));
      const chip = make("i");
      chip.style.borderTop = `3px solid ${colour}`;
      const value = make("span");
      legend.append(make("li", {}, chip, `${s.name} `, value));
      return value;
    });
    const cursor = drawn("line", {
      y1: 0, y2: HEIGHT, stroke: "currentColor", "vector-effect": "non-scaling-stroke", "stroke-width": 1.5,
    });
    svg.append(cursor);
    const point = (event) => {
      const box = svg.getBoundingClientRect();
      if (event.buttons) pick(Math.min(Math.max((event.clientX - box.left) / box.width, 0), 1));
    };
    svg.addEventListener("pointerdown", point);
    svg.addEventListener("pointermove", point);
    const dashed = series.some((s) => s.estimate) ? ", estimate dashed" : "";
    const quantum = 10 ** (Math.floor(Math.log10(high - low || 1)) - 2); // a middle of 0.00003 between ±1 is 0
    const middle = Math.round((low + high) / 2 / quantum) * quantum;
    const ticks = [high, middle, low].map((value) => make("span", {}, shown(value)));
    const limits = make("div", { class: "shape-view-limits" }, ...ticks);
    const row = make("div", { class: "shape-view-row" }, limits, svg);
    const heading = first ? [make("p", {}, `${title} [${unit}]${dashed}`)] : [];
    element.append(make("div", { class: "shape-view-trace" }, ...heading, legend, row));
    return { series, values, cursor };
  });
  const ends = [time[0], time.at(-1)].map((t) => make("span", {}, `${shown(t)} s`));
  element.append(make("div", { class: "shape-view-ends" }, ...ends));
  return (i) => {
    for (const { series, values, cursor } of panels) {
      cursor.setAttribute("x1", x(i));
      cursor.setAttribute("x2", x(i));
      series.forEach((s, k) => {
        values[k].textContent = shown(s.values[i]) + (s.estimate ? ` (${shown(s.estimate[i])})` : "");
      });
    }
  };
}
