"""The page on wire formats and the firmware: the encoder in C, the sketch, the examples, what damage does to text."""

import ctypes
import math
import re
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

wire = pytest.importorskip("repro_board.wire")
ROOT = Path(__file__).parents[2]
FIRMWARE = ROOT / "firmware"
PAGE = (ROOT / "book" / "wire_formats.md").read_text(encoding="utf-8")
KINDS = {"float32": (1, ctypes.c_float, 59), "int16": (2, ctypes.c_int16, 118)}
ARDUINO = """
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
static struct {
  void begin(long) {}
  size_t write(const uint8_t *data, size_t size) { return fwrite(data, 1, size, stdout); }
} Serial;
static uint32_t now = 4294960000ul;
static inline uint32_t micros() { return now += 7; }
"""
WIRE = """
#include <stdint.h>
static const int16_t COUNTS[2][3] = {{1000, -2000, 3}, {-32768, 16384, 32767}};
static bool unplugged = false;
static struct {
  uint8_t registers[2][256], address = 0, at = 0, left = 0, sent = 0;
  int chip() { return address == 0x35 ? 0 : address == 0x22 && !unplugged ? 1 : -1; }
  void begin() {}
  void setClock(long) {}
  void beginTransmission(uint8_t to) { address = to; sent = 0; }
  void write(uint8_t byte) {
    if (sent++ == 0) at = byte; else if (chip() >= 0) registers[chip()][at++] = byte;
  }
  uint8_t endTransmission(bool = true) { return chip() >= 0 ? 0 : 2; }
  uint8_t requestFrom(uint8_t from, uint8_t n) { address = from; return left = chip() >= 0 ? n : 0; }
  int read() {
    const uint8_t *own = registers[chip()];
    const bool measures = own[0] == 0x14 && (own[1] & 3) == 2 && own[2] >> 4 == 7 && own[3] == 0;
    const int k = at++ - 0x12;
    if (left-- == 0 || k < 0 || k > 5 || !measures) return 0;
    return COUNTS[chip()][k / 2] >> (k % 2 ? 0 : 8) & 0xff;
  }
} Wire;
"""
"""A board that is made up: its clock wraps, and two chips on its bus measure once their registers are set."""


def compiler(*names: str) -> str:
    found = next((name for name in names if shutil.which(name)), None)
    if found is None:
        pytest.skip(f"No compiler: none of {', '.join(names)} is installed.")
    return found


@pytest.fixture(scope="module")
def encode_in_c(tmp_path_factory):
    """Return the encoder in C: values, number of their type, and what else a frame has; it keeps to its memory."""
    library = tmp_path_factory.mktemp("c") / "frame_encoder.so"
    flags = ["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror", "-shared", "-fPIC"]
    sources = [str(FIRMWARE / "frame_encoder.c"), "-o", str(library)]
    subprocess.run([compiler("cc", "gcc", "clang"), *flags, *sources], check=True, timeout=60)
    function = ctypes.CDLL(str(library)).encode_frame
    function.restype = ctypes.c_size_t
    u8, u32 = ctypes.c_uint8, ctypes.c_uint32
    function.argtypes = [ctypes.c_char_p, u8, u8, ctypes.c_void_p, u8, u32, u32]

    def encode(values, kind, stream=0, sequence=0, time_us=0, code=None) -> bytes:
        number, c_type, _ = KINDS[kind]
        out = ctypes.create_string_buffer(b"\xaa" * 300, 300)
        given_values = (c_type * max(len(values), 1))(*values)
        length = function(out, stream, code or number, given_values, len(values), sequence, time_us)
        assert out.raw[max(length, 255) :] == b"\xaa" * (300 - max(length, 255))
        return out.raw[:length]

    return encode


@st.composite
def frames(draw):
    kind = draw(st.sampled_from(list(KINDS)))
    one = st.floats(width=32) if kind == "float32" else st.integers(-32768, 32767)
    values = draw(st.lists(one, min_size=1, max_size=KINDS[kind][2]))
    word = st.integers(0, 2**32 - 1)
    return values, kind, draw(st.integers(0, 255)), draw(word), draw(word)


@settings(max_examples=200)
@given(drawn=frames())
def test_the_encoder_in_c_writes_the_bytes_of_ours(encode_in_c, drawn):
    values, kind, stream, sequence, time_us = drawn
    values = [math.nan if math.isnan(value) else value for value in values]  # NaN has many forms: take one
    found = encode_in_c(values, kind, stream, sequence, time_us)
    assert found == wire.encode(values, stream, sequence, time_us, kind)


def test_the_encoder_in_c_refuses_what_does_not_fit(encode_in_c):
    assert encode_in_c([], "float32") == b""
    assert encode_in_c([0.0] * 60, "float32") == b""
    assert encode_in_c([0] * 119, "int16") == b""
    assert encode_in_c([0.0], "float32", code=3) == b""
    assert len(encode_in_c([0.0] * 59, "float32")) == 255


def test_the_sketch_sends_frames(tmp_path):
    """Six readings every 10 ms, also where the clock wraps; a chip is unplugged, and comes back without settings."""
    for name in ("frame_encoder.c", "frame_encoder.h"):
        shutil.copy(FIRMWARE / name, tmp_path)
    sketch = (FIRMWARE / "firmware.ino").read_text(encoding="utf-8")
    cases = "if (i == 4) Wire.registers[1][1] = 0; unplugged = i == 3 || i == 4;"
    run = f"int main() {{ setup(); for (int i = 0; i < 8; i++) {{ {cases} loop(); }} return 0; }}\n"
    for name, text in (("Wire.h", WIRE), ("sketch.cpp", ARDUINO + sketch + run)):
        (tmp_path / name).write_text(text, encoding="utf-8")
    sources = ["-I.", "sketch.cpp", "-x", "c++", "frame_encoder.c", "-o", "sketch"]
    build = [compiler("c++", "g++", "clang++"), "-std=c++11", "-Wall", "-Wextra", "-Werror", *sources]
    subprocess.run(build, cwd=tmp_path, check=True, timeout=60)
    sent = subprocess.run([str(tmp_path / "sketch")], capture_output=True, check=True, timeout=60).stdout
    samples = wire.Parser("frames").feed(sent)
    assert [sample.sequence for sample in samples] == list(range(8))
    np.testing.assert_allclose(np.diff([sample.time_us for sample in samples]), 10_000, atol=10)
    one, two = [1000 * 40e3 / 32768, -2000 * 40e3 / 32768, 3 * 40e3 / 32768], [math.nan, 20e3, math.nan]
    expected = np.array([[*one, *two]] * 8)  # in µT; the ends of the range are no readings
    expected[3:6, 3:] = math.nan
    np.testing.assert_allclose([1e3 * sample.values for sample in samples], expected, rtol=1e-6)


LIBRARY = """
#include <cmath>
#include <cstdio>
#include <string>
enum { MLX90393_GAIN_5X, MLX90393_FILTER_2, MLX90393_OSR_1 };
static unsigned long millis() { static unsigned long now; return now += 20; }
struct String : std::string {
  String(std::string text) : std::string(text) {}
  String(const char *text) : std::string(text) {}
  String(int k) : std::string(std::to_string(k)) {}
  String(unsigned long k) : std::string(std::to_string(k)) {}
  String(float x) { char text[32]; std::snprintf(text, sizeof text, "%.2f", x); assign(text); }
};
static struct {
  void begin(long) {}
  void print(const String &text) { std::fputs(text.c_str(), stdout); }
  void println() { std::puts("\\r"); }
} Serial;
struct Adafruit_MLX90393 {
  int address;
  bool begin_I2C(int where) { address = where; return true; }
  bool setGain(int) { return true; }
  bool setFilter(int) { return true; }
  bool setOversampling(int) { return true; }
  bool readData(float *x, float *y, float *z) {
    if (address == 0x0E) return false;
    *x = 100.5f * address; *y = -1.25f; *z = 3;
    return true;
  }
};
"""
"""Four chips with a library, of which the third does not answer."""


def test_the_sketch_with_a_library_prints_lines(tmp_path):
    (sketch,) = re.findall(r"```cpp\n(#include <Adafruit.*?)```", PAGE, re.DOTALL)
    (tmp_path / "Adafruit_MLX90393.h").write_text(LIBRARY)
    run = "int main() { setup(); for (int i = 0; i < 9; i++) loop(); return 0; }\n"
    (tmp_path / "sketch.cpp").write_text(sketch + run)
    build = [compiler("c++", "g++", "clang++"), "-std=c++11", "-Wall", "-I.", "sketch.cpp", "-o", "sketch"]
    subprocess.run(build, cwd=tmp_path, check=True, timeout=60)
    sent = subprocess.run([str(tmp_path / "sketch")], capture_output=True, check=True, timeout=60).stdout
    samples = wire.Parser().feed(sent)
    assert len(samples) == 8  # the first line may be the end of one
    lost = [math.nan] * 3
    one = [1206, -1.25, 3, 1306.5, -1.25, 3, *lost, 1507.5, -1.25, 3]
    np.testing.assert_allclose([sample.values for sample in samples], [one] * 8)


def test_the_examples_of_the_page_are_what_is_written():
    frame = re.search(r"^\| frame \| (.*) \|$", PAGE, re.MULTILINE)
    assert frame
    assert bytes.fromhex(frame[1].replace("`", "")) == wire.encode([1.0], 7, 1, 1000)
    for format in ("hall", "millivolts", "quaternions"):
        assert f"Example: `{text(format, EXAMPLES[format]).decode().strip()}`" in PAGE


@pytest.mark.parametrize("line", re.findall(r"```text\n(.*?)```", PAGE, re.DOTALL)[0].splitlines())
def test_lines_of_the_page_are_read(line):
    parser = wire.Parser()
    found = parser.feed(f"{line}\n".encode() * 4)
    assert parser.format == "csv"
    assert len(found) == 3
    assert (
        len(found[0].values) == line.count(",") + 1 - ("t:" in line)
        if "," in line
        else len(found[0].values) > 1
    )


def test_all_counters_are_explained():
    assert re.findall(r"^\| `(\w+)` \| [a-z]", PAGE, re.MULTILINE)[-9:] == [
        "frames", "checksum_errors", "malformed", "oversized", "first_partial", "gaps", "restarts", "repeats",
        "discarded_bytes",
    ]  # fmt: skip
    assert set(wire.Parser().counters) <= set(re.findall(r"`(\w+)`", PAGE))


# ---- what damage does ----

TURN = (0.0625, -0.25, 0.5, math.sqrt(1 - 0.0625**2 - 0.25**2 - 0.5**2))
EXAMPLES = {
    "frames": (1282.125, 1205.0625, 1387.4375),
    "hall": (-12.0, 187.0, -2310.0),
    "millivolts": (1282.125, 1205.0625, 1387.4375),
    "quaternions": TURN,
    "csv": (1.25, -3.5, 0.0625),
}


def text(format: str, values, later: int = 0) -> bytes:
    if format == "frames":
        return wire.encode(values, 0, 41 + later, 123_456_789)
    return wire.text_line(values, format, 3 * (format == "quaternions"))


def flips(sent: bytes) -> Iterator[bytes]:
    for place in range(len(sent)):
        for bit in range(8):
            yield sent[:place] + bytes([sent[place] ^ 1 << bit]) + sent[place + 1 :]


def losses(sent: bytes) -> Iterator[bytes]:
    return (sent[:place] + sent[place + 1 :] for place in range(len(sent)))


def doubles(sent: bytes) -> Iterator[bytes]:
    return (sent[: place + 1] + sent[place:] for place in range(len(sent)))


def received(format: str, damaged: bytes) -> list[tuple]:
    """Return what arrives of damaged bytes between two sound neighbours with other readings."""
    values = EXAMPLES[format]
    other = (0.5, 0.5, -0.5, 0.5) if format == "quaternions" else tuple(value + 1 for value in values)
    before, after = text(format, other, -1), text(format, other, 1)
    parser = wire.Parser(format)
    parser.feed(b"" if format == "frames" else b"\n" + 3 * before)  # three lines tell their form
    return [(s.stream, s.sequence, *s.values) for s in parser.feed(before + damaged + after)]


@pytest.mark.parametrize("format", EXAMPLES)
def test_how_often_damage_passes_is_what_the_page_says(format):
    sent = text(format, EXAMPLES[format])
    sound, cells = received(format, sent), []
    for damage in (flips, losses, doubles):
        outcomes = [received(format, damaged) for damaged in damage(sent)]
        cells.append(f"{sum(any(x not in sound for x in found) for found in outcomes)} of {len(outcomes)}")
    assert f"| `{format}` | {' | '.join(cells)} |" in PAGE
