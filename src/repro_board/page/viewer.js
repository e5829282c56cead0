// A shape in 3-D with a slider for time, for the pages of the book and for the live view.
//
//   handle = reproViewer.mount(element, data)
//
// `data` is what `repro_board.view` writes, lengths in mm:
//   label                what the picture shows, in words
//   box, radius          two corners around everything that is drawn; radius of the body
//   time_s               one number per frame; none for the live view, which has no slider
//   start                the frame that is shown first; 0 if not given
//   shapes               [{name, role: "truth" | "estimate", points, deviation?}]: x, y, z of the points of all frames,
//                        and for each point a standard deviation, drawn as a tube of two of them
//   magnets, sensors     {points, directions, name?}, for all frames
//   suspects             {name}, if sensors may be marked
//   widest               largest radius of a tube of deviations [mm]; any if not given
//   zoom                 how many times nearer the eye is than where all of the floor is in the picture
//   tallest              most pixels that the picture is high; 440 if not given
//   traces               [{title, unit, series: [{name, values, estimate?}]}], one value per frame, null where missing
// Many numbers arrive as base64 of 16-bit integers: tenths of a millimetre, or ten-thousandths of a direction.
//
// The handle: setFrame(i); update(frame), which draws one shape that is not part of `data` (fields as above, and in
// `suspects` numbers of sensors that are marked); dispose(). Without WebGL there is no handle but null, and the image inside `element` stays.

import { colours, onThemeChange } from "./colours.js";
import { createScene } from "./scene.js";
import css from "./style.css";
import { createTraces, make, shown } from "./traces.js";

const LENGTH_MM = 0.1; // unit of packed lengths
const DIRECTION = 1e-4; // unit of packed directions
const TURN_RAD = Math.PI / 24; // of the view, by an arrow key
const LONGEST_PLAY_S = 20; // longer recordings play faster than they were
const KEYS = {
  ArrowLeft: [-TURN_RAD, 0], ArrowRight: [TURN_RAD, 0], ArrowUp: [0, TURN_RAD], ArrowDown: [0, -TURN_RAD],
  "+": [0, 0, 1 / 1.15], "-": [0, 0, 1.15],
};

/** Numbers of `data`, packed or plain. */
function numbers(given, unit) {
  if (typeof given !== "string") return Float64Array.from(given);
  const bytes = Uint8Array.from(atob(given), (character) => character.charCodeAt(0));
  const view = new DataView(bytes.buffer);
  return Float64Array.from({ length: bytes.length / 2 }, (_, i) => unit * view.getInt16(2 * i, true));
}

/** A function that returns frame `i` of `data`, its numbers unpacked. */
function unpacked(data) {
  const n = data.time_s.length;
  const part = (all, i) => all.subarray((i * all.length) / n, ((i + 1) * all.length) / n);
  const shapes = data.shapes.map((shape) => ({
    role: shape.role,
    points: numbers(shape.points, LENGTH_MM),
    deviation: shape.deviation && numbers(shape.deviation, LENGTH_MM / 10),
  }));
  const markers = (given) => given && {
    points: numbers(given.points, LENGTH_MM), directions: numbers(given.directions, DIRECTION),
  };
  const [magnets, sensors] = [markers(data.magnets), markers(data.sensors)];
  const markersAt = (all, i) => all && { points: part(all.points, i), directions: part(all.directions, i) };
  return (i) => ({
    shapes: shapes.map(({ role, points, deviation }) => ({
      role, points: part(points, i), deviation: deviation && part(deviation, i),
    })),
    magnets: markersAt(magnets, i),
    sensors: markersAt(sensors, i),
  });
}

/** The list of what has which colour, and how large a square of the floor is. */
function legend(data, step) {
  const list = make("ul", { class: "shape-view-legend" });
  const entries = data.shapes.map((shape) => [shape.role, shape.name]);
  if (data.shapes.some((shape) => shape.deviation)) entries.push(["deviation", "± 2 standard deviations"]);
  for (const role of ["magnets", "sensors", "suspects"]) if (data[role]) entries.push([role, data[role].name ?? role]);
  for (const [role, name] of entries) list.append(make("li", {}, make("i", { "data-role": role }), name));
  list.append(make("li", {}, `floor: squares of ${shown(step)} mm`));
  list.append(make("li", {}, "turn: drag, or arrow keys and + −"));
  return list;
}

function addStyle() {
  if (addStyle.done) return;
  const sheet = new CSSStyleSheet(); // unlike a style element, allowed under a strict content security policy
  sheet.replaceSync(css);
  document.adoptedStyleSheets = [...document.adoptedStyleSheets, sheet];
  addStyle.done = true;
}

/** Show `data` in `element`; see the top of this file. */
export function mount(element, data) {
  const canvas = make("canvas", { role: "img", tabindex: 0, "aria-label": data.label });
  const scene = createScene(canvas, data, colours());
  if (!scene) return null;
  addStyle();
  const time = data.time_s ?? [];
  const frameAt = time.length ? unpacked(data) : null;
  let frame = null;
  let current = 0;
  let playing = 0; // number of the animation request, 0 when paused
  let moveCursor = () => {};

  const reset = make("button", { type: "button" }, "Reset view");
  const bar = make("div", { class: "shape-view-bar" });
  const key = legend(data, scene.step);
  const view = make("div", { class: "shape-view-mounted" }, canvas, bar, key);
  const slider = make("input", { type: "range", min: 0, max: time.length - 1, step: 1, "aria-label": "Time" });
  const clock = make("span", { class: "shape-view-clock", "aria-hidden": "true" });
  const play = make("button", { type: "button" }, "Play");
  const duration = time.length ? time.at(-1) - time[0] : 0;
  const speed = Math.max(1, duration / LONGEST_PLAY_S);
  if (time.length > 1) bar.append(play, slider, clock);
  bar.append(reset);
  const picture = element.querySelector("img");
  if (picture) picture.style.display = "none";
  element.append(view);

  function setFrame(i) {
    current = Math.min(Math.max(Math.round(i), 0), time.length - 1);
    frame = frameAt(current);
    slider.value = current;
    slider.setAttribute("aria-valuetext", `${time[current].toFixed(2)} s of ${time.at(-1).toFixed(2)} s`);
    clock.textContent = `${time[current].toFixed(2)} s`;
    moveCursor(current);
    scene.draw(frame);
  }

  /** The last frame that is not later than a time. */
  function frameBefore(seconds) {
    const later = time.findIndex((t) => t > seconds);
    return later < 0 ? time.length - 1 : Math.max(later - 1, 0);
  }

  function pause() {
    cancelAnimationFrame(playing);
    playing = 0;
    play.textContent = "Play";
  }

  // Never by itself: a page that moves unasked disturbs, and some readers ask their system for less motion.
  function start() {
    const from = current === time.length - 1 ? time[0] : time[current];
    const began = performance.now();
    const tick = (now) => {
      const next = frameBefore(from + (speed * Math.max(now - began, 0)) / 1000);
      if (next !== current) setFrame(next);
      if (next === time.length - 1) pause();
      else playing = requestAnimationFrame(tick);
    };
    play.textContent = speed > 1 ? `Pause (× ${shown(speed)})` : "Pause";
    playing = requestAnimationFrame(tick);
  }

  function paint() {
    const palette = colours();
    scene.setPalette(palette);
    for (const chip of key.querySelectorAll("i")) chip.style.background = palette[chip.dataset.role];
    if (frame) scene.draw(frame);
  }

  slider.addEventListener("input", () => {
    pause();
    setFrame(Number(slider.value));
  });
  play.addEventListener("click", () => (playing ? pause() : start()));
  reset.addEventListener("click", scene.resetView);
  canvas.addEventListener("focus", () => scene.zoomByWheel(true));
  canvas.addEventListener("blur", () => scene.zoomByWheel(false));
  canvas.addEventListener("pointerdown", () => canvas.focus({ preventScroll: true }));
  canvas.addEventListener("keydown", (event) => {
    if (!(event.key in KEYS) || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    scene.move(...KEYS[event.key]);
  });
  const resizing = new ResizeObserver(() => {
    const width = view.clientWidth;
    if (width) scene.resize(width, Math.round(Math.min(Math.max(0.62 * width, 240), data.tallest ?? 440)));
  });

  if (data.traces?.length && time.length > 1) {
    moveCursor = createTraces(view, data.traces, time, (fraction) => {
      pause();
      setFrame(frameBefore(time[0] + fraction * duration));
    });
  }
  const forgetTheme = onThemeChange(paint);
  if (frameAt) setFrame(data.start ?? 0);
  paint();
  resizing.observe(view);

  return {
    setFrame,
    update(next) {
      const shapes = next.shapes.map((shape, i) => ({ ...data.shapes[i], ...shape }));
      frame = { ...unpacked({ ...next, shapes, time_s: [0] })(0), suspects: next.suspects };
      scene.draw(frame);
    },
    dispose() {
      pause();
      forgetTheme();
      resizing.disconnect();
      scene.dispose();
      view.remove();
      if (picture) picture.style.display = "";
    },
  };
}

/** Mount every view of the page whose data stand beside it. */
function mountAll() {
  for (const element of document.querySelectorAll(".shape-view")) {
    const data = element.querySelector('script[type="application/json"]');
    if (data && !element.querySelector("canvas")) mount(element, JSON.parse(data.textContent));
  }
}

if (document.readyState === "loading") document.addEventListener("DOMContentLoaded", mountAll);
else mountAll();
