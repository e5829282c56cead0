/* Shape from orientations, live: an arm with IMUs as in Martin et al. 2022, and the paper's two models of it. */
(function () {
"use strict";
const { algebra: { plus, cross, dot, clamp, solve }, element, randomOf, Figure } = REPRO;
const LENGTH = 0.64, STEPS = 160, MARKERS = [0.36, 0.6], DEGREE = Math.PI / 180, SHAPE = [70, 30, -60, 50], IMUS = 8;
const DEFAULTS = { imus: 8, segments: 16, model: "pcc", mounting: 3, heading: 6, tilt: 1, seed: 1, view: 300, shape: SHAPE.join(";") };
const COLOURS = { rigid: "descent", pcc: "estimate" }, NAMES = { rigid: "rigid-body", pcc: "PCC-extended" }, MODELS = Object.keys(NAMES);
const RIGID = { 2: [2, 6], 4: [1, 3, 5, 7], 8: [1, 2, 3, 4, 5, 6, 7, 8] }; // Table I and the text; 0 is the base
const AT = MARKERS.map((s) => Math.round(s / LENGTH * STEPS));

/** Where an IMU points; orientations are unit quaternions XYZW. */
const tangent = ([x, y, z, w]) => [2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)];

/** The turn b, then the turn a. */
function product([ax, ay, az, aw], [bx, by, bz, bw]) {
  return [
    aw * bx + ax * bw + ay * bz - az * by, aw * by - ax * bz + ay * bw + az * bx,
    aw * bz + ax * by - ay * bx + az * bw, aw * bw - ax * bx - ay * by - az * bz,
  ];
}

/** Quaternion of a rotation vector. */
function turnOf(v) {
  const angle = Math.hypot(...v), half = angle > 0 ? Math.sin(angle / 2) / angle : 0.5;
  return [half * v[0], half * v[1], half * v[2], Math.cos(angle / 2)];
}

/** Straight pieces [direction, length], n sub-segments between each two IMUs: a turn about a fixed axis, the shorter way, eqs (3) to (5). */
function pccPieces(turns, length, n) {
  return turns.slice(1).flatMap((b, i) => {
    const [x, y, z, w] = turns[i], r = product(b, [-x, -y, -z, w]), sine = Math.hypot(r[0], r[1], r[2]), way = r[3] < 0 ? -1 : 1;
    const axis = sine > 0 ? r.slice(0, 3).map((part) => way * part / sine) : [0, 0, 0], angle = 2 * Math.atan2(sine, Math.abs(r[3])), d = tangent(turns[i]);
    return Array.from({ length: n }, (_, k) => {
      const turn = angle * (2 * k + 1) / (2 * n), c = Math.cos(turn);
      return [plus(plus(d.map((part) => c * part), cross(axis, d), Math.sin(turn)), axis, (1 - c) * dot(axis, d)), length / n];
    });
  });
}

/** Points at distances along pieces of one length. */
const pointsOn = (links, distances) => distances.map((s) => links.reduce((x, [d, length], k) => plus(x, d, clamp(s - k * length, 0, length)), [0, 0, 0]));

const parsed = (text, angles = text.split(";").map(Number)) => (angles.length === 4 && angles.every(Number.isFinite) ? angles.map((x) => clamp(x, -150, 150)) : SHAPE);

/** The arm: points and orientations every 4 mm; it bends evenly, and as an S, by these angles [deg] in x and in y. */
function arm(angles) {
  const points = [[0, 0, 0]], turns = [[0, 0, 0, 1]], h = LENGTH / STEPS;
  for (let k = 0; k < STEPS; k++) {
    const s = Math.cos(Math.PI * (k + 0.5) / STEPS) * Math.PI / 2, [x, y] = [0, 1].map((c) => DEGREE / STEPS * (angles[c] + s * angles[c + 2]));
    const half = turnOf([-y / 2, x / 2, 0]), middle = product(turns[k], half);
    points.push(plus(points[k], tangent(middle), h));
    turns.push(product(middle, half));
  }
  return { points, turns };
}

/** What base and IMUs read: mounted askew, with a wrong vertical, and turned about it; the base is right. */
function read(state, turns) {
  const random = randomOf(state.seed), normal = (size) => size * DEGREE * random.normal();
  return [turns[0], ...Array.from({ length: IMUS }, (_, k) => {
    const mounting = turnOf([0, 0, 0].map(() => normal(state.mounting))), tilt = turnOf([normal(state.tilt), normal(state.tilt), 0]);
    return product(product(turnOf([0, 0, normal(state.heading)]), tilt), product(turns[(k + 1) * STEPS / IMUS], mounting));
  })];
}

const usedBy = (name, n) => (name === "rigid" ? RIGID[n] : Array.from({ length: n + 1 }, (_, k) => k * IMUS / n));
/** A link of the rigid-body model for each IMU, eq. (2), or the sub-segments of the other model. */
function pieces(name, { imus, segments }, readings) {
  const turns = usedBy(name, imus).map((k) => readings[k]), length = LENGTH / imus;
  return name === "rigid" ? turns.map((q) => [tangent(q), length]) : pccPieces(turns, length, segments / imus);
}

function draw(figure) {
  const { state } = figure, { points, turns } = arm(parsed(state.shape)), readings = read(state, turns), found = {};
  figure.look(state.view, 14, [0, 0, 0.24], 0.47);
  figure.line(figure.circle([0, 0, 0], [0, 0, 1], 0.08), "faint", 1.5);
  figure.line(points, "body", 22, { alpha: 0.16 });
  figure.line(points, "truth", 6);
  for (const name of [...MODELS].sort((a) => (a === state.model ? 1 : -1))) {
    const chosen = name === state.model, links = pieces(name, state, readings), marked = pointsOn(links, MARKERS);
    const joints = pointsOn(links, Array.from({ length: links.length + 1 }, (_, k) => k * LENGTH / links.length));
    figure.line(joints, COLOURS[name], chosen ? 3 : 2, { alpha: chosen ? 1 : 0.8, dash: chosen ? [] : [2, 6] });
    found[name] = { marked, errors: marked.map((p, k) => 1e3 * Math.hypot(...plus(p, points[AT[k]], -1))) };
    if (chosen) marked.forEach((p, k) => figure.line([p, points[AT[k]]], "text", 1.5));
    if (chosen) [...joints.map((p) => [p, 3]), ...marked.map((p) => [p, 6])].forEach(([p, size]) => figure.dot(p, COLOURS[name], size));
  }
  for (const k of usedBy(state.model, state.imus).filter(Boolean)) {
    const p = points[k * STEPS / IMUS];
    figure.line([p, plus(p, tangent(readings[k]), 0.045)], "magnet", 2);
    figure.dot(p, "magnet", 5);
  }
  AT.forEach((at, k) => {
    const [[u, v], [x, y], tip] = [at - 3, at, STEPS].map((i) => figure.at(points[i])), [a, b] = [x - u, y - v];
    const beside = (a * (tip[1] - y) > b * (tip[0] - x) ? -26 : 26) / Math.hypot(a, b); // where no line of a model runs
    figure.dot(points[at], "truth", 6, { hollow: true });
    figure.words("M" + (k + 1), x - beside * b, y + beside * a, { align: "center" });
  });
  figure.tipHandle.place(figure.at(points[STEPS]));
  figure.legend([["truth", "true shape, M1 and M2"], ["magnet", "IMUs: where each points"], ...MODELS.map((name) => [COLOURS[name], NAMES[name]])]);
  for (const name of MODELS) found[name].errors.forEach((mm, k) => { figure.cells[name][k].textContent = mm.toFixed(1) + " mm"; });
  figure.now = { ...found, readings, points, turns };
}

function drag(figure, dx, dy) {
  let angles = parsed(figure.state.shape);
  const end = (a) => arm(a).points[STEPS], target = plus(end(angles), figure.moved(dx, dy));
  for (let turn = 0; turn < 3; turn++) {
    const at = end(angles), J = angles.map((_, k) => plus(end(angles.map((x, i) => x + (i === k))), at, -1)); // by a degree
    const A = [0, 1, 2].map((i) => [0, 1, 2].map((k) => J.reduce((sum, row) => sum + row[i] * row[k], 0) + (i === k ? 1e-6 : 0)));
    solve(A, plus(target, at, -1)).forEach((pull, i) => { angles = angles.map((x, k) => clamp(x + J[k][i] * pull, -150, 150)); });
  }
  figure.set({ shape: angles.map((x) => Math.round(10 * x) / 10).join(";") });
}

function summary({ state, now }) {
  const words = MODELS.map((name) => `${NAMES[name]} ${now[name].errors.map((mm) => mm.toFixed(1)).join(" and ")} mm`).join(", ");
  const errs = state.mounting + state.heading + state.tilt > 0 ? `Each IMU errs by about ${state.mounting}° in its mounting, ${state.heading}° in its heading and ${state.tilt}° in its tilt.` : "The IMUs are perfect.";
  return `With ${state.imus} IMUs the markers M1 and M2 are off by: ${words}. ${errs} All synthetic.`;
}

REPRO.views.imus = function (box) {
  const figure = new Figure(box, {
    name: "imus", defaults: DEFAULTS, draw, summary,
    alt: "A soft arm with motion sensors: its true shape, and the shapes that two models make of what the sensors read. The table and the text below say how far apart they are.",
    changed: (one) => showShape(one),
  });
  const { state } = figure, degrees = (x) => x + "°", numbers = (...values) => values.map((x) => [x, x]);
  figure.cells = Object.fromEntries(MODELS.map((name) => [name, [element("td"), element("td")]]));
  figure.below.append(element("table", {}, element("thead", {}, element("tr", {}, ...["Error of the markers", "M1", "M2"].map((text) => element("th", { scope: "col", text })))),
    element("tbody", {}, ...MODELS.map((name) => element("tr", {}, element("th", { scope: "row", text: NAMES[name] }), ...figure.cells[name])))));
  figure.tipHandle = figure.handle("End of the arm: drag it, or move it with the arrow keys", (dx, dy) => drag(figure, dx, dy));
  const keys = ["bend_x", "bend_y", "s_x", "s_y"], labels = ["Bend in x", "Bend in y", "As an S in x", "As an S in y"];
  const showShape = (one) => parsed(one.state.shape).forEach((x, k) => one.controls[keys[k]]?.show(Math.round(x)));
  figure.group("Shape", ...keys.map((key, k) => figure.slider(key, labels[k], {
    min: -150, max: 150, show: degrees,
    change: (x) => figure.set({ shape: parsed(state.shape).map((old, i) => (i === k ? x : old)).join(";") }),
  })), figure.turning());
  showShape(figure);
  figure.group("Models",
    figure.choice("imus", "IMUs", numbers(2, 4, 8)),
    figure.choice("segments", "Segments in all", numbers(8, 16, 32, 64)),
    figure.choice("model", "Bold line", Object.entries(NAMES)));
  figure.group("Errors of the IMUs",
    figure.slider("mounting", "Mounting", { max: 10, step: 0.5, show: degrees }),
    figure.slider("heading", "Heading", { max: 20, step: 0.5, show: degrees }),
    figure.slider("tilt", "Tilt", { max: 10, step: 0.5, show: degrees }),
    figure.button("Other sensors", () => figure.set({ seed: state.seed % 99 + 1 })));
  figure.start();
};
})();
