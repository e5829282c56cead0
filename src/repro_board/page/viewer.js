// A shape in 3-D with a slider for time, for the pages of the book and for the live view.
//
//   handle = reproViewer.mount(element, data)
//
// `data` is what `repro_board.shape_view` writes, lengths in mm:
//   label                what the picture shows, in words
//   box, radius          two corners around everything that is drawn; radius of the body
//   time_s               one number per frame; none for the live view, which has no slider
//   start                the frame that is shown first; 0 if not given
//   shapes               [{name, role: "truth" | "estimate", points, deviation?}]: x, y, z of the points of all frames,
//                        and for each point a standard deviation, drawn as a tube of two of them
//   magnets, sensors     {points, directions, name?}, for all frames
//   suspects             {name, frames?}, if sensors may be marked: for each frame numbers of those that are
//   widest               largest radius of a tube of deviations [mm]; any if not given
//   zoom                 how many times nearer the eye is than where all of the floor is in the picture
//   tallest              most pixels that the picture is high; 440 if not given
// Many numbers arrive as base64 of 16-bit integers: tenths of a millimetre, or ten-thousandths of a direction.
//
// The handle: setFrame(i); update(frame), which draws one shape that is not part of `data` (fields as above, and in
// `suspects` numbers of sensors that are marked); dispose(). Without WebGL there is no handle but null, and the image inside `element` stays.
// An event "frame" of `element` has in `detail` the number of a frame that is shown.

import {
  BufferGeometry, CanvasTexture, CatmullRomCurve3, ConeGeometry, CylinderGeometry, DirectionalLight, DoubleSide,
  GridHelper, Group, HemisphereLight, Line, LineBasicMaterial, Mesh, MeshPhongMaterial, PerspectiveCamera, Scene,
  SphereGeometry, Spherical, Sprite, SpriteMaterial, SRGBColorSpace, TubeGeometry, Vector3, WebGLRenderer,
} from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import { colours, onThemeChange } from "./colours.js";
import css from "./style.css";

const LENGTH_MM = 0.1; // unit of packed lengths
const DIRECTION = 1e-4; // unit of packed directions
const TURN_RAD = Math.PI / 24; // of the view, by an arrow key
const LONGEST_PLAY_S = 20; // longer recordings play faster than they were
const KEYS = {
  ArrowLeft: [-TURN_RAD, 0], ArrowRight: [TURN_RAD, 0], ArrowUp: [0, TURN_RAD], ArrowDown: [0, -TURN_RAD],
  "+": [0, 0, 1 / 1.15], "-": [0, 0, 1.15],
};
const FIELD_OF_VIEW_DEG = 30;
const MARGIN = 1.04; // around the box, for the letters of the axes
const FIRST_VIEW = new Vector3(1, -1.7, 0.65).normalize(); // close to the view of the companion's other 3-D figures
const AROUND = 20; // sides of a tube
const ALONG = 72; // rings of a tube
const Y = new Vector3(0, 1, 0); // axis of the cylinders and cones of three.js

// ---- the picture: one frame, drawn by three.js whenever something changes; the base of the robot is at the origin, z is
// drawn upwards

/** A tube around points, `radii` one for each of them (or one number for all): may vary along the tube. */
function tube(points, radii) {
  const places = vectors(points);
  const geometry = new TubeGeometry(new CatmullRomCurve3(places, false, "centripetal"), ALONG, 0, AROUND);
  const position = geometry.attributes.position;
  const normal = geometry.attributes.normal;
  for (let vertex = 0; vertex < position.count; vertex++) {
    const at = (Math.floor(vertex / (AROUND + 1)) / ALONG) * (places.length - 1);
    const before = Math.min(Math.floor(at), places.length - 2);
    const radius = typeof radii === "number"
      ? radii
      : radii[before] + (at - before) * (radii[before + 1] - radii[before]);
    position.setXYZ(
      vertex,
      position.getX(vertex) + radius * normal.getX(vertex),
      position.getY(vertex) + radius * normal.getY(vertex),
      position.getZ(vertex) + radius * normal.getZ(vertex),
    );
  }
  return geometry;
}

/** Flat numbers x, y, z, x, ... as vectors. */
function vectors(numbers) {
  const found = [];
  for (let i = 0; i + 2 < numbers.length; i += 3) found.push(new Vector3(numbers[i], numbers[i + 1], numbers[i + 2]));
  return found;
}

function material(colour, opacity = 1) {
  return new MeshPhongMaterial({
    color: colour, specular: "#333333", shininess: 25, side: DoubleSide,
    opacity, transparent: opacity < 1, depthWrite: opacity === 1,
  });
}

/** A letter that always faces the reader. */
function letter(text, colour, size) {
  const canvas = document.createElement("canvas");
  canvas.width = canvas.height = 64;
  const pen = canvas.getContext("2d");
  Object.assign(pen, { font: "italic 52px serif", textAlign: "center", textBaseline: "middle", fillStyle: colour });
  pen.fillText(text, 32, 32);
  const map = new CanvasTexture(canvas);
  map.colorSpace = SRGBColorSpace;
  const sprite = new Sprite(new SpriteMaterial({ map, depthWrite: false }));
  sprite.scale.setScalar(size);
  return sprite;
}

/** Free what the graphics card holds of everything below `group`, and empty it. */
function clear(group) {
  group.traverse((part) => {
    part.geometry?.dispose();
    part.material?.map?.dispose();
    part.material?.dispose();
  });
  group.clear();
}

/** Side of a square of the floor [mm]: a round number, such that at most sixteen fit across. */
function gridStep(reach) {
  const least = reach / 8;
  const power = 10 ** Math.floor(Math.log10(least));
  return power * [1, 2, 5, 10].find((factor) => factor * power >= least);
}

/**
 * Prepare a canvas; returns null where the browser has no WebGL.
 *
 * `box` holds two corners around everything that will be drawn, `radius` is that of the body [mm].
 */
function createScene(canvas, { box, radius, widest = Infinity, zoom = 1 }, palette) {
  const context = canvas.getContext("webgl2", { alpha: true, antialias: true });
  if (!context) return null;
  const renderer = new WebGLRenderer({ canvas, context, alpha: true, antialias: true });
  renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
  const scene = new Scene();
  const camera = new PerspectiveCamera(FIELD_OF_VIEW_DEG, 1, 1, 1e5);
  camera.up.set(0, 0, 1);
  const lamp = new DirectionalLight("#ffffff", 1.6);
  camera.add(lamp);
  scene.add(camera, new HemisphereLight("#ffffff", "#999999", 2.2));
  const floor = new Group();
  const robot = new Group();
  scene.add(floor, robot);

  const [low, high] = box.map((corner) => new Vector3(...corner));
  const centre = low.clone().add(high).divideScalar(2);
  const reach = Math.max(...[low.x, low.y, high.x, high.y].map(Math.abs));
  const step = gridStep(reach);
  const half = step * Math.ceil(reach / step);
  const corners = [[half, half, 0], [half, -half, 0], [-half, half, 0], [-half, -half, 0]];
  for (const x of [low.x, high.x]) for (const y of [low.y, high.y]) corners.push([x, y, low.z], [x, y, high.z]);
  const axisHeight = Math.max(1.08 * high.z, 0.4 * half); // also of an arm that hangs
  const size = Math.max(radius, low.distanceTo(high) / 35); // parts of a slender robot are drawn larger than it is
  const controls = new OrbitControls(camera, canvas);
  canvas.style.touchAction = "pan-y"; // a finger that moves up or down scrolls the page, as elsewhere
  controls.enablePan = false;
  controls.enableZoom = false; // the wheel scrolls the page until the reader has chosen the picture
  let turned = false;
  const render = () => renderer.render(scene, camera);
  controls.addEventListener("start", () => { turned = true; });
  controls.addEventListener("change", render);

  /** How far away the eye must be for the floor and the box above it to be in the picture. */
  function distanceOf(direction) {
    const up = Math.tan((FIELD_OF_VIEW_DEG * Math.PI) / 360) / MARGIN;
    const right = new Vector3().crossVectors(camera.up, direction).normalize();
    const above = new Vector3().crossVectors(direction, right);
    let distance = 0;
    for (const [x, y, z] of corners) {
      const corner = new Vector3(x, y, z).sub(centre);
      const needed = Math.max(Math.abs(corner.dot(right)) / (up * camera.aspect), Math.abs(corner.dot(above)) / up);
      distance = Math.max(distance, needed + corner.dot(direction));
    }
    return distance;
  }

  function resetView() {
    const distance = distanceOf(FIRST_VIEW) / zoom;
    controls.target.copy(centre);
    camera.position.copy(FIRST_VIEW).multiplyScalar(distance).add(centre);
    camera.near = distance / 100;
    camera.far = distance * 20;
    camera.updateProjectionMatrix();
    controls.update();
    turned = false;
    render();
  }

  /** Turn the view by angles [rad], and bring the eye nearer by a factor. */
  function move(sideways, upwards, factor = 1) {
    // Spherical measures from y: seen from the eye, our z is its y
    const eye = camera.position.clone().sub(controls.target);
    const place = new Spherical().setFromCartesianCoords(eye.x, eye.z, -eye.y);
    place.theta += sideways;
    place.phi = Math.min(Math.max(place.phi - upwards, 0.02), Math.PI - 0.02);
    place.radius *= factor;
    const moved = new Vector3().setFromSpherical(place);
    camera.position.set(moved.x, -moved.z, moved.y).add(controls.target);
    turned = true;
    controls.update();
    render();
  }

  function drawFloor() {
    clear(floor);
    const grid = new GridHelper(2 * half, (2 * half) / step, palette.axes, palette.grid);
    grid.rotation.x = Math.PI / 2;
    floor.add(grid);
    const length = half * 1.08;
    for (const [name, end] of [["x", [length, 0, 0]], ["y", [0, length, 0]], ["z", [0, 0, axisHeight]]]) {
      const tip = new Vector3(...end);
      const line = new BufferGeometry().setFromPoints([new Vector3(), tip]);
      const text = letter(name, palette.axes, low.distanceTo(high) * 0.055);
      text.position.copy(tip).multiplyScalar(1.06);
      floor.add(new Line(line, new LineBasicMaterial({ color: palette.axes })), text);
    }
  }

  /** Copies of small parts along y, one for each point, turned into its direction. */
  function addMarkers({ points, directions }, parts, colour) {
    const places = vectors(points);
    const axes = vectors(directions);
    const paint = material(colour);
    places.forEach((place, i) => {
      const marker = new Group();
      for (const part of parts) marker.add(new Mesh(part, paint));
      marker.position.copy(place);
      marker.quaternion.setFromUnitVectors(Y, axes[i].normalize());
      robot.add(marker);
    });
  }

  const arrow = [
    new CylinderGeometry(0.045 * size, 0.045 * size, 0.7 * size, 8).translate(0, 0.35 * size, 0),
    new ConeGeometry(0.13 * size, 0.35 * size, 12).translate(0, 0.85 * size, 0),
    new SphereGeometry(0.1 * size, 12, 8),
  ];
  const cylinder = [new CylinderGeometry(0.5 * size, 0.5 * size, 0.27 * size, 28)];

  /** Draw a frame: `shapes` with `role`, `points` and perhaps `deviation`, then `magnets`, `sensors` and `suspects`. */
  function draw(frame) {
    clear(robot);
    frame.shapes.forEach(({ role, points, deviation }, i) => {
      // Of two, the first is a wide glass tube: a good estimate is seen inside it, a bad one leaves it
      const glass = i === 0 && frame.shapes.length > 1;
      const thickness = size * (glass ? 0.16 : 0.08);
      const paint = material(palette[role], glass ? 0.35 : 1);
      const tip = new Mesh(new SphereGeometry(1.5 * thickness, 16, 12), paint);
      tip.position.fromArray(points, points.length - 3);
      robot.add(new Mesh(tube(points, thickness), paint), tip);
      if (i === 0) robot.add(new Mesh(tube(points, radius), material(palette.body, 0.2)));
      if (deviation) {
        const around = Array.from(deviation, (sigma) => Math.min(2 * sigma, widest));
        robot.add(new Mesh(tube(points, around), material(palette.deviation, 0.4)));
      }
    });
    if (frame.magnets) addMarkers(frame.magnets, cylinder, palette.magnets);
    if (frame.sensors) addMarkers(frame.sensors, arrow, palette.sensors);
    for (const k of frame.suspects ?? []) {
      const ball = new Mesh(new SphereGeometry(0.6 * size, 20, 14), material(palette.suspects, 0.6));
      ball.position.fromArray(frame.sensors.points, 3 * k);
      robot.add(ball);
    }
    render();
  }

  function setPalette(next) {
    palette = next;
    drawFloor();
  }

  function resize(width, height) {
    renderer.setSize(width, height, false);
    camera.aspect = width / height;
    camera.updateProjectionMatrix();
    if (turned) render();
    else resetView();
  }

  function dispose() {
    controls.dispose();
    clear(scene);
    renderer.dispose();
    renderer.forceContextLoss();
  }

  drawFloor();
  return { draw, setPalette, resize, resetView, move, step, dispose, zoomByWheel: (on) => { controls.enableZoom = on; } };
}

// ---- what is around it

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
    suspects: data.suspects?.frames?.[i],
  });
}

/** A new element with attributes and content. */
function make(name, attributes = {}, ...content) {
  const element = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  element.append(...content);
  return element;
}

/** A number as a reader wants it: three digits, a real minus sign, a dash where there is none. */
function shown(value) {
  if (value === null || value === undefined) return "–";
  return String(Number(value.toPrecision(3))).replace("-", "−");
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
    scene.draw(frame);
    element.dispatchEvent(new CustomEvent("frame", { detail: current }));
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

  const forgetTheme = onThemeChange(paint);
  if (frameAt) setFrame(data.start ?? 0);
  paint();
  resizing.observe(view);

  return {
    setFrame(i) {
      pause();
      setFrame(i);
    },
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
