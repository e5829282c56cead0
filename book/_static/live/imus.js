/* Shape from orientations, live: an arm with IMUs as in Martin et al. 2022, and three ways to fill the gaps between them. */
(function () {
"use strict";
const { algebra, element, randomOf, Figure } = REPRO;
const { plus, clamp, solve } = algebra;
const LENGTH = 0.64, STEPS = 160, MARKERS = [0.36, 0.6], DEGREE = Math.PI / 180;
const DEFAULTS = { imus: 4, model: "interpolated", mounting: 3, heading: 6, seed: 1, view: 300, shape: "70;30;-60;50" };
const COLOURS = { rigid: "descent", interpolated: "estimate", spline: "sensor" };
const NAMES = { rigid: "rigid links", interpolated: "interpolated links", spline: "smooth curve" };
const MODELS = Object.keys(NAMES);
const ALL = [1, 2, 3, 4, 5, 6, 7, 8];
const usedBy = (name, { imus }) => ({ 2: name === "rigid" ? [2, 6] : [4, 8], 4: [2, 4, 6, 8], 8: ALL })[imus]; // Table I
const AT = MARKERS.map((s) => Math.round(s / LENGTH * STEPS));

const parsed = (text) => {
  const angles = text.split(";").map(Number);
  return angles.length === 4 && angles.every(Number.isFinite) ? angles.map((x) => clamp(x, -150, 150)) : [70, 30, -60, 50];
};

/** The arm: points and orientations every 4 mm; it bends evenly, and as an S, by these angles [deg] in x and in y. */
function arm(angles) {
  const points = [[0, 0, 0]], turns = [[0, 0, 0, 1]], h = LENGTH / STEPS;
  for (let k = 0; k < STEPS; k++) {
    const s = Math.cos(Math.PI * (k + 0.5) / STEPS) * Math.PI / 2, [x, y] = [0, 1].map((c) => DEGREE / STEPS * (angles[c] + s * angles[c + 2]));
    const half = REPRO.turnOf([-y / 2, x / 2, 0]), middle = REPRO.turnProduct(turns[k], half);
    points.push(plus(points[k], REPRO.tangent(middle), h));
    turns.push(REPRO.turnProduct(middle, half));
  }
  return { points, turns };
}

/** What the eight IMUs read: turned about the vertical, and not mounted along the arm. */
function read(state, turns) {
  const random = randomOf(state.seed);
  return ALL.map((k) => {
    const heading = REPRO.turnOf([0, 0, state.heading * DEGREE * random.normal()]);
    const mounting = REPRO.turnOf([0, 0, 0].map(() => state.mounting * DEGREE * random.normal()));
    return REPRO.turnProduct(REPRO.turnProduct(heading, turns[k * STEPS / 8]), mounting);
  });
}

function estimate(state, name, readings, points) {
  const used = usedBy(name, state), lengths = used.map(() => LENGTH / state.imus);
  const turns = used.map((k) => readings[k - 1]);
  if (name === "rigid") return REPRO.rigidLinks(turns, lengths, points);
  if (name === "spline") return REPRO.tangentSpline([[0, 0, 0, 1], ...turns], lengths, points);
  return REPRO.interpolatedLinks([[0, 0, 0, 1], ...turns], lengths, points, 16 / state.imus);
}

function draw(figure) {
  const { state } = figure, { points, turns } = arm(parsed(state.shape)), readings = read(state, turns);
  figure.look(state.view, 14, [0, 0, 0.24], 0.47);
  figure.line(figure.circle([0, 0, 0], [0, 0, 1], 0.08), "faint", 1.5);
  figure.line(points, "body", 22, { alpha: 0.16 });
  figure.line(points, "truth", 6);
  const arcs = Array.from({ length: 65 }, (_, k) => k * LENGTH / 64);
  figure.errors = {};
  for (const name of ["rigid", "spline", "interpolated"].sort((a) => (a === state.model ? 1 : -1))) {
    const chosen = name === state.model, shape = estimate(state, name, readings, arcs), marked = estimate(state, name, readings, MARKERS);
    figure.line(shape, COLOURS[name], chosen ? 3 : 2, { dash: chosen ? [10, 7] : [2, 6], alpha: chosen ? 1 : 0.8 });
    figure.errors[name] = marked.map((p, k) => 1e3 * Math.hypot(...plus(p, points[AT[k]], -1)));
    if (chosen) marked.forEach((p) => figure.dot(p, COLOURS[name], 5));
  }
  for (const k of usedBy(state.model, state)) {
    const p = points[k * STEPS / 8];
    figure.line([p, plus(p, REPRO.tangent(readings[k - 1]), 0.045)], "magnet", 2);
    figure.dot(p, "magnet", 5);
  }
  AT.forEach((at, k) => {
    const [[u, v], [x, y], tip] = [at - 3, at, STEPS].map((i) => figure.at(points[i]));
    figure.dot(points[at], "truth", 6, { hollow: true });
    // beside the arm, where no line of a model runs
    const [a, b] = [x - u, y - v], beside = (a * (tip[1] - y) > b * (tip[0] - x) ? -26 : 26) / Math.hypot(a, b);
    figure.words("M" + (k + 1), x - beside * b, y + beside * a, { align: "center" });
  });
  figure.tipHandle.place(figure.at(points[STEPS]));
  figure.legend([["truth", "true shape"], ["magnet", "IMUs: where each points"], ...MODELS.map((name) => [COLOURS[name], NAMES[name]])]);
  for (const name of MODELS) figure.errors[name].forEach((mm, k) => { figure.cells[name][k].textContent = mm.toFixed(1) + " mm"; });
}

function drag(figure, dx, dy) {
  let angles = parsed(figure.state.shape);
  const end = (a) => arm(a).points[STEPS], target = plus(end(angles), figure.moved(dx, dy));
  for (let turn = 0; turn < 3; turn++) {
    const at = end(angles), J = angles.map((_, k) => plus(end(angles.map((x, i) => x + (i === k ? 0.5 : 0))), at, -1).map((x) => x / 0.5));
    const A = [0, 1, 2].map((i) => [0, 1, 2].map((k) => J.reduce((sum, row) => sum + row[i] * row[k], 0) + (i === k ? 1e-6 : 0)));
    const pull = solve(A, plus(target, at, -1));
    angles = angles.map((x, k) => clamp(x + algebra.dot(J[k], pull), -150, 150));
  }
  figure.set({ shape: angles.map((x) => Math.round(10 * x) / 10).join(";") });
}

function summary({ state, errors }) {
  const [one, two] = errors[state.model].map((mm) => mm.toFixed(1));
  return `${state.imus} IMUs and the base; ${NAMES[state.model]} put marker M1 ${one} mm and marker M2 ${two} mm from where they are. `
    + `Each IMU is off by about ${state.mounting}° in its mounting and ${state.heading}° in its heading. All synthetic.`;
}

REPRO.views.imus = function (box) {
  const figure = new Figure(box, {
    name: "imus", defaults: DEFAULTS, draw, summary,
    alt: "A soft arm with orientation sensors: its true shape, and the shapes that three models make of what the sensors read. The table and the text below say how far apart they are.",
    record: ["imu_markers", "Markers from eight IMUs"],
    changed: (one) => showShape(one),
  });
  const { state } = figure, degrees = (x) => x + "°";
  const row = (name) => element("tr", {}, element("th", { scope: "row", text: NAMES[name] }), ...figure.cells[name]);
  figure.cells = Object.fromEntries(MODELS.map((name) => [name, [element("td"), element("td")]]));
  figure.below.append(element("table", {}, element("thead", {}, element("tr", {}, ...["Error of the markers", "M1", "M2"].map((text) => element("th", { scope: "col", text })))),
    element("tbody", {}, ...MODELS.map(row))));
  figure.tipHandle = figure.handle("End of the arm: drag it, or move it with the arrow keys", (dx, dy) => drag(figure, dx, dy));
  const keys = ["bend_x", "bend_y", "s_x", "s_y"], labels = ["Bend in x", "Bend in y", "As an S in x", "As an S in y"];
  const showShape = (one) => parsed(state.shape).forEach((x, k) => one.controls[keys[k]]?.show(Math.round(x)));
  figure.group("Shape", ...keys.map((key, k) => figure.slider(key, labels[k], {
    min: -150, max: 150, show: degrees,
    change: (x) => figure.set({ shape: parsed(state.shape).map((old, i) => (i === k ? x : old)).join(";") }),
  })), figure.turning());
  showShape(figure);
  figure.group("Sensors and model",
    figure.choice("imus", "IMUs", [[2, "2"], [4, "4"], [8, "8"]]),
    figure.choice("model", "Bold line", Object.entries(NAMES)),
    figure.slider("mounting", "Error of the mounting", { max: 10, step: 0.5, show: degrees }),
    figure.slider("heading", "Error of the heading", { max: 20, step: 0.5, show: degrees }),
    figure.button("Other sensors", () => figure.set({ seed: state.seed % 99 + 1 })));
  figure.start();
};
})();
