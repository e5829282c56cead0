/* Shape from magnets, live: the robot of Baaij et al. 2023, what its sensors read, and the shape that is found from it. */
(function () {
"use strict";
const { algebra, element, short, randomOf, Figure } = REPRO;
const { plus, clamp, solve, eigen, zeros } = algebra;

const LENGTH = 0.11, RADIUS = 0.022, BEND = 0.022 * 54 * Math.PI / 180, STRETCH = 6.6e-3, RING = [0.024, 0.012, 0.006, 1450];
const MOMENTS = REPRO.ringMoments(...RING, 9);
const STEPS = { 1: [3.5e-4, 3.5e-4], 2: [3e-3, 3e-4], 3: [2e-3, 2e-4] }; // section 3.3, bending and elongation
const POSES = 40;

const DEFAULTS = {
  segments: 3, sensors: 3, radial: 13, tilt: 0, noise: 7.1e-4, seed: 1, off: "", tolerances: false, calibrated: false,
  method: "lm", evaluations: 20, start: "last", from: "", course: 60, q: "", field: true, view: 300, moved: 3,
};

// ---- The robot, as drawn and as it is ------------------------------------------------------------------------------

/** A robot whose parts are off by `x`, in units of the tolerances: {body, moments, gains}. */
function build(state, x) {
  const { segments, sensors } = state, tilt = state.tilt * Math.PI / 180, magnets = [], places = [], gains = [];
  let k = 0;
  const next = (size) => (x ? size * x[k++] : 0);
  for (let i = 0; i < segments; i++) {
    const position = [next(5e-4), next(5e-4), next(5e-4)], lean = [next(Math.PI / 90), next(Math.PI / 90)];
    const size = Math.hypot(lean[0], lean[1], 1);
    magnets.push({ segment: i, axial: LENGTH / 2, position, axis: [lean[0] / size, lean[1] / size, 1 / size] });
  }
  for (let i = 0; i < segments; i++) for (let s = 0; s < sensors; s++) {
    const azimuth = 2 * Math.PI * (s / sensors + next(0.01)), r = state.radial / 1e3 * (1 + next(0.01)), psi = tilt + next(Math.PI / 180);
    const c = Math.cos(azimuth), d = Math.sin(azimuth);
    places.push({ segment: i, axial: LENGTH, position: [r * c, r * d, 0], axis: [-Math.sin(psi) * c, -Math.sin(psi) * d, -Math.cos(psi)] });
    gains.push(1 + next(0.01));
  }
  const moments = MOMENTS.map((A) => A * (1 + next(0.02)));
  return { body: REPRO.robot(segments, LENGTH, RADIUS, magnets, places), moments, gains, parameters: k };
}

const sensingOf = ({ body, moments, gains }) => REPRO.magneticSensing(body, moments, gains);
const count = ({ segments, sensors }) => 5 * segments + 4 * segments * sensors + MOMENTS.length;

/** Parts found from readings in poses that are known: least squares with the tolerances as prior, slopes by differences. */
function calibrate(state, truth) {
  const random = randomOf(state.seed + 100), read = sensingOf(truth), n = count(state), noise = Math.max(state.noise, 7.1e-4);
  const poses = Array.from({ length: POSES }, () => box(state.segments).low.map((low, c) => low + random.uniform() * (box(state.segments).high[c] - low)));
  const measured = poses.flatMap((q) => [...read(q, false).u].map((u) => u + noise * random.normal()));
  const predicted = (x) => { const sensing = sensingOf(build(state, x)); return poses.flatMap((q) => [...sensing(q, false).u]); };
  let x = Array(n).fill(0);
  for (let turn = 0; turn < 2; turn++) {
    const at = predicted(x), A = zeros(n, n), g = x.map((value) => -value * noise * noise), h = 1e-3;
    const slopes = x.map((_, k) => predicted(x.map((value, i) => value + (i === k ? h : 0))).map((u, r) => (u - at[r]) / h));
    for (let i = 0; i < n; i++) {
      at.forEach((u, r) => { g[i] += slopes[i][r] * (measured[r] - u); });
      for (let k = 0; k <= i; k++) A[i][k] = A[k][i] = at.reduce((total, _, r) => total + slopes[i][r] * slopes[k][r], 0);
      A[i][i] += noise * noise;
    }
    const step = solve(A, g);
    x = x.map((value, k) => value + step[k]);
  }
  return build(state, x);
}

const box = (n) => ({
  low: Array.from({ length: 3 * n }, (_, c) => (c % 3 === 2 ? 0 : -BEND)),
  high: Array.from({ length: 3 * n }, (_, c) => (c % 3 === 2 ? STRETCH : BEND)),
});
const straight = (n) => Array.from({ length: 3 * n }, (_, c) => (c % 3 === 2 ? 2.75e-3 : 0));

/** The course T3, a lemniscate of every segment, at step 0 to 399. */
function lemniscate(n, step) {
  const s = step / 399, D = 0.022 * Math.PI / 4, turn = 2 * Math.PI;
  return Array.from({ length: 3 * n }, (_, c) => {
    const p = turn * Math.floor(c / 3) / n;
    return [D * Math.sin(2 * turn * s + p), D * Math.sin(turn * s + p), 2.75e-3 * (1 + Math.sin(turn * s + p))][c % 3];
  });
}

// ---- From a state to readings and estimates ------------------------------------------------------------------------

const parsed = (text, n) => {
  const q = text.split(";").map((x) => Number(x) / 1e3);
  return text && q.length === 3 * n && q.every(Number.isFinite) ? q.map((x, c) => clamp(x, box(n).low[c], box(n).high[c])) : null;
};

/** Where both estimates began, the momentum of the descent too, as the address keeps it: a link shows the same estimates. */
const inAddress = (began) => [...began.lm, ...began.descent, ...began.momentum].map((x) => x.toPrecision(8).replace("+", "")).join(";");
const fromAddress = (text, n) => {
  const x = text.split(";").map(Number), part = (k) => x.slice(3 * n * k, 3 * n * (k + 1));
  return x.length === 9 * n && x.every(Number.isFinite) ? { lm: part(0), descent: part(1), momentum: part(2) } : null;
};
const truthOf = (state) => parsed(state.q, state.segments) || lemniscate(state.segments, state.course);

/** What does not change while the robot moves: the robot as it is, and the model that the estimators have. */
function parts(figure) {
  const { state } = figure, key = [state.segments, state.sensors, state.radial, state.tilt, state.seed, state.tolerances].join();
  if (figure.key !== key) {
    const random = randomOf(state.seed);
    figure.key = key;
    figure.drawn = build(state);
    figure.real = state.tolerances ? build(state, Array.from({ length: count(state) }, () => random.normal())) : figure.drawn;
    figure.estimate = null;
  }
  const wanted = state.tolerances && state.calibrated ? key + state.noise : "";
  if (wanted && figure.calibratedFor !== wanted) {
    clearTimeout(figure.calibrating); // not while a slider is moving
    figure.calibrating = setTimeout(() => {
      figure.found = calibrate(state, figure.real);
      figure.calibratedFor = wanted;
      figure.set({});
    }, 150);
  }
  figure.waiting = Boolean(wanted) && figure.calibratedFor !== wanted;
  return wanted && !figure.waiting ? figure.found : figure.drawn;
}

function compute(figure) {
  const { state } = figure, model = parts(figure), n = state.segments, q = truthOf(state);
  const random = randomOf(state.seed * 1000 + (state.q ? 0 : Math.floor(state.course)));
  const off = new Set(state.off.split(";").map(Number)), n_s = n * state.sensors;
  let use = Array.from({ length: n_s }, (_, s) => !off.has(s + 1));
  if (!use.some(Boolean)) use = use.map((_, s) => s === 0);
  const u = [...sensingOf(figure.real)(q, false).u].map((x) => x + state.noise * random.normal());
  const sensing = sensingOf(model), { low, high } = box(n), evaluations = state.evaluations;
  const before = figure.estimate, asked = [figure.key, state.start, model === figure.drawn, evaluations, use, u].join();
  const linked = state.from !== figure.from; // by the address
  if (linked || !before || before.asked !== asked) { // the same question, as when the view is turned, is answered once
    // as the paper does it: at first from the true shape, then from the estimate before
    const warm = state.start === "last", from = warm ? q : straight(n), steps = q.map((_, c) => STEPS[n][c % 3 === 2 ? 1 : 0]);
    const last = warm && (linked ? fromAddress(state.from, n) : before && { lm: before.lm.q, descent: before.descent.q, momentum: before.descent.momentum });
    const began = last || { lm: from, descent: from, momentum: from.map(() => 0) };
    const lm = REPRO.levenbergMarquardt(sensing, began.lm, u, use, low, high, evaluations - 1);
    const descending = (x, momentum) => REPRO.gradientDescent(sensing, x, momentum, u, use, steps, 0.3, evaluations);
    const descent = descending(began.descent, began.momentum);
    const cold = warm && !last ? descending(straight(n), from.map(() => 0)) : null; // what the true start is worth
    figure.estimate = { lm, descent, cold, asked };
    if (!(linked && figure.waiting)) figure.from = state.from = last ? inAddress(last) : "";
  }
  const { lm, descent, cold } = figure.estimate;
  const tip = REPRO.tip(model.body, q).p;
  const off_mm = (x) => 1e3 * Math.hypot(...plus(REPRO.tip(model.body, x).p, tip, -1));
  return { q, u, use, sensing, model, lm, descent, cold, chosen: state.method === "lm" ? lm : descent, off_mm, tip };
}

/** Shapes along the direction that the readings say least about, as far as they read alike; none where all is known. */
function ghosts({ sensing, use, lm }, state) {
  const n = state.segments, { low, high } = box(n), scale = low.map((x, c) => (high[c] - x) / 2);
  const weakest = (q) => {
    const { values, vectors } = REPRO.information(sensing(q).J, use, scale);
    return { spread: Math.max(state.noise, 1e-6) / Math.sqrt(Math.max(values[0], 1e-30)), v: vectors[0] };
  };
  const first = weakest(lm.q), shapes = [];
  if (first.spread < 0.3) return { shapes, spread: first.spread };
  for (const side of [-1, 1]) {
    let q = [...lm.q], v = first.v.map((x) => side * x);
    for (let k = 0; k < 12; k++) {
      q = q.map((x, c) => x + 0.08 * v[c] * scale[c]);
      if (q.some((x, c) => x < low[c] || x > high[c])) break;
      if (k % 3 === 2) shapes.push(q);
      const { v: next } = weakest(q), sign = Math.sign(next.reduce((total, x, c) => total + x * v[c], 0));
      v = next.map((x) => sign * x);
    }
  }
  return { shapes, spread: first.spread };
}

// ---- Drawing -------------------------------------------------------------------------------------------------------

function drawField(figure, magnets) {
  for (const magnet of magnets) {
    const across = algebra.cross(magnet.axis, figure.towards), size = Math.hypot(...across) || 1;
    for (const distance of [0.025, 0.04, 0.065]) for (const side of [-1, 1]) for (const way of [-1, 1]) {
      let p = plus(magnet.position, across, side * distance / size);
      const points = [p];
      for (let k = 0; k < 44; k++) {
        const B = REPRO.fieldAt(magnets, MOMENTS, p), middle = plus(p, B, way * 0.003 / Math.hypot(...B));
        const at = REPRO.fieldAt(magnets, MOMENTS, middle);
        p = plus(p, at, way * 0.006 / Math.hypot(...at));
        if (magnets.some((one) => Math.hypot(...plus(p, one.position, -1)) < 0.013)) break;
        points.push(p);
      }
      figure.line(points, "field", 1, { alpha: 0.8 });
    }
  }
}

function drawEllipsoid(figure, { lm, use, model }, noise) {
  const { p, J } = REPRO.tip(model.body, lm.q), C = REPRO.covariance(lm.J, use, noise), axes = [figure.right, figure.up];
  const S = axes.map((a) => axes.map((b) => {
    const left = J[0].map((_, c) => a[0] * J[0][c] + a[1] * J[1][c] + a[2] * J[2][c]);
    const right = J[0].map((_, c) => b[0] * J[0][c] + b[1] * J[1][c] + b[2] * J[2][c]);
    return left.reduce((total, x, c) => total + x * C[c].reduce((sum, y, k) => sum + y * right[k], 0), 0);
  }));
  const { values, vectors } = eigen(S), radii = values.map((x) => 2.8 * Math.sqrt(Math.max(x, 0))); // 95 % of a normal in space
  const larger = [1, 3, 10, 30, 100, 300, 1000].find((factor) => radii[1] * factor * figure.scale > 24) || 1000;
  const [x, y] = figure.at(p), points = [];
  for (let k = 0; k <= 40; k++) {
    const a = 2 * Math.PI * k / 40, [s, t] = [Math.cos(a) * radii[0], Math.sin(a) * radii[1]].map((r) => Math.min(r * larger, 0.2) * figure.scale);
    points.push([x + s * vectors[0][0] + t * vectors[1][0], y - s * vectors[0][1] - t * vectors[1][1]]);
  }
  figure.line(points, "estimate", 1.5, { flat: true });
  return { worst: Math.sqrt(Math.max(values[1], 0)) * 1e3, larger };
}

function draw(figure) {
  const { state } = figure, found = compute(figure), n = state.segments, { body } = found.model;
  figure.look(state.view, 16, [0, 0, n * LENGTH / 2 + 0.004], Math.max(n * LENGTH * 0.64, 0.095));
  figure.line(figure.circle([0, 0, 0], [0, 0, 1], 0.045), "faint", 1.5);
  const chain = REPRO.frames(figure.real.body, found.q), magnets = REPRO.placed(figure.real.body, found.q, chain, figure.real.body.magnets);
  const sensors = REPRO.placed(figure.real.body, found.q, chain, figure.real.body.sensors);
  if (state.field) drawField(figure, magnets);
  const points = REPRO.backbone(body, found.q, 12);
  figure.line(points, "body", 2 * RADIUS * figure.scale, { alpha: 0.16 });
  found.ghosts = ghosts(found, state);
  for (const q of found.ghosts.shapes) figure.line(REPRO.backbone(body, q, 8), "ghost", 3, { alpha: 0.5 });
  for (const magnet of magnets) for (const part of [2, 1]) figure.line(figure.circle(magnet.position, magnet.axis, 0.006 * part), "magnet", 2 * part);
  for (let i = 1; i <= n; i++) figure.line(figure.circle(chain.bases[i].p, chain.bases[i].R.map((row) => row[2]), RADIUS), "body", 1, { alpha: 0.5 });
  sensors.forEach((sensor, s) => {
    figure.dot(sensor.position, "sensor", 5, { hollow: !found.use[s] });
    if (found.use[s]) figure.line([sensor.position, plus(sensor.position, sensor.axis, 0.014)], "sensor", 2);
  });
  const other = state.method === "lm" ? "descent" : "lm", colour = { lm: "estimate", descent: "descent" };
  figure.line(REPRO.backbone(body, found[other].q, 12), colour[other], 11, { alpha: 0.5 }); // seen on both sides of the truth
  figure.line(points, "truth", 6);
  figure.line(REPRO.backbone(body, found.chosen.q, 12), colour[state.method], 3, { dash: [10, 7] });
  found.ellipsoid = state.method === "lm" && state.noise > 0 && found.ghosts.spread < 0.3 ? drawEllipsoid(figure, found, state.noise) : null;
  figure.tipHandle.place(figure.at(found.tip));
  const names = [["truth", "true shape"], ["estimate", "least squares"], ["descent", "gradient descent"]];
  if (figure.width > 420) names.push(["magnet", "ring magnets"], ["sensor", "sensors"]);
  if (found.ellipsoid) names.push(["estimate", "95 % of estimates" + (found.ellipsoid.larger > 1 ? `, ${found.ellipsoid.larger} × as large` : "")]);
  if (found.ghosts.shapes.length) names.push(["ghost", "shapes that read all but alike"]);
  figure.legend(names);
  figure.now = found;
  showReadings(figure, found);
  if (figure.progress) drawProgress(figure, found);
  showSliders(figure, found.q);
}

/** Error of the tip by iteration, of both methods, on a canvas of its own. */
function drawProgress(figure, found) {
  const [width, height] = figure.progress.extent, stage = figure.context, last = figure.state.evaluations - 1;
  const errors = (one) => one.trail.map(({ q }) => found.off_mm(q));
  figure.context = figure.progress.getContext("2d");
  figure.context.clearRect(0, 0, width, height);
  figure.plot([48, 10, width - 10, height - 28], [-3, 2], last + 1, { descent: errors(found.descent), estimate: errors(found.lm) }, `error of the tip [mm], step 0 to ${last}`);
  figure.context = stage;
}

// ---- Readings as bars that switch a sensor off, and sliders of the shape -----------------------------------------------

function makeReadings(figure) {
  const { state } = figure;
  figure.bars.replaceChildren();
  figure.bar = [];
  for (let i = 0; i < state.segments; i++) {
    const row = element("div", { class: "live-bars" });
    for (let s = 0; s < state.sensors; s++) {
      const k = i * state.sensors + s, bar = element("i"), mark = element("b"), value = element("span");
      const name = element("span", { class: "live-unseen", text: `Sensor ${s + 1} on segment ${i + 1}: ` });
      const button = element("button", { type: "button", onclick: () => toggle(figure, k + 1) }, element("span", { class: "live-bar" }, bar, mark), name, value);
      row.append(button);
      figure.bar.push({ button, bar, mark, value });
    }
    figure.bars.append(row);
  }
  figure.barsFor = state.segments + " " + state.sensors;
}

function toggle(figure, k) {
  const off = new Set(figure.state.off.split(";").filter(Boolean).map(Number)), all = figure.now.use.length;
  if (!off.delete(k) && off.size < all - 1) off.add(k);
  figure.set({ off: [...off].filter((s) => s <= all).sort((a, b) => a - b).join(";") });
}

function showReadings(figure, { u, use, chosen, sensing }) {
  if (!figure.bars) return;
  if (figure.barsFor !== figure.state.segments + " " + figure.state.sensors) makeReadings(figure);
  const predicted = chosen.u || sensing(chosen.q, false).u, largest = Math.max(...u.map(Math.abs), 1e-9);
  figure.bar.forEach(({ button, bar, mark, value }, s) => {
    bar.style.transform = `scaleX(${use[s] ? Math.abs(u[s]) / largest : 0})`;
    mark.style.left = clamp(100 * Math.abs(predicted[s]) / largest, 0, 99) + "%";
    value.textContent = use[s] ? u[s].toFixed(3) + " mT" : "off";
    if (button.getAttribute("aria-pressed") !== String(use[s])) button.setAttribute("aria-pressed", use[s]);
  });
}

function showSliders(figure, q) {
  if (figure.state.moved > figure.state.segments) {
    figure.state.moved = figure.state.segments;
    figure.controls.moved?.show(figure.state.moved);
  }
  ["bend_x", "bend_y", "stretch"].forEach((key, c) => figure.controls[key]?.show(Math.round(1e4 * q[3 * (figure.state.moved - 1) + c]) / 10));
}

const inText = (q) => q.map((x) => Math.round(1e5 * x) / 100).join(";");

/** Move the tip in the plane of the screen: a few damped steps, bending before stretching. */
function drag(figure, dx, dy) {
  const n = figure.state.segments, { low, high } = box(n), { body } = figure.drawn;
  let q = truthOf(figure.state);
  const target = plus(REPRO.tip(body, q).p, figure.moved(dx, dy)), weight = q.map((_, c) => (c % 3 === 2 ? 0.05 : 1));
  for (let turn = 0; turn < 4; turn++) {
    const { p, J } = REPRO.tip(body, q), A = J.map((a, i) => J.map((b, k) => a.reduce((sum, x, c) => sum + weight[c] * x * b[c], 0) + (i === k ? 1e-2 : 0)));
    const pull = solve(A, plus(target, p, -1));
    q = q.map((x, c) => clamp(x + weight[c] * (J[0][c] * pull[0] + J[1][c] * pull[1] + J[2][c] * pull[2]), low[c], high[c]));
  }
  figure.set({ q: inText(q) });
}

function summary(figure) {
  const { state, now } = figure, n = state.segments, on = now.use.filter(Boolean).length;
  const mm = (x) => (x < 1e-4 ? "less than 0.0001 mm" : short(x) + " mm");
  const words = [`${n} segment${n > 1 ? "s" : ""}, ${on} of ${now.use.length} sensors in use, synthetic readings ${state.noise > 0 ? "with" : "without"} noise.`];
  words.push(`Error of the tip after ${state.evaluations} evaluations: ${mm(now.off_mm(now.lm.q))} with least squares, ${mm(now.off_mm(now.descent.q))} with gradient descent.`);
  if (now.cold) words.push(`The descent started at the true shape and stays near its start, which hides its errors: from the straight pose it has ${mm(now.off_mm(now.cold.q))} after as many evaluations.`);
  if (now.ellipsoid) words.push(`With this noise no unbiased method has a standard deviation of the tip below about ${short(now.ellipsoid.worst)} mm in its worst direction.`);
  if (now.ghosts.shapes.length) words.push(`${now.ghosts.shapes.length} other shapes are drawn that these sensors cannot tell from the estimate: one direction is all but undetermined.`);
  if (figure.waiting) words.push("Calibration is being computed.");
  else if (state.tolerances) words.push(state.calibrated ? `The model is calibrated in ${POSES} known poses.` : "The parts are not where the drawing has them, and the model does not know it.");
  return words.join(" ");
}

REPRO.views.magnets = function (box_) {
  const figure = new Figure(box_, {
    name: "magnets", defaults: DEFAULTS, draw, summary,
    alt: "A soft robot with ring magnets and sensors: its true shape, and the shape that is found from the readings. The text below the figure says how far apart they are.",
    changed: (one, changes) => {
      if ("segments" in changes) Object.assign(one.state, { q: "", off: "" });
      if ("sensors" in changes) one.state.off = "";
    },
  });
  const { state } = figure, few = box_.dataset.controls === "few", mm = (x) => x.toFixed(1) + " mm", clip = (key, low, high) => { state[key] = clamp(Math.round(state[key]), low, high); };
  [["segments", 1, 3], ["sensors", 2, 6], ["evaluations", 2, 40], ["course", 0, 399]].forEach((limits) => clip(...limits));
  figure.tipHandle = figure.handle("Tip of the robot: drag it, or move it with the arrow keys", (dx, dy) => drag(figure, dx, dy));
  const shape = (c) => ({ change: (x) => figure.set({ q: inText(truthOf(state).map((old, k) => (k === 3 * (state.moved - 1) + c ? x / 1e3 : old))) }) });
  const limit = Math.floor(BEND * 1e4) / 10, numbers = (a, b) => Array.from({ length: b - a + 1 }, (_, k) => [a + k, a + k]);
  const bends = few ? [] : [
    figure.choice("moved", "Segment to bend", numbers(1, 3)),
    figure.slider("bend_x", "Bend in x", { min: -limit, max: limit, step: 0.1, show: mm, ...shape(0) }),
    figure.slider("bend_y", "Bend in y", { min: -limit, max: limit, step: 0.1, show: mm, ...shape(1) }),
    figure.slider("stretch", "Stretch", { min: 0, max: 6.6, step: 0.1, show: mm, ...shape(2) })];
  figure.group("Shape",
    figure.choice("segments", "Segments", numbers(1, 3)),
    ...bends,
    figure.slider("course", "Place on the course T3", { min: 0, max: 399, show: (x) => (x / 40).toFixed(1) + " s", change: (x) => figure.set({ course: x, q: "" }) }),
    figure.player("Follow the course", (steps) => figure.set({ course: (state.course + steps) % 400, q: "" })),
    figure.turning());
  if (!few) {
    figure.bars = element("div", { class: "live-readings", role: "group", "aria-label": "Readings; press one to switch its sensor off" });
    figure.progress = element("canvas", { class: "live-progress", role: "img", "aria-label": "Error of the tip by iteration, for both methods; the text below says where they end." });
    figure.below.append(element("div", {}, element("p", { class: "live-title", text: "Readings, base to tip (line: predicted); press to switch off" }), figure.bars),
      element("div", {}, element("p", { class: "live-title", text: "Least squares against descent, step by step" }), figure.progress));
    figure.group("Sensors",
      figure.choice("sensors", "On each segment", numbers(2, 6)),
      figure.slider("radial", "Distance from the axis", { min: 5, max: 21, show: (x) => x + " mm" }),
      figure.slider("tilt", "Tilt inwards", { min: -90, max: 90, step: 5, show: (x) => x + "°" }),
      figure.slider("noise", "Noise", { values: [0, 1e-5, 1e-4, 7.1e-4, 2e-3, 5e-3, 2e-2, 0.1], show: (x) => short(x) + " mT" }),
      figure.check("tolerances", "Parts not where the drawing has them"),
      figure.check("calibrated", `Model calibrated in ${POSES} poses`),
      figure.button("Other noise, other parts", () => figure.set({ seed: state.seed % 99 + 1 })));
    figure.group("Estimate",
      figure.choice("method", "Bold line", [["lm", "Levenberg-Marquardt"], ["descent", "gradient descent, the paper's steps"]]),
      figure.slider("evaluations", "Evaluations", { min: 2, max: 40 }),
      figure.choice("start", "Start", [["last", "last estimate"], ["straight", "straight pose"]]),
      figure.check("field", "Field lines"));
  }
  figure.start();
};
})();
