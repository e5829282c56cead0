"""The command ``repro emulate``: a program of its own, stopped as users stop it."""

import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from cyclopts import App

from edition1.errors import InputError
from edition1_companion.cli_live import emulate
from edition1_live.emulate.links import HAS_PTY
from edition1_live.record.ports import close_port, open_port, read_available

ONE = str(Path(__file__).parents[3] / "data" / "robots" / "one_segment.toml")
PROGRAM = """
import sys
from cyclopts import App
from edition1_companion.cli_live import emulate
app = App()
app.command(emulate)
sys.exit(app(["emulate", *sys.argv[1:]], result_action="return_value"))
"""


def called(*arguments):
    app = App()
    app.command(emulate)
    return app(["emulate", *arguments], exit_on_error=False, print_error=False, result_action="return_value")


def started(*arguments):
    process = subprocess.Popen(
        [sys.executable, "-c", PROGRAM, *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    label = process.stdout.readline()
    return process, label, process.stdout.readline().removeprefix("Port: ").strip()


def read(address, least):
    port, data = open_port(address), b""
    deadline = time.monotonic() + 20
    while len(data) < least and time.monotonic() < deadline:
        data += read_available(port, 0.5)
    close_port(port)
    return data


def test_lines_of_the_hall_sensor_through_a_socket():
    process, label, address = started("spiral", "--socket", "0", "--speed", "inf", "--loop")
    try:
        assert label == "spiral [counts], SYNTHETIC, as hall\n"
        assert re.fullmatch(r"socket://127\.0\.0\.1:\d+", address)
        assert re.match(rb"(-?\d+,-?\d+,-?\d+\r\n)+", read(address, 100_000)).end() > 99_000
    finally:
        process.send_signal(signal.SIGINT)
        assert process.communicate(timeout=20) == ("", "\n")
    assert process.returncode == 0


@pytest.mark.skipif(not HAS_PTY, reason="no pseudo-terminals on this system")
def test_a_terminated_emulator_leaves_no_port(tmp_path):
    path = tmp_path / "board"
    faults = ("--fault", "flips", "1e-3", "--fault", "drift_ppm", "-50")
    process, label, address = started(
        "twin:T2", "--port-file", str(path), "--rate", "1000", "--loop", *faults
    )
    try:
        assert path.is_symlink()  # whoever is told of a port finds it
        assert label == "T2 of the digital twin [mV], SYNTHETIC, as millivolts\n"
        assert address == str(path)
        assert len(read(address, 1000)) >= 1000
    finally:
        process.terminate()
        process.communicate(timeout=20)
    assert process.returncode == 128 + signal.SIGTERM
    assert not path.is_symlink()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            (),
            "Input source of repro emulate must be one of .*, arm, or a recording; or --robot ROBOT.toml; "
            "instead received none.",
        ),
        (
            ("lemniscate", "--tolerances", "1"),
            "Input tolerances of repro emulate must be left out without --robot; instead received 1.0.",
        ),
        (
            ("lemniscate", "--fault", "unplug", "1"),
            "Input fault of repro emulate must be one of flips, .*, drift_ppm; instead received unplug.",
        ),
        (
            ("lemniscate", "--fault-from", "-1"),
            r"Input fault_from of repro emulate must be 0 or more \[s\]; instead received -1.0.",
        ),
        (
            ("--robot", ONE, "--loop"),
            "Input loop of repro emulate must be left out with --robot; instead received True.",
        ),
        (
            ("--robot", ONE, "--hold", "3"),
            "Input hold of repro emulate must be left out without --hold-poses; instead received 3.0.",
        ),
        (
            ("--robot", ONE, "--fault", "unplug", "4"),
            "Input unplug of one_segment.toml must be the number of a sensor, 1 to 3; instead received 4.",
        ),
        (
            ("--robot", ONE, "--fault", "fires", "1"),
            "Input fault of repro emulate must be one of flips, .*, drift_ppm, unplug, .*; instead received fires.",
        ),
        (
            ("lemniscate", "--format", "hall"),
            "Input format of the take lemniscate must be frames or csv; instead received hall.",
        ),
        (
            ("lemniscate", "--fault", "fires", "1"),
            "Input fault of repro emulate must be one of flips, .*, drift_ppm; instead received fires.",
        ),
        (
            ("lemniscate", "--socket", "0", "--port-file", "x"),
            "Input port_file of repro emulate must be left out with --socket; instead received x.",
        ),
        (
            ("lemniscate", "--socket", "0", "--speed", "0"),
            "Input speed of Emulator must be above zero; instead received 0.0.",
        ),
        (
            ("lemniscate", "--socket", "-1"),
            "Input socket of SocketLink must be 0 to 65535; instead received -1.",
        ),
    ],
)
def test_bad_input_is_refused(arguments, message, monkeypatch):
    monkeypatch.setattr(signal, "signal", lambda *_: None)  # this process keeps its own
    with pytest.raises(InputError, match=f"^{message}$"):
        called(*arguments)
