/* What all live figures share: canvas and camera, controls, handles, the state in the address, a summary in words.
   A figure is redrawn when its state changes, and never moves by itself. */
(function () {
"use strict";
const { dot } = REPRO.algebra;
const still = matchMedia("(prefers-reduced-motion: reduce)");

function element(tag, attributes, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes || {})) {
    if (name === "text") made.textContent = value;
    else if (name.startsWith("on")) made.addEventListener(name.slice(2), value);
    else if (value === true) made.setAttribute(name, "");
    else if (value !== false && value != null) made.setAttribute(name, value);
  }
  made.append(...children.filter((child) => child != null));
  return made;
}

/** A number with that many digits. */
const short = (x, digits = 2) => (Number.isFinite(x) ? String(Number(x.toPrecision(digits))) : "–");

/** Normal random numbers of a seed: always the same (mulberry32, then Box and Muller). */
function randomOf(seed) {
  let a = (seed * 2654435761) >>> 0;
  const uniform = () => {
    a = (a + 0x6d2b79f5) >>> 0;
    let t = Math.imul(a ^ (a >>> 15), 1 | a);
    t = (t + Math.imul(t ^ (t >>> 7), 61 | t)) ^ t;
    return ((t ^ (t >>> 14)) >>> 0) / 4294967296;
  };
  const normal = () => Math.sqrt(-2 * Math.log(1 - uniform())) * Math.cos(2 * Math.PI * uniform());
  return { uniform, normal };
}

/** State of a figure in the address: `#magnets=segments:2,noise:0.01`, what differs from the defaults only. */
function stateOf(name, defaults) {
  const state = { ...defaults }, found = new RegExp("^#" + name + "=(.*)$").exec(location.hash);
  for (const part of found ? found[1].split(",") : []) {
    const [key, value] = part.split(":");
    if (!(key in defaults) || value === undefined) continue;
    if (typeof defaults[key] === "number") state[key] = Number.isFinite(Number(value)) ? Number(value) : defaults[key];
    else if (typeof defaults[key] === "boolean") state[key] = value === "true";
    else if (/^[\w .;-]*$/.test(value)) state[key] = value;
  }
  return { state, given: Boolean(found) };
}

class Figure {
  /** `view` = {name, alt, defaults, draw(figure), summary(figure), changed(figure, changes)}; what a box held
      without scripts is replaced. */
  constructor(box, view) {
    this.box = box;
    this.view = view;
    const { state, given } = stateOf(view.name, view.defaults);
    this.state = state;
    this.controls = {};
    this.canvas = element("canvas", { role: "img", "aria-label": view.alt });
    this.context = this.canvas.getContext("2d");
    this.names = element("ul", { class: "live-legend" });
    this.stage = element("div", { class: "live-stage" }, this.canvas, this.names);
    this.text = element("p", { class: "live-text", role: "status" });
    this.side = element("div", { class: "live-controls", role: "group", "aria-label": "Controls of the figure" });
    this.below = element("div", { class: "live-below" });
    box.replaceChildren(element("div", { class: "live-frame" }, this.stage, this.text, this.below, this.side));
    this.dirty = true;
    new ResizeObserver(() => this.resize()).observe(this.stage);
    new MutationObserver(() => this.recolour()).observe(document.documentElement, { attributeFilter: ["data-theme"] });
    addEventListener("hashchange", () => {
      const now = stateOf(view.name, view.defaults);
      if (now.given) this.set(now.state);
    });
    box.live = this;
    if (given) requestAnimationFrame(() => box.scrollIntoView({ block: "center" }));
  }

  /** Once all controls are made: the first frame. */
  start() {
    this.recolour();
    this.resize();
    this.draw();
    this.settle();
  }

  recolour() {
    const style = getComputedStyle(this.box), known = {}; // asked once: a drawing needs a hundred
    this.colour = (role) => (known[role] ??= style.getPropertyValue("--live-" + role).trim());
    this.redraw();
  }

  resize() {
    const { clientWidth: width, clientHeight: height } = this.stage;
    if (!width) return;
    Object.assign(this, { width, height });
    this.fit(this.canvas);
    if (this.progress) this.fit(this.progress);
    this.redraw();
  }

  /** As many points in a canvas as the screen has for it; its size is measured here only, and not while drawing. */
  fit(canvas) {
    const ratio = Math.min(devicePixelRatio || 1, 2), { clientWidth: width, clientHeight: height } = canvas;
    Object.assign(canvas, { width: Math.round(width * ratio), height: Math.round(height * ratio), extent: [width, height] });
    Object.assign(canvas.getContext("2d"), { written: "" }).setTransform(ratio, 0, 0, ratio, 0, 0);
  }

  /** Change the state; controls follow, the address and the summary a moment later. */
  set(changes) {
    Object.assign(this.state, changes);
    for (const key of Object.keys(changes)) this.controls[key]?.show(this.state[key]);
    if (this.view.changed) this.view.changed(this, changes);
    this.redraw();
    clearTimeout(this.later);
    this.later = setTimeout(() => this.settle(), 250);
  }

  settle() {
    this.speak();
    const differs = Object.keys(this.view.defaults).filter((key) => this.state[key] !== this.view.defaults[key]);
    const hash = "#" + this.view.name + "=" + differs.map((key) => key + ":" + this.state[key]).join(",");
    if (differs.length || location.hash.startsWith("#" + this.view.name)) history.replaceState(null, "", hash);
  }

  speak() {
    this.spoken = performance.now();
    this.text.textContent = this.view.summary(this);
  }

  redraw() {
    if (this.dirty) return;
    this.dirty = true;
    requestAnimationFrame(() => this.draw());
  }

  draw() {
    this.dirty = false;
    this.context.clearRect(0, 0, this.width, this.height);
    this.view.draw(this);
    if (this.playing && performance.now() - this.spoken > 500) this.speak(); // what has moved on since
  }

  // ---- The camera: parallel projection, z upwards ------------------------------------------------------------------

  /** Look at `centre` [m] from an azimuth and a height [deg], `reach` metres from it in sight. */
  look(azimuth, height, centre, reach) {
    const a = azimuth * Math.PI / 180, h = height * Math.PI / 180;
    this.right = [-Math.sin(a), Math.cos(a), 0];
    this.up = [-Math.cos(a) * Math.sin(h), -Math.sin(a) * Math.sin(h), Math.cos(h)];
    this.towards = [Math.cos(a) * Math.cos(h), Math.sin(a) * Math.cos(h), Math.sin(h)];
    this.centre = [dot(centre, this.right), dot(centre, this.up)];
    this.scale = Math.min(this.width, this.height) / (2 * reach);
  }

  at(p) {
    return [
      this.width / 2 + this.scale * (dot(p, this.right) - this.centre[0]),
      this.height / 2 - this.scale * (dot(p, this.up) - this.centre[1]),
    ];
  }

  /** Displacement in space of one in pixels, in the plane of the screen. */
  moved(dx, dy) {
    return [0, 1, 2].map((k) => (dx * this.right[k] - dy * this.up[k]) / this.scale);
  }

  line(points, role, width, { alpha = 1, dash = [], flat = false } = {}) {
    const c = this.context;
    c.beginPath();
    for (const p of points) c.lineTo(...(flat ? p : this.at(p)));
    Object.assign(c, { strokeStyle: this.colour(role), lineWidth: width, globalAlpha: alpha, lineCap: "round", lineJoin: "round" });
    c.setLineDash(dash);
    c.stroke();
    c.setLineDash([]);
    c.globalAlpha = 1;
  }

  dot(point, role, radius, { alpha = 1, flat = false, hollow = false } = {}) {
    const c = this.context, [x, y] = flat ? point : this.at(point);
    c.globalAlpha = alpha;
    c.beginPath();
    c.arc(x, y, radius, 0, 7);
    if (hollow) Object.assign(c, { strokeStyle: this.colour(role), lineWidth: 2 }).stroke();
    else Object.assign(c, { fillStyle: this.colour(role) }).fill();
    c.globalAlpha = 1;
  }

  /** Circle in space about an axis. */
  circle(centre, axis, radius) {
    const side = Math.abs(axis[2]) < 0.9 ? [0, 0, 1] : [1, 0, 0], x = REPRO.algebra.cross(axis, side);
    const size = Math.hypot(...x), y = REPRO.algebra.cross(axis, x);
    return Array.from({ length: 25 }, (_, k) => [0, 1, 2].map((i) => centre[i]
      + radius / size * (Math.cos(k * Math.PI / 12) * x[i] + Math.sin(k * Math.PI / 12) * y[i])));
  }

  words(text, x, y, { align = "left", role = "text", size = 13 } = {}) {
    const c = this.context, font = size + "px system-ui, sans-serif";
    if (c.written !== font) c.font = c.written = font; // setting a font takes longer than writing
    Object.assign(c, { textAlign: align, textBaseline: "middle", fillStyle: this.colour(role) });
    c.fillText(text, x, y);
  }

  /** Names of what is drawn, [[role, words], ...]: text beside the canvas, in which text takes long to draw. */
  legend(entries) {
    if (this.named === String(entries)) return;
    this.named = String(entries);
    this.names.replaceChildren(...entries.map(([role, text]) => element("li", { style: `--role: var(--live-${role})`, text })));
  }

  /** Curves {role: values} on a logarithmic scale from 10^low to 10^high, over as many steps; returns a value's height. */
  plot([left, top, right, bottom], [low, high], steps, curves, caption) {
    const y = (x) => top + (bottom - top) * (high - REPRO.algebra.clamp(Math.log10(x), low, high)) / (high - low);
    for (let d = low; d <= high; d++) {
      this.line([[left, y(10 ** d)], [right, y(10 ** d)]], "faint", 1, { flat: true });
      if ((d - low) % 2 === 0) this.words(String(Number((10 ** d).toFixed(3))), left - 6, y(10 ** d), { align: "right", size: 12 });
    }
    this.words(caption, (left + right) / 2, bottom + 16, { align: "center", size: 12 });
    for (const [role, values] of Object.entries(curves)) {
      this.line(values.map((x, k) => [left + (right - left) * k / Math.max(steps - 1, 1), y(x)]), role, 2, { flat: true });
    }
    return y;
  }

  // ---- Controls ----------------------------------------------------------------------------------------------------

  group(title, ...children) {
    this.side.append(element("fieldset", {}, element("legend", { text: title }), ...children));
  }

  /** A control beside its name. */
  field(key, label, input, ...more) {
    input.id = `live-${this.view.name}-${key}`;
    return element("div", { class: "live-field" }, element("label", { for: input.id, text: label }), input, ...more);
  }

  /** A slider; `values` names the values it can take where these are not even, `show` writes one. */
  slider(key, label, { min = 0, max, step = 1, values, show = String, change } = {}) {
    const input = element("input", { type: "range", min: values ? 0 : min, max: values ? values.length - 1 : max, step: values ? 1 : step });
    const output = element("output"), given = () => (values ? values[Number(input.value)] : Number(input.value));
    const here = (value) => {
      const kept = values ? values.reduce((best, x, k) => (Math.abs(x - value) < Math.abs(values[best] - value) ? k : best), 0) : value;
      input.value = kept;
      output.textContent = show(given());
      input.setAttribute("aria-valuetext", output.textContent);
    };
    input.addEventListener("input", () => {
      if (change) change(given());
      else this.set({ [key]: given() });
      here(given());
    });
    this.controls[key] = { show: here, input };
    here(this.state[key] ?? 0);
    return this.field(key, label, input, output);
  }

  choice(key, label, options) {
    const select = element("select", { onchange: () => this.set({ [key]: typeof this.view.defaults[key] === "number" ? Number(select.value) : select.value }) });
    for (const [value, words] of options) select.append(element("option", { value, text: words }));
    this.controls[key] = { show: (value) => { select.value = value; }, input: select };
    if (!options.some(([value]) => value === this.state[key])) this.state[key] = this.view.defaults[key];
    select.value = this.state[key];
    return this.field(key, label, select);
  }

  check(key, label) {
    const input = element("input", { type: "checkbox", onchange: () => this.set({ [key]: input.checked }) });
    this.controls[key] = { show: (value) => { input.checked = value; }, input };
    input.checked = this.state[key];
    return this.field(key, label, input);
  }

  button(label, act) {
    return element("button", { type: "button", text: label, onclick: act });
  }

  /** A button that runs `step(frames)` once a frame until pressed again; a single, longer step where motion is unwanted. */
  player(label, step) {
    let running = false, seen = 0;
    const made = this.button(label, () => {
      if (still.matches) { step(20); return; }
      running = !running;
      seen = performance.now();
      if (running) requestAnimationFrame(next);
      made.textContent = running ? "Pause" : label;
      made.setAttribute("aria-pressed", running);
      this.text.setAttribute("aria-live", running ? "off" : "polite");
      this.playing = running;
    });
    const next = (now) => {
      if (!running || !this.box.isConnected) return;
      step(Math.min((now - seen) / 25, 4)); // 40 steps a second, as the paper's courses
      seen = now;
      requestAnimationFrame(next);
    };
    made.setAttribute("aria-pressed", "false");
    return made;
  }

  /** A thing on the stage that can be dragged, or moved by the arrow keys: move(dx, dy) in pixels. */
  handle(label, move) {
    const made = element("button", { type: "button", class: "live-handle", "aria-label": label, title: label });
    let last = null;
    made.addEventListener("pointerdown", (event) => {
      made.setPointerCapture(event.pointerId);
      last = [event.clientX, event.clientY];
    });
    made.addEventListener("pointermove", (event) => {
      if (!last) return;
      move(event.clientX - last[0], event.clientY - last[1]);
      last = [event.clientX, event.clientY];
    });
    for (const end of ["pointerup", "pointercancel"]) made.addEventListener(end, () => { last = null; });
    made.addEventListener("keydown", (event) => {
      const way = { ArrowLeft: [-6, 0], ArrowRight: [6, 0], ArrowUp: [0, -6], ArrowDown: [0, 6] }[event.key];
      if (way) move(...way);
      if (way) event.preventDefault();
    });
    this.stage.append(made);
    return { place: ([x, y]) => { made.style.transform = `translate(${x}px, ${y}px)`; } };
  }

  /** Turn the view by dragging the stage sideways, or by the slider that this returns. */
  turning(key = "view") {
    let from = null;
    this.canvas.addEventListener("pointerdown", (event) => {
      from = event.clientX;
      this.canvas.setPointerCapture(event.pointerId);
    });
    this.canvas.addEventListener("pointermove", (event) => {
      if (from === null) return;
      this.set({ [key]: (Math.round(this.state[key] - (event.clientX - from) / 2) + 720) % 360 });
      from = event.clientX;
    });
    for (const end of ["pointerup", "pointercancel"]) this.canvas.addEventListener(end, () => { from = null; });
    return this.slider(key, "Turn the view", { min: 0, max: 359, show: (x) => x + "°" });
  }
}

function startAll() {
  for (const box of document.querySelectorAll(".live-figure")) REPRO.views[box.dataset.live](box);
}

Object.assign(REPRO, { Figure, element, short, randomOf });
if (document.readyState === "complete") startAll();
else addEventListener("DOMContentLoaded", startAll);
})();
