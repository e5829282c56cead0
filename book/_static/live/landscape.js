/* A descent with momentum, live: step size and momentum on the loss of one instant of Baaij et al. 2023, section 5. */
(function () {
"use strict";
const { element, short, Figure } = REPRO;
const { points: N, reach: REACH, truth: TRUTH } = REPRO.grid, H = 2 * REACH / (N - 1), PUBLISHED = 1.5e-8;
const DEFAULTS = { step: 1, momentum: 0.2, evaluations: 20, x: 0, y: 0, marked: true };
const bytes = Uint8Array.from(atob(REPRO.grid.values), (c) => c.charCodeAt(0));
const [LOSS, BY_X, BY_Y] = [0, 1, 2].map((k) => new Float32Array(bytes.buffer, 4 * k * N * N, N * N));

// ---- The loss between the nodes of the grid ------------------------------------------------------------------------

/** Differences of values along a row (by 1) or a column (by N): central ones, one-sided ones at the edge. */
function differences(values, by) {
  return Float64Array.from(values, (x, i) => {
    const k = by === 1 ? i % N : Math.floor(i / N), next = k < N - 1 ? i + by : i, last = k > 0 ? i - by : i;
    return (values[next] - values[last]) * by / (next - last) / H;
  });
}

const along = differences(BY_X, N), across = differences(BY_Y, 1), MIXED = along.map((x, i) => (x + across[i]) / 2);

/** Weights of values and of slopes at both ends of an interval, at the share t of it, and their two derivatives. */
const hermite = (t) => [
  [[2 * t ** 3 - 3 * t * t + 1, 3 * t * t - 2 * t ** 3], [H * (t ** 3 - 2 * t * t + t), H * (t ** 3 - t * t)]],
  [[(6 * t * t - 6 * t) / H, (6 * t - 6 * t * t) / H], [3 * t * t - 4 * t + 1, 3 * t * t - 2 * t]],
  [[(12 * t - 6) / H / H, (6 - 12 * t) / H / H], [(6 * t - 4) / H, (6 * t - 2) / H]],
];

/** Loss [mV^2], gradient [mV^2/mm] and largest curvature at a bend [mm]: bicubic, by values and slopes of the nodes. */
function lossAt(x, y) {
  const [i, j] = [x, y].map((z) => Math.min(Math.max(Math.floor((z + REACH) / H), 0), N - 2));
  const X = hermite((x + REACH) / H - i), Y = hermite((y + REACH) / H - j);
  const corners = [[0, 0], [1, 0], [0, 1], [1, 1]].map(([a, b]) => [a, b, (j + b) * N + i + a]);
  const of = (dx, dy) => corners.reduce((total, [a, b, k]) => total
    + Y[dy][0][b] * (X[dx][0][a] * LOSS[k] + X[dx][1][a] * BY_X[k]) + Y[dy][1][b] * (X[dx][0][a] * BY_Y[k] + X[dx][1][a] * MIXED[k]), 0);
  const half = (of(2, 0) - of(0, 2)) / 2;
  return { loss: of(0, 0), gradient: [of(1, 0), of(0, 1)], curvature: (of(2, 0) + of(0, 2)) / 2 + Math.hypot(half, of(1, 1)) };
}

const inside = (x, y) => Math.max(Math.abs(x), Math.abs(y)) <= REACH;

/** Eqs (9) to (12) from a start at rest: what is tried, until it leaves the map. The step is in m^2/mV^2. */
function descend(x, y, step, momentum, evaluations) {
  const trail = [], size = 1e6 * step; // mm^2/mV^2
  let b = [0, 0], left = false;
  for (let k = 0; k < evaluations && !left; k++) {
    const { loss, gradient } = lossAt(x, y);
    trail.push({ x, y, loss });
    b = b.map((old, c) => momentum * old + gradient[c]);
    [x, y] = [x - size * b[0], y - size * b[1]];
    left = k < evaluations - 1 && !inside(x, y);
  }
  return { trail, left: left ? [x, y] : null, best: trail.reduce((one, other) => (other.loss < one.loss ? other : one)) };
}

/** Middles of every second cell, with the largest curvature there. */
const MIDDLES = Array.from({ length: (N - 1) ** 2 }, (_, k) => [k % (N - 1), Math.floor(k / (N - 1))]).filter(([i, j]) => i % 2 === 0 && j % 2 === 0)
  .map((cell) => cell.map((k) => H * (k + 0.5) - REACH)).map(([x, y]) => [x, y, lossAt(x, y).curvature]);

// ---- Drawing -------------------------------------------------------------------------------------------------------

/** The map as a picture, darker where the readings fit better, in bands whose edges are lines of equal error. */
function painted(figure) {
  const size = 4 * (N - 1) + 1, canvas = element("canvas", { width: size, height: size }), c = canvas.getContext("2d");
  const image = c.createImageData(size, size), rgb = (role) => figure.colour(role).match(/\w\w/g).map((x) => parseInt(x, 16));
  const near = rgb("sensor"), far = document.documentElement.dataset.theme === "dark" ? [18, 18, 18] : [255, 255, 255];
  for (let k = 0; k < size * size; k++) {
    const { loss } = lossAt(-REACH + H / 4 * (k % size), REACH - H / 4 * Math.floor(k / size));
    const share = Math.min(Math.max(Math.ceil(4 * Math.log2(Math.sqrt(loss) / 6.5)) / 18, 0), 1) ** 0.8;
    image.data.set([...near.map((x, i) => x + share * (far[i] - x)), 255], 4 * k);
  }
  c.putImageData(image, 0, 0);
  return canvas;
}

function draw(figure) {
  const { state, context: c } = figure, wide = figure.width > 640, size = wide ? Math.min(figure.height - 40, figure.width / 2) : Math.min(figure.width - 30, figure.height - 290);
  const left = wide ? 20 : (figure.width - size) / 2, top = wide ? 14 : 96, at = (x, y) => [left + size * (x + REACH) / (2 * REACH), top + size * (REACH - y) / (2 * REACH)];
  const theme = figure.colour("sensor");
  if (figure.paintedFor !== theme) Object.assign(figure, { map: painted(figure), paintedFor: theme });
  c.drawImage(figure.map, left, top, size, size);
  Object.assign(figure, { perMm: size / (2 * REACH), middle: at(0, 0) });
  const step = state.step * PUBLISHED, found = descend(state.x, state.y, step, state.momentum, state.evaluations), limit = 2 * (1 + state.momentum);
  if (state.marked) {
    Object.assign(c, { fillStyle: figure.colour("truth"), globalAlpha: 0.5 });
    for (const [x, y, curvature] of MIDDLES) if (1e6 * step * curvature > limit) c.fillRect(at(x, y)[0] - 0.75, at(x, y)[1] - 0.75, 1.5, 1.5);
    c.globalAlpha = 1;
  }
  c.save();
  c.beginPath();
  c.rect(left, top, size, size);
  c.clip();
  const path = [...found.trail.map(({ x, y }) => at(x, y)), ...(found.left ? [at(...found.left)] : [])];
  figure.line(path, "back", 5, { flat: true, alpha: 0.8 });
  figure.line(path, "descent", 2, { flat: true });
  for (const one of found.trail) figure.dot(at(one.x, one.y), "descent", 3.5, { flat: true });
  c.restore();
  figure.line([at(-REACH, -REACH), at(REACH, -REACH), at(REACH, REACH), at(-REACH, REACH), at(-REACH, -REACH)], "faint", 1, { flat: true });
  figure.words(`bend in x and in y, ±${REACH} mm`, left + size / 2, top + size + 12, { align: "center", size: 12 });
  figure.dot(at(...TRUTH), "truth", 5, { flat: true });
  figure.dot(at(found.best.x, found.best.y), "estimate", 8, { flat: true, hollow: true });
  figure.startHandle.place(at(state.x, state.y));
  figure.now = { ...found, limit, product: 1e6 * step * lossAt(found.best.x, found.best.y).curvature };
  figure.legend([["descent", "tried bends"], ["estimate", "estimate: the best of them"], ["truth", "true bend"], ...(state.marked ? [["text", "dots: the step is too long here"]] : [])]);
  const errors = found.trail.map(({ loss }) => Math.sqrt(loss)), place = wide ? [left + size + 70, 110, figure.width - 20, figure.height - 46] : [50, top + size + 40, figure.width - 14, figure.height - 30];
  const y = figure.plot(place, [0, 3], state.evaluations, { }, "error of the readings [mV] by evaluation"), x = (k) => place[0] + (place[2] - place[0]) * k / Math.max(state.evaluations - 1, 1);
  figure.line(errors.map((error, k) => [x(k), y(error)]), "descent", 2, { flat: true });
  errors.forEach((error, k) => figure.dot([x(k), y(error)], "descent", 3, { flat: true }));
}

function summary({ state, now }) {
  const { trail, best, left, product, limit } = now, error = (one) => short(Math.sqrt(one.loss)) + " mV", last = trail[trail.length - 1];
  const off = Math.hypot(best.x - TRUTH[0], best.y - TRUTH[1]);
  const words = [`The best of ${trail.length} evaluation${trail.length > 1 ? "s" : ""} has an error of ${error(best)} and lies ${short(off)} mm from the true bend.`];
  words.push(left ? "Then the descent leaves the map." : `The last one has ${error(last)}.`);
  const before = trail[trail.length - 2], rests = before && Math.hypot(last.x - before.x, last.y - before.y) < 0.01;
  const ends = product <= 0 ? ": the loss curves downwards there, and no descent comes to rest."
    : `, ${product < limit ? "below" : "above"} the limit 2(1 + μ) = ${short(limit)}` + (product >= limit ? ": no descent comes to rest there."
      : rests && !left ? ", and the descent comes to rest there." : ", but the descent is not at rest: what decides is γλ on the floor of the valley.");
  words.push(`At the estimate γλ is ${short(product)}${ends}`);
  return words.join(" ") + " Simulated rig, one instant of T2.";
}

REPRO.landscape = { lossAt, descend };

REPRO.views.landscape = function (box) {
  const figure = new Figure(box, {
    name: "landscape", defaults: DEFAULTS, draw, summary,
    alt: "A map of the error of the readings over the bend in x and y, with the path of a descent, its estimate and the true bend; beside it the error by evaluation. The text below the figure says where the descent ends.",
  });
  const { state } = figure, bound = (z) => Math.round(10 * Math.min(Math.max(z, -REACH), REACH)) / 10, clip = (key, low, high) => { state[key] = Math.min(Math.max(state[key], low), high); };
  [["step", 0.02, 4], ["momentum", 0, 0.95], ["evaluations", 1, 100], ["x", -REACH, REACH], ["y", -REACH, REACH]].forEach((limits) => clip(...limits));
  state.evaluations = Math.round(state.evaluations);
  figure.startHandle = figure.handle("Start of the descent: drag it, or move it with the arrow keys", (dx, dy) => figure.set({ x: bound(state.x + dx / figure.perMm), y: bound(state.y - dy / figure.perMm) }));
  figure.group("Descent",
    figure.slider("step", "Step size γ", { values: [0.02, 0.05, 0.1, 0.2, 0.3, 0.5, 0.7, 1, 1.5, 2, 3, 4], show: (x) => (x === 1 ? "published" : x + " ×") }),
    figure.slider("momentum", "Momentum μ", { min: 0, max: 0.95, step: 0.05, show: (x) => x.toFixed(2) }),
    figure.slider("evaluations", "Evaluations", { min: 1, max: 100 }),
    figure.check("marked", "Mark where γλ is above 2(1 + μ)"));
  figure.canvas.addEventListener("click", ({ offsetX, offsetY }) => {
    const [x, y] = [(offsetX - figure.middle[0]) / figure.perMm, (figure.middle[1] - offsetY) / figure.perMm];
    if (inside(x, y)) figure.set({ x: bound(x), y: bound(y) });
  });
  const from = (x, y) => () => figure.set({ x, y });
  figure.group("Start", element("div", { class: "live-buttons" },
    figure.button("Straight", from(0, 0)), figure.button("In another valley", from(-8, -8)), figure.button("At the true bend", from(...TRUTH.map(bound)))));
  figure.start();
};
})();
