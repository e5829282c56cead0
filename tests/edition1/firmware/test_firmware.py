"""The firmware, compiled and run on a simulated ATmega328P whose sensors read what magpylib says."""

from __future__ import annotations

import contextlib
import re
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from edition1.robot_file.load import load_robot
from edition1_live.emulate.robot_readings import course, readings_along
from edition1_live.record.recorder import record
from edition1_live.record.recording import read_recording
from edition1_live.wire.binary import BinaryParser
from edition1_live.wire.frame import Frame
from tools import ARDUINO, missing

ROOT = Path(__file__).resolve().parents[3]
FIRMWARE = ROOT / "firmware"
SKETCHES = ("analogue_hall", "three_axis_hall", "eight_imus")
STRICT = [
    "-std=c99",
    "-Wall",
    "-Wextra",
    "-Werror",
    "-O2",
    "-ffunction-sections",
    "-fdata-sections",
    f"-I{FIRMWARE}",
]
AVR = ["avr-gcc", "-mmcu=atmega328p", "-DF_CPU=16000000UL", *STRICT, "-Wl,--gc-sections"]
CORE = ARDUINO / "cores" / "arduino"
IDE = [
    *("-mmcu=atmega328p", "-DF_CPU=16000000L", "-DARDUINO=10819", "-DARDUINO_AVR_UNO", "-DARDUINO_ARCH_AVR"),
    *(f"-I{CORE}", f"-I{ARDUINO / 'variants' / 'standard'}", f"-I{FIRMWARE}"),
    *("-Os", "-flto", "-ffat-lto-objects", "-ffunction-sections", "-fdata-sections"),
]
"""What platform.txt of the core says."""
IDE_C = ["avr-gcc", "-std=gnu11", *IDE]
IDE_CPP = ["avr-g++", "-std=gnu++11", "-fpermissive", "-fno-exceptions", "-fno-threadsafe-statics", *IDE]
IDE_PERIOD_US = {"analogue_hall": 5500, "three_axis_hall": 5000, "eight_imus": 10000}
STATUS = 255
MV_PER_MT, REST_MV = 50.0, 2500.0  # DRV5055A2 at 5 V
SLAVES = {"analogue_hall": slice(0, 12), "three_axis_hall": slice(12, 24), "eight_imus": slice(24, 56)}

pytestmark = pytest.mark.skipif(bool(missing()), reason=f"not installed: {', '.join(missing())}")


def build(command: list[str]) -> None:
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.fixture(scope="module")
def built(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("firmware")
    sources = [str(path) for path in FIRMWARE.glob("*.c")]
    for name in SKETCHES:
        sketch = FIRMWARE / "examples" / name / f"{name}.ino"
        build(
            [*AVR, *sources, "-x", "c", str(sketch), "-x", "none", "-lm", "-o", str(folder / f"{name}.elf")]
        )
    simulate = str(FIRMWARE / "simulation" / "simulate.c")
    flags = ["-O2", "-std=c99", "-Wall", "-Wextra", "-Werror"]
    build(["gcc", *flags, simulate, "-lsimavr", "-lelf", "-o", str(folder / "simulate")])
    return folder


def arguments(built: Path, sketch: str, time_us, rows, port, seconds, speed, *events: str, build: str = ""):
    table = np.zeros((len(rows), 57))
    table[:, 0] = time_us
    table[:, 1:][:, SLAVES[sketch]] = rows
    np.savetxt(built / "readings.txt", table, fmt="%.6f")
    program = [str(built / "simulate"), str(built / f"{build}{sketch}.elf"), str(built / "readings.txt")]
    return [*program, port, str(seconds), str(speed), *events]


def frames_of(built: Path, sketch: str, time_us, rows, seconds: float, *events: str, build: str = ""):
    command = arguments(built, sketch, time_us, rows, "-", seconds, 0, *events, build=build)
    done = subprocess.run(command, capture_output=True, stdin=subprocess.DEVNULL, check=False)
    assert done.returncode == 0, done.stderr
    parser = BinaryParser()
    frames = parser.feed(done.stdout)
    return frames, parser.counters


def stream(frames: list[Frame], number: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    own = [frame for frame in frames if frame.stream == number]
    return tuple(np.array(part) for part in zip(*(frame[1:] for frame in own), strict=True))


def field_mt(seconds: float) -> tuple[np.ndarray, np.ndarray]:
    """Times [us] and the field at the nine sensors of a moving robot [mT], by magpylib; synthetic."""
    robot = load_robot(ROOT / "data" / "robots" / "three_segments.toml")
    time_s = np.arange(0, seconds, 0.05)
    values = readings_along(robot, time_s, course(robot, time_s)).values
    return 1e6 * time_s, values


def voltages(values_mt: np.ndarray) -> np.ndarray:
    rows = np.zeros((len(values_mt), 3, 4))
    rows[:, :, :3] = (REST_MV + MV_PER_MT * values_mt).reshape(-1, 3, 3)
    return rows.reshape(-1, 12)


def agrees(device_us, values, time_us, expected, tolerance: float, slack_us: float = 6000.0) -> None:
    """Every value was that of its channel at some time during its round."""
    first = np.searchsorted(time_us, device_us, side="right") - 1
    last = np.searchsorted(time_us, device_us + slack_us, side="right") - 1
    gap = np.minimum(abs(values - expected[first]), abs(values - expected[last]))
    assert np.nanmax(gap) <= tolerance


def steady(sequence, device_us, period_us: float, jitter_us: float = 1000.0) -> None:
    assert (np.diff(sequence) == 1).all()
    assert abs(device_us - device_us[0] - period_us * np.arange(len(device_us))).max() < jitter_us


def check_nine_channels(built: Path, seconds: float) -> int:
    time_us, mt = field_mt(seconds)
    frames, counters = frames_of(built, "analogue_hall", time_us, voltages(mt), seconds)
    sequence, device_us, values = stream(frames, 0)
    steady(sequence, device_us, 5000)
    assert len(sequence) >= 200 * seconds - 3
    assert counters.as_dict() == {**dict.fromkeys(counters.as_dict(), 0), "frames": len(frames)}
    agrees(device_us, values, time_us, REST_MV + MV_PER_MT * mt, 0.1875 / 2 + 1e-3)
    _, _, status = stream(frames, STATUS)
    assert status[-1].tolist() == [0, 1, *[0] * 12]
    return len(sequence)


def test_nine_analogue_sensors_arrive_whole_in_order_and_at_200_hz(built):
    check_nine_channels(built, 8.0)


def test_three_axis_sensors_arrive_at_200_hz(built):
    time_us, mt = field_mt(4.0)
    ut = 1000 * np.concatenate([mt, mt[:, :3] / 2], axis=1)
    frames, counters = frames_of(built, "three_axis_hall", time_us, ut, 4.0)
    sequence, device_us, values = stream(frames, 0)
    assert (np.diff(sequence) == 1).all()
    assert len(sequence) >= 797
    assert counters.gaps == counters.checksum_errors == counters.malformed == 0
    agrees(device_us, values, time_us, ut / 1000, 2.42e-3 / 2 + 1e-5)


def orientations(seconds: float) -> tuple[np.ndarray, np.ndarray]:
    robot = load_robot(ROOT / "data" / "robots" / "imu_arm.toml")
    time_s = np.arange(0, seconds, 0.05)
    return 1e6 * time_s, readings_along(robot, time_s, course(robot, time_s)).orientations


def test_eight_imus_arrive_at_100_hz(built):
    time_us, xyzw = orientations(4.0)
    frames, counters = frames_of(built, "eight_imus", time_us, np.roll(xyzw, 1, axis=2).reshape(-1, 32), 4.0)
    assert counters.gaps == counters.checksum_errors == counters.malformed == 0
    for imu in range(8):
        sequence, device_us, values = stream(frames, imu)
        assert (np.diff(sequence) == 1).all()
        assert len(sequence) >= 398
        assert np.isnan(values).any(1).nonzero()[0].tolist() in ([0], [0, 1])  # until it is switched on
        agrees(device_us, values, time_us, xyzw[:, imu], 0.5 / 16384 + 1e-6)
        assert np.nanmax(abs(np.linalg.norm(values, axis=1) - 1)) < 1e-3


def test_an_unplugged_converter_is_missing_the_others_go_on_and_it_comes_back(built):
    time_us, mt = field_mt(3.0)
    frames, counters = frames_of(
        built, "analogue_hall", time_us, voltages(mt), 3.0, "unplug:49@1.0", "plug:49@1.5"
    )
    sequence, device_us, values = stream(frames, 0)
    steady(sequence, device_us, 5000, 2000.0)
    lost = np.isnan(values)
    assert not lost[:, [0, 1, 2, 6, 7, 8]].any()
    assert ((lost[:, 3:6].sum(0) >= 99) & (lost[:, 3:6].sum(0) <= 102)).all()
    assert not lost[device_us > 1.51e6].any()
    agrees(device_us, values, time_us, REST_MV + MV_PER_MT * mt, 0.1875 / 2 + 1e-3)
    _, _, status = stream(frames, STATUS)
    assert status[-1][5:].tolist() == lost[device_us < 2e6].sum(0).tolist()
    assert counters.gaps == 0


@pytest.mark.parametrize("when", [1.0003, 1.0011, 1.0019, 1.0027, 1.0041])
def test_a_slave_that_holds_the_bus_gets_its_clock_pulses_and_costs_a_few_readings(built, when):
    time_us, mt = field_mt(3.0)
    frames, counters = frames_of(built, "analogue_hall", time_us, voltages(mt), 3.0, f"stick@{when}")
    sequence, device_us, values = stream(frames, 0)
    assert (np.diff(sequence) == 1).all()
    assert np.isnan(values).sum() <= 2
    agrees(device_us, values, time_us, REST_MV + MV_PER_MT * mt, 0.1875 / 2 + 1e-3)
    _, _, status = stream(frames, STATUS)
    assert status[-1][4] == 1
    assert counters.gaps == counters.checksum_errors == 0


def test_while_the_bus_is_held_frames_say_missing_and_then_readings_return(built):
    time_us, mt = field_mt(3.5)
    frames, _ = frames_of(built, "analogue_hall", time_us, voltages(mt), 3.5, "hold@1.0002", "let-go@1.5")
    sequence, device_us, values = stream(frames, 0)
    assert (np.diff(sequence) == 1).all()
    assert len(sequence) >= 695
    during = (device_us > 1.01e6) & (device_us < 1.49e6)
    assert np.isnan(values[during]).all()
    assert not np.isnan(values[device_us > 1.51e6]).any()
    agrees(device_us, values[:], time_us, REST_MV + MV_PER_MT * mt, 0.1875 / 2 + 1e-3, 8000.0)


def test_an_imu_that_holds_its_branch_is_cut_off_and_the_others_go_on(built):
    time_us, xyzw = orientations(4.0)
    rows = np.roll(xyzw, 1, axis=2).reshape(-1, 32)
    frames, _ = frames_of(
        built, "eight_imus", time_us, rows, 4.0, "hold:3@1.0", "unplug:28.6@2.0", "plug:28.6@2.5"
    )
    for imu in range(8):
        _, device_us, values = stream(frames, imu)
        lost = np.isnan(values).any(1) & (device_us > 0.1e6)
        away = {3: device_us > 1.02e6, 6: (device_us > 2e6) & (device_us < 3.18e6)}.get(imu, device_us < 0)
        assert (lost == away).sum() >= len(lost) - 4
        if imu not in (3, 6):
            assert lost.sum() <= 1


def test_a_brown_out_is_a_restart_that_is_counted(built):
    time_us, mt = field_mt(3.0)
    frames, counters = frames_of(built, "analogue_hall", time_us, voltages(mt), 3.0, "brown-out@1.5003")
    sequence, device_us, values = stream(frames, 0)
    assert (np.diff(sequence) != 1).sum() == 1
    assert counters.restarts == 2  # of both streams
    assert counters.gaps == 0
    assert counters.checksum_errors <= 1  # the frame that was cut off
    _, _, status = stream(frames, STATUS)
    assert status[0][:2].tolist() == [0, 1]
    assert status[-1][:2].tolist() == [1, 4]
    late_us = np.where(
        np.arange(len(sequence)) > np.argmin(np.diff(sequence)), device_us + 1.5003e6, device_us
    )
    agrees(late_us, values, time_us, REST_MV + MV_PER_MT * mt, 0.1875 / 2 + 1e-3)


@contextlib.contextmanager
def simulated(command: list[str], port: Path):
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stderr=subprocess.DEVNULL)
    try:
        while not port.is_symlink():
            time.sleep(0.01)
        yield process
    finally:
        process.kill()
        process.communicate()


def test_repro_record_takes_every_frame_from_its_pseudo_terminal(built, tmp_path):
    time_us, mt = field_mt(4.0)
    port = tmp_path / "board"
    command = arguments(built, "analogue_hall", time_us, voltages(mt), str(port), 4.0, 1)
    stop = threading.Event()
    with simulated(command, port):
        summary = record(str(port), "frames", tmp_path / "first.rec", baud=500000, duration_s=6.0, stop=stop)
    recording = read_recording(tmp_path / "first.rec").frames
    assert summary.counters["frames"] == len(recording)
    assert not summary.dropped
    own = recording[recording["stream"] == 0]
    assert own["sequence"].tolist() == list(range(len(own)))
    assert len(own) >= 797


def test_repro_live_estimates_the_shape_from_it(built, tmp_path):
    text = (ROOT / "data" / "robots" / "three_segments.toml").read_text(encoding="utf-8")
    text = text.replace('unit = "mT"', 'unit = "mV"').replace("noise_mt = 7.1e-4", "noise_mv = 0.1")
    text = re.sub(r"(azimuth_deg = .*)", rf"\1\ngain_mv_per_mt = {MV_PER_MT}\noffset_mv = {REST_MV}", text)
    robot = tmp_path / "robot.toml"
    robot.write_text(text, encoding="utf-8")
    time_us, mt = field_mt(6.0)
    port = tmp_path / "board"
    with simulated(arguments(built, "analogue_hall", time_us, voltages(mt), str(port), 6.0, 1), port):
        program = [sys.executable, "-c", "from edition1_companion.cli import main; raise SystemExit(main())"]
        options = [
            "--robot",
            str(robot),
            "--baud",
            "500000",
            "--duration",
            "5",
            "--estimates",
            str(tmp_path / "q.csv"),
        ]
        done = subprocess.run(
            [*program, "live", str(port), *options], capture_output=True, text=True, check=False
        )
    assert done.returncode == 0, done.stderr
    q = np.genfromtxt(tmp_path / "q.csv", delimiter=",", names=True)
    described = load_robot(robot)
    truth = course(described, time_us / 1e6)
    columns = [q[f"delta_{axis}_{k}_mm"] for k in (1, 2, 3) for axis in "xyL"]
    estimates = 1e-3 * np.stack(columns, axis=1)
    nearest = abs(estimates[:, None] - truth[None]).max(-1).min(1)
    assert len(q) > 100
    assert np.median(nearest) < 1e-3  # [m]


@pytest.mark.parametrize("sketch", SKETCHES)
def test_it_compiles_for_a_cortex_m4(sketch, tmp_path):
    """Compiled only: registers of the board, in twi.c and board.c, are those of the AVR."""
    arm = ["arm-none-eabi-gcc", "-mcpu=cortex-m4", "-mthumb", *STRICT, "-c"]
    for source in (FIRMWARE / "frame_encoder.c", FIRMWARE / "rounds.c"):
        build([*arm, str(source), "-o", str(tmp_path / f"{source.stem}.o")])
    ino = FIRMWARE / "examples" / sketch / f"{sketch}.ino"
    build([*arm, "-x", "c", str(ino), "-o", str(tmp_path / "sketch.o")])


@pytest.mark.parametrize("sketch", SKETCHES)
def test_it_runs_as_the_arduino_ide_compiles_it(built, sketch, tmp_path):
    """A sketch in C++, the library in C, the core in an archive, whose serial line must not be taken in."""
    warn = ["-Wall", "-Wextra", "-Werror", "-c"]
    text = (FIRMWARE / "examples" / sketch / f"{sketch}.ino").read_text(encoding="utf-8")
    text = text.replace("PERIOD_US = 5000;", f"PERIOD_US = {IDE_PERIOD_US[sketch]};")
    assert f"PERIOD_US = {IDE_PERIOD_US[sketch]};" in text
    (tmp_path / "sketch.cpp").write_text(f"#include <Arduino.h>\n{text}", encoding="utf-8")
    build([*IDE_CPP, *warn, str(tmp_path / "sketch.cpp"), "-o", str(tmp_path / "sketch.o")])
    for path in FIRMWARE.glob("*.c"):
        build([*IDE_C, *warn, str(path), "-o", str(tmp_path / f"library_{path.stem}.o")])
    for name in ("wiring.c", "hooks.c", "main.cpp", "HardwareSerial.cpp", "HardwareSerial0.cpp"):
        command = IDE_CPP if name.endswith("cpp") else IDE_C
        build([*command, "-w", "-c", str(CORE / name), "-o", str(tmp_path / f"core_{name}.o")])
    core = [str(path) for path in sorted(tmp_path.glob("core_*.o"))]
    build(["avr-gcc-ar", "rcs", str(tmp_path / "core.a"), *core])
    objects = [
        str(path) for path in (tmp_path / "sketch.o", *tmp_path.glob("library_*.o"), tmp_path / "core.a")
    ]
    linker = ["avr-gcc", "-Os", "-flto", "-fuse-linker-plugin", "-Wl,--gc-sections", "-mmcu=atmega328p"]
    build([*linker, *objects, "-lm", "-o", str(built / f"ide_{sketch}.elf")])
    rows = np.ones((1, SLAVES[sketch].stop - SLAVES[sketch].start)) * 3000.0
    if sketch == "eight_imus":
        rows = np.tile([1.0, 0, 0, 0], (1, 8))
    frames, counters = frames_of(built, sketch, [0.0], rows, 4.0, build="ide_")
    sequence, device_us, values = stream(frames, 0)
    steady(sequence, device_us, IDE_PERIOD_US[sketch], 2000.0)
    assert not np.isnan(values[1:]).any()
    assert counters.gaps == counters.checksum_errors == 0
    _, _, status = stream(frames, STATUS)
    assert status[-1][2:5].tolist() == [0, 0, 0]  # left out, late, bus freed


CLOCK = """
#include <board.h>
#include <frame_encoder.h>
#include <rounds.h>
static uint8_t out[LONGEST_FRAME];
static const uint8_t floats[3] = { 9, 12, 4 };
void setup(void) { rounds_begin(500000, 20000, 0); }
void loop(void)
{
    static float values[12] = { 1.5f, -2.5f, 2517.25f, 3.1f, 0.0f, 4.7f, 5.9f, 8.8f, 1e-3f, 7.7f, 6.6f, 5.5f };
    float took_us[3];
    const round_t now = next_round();
    for (uint8_t k = 0; k < 3; k++) {
        const uint32_t before = board_micros();
        encode_frame(out, 0, FLOAT32, values, floats[k], now.number, now.time_us);
        took_us[k] = (float)(board_micros() - before);
    }
    send_readings(0, took_us, 3, now);
}
"""


def table_row(sketch: str) -> tuple[str, ...]:
    lines = (ROOT / "data" / "firmware.csv").read_text(encoding="utf-8").splitlines()[1:]
    rows = {re.sub("[ -]", "_", line.partition(",")[0].lower()): line.split(",") for line in lines}
    return tuple(rows[sketch][1:])


def test_the_table_says_how_long_a_frame_takes_to_encode(built):
    (built / "clock.c").write_text(CLOCK, encoding="utf-8")
    sources = [str(path) for path in FIRMWARE.glob("*.c")]
    build([*AVR, *sources, str(built / "clock.c"), "-lm", "-o", str(built / "clock.elf")])
    done = subprocess.run(
        [str(built / "simulate"), str(built / "clock.elf"), "/dev/null", "-", "1", "0"],
        capture_output=True,
        stdin=subprocess.DEVNULL,
        check=True,
    )
    _, _, took_us = stream(BinaryParser().feed(done.stdout), 0)
    assert len(took_us) >= 45
    assert np.ptp(took_us, axis=0).max() < 50
    said_ms = [float(table_row(sketch)[3]) for sketch in SKETCHES]
    np.testing.assert_allclose(np.median(took_us, axis=0) / 1000, said_ms, rtol=0.1)


def test_the_library_says_what_arduino_asks_for():
    """OWNER in the address is for the owner of the repository to fill in."""
    lines = (FIRMWARE / "library.properties").read_text(encoding="utf-8").splitlines()
    fields = dict(line.split("=", 1) for line in lines)
    asked = ("name", "version", "author", "maintainer", "sentence", "paragraph", "category", "url")
    assert all(fields[name] for name in (*asked, "architectures"))
    assert re.fullmatch(r"https://github\.com/[\w-]+/repro", fields["url"])
    for name in fields["includes"].split(","):
        assert (FIRMWARE / name).is_file()


@pytest.mark.parametrize("sketch", SKETCHES)
def test_it_fits_the_chip_with_room_for_the_stack(built, sketch):
    done = subprocess.run(
        ["avr-size", str(built / f"{sketch}.elf")], capture_output=True, text=True, check=True
    )
    text, data, bss = map(int, done.stdout.splitlines()[1].split()[:3])
    assert text + data <= 32256  # less a bootloader of 512 B
    assert data + bss <= 2048 - 512
    said = tuple(map(float, table_row(sketch)[:2]))
    assert said == pytest.approx((text + data, data + bss), rel=0.1)  # other compilers differ a little
