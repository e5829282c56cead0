"""Recordings of Mitchell et al. 2021: readings and motion capture on one clock, nominal bends, light bulbs."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import timedelta, timezone
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from repro.common import bad_input, require
from repro.motion_files import Motion as MotionCapture
from repro.motion_files import read_motion, undo_exchanges
from repro_board.lag import search_lag
from repro_companion import show
from repro_companion.papers.fetch import listed_files, states
from repro_companion.run import recordings_folder
from repro_companion.show import sentences

FOLDER = "mitchell2021"
MT_PER_UNIT, LARGEST_UNIT = 10.0, 8.192
"""Unit of the files: 1000 steps of 0.01 mT; the components have 14 bits with sign."""
MODEL_FROM_FILE = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])
"""In the files x is along the body; the magnet points the other way, and y is mirrored."""
ZONE = timezone(timedelta(hours=-5))
"""Of the start times of the motion capture."""
REST_S, LIVE_S, LONGEST_BUFFER = 2.0, 1e-3, 25
BODY, PAD_S, LEAST_LOGGED = "Module", 5.0, 0.9


# Files of the sensor and of motion capture


class Hall(NamedTuple):
    """Readings of the Hall sensor, and what was left out of them."""

    time_s: np.ndarray
    """Since 1970."""
    u: np.ndarray
    """Flux density ``[t, 3]`` [mT] in the axes of the model, as sent."""
    facts: dict[str, int]

    @property
    def ratio(self) -> np.ndarray:
        """Fields across over along the body."""
        return ratio(self.u)


def ratio(u: np.ndarray) -> np.ndarray:
    """Return the fields across over the field along the body, x and y as one complex number."""
    return (u[..., 0] + 1j * u[..., 1]) / u[..., 2]


def median(z: np.ndarray) -> complex:
    """Return the median of complex numbers, real and imaginary parts apart."""
    return complex(np.median(z.real), np.median(z.imag))


def readable(rows: Sequence[Sequence[str]], columns: int) -> np.ndarray:
    """Return the rows in which every cell is a finite number."""
    cells = pd.DataFrame(rows, columns=range(columns), dtype=object)
    table = cells.apply(pd.to_numeric, errors="coerce").to_numpy(float)
    return table[np.isfinite(table).all(axis=1)]


def read_hall(path: Path) -> Hall:
    """Read a file of the Hall sensor, rows ``[x y z],unix_time``; what a buffer held at the start is dropped."""
    lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    cells = [re.split(r"[\[\],\s]+", line.strip()) for line in lines]
    table = readable([row[1:] for row in cells if len(row) == 5], 4)
    steps, n = np.diff(table[:, 3]), len(lines)
    live = np.flatnonzero(steps > LIVE_S)
    require(
        len(live), "rows", path.name, "readings, two of them a millisecond apart", f"{len(table)} readings"
    )
    require((steps > 0).all(), "times", path.name, "increasing", "a step back")
    drained, unreadable = int(live[0]) + 1, n - len(table)
    table = table[drained:]
    outside = (np.abs(table[:, :3]) > LARGEST_UNIT).any(axis=1)
    u = MT_PER_UNIT * table[~outside, :3] @ MODEL_FROM_FILE.T
    for what, count, allowed in (("unreadable or beyond the range", unreadable + int(outside.sum()), 0),
                                 ("out of a buffer", drained, LONGEST_BUFFER)):  # fmt: skip
        require(count <= max(n / 20, allowed), "rows", path.name, f"at most 5 % {what}", f"{count} of {n}")
    # The sensor switches its own gain, so that all components jump by one factor.
    switches = int((np.abs(np.diff(np.log(np.linalg.norm(u, axis=1)))) > 0.1).sum())
    facts = {
        "buffered": drained,
        "unreadable": unreadable,
        "beyond_range": int(outside.sum()),
        "gain_switches": switches,
    }
    return Hall(table[~outside, 3], u, facts)


class Motion(NamedTuple):
    """Motion of the module by motion capture, and what was done about exchanged markers."""

    start_s: float
    """Since 1970."""
    rate_hz: float
    q: np.ndarray
    """Bend vector [rad] as a complex number, by the tilt of the y axis, which is up; NaN where masked."""
    tilt_z: np.ndarray
    facts: dict[str, float]


SHAKE, GUARD = np.radians(2.0), 6
"""Turn from one frame to the next that a bending module does not make [rad]; frames masked on either side of it."""


def motion(take: MotionCapture) -> Motion:
    """Return the bend of the module from motion capture."""
    require(BODY in take.bodies, "body", take.name, BODY, ", ".join(take.bodies))
    if take.started is None:
        raise bad_input("Capture Start Time", take.name, "in the header", "nothing")
    poses, n = take.bodies[BODY], len(take.times) + take.missing
    turned, undone = undo_exchanges(poses[:, :4])
    jumps = 2 * np.arccos(np.minimum(np.abs((turned[1:] * turned[:-1]).sum(axis=1)), 1.0)) > SHAKE
    turned[np.convolve(np.r_[False, jumps], np.ones(2 * GUARD))[GUARD : GUARD + len(turned)] > 0] = np.nan
    seen = np.isfinite(turned[:, 0])
    axes = np.full((len(turned), 3, 3), np.nan)
    axes[seen] = Rotation.from_quat(turned[seen]).as_matrix()
    upright = np.degrees(np.arccos(axes[seen][0, 1, 1]))
    require(upright < 45, "first frame", take.name, "upright within 45 deg", f"{upright:.1f} deg")
    tilt, tilt_z = np.arccos(np.clip(axes[:, [1, 2], [1, 2]], -1.0, 1.0)).T
    q, high = tilt * np.exp(1j * np.arctan2(axes[:, 0, 1], axes[:, 2, 1])), tilt > np.radians(40)
    # The place of the body hardly depends on which marker is which: it says whether the tilt is right.
    moved = np.linalg.norm(poses[seen][:, [4, 6]] - poses[seen][0, [4, 6]], axis=1)
    powers, degrees = (moved / max(moved.max(), 1e-9))[:, None] ** np.arange(1, 6), np.degrees(tilt[seen])
    off = degrees - powers @ np.linalg.lstsq(powers, degrees)[0]
    facts = {
        "frames": n,
        "undone": int(undone.sum()),
        "undone_above_40_percent": 100 * float(undone[high].mean()) if high.any() else 0.0,
        "masked_percent": 100 * (1 - seen.sum() / n),
        "off_displacement_deg": float(np.sqrt((off**2).mean())),
    }
    return Motion(take.started.replace(tzinfo=ZONE).timestamp(), take.rate_hz, q, tilt_z, facts)


# One take: both, on one clock


@dataclass(frozen=True, eq=False)
class Take:
    """A bend test on the clock of the Hall sensor, where motion capture runs."""

    name: str
    time_s: np.ndarray
    u: np.ndarray
    """Readings ``[t, 3]`` [mT] in the axes of the model, as sent."""
    ratio: np.ndarray
    """Field across over field along the body, less its median over the first two seconds."""
    rest_mt: np.ndarray
    """Mean of the first hundred readings, which the released code subtracts across the body."""
    q: np.ndarray
    """Bend vector [rad] by motion capture, complex; NaN where masked."""
    tilt_z: np.ndarray
    log: np.ndarray | None
    """Output of the authors' filter, complex bend vectors [rad]; NaN where it has none."""
    facts: dict[str, float]

    @property
    def test(self) -> str:
        """Number of the test: one direction each."""
        return self.name[5]


def aligned(name: str, hall: Hall, motion: Motion, log: pd.DataFrame | None = None) -> Take:
    """Bring motion capture onto the clock of the Hall sensor: there is no common trigger, so we search the lag."""
    start, rate, n = hall.time_s[0], motion.rate_hz, len(motion.q)
    t = hall.time_s - start
    relative = hall.ratio - median(hall.ratio[t < REST_S])
    pad = round(PAD_S * rate)
    at = motion.start_s - start + np.arange(-pad, n + pad) / rate
    k = np.searchsorted((t[1:] + t[:-1]) / 2, at)
    read = np.where(np.abs(t[k] - at) < 1.5 * np.median(np.diff(t)), relative[k], np.nan)
    pairs = [np.column_stack([x.real, x.imag]) for x in (np.pad(motion.q, pad, constant_values=np.nan), read)]
    lag = search_lag(*pairs, rate)
    frame = np.rint((t - lag.lag_s - motion.start_s + start) * rate).astype(int)
    own = (frame >= 0) & (frame < n)
    frame = frame[own]
    longest = float(np.diff(t[own]).max())
    facts = {"readings": int(own.sum()), **hall.facts, **motion.facts, "lag_s": lag.lag_s,
             "lag_residual": lag.best / lag.spread, "longest_gap_s": longest}  # fmt: skip
    logged = None if log is None else on_readings(log, t)[own]
    if logged is not None and np.isfinite(logged).mean() < LEAST_LOGGED:
        logged = None
    return Take(name, t[own], hall.u[own], relative[own], hall.u[:100].mean(axis=0), motion.q[frame],
                motion.tilt_z[frame], logged, facts)  # fmt: skip


def on_readings(log: pd.DataFrame, t: np.ndarray) -> np.ndarray:
    """Return the authors' output at the times of the readings, by its own clock; NaN where it has no row."""
    own = log["time"].to_numpy()
    sample = own[np.linspace(0, len(own) - 1, 200).astype(int)]
    offsets = t - own[len(own) // 2]

    def nearest(x: np.ndarray, of: np.ndarray) -> np.ndarray:
        return np.searchsorted((of[1:] + of[:-1]) / 2, x)

    at = sample + offsets[:, None]
    offset = offsets[(np.abs(t[nearest(at, t)] - at) < LIVE_S).sum(axis=1).argmax()]
    k = nearest(t - offset, own)
    q = log["bend_ang"].to_numpy() * np.exp(
        1j * (np.pi - log["bend_dir"].to_numpy())
    )  # their y is not mirrored
    return np.where(np.abs(own[k] + offset - t) < LIVE_S, q[k], np.nan)


def recorded_takes() -> list[Take]:
    """Return the bend tests of which both recordings are in REPRO_DATA_DIR."""
    folder, found = recordings_folder() / FOLDER, []
    for name in (f"{test}_try_{attempt}" for test in range(6) for attempt in (1, 2)):
        hall, capture = folder / f"experiment_data/bend_test_{name}.csv", folder / f"mocap/bend_{name}.csv"
        log = folder / f"filter_readings/bend_{name}.csv"
        if hall.is_file() and capture.is_file():
            logged = pd.read_csv(log) if log.is_file() else None
            found.append(aligned(f"bend_{name}", read_hall(hall), motion(read_motion(capture)), logged))
    return found


KINDS_OF_FILES = {
    "experiment_data": "of the Hall sensor in the experiments",
    "mocap": "of motion capture",
    "filter_readings": "of the authors' filter",
    "calibrate_data": "at nominal bends",
}
FILES = """
{% if not found %}
We may not pass the recordings on, so this page was built without them. Its numbers are from a run with the files
that we had, 9 of the 12 takes and two of three repetitions at nominal bends. The first command brings all
{{ listed }} files ({{ megabytes | fixed(0) }} MB). Then the page draws Figs 8 and 9 over time, and
computes every number from your copy.
{% elif missing %}
Not found: {{ missing | join(", ") }}. {{ checked }} What needs the missing ones stands here as an earlier run found
it, or not at all. These commands bring them:
{% else %}
All {{ listed }} released files are here. {{ checked }}
{% endif %}
"""
COMMAND = "\n\n```bash\n.venv/bin/repro fetch mitchell2021\nmake page P=bend_tests\n```\n"


def files_in_words() -> str:
    """Return which of the released recordings are in REPRO_DATA_DIR, and which are not those, by their hashes."""
    found, listed, missing = states(FOLDER), listed_files(FOLDER), []
    for kind, words in KINDS_OF_FILES.items():
        own = [state for path, state in found.items() if path.startswith(f"{kind}/")]
        missing += [f"{own.count('missing')} of {len(own)} files {words}"] if "missing" in own else []
    other = [path for path, state in found.items() if state == "another"]
    named = f"**Not the released files: {', '.join(other[:5])}{' and others' * (len(other) > 5)}.**"
    checked = named if other else "What was found has its published checksums."
    megabytes = 1e-6 * sum(one.size or 0 for one in listed)
    told = {"missing": missing, "checked": checked, "listed": len(listed), "megabytes": megabytes}
    return sentences(FILES, found=set(found.values()) != {"missing"}, **told) + COMMAND * bool(missing)


def of_recordings(name: str, computed: pd.DataFrame | None) -> pd.DataFrame:
    """Return a table computed from recordings, or without them what the committed study of this name found."""
    return show.study(name) if computed is None else computed


# A module at nominal bends: calibrate_data

DIRECTIONS_DEG = {"0dir": 0.0, "pi2dir": 90.0, "pidir": 180.0, "3pi2dir": 270.0}
"""Folders of calibrate_data, and the nominal direction of the bend in each."""
SPIKE_UNITS = 1.0
"""A row this far from its file's median is no bend: at rest the whole field is 2 units."""
SUSPECT = ("0dir", 90)
"""Files that read less than those of 40 deg in their direction, in both repetitions that we have."""


class NominalBends(NamedTuple):
    """What the sensor read of a module at nominal bends, one value for each file."""

    files: pd.DataFrame
    """Direction, nominal bend, repetition, and what was counted."""
    q: np.ndarray
    """Nominal bend vectors [rad], complex."""
    ratio: np.ndarray
    """Field across over field along the body, less the ratio at rest: medians."""
    across_mt: np.ndarray
    """Field across the body, less the field at rest [mT], complex: medians."""
    rest: complex
    """The ratio at rest."""

    def of(self, chosen: np.ndarray) -> NominalBends:
        """Return some of the files."""
        return NominalBends(*(x[chosen] for x in self[:4]), self.rest)

    @property
    def suspect(self) -> np.ndarray:
        """Which files are those of SUSPECT."""
        return ((self.files["direction"] == SUSPECT[0]) & (self.files["bend_deg"] == SUSPECT[1])).to_numpy()


def read_nominal(path: Path) -> tuple[np.ndarray, dict[str, int]]:
    """Read a file of calibrate_data, rows ``x,y,z`` without times; return readings [mT] and what was dropped."""
    lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    table = readable([row for line in lines if len(row := line.split(",")) == 3], 3)
    owner, unreadable = f"calibrate_data/{path.parent.name}/{path.name}", len(lines) - len(table)
    require(len(table) and unreadable <= len(lines) / 20, "rows", owner,
            "x,y,z and at most 5 % unreadable", f"{unreadable} of {len(lines)} unreadable")  # fmt: skip
    middle = np.median(table, axis=0)
    require(0.5 < np.linalg.norm(middle) < LARGEST_UNIT, "median field", owner,
            f"between 0.5 and {LARGEST_UNIT:g} units of 10 mT", f"{np.linalg.norm(middle):g}")  # fmt: skip
    spikes = (np.abs(table - middle) > SPIKE_UNITS).any(axis=1)
    require(spikes.sum() <= len(lines) / 20, "rows", owner, f"within {SPIKE_UNITS:g} unit of the median but 5 %",
            f"{spikes.sum()} of {len(lines)} elsewhere")  # fmt: skip
    facts = {"rows": len(lines), "unreadable": unreadable, "spikes": int(spikes.sum())}
    return MT_PER_UNIT * table[~spikes] @ MODEL_FROM_FILE.T, facts


def nominal_bends() -> NominalBends | None:
    """Return the files of calibrate_data in REPRO_DATA_DIR; without a file at rest there are none."""
    folder, lines = recordings_folder() / FOLDER / "calibrate_data", []
    for path in sorted(folder.glob("*/*.csv")):
        name = re.fullmatch(r"(\d0?)deg_([1-3])", path.stem)
        if path.parent.name not in DIRECTIONS_DEG or name is None:
            must_be = f"DIRECTION/BENDdeg_REPETITION.csv, with one of {', '.join(DIRECTIONS_DEG)}"
            raise bad_input("file", "calibrate_data", must_be, f"{path.parent.name}/{path.name}")
        u, facts = read_nominal(path)
        line = {"direction": path.parent.name, "bend_deg": int(name[1]), "repetition": int(name[2]), **facts}
        lines.append(line | {"ratio": median(ratio(u)), "across_mt": median(u[:, 0] + 1j * u[:, 1])})
    files = pd.DataFrame(lines)
    if files.empty or (straight := files["bend_deg"] == 0).sum() == 0:
        return None
    ratios, across = (files.pop(name).to_numpy(complex) for name in ("ratio", "across_mt"))
    towards = np.radians(files["direction"].map(DIRECTIONS_DEG).to_numpy())
    q = np.radians(files["bend_deg"].to_numpy()) * np.exp(1j * towards)
    less = [x - x[straight].mean() for x in (ratios, across)]
    return NominalBends(files, q, *less, ratios[straight].mean()).of(~straight.to_numpy())


def side_by_side(readings: Sequence[np.ndarray]) -> np.ndarray:
    """Return readings ``[t, axes]`` of takes as one array ``[t, take, axes]``; after its end a take has none."""
    table = np.full((max(map(len, readings)), len(readings), readings[0].shape[1]), np.nan)
    for k, u in enumerate(readings):
        table[: len(u), k] = u
    return table


def calibrations(
    take: Take, takes: Sequence[Take], bends: NominalBends | None = None
) -> dict[str, list[Take | NominalBends]]:
    """Return what may calibrate a take, by name: other takes, and nominal bends; it is never among them."""
    same = [other for other in takes if other.test == take.test and other is not take]
    others = [other for other in takes if other.test != take.test]
    nominal = [] if bends is None else [bends.of(~bends.suspect)]
    found = {"other try": same, "other tests": others, "nominal bends": nominal}
    return {"none": []} | {name: some for name, some in found.items() if some}


# The light bulb, Fig. 8

QUIET_S = 10.0


def light_files() -> dict[str, Hall]:
    """Return the light-bulb files in REPRO_DATA_DIR, the trial run first; none unless all are there."""
    folder = recordings_folder() / FOLDER / "experiment_data"
    paths = {f"light_{k}": folder / f"light_test_{k}.csv" for k in (-1, 0, 1, 2)}
    return (
        {name: read_hall(path) for name, path in paths.items()}
        if all(map(Path.is_file, paths.values()))
        else {}
    )


def rest_of(hall: Hall) -> tuple[complex, float]:
    """Return the ratio at rest and its deviation, in the ten seconds in which it varies least."""
    t, x = hall.time_s - hall.time_s[0], hall.ratio
    require(t[-1] > 2 * QUIET_S, "recording", "rest_of", f"longer than {2 * QUIET_S:g} s", f"{t[-1]:.1f} s")
    parts = [x[(t >= a) & (t < a + QUIET_S)] for a in np.arange(0.0, t[-1] - QUIET_S, 0.5)]
    scatter = [(part.real.std() + part.imag.std()) / 2 for part in parts]
    return median(parts[int(np.argmin(scatter))]), float(min(scatter))


BULB = ["light_0", "light_1", "light_2"]
"""Files of the experiments; the trial run has the number -1."""
