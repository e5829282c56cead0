// The page of a recording: a mark in the lines over time moves with the shape; alarms and notes lead to their time.
//
// Below "told" it finds times of rows and of what is drawn, as `repro_board.show` writes them:
//   from, to         first and last time of all [s]
//   said, at         {words, meaning, level} of a status, and the number of that of each frame of the shape; the level
//                    is 0 if all is well, 1 if the shape is to be trusted all the same, 2 if it is not
//   alarms           [from, to, number of rows, number in `said`]
//   notes            [time, text]
//   charts           {title, names, time_s, rows, thinned, gap_s}: `rows` has as many values for each time as `names`
"use strict";

const HANDLE = 16; // width of what is moved along a slider [px]
const BANDS = ["", "#e69f0050", "#e6000050"]; // behind the lines, by level
const told = JSON.parse(byId("told").textContent), element = document.querySelector(".shape-view");
const data = JSON.parse(element.querySelector("script").textContent), times = data.time_s;
const seconds = (time, unit = " s") => signed(time.toFixed(2)) + unit;
let current = 0, handle = null;

/** The frame whose time is nearest. */
function nearest(time) {
  let best = 0;
  times.forEach((t, i) => { if (Math.abs(t - time) < Math.abs(times[best] - time)) best = i; });
  return best;
}

const go = (i) => (handle ? handle.setFrame(i) : moved(i));

/** A list of buttons [time, text, level], each of which leads to its time. */
function list(place, entries) {
  for (const [time, text, level] of entries) {
    const button = make("button", text);
    Object.assign(button, { type: "button", onclick: () => go(nearest(time)) });
    button.dataset.level = level;
    place.appendChild(make("li")).append(button);
  }
  if (!entries.length) place.append(make("li", "None."));
}

/** A chart with its title, mark and names; what draws it has `plot`. */
function chart({ title, names, time_s, rows, thinned, gap_s }) {
  const [canvas, now, key] = [make("canvas"), make("div"), make("ul")], box = make("div");
  now.className = "now";
  key.className = "values";
  box.className = "chart";
  box.append(canvas, now);
  canvas.setAttribute("role", "img");
  canvas.setAttribute("aria-label", `${title} over time`);
  const seek = (event) => {
    const share = (event.offsetX - LEFT) / (canvas.clientWidth - LEFT - RIGHT);
    go(nearest(told.from + share * (told.to - told.from)));
  };
  canvas.onpointerdown = (event) => { canvas.setPointerCapture(event.pointerId); seek(event); };
  canvas.onpointermove = (event) => { if (event.buttons) seek(event); };
  const values = names.map((name, k) => {
    const entry = key.appendChild(make("li"));
    entry.append(make("i"), make("span", name));
    entry.firstChild.style.backgroundColor = colour(k);
    return entry.lastChild;
  });
  byId("charts").append(make("h2", title), box, key);
  const all = time_s.map((time, i) => [time, rows[i]]), [low, high] = extremes(all);
  const [at, digits] = ticks(told.from, told.to);
  const plot = low <= high && {
    rows: all, count: names.length, from: told.from, to: told.to, limits: widened(low, high), gap: gap_s,
    labels: at.map((time) => [time, `${signed(time.toFixed(digits))} s`]),
    bands: told.alarms.map(([from, to, , k]) => [from, to, BANDS[told.said[k].level]]), marks: told.notes.map(([time]) => time),
  };
  return { canvas, now, plot, tell(time) {
    if (thinned) return; // what is drawn there are extremes
    let row = null;
    for (const [t, x] of all) if (t <= time + 1e-6) row = x;
    values.forEach((place, k) => { place.textContent = `${names[k]} ${signed(String(row?.[k] ?? "–"))}`; });
  } };
}

const charts = told.charts.map(chart);

/** Show what belongs to a frame beside its shape. */
function moved(i) {
  current = Math.min(Math.max(i, 0), times.length - 1);
  const time = times[current], { words, meaning, level } = told.said[told.at[current]];
  const text = meaning ? `${words}: ${meaning}.` : `${words}.`;
  byId("time").value = current;
  byId("time").setAttribute("aria-valuetext", seconds(time));
  byId("clock").textContent = seconds(time);
  byId("status").dataset.level = level;
  if (byId("status").textContent !== text) byId("status").textContent = text;
  for (const { canvas, now, tell } of charts) {
    now.style.left = `${timeToX(canvas, told, time)}px`;
    tell(time);
  }
  [...byId("alarmed").querySelectorAll("button")].forEach((button, k) => {
    const [from, to] = told.alarms[k];
    if (from <= time && time <= to) button.setAttribute("aria-current", "time");
    else button.removeAttribute("aria-current");
  });
}

function draw() {
  for (const { canvas, plot } of charts) drawLines(canvas, plot);
  const at = (time) => timeToX(charts[0].canvas, told, time), x = told.notes.map(([time]) => at(time));
  byId("time").style.marginLeft = `${at(times[0]) - HANDLE / 2}px`;
  byId("time").style.width = `${at(times.at(-1)) - at(times[0]) + HANDLE}px`;
  byId("marks").replaceChildren(...told.notes.map(([, text], k) => {
    const mark = make("span", text);
    mark.style.left = `${x[k]}px`;
    mark.style.maxWidth = `${Math.max((x[k + 1] ?? charts[0].canvas.clientWidth) - x[k] - 8, 0)}px`;
    return mark;
  }));
  moved(current);
}

list(byId("alarmed"), told.alarms.map(([from, to, rows, k]) => {
  const when = rows > 1 ? `${seconds(from, "")} to ${seconds(to)}` : seconds(from);
  return [from, `${when}: ${told.said[k].words}, ${rows} row${rows > 1 ? "s" : ""}`, told.said[k].level];
}));
list(byId("noted"), told.notes.map(([time, text]) => [time, `${seconds(time)}: ${text}`, 0]));
byId("time").max = times.length - 1;
byId("time").oninput = () => go(Number(byId("time").value));
element.addEventListener("frame", (event) => moved(event.detail));
handle = window.reproViewer.mount(element, data);
byId("no-shape").hidden = handle !== null;
new ResizeObserver(draw).observe(byId("charts"));
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
