"""A robot in a TOML file. Reading it runs no code."""

from __future__ import annotations

import hashlib
import json
import math
import re
import tomllib
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from difflib import get_close_matches
from pathlib import Path
from typing import Any, NamedTuple, TypeGuard

import numpy as np
from scipy.spatial.transform import Rotation

from repro.chain import AffineCurvature, BallJoint, ConstantCurvature, FreeBody, Link, point_on
from repro.common import ArrayLike, InputError, bad_input, require, whole
from repro.estimators.calibration import load_calibration
from repro.magnets import Cube, Disc, Magnet, Ring
from repro.networks import Network, load_network
from repro.parts import Assembly, Imu, Sensor, Source
from repro.robot import Robot

_SI = {"mm": 1e-3, "deg": math.pi / 180, "percent": 1e-2}
_PER_MT = {"mT": 1.0, "uT": 1e3, "nT": 1e6, "G": 10.0, "mG": 1e4}
"""Units of readings for 1 mT; for millivolts and counts the file says how many a millitesla is."""
_MISTAKEN = {"mm": {"metres": 1e3}, "mT": {"tesla": 1e3, "gauss": 0.1}, "deg": {"radians": 180 / math.pi}}
"""Units that a number is often written in by mistake, and the factor from it."""
_Row = dict[str, Any]
"""A table of the file. What its values are is known once they are read by their keys."""
_Where = tuple[str | int, ...]
"""Name of a table, its number among those of one name, and a key."""
_NEEDED = object()
_FORMATS = ("csv", "frames", "hall", "millivolts", "quaternions")
_PARTS = ("segments", "magnets", "sensors", "imus")


class _Key(NamedTuple):
    """What a key takes: words, a test, its value when left out, its factor to SI, what looks wrong, and its rival."""

    must_be: str
    fits: Callable[[object], bool]
    default: object = _NEEDED
    unit: str = ""
    doubt: Callable[[Any], str] = lambda _: ""
    not_beside: str = ""


def _is_number(x: object) -> TypeGuard[float]:
    return isinstance(x, int | float) and not isinstance(x, bool) and abs(x) <= 1e300


def _numbers(x: object, n: int) -> TypeGuard[list[float]]:
    return isinstance(x, list) and len(x) == n and all(map(_is_number, x))


def _number(
    low: float,
    high: float,
    unit: str,
    default: object = _NEEDED,
    *,
    signed: bool = False,
    n: int = 1,
) -> _Key:
    """Describe a number (or one for each of ``n`` axes) whose magnitude is in a range, or the default."""

    def fits(x: object) -> bool:
        values = x if n > 1 and _numbers(x, n) else [x]
        return all(
            _is_number(v) and (v == default or low <= (abs(v) if signed else v) <= high) for v in values
        )

    words = "0, or " if default == 0 < low else ""
    words += f"{'of a magnitude ' if signed else ''}between {low:g} and {high:g}"
    words += f", or {n} of them" if n > 1 else ""
    return _Key(f"{words} [{unit}]", fits, default, unit, _radians if unit == "deg" else lambda _: "")


def _radians(x: Any) -> str:
    """Doubt angles in degrees that are all smaller than a turn in radians, and no round numbers."""
    values = [value for value in (x if isinstance(x, list) else [x]) if value]
    small = bool(values) and all(
        0.01 < abs(v) <= 2 * math.pi + 1e-3 and 2 * v != round(2 * v) for v in values
    )
    return "looks like radians" if small else ""


def _noise(unit: str, n: int = 1) -> _Key:
    """Describe the noise of readings in their unit; doubt what is none of a magnetic sensor."""

    def doubt(x: Any) -> str:
        noise = np.divide(x, _PER_MT.get(unit, math.nan))
        wrong = np.min(noise) < 1e-5 or np.max(noise) > 0.5
        return f"is a noise of {np.max(noise):g} mT, which is doubtful" if wrong else ""

    return _number(1e-9, 1e6, unit, None, n=n)._replace(doubt=doubt)


def _bounds(high: float, least: float, unit: str, default: object = None) -> _Key:
    """Describe bounds, the smaller first, so far apart and within a magnitude; or one number, which is fixed."""

    def fits(x: object) -> bool:
        pair = _numbers(x, 2) and x[1] - x[0] >= least and max(map(abs, x)) <= high
        return pair or (_is_number(x) and abs(x) <= high)

    words = (
        f"[lowest, highest], at least {least:g} apart and within {high:g} of zero, or one number to fix it"
    )
    return _Key(f"{words} [{unit}]", fits, default, unit, _radians if unit == "deg" else lambda _: "")


def _vector(what: str, unit: str = "", n: int = 3, most: float = 1e9) -> _Key:
    return _Key(
        f"{n} numbers, {what}, together at most {most:g} [{unit}]",
        lambda x: _numbers(x, n) and math.hypot(*x) <= most,
        None,
        unit,
        lambda x: "looks like metres" if unit == "mm" and 0 < math.hypot(*x) < 0.1 else "",
    )


def _quaternion(turn: str) -> _Key:
    return _vector(f"a unit quaternion [x, y, z, w] {turn}", n=4)._replace(
        doubt=lambda x: "looks as if w came first" if abs(x[0]) > 0.999 else ""
    )


def _doubt_of_earth(field: list[float]) -> str:
    size = math.hypot(*field)
    return f"has a length of {size:.2g} mT, which is doubtful" if size and not 0.01 < size < 0.1 else ""


def _word(*words: str, default: object = _NEEDED) -> _Key:
    return _Key(f"one of {', '.join(map(repr, words))}", lambda x: x in words, default)


def _are_tables(x: object) -> bool:
    return isinstance(x, list) and all(isinstance(table, dict) for table in x)


def _is_channel(x: object) -> bool:
    return bool(x) and (x.isprintable() if isinstance(x, str) else isinstance(x, int))


def _channels(n: int) -> _Key:
    words = f"{n} columns, one for every axis: names, or numbers from 1"
    return _Key(words, lambda x: isinstance(x, list) and len(x) == n and all(map(_is_channel, x)), None)


_TEXT = _Key(
    "a name in one line that can be printed",
    lambda x: isinstance(x, str) and x.isprintable() and x != "",
    None,
)
_TABLE = _Key("a table { key = number, ... }", lambda x: isinstance(x, dict), {})
_LENGTH, _SIZE = _number(1.0, 5000.0, "mm"), _number(0.5, 200.0, "mm")
_STRETCH, _BEND, _TURN = _bounds(1000.0, 0.05, "mm"), _bounds(2000.0, 0.05, "mm"), _bounds(720.0, 0.5, "deg")
_PLACE = {
    "segment": _number(0, 10_000, "number of a segment, 0 for the base"),
    "at_mm": _number(0.1, 5000.0, "mm", 0.0),
    "tolerance": _TABLE,
    "free": _TABLE,
}
_POSITION = _vector("along x, y, z of the cross-section", "mm", most=5000.0)
_DIRECTION = _vector("along x, y, z of the cross-section")
_SEGMENTS: dict[str, tuple[dict[str, _Key], dict[str, _Key]]] = {
    "constant_curvature": (
        {"length_mm": _LENGTH, "radius_mm": _number(0.5, 500.0, "mm")},
        {"delta_x_mm": _BEND, "delta_y_mm": _BEND, "delta_L_mm": _STRETCH},
    ),
    "affine_curvature": (
        {"length_mm": _LENGTH},
        {
            "kappa_0_rad": _bounds(30.0, 0.01, "rad"),
            "kappa_1_rad": _bounds(60.0, 0.01, "rad"),
            "phi_deg": _bounds(720.0, 10.0, "deg"),
            "delta_L_mm": _STRETCH,
        },
    ),
    "link": (
        {
            "length_mm": _number(0.0, 5000.0, "mm"),
            "offset_mm": _vector("along x, y, z of its start", "mm", most=5000.0),
            "orientation": _quaternion("from the frame of the link to that of its start"),
            "tolerance": _TABLE,
        },
        {},
    ),
    "ball_joint": ({}, {"rx_deg": _TURN, "ry_deg": _TURN, "rz_deg": _TURN}),
    "free": (
        {},
        {
            **{f"{axis}_mm": _bounds(1e5, 0.05, "mm", _NEEDED) for axis in "xyz"},
            **{f"r{axis}_deg": _TURN for axis in "xyz"},
        },
    ),
}
"""Keys of ``[[segments]]`` by their ``kind``: sizes, and coordinates with their bounds."""
_KINDS = {
    "constant_curvature": ConstantCurvature,
    "affine_curvature": AffineCurvature,
    "link": Link,
    "free": FreeBody,
}
_POLARISATION = _number(10.0, 2000.0, "mT", signed=True)
_MAGNETS: dict[str, dict[str, _Key]] = {
    "ring": {
        "outer_diameter_mm": _SIZE,
        "inner_diameter_mm": _number(0.1, 200.0, "mm", 0.0),
        "height_mm": _SIZE,
        "polarisation_mt": _POLARISATION,
    },
    "disc": {"diameter_mm": _SIZE, "height_mm": _SIZE, "polarisation_mt": _POLARISATION},
    "cube": {"edge_mm": _SIZE, "polarisation_mt": _POLARISATION},
}
_CUBE_BY_SIDE = {"cube": {"side_mm": _SIZE, "polarisation_mt": _POLARISATION}}
_RANGE_MM = _Key(
    "[lowest, highest] [mm], the smaller first", lambda x: _numbers(x, 2) and x[0] < x[1], None, "mm"
)
_RANGE_DEG = _RANGE_MM._replace(must_be="[lowest, highest] [deg], the smaller first", unit="deg")
_STD_MM = _number(0.0, 1000.0, "mm", None)._replace(
    doubt=lambda x: "looks like metres" if 0 < x < 5e-3 else ""
)
_STD_DEG = _number(0.0, 180.0, "deg", None)
_STD_PERCENT = _number(0.0, 100.0, "percent", None)
_TOLERANCES: dict[str, dict[str, tuple[str, _Key]]] = {
    "segments": {"offset_mm": ("offset", _STD_MM), "tilt_deg": ("tilt", _STD_DEG)},
    "magnets": {
        "at_mm": ("at", _STD_MM),
        "position_mm": ("position", _STD_MM),
        "tilt_deg": ("tilt", _STD_DEG),
        "polarisation_percent": ("polarisation", _STD_PERCENT),
        "size_mm": ("size", _STD_MM),
        "side_mm": ("size", _STD_MM),
    },
    "sensors": {
        "at_mm": ("at", _STD_MM),
        "position_mm": ("position", _STD_MM),
        "radial_mm": ("radius", _STD_MM),
        "azimuth_deg": ("azimuth", _STD_DEG),
        "tilt_deg": ("tilt", _STD_DEG),
        "gain_percent": ("gain", _STD_PERCENT),
        "offset_mt": ("offset", _number(0.0, 100.0, "mT", None)),
    },
    "imus": {"at_mm": ("at", _STD_MM), "tilt_deg": ("tilt", _STD_DEG), "heading_deg": ("heading", _STD_DEG)},
}
"""Keys of a ``tolerance``, and the names that the parts have for them."""
_HEADER = re.compile(r"\s*(\[\[?)\s*[\"']?([^\[\]#\"']+?)[\"']?\s*\]")
_ENTRY = re.compile(r"""\s*["']?([A-Za-z0-9_-]+)["']?\s*[=.]""")


class _Document:
    """A robot file as it was read, and where everything in it stands."""

    def __init__(self, name: str, content: bytes) -> None:
        self.name = name
        try:
            text = content.decode("utf-8-sig")
            self.content: _Row = tomllib.loads(text)
        except (ValueError, RecursionError) as error:
            raise bad_input("file", name, "valid TOML in UTF-8", error) from error
        self.lines: dict[_Where, int] = {}
        counts: dict[str, int] = {}
        table: _Where = ()
        for number, line in enumerate(text.split("\n"), start=1):
            if header := _HEADER.match(line):
                table = (header[2],)
                if header[1] == "[[":
                    counts[header[2]] = counts.get(header[2], -1) + 1
                    table = (header[2], counts[header[2]])
                self.lines.setdefault(table, number)
            elif entry := _ENTRY.match(line):
                self.lines.setdefault((*table, entry[1]), number)

    def line(self, *place: str | int) -> int:
        """Return the line of a key; that of its table where the key has none."""
        while place and place not in self.lines and (*place, 0) not in self.lines:
            place = place[:-1]
        return self.lines.get(place, self.lines.get((*place, 0), 1))

    def where(self, *place: str | int) -> str:
        """Return file, line and table of a key."""
        first, second = (*place, None, None)[:2]
        number = f", [[{first}]] {second + 1}" if isinstance(second, int) else ""
        table = number or (f", [{first}]" if second is not None else "")
        return f"{self.name}, line {self.line(*place)}{table}"

    def error(self, place: _Where, must_be: str, received: object) -> InputError:
        """Return the error about a key: file, line, table, what it must be, what it is."""
        return bad_input(str(place[-1]), f"{self.where(*place)},", must_be, received)

    def tables(self, name: str) -> list[_Row]:
        """Return the tables ``[[name]]``."""
        return self.content.get(name, [])

    def read(self, keys: Mapping[str, _Key], *place: str | int) -> _Row:
        """Return the values of a table in SI units, those left out at their defaults; warn where one looks wrong."""
        table: Any = self.content
        for part in place:
            table = table[part] if isinstance(part, int) or part in table else {}
        for name in table:
            if name not in keys:
                raise self.error((*place, name), _nearest(name, keys), "a key that does not exist")
        values = {}
        for name, key in keys.items():
            value = values[name] = table.get(name, key.default)
            if value is _NEEDED:
                raise self.error((*place, name), f"given: {key.must_be}", "nothing")
            if name not in table:
                continue
            if not key.fits(value):
                raise self.error((*place, name), key.must_be, repr(value) + _mistaken(key, value))
            if key.not_beside in table:
                line = self.line(*place, key.not_beside)
                raise self.error(
                    (*place, name), f"left out beside {key.not_beside} (line {line})", repr(value)
                )
            if doubt := key.doubt(value):
                said = f"{self.where(*place, name)}: {name} = {value!r} {doubt}."
                warnings.warn_explicit(said, UserWarning, self.name, self.line(*place, name))
            if key.unit in _SI:
                values[name] = np.multiply(value, _SI[key.unit]).tolist()
        return values

    def read_kind(
        self, kinds: Mapping[str, Mapping[str, _Key]], others: Mapping[str, _Key], name: str, k: int
    ) -> _Row:
        """Return the values of a table whose ``kind`` says which keys it has beside others."""
        kind, key = self.tables(name)[k].get("kind"), _word(*kinds)
        if str(kind) not in kinds:
            raise self.error((name, k, "kind"), _nearest(str(kind), kinds), repr(kind) if kind else "nothing")
        return self.read({"kind": key, **others, **kinds[str(kind)]}, name, k)

    @contextmanager
    def at(self, *place: str | int) -> Iterator[None]:
        """Give the refusals of a part the place of its table."""
        try:
            yield
        except InputError as error:
            raise InputError(f"{self.where(*place)}: {error}") from error


def _nearest(name: str, known: Iterable[str]) -> str:
    return next(iter(get_close_matches(name, known, 1)), f"one of {', '.join(known)}")


def _mistaken(key: _Key, value: object) -> str:
    """Say in which unit a number would fit."""
    for unit, factor in _MISTAKEN.get(key.unit, {}).items():
        is_list = isinstance(value, list) and all(map(_is_number, value))
        if (is_list or _is_number(value)) and key.fits(np.multiply(value, factor).tolist()):
            return f" (in {unit}?)"
    return ""


def example() -> Path:
    """Return the folder of an example: ``robot.toml``, ``mine.csv`` with its readings and ``poses.csv``.

    A soft arm of two segments with a disc magnet in each and four three-axis chips. The readings, and the poses of
    the tips of its segments in motion capture, are simulated.

    Examples
    --------
    >>> import repro
    >>> sorted(file.name for file in repro.example().iterdir())
    ['mine.csv', 'poses.csv', 'robot.toml']
    """
    return Path(__file__).parent / "example_data"


def load_robot(path: str | Path, calibration: str | Path | None = None) -> Robot:
    """Read a robot file, and apply a calibration if there is one.

    The file is TOML, as ``robot.toml`` in ``repro.example()``: tables ``[[segments]]`` from base to tip,
    ``[[magnets]]``, ``[[sensors]]``, ``[[imus]]``, and ``[stream]`` with rate, unit and noise of the readings. Names
    of keys end in their unit. A coordinate has bounds ``[lowest, highest]``, or one number that fixes it; without
    bounds a segment bends by up to 90 degrees and stretches by up to 10 %. Networks are safetensors files in the
    folder of the file. Nothing in it is run.

    Parameters
    ----------
    path
        The robot file.
    calibration
        What ``save`` of a :class:`.Calibration` wrote for this file.

    Returns
    -------
    Robot
        With bounds, start, noise, rate and Earth as the file states them.

    Raises
    ------
    InputError
        If the file does not describe a robot; the message names file, line and key.

    Examples
    --------
    >>> import repro
    >>> robot = repro.load_robot(repro.example() / "robot.toml")
    >>> robot
    Robot of ConstantCurvature, ConstantCurvature; 2 magnets, 4 sensors, 0 IMUs; 6 coordinates
    >>> robot.rate_hz, robot.names[:3]
    (25.0, ('B1x', 'B1y', 'B1z'))
    """
    file = isinstance(path, str | Path) and Path(path).is_file()
    require(file, "path", "load_robot", "a robot file that exists", path)
    path, content = Path(path), Path(path).read_bytes()
    robot = _robot(_Document(path.name, content), path.parent, hashlib.sha256(content).hexdigest())
    return robot if calibration is None else load_calibration(calibration, robot).robot


def _robot(document: _Document, folder: Path, sha256: str) -> Robot:
    top = document.read(
        {
            "earth_mt": _vector("along x, y, z of the base", "mT", most=1.0)._replace(doubt=_doubt_of_earth),
            "base_orientation": _quaternion("from the frame of the base to the world of the IMUs")._replace(
                fits=lambda x: _numbers(x, 4) and abs(math.hypot(*x) - 1) <= 1e-3
            ),
            "stream": _TABLE,
            "model": _TABLE,
            **{name: _Key(f"tables [[{name}]]", _are_tables, []) for name in _PARTS},
        }
    )
    n = {name: range(len(document.tables(name))) for name in _PARTS}
    if not n["segments"]:
        raise document.error(("segments",), "given: at least one table [[segments]]", "nothing")
    chain = [_segment(document, k) for k in n["segments"]]
    bare = Robot([one.segments[0] for one in chain])
    lower, upper, start = (
        np.concatenate([vars(one)[x] for one in chain]) for x in ("lower", "upper", "start")
    )
    stated = any("start" in table for table in document.tables("segments"))
    units, unit = _word(*_PER_MT, "mV", "raw", default="mT"), str(top["stream"].get("unit", "mT"))
    if not units.fits(unit):  # before the names of keys that end in it
        raise document.error(("stream", "unit"), units.must_be, repr(unit))
    noise = f"noise_{unit.lower()}"
    keys = {
        "format": _word(*_FORMATS, default=None),
        "rate_hz": _number(1e-3, 1e5, "Hz", None),
        "unit": units,
        noise: _noise(unit),
        "noise_deg": _number(1e-3, 30.0, "deg", math.radians(0.2)),
    }
    stream = document.read(keys, "stream")
    networks = _networks(document, folder)
    per_mt = 1.0 if networks else _PER_MT.get(unit)
    sensors = [_sensor(document, k, bare, unit, per_mt, stream[noise]) for k in n["sensors"]]
    _check_channels(document, sensors)
    std = None if per_mt is None or stream[noise] is None else stream[noise] / per_mt
    return bare.replaced(
        magnets=[_magnet(document, k, bare) for k in n["magnets"]], sensors=sensors,
        imus=[_imu(document, k, bare, top["base_orientation"], stream["noise_deg"]) for k in n["imus"]],
        lower=lower, upper=upper, start=start if stated else None, noise=std, rate_hz=stream["rate_hz"],
        earth=top["earth_mt"], model=networks or None, source=Source(document.name, sha256, stream),
    )  # fmt: skip


def _segment(document: _Document, k: int) -> Robot:
    """Return a robot of one segment, with its bounds, and its start or the middle of these.

    Without bounds a segment bends by up to 90 degrees (an affine one by its ``kappa_0`` up to that, by its
    ``kappa_1`` up to twice that) and stretches by up to 10 %.
    """
    place = ("segments", k)
    merged = {kind: {**sizes, **limits} for kind, (sizes, limits) in _SEGMENTS.items()}
    row = document.read_kind(merged, {"start": _TABLE}, *place)
    kind, (sizes, keys), table = row["kind"], _SEGMENTS[row["kind"]], document.tables("segments")[k]
    limits = list(keys)
    if kind == "ball_joint":  # the axes that are named, or all
        limits = [name for name in limits if row[name] is not None] or limits
        segment = BallJoint("".join(name[1] for name in limits))
    else:
        row["tolerance"] = _tolerance(document, *place)
        with document.at(*place):
            segment = _KINDS[kind](*(row[name] for name in sizes))
    bend, stretch = math.pi / 2, 0.1 * segment.length
    usual = {"kappa_0_rad": bend, "kappa_1_rad": 2 * bend, "delta_L_mm": stretch}
    usual |= dict.fromkeys(("delta_x_mm", "delta_y_mm"), bend * row.get("radius_mm", 0.0))
    ends = {
        name: _Key(f"a number [{keys[name].unit}]", _is_number, math.nan, keys[name].unit) for name in limits
    }
    start = list(document.read(ends, *place, "start").values())
    without = {name: [-usual.get(name, math.nan), usual.get(name, math.nan)] for name in limits}
    given = [without[name] if row[name] is None else row[name] for name in limits]
    lower, upper = np.array([np.broadcast_to(pair, 2) for pair in given]).reshape(-1, 2).T
    if "delta_L_mm" in limits and lower[limits.index("delta_L_mm")] <= -segment.length:
        shortest = f"above {-1e3 * segment.length:g} [mm], which leaves no length"
        raise document.error((*place, "delta_L_mm"), shortest, table["delta_L_mm"])
    start = np.where(np.isnan(start), np.nan_to_num((lower + upper) / 2), start)
    for name, low, x, high in zip(limits, lower, start, upper, strict=True):
        whole_turn = name.endswith("_deg") and not high - low < 2 * math.pi - 1e-9
        if not (low <= x <= high or whole_turn):
            raise document.error((*place, "start", name), "within its bounds", table["start"][name])
    return Robot([segment], lower=lower, upper=upper, start=start)


def _place(document: _Document, name: str, k: int, row: _Row, bare: Robot) -> _Row:
    """Return the segment, the place along it and the tolerance of a part; refuse a place that is not there."""
    with document.at(name, k, "at_mm"):
        bare.check_place(point_on(row["segment"], row["at_mm"]), "segment, at_mm")
    if (
        "at_mm" not in document.tables(name)[k]
        and row["segment"]
        and bare.segments[row["segment"] - 1].length
    ):
        raise document.error((name, k, "at_mm"), f"given on segment {row['segment']}", "nothing")
    return {"segment": row["segment"], "at": row["at_mm"], "tolerance": _tolerance(document, name, k)}


def _tolerance(document: _Document, name: str, k: int) -> dict[str, float] | None:
    """Return the tolerance of a part, by the names that parts have for it."""
    known = _TOLERANCES[name]
    given = document.read({key: own for key, (_, own) in known.items()}, name, k, "tolerance")
    return {known[key][0]: value for key, value in given.items() if value is not None} or None


def _free(
    document: _Document, name: str, k: int, sizes: Iterable[str] = ()
) -> dict[str, tuple[float, float]] | None:
    """Return the ranges of what is free of a part."""
    ranges = {"at_mm": _RANGE_MM, "azimuth_deg": _RANGE_DEG, **dict.fromkeys(sizes, _RANGE_MM)}
    given = document.read(ranges, name, k, "free")
    attributes = {"azimuth_deg": "azimuth", "side_mm": "edge"}
    return {
        attributes.get(key, key.removesuffix("_mm")): (ends[0], ends[1])
        for key, ends in given.items()
        if ends
    } or None


def _magnet(document: _Document, k: int, bare: Robot) -> Magnet:
    others = {**_PLACE, "position_mm": _POSITION, "direction": _DIRECTION}
    kinds = _MAGNETS | (_CUBE_BY_SIDE if "side_mm" in document.tables("magnets")[k] else {})
    row = document.read_kind(kinds, others, "magnets", k)
    sizes = [row[name] for name in kinds[row["kind"]]]
    if row["kind"] == "ring" and sizes[1] >= sizes[0]:
        at = ("magnets", k, "inner_diameter_mm")
        raise document.error(at, "below outer_diameter_mm", f"{1e3 * sizes[1]:g}")
    where = _place(document, "magnets", k, row, bare)
    free = _free(document, "magnets", k, [key for key in kinds[row["kind"]] if key.endswith("_mm")])
    with document.at("magnets", k):
        shape = {"ring": Ring, "disc": Disc, "cube": Cube}[row["kind"]](*sizes)
        return Magnet(
            shape, **where, direction=row["direction"], position=row["position_mm"],
            free=free,
        )  # fmt: skip


def _sensor(
    document: _Document, k: int, bare: Robot, unit: str, per_mt: float | None, noise: float | None
) -> Sensor:
    """Return a sensor; what its file says in the unit of the readings is in mT then."""
    place, low, own = ("sensors", k), unit.lower(), per_mt is None
    gain = f"gain_{low}_per_mt" if own else "gain"
    axes = 3 if document.tables("sensors")[k].get("axes") == 3 else 1
    keys = {
        **_PLACE,
        "name": _TEXT,
        "axes": _Key("1 or 3", lambda x: x in (1, 3) and _is_number(x), 1),
        "channel": _Key("a column: its name, or a number from 1", _is_channel, None, not_beside="channels"),
        "channels": _channels(axes),
        "radial_mm": _number(0.1, 500.0, "mm", 0.0)._replace(not_beside="position_mm"),
        "azimuth_deg": _number(0.0, 360.0, "deg", 0.0, signed=True)._replace(not_beside="position_mm"),
        "position_mm": _POSITION,
        "tilt_deg": _number(0.0, 180.0, "deg", 0.0, signed=True)._replace(not_beside="direction"),
        "direction": _DIRECTION,
        "orientation": _quaternion("from the frame of the chip to that of the cross-section")._replace(
            not_beside="rotation_vector_rad"
        ),
        "rotation_vector_rad": _vector("about x, y, z of the cross-section", "rad", most=2 * math.pi),
        "range_mt": _number(0.05, 1e4, "mT", math.inf),
        "resolution_mt": _number(0.0, 100.0, "mT", 0.0),
        f"noise_{low}": _noise(unit, axes),
        f"offset_{low}": _number(0.0, 1e9, unit, 0.0, signed=True, n=axes),
        gain: _number(1e-3, 1e9, f"{unit}/mT", _NEEDED if own else 1.0, signed=True, n=axes),
    }
    row = document.read(keys, *place)
    scale = float(np.ravel(row[gain])[0]) if per_mt is None else per_mt
    std = row[f"noise_{low}"]
    if std is None and own:  # else that of the robot, which can be replaced
        std = noise
    if row["rotation_vector_rad"] is not None:
        row["orientation"] = Rotation.from_rotvec(row["rotation_vector_rad"]).as_quat()
    where = _place(document, "sensors", k, row, bare)
    free = _free(document, "sensors", k)
    with document.at(*place):
        return Sensor(
            **where, radial=row["radial_mm"], azimuth=row["azimuth_deg"], tilt=row["tilt_deg"],
            position=row["position_mm"], direction=row["direction"], axes=axes, orientation=row["orientation"],
            channels=row["channels"] or (None if row["channel"] is None else [row["channel"]]), name=row["name"],
            range=row["range_mt"], resolution=row["resolution_mt"], per_mt=scale, unit=unit,
            gain=np.divide(row[gain], scale if own else 1.0).tolist(),
            noise=None if std is None else np.divide(std, abs(scale)).tolist(),
            offset=np.divide(row[f"offset_{low}"], scale).tolist(), free=free,
        )  # fmt: skip


def _check_channels(document: _Document, sensors: Sequence[Sensor]) -> None:
    """Refuse two readings on one channel, and two sensors of one name."""
    first: dict[tuple[str, str | int], int] = {}
    for k, sensor in enumerate(sensors):
        for key, value in [("channel", x) for x in sensor.channels or ()] + [("name", sensor.name)]:
            if value is not None and first.setdefault((key, value), k) != k:
                other = document.where("sensors", first[key, value], key)
                raise document.error(("sensors", k, key), f"another than in {other}", value)


def _imu(document: _Document, k: int, bare: Robot, world: ArrayLike | None, noise: float) -> Imu:
    keys = {
        **{key: _PLACE[key] for key in ("segment", "at_mm", "tolerance")},
        "name": _TEXT,
        "stream": _number(0, 255, "number of a stream", None)._replace(not_beside="channels"),
        "channels": _channels(4),
        "mounted": _quaternion("from the frame of the IMU to that of the cross-section"),
        "noise_deg": _number(1e-3, 30.0, "deg", noise),
    }
    row = document.read(keys, "imus", k)
    where = _place(document, "imus", k, row, bare)
    with document.at("imus", k):
        return Imu(
            **where, orientation=row["mounted"], name=row["name"], world=world,
            channels=row["channels"] or row["stream"], noise=row["noise_deg"],
        )  # fmt: skip


def _networks(document: _Document, folder: Path) -> list[Network]:
    """Return the networks of ``[model]``: safetensors in the folder of the file, which hold numbers only."""
    words = (
        "a list of safetensors files (TorchScript is a program, which a file cannot start; load it in Python)"
    )

    def fits(x: object) -> bool:
        return isinstance(x, list) and all(re.fullmatch(r"[^\0]+\.safetensors", str(name)) for name in x)

    names = document.read({"networks": _Key(words, fits, [])}, "model")["networks"]
    for name in names:
        inside = (folder / name).resolve().is_relative_to(folder.resolve())
        if not inside:
            raise document.error(("model", "networks"), "files in the folder of the robot file", name)
    with document.at("model", "networks"):
        return [load_network(folder / name) for name in names]


def write_improved(path: str | Path, better: Assembly, output: str | Path) -> None:
    """Write a robot file with the changes of a better design; all else, and the comments, stay as they are.

    Parameters
    ----------
    path
        The robot file that was checked.
    better
        ``robot`` of the :class:`.Improvement` of this file.
    output
        The new file, whole or not at all.

    Raises
    ------
    InputError
        If a part is not a table of its own with a key on each line, or the new file is there already.
    """
    path, old = Path(path), load_robot(path)
    document = _Document(path.name, path.read_bytes())
    lines, added = path.read_bytes().decode("utf-8-sig").split("\n"), list[str]()
    for name in ("magnets", "sensors"):
        before: Sequence[Any] = getattr(old, name)
        for k, part in enumerate(getattr(better, name)):
            if k < len(before):
                table = document.tables(name)[k]
                _rewrite(document, lines, (name, k), _changes(before[k], part, table))
                continue
            like = next(n for n, own in enumerate(before) if _alike(own, part))
            table = document.tables(name)[like]
            own = (
                {"name": part.name, "channels": list(part.channels)} if part.channels else {"name": part.name}
            )
            entries = (
                {x: y for x, y in table.items() if x != "channel"} | own | _changes(before[like], part, table)
            )
            added += ["", f"[[{name}]]", *(f"{key} = {_toml(value)}" for key, value in entries.items())]
    text = "\n".join([*lines, *added, ""] if added else lines)
    with whole(output, "improved robot file") as part:
        part.write_text(text, encoding="utf-8", newline="")
        same = False
        with suppress(InputError):
            read = _robot(_Document(path.name, text.encode()), path.parent, "")
            same = _numbers_of(read) == _numbers_of(better)
        expected = "one whose parts are tables [[magnets]] and [[sensors]] with a key on each line"
        require(same, "path", "write_improved", expected, path)


def _numbers_of(robot: Assembly) -> list[Any]:
    """Return what a better design may have changed."""
    parts: list[Any] = [*robot.magnets, *robot.sensors]
    own = ("at", "azimuth", "position", "name", "shape")
    return [[str(vars(part).get(name)) for name in own] for part in parts]


def _alike(chip: Sensor, copy: Sensor) -> bool:
    """Whether a chip is a copy of another one at another place."""
    places = ("at", "azimuth", "position", "name", "channels", "place", "free")
    one, other = ({x: str(y) for x, y in vars(part).items() if x not in places} for part in (chip, copy))
    return one == other


def _changes(was: Any, part: Any, table: _Row) -> _Row:
    """Return the keys of a part that are other numbers now, in their units."""
    found: _Row = {"at_mm": round(1e3 * part.at, 6)} if part.at != was.at else {}
    if part.position is not None and np.any(np.not_equal(part.position, was.position)):
        found["position_mm"] = np.round(np.multiply(part.position, 1e3), 6).tolist()
    if isinstance(part, Sensor):
        azimuth = {"azimuth_deg": round(math.degrees(part.azimuth), 6)}
        return found | (azimuth if part.azimuth != was.azimuth else {})
    for name, size in vars(part.shape).items():
        if size != vars(was.shape)[name]:
            found["side_mm" if "side_mm" in table else f"{name}_mm"] = round(1e3 * size, 6)
    return found


def _rewrite(document: _Document, lines: list[str], place: _Where, changes: _Row) -> None:
    """Put other numbers into the lines of a table, and new keys behind its head."""
    for key, value in changes.items():
        head = document.line(*place) - 1
        if (*place, key) in document.lines:
            at = document.line(*place, key) - 1
            lines[at] = re.sub(r"=\s*(\[[^\]]*\]|[^#\s]+)", f"= {_toml(value)}", lines[at], count=1)
        else:
            lines[head] += f"\n{key} = {_toml(value)}"


def _toml(value: object) -> str:
    """Write a value as TOML does."""
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{key} = {_toml(own)}" for key, own in value.items()) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(map(_toml, value)) + "]"
    return json.dumps(value, ensure_ascii=False) if isinstance(value, str | bool) else repr(value)
