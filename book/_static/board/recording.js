/* The recording in the browser: byte for byte the file that `repro record` writes of the same frames and times, so that
   `repro export` reads it. What is durable and what the blocks hold stands in edition1_live/record/recording_file.py. */
(function () {
"use strict";

const MAGIC = 0x31425252, HEAD = 16, MOST_FRAMES = 65536, PART_BYTES = 1 << 20; // "RRB1"

/** JSON as Python writes it. */
function json(x) {
  if (Array.isArray(x)) return `[${x.map(json).join(", ")}]`;
  if (x !== null && typeof x === "object") return `{${Object.entries(x).map(([key, value]) => `${json(key)}: ${json(value)}`).join(", ")}}`;
  if (typeof x !== "string") return String(x);
  return JSON.stringify(x).replace(/[\x7f-\uffff]/g, (c) => "\\u" + c.charCodeAt(0).toString(16).padStart(4, "0"));
}

/** A block with room for its content: {bytes, view, seal()}; sealing puts the checksum in. */
function block(kind, width, count, size) {
  const bytes = new Uint8Array(HEAD + size), view = new DataView(bytes.buffer);
  view.setUint32(0, MAGIC, true);
  view.setUint8(4, kind.charCodeAt(0));
  view.setUint16(6, width, true);
  view.setUint32(8, count, true);
  const seal = () => {
    view.setUint32(12, BOARD.crc32(bytes.subarray(HEAD), BOARD.crc32(bytes.subarray(0, 12))), true);
    return bytes;
  };
  return { bytes, view, seal };
}

function textBlock(content) {
  const text = new TextEncoder().encode(json(content)), made = block("H", 0, text.length, text.length);
  made.bytes.set(text, HEAD);
  return made.seal();
}

function framesBlock(host_ns, frames) {
  const width = frames.reduce((most, frame) => Math.max(most, frame.values.length), 0), size = 20 + 8 * width;
  const { view, seal } = block("F", width, frames.length, size * frames.length);
  frames.forEach(({ stream, sequence, device_us, values }, k) => {
    const at = HEAD + k * size;
    view.setBigInt64(at, host_ns, true);
    view.setUint32(at + 8, device_us ?? 0, true);
    view.setUint32(at + 12, sequence ?? 0, true);
    view.setUint16(at + 16, stream, true);
    view.setUint8(at + 18, values.length);
    view.setUint8(at + 19, (sequence === null ? 0 : 1) + (device_us === null ? 0 : 2));
    values.forEach((value, j) => view.setFloat64(at + 20 + 8 * j, value, true));
  });
  return seal();
}

/** A recording that grows. Until it is saved the page keeps it, as Blobs, which a browser may put on its disk; what a
    file has is kept no longer. */
class Recording {
  /** `metadata`: format, start_unix_s and start_host_ns at least; whole numbers that are large as BigInt. */
  constructor(metadata) {
    Object.assign(this, { metadata, parts: [], tail: [], tailBytes: 0, frames: 0, bytes: 0, saved: 0, handle: null, saving: null });
    this.put(textBlock(metadata));
  }

  put(bytes) {
    this.tail.push(bytes);
    this.tailBytes += bytes.length;
    this.bytes += bytes.length;
    if (this.tailBytes >= PART_BYTES) this.pack();
  }

  pack() {
    if (this.tail.length) this.parts.push(new Blob(this.tail));
    [this.tail, this.tailBytes] = [[], 0];
  }

  /** Frames that arrived together, at a time of the host's monotonic clock [ns, BigInt]. */
  append(host_ns, frames) {
    for (let first = 0; first < frames.length; first += MOST_FRAMES) this.put(framesBlock(host_ns, frames.slice(first, first + MOST_FRAMES)));
    this.frames += frames.length;
  }

  /** What happened to the port, such as {event: "reopened", host_ns: 17n}. */
  note(content) {
    this.put(textBlock(content));
  }

  /** All of it, as long as no file has a part. */
  blob() {
    this.pack();
    return new Blob(this.parts, { type: "application/octet-stream" });
  }

  /** Put what it does not have yet into the file; on the disk once this is done. One call at a time. */
  async save() {
    if (this.saving) await this.saving.catch(() => {});
    this.saving = this.written();
    await this.saving;
  }

  async written() {
    this.pack();
    const parts = this.parts.slice(), data = new Blob(parts);
    if (!data.size) return;
    const file = await this.handle.createWritable({ keepExistingData: this.saved > 0 });
    await file.write({ type: "write", position: this.saved, data });
    await file.close(); // before this, the file is as it was
    this.saved += data.size;
    this.parts.splice(0, parts.length);
  }
}

Object.assign(BOARD, { Recording, json });
})();
