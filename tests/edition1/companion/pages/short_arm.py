"""The beginning of the synthetic motion: enough of it for tests."""

from dataclasses import replace
from pathlib import Path

from edition1_companion.twins.soft_arm import load_soft_arm

DATA = Path(__file__).parents[4] / "data"


def short_arm(stop_s=40.0):
    arm = load_soft_arm(DATA / "soft_arm.npz")
    kept = arm.time_s <= stop_s
    return replace(
        arm, time_s=arm.time_s[kept], positions=arm.positions[kept], orientations=arm.orientations[kept]
    )
