"""Does `repro check --improve` find what a random search finds? `python -m bench.improve`, some minutes.

Designs that cannot work are drawn at random along an arm of 60 mm: one or two segments, a disc magnet or two, chips
with one axis or three. For each of them the best of 2,000 random layouts stands beside what the search finds with as
many chips, and the time that it takes for all numbers of chips.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from repro import ConstantCurvature, Disc, Magnet, Robot, Sensor
from repro.check import check_design, median_tip
from repro.improve import improve_design

LENGTH, LAYOUTS, BAR, SECONDS = 0.06, 2000, 1.2, 10.0


def random_design(rng: np.random.Generator) -> Robot:
    """Return a design that cannot work."""
    while True:
        n = int(rng.integers(1, 3))
        axes = int(rng.choice([1, 3]))
        chips = rng.integers(1, 3) if axes == 3 else rng.integers(3, 6)
        magnets = [
            Magnet(
                Disc(rng.uniform(2e-3, 8e-3), rng.uniform(1e-3, 4e-3), 1300.0),
                int(rng.integers(1, n + 1)),
                0.0,
            )
            for _ in range(rng.integers(1, n + 1))
        ]
        sensors = [
            Sensor(int(rng.integers(1, n + 1)), 0.0, radial=rng.uniform(8e-3, 15e-3), axes=axes)
            for _ in range(chips)
        ]
        bend, noise = rng.uniform(5e-3, 12e-3), float(rng.choice([0.005, 0.02, 0.05]))
        robot = Robot(
            [ConstantCurvature(LENGTH / n, 0.01) for _ in range(n)], magnets, sensors,
            lower=[-bend, -bend, 0.0] * n, upper=[bend, bend, 3e-3] * n, noise=noise,
        )  # fmt: skip
        robot = random_layout(robot, rng)
        if not check_design(robot, samples=100).can_work:
            return robot


def random_layout(robot: Robot, rng: np.random.Generator) -> Robot:
    """Return the robot with all parts anywhere along their segments, chips anywhere around; magnets do not touch."""
    reach = robot.segments[0].length
    while True:
        magnets = [replace(part, at=float(rng.uniform(0, reach))) for part in robot.magnets]
        free = all(
            a.segment != b.segment or abs(a.at - b.at) >= 4e-3
            for k, a in enumerate(magnets)
            for b in magnets[:k]
        )
        if free:
            break
    sensors = [
        replace(part, at=float(rng.uniform(0, reach)), azimuth=float(rng.uniform(0, 2 * np.pi)))
        for part in robot.sensors
    ]
    return robot.replaced(magnets=magnets, sensors=sensors)


def compared(seed: int, number: int) -> tuple[float, float, float, float]:
    """Return the median deviation of a design, as found, and the best at random [mm], and times of the search [s]."""
    rng = np.random.default_rng([seed, number])
    robot = random_design(rng)
    wall, own = time.perf_counter(), time.process_time()
    found = improve_design(robot)
    wall, own = time.perf_counter() - wall, time.process_time() - own
    best = min((random_layout(robot, rng) for _ in range(LAYOUTS)), key=lambda x: median_tip(x, samples=64))
    same = next(row.calibrated for row in found.by_chips if row.chips == len(robot.sensors))
    ratio = same / median_tip(best, samples=400)
    print(
        f"{number:3}: {len(robot.segments)} segments, {len(robot.magnets)} magnets, {len(robot.sensors)} chips: "
        f"{1e3 * median_tip(robot, samples=400):.2f} -> {1e3 * same:.2f} mm, {ratio:.3f} of random; {wall:.1f} s, "
        f"{own:.1f} s of one core; works: {found.can_work}", flush=True,
    )  # fmt: skip
    return ratio, wall, own, float(found.can_work)


def main(words: Sequence[str] | None = None) -> None:
    """Print a line for each design, and what of them is within the bar."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--designs", type=int, default=20)
    options.add_argument("--first", type=int, default=0)
    options.add_argument("--seed", type=int, default=73)
    asked = options.parse_args(words)
    improve_design(random_design(np.random.default_rng(0)))  # compiles the kernels
    numbers = range(asked.first, asked.first + asked.designs)
    ratio, wall, own, works = np.array([compared(asked.seed, k) for k in numbers]).T
    in_time = (wall <= SECONDS).sum()
    times = f"{in_time} in {SECONDS:g} s, the longest {wall.max():.1f} s ({own.max():.1f} s of a core)"
    print(
        f"{(ratio <= BAR).sum()} of {len(ratio)} within 20 % of random, the worst {ratio.max():.3f}, median "
        f"{np.median(ratio):.3f}; {times}; {works.sum():.0f} work then"
    )


if __name__ == "__main__":
    main()
