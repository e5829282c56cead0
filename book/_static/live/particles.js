/* Bend from one magnet, live: the particle filter of Mitchell et al. 2021, step by step. */
(function () {
"use strict";
const { algebra, element, short, randomOf, Figure } = REPRO;
const REACH = Math.PI / 2, EDGE = 6.35e-3, POLARISATION = 1320, DEGREE = Math.PI / 180;
const DEFAULTS = { particles: 300, walk: 0.02, noise: 0.025, length: 15, estimate: "bestTenth", curve: "flower", seed: 1, x: 40, y: 20 };
const CURVES = { // eqs (5)-(7): bend direction and angle
  spiral: (t) => [t, 0.03 * t], flower: (t) => [(0.1 * t) ** 2, Math.sin(t)], seagull: (t) => [Math.sin(t) + Math.PI / 2, Math.abs(Math.sin(t))],
};

const truthOf = ({ x, y }) => [x * DEGREE, y * DEGREE];
const sensingOf = (state) => (x, y) => REPRO.bendReading(x, y, state.length / 1e3, EDGE, POLARISATION);
const assumed = (state) => Math.max(state.noise, 0.01 / Math.SQRT2); // the paper's 0.01 mT is sqrt(2) times the noise of an axis

function restart(figure) {
  const { state } = figure, random = figure.random = randomOf(state.seed);
  figure.cloud = REPRO.moveParticles(Array(state.particles).fill([0, 0]), state.walk * Math.PI, REACH, () => normals(random, state.particles));
  Object.assign(figure, { weights: null, drawn: null, errors: [], estimate: null, phase: 0, time: 0 });
}

const normals = (random, n) => Array.from({ length: n }, () => [random.normal(), random.normal()]);

/** One of the three parts of a step: weigh, draw anew, move. */
function advance(figure) {
  const { state, random } = figure, n = figure.cloud.length;
  if (figure.phase === 0) {
    const sensing = sensingOf(state), u = sensing(...truthOf(state)).map((x) => x + state.noise * random.normal());
    figure.weights = REPRO.weigh(figure.cloud, u, assumed(state), sensing);
    const found = REPRO.cloudEstimates(figure.cloud, figure.weights);
    figure.estimate = found[state.estimate];
    figure.effective = found.effective;
    figure.errors.push(distance(state, figure.estimate, truthOf(state)));
    if (figure.errors.length > 300) figure.errors.shift();
  } else if (figure.phase === 1) {
    figure.drawn = REPRO.resample(figure.weights, Array.from({ length: n }, random.uniform).sort((a, b) => a - b));
    figure.cloud = figure.drawn.map((k) => figure.cloud[k]);
    figure.weights = null;
  } else {
    figure.cloud = REPRO.moveParticles(figure.cloud, state.walk * Math.PI, REACH, () => normals(random, n));
  }
  figure.phase = (figure.phase + 1) % 3;
}

/** Distance of the magnet's places [mm]. */
function distance({ length }, q, p) {
  const place = ([x, y]) => {
    const angle = Math.hypot(x, y) || 1e-9, side = length * (1 - Math.cos(angle)) / angle / angle;
    return [side * x, side * y, length * Math.sin(angle) / angle];
  };
  return Math.hypot(...algebra.plus(place(q), place(p), -1));
}

/** Error where the spread of the cloud is all there is: see the page. */
const law = ({ walk, length, particles }) => 0.325 * walk * Math.PI * length / 2 / Math.sqrt(particles / 10);
const rms = (errors) => Math.sqrt(errors.reduce((total, x) => total + x * x, 0) / errors.length);

function draw(figure) {
  const { state } = figure, wide = figure.width > 560, half = wide ? figure.width / 2 : figure.width, size = Math.min(half, wide ? figure.height : figure.height - 120) / 2 - 14;
  const centre = [half / 2, size + 14], at = ([x, y]) => [centre[0] + x / REACH * size, centre[1] - y / REACH * size];
  figure.perDegree = size / 90;
  for (const angle of [30, 60, 90]) {
    figure.line(Array.from({ length: 61 }, (_, k) => at([angle * DEGREE * Math.cos(k * Math.PI / 30), angle * DEGREE * Math.sin(k * Math.PI / 30)])), "faint", 1.2, { flat: true });
    figure.words(angle + "°", centre[0], centre[1] - size * angle / 90 + 9, { align: "center", size: 12 });
  }
  const n = figure.cloud.length, c = figure.context;
  Object.assign(c, { fillStyle: figure.colour("descent"), globalAlpha: 0.45 });
  figure.cloud.forEach((q, k) => {
    const [x, y] = at(q), r = figure.weights ? Math.min(1 + 2 * Math.sqrt(figure.weights[k] * n), 14) : 2.4;
    c.fillRect(x - r / 2, y - r / 2, r, r);
  });
  c.globalAlpha = 1;
  const truth = truthOf(state);
  figure.dot(at(truth), "truth", 5, { flat: true });
  if (figure.estimate) figure.dot(at(figure.estimate), "estimate", 8, { flat: true, hollow: true });
  figure.truthHandle.place(at(truth));
  figure.next.textContent = ["Weigh", "Draw anew", "Move"][figure.phase];
  figure.legend([["truth", "true bend"], ["descent", "particles"], ["estimate", "estimate"]]);
  drawErrors(figure, wide ? [half + 50, 40, figure.width - 14, figure.height - 40] : [50, 2 * size + 40, figure.width - 14, figure.height - 26]);
}

function drawErrors(figure, place) {
  const y = figure.plot(place, [-3, 1], 300, { estimate: figure.errors }, "error [mm], last 300 steps; dashed: the law"), limit = y(law(figure.state));
  figure.line([[place[0], limit], [place[2], limit]], "text", 1.5, { flat: true, dash: [6, 5] });
}

function summary(figure) {
  const { state } = figure, n = state.particles, after = [`${n} particles that have just been moved`, "weighed by the readings: large ones agree with them", "drawn anew by their weights: few places, many times"];
  const words = [`Now: ${after[figure.phase]}.`];
  if (!figure.errors.length) words.push("They start around the straight arc; the sensor has not been read yet.");
  if (figure.phase === 1) words.push(`They are worth ${short(figure.effective)} equal ones.`);
  if (figure.errors.length) words.push(`The estimate is off by ${short(figure.errors[figure.errors.length - 1])} mm, ${short(rms(figure.errors))} mm over ${figure.errors.length} steps; the spread of the cloud alone gives ${short(law(state))} mm. All synthetic.`);
  return words.join(" ");
}

REPRO.views.particles = function (box) {
  const figure = new Figure(box, {
    name: "particles", defaults: DEFAULTS, draw, summary,
    alt: "The disc of bends with a cloud of particles, the true bend and the estimate; beside it the error by step. The text below the figure says what the last step did.",
    changed: (one, changes) => { if ("particles" in changes || "seed" in changes) restart(one); },
  });
  const { state } = figure;
  if (!(state.particles >= 10 && state.particles <= 2000)) state.particles = DEFAULTS.particles;
  const bound = (x, y) => { const r = Math.max(Math.hypot(x, y) / 90, 1); return { x: Math.round(10 * x / r) / 10, y: Math.round(10 * y / r) / 10 }; };
  Object.assign(state, bound(state.x, state.y));
  restart(figure);
  figure.truthHandle = figure.handle("True bend: drag it, or move it with the arrow keys", (dx, dy) => figure.set(bound(state.x + dx / figure.perDegree, state.y - dy / figure.perDegree)));
  figure.next = figure.button("Weigh", () => { advance(figure); figure.set({}); });
  figure.group("Step by step", element("div", { class: "live-buttons" }, figure.next,
    figure.player("Follow the curve", (frames) => {
      for (let k = 0; k < Math.max(Math.floor(frames), 1); k++) {
        while (figure.phase) advance(figure);
        figure.time = (figure.time + 0.01) % (10 * Math.PI);
        const [direction, angle] = CURVES[state.curve](figure.time);
        Object.assign(state, bound(angle / DEGREE * Math.cos(direction), angle / DEGREE * Math.sin(direction)));
        for (let part = 0; part < 3; part++) advance(figure);
      }
      figure.set({});
    }),
    figure.button("Start again, straight", () => figure.set({ seed: state.seed % 99 + 1 }))),
    figure.choice("curve", "Curve", [["flower", "Flower"], ["spiral", "Spiral"], ["seagull", "Seagull"]]),
    figure.choice("estimate", "Estimate", [["bestTenth", "best tenth (paper)"], ["mean", "mean by weight"]]));
  figure.group("Filter and sensor",
    figure.slider("particles", "Particles", { values: [20, 50, 100, 300, 1000, 2000] }),
    figure.slider("walk", "Process noise", { values: [0.0005, 0.001, 0.002, 0.005, 0.01, 0.02, 0.05], show: (x) => x + "π rad" }),
    figure.slider("noise", "Sensor noise", { values: [0, 0.005, 0.025, 0.1, 0.5], show: (x) => x + " mT" }),
    figure.slider("length", "Length of the arc", { min: 10, max: 30, show: (x) => x + " mm" }));
  figure.start();
};
})();
