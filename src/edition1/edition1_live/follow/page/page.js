// The page of a live session: asks for the scene once, then draws what the stream of events brings.
"use strict";

const LATE_S = 0.25; // readings older than this are not drawn at "now"
const byId = (id) => document.getElementById(id);

/** Put texts into a list, reusing its entries: they stay selectable while numbers change. */
function fill(list, texts) {
  while (list.children.length > texts.length) list.lastChild.remove();
  texts.forEach((text, k) => {
    const entry = list.children[k] ?? list.appendChild(document.createElement("li"));
    if (entry.lastChild?.nodeType !== Node.TEXT_NODE) entry.append(document.createTextNode(""));
    if (entry.lastChild.data !== text) entry.lastChild.data = text;
  });
}

/** Say something to everybody, also to those who do not see it; only if it is new. */
function say(text) {
  if (byId("status").textContent !== text) byId("status").textContent = text;
}

/** Say of all that is shown that it is not of now, and why in a word or two; or, without one, that it is. */
function doubt(mark) {
  document.body.classList.toggle("doubtful", mark !== "");
  for (const place of document.querySelectorAll(".mark")) {
    if (place.textContent !== mark) place.textContent = mark;
  }
}

/** Lines over the last seconds; a reading that is missing leaves a gap, and so does a time without readings. */
class Traces {
  constructor(canvas, names) {
    this.canvas = canvas;
    this.names = names;
    this.rows = []; // [time, values, time from which they came without a gap]
    this.end = 0; // time of "now"
    this.limits = null;
  }

  add(time, values, since, age) {
    this.end = time + (age > LATE_S ? age : 0);
    if (!this.rows.length || time > this.rows.at(-1)[0]) this.rows.push([time, values, since]);
    while (this.rows.length && this.rows[0][0] < this.end - reproTraces.SECONDS) this.rows.shift();
  }

  draw() {
    const { rows, end } = this;
    let low = Infinity, high = -Infinity;
    for (const [, values] of rows) for (const x of values) if (x !== null) [low, high] = [Math.min(low, x), Math.max(high, x)];
    if (low <= high) this.limits = reproTraces.roomy(low, high); // else those of before, while nothing is shown
    reproTraces.draw(this.canvas, this.limits, this.names.length, (k, to) => {
      let last = -Infinity; // time of the reading that a line may be drawn from
      for (const [time, values, since] of rows) {
        const value = values[k];
        if (value === null) { last = -Infinity; continue; }
        to(end - time, value, last >= since);
        last = time;
      }
    });
  }
}

function begin(scene) {
  document.title = `Live: ${scene.robot}`;
  byId("robot").textContent = scene.robot;
  byId("unit").textContent = `[${scene.unit}]`;
  const handle = window.reproViewer ? window.reproViewer.mount(byId("shape"), scene.shape) : null;
  byId("no-shape").hidden = handle !== null;
  const traces = new Traces(byId("traces"), scene.traces);
  fill(byId("values"), scene.traces);
  [...byId("values").children].forEach((entry, k) => {
    const mark = document.createElement("i");
    mark.style.backgroundColor = reproTraces.colour(k);
    entry.prepend(mark);
  });
  let latest = null;
  let stopped = ""; // the mark of what is shown, once nothing more comes
  const draw = () => {
    if (latest === null) return;
    if (handle && latest.shape) handle.update(latest.shape);
    fill(byId("quantities"), latest.quantities);
    fill(byId("troubles"), latest.troubles);
    fill(byId("values"), scene.traces.map((name, k) => `${name} ${latest.readings?.[k]?.toPrecision(4) ?? "—"}`));
    byId("head").textContent = latest.head;
    doubt(latest.shape ? stopped || latest.mark : "");
    byId("counters").textContent = latest.counters;
    traces.draw();
    latest = null;
  };
  const over = (text) => {
    say(text);
    stopped = "the last ones";
    if (byId("quantities").children.length) doubt(stopped);
  };
  let lost = false;
  const events = new EventSource("/events");
  events.onopen = () => {
    if (lost) location.reload(); // it may be another session
    say("The estimator is being prepared.");
  };
  events.onmessage = (event) => {
    const first = latest === null;
    latest = JSON.parse(event.data);
    if (latest.readings) traces.add(latest.time_s, latest.readings, latest.since_s, latest.age_s);
    say(latest.alerts.length ? latest.alerts.join(" ") : latest.quantities.length ? "Estimating." : "No frame yet.");
    if (first) requestAnimationFrame(draw); // a hidden page draws nothing, and catches up later
  };
  events.addEventListener("end", () => { events.close(); over("The session has ended."); });
  events.onerror = () => { lost = true; over("The connection is lost; trying again."); };
}

fetch("/scene.json").then((answer) => answer.json()).then(begin, () => say("The session cannot be reached."));
