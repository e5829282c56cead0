"""The tables of a robot file: which keys there are, in which unit and range, and what to say of any other.

Ranges are wide; they are there to notice a wrong unit, such as metres under a key that ends in ``_mm``.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Any, NamedTuple

from repro.errors import InputError, bad_input
from repro.live.robot.toml_lines import Place, key_lines
from repro.live.wire.formats import FORMATS

UNITS = ("mT", "mV", "raw")
"""Units that the readings of magnetic sensors may have."""


class Key(NamedTuple):
    """What a key takes: its words in a message, a test, and its value when left out (None: it must be given)."""

    must_be: str
    fits: Callable[[Any], bool]
    default: Any = None


def _is_number(x: object) -> bool:
    return isinstance(x, int | float) and not isinstance(x, bool) and math.isfinite(x)


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
        numbers = isinstance(x, list) and len(x) == 2 and all(map(_is_number, x))
        return numbers and x[1] - x[0] >= least and max(map(abs, x)) <= high

    text = f"[lowest, highest], at least {least:g} apart and within {high:g} of zero [{unit}]"
    return Key(text, fits, [])


def _count(lowest: int, default: int | None = None) -> Key:
    def fits(x: Any) -> bool:
        return isinstance(x, int) and not isinstance(x, bool) and x >= lowest

    return Key(f"a whole number from {lowest}", fits, default)


def _word(*words: str) -> Key:
    return Key(f"one of {', '.join(map(repr, words))}", lambda x: x in words)


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

_PLACE = {"segment": _count(1), "at_mm": _AT}


def stream_keys(sensors: bool, unit: object = None) -> dict[str, Key]:
    """Keys of ``[stream]``; the unit and the noise are those of magnetic sensors, if there are any."""
    keys = {"format": _word(*FORMATS), "rate_hz": _number(0.1, 1e5, "Hz")}
    if not sensors:
        return keys
    noise = f"noise_{str(unit if unit in UNITS else UNITS[0]).lower()}"
    return {**keys, "unit": _word(*UNITS), noise: _number(1e-9, 1e6, noise[6:]), "channels": _count(1, 0)}


def sensor_keys(unit: str, network: bool) -> dict[str, Key]:
    """Keys of ``[[sensors]]`` for readings in a unit; a network says by itself what it reads, so has no gains."""
    low = unit.lower()
    name = "gain" if unit == "mT" else f"gain_{low}_per_mt"
    gain = _number(1e-3, 1e9, f"{unit}/mT", 1.0 if unit == "mT" else None, signed=True)
    keys = {
        "channel": _count(1),
        **_PLACE,
        "radial_mm": _number(0.1, 500.0, "mm", 0.0),
        "azimuth_deg": _number(0.0, 360.0, "deg", 0.0, signed=True),
        "tilt_deg": _number(0.0, 180.0, "deg", 0.0, signed=True),
        f"offset_{low}": _number(0.0, 1e9, unit, 0.0, signed=True),
    }
    return keys if network else {**keys, name: gain}


@dataclass(frozen=True)
class Document:
    """A robot file as it was read, and where everything in it stands.

    Parameters
    ----------
    name
        Name of the file, for messages.
    content
        What tomllib made of it.
    lines
        From :func:`~repro.live.robot.toml_lines.key_lines`.
    """

    name: str
    content: Mapping[str, Any]
    lines: Mapping[Place, int]

    @classmethod
    def of(cls, name: str, text: str) -> Document:
        """Parse a text.

        Raises
        ------
        InputError
            If it is not TOML; the message of tomllib says where.
        """
        try:
            return cls(name, tomllib.loads(text), key_lines(text))
        except tomllib.TOMLDecodeError as error:
            raise bad_input("file", name, "valid TOML", error) from error

    def line(self, *place: str | int) -> int:
        """Line of a key; of its table where the key has none."""
        while place and place not in self.lines:
            place = place[:-1]
        return self.lines.get(place, 1)

    def error(self, place: Place, must_be: str, received: Any) -> InputError:
        """Error about a key: file, line, table, what it must be, what it is."""
        *table, key = place
        where = f", {_shown(tuple(table))}" if table else ""
        return bad_input(str(key), f"{self.name}, line {self.line(*place)}{where},", must_be, received)

    def tables(self, name: str) -> list[dict[str, Any]]:
        """Tables ``[[name]]``, none if there are none."""
        found = self.content.get(name, [])
        if not isinstance(found, list) or not all(isinstance(table, dict) for table in found):
            raise self.error((name,), f"tables [[{name}]]", found)
        return found

    def table(self, name: str) -> dict[str, Any]:
        """Table ``[name]``, empty if there is none."""
        found = self.content.get(name, {})
        if not isinstance(found, dict):
            raise self.error((name,), f"a table [{name}]", found)
        return found

    def checked(self, keys: Mapping[str, Key], *place: str | int) -> dict[str, Any]:
        """Values of a table, those left out at their defaults.

        Raises
        ------
        InputError
            If a key is unknown, missing, or its value does not fit.
        """
        table: Any = self.content
        for part in place:
            table = table[part] if isinstance(part, int) or part in table else {}
        for name in table:
            if name not in keys:
                raise self.error((*place, name), _known(name, keys), "a key that does not exist")
        values = {}
        for name, key in keys.items():
            if name not in table:
                if key.default is None:
                    raise self.error((*place, name), f"given: {key.must_be}", "nothing")
                values[name] = key.default
            elif not key.fits(table[name]):
                raise self.error((*place, name), key.must_be, repr(table[name]))
            else:
                values[name] = table[name]
        return values

    def checked_kind(
        self, kinds: Mapping[str, Mapping[str, Key]], *place: str | int, placed: bool
    ) -> dict[str, Any]:
        """Values of a table whose ``kind`` says which keys it has."""
        name, number = place
        table, kind = self.tables(str(name))[int(number)], _word(*kinds)
        if not kind.fits(table.get("kind")):
            received = repr(table["kind"]) if "kind" in table else "nothing"
            raise self.error((*place, "kind"), kind.must_be, received)
        keys = {"kind": kind, **(_PLACE if placed else {}), **kinds[table["kind"]]}
        return self.checked(keys, *place)


def imu_keys() -> dict[str, Key]:
    """Keys of ``[[imus]]``."""
    return {**_PLACE, "stream": _count(0)}


def top_keys() -> dict[str, Key]:
    """Keys of the file outside of tables, and the names of its tables."""

    def fits(x: Any) -> bool:
        return (
            isinstance(x, list) and len(x) == 3 and all(map(_is_number, x)) and math.hypot(*x) <= 1.0
        )  # the Earth has 0.02-0.07 mT: 50 is in microtesla

    earth = Key("three numbers along x, y, z of the base, together at most 1 [mT]", fits, [0.0, 0.0, 0.0])
    tables = {
        name: Key("", lambda _: True, [])
        for name in ("stream", "segments", "magnets", "sensors", "imus", "model")
    }
    return {"earth_mt": earth, **tables}


def model_keys(segments: int, sensors: int) -> dict[str, Key]:
    """Keys of ``[model]``: trained networks instead of the field of the magnets."""
    counts = sorted({1, segments, sensors})

    def fits(x: Any) -> bool:
        return isinstance(x, list) and len(x) in counts and all(isinstance(name, str) for name in x)

    inputs = _word("angles", "cosines")._replace(default="angles")
    return {
        "networks": Key("files: one for all sensors, one per segment, or one per sensor", fits),
        "inputs": inputs,
    }


def _known(name: str, keys: Mapping[str, Key]) -> str:
    """Say which key was probably meant: one of the same name in another unit, or of a similar name."""
    stem = name.rsplit("_", 1)[0]
    same = [key for key in keys if key.rsplit("_", 1)[0] == stem]
    near = same or get_close_matches(name, keys, n=1, cutoff=0.6)
    return near[0] if near else f"one of {', '.join(keys)}"


def _shown(table: Place) -> str:
    return f"[[{table[0]}]] {int(table[1]) + 1}" if len(table) == 2 else f"[{table[0]}]"
