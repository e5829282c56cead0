// Lines over the last seconds, drawn on a canvas of the page of a live session.
(function () {
"use strict";

const SECONDS = 20; // that are shown
const COLOURS = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9"];
const DASHES = [[], [6, 3], [2, 2]]; // lines with the same colour differ in their dashes
const LEFT = 64, TOP = 6, RIGHT = 8, BOTTOM = 20; // around the lines [px]

const colour = (k) => COLOURS[k % COLOURS.length];

/** Limits with some room around the lowest and the highest value. */
function roomy(low, high) {
  const room = 0.05 * (high - low) || Math.max(1e-3, 0.05 * Math.abs(high));
  return [low - room, high + room];
}

/** Draw `count` lines between limits: `line(k, to)` calls `to(age [s], value, joined)` for each point of line k. */
function draw(canvas, limits, count, line) {
  const ratio = devicePixelRatio || 1, pen = canvas.getContext("2d");
  const sizes = [canvas.clientWidth, canvas.clientHeight].map((size) => Math.round(size * ratio));
  if (canvas.width !== sizes[0] || canvas.height !== sizes[1]) [canvas.width, canvas.height] = sizes;
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.setLineDash([]);
  pen.clearRect(0, 0, canvas.width, canvas.height);
  if (!limits) return;
  const [low, high] = limits, [width, height] = sizes.map((size) => size / ratio), bottom = height - BOTTOM;
  const x = (age) => LEFT + (1 - age / SECONDS) * (width - LEFT - RIGHT);
  const y = (value) => TOP + (high - value) / (high - low) * (bottom - TOP);
  Object.assign(pen, { font: "12px system-ui, sans-serif", fillStyle: getComputedStyle(canvas).color, strokeStyle: "#88888866", lineWidth: 1, textAlign: "right", textBaseline: "middle" });
  for (let k = 0; k <= 4; k++) {
    const value = low + k / 4 * (high - low);
    pen.beginPath(); pen.moveTo(LEFT, y(value)); pen.lineTo(width, y(value)); pen.stroke();
    pen.fillText(value.toPrecision(4), LEFT - 6, Math.min(Math.max(y(value), 7), bottom));
  }
  pen.fillText("now", width - 4, height - 8);
  pen.textAlign = "left";
  pen.fillText(`−${SECONDS} s`, LEFT, height - 8);
  pen.lineWidth = 1.8;
  for (let k = 0; k < count; k++) {
    pen.strokeStyle = colour(k);
    pen.setLineDash(DASHES[Math.floor(k / COLOURS.length) % DASHES.length]);
    pen.beginPath();
    line(k, (age, value, joined) => (joined ? pen.lineTo(x(age), y(value)) : pen.moveTo(x(age), y(value))));
    pen.stroke();
  }
}

window.reproTraces = { SECONDS, colour, roomy, draw };
})();
