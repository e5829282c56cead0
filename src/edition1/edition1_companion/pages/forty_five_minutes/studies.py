"""Twins of 45 minutes by five methods, and robots calibrated by motion and with poses: minutes of computing."""

from __future__ import annotations

from edition1_companion.book.studies import Study
from edition1_companion.pages.forty_five_minutes.methods import METHODS, errors_by_minute
from edition1_companion.pages.forty_five_minutes.poses import DRIFT, PLACES, becomes_known, compared
from edition1_companion.pages.forty_five_minutes.twin import JUDGED, MINUTES

DRAWS = tuple(range(10))
"""Seeds of the robots that are judged; ``repro calibrate --self`` was mended on those from 1000 to 1003."""
ROBOTS = ("one_segment", "two_segments", "three_segments")


def _by_motion(name: str, robot: str, off: str, minutes: list[float]) -> Study:
    settings = {"draws": list(DRAWS), "robots": [robot], "off": [off], "minutes": minutes}
    return Study(f"forty_five_minutes_{name}", compared, settings, digits=4)


POSES = (
    _by_motion("poses_1", "one_segment", DRIFT, [1.0, 5.0]),
    _by_motion("poses_2", "two_segments", DRIFT, [1.0, 5.0]),
    _by_motion("poses_3", "three_segments", DRIFT, [1.0, 5.0]),
    _by_motion("poses_places", "one_segment", PLACES, [5.0]),
    _by_motion("poses_places_2", "two_segments", PLACES, [5.0]),
)
STRAIGHT_AT_FIRST = Study(
    "forty_five_minutes_poses_straight",
    compared,
    {
        "draws": list(DRAWS),
        "robots": list(ROBOTS),
        "off": [DRIFT],
        "minutes": [1.0, 5.0],
        "straight": True,
    },
    digits=4,
)
KNOWN = Study(
    "forty_five_minutes_known",
    becomes_known,
    {"draws": list(DRAWS[:3]), "robots": list(ROBOTS), "minutes": [0.5, 1.0, 5.0]},
    digits=4,
)
STUDIES = (
    Study(
        "forty_five_minutes",
        errors_by_minute,
        {"twins": list(JUDGED), "minutes": MINUTES, "methods": list(METHODS)},
        digits=4,
    ),
    *POSES,
    STRAIGHT_AT_FIRST,
    KNOWN,
)
