"""Compile the kernels that pages and tests use, in processes beside each other, before these start.

``python -m repro_companion.kernels`` compiles what this machine does not have yet. Pages or tests that start together
would else each compile the same. A part that is compiled leaves an empty file, so that nothing loads it again to see
that it is there.
"""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import numba
import numpy as np
from llvmlite.binding import get_host_cpu_name

import repro
from repro import BendSensor, KalmanFilter, LevenbergMarquardt, Link, Sensing, track
from repro.chain import turn
from repro.estimators.rod import Rod, RodFilter, RodSensor
from repro.networks import Network
from repro_companion.papers import baaij, mitchell


def of_robots() -> None:
    """Compile what robots need: arcs of constant curvature with multipoles, networks, and segments of other kinds.

    One process compiles all three, because they have most functions in common.
    """
    robot = baaij.robot(1)
    _follow(Sensing(robot), "descent", "least squares", "Kalman")
    layer = np.full((1, 1 + 4 * len(robot.magnets)), 0.1, np.float32), np.zeros(1, np.float32)
    _follow(Sensing(robot, Network([layer], "relu", "angles")), "descent", "least squares")
    _follow(Sensing(robot.replaced(segments=[*robot.segments, Link(0.01)])), "least squares")


def _follow(sensing: Sensing, *names: str) -> None:
    """Follow a robot of one segment by the methods named."""
    start, bounds = [0.0, 0.0, 0.003], baaij.bounds(1)
    readings = np.tile(sensing(start), (3, 1))
    methods = {
        "descent": baaij.descent(sensing, 1),
        "least squares": LevenbergMarquardt(sensing, *bounds, noise=1e-3),
        "Kalman": KalmanFilter(sensing, *bounds, 1e-3, np.full(3, 1e-3)),
    }
    for name in names:
        track(methods[name], readings, start, rate_hz=40.0)


def of_filters() -> None:
    """Compile the rod, and the particle filter of a bend sensor."""
    sensor = BendSensor(mitchell.LENGTH, mitchell.CUBE)
    readings = sensor(np.zeros((3, 2)))
    track(mitchell.particle_filter(0.02, particles=10), readings, np.zeros(2), rate_hz=100.0)
    sensors = [RodSensor(kind, 1e-2, arc_m=0.5) for kind in ("pose", "orientation")]
    rod = RodFilter(Rod(1.0, bending=1, torsion=0), sensors, strain_std=10.0, rate=1.0, base_std=[0.01, 0.1])
    state = rod.init()
    for t in (0.0, 0.1):
        state, _ = rod.step(state, np.zeros(9), t)


PARTS: dict[str, Callable[[], None]] = {"robots": of_robots, "filters": of_filters}


def note_of(name: str) -> Path:
    """Return the file that says that a part is compiled: from these sources, by this numba, for this processor."""
    sources = [Path(__file__), *sorted(Path(repro.__file__).parent.rglob("*.py"))]
    # numba compiles anew where a file has another time, too.
    key = [file.stat().st_mtime_ns for file in sources], sys.version, numba.__version__, get_host_cpu_name()
    # Where nothing is kept, no part is there ever.
    folder = getattr(getattr(turn, "stats", None), "cache_path", None) or os.devnull
    return Path(folder, f"{name}-{hashlib.sha256(repr(key).encode()).hexdigest()[:16]}")


def main(names: Sequence[str]) -> int:
    """Compile the parts named; or all that are not there yet, each in a process of its own."""
    for name in names:
        PARTS[name]()
        note_of(name).touch()
    due = [] if names else [name for name in PARTS if not note_of(name).exists()]
    command = [sys.executable, "-m", "repro_companion.kernels"]
    running = [subprocess.Popen([*command, name], stderr=subprocess.DEVNULL) for name in due]
    if sum(process.wait() for process in running):
        print("Kernels could not be compiled ahead, so each process compiles its own.", file=sys.stderr)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
