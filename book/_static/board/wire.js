/* The wire formats in the browser: what the parsers of `edition1_live.wire` do, under the same names and with the same
   counters. No dependency, no page needed. A test compares both on a hundred thousand damaged frames and lines. */
(function () {
"use strict";

const WRAP = 2 ** 32, LONGEST_PACKET = 253, MOST_VALUES = 118, AGREEING = 3, MOST_HELD = 32, LONGEST_LINE = 4096, LATEST = 1e16;
const FORMATS = ["frames", "hall", "millivolts", "quaternions", "csv"];
const RESERVED = ["time_s", "host_ns", "stream", "sequence", "device_us"];

/** Text as Python writes it between quotes. */
function quoted(text) {
  const quote = text.includes("'") && !text.includes('"') ? '"' : "'";
  const known = { "\t": "\\t", "\n": "\\n", "\r": "\\r", "\\": "\\\\", [quote]: "\\" + quote };
  const hex = (code, digits) => code.toString(16).padStart(digits, "0");
  const escaped = (code) => (code < 256 ? "\\x" + hex(code, 2) : code < 65536 ? "\\u" + hex(code, 4) : "\\U" + hex(code, 8));
  return quote + Array.from(text, (c) => known[c] ?? (/[\p{C}\p{Z}]/u.test(c) && c !== " " ? escaped(c.codePointAt(0)) : c)).join("") + quote;
}

const latin = (bytes) => String.fromCharCode(...bytes);
const withoutReturn = (bytes) => (bytes[bytes.length - 1] === 13 ? bytes.subarray(0, -1) : bytes);
const sameBytes = (a, b) => a.length === b.length && a.every((x, k) => x === b[k]);
const same = (a, b) => JSON.stringify(a) === JSON.stringify(b);

/** Bytes in, frames {stream, sequence, device_us, values} out; chunks may be cut anywhere. */
class Parser {
  constructor(delimiter, longest) {
    Object.assign(this, { delimiter, longest, begun: new Uint8Array(0), oversized: false, opened: true, refused: "" });
    this.counters = {
      frames: 0, checksum_errors: 0, malformed: 0, oversized: 0, first_partial: 0, gaps: 0, restarts: 0, repeats: 0, discarded_bytes: 0,
    };
  }

  feed(chunk) {
    const frames = this.frames(...this.split(chunk));
    this.counters.frames += frames.length;
    return frames;
  }

  /** Forget a packet begun: the next may be the end of one only. */
  reopened() {
    this.dropBegun();
    Object.assign(this, { oversized: false, opened: true });
  }

  refuse(size, why) {
    this.counters.malformed += 1;
    this.counters.discarded_bytes += size;
    this.refused = this.refused || why;
  }

  /** Whole packets without delimiters, and whether the first of them may be cut off in front. */
  split(chunk) {
    const data = new Uint8Array(this.begun.length + chunk.length);
    data.set(this.begun);
    data.set(chunk, this.begun.length);
    let packets = [], start = 0, cut = false;
    for (let end; (end = data.indexOf(this.delimiter, start)) >= 0; start = end + 1) packets.push(data.subarray(start, end));
    this.begun = data.slice(start);
    if (packets.length) {
      [cut, this.opened] = [this.opened, false];
      if (this.oversized) {
        this.counters.discarded_bytes += packets.shift().length;
        this.oversized = cut = false;
      }
      const long = (packet) => packet.length > this.longest;
      if (packets.some(long)) {
        cut = cut && !long(packets[0]);
        for (const packet of packets.filter(long)) {
          this.counters.oversized += 1;
          this.counters.discarded_bytes += packet.length;
        }
        packets = packets.filter((packet) => !long(packet));
      }
    }
    if (this.oversized) this.dropBegun();
    else if (this.begun.length > this.longest) {
      this.oversized = true;
      this.counters.oversized += 1;
      this.dropBegun();
    }
    return [packets, cut];
  }

  dropBegun() {
    this.counters.discarded_bytes += this.begun.length;
    this.begun = new Uint8Array(0);
  }
}

// ---- Our own frames: COBS between zero bytes, CRC-32 -----------------------------------------------------------------

const CRC_TABLE = Uint32Array.from({ length: 256 }, (_, k) => {
  for (let bit = 0; bit < 8; bit++) k = k & 1 ? (k >>> 1) ^ 0xedb88320 : k >>> 1;
  return k;
});

/** CRC-32 of bytes, behind others whose CRC is `before`. */
function crc32(bytes, before = 0) {
  let crc = ~before;
  for (const byte of bytes) crc = CRC_TABLE[(crc ^ byte) & 255] ^ (crc >>> 8);
  return ~crc >>> 0;
}

/** The bytes before COBS; none if they are not COBS. */
function decoded(packet) {
  const body = new Uint8Array(packet.length);
  let at = 0, n = 0;
  while (at < packet.length) {
    const end = at + packet[at];
    if (end > packet.length) return new Uint8Array(0);
    body.set(packet.subarray(at + 1, end), n);
    n += end - at - 1;
    if (packet[at] < 255 && end < packet.length) body[n++] = 0;
    at = end;
  }
  return body.subarray(0, n);
}

/** Bytes of a value and how many values a frame holds at most, by the type in the frame. */
const KINDS = { 1: [4, 59], 2: [2, 118] };

class BinaryParser extends Parser {
  constructor(channels) {
    super(0, LONGEST_PACKET);
    this.channels = channels;
    this.last = new Map(); // by stream: sequence number and bytes of the last frame
  }

  frames(packets, cut) {
    const frames = [], { counters } = this;
    for (const packet of packets) {
      const begun = cut;
      cut = false;
      if (!packet.length) continue;
      const body = decoded(packet);
      if (crc32(body) !== 0x2144df1c) { // that of any bytes followed by their own CRC-32
        counters[begun ? "first_partial" : "checksum_errors"] += 1;
        counters.discarded_bytes += packet.length;
        continue;
      }
      const [version, stream, type, count] = body, kind = KINDS[type], known = kind && count >= 1 && count <= kind[1];
      const wanted = known && (this.channels === null || count === this.channels);
      if (!wanted || body.length !== 16 + kind[0] * count || version !== 1) {
        this.refuse(packet.length, "a frame of " + (known && version === 1 ? count + " values" : "another version or length"));
        continue;
      }
      const view = new DataView(body.buffer, body.byteOffset), sequence = view.getUint32(4, true), before = this.last.get(stream);
      const step = before ? (sequence - before[0] + WRAP) % WRAP : 1;
      if (step !== 1) {
        if (sameBytes(packet, before[1])) {
          counters.repeats += 1;
          counters.discarded_bytes += packet.length;
          continue;
        }
        if (step > 1 && step < WRAP / 2) counters.gaps += step - 1;
        else counters.restarts += 1;
      }
      this.last.set(stream, [sequence, packet.slice()]);
      const value = (k) => (type === 1 ? view.getFloat32(12 + 4 * k, true) : view.getInt16(12 + 2 * k, true));
      frames.push({ stream, sequence, device_us: view.getUint32(8, true), values: Array.from({ length: count }, (_, k) => value(k)) });
    }
    return frames;
  }
}

// ---- Lines of the papers -------------------------------------------------------------------------------------------

const WHOLE = /^(?:0|-?[1-9][0-9]{0,3})$/, NUMBER = /^-?[0-9]+(?:\.[0-9]+)?(?:[eE][-+]?[0-9]{1,3})?$/, IDENTITY = /^(?:0|[1-9][0-9]{0,2})$/;
const NORM_TOLERANCE = 1e-3, LONGEST_FIELD = 25;
const LINES = {
  hall: { count: 3, lowest: -8192, highest: 8191, form: WHOLE },
  millivolts: { count: 3, lowest: 0, highest: 2048, form: NUMBER },
  quaternions: { count: 4, lowest: -1 - NORM_TOLERANCE, highest: 1 + NORM_TOLERANCE, form: NUMBER, quaternion: true },
};

class TextParser extends Parser {
  constructor(line) {
    super(10, LONGEST_FIELD * (line.count + (line.quaternion ? 1 : 0)));
    this.line = line;
  }

  read(text) {
    const { count, lowest, highest, form, quaternion } = this.line, fields = text.split(",");
    if (fields.length !== count + (quaternion ? 1 : 0)) return null;
    const first = quaternion ? fields.shift() : "0";
    if (!IDENTITY.test(first) || Number(first) > 255 || !fields.every((field) => form.test(field))) return null;
    const values = fields.map(Number);
    if (!values.every((x) => lowest <= x && x <= highest)) return null;
    if (quaternion && !(Math.abs(Math.hypot(...values) - 1) <= NORM_TOLERANCE)) return null;
    if (quaternion) values.push(values.shift()); // w, x, y, z become x, y, z, w
    return { stream: Number(first), sequence: null, device_us: null, values };
  }

  frames(packets, cut) {
    if (cut) {
      this.counters.first_partial += 1;
      this.counters.discarded_bytes += packets.shift().length;
    }
    return packets.flatMap((raw) => {
      const frame = this.read(latin(withoutReturn(raw)));
      if (frame) return [frame];
      const shown = latin(withoutReturn(raw.subarray(0, 80)));
      // bytes are written as Latin-1 with everything that is no ASCII escaped
      this.refuse(raw.length, quoted(shown).replace(/[\x7f-\xff]/g, (c) => "\\x" + c.charCodeAt(0).toString(16)));
      return [];
    });
  }
}

// ---- Lines of numbers as sketches print them -----------------------------------------------------------------------

const SEPARATORS = { ";": "semicolons", ",": "commas", "\t": "tabs", " ": "blanks" };
const LETTER = "A-Za-zµμΩ°%", NAN = "[nN][aA][nN]";
const DECIMAL = `[+-]?(?:[0-9]+(?:\\.[0-9]*)?|\\.[0-9]+)(?:[eE][+-]?[0-9]{1,3})?|[+-]?${NAN}(?![A-Za-z])`;
const UNIT = `(?![xXbB][0-9]|[eE](?![${LETTER}])|(?:${NAN}|[iI][nN][fF]|[oO][vV][fF])(?![${LETTER}]))[${LETTER}][${LETTER}/²³^*]*(?:[0-9](?![0-9${LETTER}]))?`;
const LABEL = `[${LETTER}_][${LETTER}0-9_ .()\\[\\]/#-]*?`, WORD = `[${LETTER}_][${LETTER}0-9_.()\\[\\]/#-]*?`;
const FIELD = new RegExp(`^(?:(?:(${LABEL})[ \\t]*[:=][ \\t]*)?(${DECIMAL})[ \\t]*(${UNIT})?)$`);
const ITEM = new RegExp(`(?:(${WORD})[ ]*[:=][ ]*)?(${DECIMAL})(?:[ ]*(${UNIT})(?![ ]*[:=]))?(?:[ ]+|$)`, "y");
const NAME = new RegExp(`^[${LETTER}_][${LETTER}0-9_ .()\\[\\]/²³^*#-]*$`);
const DECIMAL_COMMAS = /^[+-]?[0-9]+,[0-9]+(?:,[ ]+[+-]?[0-9]+,[0-9]+)+$/, NO_NUMBER = /^[+-]?(?:nan|inf|infinity|ovf)$/i;
const WHITE = /[\t-\r\x1c-\x20\x85\xa0\u1680\u2000-\u200a\u2028\u2029\u202f\u205f\u3000]+/;
const UNITS = ["nT", "uT", "µT", "μT", "mT", "mG", "gauss", "uV", "µV", "mV", "V", "counts", "raw", "deg", "rad"];
const TIME_UNITS = new Map([["s", 1e6], ["sec", 1e6], ["ms", 1e3], ["us", 1], ["µs", 1], ["μs", 1]]);
const TIME_NAMES = new Map([
  ["time", ""], ["t", ""], ["timestamp", ""], ["seconds", "s"], ["sec", "s"],
  ["millis", "ms"], ["milliseconds", "ms"], ["ms", "ms"], ["micros", "us"], ["microseconds", "us"], ["us", "us"],
]);

const stripped = (text) => text.replace(/^[ \t]+|[ \t]+$/g, "");
const separatorOf = (text) => Object.keys(SEPARATORS).find((separator) => text.includes(separator) || separator === " ");
const textOf = (raw) => new TextDecoder("utf-8", { ignoreBOM: true }).decode(withoutReturn(raw));

function nameAndUnit(text) {
  const match = /^(.*?)[ _]*[(\[][ ]*(.*?)[ ]*[)\]]$/s.exec(text);
  if (match) return [match[1], match[2]];
  const at = text.lastIndexOf("_"), name = text.slice(0, Math.max(at, 0)), unit = text.slice(at + 1);
  const known = UNITS.includes(unit) || (TIME_UNITS.has(unit) && TIME_NAMES.has(name.toLowerCase()));
  return name && known ? [name, unit] : [text, ""];
}

/** Microseconds of a unit of a column of times; 0 if its unit is not said, null if it is no time. */
function timeScale(name, unit) {
  if (name === "T" || !TIME_NAMES.has(name.toLowerCase())) return null;
  return TIME_UNITS.get(unit || TIME_NAMES.get(name.toLowerCase())) ?? 0;
}

function mayBeCut(name) {
  const whole = [...TIME_NAMES.keys(), ...["time", "t", "timestamp"].flatMap((n) => [...TIME_UNITS.keys()].map((unit) => n + "_" + unit))];
  name = name.toLowerCase();
  return timeScale(...nameAndUnit(name)) === null && whole.some((text) => text.endsWith(name));
}

/** {separator, labels, units, trailing, values} of a line, or in words why it holds no numbers. */
function readLine(text) {
  text = stripped(text);
  const separator = separatorOf(text), found = [];
  let trailing = false;
  if (separator === " ") {
    for (let at = 0; at < text.length || !found.length; at = ITEM.lastIndex) {
      ITEM.lastIndex = at;
      const match = ITEM.exec(text);
      if (!match) return text ? quoted(text.slice(at)) + " is no number with a decimal point" : "the line is empty";
      found.push(match.slice(1));
    }
  } else {
    const fields = text.split(separator).map(stripped);
    trailing = fields.length > 1 && !fields[fields.length - 1];
    if (trailing) fields.pop();
    for (const field of fields) {
      const match = FIELD.exec(field);
      if (!match) return field ? quoted(field) + " is no number with a decimal point" : "a field is empty";
      found.push(match.slice(1));
    }
  }
  const [labels, numbers, units] = [0, 1, 2].map((k) => found.map((groups) => groups[k] ?? ""));
  if (labels.some(Boolean) && !labels.every(Boolean)) return "some numbers have a label, others have none";
  const values = numbers.map(Number);
  if (values.some((x) => Math.abs(x) === Infinity)) return "a number is too large";
  return { separator, labels, units, trailing, values };
}

function readHeader(text) {
  text = stripped(text);
  const separator = separatorOf(text);
  let end = text.length;
  while (end && (separator + " \t").includes(text[end - 1])) end -= 1;
  const fields = separator === " " ? text.split(WHITE).filter(Boolean) : text.slice(0, end).split(separator);
  const names = fields.map((field) => stripped(field).replace(/^"+|"+$/g, ""));
  return names.every((name) => NAME.test(name) && !NO_NUMBER.test(name)) ? names : [];
}

/** The form of the lines of a board. */
class Layout {
  constructor({ separator, labels, units, trailing }, header) {
    Object.assign(this, { separator, labels, units, trailing, header });
    const named = header.length ? header : labels;
    const withUnits = (all) => named.map(nameAndUnit).map(([name, byName], k) => [name, all[k] || byName]);
    const time = withUnits(units).findIndex((pair) => timeScale(...pair) !== null);
    const all = [...units], values = units.map((_, k) => k).filter((k) => k !== time), last = values[values.length - 1];
    if (values.length && all[last] && !values.slice(0, -1).some((k) => all[k])) for (const k of values) all[k] = all[last];
    const columns = withUnits(all), own = columns.filter((_, k) => k !== time);
    // of names, and of what is asked of a line, JSON must not compare more
    for (const [key, value] of Object.entries({ time, columns, value_units: own.map(([, unit]) => unit), names: namesOf(own) })) {
      Object.defineProperty(this, key, { value });
    }
  }

  toString() {
    const n = this.names.length, by = SEPARATORS[this.separator];
    const text = `${n} value${n > 1 ? "s" : ""} a line${this.units.length > 1 ? `, separated by ${by}` : ""}: ${this.names.join(", ")}`;
    if (this.time < 0) return text;
    const [name, unit] = this.columns[this.time];
    if (timeScale(name, unit)) return `${text}; times in ${name}`;
    return `${text}; ${name} is a time without a unit and is left out, times are those of arrival`;
  }
}

function namesOf(columns) {
  const plain = columns.map(([name]) => name.replace(/[^\p{L}\p{N}_]+/gu, "_").replace(/^_+|_+$/g, ""));
  const numbered = plain.map((_, k) => "u" + (k + 1));
  for (const names of [plain, numbered]) {
    const found = names.map((name, k) => (columns[k][1] ? name + "_" + columns[k][1] : name));
    if (!names.includes("") && new Set(found).size === found.length && !found.some((name) => RESERVED.includes(name))) return found;
  }
  return numbered;
}

class CsvParser extends Parser {
  constructor(channels, unit) {
    super(10, LONGEST_LINE);
    Object.assign(this, { layout: null, channels, unit, header: [], headerSeparator: "", otherHeader: false, held: [] });
  }

  reopened() {
    super.reopened();
    this.otherHeader = false;
    for (const [, , raw] of this.held.splice(0)) this.drop(raw, "too few lines before the port was opened anew");
  }

  frames(packets, cut) {
    const frames = [];
    if (cut) {
      this.counters.first_partial += 1;
      this.counters.discarded_bytes += packets[0].length;
      this.named(textOf(packets.shift()), true);
    }
    for (const raw of packets) if (withoutReturn(raw).some((byte) => byte !== 32 && byte !== 9)) frames.push(...this.one(raw));
    return frames;
  }

  one(raw) {
    const text = textOf(raw), line = readLine(text);
    if (typeof line === "string") {
      if (!this.named(text, false)) this.drop(raw, line);
      return [];
    }
    const { layout } = this;
    if (layout) {
      if (!this.otherHeader && !this.differing(line).length) return this.frame(line, raw);
      this.drop(raw, this.difference(line));
      return [];
    }
    const fits = this.headerSeparator === line.separator && this.header.length === line.values.length;
    const own = new Layout(line, fits && !line.labels.some(Boolean) ? this.header : []), n = own.names.length;
    if (DECIMAL_COMMAS.test(stripped(text))) this.drop(raw, "decimal commas, or twice as many numbers?");
    else if (n < 1 || n > MOST_VALUES || (this.channels !== null && n !== this.channels)) {
      this.drop(raw, `${n} values, not ${this.channels ?? `1 to ${MOST_VALUES}`}`);
    } else return this.hold(own, line, raw);
    return [];
  }

  /** Keep a line; when enough agree, their form is that of the board. */
  hold(layout, line, raw) {
    this.held.push([layout, line, raw.slice()]);
    if (this.held.filter(([other]) => same(other, layout)).length < AGREEING) {
      if (this.held.length > MOST_HELD) this.drop(this.held.shift()[2], `no ${AGREEING} of the first lines have one form`);
      return [];
    }
    layout.names.forEach((name, k) => {
      const said = layout.value_units[k], { unit } = this;
      if (said && unit !== null && unit !== "raw" && said.toLowerCase() !== unit.toLowerCase()) {
        throw new Error(`Input unit of the robot file must be ${said}, as the lines say of ${name} (or "raw", with gains in ${said}/mT); instead received ${unit}.`);
      }
    });
    this.layout = layout;
    return this.held.splice(0).flatMap(([other, numbers, packet]) => {
      if (same(other, layout)) return this.frame(numbers, packet);
      this.drop(packet, this.difference(numbers));
      return [];
    });
  }

  frame(line, raw) {
    const { time, columns } = this.layout;
    if (time < 0) return [{ stream: 0, sequence: null, device_us: null, values: line.values }];
    const t = line.values[time], x = t * (timeScale(...columns[time]) || 0);
    if (!(t >= 0 && t <= LATEST)) {
      this.drop(raw, "a time must be from 0 to 1e+16");
      return [];
    }
    const even = Math.floor(x) + (x % 1 > 0.5 || (x % 1 === 0.5 && Math.floor(x) % 2) ? 1 : 0); // a half goes to the even number
    const device_us = timeScale(...columns[time]) ? (even % WRAP) + 0 : null;
    return [{ stream: 0, sequence: null, device_us, values: line.values.filter((_, k) => k !== time) }];
  }

  /** Take a header; return whether a line is one. One cut off in front tells the other columns only. */
  named(text, cut) {
    const names = readHeader(text), separator = separatorOf(stripped(text)), { layout } = this, first = cut ? 1 : 0;
    if (!layout) {
      if (names.length && !(cut && mayBeCut(names[0]))) [this.header, this.headerSeparator] = [names, separator];
      return names.length > 0;
    }
    if (names.length !== layout.units.length || separator !== layout.separator) return false;
    this.otherHeader = layout.header.length > 0 && !same(names.slice(first), layout.header.slice(first));
    if (!cut && !this.otherHeader) this.counters.restarts += 1;
    return !this.otherHeader;
  }

  differing(line) {
    return ["separator", "labels", "units", "trailing"].filter((key) => !same(line[key], this.layout[key]));
  }

  difference(line) {
    const words = { separator: "another separator", labels: "other labels", units: "other units", trailing: "another end" };
    if (this.otherHeader) return "after a header with other names";
    const [n, m] = [line.values.length, this.layout.units.length];
    return n !== m ? `${n} numbers, not ${m}` : (words[this.differing(line)[0]] ?? "another header") + " than the lines before";
  }

  drop(raw, why) {
    this.refuse(raw.length, quoted(Array.from(textOf(raw)).slice(0, 80).join("")) + ": " + why);
  }
}

// ---- By name -------------------------------------------------------------------------------------------------------

/** A new parser of a format, as after opening a port; `channels` and `unit` as in Python, null for any. */
function parser(format, channels = null, unit = null) {
  if (format === "frames") return new BinaryParser(channels);
  if (format === "csv") return new CsvParser(channels, unit);
  return new TextParser(format === "millivolts" && channels ? { ...LINES.millivolts, count: channels } : LINES[format]);
}

/** Names of the values of a frame, as in a recording. */
function channelNames(format, n, layout) {
  if (layout) return layout.names;
  const names = { hall: ["z_counts", "y_counts", "x_counts"], quaternions: ["x", "y", "z", "w"] }[format] ?? [];
  return names.length === n ? names : Array.from({ length: n }, (_, k) => `u${k + 1}${format === "millivolts" ? "_mV" : ""}`);
}

const dropped = ({ malformed, checksum_errors, oversized }) => malformed + checksum_errors + oversized;

/** The first format that almost all of the bytes are of, as `repro record` recommends it; empty if they are of none. */
function detected(bytes) {
  const [line] = latin(bytes.subarray(0, 16384)).split("\n").slice(1), n = (line ?? "").split(",").length;
  return FORMATS.find((format) => {
    const trial = parser(format, format === "millivolts" ? n : null);
    const { length } = trial.feed(bytes.subarray(0, 16384));
    return length > 0 && length >= 0.95 * (length + dropped(trial.counters));
  }) ?? "";
}

window.BOARD = { FORMATS, parser, channelNames, detected, dropped, crc32, quoted };
})();
