// Lines over time on a canvas, for the page of a live session and for that of a recording.
"use strict";

const COLOURS = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9"];
const DASHES = [[], [6, 3], [2, 2]]; // lines with the same colour differ in their dashes
const LEFT = 52, TOP = 8, RIGHT = 8, BOTTOM = 20; // around the lines [px]
const byId = (id) => document.getElementById(id);
const make = (name, text = "") => Object.assign(document.createElement(name), { textContent: text });
const colour = (k) => COLOURS[k % COLOURS.length];

/** Round numbers between two limits, four to seven of them, and how many digits they have behind the point. */
function ticks(low, high) {
  const least = (high - low) / 6;
  const power = 10 ** Math.floor(Math.log10(least));
  const step = power * [1, 2, 5, 10].find((factor) => factor * power >= least * 0.999);
  const values = [];
  for (let k = Math.ceil(low / step); k * step <= high; k++) values.push(k * step);
  return [values, Math.max(0, -Math.floor(Math.log10(step) + 1e-9))];
}

/** A number as a reader wants it, with a real minus sign. */
const signed = (text) => text.replace(/^-(?=.*[1-9])/, "−").replace(/^-/, "");

/** The least and the largest value of rows [time, values]; beyond each other where there is none. */
function extremes(rows) {
  let low = Infinity, high = -Infinity;
  for (const [, values] of rows) {
    for (const x of values) if (x !== null) [low, high] = [Math.min(low, x), Math.max(high, x)];
  }
  return [low, high];
}

/** Two limits with some room around them. */
function widened(low, high) {
  const room = 0.05 * (high - low) || Math.max(1e-3, 0.05 * Math.abs(high));
  return [low - room, high + room];
}

/** Where a time is on a canvas that shows those from one to another [px]. */
const timeToX = (canvas, { from, to }, time) => LEFT + ((time - from) / (to - from)) * (canvas.clientWidth - LEFT - RIGHT);

/**
 * Draw `rows` [time, `count` values] between two times and two limits; without anything to draw the canvas is empty.
 *
 * `labels` are [time, text] for the axis of time; times farther apart than `gap` are not joined, and neither are those
 * around a value that is missing. `bands` are [from, to, colour] behind the lines, `marks` times with a dashed line;
 * lines of `suspects` stand out.
 */
function drawLines(canvas, plot) {
  const pen = canvas.getContext("2d"), ratio = devicePixelRatio || 1;
  const [width, height] = [canvas.clientWidth, canvas.clientHeight], bottom = height - BOTTOM;
  const sizes = [width, height].map((size) => Math.round(size * ratio));
  if (canvas.width !== sizes[0] || canvas.height !== sizes[1]) [canvas.width, canvas.height] = sizes;
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.clearRect(0, 0, width, height);
  if (!plot) return;
  const { rows, count, limits: [low, high], labels, gap, suspects = [], bands = [], marks = [] } = plot;
  const x = (time) => timeToX(canvas, plot, time);
  const y = (value) => TOP + (high - Math.min(Math.max(value, low), high)) / (high - low) * (bottom - TOP);
  const line = (...points) => { pen.beginPath(); pen.moveTo(...points[0]); pen.lineTo(...points[1]); pen.stroke(); };
  for (const [begin, end, paint] of bands) {
    pen.fillStyle = paint;
    pen.fillRect(x(begin) - 1, TOP, Math.max(x(end) - x(begin), 0) + 2, bottom - TOP);
  }
  Object.assign(pen, {
    font: "12px system-ui, sans-serif", fillStyle: getComputedStyle(canvas).color, strokeStyle: "#88888866",
    lineWidth: 1, globalAlpha: 1, textAlign: "right", textBaseline: "middle",
  });
  pen.setLineDash([]);
  const [values, digits] = ticks(low, high);
  for (const value of values) {
    line([LEFT, y(value)], [width - RIGHT, y(value)]);
    pen.fillText(signed(value.toFixed(digits)), LEFT - 6, y(value));
  }
  for (const [time, text] of labels) {
    const half = pen.measureText(text).width / 2; // kept inside of the canvas
    pen.textAlign = x(time) + half > width ? "right" : x(time) - half < LEFT ? "left" : "center";
    pen.fillText(text, x(time), height - 8);
  }
  for (let k = 0; k < count; k++) {
    const suspect = suspects.includes(k);
    Object.assign(pen, { strokeStyle: suspect ? "#e60000" : colour(k), lineWidth: suspect ? 3 : 1.6 });
    pen.globalAlpha = suspects.length && !suspect ? 0.45 : 1;
    pen.setLineDash(DASHES[Math.floor(k / COLOURS.length) % DASHES.length]);
    pen.beginPath();
    let last = -Infinity;
    for (const [time, row] of rows) {
      if (row[k] === null) { last = -Infinity; continue; }
      if (time - last <= gap) pen.lineTo(x(time), y(row[k])); else pen.moveTo(x(time), y(row[k]));
      last = time;
    }
    pen.stroke();
  }
  Object.assign(pen, { globalAlpha: 1, lineWidth: 1.5, strokeStyle: getComputedStyle(canvas).color });
  pen.setLineDash([5, 4]);
  for (const time of marks) line([x(time), TOP], [x(time), bottom]);
}
