"""The tables of a robot file: which keys there are, in which unit and range, and what to say of any other.

Ranges are wide; they are there to notice a wrong unit, such as metres under a key that ends in ``_mm``.
"""

from __future__ import annotations

import math
from typing import Any

from edition1.estimation.orientations import UNIT_TOLERANCE, UPRIGHT
from edition1.robot_file._document import Key, word
from edition1.robot_file.columns import FORMATS

MOST_VALUES = {"frames": 118, "hall": 3}
"""Values of a frame at most, by format."""
UNITS = ("mT", "mV", "raw")
"""Units that the readings of magnetic sensors may have."""
MOST_CHANNELS = 255
"""Values of a frame, at most; a format may have fewer."""
_LAST_STREAM = 255
IMU_NOISE_RAD = 0.0035
"""Standard deviation of an orientation about each axis where the file states none, 0.2 degrees [rad]."""
HEADINGS = ("absolute", "free")
"""Whether the orientation of an IMU about the vertical is known in the world of the base, or arbitrary."""


def _is_number(x: object) -> bool:
    # Whole numbers may have any number of digits: compared, but not turned into floats, they do not overflow.
    return isinstance(x, int | float) and not isinstance(x, bool) and abs(x) <= 1e300


def _numbers(x: object, n: int) -> bool:
    return isinstance(x, list) and len(x) == n and all(map(_is_number, x))


def _number(low: float, high: float, unit: str, default: float | None = None, *, signed: bool = False) -> Key:
    """Describe a number whose magnitude is in a range, or that is zero where zero is its default."""

    def fits(x: Any) -> bool:
        size = abs(x) if _is_number(x) and signed else x
        return _is_number(x) and (low <= size <= high or (x == 0 and (default == 0 or low == 0)))

    zero = "0, or " if default == 0 and low > 0 else ""
    size = "of a magnitude " if signed else ""
    return Key(f"{zero}{size}between {low:g} and {high:g} [{unit}]", fits, default)


def _interval(high: float, least: float, unit: str) -> Key:
    """Describe two bounds, the smaller first, so far apart and within a magnitude; none when left out."""

    def fits(x: Any) -> bool:
        return _numbers(x, 2) and x[1] - x[0] >= least and max(map(abs, x)) <= high

    text = f"[lowest, highest], at least {least:g} apart and within {high:g} of zero [{unit}]"
    return Key(text, fits, [])


def _count(lowest: int, highest: int, default: int | None = None) -> Key:
    def fits(x: Any) -> bool:
        return isinstance(x, int) and not isinstance(x, bool) and lowest <= x <= highest

    return Key(f"a whole number from {lowest} to {highest}", fits, default)


def _quaternion(turn: str) -> Key:
    text = f"a unit quaternion [x, y, z, w] within {UNIT_TOLERANCE:g}, {turn}"
    return Key(text, lambda x: _numbers(x, 4) and abs(math.hypot(*x) - 1) <= UNIT_TOLERANCE, UPRIGHT)


_LENGTH = _number(1.0, 5000.0, "mm")
_AT = Key("0, or between 0.1 and 5000 [mm]", lambda x: _is_number(x) and (x == 0 or 0.1 <= x <= 5000))
_SIZE = _number(0.5, 200.0, "mm")
_POLARISATION = _number(10.0, 2000.0, "mT", signed=True)
_ELONGATION = _interval(1000.0, 0.05, "mm")

SEGMENT_KINDS = {
    "constant_curvature": {
        "length_mm": _LENGTH,
        "radius_mm": _number(0.5, 500.0, "mm"),
        "delta_x_mm": _interval(2000.0, 0.05, "mm"),
        "delta_y_mm": _interval(2000.0, 0.05, "mm"),
        "delta_L_mm": _ELONGATION,
    },
    "affine_curvature": {
        "length_mm": _LENGTH,
        "kappa_0_rad": _interval(30.0, 0.01, "rad"),
        "kappa_1_rad": _interval(60.0, 0.01, "rad"),
        "phi_deg": _interval(720.0, 10.0, "deg"),
        "delta_L_mm": _ELONGATION,
    },
}
"""Keys of ``[[segments]]`` by their ``kind``; the intervals bound the coordinates of the same name."""

MAGNET_KINDS = {
    "ring": {
        "outer_diameter_mm": _SIZE,
        "inner_diameter_mm": _number(0.1, 200.0, "mm", 0.0),
        "height_mm": _SIZE,
        "polarisation_mt": _POLARISATION,
    },
    "cube": {"edge_mm": _SIZE, "polarisation_mt": _POLARISATION},
}
"""Keys of ``[[magnets]]`` by their ``kind``, beside ``segment`` and ``at_mm``."""

_PLACE = {"segment": _count(1, 10_000), "at_mm": _AT}
_DIRECTION = Key(
    "three numbers along x, y, z of the cross-section, not all zero",
    lambda x: _numbers(x, 3) and 1e-9 <= math.hypot(*x) <= 1e9,
    [],
)
MAGNET_KEYS = {**_PLACE, "direction": _DIRECTION}
"""Keys of ``[[magnets]]`` of every kind."""


def stream_keys(sensors: bool, imus: bool, unit: object = None) -> dict[str, Key]:
    """Keys of ``[stream]``; the unit and the noise are those of magnetic sensors, if there are any."""
    keys = {"format": word(*FORMATS), "rate_hz": _number(0.1, 1e5, "Hz")}
    if imus:
        keys["noise_deg"] = _number(1e-3, 30.0, "deg", math.degrees(IMU_NOISE_RAD))
    if not sensors:
        return keys
    noise = f"noise_{str(unit if unit in UNITS else UNITS[0]).lower()}"
    return {
        **keys,
        "unit": word(*UNITS),
        noise: _number(1e-9, 1e6, noise[6:]),
        "channels": _count(1, MOST_CHANNELS, 0),
    }


def sensor_keys(unit: str, network: bool) -> dict[str, Key]:
    """Keys of ``[[sensors]]`` for readings in a unit; a network says by itself what it reads, so has no gains."""
    low = unit.lower()
    name = "gain" if unit == "mT" else f"gain_{low}_per_mt"
    gain = _number(1e-3, 1e9, f"{unit}/mT", 1.0 if unit == "mT" else None, signed=True)
    keys = {
        "channel": _count(1, MOST_CHANNELS),
        **_PLACE,
        "direction": _DIRECTION,
        "radial_mm": _number(0.1, 500.0, "mm", 0.0),
        "azimuth_deg": _number(0.0, 360.0, "deg", 0.0, signed=True),
        "tilt_deg": _number(0.0, 180.0, "deg", 0.0, signed=True),
        f"offset_{low}": _number(0.0, 1e9, unit, 0.0, signed=True),
    }
    return keys if network else {**keys, name: gain}


def imu_keys() -> dict[str, Key]:
    """Keys of ``[[imus]]``."""
    return {
        **_PLACE,
        "stream": _count(0, _LAST_STREAM),
        "mounted": _quaternion("from the frame of the IMU to that of the cross-section"),
        "heading": word(*HEADINGS, default=HEADINGS[0]),
    }


def top_keys() -> dict[str, Key]:
    """Keys of the file outside of tables, and the names of its tables."""

    def fits(x: Any) -> bool:
        return _numbers(x, 3) and math.hypot(*x) <= 1.0  # the Earth has 0.02-0.07 mT: 50 is in microtesla

    earth = Key("three numbers along x, y, z of the base, together at most 1 [mT]", fits, [0.0, 0.0, 0.0])
    tables = {
        name: Key("", lambda _: True, [])
        for name in ("stream", "segments", "magnets", "sensors", "imus", "model")
    }
    base = _quaternion("from the frame of the base to the world of the IMUs")
    return {"earth_mt": earth, "base_orientation": base, **tables}


def model_keys(segments: int, sensors: int) -> dict[str, Key]:
    """Keys of ``[model]``: trained networks instead of the field of the magnets."""
    counts = sorted({1, segments, sensors})

    def fits(x: Any) -> bool:
        return isinstance(x, list) and len(x) in counts and all(isinstance(name, str) for name in x)

    inputs = word("angles", "cosines", default="angles")
    return {
        "networks": Key("files: one for all sensors, one per segment, or one per sensor", fits),
        "inputs": inputs,
    }
