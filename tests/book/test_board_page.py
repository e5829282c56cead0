"""The page of the board with a port that is made up: it is fed what the emulated board sends, faults and all."""

from __future__ import annotations

import base64
import time
from pathlib import Path

import numpy as np
import pytest
from board_example import FAULTS, ROBOT, frames
from edition1.robot_file.load import load_robot
from edition1_live.emulate.board import Reading, passages
from edition1_live.emulate.faults import Faults
from edition1_live.record.export import export
from edition1_live.record.recording import read_recording
from edition1_live.wire.formats import parser
from page_on_screen import pixels, wait_until
from page_visit import AXE, SEVERE, VIOLATIONS, open_page

ROOT = Path(__file__).resolve().parents[2]
STATIC = ROOT / "book" / "_static"
LIVE = ROOT / "src" / "edition1" / "edition1_live"
OWN = ("live/model", "board/wire", "board/recording", "board/robot", "board/example", "board/board")
SCRIPTS = (
    LIVE / "follow/page/traces.js",
    *(STATIC / f"{name}.js" for name in OWN),
    LIVE / "view/viewer/shape_viewer.js",
)
PAGE = """<!doctype html><html lang="en" data-theme="light"><meta charset="utf-8"><title>A board</title>
<meta name="viewport" content="width=device-width"><link rel="stylesheet" href="{static}/board/board.css">
<style>:root {{ --pst-color-background: #fff; --pst-color-text-base: #222; --pst-color-text-muted: #555; }}</style>
<script>{before}</script><main><h1>A board</h1><h2>Here</h2><div class="board"></div></main>{scripts}"""
PORT = """
class Port extends EventTarget {
  get readable() { return this.stream; }
  getInfo() { return {usbVendorId: 0x2341, usbProductId: 0x43}; }
  async open({baudRate}) { this.stream = new ReadableStream({start: c => { this.controller = c; }}); }
  async close() { this.stream = null; }
  send(text) { this.controller.enqueue(Uint8Array.from(atob(text), c => c.charCodeAt(0))); }
  lose() { this.stream = null; this.controller.error(new DOMException("Lost.", "NetworkError")); }
}
const serial = new EventTarget();
window.port = new Port();
serial.requestPort = async () => window.port;
Object.defineProperty(navigator, "serial", {value: serial});
window.found = () => {
  const event = new Event("connect");
  Object.defineProperty(event, "target", {value: window.port});
  serial.dispatchEvent(event);
};
"""
FILE = """
window.written = [];
window.showSaveFilePicker = async () => ({name: "mine.rec", createWritable: async ({keepExistingData}) => {
  let now = keepExistingData ? window.written.slice() : [];
  return {
    write: async ({position, data}) => {
      new Uint8Array(await data.arrayBuffer()).forEach((x, k) => { now[position + k] = x; });
    },
    close: async () => {
      if (window.full) throw new DOMException("No space.", "QuotaExceededError");
      window.written = now;
    },
  };
}});
"""
NO_FILE = "delete window.showSaveFilePicker;"
COUNTERS = "() => document.querySelector('.board').board.session.counters"


@pytest.fixture
def board(browser, tmp_path):
    """Open a page with a board; nothing may be said on the console, and nothing asked outside."""
    opened = []

    def show(before: str = PORT + NO_FILE, *, width: int = 900):
        scripts = "".join(f'<script src="{script.as_uri()}"></script>' for script in SCRIPTS)
        path = tmp_path / "board.html"
        text = PAGE.format(static=STATIC.as_uri(), before=before, scripts=scripts)
        path.write_text(text, encoding="utf-8")
        page, seen = open_page(browser, path.as_uri(), width=width)
        opened.append((page, seen))
        return page

    yield show
    for page, seen in opened:
        page.wait_for_timeout(50)
        page.close()
        assert seen.console == []
        assert seen.asked_outside() == []


def connected(page, format: str = "frames"):
    page.get_by_label("Format").select_option(format)
    page.get_by_role("button", name="Connect a board").click()
    wait_until(page, "() => document.querySelector('.board').board.port !== null && Boolean(port.controller)")


def send(page, data: bytes) -> None:
    page.evaluate("text => port.send(text)", base64.b64encode(data).decode())


def status(page) -> str:
    return page.locator(".board-status").inner_text()


def emulated(count: int, rate_hz: float, faults: Faults) -> list[tuple[float, bytes]]:
    """What a board with three sensors sends, in pieces with the times at which they end."""
    rng = np.random.default_rng(0)
    readings = (Reading(k / rate_hz, 0, tuple(rng.normal(size=3).tolist())) for k in range(count))
    return [
        (float(one.time_s[-1]), one.data)
        for one in passages(readings, "frames", faults, seed=1)
        if len(one.time_s)
    ]


def test_counters_of_a_hundred_thousand_frames_are_those_of_the_reader(board):
    """Of the bytes of the emulated board with faults, at a thousand frames a second and faster."""
    page, faults = board(), Faults(flips=2e-4, drops=1e-4, duplicates=1e-4, bursts=1e-5, reboots=1e-4)
    connected(page)
    data = b"".join(piece for _, piece in emulated(100_000, 1000.0, faults))
    reader = parser("frames")
    for first in range(0, len(data), 31_000):
        send(page, data[first : first + 31_000])
        reader.feed(data[first : first + 31_000])
    wait_until(page, f"() => ({COUNTERS})().received_bytes === {len(data)}")
    found = page.evaluate(COUNTERS)
    assert found == reader.counters.as_dict() | {"reconnects": 0, "received_bytes": len(data)}
    assert found["gaps"] > 100
    assert found["checksum_errors"] > 100
    shown = page.locator(".board dd").all_inner_texts()
    wait_until(page, f"() => document.querySelector('.board dd').textContent === '{found['frames']}'")
    assert len(shown) == 10


def test_a_thousand_frames_a_second_without_loss_and_drawn_in_time(board, record_property):
    """Ten seconds in real time, with the shape; nothing is lost, and drawing takes at most 16 ms nearly always."""
    page, seconds = board(), 10
    robot = load_robot(ROBOT)
    page.get_by_label("Robot file, calibration").set_input_files(ROBOT)
    wait_until(page, "() => document.querySelector('.board').board.follower !== null")
    u = robot.values(robot.start).tolist()
    rng = np.random.default_rng(0)
    readings = (
        Reading(k / 1e3, 0, tuple(np.add(u, 7e-4 * rng.normal(size=8)).tolist()))
        for k in range(1000 * seconds)
    )
    data = b"".join(one.data for one in passages(readings, "frames", Faults(), seed=1))
    connected(page)
    page.evaluate(
        """([text, seconds]) => new Promise(done => {
          const bytes = Uint8Array.from(atob(text), c => c.charCodeAt(0)), began = performance.now();
          let sent = 0;
          const timer = setInterval(() => {
            const share = Math.min((performance.now() - began) / 1e3 / seconds, 1);
            const end = Math.floor(share * bytes.length);
            if (end > sent) port.controller.enqueue(bytes.subarray(sent, end));
            sent = end;
            if (end === bytes.length) { clearInterval(timer); setTimeout(done, 200); }
          }, 4);
        })""",
        [base64.b64encode(data).decode(), seconds],
    )
    found = page.evaluate(COUNTERS)
    assert (found["frames"], found["gaps"], found["checksum_errors"]) == (1000 * seconds, 0, 0)
    draw_ms = np.array(page.evaluate("() => document.querySelector('.board').board.drawMs"))
    record_property("draw_ms_p95", float(np.quantile(draw_ms, 0.95)))
    print(
        f"drawing: median {np.median(draw_ms):.2f} ms, p95 {np.quantile(draw_ms, 0.95):.2f} ms of {len(draw_ms)}"
    )
    assert np.quantile(draw_ms, 0.95) <= 16
    assert status(page) == "Receiving."


def test_half_an_hour_of_memory(board):
    """What the page keeps after thirty minutes at a thousand frames a second, faster than real time."""
    page = board(PORT + FILE)
    piece = b"".join(data for _, data in emulated(60_000, 1000.0, Faults()))
    kept = page.evaluate(
        """async text => {
          const bytes = Uint8Array.from(atob(text), c => c.charCodeAt(0));
          const about = {port: "p", baud: 1, start_ms: 0, start_unix_s: 0, system: ""};
          const session = new BOARD.Session("frames", about);
          const sizes = () => { const t = session.traces, r = session.recording; return {
            bins: t.bins.length, names: t.names.length, places: t.places.size,
            tail: r.tailBytes, parts: r.parts.length,
            begun: session.parser.begun.length, waiting: session.waiting.length, last: session.parser.last.size}; };
          const seen = [];
          for (let minute = 0; minute < 30; minute++) {
            for (let s = 0; s < 600; s++) {
              const [begin, end] = [s, s + 1].map(k => Math.round(k * bytes.length / 600));
              session.take(60000 * minute + 100 * s, bytes.subarray(begin, end));
            }
            const file = {write: async () => {}, close: async () => {}};
            session.recording.handle ??= {createWritable: async () => file};
            await session.recording.save();
            seen.push(sizes());
          }
          const {saved, bytes: all} = session.recording;
          return {seen, frames: session.counters.frames, saved, bytes: all};
        }""",
        base64.b64encode(piece).decode(),
    )
    assert kept["frames"] == 30 * 60_000
    assert kept["saved"] == kept["bytes"] > 30 * 60_000 * 44
    for sizes in kept["seen"]:
        assert sizes["bins"] <= 802
        assert sizes["names"] == sizes["places"] == 3
        assert sizes["tail"] == sizes["parts"] == sizes["waiting"] == 0
        assert sizes["begun"] <= 253
        assert sizes["last"] == 1


def test_the_recording_is_read_by_python(board, tmp_path):
    """A download; the port is lost and comes back in between. The file of the counters completes it."""
    page, data = board(), b"".join(piece for _, piece in emulated(2000, 1000.0, Faults(flips=3e-4)))
    connected(page)
    reader, half = parser("frames"), len(data) // 2
    sent = reader.feed(data[:half])
    send(page, data[:half])
    wait_until(page, f"() => ({COUNTERS})().received_bytes === {half}")
    page.evaluate("port.lose()")
    wait_until(
        page, "() => document.querySelector('.board-status').textContent.startsWith('The port is gone')"
    )
    page.evaluate("found()")
    wait_until(page, f"() => ({COUNTERS})().reconnects === 1 && Boolean(port.stream)")
    reader.reopened()
    sent += reader.feed(data[half:])
    send(page, data[half:])
    wait_until(page, f"() => ({COUNTERS})().received_bytes === {len(data)}")
    for button, name in (
        ("Save the recording", "recording.rec"),
        ("Save the counters", "recording.rec.json"),
    ):
        with page.expect_download() as download:
            page.get_by_role("button", name=button).click()
        assert download.value.suggested_filename == name
        download.value.save_as(tmp_path / name)
    recording = read_recording(tmp_path / "recording.rec")
    assert [frame for _, frame in recording.as_frames()] == sent
    assert [note["event"] for note in recording.notes] == ["lost", "reopened"]
    assert recording.remarks == ()
    assert recording.metadata["counters"] == page.evaluate(COUNTERS)
    assert abs(recording.metadata["start_unix_s"] - time.time()) < 60
    assert (np.diff(recording.frames["host_ns"]) >= 0).all()
    export(recording, tmp_path / "table.csv")


def test_a_file_that_was_chosen_is_kept_up_to_date(board, tmp_path):
    page, data = board(PORT + FILE), b"".join(piece for _, piece in emulated(300, 100.0, Faults()))
    connected(page)
    send(page, data[:2000])
    wait_until(page, f"() => ({COUNTERS})().frames > 10")
    page.get_by_role("button", name="Save the recording").click()
    wait_until(page, "() => written.length > 0")
    first = page.evaluate("written.length")
    send(page, data[2000:])
    wait_until(page, f"() => ({COUNTERS})().frames === 300")
    page.evaluate("window.full = true")
    page.get_by_role("button", name="Save the recording").click()
    wait_until(page, "() => document.querySelector('.board-notes').textContent.includes('failed: No space.')")
    assert page.evaluate("written.length") == first
    page.evaluate("window.full = false")
    page.get_by_role("button", name="Disconnect").click()
    wait_until(
        page, "() => written.length === document.querySelector('.board').board.session.recording.bytes"
    )
    (tmp_path / "mine.rec").write_bytes(bytes(page.evaluate("written")))
    recording = read_recording(tmp_path / "mine.rec")
    assert [frame for _, frame in recording.as_frames()] == parser("frames").feed(data)
    assert recording.remarks == ()


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"".join(b"%d,%d,-7\r\n" % (k, k) for k in range(200)), "The format is hall."),
        (
            b"X: 1.5 uT, Y: -3 uT\r\n" * 100,
            "The lines have 2 values a line, separated by commas: X_uT, Y_uT.",
        ),
    ],
)
def test_the_format_is_found_out(board, data, words):
    page = board()
    connected(page, "")
    send(page, data[:1000])
    page.wait_for_timeout(1600)
    send(page, data[1000:])
    wait_until(page, f"() => ({COUNTERS})().frames > 0")
    assert words in page.locator(".board-notes").inner_text()


def test_what_is_of_no_format_is_said(board):
    page, noise = board(), np.random.default_rng(0).integers(1, 256, 4000, dtype=np.uint8).tobytes()
    connected(page, "")
    for first in (0, 2000):
        send(page, noise[first : first + 2000])
        page.wait_for_timeout(1600)
    assert "of none of the formats" in status(page) or "No readings" in status(page)
    send(page, noise[:500])
    wait_until(
        page, "() => document.querySelector('.board-status').textContent.includes('of none of the formats')"
    )


def test_silence_is_said(board):
    page = board()
    connected(page)
    send(page, frames()[:3000])
    wait_until(page, "() => document.querySelector('.board-status').textContent === 'Receiving.'")
    wait_until(
        page,
        "() => document.querySelector('.board-status').textContent === 'No readings: nothing arrives any more.'",
    )
    send(page, b"hello" * 20)
    wait_until(
        page, "() => /Bytes arrive, but no frame/.test(document.querySelector('.board-status').textContent)"
    )


@pytest.mark.parametrize("width", [390, 1400])
def test_the_example(board, width):
    """By keyboard; it fits the page and is accessible, and once the sensor sticks the shape is not trusted."""
    page = board(width=width)
    page.evaluate("BOARD.example.seconds = 4")
    page.get_by_role("button", name="Play an example").focus()
    page.keyboard.press("Enter")
    wait_until(page, "() => document.querySelectorAll('.board-quantities li').length === 9")
    assert pixels(page.locator(".board > canvas")).std() > 5
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    wait_until(page, "() => document.querySelector('.board-mark').textContent.startsWith('wrong')")
    assert "Wrong, not to be trusted" in page.locator(".board-troubles").inner_text()
    wait_until(
        page, "() => document.querySelector('.board-status').textContent.startsWith('The example is over')"
    )
    reader = parser("frames")
    reader.feed(frames())
    assert page.evaluate(COUNTERS)["frames"] == reader.counters.frames
    assert FAULTS.flips > 0 < reader.counters.checksum_errors
    page.evaluate(AXE.read_text(encoding="utf-8"))
    assert [one for one in page.evaluate(VIOLATIONS, None) if one["impact"] in SEVERE] == []


def test_deviations_are_grown_as_asked(board):
    """Those that are shown at once, also when all is over; a number that cannot be is refused, and the last stays."""
    page = board()
    numbers = "() => [...document.querySelectorAll('.board-quantities li')].map(x => x.textContent)"
    page.evaluate("BOARD.example.seconds = 1")
    page.get_by_role("button", name="Play an example").click()
    wait_until(
        page, "() => document.querySelector('.board-status').textContent.startsWith('The example is over')"
    )
    field = page.get_by_label("Deviations grown by (the factor that repro fit states)")
    stated = page.evaluate(numbers)
    field.fill("2.5")
    field.press("Enter")
    grown = page.evaluate(numbers)
    assert grown.pop() == "Every ± is 2.5 times what the estimator states."
    assert len(grown) == len(stated) == 9
    for before, after in zip(stated, grown, strict=True):
        (name, small), (same, large) = (text.removesuffix(" mm").split(" ± ") for text in (before, after))
        assert name == same
        assert float(large) == pytest.approx(2.5 * float(small), abs=1.8e-3)
    for wrong in ("-1", "0", ""):
        field.fill(wrong)
        field.press("Enter")
        said = f"must be a positive number; instead received {wrong or 'none'}."
        assert page.locator(".board-notes").inner_text().endswith(said)
        assert field.input_value() == "2.5"
    assert page.evaluate(numbers)[:9] == grown
    page.get_by_label("Robot file, calibration").set_input_files(ROBOT)
    wait_until(page, "() => document.querySelector('.board').board.follower.q === null")
    assert page.evaluate("document.querySelector('.board').board.follower.grown") == 2.5


def test_without_web_serial_the_page_says_so(board):
    page = board("Object.defineProperty(navigator, 'serial', {value: undefined});")
    assert "Firefox and Safari have no Web Serial" in status(page)
    assert page.get_by_role("button", name="Connect a board").is_disabled()


def test_what_a_robot_cannot_tell_is_remarked(board, tmp_path):
    """As long as the robot is shown, whatever else is said."""
    page, path = board(), tmp_path / "robot.toml"
    text = ROBOT.read_text(encoding="utf-8")
    path.write_text(text.replace("noise_mt = 7.1e-4", "noise_mt = 0.5"), encoding="utf-8")
    page.get_by_label("Robot file, calibration").set_input_files(path)
    remarks = page.locator(".board-remarks li")
    wait_until(page, "() => document.querySelectorAll('.board-remarks li').length > 0")
    assert tuple(remarks.all_inner_texts()) == load_robot(path).notes
    page.get_by_label("Robot file, calibration").set_input_files(ROBOT)
    wait_until(page, "() => document.querySelectorAll('.board-remarks li').length === 0")


def test_what_is_wrong_with_a_file_is_said(board, tmp_path):
    page, path = board(), tmp_path / "robot.toml"
    path.write_text(ROBOT.read_text(encoding="utf-8").replace("radius_mm", "radius_m", 1), encoding="utf-8")
    page.get_by_label("Robot file, calibration").set_input_files(path)
    wait_until(
        page,
        "() => document.querySelector('.board-notes').textContent.includes('robot.toml, line 14, [[segments]] 1')",
    )
    (tmp_path / "c.json").write_text("{}", encoding="utf-8")
    page.get_by_label("Robot file, calibration").set_input_files(tmp_path / "c.json")
    wait_until(
        page, "() => document.querySelector('.board-notes').textContent.includes('after its robot file')"
    )
