/* Sensors that fail, live: the arm of Baaij et al. 2023, section 3.5, along its course, and what each loss costs. */
(function () {
"use strict";
const { algebra, element, short, randomOf, Figure } = REPRO;
const { plus, clamp } = algebra;
const SEGMENTS = 3, EACH = 4, ALL = SEGMENTS * EACH, LENGTH = 0.11, RADIUS = 0.022, AROUND = 0.013, MOMENTS = REPRO.ringMoments(0.024, 0.012, 0.006, 1450, 9);
const MOMENTS_IN_TIME = 101, BEND = RADIUS * 54 * Math.PI / 180, STRETCH = 6.6e-3, EVALUATIONS = 4;
const DEFAULTS = { off: "4", from: 5, time: 7.5, noise: 7.1e-4, seed: 1, view: 300 };

const parts = Array.from({ length: SEGMENTS }, (_, segment) => segment);
const BODY = REPRO.robot(SEGMENTS, LENGTH, RADIUS,
  parts.map((segment) => ({ segment, axial: LENGTH / 2, position: [0, 0, 0], axis: [0, 0, 1] })),
  parts.flatMap((segment) => Array.from({ length: EACH }, (_, k) => {
    const [c, s] = [Math.cos(k * Math.PI / 2), Math.sin(k * Math.PI / 2)];
    return { segment, axial: LENGTH, position: [AROUND * c, AROUND * s, 0], axis: [0, 0, -1] };
  })));
const sensing = REPRO.magneticSensing(BODY, MOMENTS);
const LOW = Array.from({ length: 3 * SEGMENTS }, (_, c) => (c % 3 === 2 ? 0 : -BEND)), HIGH = LOW.map((low) => (low === 0 ? STRETCH : BEND));

/** The course of Table 1, a lemniscate of every segment. */
const COURSE = Array.from({ length: MOMENTS_IN_TIME }, (_, step) => Array.from({ length: 3 * SEGMENTS }, (_, c) => {
  const turn = 2 * Math.PI * step / (MOMENTS_IN_TIME - 1), p = 2 * Math.PI * Math.floor(c / 3) / SEGMENTS, D = RADIUS * Math.PI / 4;
  return [D * Math.sin(2 * turn + p), D * Math.sin(turn + p), 2.75e-3 * (1 + Math.sin(turn + p))][c % 3];
}));
const READINGS = COURSE.map((q) => [...sensing(q, false).u]), TIPS = COURSE.map((q) => REPRO.tip(BODY, q).p);
const timeOf = (k) => 10 * k / (MOMENTS_IN_TIME - 1), momentOf = (time) => Math.round(time * (MOMENTS_IN_TIME - 1) / 10);

/** Least squares along the course, each moment from the estimate before: {q, off} by moment, the error in mm. */
function follow(readings, before, used, first) {
  const found = before.slice(0, first);
  for (let k = first; k < MOMENTS_IN_TIME; k++) {
    const q = [...REPRO.levenbergMarquardt(sensing, k ? found[k - 1].q : COURSE[0], readings[k], used, LOW, HIGH, EVALUATIONS - 1).q];
    found.push({ q, off: 1e3 * Math.hypot(...plus(REPRO.tip(BODY, q).p, TIPS[k], -1)) });
  }
  return found;
}

/** Factors by which the deviation of each coordinate grows at a shape, without the sensors that are off. */
function factors(q, used) {
  const { J } = sensing(q), deviations = (use) => REPRO.covariance(J, use, 1).map((row, c) => Math.sqrt(row[c]));
  const whole = deviations(used.map(() => true));
  return deviations(used).map((x, c) => x / whole[c]);
}

const lost = (text) => [...new Set(text.split(";").map(Number))].filter((s) => s >= 1 && s <= ALL && s % 1 === 0).sort((a, b) => a - b);

function compute(figure) {
  const { state } = figure, off = lost(state.off).slice(0, ALL - 1), used = Array.from({ length: ALL }, (_, s) => !off.includes(s + 1));
  const noisy = [state.seed, state.noise].join(), asked = [noisy, off, state.from].join(" ");
  if (figure.noisy !== noisy) {
    const random = randomOf(state.seed), u = READINGS.map((row) => row.map((x) => x + state.noise * random.normal()));
    Object.assign(figure, { noisy, u, all: follow(u, [], used.map(() => true), 0) });
  }
  if (figure.asked !== asked) Object.assign(figure, { asked, left: follow(figure.u, figure.all, used, momentOf(state.from)) });
  const k = momentOf(state.time), failed = state.time >= state.from;
  return { k, used: failed ? used : used.map(() => true), working: used, u: figure.u, all: figure.all, left: figure.left, factors: factors(COURSE[k], used) };
}

const rms = (found) => Math.sqrt(found.reduce((total, { off }) => total + off * off, 0) / found.length);

// ---- Drawing -------------------------------------------------------------------------------------------------------

function draw(figure) {
  const { state } = figure, now = figure.now = compute(figure), wide = figure.width > 640, { width, height } = figure;
  const area = wide ? [width * 0.46, height] : [width, height * 0.6], below = wide ? 0 : 80; // the legend
  Object.assign(figure, { width: area[0], height: area[1] - below }); // the camera looks at a part of the stage
  figure.context.save();
  figure.context.translate(0, below);
  figure.look(state.view, 16, [0, 0, SEGMENTS * LENGTH / 2 + 0.004], SEGMENTS * LENGTH * 0.64);
  const truth = COURSE[now.k], points = REPRO.backbone(BODY, truth, 12), chain = REPRO.frames(BODY, truth);
  figure.line(figure.circle([0, 0, 0], [0, 0, 1], 0.045), "faint", 1.5);
  figure.line(points, "body", 2 * RADIUS * figure.scale, { alpha: 0.16 });
  for (const { position, axis } of REPRO.placed(BODY, truth, chain, BODY.magnets)) figure.line(figure.circle(position, axis, 0.012), "magnet", 2);
  for (let i = 1; i <= SEGMENTS; i++) figure.line(figure.circle(chain.bases[i].p, chain.bases[i].R.map((row) => row[2]), RADIUS), "body", 1, { alpha: 0.5 });
  figure.line(points, "truth", 6);
  figure.line(REPRO.backbone(BODY, now.left[now.k].q, 12), "estimate", 3, { dash: [10, 7] });
  REPRO.placed(BODY, truth, chain, BODY.sensors).forEach(({ position }, s) => figure.dot(position, "sensor", 5, { hollow: !now.used[s] }));
  figure.context.restore();
  Object.assign(figure, { width, height });
  figure.legend([["truth", "true shape"], ["estimate", "estimate, without the lost sensors"], ["descent", "with all sensors"], ["sensor", "sensors; rings are lost"]]);
  drawErrors(figure, now, wide ? [area[0] + 56, 110, width - 16, height - 46] : [50, area[1] + 24, width - 14, height - 30]);
  show(figure, now);
}

function drawErrors(figure, { k, all, left }, place) {
  const of = (found) => found.map(({ off }) => Math.max(off, 1e-9)), x = (time) => place[0] + (place[2] - place[0]) * time / 10;
  figure.plot(place, [-2, 3], MOMENTS_IN_TIME, { descent: of(all), estimate: of(left) }, "error of the tip [mm], 0 to 10 s; dotted: failure");
  figure.line([[x(figure.state.from), place[1]], [x(figure.state.from), place[3]]], "text", 1.5, { flat: true, dash: [2, 5] });
  figure.line([[x(timeOf(k)), place[1]], [x(timeOf(k)), place[3]]], "faint", 2, { flat: true });
}

function show(figure, { k, u, used, working, left, factors: grown }) {
  const predicted = sensing(left[k].q, false).u, largest = Math.max(...u[k].map(Math.abs), ...predicted.map(Math.abs));
  figure.bar.forEach(({ button, bar, mark, value }, s) => {
    bar.style.transform = `scaleX(${used[s] ? Math.abs(u[k][s]) / largest : 0})`;
    mark.style.left = clamp(100 * Math.abs(predicted[s]) / largest, 0, 99) + "%";
    value.textContent = used[s] ? u[k][s].toFixed(3) + " mT" : "lost";
    button.setAttribute("aria-pressed", working[s]);
  });
  grown.forEach((x, c) => { figure.cells[c].textContent = x < 100 ? "× " + x.toFixed(2) : "lost"; });
}

function summary({ state, now }) {
  const off = now.working.filter((works) => !works).length, first = momentOf(state.from), words = [];
  words.push(off ? `${off} of ${ALL} sensors ${off > 1 ? "are" : "is"} lost at ${state.from} s.` : "All sensors work.");
  words.push(`From then on the tip is off by ${short(rms(now.left.slice(first)))} mm (root mean square), with all sensors by ${short(rms(now.all.slice(first)))} mm.`);
  const worst = now.factors.reduce((best, x, c) => (x > now.factors[best] ? c : best), 0), name = ["bend in x", "bend in y", "elongation"][worst % 3];
  const place = `${name} of segment ${Math.floor(worst / 3) + 1}`;
  if (off) words.push(now.factors[worst] > 100 ? `The ${place} is not determined any more.` : `At the moment shown the ${place} loses most: its deviation grows by a factor of ${short(now.factors[worst], 3)}.`);
  return words.join(" ") + " Synthetic readings.";
}

REPRO.views.failure = function (box) {
  const figure = new Figure(box, {
    name: "failure", defaults: DEFAULTS, draw, summary,
    alt: "A soft arm of three segments with twelve sensors, some of them lost: its true shape and the estimate; beside it the error of the tip over time. The text below the figure says how far the tip is off.",
  });
  const { state } = figure;
  [["from", 0, 9], ["time", 0, 10], ["noise", 0, 1]].forEach(([key, low, high]) => { state[key] = clamp(state[key], low, high); });
  figure.bar = Array.from({ length: ALL }, (_, s) => {
    const bar = element("i"), mark = element("b"), value = element("span"), name = element("span", { class: "live-unseen", text: `Sensor ${s + 1}, on segment ${Math.floor(s / EACH) + 1}: ` });
    const toggle = () => {
      const off = lost(state.off), less = off.filter((one) => one !== s + 1);
      if (less.length < off.length || off.length < ALL - 1) figure.set({ off: (less.length < off.length ? less : [...off, s + 1].sort((a, b) => a - b)).join(";") });
    };
    return { button: element("button", { type: "button", onclick: toggle }, element("span", { class: "live-bar" }, bar, mark), name, value), bar, mark, value };
  });
  const bars = parts.map((i) => element("div", { class: "live-bars" }, ...figure.bar.slice(EACH * i, EACH * (i + 1)).map(({ button }) => button)));
  figure.cells = Array.from({ length: 3 * SEGMENTS }, () => element("td"));
  const heads = (words) => element("tr", {}, ...words.map((text) => element("th", { scope: "col", text })));
  figure.below.append(
    element("div", {}, element("p", { class: "live-title", text: "Sensors 1 to 12, a row for each segment; press one to lose it" }),
      element("div", { class: "live-readings", role: "group", "aria-label": "Sensors; press one to lose it, and again to mend it" }, ...bars)),
    element("div", {}, element("p", { class: "live-title", text: "By how much each deviation grows" }),
      element("table", {}, element("thead", {}, heads(["Segment", "bend in x", "bend in y", "elongation"])),
        element("tbody", {}, ...parts.map((i) => element("tr", {}, element("th", { scope: "row", text: i + 1 }), ...figure.cells.slice(3 * i, 3 * i + 3)))))));
  const seconds = (x) => x.toFixed(1) + " s";
  figure.group("Course",
    figure.slider("time", "Moment", { min: 0, max: 10, step: 0.1, show: seconds }),
    figure.slider("from", "Sensors fail at", { min: 0, max: 9, step: 0.5, show: seconds }),
    figure.player("Follow the course", (steps) => figure.set({ time: Math.round(100 * ((state.time + steps / 40) % 10)) / 100 })), figure.turning());
  figure.group("Sensors",
    figure.slider("noise", "Noise", { values: [0, 1e-4, 7.1e-4, 2e-3, 5e-3, 2e-2], show: (x) => short(x) + " mT" }),
    element("div", { class: "live-buttons" }, figure.button("All work", () => figure.set({ off: "" })), figure.button("As in the paper", () => figure.set({ off: "4;8;12" })),
      figure.button("Other noise", () => figure.set({ seed: state.seed % 99 + 1 }))));
  figure.start();
};
})();
