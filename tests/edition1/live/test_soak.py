"""The soak, short; and that it can fail."""

import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace

import pytest

from bench.soak import parsers as module
from bench.soak.parsers import soak
from edition1.errors import InputError
from edition1_live.emulate.board import Passage
from edition1_live.emulate.links import HAS_PTY

PORTS = ["socket", *(["pty"] if HAS_PTY else [])]
FRAMES = 300_000


@pytest.fixture(scope="module")
def reports() -> dict[str, tuple[int, dict[str, float]]]:
    """Exit status and report of every port, as printed: run as programs, so that nothing slows the frames down."""
    command = [sys.executable, "-m", "bench.soak.parsers", str(FRAMES)]
    running = {port: subprocess.Popen([*command, port], stdout=subprocess.PIPE, text=True) for port in PORTS}
    printed = {port: process.communicate(timeout=120)[0] for port, process in running.items()}
    rows = {port: [line.split() for line in text.splitlines()] for port, text in printed.items()}
    return {
        port: (running[port].returncode, {r[0]: float(r[1].replace(",", "")) for r in rows[port] if r[1:]})
        for port in PORTS
    }


@pytest.mark.parametrize("port", PORTS)
def test_nothing_corrupt_is_accepted_and_nothing_intact_lost(reports, port):
    status, report = reports[port]
    assert status == 0, report
    for name in ("corrupt", "out_of_order", "intact_lost", "not_received_bytes"):
        assert report[name] == 0
    assert report["connections"] > 5
    assert report["sent"] - report["intact"] > 1000
    assert report["intact"] <= report["accepted"] < report["sent"]
    # Of frames before the first and after the last that was accepted, no sequence number tells.
    assert 0 <= FRAMES - report["accepted"] - report["gaps"] < 100
    if sys.platform != "win32":
        assert report["grown_bytes"] < 6e6  # the frames alone are 9 MB on the wire


def test_the_faults_are_the_same_on_every_port(reports):
    assert (
        len(
            {tuple(report[name] for name in ("sent", "intact", "accepted")) for _, report in reports.values()}
        )
        == 1
    )


def tampered(change):
    """Wrap the board: ``change`` alters one passage on its way, but not what is noted of it."""
    original = module.passages

    def passages(*arguments, **options) -> Iterator[Passage]:
        for k, passage in enumerate(original(*arguments, **options)):
            yield change(passage) if k == 1 else passage

    return passages


@pytest.mark.parametrize(
    ("change", "wrong"),
    [
        # what was "sent" had other values, so that the real ones are wrong
        (lambda p: p._replace(data=rewritten(p, values=(0.0, 0.0, -1.0))), "corrupt"),
        (lambda p: p._replace(data=rewritten(p, device_us=5)), "corrupt"),
        (lambda p: p._replace(data=p.data[: p.ends[9]] + p.data[p.ends[10] :]), "intact_lost"),
        (lambda p: p._replace(data=p.data[: p.ends[9]] * 2 + p.data[p.ends[9] :]), "out_of_order"),
    ],
)
def test_it_notices(monkeypatch, change, wrong):
    monkeypatch.setattr(module, "passages", tampered(change))
    monkeypatch.setattr(module, "CHANCE", 0.0)
    monkeypatch.setattr(module, "INTERRUPTIONS", 0)
    report = soak(10_000, port="socket")
    assert getattr(report, wrong) > 0
    assert not report.passed


def rewritten(passage, **changes):
    """Bytes of a passage whose eleventh frame was sent with another content and a right checksum."""
    from edition1_live.wire.formats import encode

    frame = passage.frames[10]._replace(**changes)
    start, end = int(passage.ends[9]), int(passage.ends[10])
    return passage.data[:start] + encode("frames", frame) + passage.data[end:]


def test_bytes_lost_by_the_port_do_not_pass(monkeypatch):
    monkeypatch.setattr(module, "INTERRUPTIONS", 0)
    report = soak(1_000, port="socket")
    assert report.passed
    assert not replace(report, not_received_bytes=1).passed


def test_there_must_be_a_frame_and_a_port():
    with pytest.raises(
        InputError,
        match="^Input frames of soak must be 1 or more, and a number of 32 bits; instead received 0.$",
    ):
        soak(0)
    with pytest.raises(InputError, match="^Input port of soak must be pty or socket; instead received usb.$"):
        soak(1, port="usb")
