"""The study of the page on markers: the calibration over draws of the sensors."""

from edition1_companion.book.studies import Study
from edition1_companion.pages.imu_markers.calibration import DRAWS, EVERY, FIRST_S, over_sensors

STUDIES = (
    Study(
        "martin_calibration",
        over_sensors,
        {"draws": list(range(DRAWS)), "first_s": FIRST_S, "every": EVERY},
        ("data", "progress"),
    ),
)
