/* A robot file and its calibration in the browser, and the estimate from a frame: as repro.load_robot and repro live do,
   for what `REPRO` in live/model.js can model. Anything else is refused, with its line. */
(function () {
"use strict";

const { algebra: { dot, cross, times, eigen, solve, zeros }, robot, frames, placed, magneticSensing, levenbergMarquardt, covariance } = REPRO;
const FALSE_ALARMS_PER_HOUR = 0.1, WRONG_SHARE = 0.01, WINDOW = 10, SHOWN_HZ = 60, EXPLAINED = 1e-3, MUCH_BETTER = 25;
const IN_RANGE = 10, UNLEARNT = 0.9;
const coordinate = (c) => `delta_${"xyL"[c % 3]}_${Math.floor(c / 3) + 1}`;
const UNITS = ["mT", "mV", "raw"], RADIANS = Math.PI / 180;

// ---- The subset of TOML that robot files use -----------------------------------------------------------------------

/** Tables of a text: {"": {...}, name: {...} or [{...}, ...]}; of each table, `lines` has the line of each key. */
function toml(name, text) {
  const lines = text.replace(/^\ufeff/, "").replace(/\r\n/g, "\n").split("\n"), found = {}, tableLines = new WeakMap();
  const refuse = (k, must, received) => { throw new Error(`Input ${name}, line ${k + 1}, must be ${must}; instead received ${received}.`); };
  const open = (k) => { const table = Object.create(null); tableLines.set(table, { "": k + 1, text: {} }); return table; };
  const top = open(0);
  let table = top;
  for (let k = 0; k < lines.length; k++) {
    const line = lines[k], first = k;
    if (/[\x00-\x08\x0b-\x1f\x7f]/.test(line)) refuse(k, "text", "a control character");
    if (/^[ \t]*(#.*)?$/.test(line)) continue;
    const header = /^[ \t]*(\[\[?)[ \t]*([A-Za-z0-9_-]+)[ \t]*(\]\]?)[ \t]*(#.*)?$/.exec(line);
    if (header) {
      const [, begin, key, end] = header;
      if (begin.length !== end.length) refuse(k, "a table", line.trim());
      if (begin === "[[" ? Object.hasOwn(found, key) && !Array.isArray(found[key]) : Object.hasOwn(found, key)) refuse(k, `one table ${key}`, "another one");
      if (key in top) refuse(k, `one table ${key}`, "a key of the same name before");
      table = open(k);
      if (begin === "[[") (found[key] ??= []).push(table);
      else found[key] = table;
      continue;
    }
    const pair = /^[ \t]*([A-Za-z0-9_-]+)[ \t]*=[ \t]*(.*)$/.exec(line);
    if (!pair) refuse(k, "a table, or a key = value", line.trim());
    if (pair[1] in table) refuse(k, `one key ${pair[1]} in a table`, "another one");
    let rest = pair[2];
    const skip = (more) => { // blanks; and within an array, comments and ends of lines
      rest = rest.replace(/^[ \t]+/, "");
      while (more && (rest === "" || rest[0] === "#")) {
        if (++k >= lines.length) refuse(first, "an array that ends", "the end of the file");
        rest = lines[k].replace(/^[ \t]+/, "");
      }
    };
    const value = (depth) => {
      const quoted = /^"((?:[^"\\]|\\["\\tn])*)"|^'([^']*)'/.exec(rest);
      const word = /^(?:true|false|[+-]?(?:0|[1-9](?:_?[0-9])*)(?:\.[0-9](?:_?[0-9])*)?(?:[eE][+-]?[0-9](?:_?[0-9])*)?)(?=[ \t]*(?:[,\]#]|$))/.exec(rest);
      if (quoted && !/^("""|''')/.test(rest)) {
        rest = rest.slice(quoted[0].length);
        return quoted[2] ?? quoted[1].replace(/\\(.)/g, (_, c) => ({ t: "\t", n: "\n" })[c] ?? c);
      }
      if (word) {
        rest = rest.slice(word[0].length);
        return word[0] === "true" || (word[0] !== "false" && Number(word[0].replaceAll("_", "")));
      }
      if (rest[0] !== "[" || depth > 8) refuse(k, "a text in quotes, a number, true, false, or an array of these", rest || "nothing");
      const items = [];
      rest = rest.slice(1);
      for (skip(true); rest[0] !== "]"; skip(true)) {
        items.push(value(depth + 1));
        skip(true);
        if (rest[0] === ",") rest = rest.slice(1);
        else if (rest[0] !== "]") refuse(k, "an array, its values with commas between them", rest);
      }
      rest = rest.slice(1);
      return items;
    };
    skip(false);
    const given = rest;
    table[pair[1]] = value(0);
    Object.assign(tableLines.get(table), { [pair[1]]: first + 1 }).text[pair[1]] = given;
    if (!/^[ \t]*(#.*)?$/.test(rest)) refuse(k, "a value, and nothing behind it", rest.trim());
  }
  return { top, tables: found, lines: tableLines };
}

// ---- What the keys must be -----------------------------------------------------------------------------------------

const isNumber = (x) => typeof x === "number" && Math.abs(x) <= 1e300;
const areNumbers = (x, n) => Array.isArray(x) && x.length === n && x.every(isNumber);
const REQUIRED = undefined;

/** A number of a magnitude in a range [unit]; or zero, where that is the default or the lowest. */
function number(low, high, unit, fallback = REQUIRED, signed = false) {
  const fits = (x) => isNumber(x) && ((low <= (signed ? Math.abs(x) : x) && (signed ? Math.abs(x) : x) <= high) || (x === 0 && (fallback === 0 || low === 0)));
  return { must: `${fallback === 0 && low > 0 ? "0, or " : ""}${signed ? "of a magnitude " : ""}between ${low} and ${high} [${unit}]`, fits, fallback };
}
const count = (low, high, fallback = REQUIRED) => ({
  must: `a whole number from ${low} to ${high}`, fits: (x, text) => /^[+-]?[0-9_]+(?![.eE0-9_])/.test(text) && isNumber(x) && low <= x && x <= high, fallback,
});
const word = (words) => ({ must: `one of ${words.map((x) => `'${x}'`).join(", ")}`, fits: (x) => words.includes(x) });
const interval = (high, least, unit) => ({
  must: `[lowest, highest], at least ${least} apart and within ${high} of zero [${unit}]`, fallback: null,
  fits: (x) => areNumbers(x, 2) && x[1] - x[0] >= least && Math.max(...x.map(Math.abs)) <= high,
});
const AT = { must: "0, or between 0.1 and 5000 [mm]", fits: (x) => isNumber(x) && (x === 0 || (x >= 0.1 && x <= 5000)) };
const DIRECTION = {
  must: "three numbers along x, y, z of the cross-section, not all zero", fallback: null,
  fits: (x) => areNumbers(x, 3) && Math.hypot(...x) >= 1e-9 && Math.hypot(...x) <= 1e9,
};
const PLACE = { segment: count(1, 10000), at_mm: AT, direction: DIRECTION }, SIZE = number(0.5, 200, "mm");
const SEGMENT = {
  kind: word(["constant_curvature"]), length_mm: number(1, 5000, "mm"), radius_mm: number(0.5, 500, "mm"),
  delta_x_mm: interval(2000, 0.05, "mm"), delta_y_mm: interval(2000, 0.05, "mm"), delta_L_mm: interval(1000, 0.05, "mm"),
};
const MAGNET = {
  kind: word(["ring"]), ...PLACE, outer_diameter_mm: SIZE, inner_diameter_mm: number(0.1, 200, "mm", 0), height_mm: SIZE,
  polarisation_mt: number(10, 2000, "mT", REQUIRED, true),
};
const TOP = { earth_mt: { must: "three numbers along x, y, z of the base, together at most 1 [mT]", fallback: [0, 0, 0], fits: (x) => areNumbers(x, 3) && Math.hypot(...x) <= 1 } };
const streamKeys = (unit) => ({
  format: word(BOARD.FORMATS), rate_hz: number(0.1, 1e5, "Hz"), unit: word(UNITS),
  ["noise_" + unit.toLowerCase()]: number(1e-9, 1e6, unit.toLowerCase()), channels: count(1, 255, 0),
});
const sensorKeys = (unit) => ({
  channel: count(1, 255), ...PLACE, radial_mm: number(0.1, 500, "mm", 0), azimuth_deg: number(0, 360, "deg", 0, true),
  tilt_deg: number(0, 180, "deg", 0, true), ["offset_" + unit.toLowerCase()]: number(0, 1e9, unit, 0, true),
  [unit === "mT" ? "gain" : `gain_${unit.toLowerCase()}_per_mt`]: number(1e-3, 1e9, unit + "/mT", unit === "mT" ? 1 : REQUIRED, true),
});

// ---- From a file to a robot ----------------------------------------------------------------------------------------

const turnX = (a) => [[1, 0, 0], [0, Math.cos(a), -Math.sin(a)], [0, Math.sin(a), Math.cos(a)]];
const turnY = (a) => [[Math.cos(a), 0, Math.sin(a)], [0, 1, 0], [-Math.sin(a), 0, Math.cos(a)]];
const turnZ = (a) => [[Math.cos(a), -Math.sin(a), 0], [Math.sin(a), Math.cos(a), 0], [0, 0, 1]];
const matrix = (A, B) => A.map((row) => [0, 1, 2].map((k) => row[0] * B[0][k] + row[1] * B[1][k] + row[2] * B[2][k]));

/** Rotation whose z axis is a direction; y is across it and the backbone, on the given side. */
function directed(direction, side) {
  const size = Math.hypot(...direction), z = direction.map((x) => x / size);
  let y = cross([0, 0, 1], z);
  if (dot(y, side) < 0) y = y.map((x) => -x);
  const sine = Math.hypot(...y), x = cross(y = sine > 0 ? y.map((c) => c / sine) : side, z);
  return [0, 1, 2].map((k) => [x[k], y[k], z[k]]);
}

/** A robot of a file's text, in SI and radians; see the page of robots of one's own for what the keys mean. */
function robotOf(name, text, bytes = new TextEncoder().encode(text)) {
  const file = toml(name, text), { tables } = file;
  const fail = (table, where, key, must, received) => {
    const lines = file.lines.get(table), shown = typeof received === "string" ? received : JSON.stringify(received);
    throw new Error(`Input ${key} of ${name}, line ${lines[key] ?? lines[""]}${where}, must be ${must}; instead received ${shown}.`);
  };
  const checked = (table, keys, where) => {
    for (const key of Object.keys(table)) if (!(key in keys)) fail(table, where, key, `one of ${Object.keys(keys).join(", ")}`, "a key that does not exist");
    return Object.fromEntries(Object.entries(keys).map(([key, { must, fits, fallback }]) => {
      if (!(key in table)) {
        if (fallback === REQUIRED) fail(table, where, key, `given: ${must}`, "nothing");
        return [key, fallback];
      }
      if (!fits(table[key], file.lines.get(table).text[key])) fail(table, where, key, must, table[key]);
      return [key, table[key]];
    }));
  };
  const rows = (key) => {
    if (!Array.isArray(tables[key] ?? [])) fail(tables[key], "", key, `tables [[${key}]]`, `a table [${key}]`);
    return tables[key] ?? [];
  };
  for (const key of Object.keys(tables)) {
    const one = [tables[key]].flat()[0];
    if (key === "imus") fail(one, "", key, "left out: this page models magnetic sensors only (repro live takes IMUs)", "[[imus]]");
    if (key === "model") fail(one, "", key, "left out: this page runs no networks (repro live does)", "[model]");
    if (!["stream", "segments", "magnets", "sensors"].includes(key)) fail(one, "", key, "one of stream, segments, magnets, sensors", "a table that does not exist");
  }
  const all = (key, keys) => rows(key).map((table, k) => checked(table, keys, `, [[${key}]] ${k + 1}`));
  const { earth_mt } = checked(file.top, TOP, "");
  if (Array.isArray(tables.stream)) fail(tables.stream[0], "", "stream", "a table [stream]", "[[stream]]");
  for (const [k, table] of rows("segments").entries()) if (table.kind === "affine_curvature") fail(table, `, [[segments]] ${k + 1}`, "kind", "'constant_curvature', which this page models", table.kind);
  for (const [k, table] of rows("magnets").entries()) if (table.kind === "cube") fail(table, `, [[magnets]] ${k + 1}`, "kind", "'ring', which this page models", table.kind);
  const segments = all("segments", SEGMENT), magnets = all("magnets", MAGNET);
  if (!segments.length) fail(file.top, "", "segments", "given: at least one table [[segments]]", "nothing");
  const { length_mm, radius_mm } = segments[0], bend = 1e-3 * Math.PI / 2 * radius_mm, stretch = 1e-4 * length_mm;
  const bounds = segments.flatMap((row, k) => {
    const table = tables.segments[k], where = `, [[segments]] ${k + 1}`;
    for (const key of ["length_mm", "radius_mm"]) if (row[key] !== segments[0][key]) fail(table, where, key, `${segments[0][key]}, as of the first segment: this page models equal ones`, row[key]);
    if (row.delta_L_mm && !(row.delta_L_mm[0] > -length_mm)) fail(table, where, "delta_L_mm", `above ${-length_mm}: a segment is longer than 0 [mm]`, row.delta_L_mm);
    return [[row.delta_x_mm, bend], [row.delta_y_mm, bend], [row.delta_L_mm, stretch]].map(([given, usual]) => (given ? given.map((x) => x / 1e3) : [-usual, usual]));
  });
  magnets.forEach((row, k) => {
    const table = tables.magnets[k], where = `, [[magnets]] ${k + 1}`;
    if (!(row.inner_diameter_mm < row.outer_diameter_mm)) fail(table, where, "inner_diameter_mm", `below outer_diameter_mm, ${row.outer_diameter_mm}`, row.inner_diameter_mm);
    for (const key of ["outer_diameter_mm", "inner_diameter_mm", "height_mm", "polarisation_mt"]) {
      if (row[key] !== magnets[0][key]) fail(table, where, key, `${magnets[0][key]}, as of the first magnet: this page models magnets that are alike`, row[key]);
    }
  });
  const stream = tables.stream ?? file.top, unit = UNITS.includes(stream.unit) ? stream.unit : UNITS[0];
  const { format, rate_hz, channels: given, ["noise_" + unit.toLowerCase()]: noise } = checked(stream, streamKeys(unit), ", [stream]");
  const own = { millivolts: "mV", hall: "raw" }[format] ?? unit;
  if (format === "quaternions") fail(stream, ", [stream]", "format", "of magnetic sensors: quaternions are of IMUs", format);
  if (unit !== own) fail(stream, ", [stream]", "unit", `'${own}', the unit of ${format}`, unit);
  const sensors = all("sensors", sensorKeys(unit));
  if (!sensors.length || !magnets.length) fail(file.top, "", "robot", "one with [[magnets]] and [[sensors]]", `${magnets.length} and ${sensors.length}`);
  for (const [key, parts] of [["magnets", magnets], ["sensors", sensors]]) parts.forEach((row, k) => {
    const where = `, [[${key}]] ${k + 1}`;
    if (row.segment > segments.length) fail(tables[key][k], where, "segment", `between 1 and ${segments.length}, the number of segments`, row.segment);
    if (row.at_mm > length_mm * (1 + 1e-12)) fail(tables[key][k], where, "at_mm", `at most ${length_mm}, the length of segment ${row.segment} [mm]`, row.at_mm);
  });
  const most = { frames: 118, hall: 3 }[format] ?? 255, exact = format === "hall";
  if (given && (given > most || (exact && given !== most))) fail(stream, ", [stream]", "channels", `${exact ? "" : "at most "}${most}, the values of a frame of this format`, given);
  const used = sensors.map((row) => row.channel), channels = exact ? most : given || Math.max(...used);
  used.forEach((channel, k) => {
    if (used.indexOf(channel) < k) fail(tables.sensors[k], `, [[sensors]] ${k + 1}`, "channel", `another channel than that of sensor ${used.indexOf(channel) + 1}`, channel);
    if (channel > Math.min(channels, most)) fail(tables.sensors[k], `, [[sensors]] ${k + 1}`, "channel", `at most ${Math.min(channels, most)}`, channel);
  });
  const pole = magnets.map((row) => ({ segment: row.segment - 1, axial: row.at_mm / 1e3, p: [0, 0, 0], R: row.direction ? directed(row.direction, [0, 1, 0]) : turnX(0) }));
  const hall = sensors.map((row, k) => {
    const azimuth = row.azimuth_deg * RADIANS, r = row.radial_mm / 1e3, table = tables.sensors[k], where = `, [[sensors]] ${k + 1}`;
    if (row.direction && "tilt_deg" in table) fail(table, where, "tilt_deg", "left out: direction says where the sensor points", row.tilt_deg);
    if (row.direction && "azimuth_deg" in table && !row.radial_mm) fail(table, where, "azimuth_deg", "left out on the backbone: direction does not turn with it", row.azimuth_deg);
    const flip = [[1, 0, 0], [0, -1, 0], [0, 0, -1]], usual = matrix(matrix(turnZ(azimuth), turnY(row.tilt_deg * RADIANS)), flip);
    const R = row.direction ? directed(row.direction, matrix(turnZ(azimuth), flip).map((one) => one[1])) : usual;
    return { segment: row.segment - 1, axial: row.at_mm / 1e3, p: [r * Math.cos(azimuth), r * Math.sin(azimuth), 0], R };
  });
  const ends = (one) => one.segment * 1e3 + one.axial, between = ([a, b], i) => Math.min(a, b) < i * 1e3 + length_mm / 1e3 && Math.max(a, b) > i * 1e3 && a !== b;
  const pairs = hall.flatMap((s) => [...pole.map(ends), ...(earth_mt.some(Boolean) ? [0] : [])].map((m) => [m, ends(s)]));
  segments.forEach((row, i) => {
    if (!pairs.some((pair) => between(pair, i))) fail(tables.segments[i], `, [[segments]] ${i + 1}`, "kind", "of a segment between a magnet and a sensor: nothing observes this one", row.kind);
  });
  const { outer_diameter_mm, inner_diameter_mm, height_mm, polarisation_mt } = magnets[0];
  const made = {
    name, bytes, format, rate_hz, unit, channels, channel: used.map((k) => k - 1), noise, earth: earth_mt, magnets: pole, sensors: hall,
    segments: segments.length, length: length_mm / 1e3, radius: radius_mm / 1e3, low: bounds.map(([low]) => low), high: bounds.map(([, high]) => high),
    gain: sensors.map((row) => row.gain ?? row[`gain_${unit.toLowerCase()}_per_mt`]), offset: sensors.map((row) => row["offset_" + unit.toLowerCase()]),
    moments: REPRO.ringMoments(outer_diameter_mm / 1e3, inner_diameter_mm / 1e3, height_mm / 1e3, polarisation_mt, 9), error: null,
  };
  made.start = made.low.map((low, c) => (c % 3 === 2 ? (low + made.high[c]) / 2 : Math.min(Math.max(0, low), made.high[c])));
  const body = bodyOf(made), chain = frames(body, made.start), reach = Math.hypot(outer_diameter_mm, height_mm) / 2e3;
  placed(body, made.start, chain, body.sensors).forEach((s, j) => placed(body, made.start, chain, body.magnets).forEach((m, k) => {
    const distance = Math.hypot(...s.position.map((x, c) => x - m.position[c]));
    if (!(distance > reach)) fail(tables.sensors[j], `, [[sensors]] ${j + 1}`, "at_mm", `farther than ${(reach * 1e3).toFixed(1)} mm from the centre of magnet ${k + 1}`, `${(distance * 1e3).toFixed(1)} mm from it`);
  }));
  return { ...made, body, notes: [...outOfRange(made, body, tables.sensors.map((table) => file.lines.get(table)[""])), ...unobserved(made, body)] };
}

function bodyOf(made) {
  const mounts = (all) => all.map(({ segment, axial, p, R }) => ({ segment, axial, position: p, axis: R.map((row) => row[2]) }));
  return robot(made.segments, made.length, made.radius, mounts(made.magnets), mounts(made.sensors));
}

/** Sensor model with the field of the Earth, which turns with no segment: q => {u, J}. */
function sensingOf(made, body = bodyOf(made)) {
  const own = magneticSensing(body, made.moments, made.gain);
  if (!made.earth.some(Boolean)) return own;
  return (q, slopes = true) => {
    const { u, J } = own(q, slopes), chain = frames(body, q);
    placed(body, q, chain, body.sensors).forEach((sensor, s) => {
      u[s] += made.gain[s] * dot(sensor.axis, made.earth);
      const torque = cross(sensor.axis, made.earth);
      for (let i = 0; slopes && i <= sensor.segment; i++) (i < sensor.segment ? chain.twists[i] : sensor.twists).forEach((t, j) => {
        J[s][3 * i + j] += made.gain[s] * dot(torque, t);
      });
    });
    return { u, J };
  };
}

// ---- What the readings cannot say, in the words of repro.load_robot --------------------------------------------------

const brief = (x) => String(Number(x.toPrecision(2)));

/** Notes on sensors that no magnet reaches where the estimates start. */
function outOfRange({ name, start, gain, moments, noise, unit }, body, lines) {
  const chain = frames(body, start), magnets = placed(body, start, chain, body.magnets);
  return placed(body, start, chain, body.sensors).flatMap((sensor, j) => {
    const away = magnets.map(({ position }) => Math.hypot(...position.map((x, c) => x - sensor.position[c])));
    const signal = Math.abs(2 * moments[0] * gain[j]) / Math.min(...away) ** 3;
    if (signal >= IN_RANGE * noise) return [];
    const distances = away.map((d, k) => `magnet ${k + 1} at ${(1e3 * d).toFixed(0)} mm`).join(", ");
    return [`${name}, line ${lines[j]}: no magnet is in range of sensor ${j + 1} (${distances}): the nearest gives it ${brief(signal)} ${unit} at most, with a noise of ${brief(noise)}.`];
  });
}

/** Notes on fewer readings than unknowns, and on what readings leave open at the start. */
function unobserved(made, body) {
  const { name, high, start, sensors } = made, notes = [], n = start.length;
  if (sensors.length < n) notes.push(`${name}: ${sensors.length} readings for ${n} unknowns. Those of one moment do not determine the configuration; only an estimator that knows how the robot moves, such as kalman, can follow it.`);
  const open = openAt(made, body, start), bent = start.map((x, c) => x + (0.2 + 0.5 * (0.618 * (c + 1) % 1)) * (high[c] - x));
  if (open.length) notes.push(`${name}: at the start the readings do not determine, in units of the bounds: ${open.join("; ")}.${openAt(made, body, bent).length ? "" : " Bent, they do."}`);
  return notes;
}

/** Combinations that readings do not make more certain than the bounds do, as close to single coordinates as can be. */
function openAt(made, body, q) {
  const { J } = sensingOf(made, body)(q), half = made.low.map((x, c) => (made.high[c] - x) / (2 * made.noise));
  const A = half.map((a, i) => half.map((b, k) => J.reduce((sum, row) => sum + row[i] * a * row[k] * b, i === k ? 1 : 0)));
  const { values, vectors } = eigen(A), free = vectors.filter((_, k) => values[k] < UNLEARNT ** -2);
  let P = half.map((_, i) => half.map((__, k) => free.reduce((sum, v) => sum + v[i] * v[k], 0)));
  return free.map(() => {
    const most = P.map((row, i) => row[i]), pivot = most.indexOf(Math.max(...most)), d = P.map((row) => row[pivot] / Math.sqrt(most[pivot]));
    P = P.map((row, i) => row.map((x, k) => x - d[i] * d[k]));
    const size = d.map(Math.abs), rounded = size.map((x) => Math.round(1e9 * x)), order = d.map((_, k) => k).sort((a, b) => rounded[b] - rounded[a]);
    return order.filter((k) => size[k] > Math.max(...size) / 2).map((k) => `${d[k] < 0 ? "" : "+"}${d[k].toFixed(2)} ${coordinate(k)}`).join(" ");
  });
}

// ---- A calibration -------------------------------------------------------------------------------------------------

/** The robot with parameters in the order of edition1.sensing.placement: magnets, sensors, moments; and an Earth field. */
function moved(made, z, earth) {
  const m = made.magnets.length, s = made.sensors.length;
  const magnets = made.magnets.map((one, k) => {
    const p = z.slice(5 * k, 5 * k + 5), shift = times(one.R, p);
    return { ...one, R: matrix(one.R, matrix(turnX(p[3]), turnY(p[4]))), p: one.p.map((x, c) => x + shift[c]) };
  });
  const own = (k) => z.slice(5 * m + 4 * k, 5 * m + 4 * k + 4);
  const sensors = made.sensors.map((one, k) => {
    const [azimuth, stretch, tilt] = own(k), [x, y, h] = one.p;
    return { ...one, R: matrix(matrix(turnZ(azimuth), one.R), turnY(-tilt)), p: times(turnZ(azimuth), [x * (1 + stretch), y * (1 + stretch), h]) };
  });
  const moments = made.moments.map((x, k) => x * (1 + z[5 * m + 4 * s + k])), gain = made.gain.map((x, k) => x * (1 + own(k)[3]));
  const found = { ...made, magnets, sensors, moments, gain, earth };
  return { ...found, body: bodyOf(found) };
}

const CALIBRATION = ["robot", "robot_sha256", "names", "parameters", "offset", "earth_mt", "covariance", "undetermined", "poses", "held_out", "before", "after", "chi2"];

/** The robot as a file of `repro calibrate` says; it must be one of this robot file as it is. */
async function calibrated(made, name, text) {
  const fail = (key, must, received) => { throw new Error(`Input ${key} of ${name} must be ${must}; instead received ${received}.`); };
  let given;
  try {
    given = JSON.parse(text);
  } catch (error) {
    fail("file", "JSON that repro calibrate wrote", error.message);
  }
  if (given?.schema !== 2) fail("schema", "2 (older files: calibrate again)", JSON.stringify(given?.schema ?? null));
  const wrong = [...CALIBRATION.filter((key) => !(key in given)), ...Object.keys(given).filter((key) => key !== "schema" && !CALIBRATION.includes(key))];
  if (wrong.length) fail("keys", CALIBRATION.join(", "), `a difference in ${wrong.join(", ")}`);
  const base = made.drawn ?? made, s = base.sensors.length, n = 5 * base.magnets.length + 4 * s + base.moments.length, all = n + s + 3;
  const sizes = { parameters: n, offset: s, earth_mt: 3, covariance: all };
  for (const [key, size] of Object.entries(sizes)) {
    const rows = key === "covariance" ? given[key] : [given[key]], width = key === "covariance" ? all : size;
    if (!Array.isArray(rows) || (key === "covariance" && rows.length !== size) || !rows.every((row) => areNumbers(row, width))) fail(key, `${width} finite numbers${key === "covariance" ? " in each of as many rows" : ""}`, "something else");
  }
  const digest = await crypto.subtle.digest("SHA-256", base.bytes);
  const sha = Array.from(new Uint8Array(digest), (x) => x.toString(16).padStart(2, "0")).join("");
  if (sha !== given.robot_sha256) fail("calibration", `made with ${base.name} as it is now (sha256 ${sha.slice(0, 12)})`, `one made with ${given.robot} of sha256 ${String(given.robot_sha256).slice(0, 12)}`);
  const found = moved(base, given.parameters, given.earth_mt);
  return { ...found, drawn: base, offset: base.offset.map((x, k) => x + given.offset[k]), error: (q) => calibrationError(base, given, q) };
}

/** Covariance of the readings at q that a calibration leaves uncertain. */
function calibrationError(base, { parameters, earth_mt, covariance: S }, q) {
  const n = parameters.length, s = base.sensors.length, step = 1e-6, all = [...parameters, ...earth_mt];
  const columns = all.map((_, k) => {
    const [up, down] = [step, -step].map((h) => {
      const z = all.map((x, c) => (c === k ? x + h : x)), made = moved(base, z.slice(0, n), z.slice(n));
      return sensingOf(made, made.body)(q, false).u;
    });
    return Array.from(up, (x, j) => (x - down[j]) / (2 * step));
  });
  const offsets = base.offset.map((_, k) => base.offset.map((__, j) => (j === k ? 1 : 0)));
  const J = [...columns.slice(0, n), ...offsets, ...columns.slice(n)], SJ = S.map((row) => base.offset.map((_, j) => row.reduce((sum, x, k) => sum + x * J[k][j], 0)));
  return base.offset.map((_, i) => base.offset.map((__, j) => J.reduce((sum, column, k) => sum + column[i] * SJ[k][j], 0)));
}

// ---- Do the readings fit? ------------------------------------------------------------------------------------------

const LANCZOS = [76.18009172947146, -86.50532032941677, 24.01409824083091, -1.231739572450155, 1.208650973866179e-3, -5.395239384953e-6];

/** Chance that a chi-square of so many degrees of freedom is larger: the incomplete gamma function. */
function chance(value, freedom) {
  const a = freedom / 2, x = value / 2;
  if (!(x > 0)) return 1;
  const series = LANCZOS.reduce((sum, c, k) => sum + c / (a + 1 + k), 1.000000000190015);
  const front = Math.exp(a * Math.log(x) - x - ((a + 0.5) * Math.log(a + 5.5) - a - 5.5 + Math.log(2.5066282746310005 * series / a)));
  if (x < a + 1) {
    let term = 1 / a, sum = term;
    for (let n = 1; n < 1000 && term > sum * 1e-16; n++) sum += term *= x / (a + n);
    return 1 - sum * front;
  }
  let b = x + 1 - a, c = 1e300, d = 1 / b, h = d;
  for (let i = 1; i < 1000; i++) {
    const an = -i * (i - a);
    d = 1 / (an * d + (b += 2));
    c = b + an / c;
    h *= d * c;
    if (Math.abs(d * c - 1) < 1e-15) break;
  }
  return h * front;
}

/** Chi-square, degrees of freedom and share of the model in a residual; covariance that the model adds. */
function tested(made, { q, u, J }, readings, use, E) {
  const rows = use.flatMap((one, k) => (one ? [k] : [])), r = rows.map((k) => readings[k] - u[k]), n = q.length;
  const free = Array.from(q, (x, c) => x > made.low[c] && x < made.high[c]), variance = made.noise ** 2;
  if (!E) {
    return { chi2: r.reduce((sum, x) => sum + x * x, 0) / variance, dof: Math.max(0, rows.length - free.filter(Boolean).length), systematic: 0, added: null };
  }
  const unit = (v) => { const size = Math.hypot(...v); return size > 1e-9 ? v.map((x) => x / size) : null; };
  const basis = [], project = (v) => { for (let turn = 0; turn < 2; turn++) for (const b of basis) { const along = b.reduce((sum, x, k) => sum + x * v[k], 0); v = v.map((x, k) => x - along * b[k]); } return v; };
  const add = (v) => { const one = v && unit(project(v)); if (one) basis.push(one); return Boolean(one); };
  free.forEach((is, c) => { if (is) add(unit(rows.map((k) => J[k][c]))); });
  const own = basis.length;
  rows.forEach((_, k) => add(rows.map((__, j) => (j === k ? 1 : 0))));
  const N = basis.slice(own), by = (A, B, M) => A.map((a) => B.map((b) => a.reduce((sum, x, i) => sum + x * b.reduce((inner, y, j) => inner + y * M(i, j), 0), 0)));
  const model = by(N, N, (i, j) => E[rows[i]][rows[j]]), p = N.map((v) => v.reduce((sum, x, k) => sum + x * r[k], 0));
  const system = () => model.map((row, i) => row.map((x, j) => x + (i === j ? variance : 0)));
  const solved = N.length ? solve(system(), p.slice()) : [], trace = N.reduce((sum, _, c) => sum + solve(system(), model.map((row) => row[c]))[c], 0);
  const A = zeros(n, n);
  for (const k of rows) for (let a = 0; a < n; a++) for (let b = 0; b < n; b++) A[a][b] += J[k][a] * J[k][b];
  for (let c = 0; c < n; c++) A[c][c] += 12 * variance / (made.high[c] - made.low[c]) ** 2;
  const G = rows.map((k) => solve(A.map((row) => row.slice()), Array.from(J[k]))), columns = Array.from(q, (_, c) => G.map((row) => row[c]));
  return {
    chi2: p.reduce((sum, x, k) => sum + x * solved[k], 0), dof: N.length, systematic: N.length ? trace / N.length : 0,
    added: by(columns, columns, (i, j) => E[rows[i]][rows[j]]),
  };
}

/** Covariance of two quantities that change by these rows when the configuration does. */
const covaried = (C, a, b) => C.reduce((sum, row, i) => sum + a[i] * row.reduce((inner, x, j) => inner + x * b[j], 0), 0);

// ---- The estimate --------------------------------------------------------------------------------------------------

/** Follows the frames of a robot by least squares from the last estimate, and says whether the shape explains them.
    `grown` is how many times the deviations of the estimator it states: the band that holds, as `repro fit` finds it. */
class Follower {
  constructor(made, grown = 1) {
    Object.assign(this, { made, grown, sensing: sensingOf(made, made.body), q: null, C: null, window: [], status: 0, excess: 0, cause: "", anew: -Infinity, steps: 0, looked: -Infinity, refusal: "", error: null });
    Object.assign(this, { missing: made.channel.map(() => 0), missingNow: made.channel.map(() => false), refused: 0, refusedNow: false, doubted: 0 });
    let seed = 1;
    const share = () => (seed = (seed * 16807) % 2147483647) / 2147483647; // always the same
    this.starts = Array.from({ length: 8 }, () => made.low.map((low, c) => low + share() * (made.high[c] - low)));
  }

  fit(start, u, use) {
    const { made } = this, found = levenbergMarquardt(this.sensing, start, u, use, made.low, made.high, 30);
    if (made.error && (!this.error || this.error.q.some((x, c) => Math.abs(x - found.q[c]) > 0.02 * (made.high[c] - made.low[c])))) {
      this.error = { q: found.q, E: made.error(found.q) }; // it changes slowly
    }
    return { ...found, ...tested(made, found, u, use, this.error?.E) };
  }

  step(values) {
    const { made } = this, n = made.low.length;
    this.refusedNow = true;
    const why = values.length !== made.channels ? `Input frame of the stream must be of ${made.channels} channels, as described in ${made.name}; instead received ${values.length} values.`
      : made.channel.every((k) => Number.isNaN(values[k])) ? "No reading is a number." : made.channel.some((k) => Math.abs(values[k]) === Infinity) ? "A reading is infinite." : "";
    if (why) {
      this.refused += 1;
      this.refusal = why;
      return;
    }
    const u = made.channel.map((k, j) => values[k] - made.offset[j]), use = u.map((x) => !Number.isNaN(x)), many = use.filter(Boolean).length;
    Object.assign(this, { refusedNow: false, missingNow: use.map((is) => !is) });
    use.forEach((is, j) => { if (!is) this.missing[j] += 1; });
    this.steps += 1;
    let found = this.fit(this.q ?? made.start, u, use);
    this.test(found);
    if (this.status && this.steps - this.looked >= 15) { // another shape may explain them
      this.looked = this.steps;
      const others = [made.start, ...this.starts].map((start) => this.fit(start, u, use));
      const best = others.reduce((a, b) => (b.chi2 < a.chi2 ? b : a)), apart = Math.max(...made.low.map((low, c) => Math.abs(best.q[c] - found.q[c]) / (made.high[c] - low)));
      if (chance(best.chi2, Math.max(best.dof, 1)) >= EXPLAINED && best.chi2 < found.chi2 - MUCH_BETTER && apart > 0.02) {
        [found, this.window, this.anew] = [best, [], this.steps];
        this.test(found);
      }
    }
    if (this.steps - this.anew < WINDOW && !this.status) [this.status, this.cause] = [1, "anew"];
    else if (!this.status && many < n) [this.status, this.cause] = [1, "too few"];
    else this.cause = this.status ? "untold" : "";
    if (this.status) this.doubted += 1;
    this.q = Array.from(found.q);
    this.C = covariance(found.J, use, made.noise).map((row, a) => Array.from(row, (x, b) => x + (found.added?.[a][b] ?? 0)));
    if (this.status && this.excess > 1) this.C = this.C.map((row) => row.map((x) => x * this.excess ** 2));
  }

  /** The chi-square test of the last readings; errors that last are as good as one reading, however many there are. */
  test(found) {
    this.window = [...this.window, found].slice(-WINDOW);
    const sum = (key) => this.window.reduce((total, seen) => total + seen[key], 0), m = this.window.length, chi2 = sum("chi2"), dof = sum("dof");
    [this.status, this.excess] = [0, 0];
    if (!dof) return;
    const last = sum("systematic") / m, free = Math.round(100 * dof / m / (last ** 2 + (1 - last ** 2) / m)) / 100;
    const rare = FALSE_ALARMS_PER_HOUR / (3600 * Math.min(this.made.rate_hz, SHOWN_HZ)), of = chance(chi2 / dof * free, Math.max(free, 1));
    [this.status, this.excess] = [(of < rare) + (of < WRONG_SHARE * rare), Math.sqrt(chi2 / dof)];
  }

  // ---- In words ----------------------------------------------------------------------------------------------------

  /** Position of the tip and its standard deviations, as stated [m]. */
  tip() {
    const { p, J } = REPRO.tip(this.made.body, this.q);
    return { p, deviation: J.map((row) => this.grown * Math.sqrt(Math.max(covaried(this.C, row, row), 0))) };
  }

  quantities() {
    const { p, deviation: ofTip } = this.tip(), tip = p.map((x, k) => `tip ${"xyz"[k]} ${(1e3 * x).toFixed(2)} ± ${(1e3 * ofTip[k]).toFixed(3)} mm`);
    const own = this.q.map((x, c) => {
      const deviation = this.grown * Math.sqrt(Math.max(this.C[c][c], 0)), name = `${coordinate(c)} ${(1e3 * x).toFixed(2)}`;
      return deviation > this.made.high[c] - this.made.low[c] ? `${name} mm (undetermined)` : `${name} ± ${(1e3 * deviation).toFixed(3)} mm`;
    });
    return [...own, ...tip, ...(this.grown === 1 ? [] : [`Every ± is ${this.grown} times what the estimator states.`])];
  }

  mark() {
    return ["", "suspicious", "wrong, not to be trusted"][this.status];
  }

  why() {
    if (this.cause === "too few") return "There are fewer readings than unknowns: they do not determine the shape.";
    if (this.cause === "anew") return "Another shape explained the readings much better: the estimator was started anew there.";
    return "A sensor, something magnetic nearby, more noise than stated, or a robot that is not as described. repro live says which sensor it is, where that can be told.";
  }

  /** Sentences that stay the same while this lasts. */
  alerts() {
    const said = this.status ? [`The shape does not explain the readings. ${this.why()}`] : [];
    this.missingNow.forEach((gone, j) => { if (gone) said.push(`sensor ${j + 1} gives no reading and is left out.`); });
    return this.refusedNow ? [...said, "Readings that cannot be used came."] : said;
  }

  troubles(silent) {
    const said = [], { made } = this, n = made.low.length, s = made.channel.length;
    if (!silent && this.status) {
      const times = ["anew", "too few"].includes(this.cause) ? "" : `: residuals are ${Number(this.excess.toPrecision(2))} times those of the noise`;
      said.push(`${["", "Suspicious, perhaps not to be trusted", "Wrong, not to be trusted"][this.status]}${times}. ${this.why()}`);
    } else if (this.doubted) said.push(`${this.doubted} estimates did not explain their readings, at a time that is over.`);
    this.missing.forEach((count, j) => { if (count) said.push(`sensor ${j + 1} ${this.missingNow[j] && !silent ? "gives" : "gave"} no reading and is left out: ${count} estimates so far.`); });
    if (this.refused) said.push(`${this.refused} frames without an estimate. ${this.refusal}`);
    if (s <= n) said.push(`No redundancy, ${s} readings for ${n} unknowns: a wrong sensor looks like another shape and cannot be told.`);
    return said;
  }

  // ---- For the viewer, lengths in mm -------------------------------------------------------------------------------

  scene() {
    const { made } = this, reach = 1e3 * made.length * made.segments, side = 0.7 * reach + 1e3 * made.radius;
    return {
      label: `The shape of ${made.name} as estimated at the moment.`, box: [[-side, -side, 0], [side, side, 1.15 * reach]], radius: 1e3 * made.radius,
      shapes: [{ name: "estimate", role: "estimate", deviation: [] }], magnets: {}, sensors: {},
    };
  }

  frame() {
    const { body, low, high } = this.made, points = (q) => REPRO.backbone(body, q, 8), here = points(this.q), chain = frames(body, this.q);
    const slopes = this.q.map((_, c) => {
      const [up, down] = [1, -1].map((sign) => points(this.q.map((x, k) => (k === c ? x + sign * 1e-4 * (high[c] - low[c]) : x))));
      return up.map((p, k) => p.map((x, i) => (x - down[k][i]) / (2e-4 * (high[c] - low[c]))));
    });
    const deviation = here.map((_, k) => {
      const spread = [0, 1, 2].map((a) => [0, 1, 2].map((b) => covaried(this.C, slopes.map((one) => one[k][a]), slopes.map((one) => one[k][b]))));
      return 1e3 * Math.min(this.grown * Math.sqrt(Math.max(eigen(spread).values[2], 0)), this.made.length * this.made.segments);
    });
    const markers = (mounts) => {
      const all = placed(body, this.q, chain, mounts);
      return { points: all.flatMap(({ position }) => position.map((x) => 1e3 * x)), directions: all.flatMap(({ axis }) => axis) };
    };
    return { shapes: [{ points: here.flat().map((x) => 1e3 * x), deviation }], magnets: markers(body.magnets), sensors: markers(body.sensors) };
  }
}

Object.assign(BOARD, { toml, robotOf, sensingOf, calibrated, chance, Follower });
})();
