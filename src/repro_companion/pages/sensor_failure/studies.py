"""The study of the page on sensor failure: what the watched estimate says of faults; some ten minutes."""

from repro_companion.book.studies import Study
from repro_companion.pages.sensor_failure.alarms import SCENARIOS, alarm_sums

STUDIES = (
    Study(
        "alarms",
        alarm_sums,
        {
            "rates_hz": {"two_segments": 100.0, "one_segment": 40.0},
            "estimators": ["levenberg_marquardt", "kalman"],
            "scenarios": list(SCENARIOS),
            "trials": 20,
            "seed": 1000,
        },
        ("progress",),
    ),
)
