// The page of a live session: asks for the scene once, then draws what the stream of events brings.
"use strict";

const SECONDS = 20; // of readings that are shown
const LATE_S = 0.25; // readings older than this are not drawn at "now"
const GAP_S = 1; // readings farther apart are not joined
const MOST_RESIDUAL = 30; // beyond this a residual stays at the edge

/** Put texts into a list, reusing its entries: they stay selectable while numbers change. */
function fill(list, texts, name = "li") {
  while (list.children.length > texts.length) list.lastChild.remove();
  texts.forEach((text, k) => {
    const entry = list.children[k] ?? list.appendChild(make(name));
    if (entry.textContent !== text) entry.textContent = text;
  });
}

const say = (text) => { if (byId("status").textContent !== text) byId("status").textContent = text; };

/** Lines over the last seconds; a reading that is missing leaves a gap, and so does a time without readings. */
class Traces {
  constructor(canvas, count, most = Infinity) {
    Object.assign(this, { canvas, count, most, rows: [], end: 0 });
  }

  add(time, values, age) {
    if (this.rows.length && time < this.rows.at(-1)[0]) this.rows = []; // the board began anew
    this.end = time + (age > LATE_S ? age : 0);
    if (!this.rows.length || time > this.rows.at(-1)[0]) this.rows.push([time, values]);
    while (this.rows.length && this.rows[0][0] < this.end - SECONDS) this.rows.shift();
  }

  limits() {
    let [low, high] = extremes(this.rows);
    if (low > high) return this.shown;
    if (this.most < Infinity) [low, high] = [Math.max(Math.min(low, -4), -this.most), Math.min(Math.max(high, 4), this.most)];
    return (this.shown = widened(low, high));
  }

  draw(suspects) {
    const { canvas, count, rows, end } = this, limits = this.limits(), from = end - SECONDS;
    const labels = [0, 5, 10, 15, 20].map((age) => [end - age, age ? `−${age} s` : "now"]);
    drawLines(canvas, limits && { rows, count, limits, from, to: end, labels, gap: GAP_S, suspects });
  }
}

function begin(scene) {
  document.title = `Live: ${scene.robot}`;
  byId("robot").textContent = scene.robot;
  byId("unit").textContent = `[${scene.unit}]`;
  const handle = window.reproViewer?.mount(byId("shape"), scene.shape) ?? null;
  byId("no-shape").hidden = handle !== null;
  const n = scene.readings.length;
  const readings = new Traces(byId("readings"), n), residuals = new Traces(byId("residuals"), n, MOST_RESIDUAL);
  const entries = scene.readings.map((name, k) => {
    const entry = byId("values").appendChild(make("li"));
    entry.append(make("i"), make("span", name));
    entry.firstChild.style.backgroundColor = colour(k);
    return entry;
  });
  let latest = null, ended = "";

  function draw() {
    const now = latest;
    latest = null;
    if (handle && now.shape) handle.update(now.shape);
    fill(byId("numbers"), now.numbers.map((text) => text.replace(" -", " −")));
    fill(byId("notes"), now.notes);
    fill(byId("alarms"), now.alarms, "p");
    byId("raw").textContent = now.raw;
    const rows = Object.entries(now.summary).flat();
    if (byId("summary").children.length !== rows.length) {
      byId("summary").replaceChildren(...rows.map((text, k) => make(k % 2 ? "dd" : "dt", text)));
    } else fill(byId("summary"), rows);
    entries.forEach((entry, k) => {
      entry.lastChild.textContent = `${scene.readings[k]} ${now.readings?.[k]?.toPrecision(4).replace("-", "−") ?? "–"}`;
      entry.classList.toggle("suspect", now.suspects.includes(k));
    });
    doubt(now.numbers.length ? ended || now.doubt : "");
    readings.draw(now.suspects);
    residuals.draw(now.suspects);
  }

  /** Say of the shape that it is not to be trusted, and why in a word or two; or, without one, that it is. */
  function doubt(mark) {
    document.body.classList.toggle("doubtful", mark !== "" && mark !== "left out");
    for (const place of document.querySelectorAll(".mark")) if (place.textContent !== mark) place.textContent = mark;
  }

  function over(text) {
    say(text);
    ended = "the last one";
    if (byId("numbers").children.length) doubt(ended);
  }

  const events = new EventSource("/events");
  let opened = false;
  events.onopen = () => { if (opened) location.reload(); opened = true; }; // it may be another session
  events.onmessage = (event) => {
    const first = latest === null;
    latest = JSON.parse(event.data);
    if (latest.readings) {
      readings.add(latest.time_s, latest.readings, latest.age_s);
      residuals.add(latest.time_s, latest.residuals, latest.age_s);
    }
    say(latest.alarms.length ? "Alarm." : latest.numbers.length ? "Estimating." : "Waiting for readings.");
    if (first) requestAnimationFrame(draw); // a hidden page draws nothing, and catches up later
  };
  events.addEventListener("end", () => { events.close(); over("The session has ended."); });
  events.onerror = () => over(events.readyState !== EventSource.CLOSED ? "The connection is lost; trying again."
    : opened ? "This session is over. If it was started again, open the address that it prints now."
      : "Too many pages show this session. Close one of them, then load this page again.");
  window.addEventListener("error", ({ error }) => // a notice, such as of a ResizeObserver, has none
    error && (events.close(), over(`This page has failed (${error}). Load it again.`)));
}

fetch("/scene.json").then((answer) => answer.json()).then(begin, () => say("The session cannot be reached."));
