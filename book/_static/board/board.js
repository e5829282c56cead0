/* A sensor board in the browser: the page. A session takes bytes and times and knows no page; the page connects a port
   or plays an example, shows counters and traces, saves the recording, and with a robot file shows the shape. */
(function () {
"use strict";

const BINS = 800, BIN_S = reproTraces.SECONDS / BINS, MOST_TRACES = 12; // of the traces
const DETECT_BYTES = 600, DETECT_MS = 1500, SILENT_MS = 1000, GAP_MS = 250, SAVE_MS = 30000, SHAPE_REST = 20;
const BAUDS = [9600, 19200, 38400, 57600, 115200, 230400, 460800, 921600, 1000000, 2000000];
const nanoseconds = (ms) => BigInt(Math.round(ms * 1e6));

// ---- What came -----------------------------------------------------------------------------------------------------

/** Lowest, highest and last value of each channel in short intervals of time: as much, however fast a board is. */
class Traces {
  constructor() {
    this.names = [];
    this.places = new Map(); // of "stream value"
    this.bins = []; // [number, one [lowest, highest, last] for each trace]
  }

  add(ms, { stream, values }, label) {
    const number = Math.floor(ms / (1e3 * BIN_S));
    let bin = this.bins[this.bins.length - 1]; // a time before it counts as its own
    if (!bin || number > bin[0]) this.bins.push(bin = [number, []]);
    while (this.bins[0][0] < bin[0] - BINS) this.bins.shift();
    values.forEach((x, k) => {
      const key = stream + " " + k;
      if (!this.places.has(key)) {
        if (this.names.length >= MOST_TRACES) return;
        this.places.set(key, this.names.length);
        this.names.push(label(stream, k));
      }
      const place = this.places.get(key), seen = bin[1][place];
      if (!Number.isFinite(x)) return;
      if (!seen) bin[1][place] = [x, x, x];
      else bin[1][place] = [Math.min(seen[0], x), Math.max(seen[1], x), x];
    });
  }
}

/** Bytes in, counters, traces and a recording out; times in ms of one clock that only grows. */
class Session {
  /** `about`: port, baud, start_ms, start_unix_s; `format` "" is found out; `robot` says channels and unit. */
  constructor(format, about, robot = null, tell = () => {}) {
    Object.assign(this, { about, robot, tell, format, parser: null, recording: null, traces: new Traces(), newest: null, waiting: [], foreign: "", apart: [0] });
    Object.assign(this, { received: 0, reconnects: 0, lastFrame: -Infinity, lastByte: -Infinity, lost: false, rate: NaN, counted: [about.start_ms, 0], layout: null });
    if (format) this.begin(format);
  }

  begin(format) {
    this.format = format;
    const own = this.robot && this.robot.format === format ? this.robot : {};
    this.parser = BOARD.parser(format, format === "millivolts" || format === "csv" ? own.channels || null : null, own.unit ?? null);
  }

  get counters() {
    return { ...(this.parser ?? BOARD.parser("frames")).counters, reconnects: this.reconnects, received_bytes: this.received };
  }

  take(ms, chunk) {
    this.received += chunk.length;
    this.lastByte = ms;
    if (this.parser) this.read(ms, chunk);
    else {
      this.waiting.push([ms, chunk.slice()]);
      this.detect(ms);
    }
  }

  /** Find the format, once there are enough bytes for long enough. */
  detect(ms) {
    const { waiting } = this, size = waiting.reduce((total, [, chunk]) => total + chunk.length, 0);
    if (size < DETECT_BYTES || ms - (this.tried ?? waiting[0][0]) < DETECT_MS) return;
    const all = new Uint8Array(size);
    waiting.reduce((at, [, chunk]) => (all.set(chunk, at), at + chunk.length), 0);
    const format = BOARD.detected(all);
    if (!format) {
      this.foreign = `${this.received} bytes came that are of none of the formats. Is the rate that of the board?`;
      this.tried = ms;
      for (let rest = size; rest > 16384 && waiting.length > 1;) rest -= waiting.shift()[1].length;
      return;
    }
    const other = format === "hall" || format === "millivolts" ? " If these are other numbers, connect again with the format csv." : "";
    this.tell(`The format is ${format}.${other}`);
    this.begin(format);
    for (const [then, chunk] of this.waiting.splice(0)) this.read(then, chunk);
  }

  read(ms, chunk) {
    const frames = this.parser.feed(chunk);
    if (!frames.length) return;
    this.foreign = "";
    if (!this.layout && this.parser.layout) this.tell(`The lines have ${this.layout = this.parser.layout}.`);
    this.recording ??= new BOARD.Recording(this.description(frames[0].values.length));
    this.recording.append(nanoseconds(ms), frames);
    const { channels } = this.recording.metadata;
    const label = (stream, k) => (this.format === "quaternions" || stream ? stream + ": " : "") + (channels[k] ?? "u" + (k + 1));
    const passed = ms - this.lastFrame, since = passed < GAP_MS ? passed : 0; // what came together was sent one after the other
    frames.forEach((frame, k) => this.traces.add(ms - since * (1 - (k + 1) / frames.length), frame, label));
    if (Number.isFinite(passed)) this.apart = [...this.apart, passed].slice(-9);
    this.newest = frames.findLast((frame) => frame.stream === 0) ?? this.newest;
    this.lastFrame = ms;
  }

  description(width) {
    const { layout, format } = this, { port, baud, start_ms, start_unix_s, system } = this.about;
    const lines = layout ? { units: layout.value_units, lines: String(layout) } : {};
    const host = { port, baud, start_unix_s, start_host_ns: nanoseconds(start_ms), versions: { system } };
    return { format, channels: BOARD.channelNames(format, width, layout), ...lines, ...host };
  }

  /** The port is gone, or is back: what was begun is forgotten, so that nothing is joined that does not belong together. */
  happened(event, ms) {
    this.lost = event === "lost";
    if (event === "reopened") {
      this.reconnects += 1;
      this.parser?.reopened();
    }
    this.recording?.note({ event, host_ns: nanoseconds(ms) });
  }

  tick(ms) {
    const [since, before] = this.counted, { frames } = this.counters;
    if (ms - since < 1000) return;
    this.rate = 1000 * (frames - before) / (ms - since);
    this.counted = [ms, frames];
  }

  /** What the recorder writes beside a recording. */
  sidecar(ms, ended) {
    const seconds = (ms - this.about.start_ms) / 1000, first_malformed = this.parser.refused || null;
    return { ...this.recording.metadata, seconds, ended, counters: this.counters, first_malformed, clock: null };
  }

  silent(ms) {
    const median = this.apart.slice().sort((a, b) => a - b)[this.apart.length >> 1];
    return ms - this.lastFrame > Math.max(SILENT_MS, 3 * median); // also of a slow board
  }

  /** Why there are no readings, in a sentence that stays the same while this lasts; empty if there are. */
  silence(ms) {
    if (this.lost) return "The port is gone; waiting for it to come back.";
    if (!this.silent(ms)) return "";
    if (ms - this.lastByte < 2500 && !this.parser) return this.foreign || "Bytes arrive; their format is being found out.";
    if (ms - this.lastByte < 2500) return `Bytes arrive, but no frame of the format ${this.format}.`;
    return `No readings: nothing arrives${this.counters.frames ? " any more" : ""}.`;
  }
}

// ---- The page ------------------------------------------------------------------------------------------------------

function make(tag, attributes = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name === "text") made.textContent = value;
    else if (name.startsWith("on")) made.addEventListener(name.slice(2), value);
    else made.setAttribute(name, value);
  }
  made.append(...children);
  return made;
}

const put = (place, text) => { if (place.textContent !== text) place.textContent = text; };

/** Texts into a list, reusing its entries. */
function fill(list, texts) {
  while (list.children.length > texts.length) list.lastChild.remove();
  texts.forEach((text, k) => put(list.children[k] ?? list.appendChild(make("li")), text));
}

function download(blob, name) {
  const link = make("a", { href: URL.createObjectURL(blob), download: name });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
}

const SHOWN_COUNTERS = {
  frames: "accepted", rate: "per second", gaps: "lost", corrupt: "corrupt", repeats: "sent twice", restarts: "restarts of the board",
  reconnects: "times the port was back", first_partial: "cut off at an opening", discarded_bytes: "bytes discarded", received_bytes: "bytes received",
};

class Board {
  constructor(box) {
    Object.assign(this, { box, session: null, port: null, robot: null, follower: null, handle: null, paused: false, kept: "", drawMs: [], factor: 1 });
    const button = (text, act, more = {}) => make("button", { type: "button", text, onclick: act, ...more });
    const option = ([value, text]) => make("option", { value, text });
    this.connecting = button("Connect a board …", () => (this.port ? this.disconnect() : this.connect()));
    this.example = button("Play an example", () => this.play());
    this.pausing = button("Pause the view", () => this.pause(), { "aria-pressed": "false", disabled: "" });
    this.saving = button("Save the recording …", () => this.save(), { disabled: "" });
    this.counting = button("Save the counters …", () => this.saveCounters(), { disabled: "" });
    this.baud = make("select", {}, ...BAUDS.map((baud) => option([baud, `${baud} baud`])));
    this.baud.value = 115200;
    this.format = make("select", {}, ...[["", "found out"], ...BOARD.FORMATS.map((name) => [name, name])].map(option));
    this.file = make("input", { type: "file", multiple: "", accept: ".toml,.json", onchange: () => this.files(this.file.files) });
    this.grown = make("input", { type: "number", min: "0", step: "any", value: "1", onchange: () => this.grow() });
    const field = (text, input) => make("label", {}, text + " ", input);
    this.status = make("p", { class: "board-status", role: "status", "aria-live": "polite" });
    this.notes = make("p", { class: "board-notes", role: "status", "aria-live": "polite" });
    this.numbers = Object.fromEntries(Object.keys(SHOWN_COUNTERS).map((name) => [name, make("dd", { text: "0" })]));
    const counters = make("dl", {}, ...Object.entries(SHOWN_COUNTERS).map(([name, text]) => make("div", {}, make("dt", { text }), this.numbers[name])));
    this.canvas = make("canvas", { role: "img", "aria-label": `Readings of the last ${reproTraces.SECONDS} seconds; the last values stand below.` });
    this.values = make("ul", { class: "board-values" });
    this.shape = make("div", { class: "board-shape" });
    this.quantities = make("ul", { class: "board-quantities" });
    this.troubles = make("ul", { class: "board-troubles" });
    this.title = make("h3", { text: "Shape" });
    this.about = make("p", { text: "Drop a robot file here or choose it below, and its calibration if there is one." });
    this.remarks = make("ul", { class: "board-remarks" });
    this.mark = make("span", { class: "board-mark" });
    box.replaceChildren(
      make("div", { class: "board-bar" }, this.connecting, field("Rate", this.baud), field("Format", this.format), this.example),
      this.status, this.notes,
      make("div", { class: "board-bar" }, this.pausing, this.saving, this.counting),
      make("h3", { text: "Frames or lines" }), counters, this.troubles,
      make("h3", { text: "Readings" }), this.canvas, this.values,
      this.title, this.about, this.remarks, this.mark, this.shape, this.quantities,
      make("div", { class: "board-bar" }, field("Robot file, calibration", this.file), field("Deviations grown by (the factor that repro fit states)", this.grown)),
    );
    if (!navigator.serial) {
      this.connecting.disabled = true;
      this.say("This browser cannot open serial ports: Firefox and Safari have no Web Serial. Chrome, Edge and Chromium have it, on Windows, macOS and Linux. The example plays here, too.");
    } else {
      this.say("Not connected.");
      navigator.serial.addEventListener("connect", (event) => this.back(event.target));
    }
    for (const kind of ["dragover", "drop"]) box.addEventListener(kind, (event) => event.preventDefault());
    box.addEventListener("drop", (event) => this.files(event.dataTransfer.files));
    addEventListener("beforeunload", (event) => { if (this.unsaved()) event.preventDefault(); });
    new ResizeObserver(() => { if (this.session) this.lines(performance.now()); }).observe(this.canvas);
    setInterval(() => this.autosave(), SAVE_MS);
    box.board = this;
    const loop = () => {
      if (!box.isConnected) return;
      requestAnimationFrame(loop);
      if (this.session && !this.paused) this.draw(performance.now());
    };
    requestAnimationFrame(loop);
  }

  say(text) { put(this.status, text); }

  note(text) { put(this.notes, text); }

  unsaved() {
    const recording = this.session?.recording;
    return Boolean(recording && !this.session.about.example && recording.bytes > recording.saved && this.kept !== recording.bytes);
  }

  /** A new session, once what the last one recorded may go. */
  open(port, baud, format, example = false) {
    if (this.unsaved() && !confirm("The recording of the last session is not saved. Discard it?")) return false;
    const about = { port, baud, start_ms: performance.now(), start_unix_s: Date.now() / 1000, system: navigator.userAgent, example };
    this.session = new Session(format, about, this.robot, (text) => this.note(text));
    this.note("");
    if (this.robot) this.follow();
    for (const one of [this.pausing, this.saving, this.counting]) one.disabled = false;
    return true;
  }

  // ---- The port ----------------------------------------------------------------------------------------------------

  async connect() {
    let port;
    try {
      port = await navigator.serial.requestPort();
    } catch (error) {
      this.say(error.name === "NotFoundError" ? "No port was chosen." : `The port cannot be used: ${error.message}`);
      return;
    }
    try {
      await port.open({ baudRate: Number(this.baud.value), bufferSize: 65536 });
    } catch (error) {
      this.say(`The port cannot be opened: ${error.message} Another program may hold it, such as the monitor of an Arduino.`);
      return;
    }
    const { usbVendorId, usbProductId } = port.getInfo(), hex = (x) => x.toString(16).padStart(4, "0");
    const name = usbVendorId === undefined ? "serial port" : `USB ${hex(usbVendorId)}:${hex(usbProductId)}`;
    if (!this.open(name, Number(this.baud.value), this.format.value)) {
      await port.close();
      return;
    }
    this.port = port;
    put(this.connecting, "Disconnect");
    await this.listen(port);
  }

  /** Read until the port is closed or gone. */
  async listen(port) {
    const { session } = this;
    while (this.port === port && port.readable) {
      this.reader = port.readable.getReader();
      try {
        for (let end = false; !end;) {
          const { value, done } = await this.reader.read();
          if (value) this.take(session, performance.now(), value);
          end = done;
        }
        if (this.port !== port) break;
      } catch (error) {
        if (port.readable) this.note(`The port reported an error: ${error.message}`); // a break, or bytes that were lost: it goes on
        session.parser?.reopened();
      } finally {
        this.reader.releaseLock();
      }
    }
    if (this.port !== port) return;
    session.happened("lost", performance.now());
    await port.close().catch(() => {});
  }

  take(session, ms, bytes) {
    try {
      session.take(ms, bytes);
    } catch (error) { // of lines that say another unit than the robot file
      this.note(error.message);
      this.disconnect();
    }
  }

  /** The port that was lost is there again. */
  async back(port) {
    const alike = (a, b) => a.usbVendorId === b.usbVendorId && a.usbProductId === b.usbProductId;
    if (!this.port || !this.session?.lost || !(port === this.port || alike(port.getInfo(), this.port.getInfo()))) return;
    try {
      await port.open({ baudRate: this.session.about.baud, bufferSize: 65536 });
    } catch (error) {
      this.note(`The port is back, but cannot be opened: ${error.message}`);
      return;
    }
    this.port = port;
    this.session.happened("reopened", performance.now());
    await this.listen(port);
  }

  async disconnect() {
    const { port } = this;
    this.port = null;
    this.stop("Disconnected.");
    await this.reader?.cancel().catch(() => {});
    await port?.close().catch(() => {});
  }

  stop(text) {
    if (this.paused) this.pause();
    this.shapeDue = 0;
    if (this.session) this.draw(performance.now());
    if (this.session) this.session.ended = text;
    put(this.connecting, "Connect a board …");
    if (this.follower?.q) {
      put(this.mark, this.mark.textContent || "the last one");
      this.box.classList.add("board-doubtful");
    }
    this.say(text);
    this.autosave();
  }

  /** Recorded bytes of an emulated board, in the time they took. */
  play() {
    const { robot, frames, seconds } = BOARD.example, bytes = Uint8Array.from(atob(frames), (c) => c.charCodeAt(0));
    if (this.port) this.disconnect();
    this.describe("example.toml", robot);
    if (!this.open("example, synthetic", 0, "frames", true)) return;
    const { session } = this, began = performance.now();
    let sent = 0;
    const step = () => {
      if (this.session !== session) return;
      const share = Math.min((performance.now() - began) / (1e3 * seconds), 1), end = Math.floor(share * bytes.length);
      if (end > sent) this.take(session, performance.now(), bytes.subarray(sent, end));
      sent = end;
      if (share < 1) setTimeout(step, 20);
      else this.stop("The example is over. Its readings are synthetic.");
    };
    step();
  }

  // ---- What is shown -----------------------------------------------------------------------------------------------

  pause() {
    this.paused = !this.paused;
    put(this.pausing, this.paused ? "Go on" : "Pause the view");
    this.pausing.setAttribute("aria-pressed", this.paused);
    if (this.paused) this.say("The view is paused; reading and recording go on.");
  }

  draw(now) {
    const { session } = this, began = performance.now();
    if (session.ended) return;
    session.tick(now);
    const { counters } = session, corrupt = BOARD.dropped(counters), silence = session.silence(now);
    const shown = { ...counters, corrupt, rate: Number.isFinite(session.rate) ? session.rate.toFixed(1) : "–" };
    for (const [name, place] of Object.entries(this.numbers)) put(place, String(shown[name]));
    const late = this.estimate(session, now, silence);
    this.say([silence, ...late.alerts].filter(Boolean).join(" ") || (counters.frames ? "Receiving." : "Connected; no frame yet."));
    const first = session.parser?.refused ? ` The first line or frame that does not fit: ${session.parser.refused}` : "";
    const mostly = corrupt >= 20 && corrupt > counters.frames ? [`Most of what arrives is not ${session.format}.${first}`] : first ? [first.trim()] : [];
    fill(this.troubles, [...mostly, ...late.troubles]);
    this.lines(now);
    this.drawMs.push(performance.now() - began);
    if (this.drawMs.length > 600) this.drawMs.shift();
  }

  /** Traces: a line through the lowest and highest values of each interval; nothing where nothing came. */
  lines(now) {
    const { names, bins } = this.session.traces, last = now / (1e3 * BIN_S);
    let low = Infinity, high = -Infinity;
    for (const [, all] of bins) for (const seen of all) if (seen) [low, high] = [Math.min(low, seen[0]), Math.max(high, seen[1])];
    const typical = bins.length && Math.max(GAP_MS / (1e3 * BIN_S), 3 * (bins[bins.length - 1][0] - bins[0][0]) / bins.length); // longer is a gap
    reproTraces.draw(this.canvas, low <= high ? reproTraces.roomy(low, high) : null, names.length, (k, to) => {
      let before = -Infinity;
      for (const [number, all] of bins) {
        const age = (last - number) * BIN_S;
        if (!all[k] || age > reproTraces.SECONDS) continue;
        to(age, all[k][0], number - before <= typical);
        if (all[k][1] > all[k][0]) to(age, all[k][1], true);
        before = number;
      }
    });
    if (low > high) return;
    const newest = bins[bins.length - 1][1];
    fill(this.values, names.map((name, k) => `${name} ${newest[k] ? newest[k][2].toPrecision(4) : "—"}`));
    [...this.values.children].forEach((entry, k) => entry.style.setProperty("--trace", reproTraces.colour(k)));
  }

  // ---- The robot ---------------------------------------------------------------------------------------------------

  async files(files) {
    const all = [...files].sort((a, b) => a.name.endsWith(".json") - b.name.endsWith(".json")); // the robot comes first
    for (const file of all) {
      const bytes = new Uint8Array(await file.arrayBuffer());
      let text;
      try {
        text = new TextDecoder("utf-8", { fatal: true }).decode(bytes);
      } catch {
        this.note(`Input file of ${file.name} must be text in UTF-8; instead received other bytes.`);
        continue;
      }
      if (file.name.endsWith(".json")) await this.calibrate(file.name, text);
      else this.describe(file.name, text, bytes);
    }
  }

  describe(name, text, bytes) {
    try {
      this.robot = BOARD.robotOf(name, text, bytes);
    } catch (error) {
      this.note(error.message);
      return;
    }
    this.format.value = this.robot.format;
    this.note(`${name} describes ${this.robot.body.segments} segments with ${this.robot.channel.length} sensors.`);
    this.follow();
  }

  async calibrate(name, text) {
    try {
      if (!this.robot) throw new Error(`Input calibration ${name} must be given after its robot file; instead received it alone.`);
      this.robot = await BOARD.calibrated(this.robot, name, text);
    } catch (error) {
      this.note(error.message);
      return;
    }
    this.note(`${this.robot.name} is calibrated by ${name}.`);
    this.follow();
  }

  follow() {
    this.handle?.dispose();
    Object.assign(this, { follower: new BOARD.Follower(this.robot, this.factor), stale: false, shapeDue: 0 });
    put(this.title, `Shape of ${this.robot.name}`);
    put(this.about, "");
    fill(this.remarks, this.robot.notes);
    this.handle = window.reproViewer?.mount(this.shape, this.follower.scene()) ?? null;
    if (!this.handle) put(this.about, "This browser has no WebGL: the shape is not drawn. Its numbers are below.");
  }

  /** State deviations so many times larger, also those that are shown at the moment. */
  grow() {
    const given = Number(this.grown.value), { follower } = this;
    if (!(given > 0 && given < Infinity)) {
      this.note(`Input deviations grown by must be a positive number; instead received ${this.grown.value || "none"}.`);
      this.grown.value = this.factor;
      return;
    }
    this.factor = given;
    if (!follower) return;
    follower.grown = given;
    if (!follower.q) return;
    fill(this.quantities, follower.quantities());
    this.handle?.update(follower.frame());
  }

  /** Estimate from the newest frame; {alerts, troubles} in sentences. */
  estimate(session, now, silence) {
    const { follower } = this;
    if (!follower) return { alerts: [], troubles: [] };
    if (session.format && session.format !== this.robot.format) {
      return { alerts: [`${this.robot.name} has the format ${this.robot.format}, and the port is read as ${session.format}: connect again.`], troubles: [] };
    }
    if (session.newest && session.newest !== this.estimated) {
      this.estimated = session.newest;
      follower.step(session.newest.values);
      this.stale = true;
      if (follower.q) fill(this.quantities, follower.quantities());
    }
    if (this.handle && follower.q && this.stale && now >= this.shapeDue) {
      const began = performance.now();
      this.handle.update(follower.frame());
      this.shapeDue = now + SHAPE_REST * (performance.now() - began); // without a graphics card a picture takes long
      this.stale = false;
    }
    const mark = !follower.q ? "" : silence ? `${((now - session.lastFrame) / 1000).toFixed(0)} s old` : follower.mark();
    put(this.mark, mark);
    this.box.classList.toggle("board-doubtful", mark !== "");
    return { alerts: silence ? [] : follower.alerts(), troubles: follower.troubles(Boolean(silence)) };
  }

  // ---- The recording -----------------------------------------------------------------------------------------------

  async save() {
    const recording = this.session?.recording;
    if (!recording) {
      this.note("There is nothing to save: no frame has come.");
      return;
    }
    if (!window.showSaveFilePicker) {
      const blob = recording.blob();
      download(blob, "recording.rec");
      this.kept = recording.bytes;
      this.note(`${recording.frames} frames were saved as a download; press again for those that come later.`);
      return;
    }
    try {
      recording.handle ??= await showSaveFilePicker({ suggestedName: "recording.rec" });
    } catch (error) {
      if (error.name !== "AbortError") this.note(`The recording is not saved: ${error.message}`);
      return;
    }
    await this.autosave(true);
  }

  /** What has come since is put into the file that was chosen: twice a minute, and at the end. */
  async autosave(asked = false) {
    const recording = this.session?.recording;
    if (!recording?.handle) return;
    try {
      await recording.save();
      if (asked) this.note(`${recording.handle.name} has all frames up to now; later ones follow twice a minute, and at the end.`);
    } catch (error) {
      this.note(`Writing ${recording.handle.name} failed: ${error.message} What came since is kept here; press Save again.`);
    }
  }

  saveCounters() {
    if (!this.session?.recording) {
      this.note("There is nothing to save: no frame has come.");
      return;
    }
    const text = JSON.stringify(this.session.sidecar(performance.now(), this.session.ended ? "stopped" : null), (_, x) => (typeof x === "bigint" ? Number(x) : x), 1);
    download(new Blob([text + "\n"], { type: "application/json" }), "recording.rec.json");
  }
}

function start() {
  for (const box of document.querySelectorAll(".board")) new Board(box);
}

Object.assign(BOARD, { Session, Traces, Board });
if (document.readyState === "complete") start();
else addEventListener("DOMContentLoaded", start);
})();
