"""A robot in a TOML file, and what a calibration found in a JSON file. Reading them runs no code."""

from __future__ import annotations

import hashlib
import json
import math
import re
import tomllib
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from difflib import get_close_matches
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from repro.common import Array, InputError, bad_input, require
from repro.estimators.calibration import Calibration, placed
from repro.magnets import Cube, Disc, Magnet, Ring
from repro.networks import load_network
from repro.robot import (
    AffineCurvature,
    BallJoint,
    ConstantCurvature,
    FreeBody,
    Imu,
    Link,
    Robot,
    Segment,
    Sensor,
)

_SI = {"mm": 1e-3, "deg": math.pi / 180, "percent": 1e-2}
_PER_MT = {"mT": 1.0, "uT": 1e3, "nT": 1e6, "G": 10.0, "mG": 1e4}
"""Units of readings for 1 mT; for millivolts and counts the file says how many a millitesla is."""
_MISTAKEN = {"mm": {"metres": 1e3}, "mT": {"tesla": 1e3, "gauss": 0.1}, "deg": {"radians": 180 / math.pi}}
"""Units that a number is often written in by mistake, and the factor from it."""
_NEEDED: Any = object()
_FORMATS = ("csv", "frames", "hall", "millivolts", "quaternions")


class Source(NamedTuple):
    """The file that a robot was read from: its name, the hash of its content, and its table ``[stream]``."""

    name: str
    sha256: str
    stream: Mapping[str, Any]


class _Key(NamedTuple):
    """What a key takes: in words, as a test, its value when left out, its factor to SI, and what looks wrong."""

    must_be: str
    fits: Callable[[Any], bool]
    default: Any = _NEEDED
    unit: str = ""
    doubt: Callable[[Any], str] = lambda _: ""


def _is_number(x: object) -> bool:
    return isinstance(x, int | float) and not isinstance(x, bool) and abs(x) <= 1e300


def _numbers(x: object, n: int) -> bool:
    return isinstance(x, list) and len(x) == n and all(map(_is_number, x))


def _number(
    low: float, high: float, unit: str, default: Any = _NEEDED, *, signed: bool = False, n: int = 1
) -> _Key:
    """Describe a number (or one for each of ``n`` axes) whose magnitude is in a range, or zero if that is allowed."""
    zero = default == 0 or low == 0

    def fits(x: Any) -> bool:
        if n > 1 and isinstance(x, list):
            return _numbers(x, n) and all(map(fits, x))
        return _is_number(x) and (low <= (abs(x) if signed else x) <= high or (zero and x == 0))

    words = "0, or " if zero and low > 0 else ""
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


def _bounds(high: float, least: float, unit: str, default: Any = None) -> _Key:
    """Describe bounds, the smaller first, so far apart and within a magnitude; or one number, which is fixed."""

    def fits(x: Any) -> bool:
        pair = _numbers(x, 2) and x[1] - x[0] >= least and max(map(abs, x)) <= high
        return pair or (_is_number(x) and abs(x) <= high)

    words = (
        f"[lowest, highest], at least {least:g} apart and within {high:g} of zero, or one number to fix it"
    )
    return _Key(f"{words} [{unit}]", fits, default, unit, _radians if unit == "deg" else lambda _: "")


def _vector(what: str, unit: str, most: float, doubt: float = math.inf, default: Any = None) -> _Key:
    return _Key(
        f"three numbers along x, y, z of {what}, together at most {most:g} [{unit}]",
        lambda x: _numbers(x, 3) and math.hypot(*x) <= most,
        default,
        unit,
        lambda x: (
            f"has a length of {math.hypot(*x):.2g} {unit}, which is doubtful"
            if math.hypot(*x) > doubt
            else ""
        ),
    )


def _quaternion(turn: str) -> _Key:
    words = f"a unit quaternion [x, y, z, w] within 0.001, {turn}"
    doubt = "looks as if w came first"
    return _Key(
        words,
        lambda x: _numbers(x, 4) and abs(math.hypot(*x) - 1) <= 1e-3,
        None,
        "",
        lambda x: doubt if abs(x[0]) > 0.999 else "",
    )


def _whole(x: Any, low: int, high: int) -> bool:
    return isinstance(x, int) and not isinstance(x, bool) and low <= x <= high


def _count(low: int, high: int, default: Any = _NEEDED) -> _Key:
    return _Key(f"a whole number from {low} to {high}", lambda x: _whole(x, low, high), default)


def _word(*words: str, default: Any = _NEEDED) -> _Key:
    return _Key(f"one of {', '.join(map(repr, words))}", lambda x: x in words, default)


def _is_channel(x: Any) -> bool:
    return (isinstance(x, str) and x != "") or _whole(x, 1, 255)


def _channels(n: int) -> _Key:
    words = f"the {n} columns of its readings: names, or numbers from 1 to 255"
    return _Key(words, lambda x: isinstance(x, list) and len(x) == n and all(map(_is_channel, x)), None)


_TEXT = _Key("a name", lambda x: isinstance(x, str) and x != "", None)
_TABLE = _Key("a table { key = number, ... }", lambda x: isinstance(x, dict), {})
_LENGTH, _SIZE = _number(1.0, 5000.0, "mm"), _number(0.5, 200.0, "mm")
_STRETCH, _BEND, _TURN = _bounds(1000.0, 0.05, "mm"), _bounds(2000.0, 0.05, "mm"), _bounds(720.0, 0.5, "deg")
_PLACE = {"segment": _count(0, 10_000), "at_mm": _number(0.1, 5000.0, "mm", 0.0)}
_POSITION = _vector("the cross-section", "mm", 5000.0)
_DIRECTION = _Key(
    "three numbers along x, y, z of the cross-section, not all zero",
    lambda x: _numbers(x, 3) and 1e-9 <= math.hypot(*x) <= 1e9,
    None,
)
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
    "link": ({"length_mm": _number(0.0, 5000.0, "mm")}, {}),
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
_STD_MM, _STD_DEG = _number(0.0, 1000.0, "mm", None), _number(0.0, 180.0, "deg", None)
_STD_PERCENT = _number(0.0, 100.0, "percent", None)
_SIZES = (
    "size_mm",
    "side_mm",
    "edge_mm",
    "diameter_mm",
    "outer_diameter_mm",
    "inner_diameter_mm",
    "height_mm",
)
_TOLERANCES: dict[str, dict[str, tuple[str, _Key]]] = {
    "magnets": {
        "at_mm": ("at", _STD_MM),
        "position_mm": ("position", _STD_MM),
        "tilt_deg": ("tilt", _STD_DEG),
        "polarisation_percent": ("polarisation", _STD_PERCENT),
        **dict.fromkeys(_SIZES, ("size", _STD_MM)),
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

    def __init__(self, name: str, text: str) -> None:
        self.name = name
        try:
            self.content: dict[str, Any] = tomllib.loads(text)
        except (ValueError, RecursionError) as error:
            raise bad_input("file", name, "valid TOML", error) from error
        self.lines: dict[tuple[Any, ...], int] = {}
        counts: dict[str, int] = {}
        table: Any = ()
        for number, line in enumerate(text.split("\n"), start=1):
            if header := _HEADER.match(line):
                table = (header[2],)
                if header[1] == "[[":
                    counts[header[2]] = counts.get(header[2], -1) + 1
                    table = (header[2], counts[header[2]])
                self.lines.setdefault(table, number)
            elif entry := _ENTRY.match(line):
                self.lines.setdefault((*table, entry[1]), number)

    def line(self, *place: Any) -> int:
        """Return the line of a key; that of its table where the key has none."""
        while place and place not in self.lines:
            place = place[:-1]
        return self.lines.get(place, 1)

    def where(self, *place: Any) -> str:
        """Return file, line and table of a key."""
        first, second = (*place, None, None)[:2]
        number = f", [[{first}]] {second + 1}" if isinstance(second, int) else ""
        table = number or (f", [{first}]" if second is not None else "")
        return f"{self.name}, line {self.line(*place)}{table}"

    def error(self, place: tuple[Any, ...], must_be: str, received: Any) -> InputError:
        """Return the error about a key: file, line, table, what it must be, what it is."""
        return bad_input(str(place[-1]), f"{self.where(*place)},", must_be, received)

    def tables(self, name: str) -> list[dict[str, Any]]:
        """Return the tables ``[[name]]``."""
        found = self.content.get(name, [])
        if not isinstance(found, list) or not all(isinstance(table, dict) for table in found):
            raise self.error((name,), f"tables [[{name}]]", found)
        return found

    def read(self, keys: Mapping[str, _Key], *place: Any) -> dict[str, Any]:
        """Return the values of a table in SI units, those left out at their defaults; warn where one looks wrong."""
        table: Any = self.content
        for part in place:
            table = table[part] if isinstance(part, int) or part in table else {}
        if not isinstance(table, dict):
            raise self.error(place, f"a table [{place[-1]}]", table)
        for name in table:
            if name not in keys:
                same = [key for key in keys if key.rpartition("_")[0] == name.rpartition("_")[0] != ""]
                near = same or get_close_matches(name, keys, n=1, cutoff=0.6)
                known = near[0] if near else f"one of {', '.join(keys)}"
                raise self.error((*place, name), known, "a key that does not exist")
        values = {}
        for name, key in keys.items():
            value = table.get(name, key.default)
            if value is _NEEDED:
                raise self.error((*place, name), f"given: {key.must_be}", "nothing")
            if name in table:
                if not key.fits(value):
                    raise self.error((*place, name), key.must_be, repr(value) + _mistaken(key, value))
                if doubt := key.doubt(value):
                    self.warn((*place, name), f"{name} = {value!r} {doubt}")
                if _is_number(value) or (isinstance(value, list) and all(map(_is_number, value))):
                    scaled = np.multiply(value, _SI.get(key.unit, 1.0))
                    value = value if key.unit not in _SI else scaled.tolist()
            values[name] = value
        return values

    def read_kind(
        self, kinds: Mapping[str, Mapping[str, _Key]], others: Mapping[str, _Key], *place: Any
    ) -> dict[str, Any]:
        """Return the values of a table whose ``kind`` says which keys it has beside others."""
        kind, key = self.tables(place[0])[place[1]].get("kind"), _word(*kinds)
        if not (isinstance(kind, str) and key.fits(kind)):
            near = get_close_matches(str(kind), kinds, 1)
            received = f"{kind!r}{f' (do you mean {near[0]!r}?)' if near else ''}" if kind else "nothing"
            raise self.error((*place, "kind"), key.must_be, received)
        return self.read({"kind": key, **others, **kinds[kind]}, *place)

    def warn(self, place: tuple[Any, ...], text: str) -> None:
        """Say what looks wrong, with its line."""
        warnings.warn(f"{self.where(*place)}: {text}.", stacklevel=6)

    def apart(self, place: tuple[Any, ...], *pairs: tuple[str, str]) -> None:
        """Refuse two keys that say the same."""
        table = self.tables(place[0])[place[1]]
        for first, second in pairs:
            if first in table and second in table:
                expected = f"left out beside {second} (line {self.line(*place, second)})"
                raise self.error((*place, first), expected, repr(table[first]))

    @contextmanager
    def at(self, *place: Any) -> Iterator[None]:
        """Give the refusals of a part the place of its table."""
        try:
            yield
        except InputError as error:
            raise InputError(f"{self.where(*place)}: {error}") from error


def _mistaken(key: _Key, value: Any) -> str:
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
    of keys end in their unit. A coordinate has bounds ``[lowest, highest]``, or one number that fixes it. Networks
    are safetensors files in the folder of the file. Nothing in it is run.

    Parameters
    ----------
    path
        The robot file.
    calibration
        What :func:`save_calibration` or edition 1 wrote for this file.

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
    require(
        isinstance(path, str | Path), "path", "load_robot", "the path of a robot file", type(path).__name__
    )
    path = Path(path)
    require(path.is_file(), "path", "load_robot", "a robot file that exists", path)
    content = path.read_bytes()
    try:
        text = content.decode("utf-8-sig").replace("\r\n", "\n")
    except UnicodeDecodeError as error:
        raise bad_input("file", path.name, "text in UTF-8", error) from error
    robot = _robot(_Document(path.name, text), path.parent, hashlib.sha256(content).hexdigest())
    return robot if calibration is None else load_calibration(calibration, robot).robot


def _robot(document: _Document, folder: Path, sha256: str) -> Robot:
    parts = ("segments", "magnets", "sensors", "imus")
    anything = _Key("", lambda _: True, {})
    top = document.read(
        {
            "earth_mt": _vector("the base", "mT", 1.0, 0.1),
            "base_orientation": _quaternion("from the frame of the base to the world of the IMUs"),
            **dict.fromkeys((*parts, "stream", "model"), anything),
        }
    )
    segments, limits = [], []
    for k in range(len(document.tables("segments"))):
        segment, own = _segment(document, k)
        segments.append(segment)
        limits += own
    if not segments:
        raise document.error(("segments",), "given: at least one table [[segments]]", "nothing")
    n = {name: len(document.tables(name)) for name in parts}
    unit = document.content.get("stream", {}).get("unit", "mT") if n["sensors"] else "mT"
    noise = f"noise_{str(unit).lower()}"
    keys = {"format": _word(*_FORMATS, default="csv"), "rate_hz": _number(1e-3, 1e5, "Hz", None)}
    keys |= {"noise_deg": _number(1e-3, 30.0, "deg", math.radians(0.2))} if n["imus"] else {}
    if n["sensors"]:
        keys |= {
            "unit": _word(*_PER_MT, "mV", "raw", default="mT"),
            noise: _number(1e-9, 1e6, str(unit), None),
        }
        keys |= {"channels": _count(1, 255, 0)}
    stream = document.read(keys, "stream")
    networks = _networks(document, folder)
    lengths = [segment.length for segment in segments]
    magnets = [_magnet(document, k, lengths) for k in range(n["magnets"])]
    sensors = [
        _sensor(document, k, lengths, unit, stream[noise], bool(networks)) for k in range(n["sensors"])
    ]
    _check_channels(document, sensors, stream)
    imus = [
        _imu(document, k, lengths, top["base_orientation"], stream["noise_deg"]) for k in range(n["imus"])
    ]
    lower, upper, start = (
        (np.array(x, dtype=float) for x in zip(*limits, strict=True)) if limits else [None] * 3
    )
    if start is not None and lower is not None and upper is not None:
        middle = np.nan_to_num((lower + upper) / 2)
        start = None if np.isnan(start).all() else np.where(np.isnan(start), middle, start)
    std = stream.get(noise)
    std = std if std is None or unit not in _PER_MT or networks else std / _PER_MT[unit]
    with document.at("segments"):
        robot = Robot(
            segments, magnets, sensors, imus, lower=lower, upper=upper, start=start, noise=std,
            rate_hz=stream["rate_hz"],
            earth=top["earth_mt"], model=networks or None, source=Source(document.name, sha256, stream),
        )  # fmt: skip
    if sensors:
        with document.at("sensors", 0):
            robot.sensing()
    _check_clear(document, robot)
    return robot


def _segment(document: _Document, k: int) -> tuple[Segment, list[tuple[float, float, float]]]:
    """Return a segment, and lower bound, upper bound and start of its coordinates, NaN where not stated.

    Without bounds a segment bends by up to 90 degrees (an affine one by its ``kappa_0`` up to that, by its
    ``kappa_1`` up to twice that) and stretches by up to 10 %.
    """
    place = ("segments", k)
    merged = {kind: {**sizes, **limits} for kind, (sizes, limits) in _SEGMENTS.items()}
    row = document.read_kind(merged, {"start": _TABLE}, *place)
    kind, length, pi = row["kind"], row.get("length_mm", 0.0), math.pi
    limits = _SEGMENTS[kind][1]
    usual = {"kappa_0_rad": pi / 2, "kappa_1_rad": pi, "delta_L_mm": 0.1 * length}
    segment: Segment
    if kind == "constant_curvature":
        segment = ConstantCurvature(length, row["radius_mm"])
        usual |= dict.fromkeys(("delta_x_mm", "delta_y_mm"), pi / 2 * segment.radius)
    elif kind == "affine_curvature":
        segment = AffineCurvature(length)
    elif kind == "ball_joint":  # the axes that are named, or all
        named = [name for name in limits if row[name] is not None] or list(limits)
        limits = {name: limits[name] for name in named}
        segment = BallJoint("".join(name[1] for name in named))
    else:
        segment = Link(length) if kind == "link" else FreeBody()
    ends = {
        name: _Key(f"a number [{key.unit}]", _is_number, math.nan, key.unit) for name, key in limits.items()
    }
    starts, found = document.read(ends, *place, "start"), []
    for name in limits:
        given = row[name]
        low, high = given if isinstance(given, list) else (given, given)
        if given is None:
            low, high = -usual.get(name, math.nan), usual.get(name, math.nan)
        if name == "delta_L_mm" and not low > -length:
            raise document.error(
                (*place, name), f"above {-1e3 * length:g}: a segment is longer than 0 [mm]", given
            )
        at = starts[name]
        if low < high and not (math.isnan(at) or low <= at <= high):
            raise document.error(
                (*place, "start"), f"within the bounds of {name}", document.tables("segments")[k]
            )
        found.append((low, high, at))
    return segment, found


def _place(
    document: _Document, name: str, k: int, row: Mapping[str, Any], lengths: Sequence[float]
) -> dict[str, Any]:
    """Return the segment, the place along it and the tolerance of a part; refuse a place that is not there."""
    segment, at = row["segment"], row["at_mm"]
    if segment > len(lengths):
        expected = f"from 0, the base, to {len(lengths)}, the number of segments"
        raise document.error((name, k, "segment"), expected, segment)
    reach = lengths[segment - 1] if segment else 0.0
    if at > reach * (1 + 1e-12):
        line = document.line("segments", segment - 1, "length_mm")
        what = f"the length of segment {segment} (line {line})" if segment else "as for all on the base"
        raise document.error((name, k, "at_mm"), f"at most {1e3 * reach:g}, {what} [mm]", 1e3 * at)
    if reach and "at_mm" not in document.tables(name)[k]:
        raise document.error((name, k, "at_mm"), f"given on segment {segment}", "nothing")
    known = _TOLERANCES[name]
    given = document.read({key: own for key, (_, own) in known.items()}, name, k, "tolerance")
    tolerance: dict[str, float] = {}
    for key, value in given.items():
        if value is not None:
            tolerance[known[key][0]] = max(value, tolerance.get(known[key][0], 0.0))
    return {"segment": segment, "at": at, "tolerance": tolerance or None}


def _magnet(document: _Document, k: int, lengths: Sequence[float]) -> Magnet:
    table = document.tables("magnets")[k]
    if table.get("kind") == "cube" and "side_mm" in table:
        document.apart(("magnets", k), ("side_mm", "edge_mm"))
        table["edge_mm"] = table.pop("side_mm")
        document.lines["magnets", k, "edge_mm"] = document.line("magnets", k, "side_mm")
    others = {**_PLACE, "position_mm": _POSITION, "direction": _DIRECTION, "tolerance": _TABLE}
    row = document.read_kind(_MAGNETS, others, "magnets", k)
    sizes = [row[name] for name in _MAGNETS[row["kind"]]]
    where = _place(document, "magnets", k, row, lengths)
    with document.at("magnets", k):
        shape = {"ring": Ring, "disc": Disc, "cube": Cube}[row["kind"]](*sizes)
        return Magnet(shape, **where, direction=row["direction"], position=row["position_mm"])


def _sensor(
    document: _Document, k: int, lengths: Sequence[float], unit: str, noise: float | None, network: bool
) -> Sensor:
    """Return a sensor; what its file says in the unit of the readings is in mT then."""
    table, place = document.tables("sensors")[k], ("sensors", k)
    axes, low = 3 if table.get("axes") == 3 else 1, unit.lower()
    own = unit not in _PER_MT and not network
    gain = f"gain_{low}_per_mt" if own else "gain"
    keys = {
        **_PLACE,
        "name": _TEXT,
        "axes": _Key("1 or 3", lambda x: x in (1, 3) and _is_number(x), 1),
        "channel": _Key("a column: its name, or a number from 1 to 255", _is_channel, None),
        "channels": _channels(axes),
        "radial_mm": _number(0.1, 500.0, "mm", 0.0),
        "azimuth_deg": _number(0.0, 360.0, "deg", 0.0, signed=True),
        "position_mm": _POSITION,
        "tilt_deg": _number(0.0, 180.0, "deg", 0.0, signed=True),
        "direction": _DIRECTION,
        "orientation": _quaternion("from the frame of the chip to that of the cross-section"),
        "rotation_vector_rad": _vector("the cross-section", "rad", 2 * math.pi),
        "range_mt": _number(1e-3, 1e4, "mT", math.inf),
        "resolution_mt": _number(0.0, 100.0, "mT", 0.0),
        f"noise_{low}": _number(1e-9, 1e6, unit, None, n=axes),
        f"offset_{low}": _number(0.0, 1e9, unit, 0.0, signed=True, n=axes),
        gain: _number(1e-3, 1e9, f"{unit}/mT", _NEEDED if own else 1.0, signed=True, n=1 if own else axes),
        "tolerance": _TABLE,
    }
    if network:
        del keys[gain]
    row = document.read(keys, *place)
    pairs = (("channel", "channels"), ("tilt_deg", "direction"), ("orientation", "rotation_vector_rad"))
    document.apart(place, *pairs, ("radial_mm", "position_mm"), ("azimuth_deg", "position_mm"))
    for name in ("channel", "tilt_deg", "direction") if axes == 3 else ("orientation", "rotation_vector_rad"):
        if name in table:
            raise document.error(
                (*place, name), f"left out for a sensor with axes = {axes}", repr(table[name])
            )
    if "direction" in table and "azimuth_deg" in table and not row["radial_mm"]:
        line = document.line(*place, "direction")
        expected = f"left out on the backbone: direction (line {line}) does not turn with it"
        raise document.error((*place, "azimuth_deg"), expected, table["azimuth_deg"])
    per_mt = row[gain] if own else 1.0 if network else _PER_MT[unit]
    own_noise = row[f"noise_{low}"] is not None
    std = row[f"noise_{low}"] if own_noise else noise
    std = None if std is None else np.divide(std, abs(per_mt)).tolist()
    if (
        not network
        and std is not None
        and (own_noise or k == 0)
        and (np.min(std) < 1e-5 or np.max(std) > 0.5)
    ):
        at = (*place, f"noise_{low}") if own_noise else ("stream", f"noise_{low}")
        document.warn(at, f"a noise of {np.max(std):g} mT is doubtful")
    turn = row["rotation_vector_rad"]
    if turn is not None:
        from scipy.spatial.transform import Rotation

        row["orientation"] = Rotation.from_rotvec(turn).as_quat()
    with document.at(*place):
        return Sensor(
            **_place(document, "sensors", k, row, lengths), radial=row["radial_mm"], azimuth=row["azimuth_deg"],
            tilt=row["tilt_deg"], position=row["position_mm"], direction=row["direction"], axes=axes,
            orientation=row["orientation"], name=row["name"], range=row["range_mt"], per_mt=per_mt,
            noise=std if own or own_noise else None,  # else that of the robot, which can be replaced
            channels=row["channels"] or (None if row["channel"] is None else [row["channel"]]),
            resolution=row["resolution_mt"], gain=1.0 if own or network else row[gain],
            offset=np.divide(row[f"offset_{low}"], per_mt).tolist(),
        )  # fmt: skip


def _check_channels(document: _Document, sensors: Sequence[Sensor], stream: Mapping[str, Any]) -> None:
    """Refuse two readings on one channel, and numbers of channels that the stream does not have."""
    first: dict[Any, int] = {}
    for k, sensor in enumerate(sensors):
        key = ("sensors", k, "channels" if "channels" in document.tables("sensors")[k] else "channel")
        for channel in sensor.channels or ():
            if channel in first:
                line = document.line("sensors", first[channel], key[2])
                expected = f"another channel than that of sensor {first[channel] + 1} (line {line})"
                raise document.error(key, expected, channel)
            if isinstance(channel, int) and stream["channels"] and channel > stream["channels"]:
                line = document.line("stream", "channels")
                raise document.error(key, f"at most {stream['channels']} (line {line})", channel)
            first[channel] = k


def _imu(document: _Document, k: int, lengths: Sequence[float], world: Any, noise: float) -> Imu:
    mounted = _quaternion("from the frame of the IMU to that of the cross-section")
    keys = {
        **_PLACE,
        "name": _TEXT,
        "stream": _count(0, 255, None),
        "channels": _channels(4),
        "mounted": mounted,
        "orientation": mounted,
        "heading": _word("absolute", "free", default="absolute"),
        "noise_deg": _number(1e-3, 30.0, "deg", noise),
        "tolerance": _TABLE,
    }
    row = document.read(keys, "imus", k)
    document.apart(("imus", k), ("mounted", "orientation"), ("stream", "channels"))
    where = _place(document, "imus", k, row, lengths)
    if row["heading"] == "free":
        where["tolerance"] = {**(where["tolerance"] or {}), "heading": math.pi}
    with document.at("imus", k):
        return Imu(
            **where, orientation=row["mounted"] or row["orientation"], name=row["name"], world=world,
            channels=row["channels"] or row["stream"], noise=row["noise_deg"],
        )  # fmt: skip


def _networks(document: _Document, folder: Path) -> list[Any]:
    """Return the networks of ``[model]``: safetensors in the folder of the file, which hold numbers only."""
    if "model" not in document.content:
        return []

    def fits(x: Any) -> bool:
        return isinstance(x, list) and bool(x) and all(isinstance(name, str) for name in x)

    words = _word("angles", "cosines", default="angles")
    model = document.read({"networks": _Key("a list of files", fits), "inputs": words}, "model")
    place = ("model", "networks")
    for name in model["networks"]:
        inside = (folder / name).resolve().is_relative_to(folder.resolve())
        if not name.endswith(".safetensors"):
            expected = (
                "safetensors files: TorchScript is a program, which a file cannot start; load it in Python"
            )
            raise document.error(place, expected, name)
        if not inside:
            raise document.error(place, "files in the folder of the robot file", name)
        if not (folder / name).is_file():
            raise document.error(place, "files that exist", name)
    with document.at(*place):
        return [load_network(folder / name) for name in model["networks"]]


def _check_clear(document: _Document, robot: Robot) -> None:
    """Refuse a sensor within the sphere around a magnet, where the series of its field has no meaning."""
    if any(isinstance(segment, FreeBody) for segment in robot.segments) or robot.model is not None:
        return
    middle = np.zeros(0) if robot.lower is None or robot.upper is None else (robot.lower + robot.upper) / 2
    places = [part.place for part in (*robot.magnets, *robot.sensors)]
    p = robot.poses(middle if robot.start is None else robot.start, places)[:, :3, 3]
    for k, magnet in enumerate(robot.magnets):
        shape = magnet.shape
        wide = (
            shape.edge if isinstance(shape, Cube) else getattr(shape, "diameter", 0.0) or shape.outer_diameter
        )
        radius = (
            math.hypot(wide, wide, wide) / 2
            if isinstance(shape, Cube)
            else math.hypot(wide, shape.height) / 2
        )
        distances = np.linalg.norm(p[len(robot.magnets) :] - p[k], axis=1)
        for j in np.flatnonzero(distances <= radius):
            expected = f"farther than {1e3 * radius:.1f} mm from the centre of magnet {k + 1}"
            raise document.error(
                ("sensors", int(j), "at_mm"), expected, f"{1e3 * distances[j]:.1f} mm from it"
            )


_SCHEMA = 3
_KEPT = ("names", "estimate", "tolerances", "covariance", "chi2", "poses", "before", "after")
"""What a calibration consists of beside the robot as described."""


def save_calibration(path: str | Path, found: Calibration) -> None:
    """Write what :func:`repro.calibrate` found, as JSON that :func:`load_calibration` reads for the same robot file.

    Parameters
    ----------
    path
        The file to write, whole or not at all.
    found
        The calibration of a robot that :func:`repro.load_robot` has read.

    Raises
    ------
    InputError
        If the robot does not come from a file.
    """
    source = found.described.source
    expected = "a calibration of a robot that load_robot has read"
    require(isinstance(source, Source), "found", "save_calibration", expected, "one of another robot")
    content = {"schema": _SCHEMA, "robot": source.name, "robot_sha256": source.sha256}
    content |= {name: np.asarray(getattr(found, name)).tolist() for name in _KEPT}
    content["sha256"] = _own_hash(content)
    partial = Path(path).with_name(Path(path).name + ".part")
    partial.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    partial.replace(path)


def _own_hash(content: Mapping[str, Any]) -> str:
    rest = {name: value for name, value in content.items() if name != "sha256"}
    return hashlib.sha256(json.dumps(rest, sort_keys=True).encode()).hexdigest()


def load_calibration(path: str | Path, robot: Robot) -> Calibration:
    """Read what a calibration found for a robot file.

    Parameters
    ----------
    path
        What :func:`save_calibration` wrote, or a calibration of edition 1 (schema 2).
    robot
        From the robot file that was calibrated.

    Raises
    ------
    InputError
        If the file is no calibration, was changed, belongs to another robot, or holds values that cannot be.
    """
    path, source = Path(path), robot.source
    owner = path.name
    require(path.is_file(), "calibration", "load_calibration", "a file that exists", path)
    try:
        content: Any = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        raise bad_input("file", owner, "JSON that a calibration wrote", error) from error
    schema = content.get("schema") if isinstance(content, dict) else type(content).__name__
    require(schema in (2, _SCHEMA), "schema", owner, f"2 or {_SCHEMA}", repr(schema))
    if schema == _SCHEMA:
        same = content.get("sha256") == _own_hash(content)
        require(same, "sha256", owner, "the hash of what the file holds", "another: the file was changed")
    if source is None or content.get("robot_sha256") != source.sha256:
        expected = f"made with {source.name if source else 'a robot file'} as it is now"
        raise bad_input("robot_sha256", owner, expected, f"one made with {content.get('robot')!r}")
    if schema == 2:
        content = _from_edition_1(content, robot, owner)
    names: Any = content.get("names")
    words = isinstance(names, list) and all(isinstance(name, str) for name in names)
    require(words, "names", owner, "those of the parameters", names)
    n = len(names)
    estimate, tolerances = (_array(content, owner, name, (n,), 1e3) for name in ("estimate", "tolerances"))
    C = _array(content, owner, "covariance", (n, n), 1.0 + 1e-6)
    for name, value in zip(names, estimate, strict=True):
        last = name.rpartition(" ")[2]
        relative = "moment" in name or name.endswith(("gain", "radius", "polarisation")) or " gain " in name
        angle = "tilt" in name or last == "azimuth"
        most = (
            0.9
            if relative
            else math.pi
            if angle
            else 1.0
            if "Earth" in name
            else 100.0
            if "offset" in name
            else 0.1
        )
        require(abs(value) <= most, name, owner, f"within {most:g} of zero", f"{value:g}")
    variance = np.diag(C)
    std = np.sqrt(np.maximum(variance, 1e-300))
    values = np.linalg.eigvalsh((C + C.T) / 2 / std / std[:, None])
    good = (
        np.allclose(C, C.T)
        and (variance >= 0).all()
        and (values > -1e-9 * n).all()
        and (tolerances >= 0).all()
    )
    require(good, "covariance", owner, "that of random numbers", "another matrix, or a negative variance")
    rest = {name: content.get(name, math.nan) for name in ("chi2", "poses", "before", "after")}
    moved = placed(robot, dict(zip(names, estimate.tolist(), strict=True)))
    return Calibration(
        moved, robot, tuple(names), estimate, np.sqrt(variance) * tolerances, tolerances, C, **rest
    )


def _array(content: Mapping[str, Any], owner: str, name: str, shape: tuple[int, ...], most: float) -> Array:
    """Return an array of a file; refuse what is none, and numbers that cannot be."""
    try:
        found = np.array(content[name], dtype=float)
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise bad_input(name, owner, "numbers", repr(content.get(name, "nothing"))) from error
    require(found.shape == shape, name, owner, f"of shape {shape}", found.shape)
    wrong = ~(np.abs(found) <= most)
    require(not wrong.any(), name, owner, f"finite and within {most:g} of zero", found[wrong][:1].tolist())
    return found


def _from_edition_1(content: Mapping[str, Any], robot: Robot, owner: str) -> dict[str, Any]:
    """Return a calibration of schema 2 in the terms of today: offsets in mT, the Earth's field against the file."""
    n, m = len(robot.sensors), len(robot.magnets)
    given: Any = content.get("names")
    axes = ("x", "y", "z")
    expected = [f"magnet {k + 1} {x}" for k in range(m) for x in (*axes, "tilt about x", "tilt about y")]
    expected += [f"sensor {j + 1} {x}" for j in range(n) for x in ("azimuth", "radius", "tilt", "gain")]
    expected += [f"moment A{2 * i + 1}" for i in range(robot.sensing().moments.shape[1])]
    k, last = len(expected), [*(f"offset {j + 1}" for j in range(n)), "Bx", "By", "Bz"]
    require(given == [*expected, *last], "names", owner, "those of this robot's parameters", given)
    per_mt = robot.per_reading("per_mt", 1.0, 1.0)
    scale = np.concatenate([np.ones(k), 1 / per_mt, np.ones(3)])
    earth = np.zeros(3) if robot.earth is None else robot.earth
    parts = (("parameters", (k,)), ("offset", (n,)), ("earth_mt", (3,)))
    estimate = np.concatenate([_array(content, owner, name, shape, 1e9) for name, shape in parts]) * scale
    estimate[-3:] -= earth
    C = _array(content, owner, "covariance", (len(scale),) * 2, 100.0) * scale * scale[:, None]
    std = np.sqrt(np.maximum(np.diag(C), 1e-300))
    names = [
        *expected,
        *(f"sensor {j + 1} offset" for j in range(n)),
        *(f"Earth field along {x}" for x in axes),
    ]
    rest = {"tolerances": std.tolist(), "covariance": (C / std / std[:, None]).tolist()}
    return {**content, "names": names, "estimate": estimate.tolist(), **rest}
