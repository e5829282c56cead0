"""Martin et al. 2022: the tables that the authors released, the chains that give them, and the trial behind them."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation, Slerp

from repro import Arm, pcc_extended
from repro.common import bad_input, require
from repro_companion.papers.fetch import listed_files, states
from repro_companion.papers.martin import (
    HALF_TURN,
    ORIGIN,
    POSITIONS,
    UP,
    Trial,
    product,
    released_arm,
    shape,
)
from repro_companion.run import recordings_folder
from repro_companion.show import number, sentences, study

FOLDER = "martin2022"
TABLES = "data analysis/data"
RIGID_FILE, PCC_1, PCC_2 = "elephant/rigid/rigid.csv", "elephant/pcc/pcc1.csv", "elephant/pcc/pcc2.csv"
PCC_16_2 = "fly/pcc16/pcc16_2.csv"
NEEDED = (RIGID_FILE, PCC_1, PCC_2, PCC_16_2)
"""Tables that tell the orientations of the trial: the first two of IMUs #1 to #7, the others of #8."""
QUATERNIONS = "elephant/quat/2points_2022-02-22-11-40-35quat_meas.csv"
"""What the IMUs sent in that trial."""
CAPTURE = "elephant/mocap/mocap_base_and_2_points_1.csv"
"""Motion capture of that trial."""
SAME_M = 1e-6
"""Points closer than this count as the same."""
LATER = 6
"""Rows by which pcc1.csv is later than rigid.csv."""
LARGEST_SHIFT = 40
"""Rows by which one table may be later than another."""
LEAST_ROWS = 1000
"""Rows that a table of the trial has at least."""
CLOCK = "%Y/%m/%d/%H:%M:%S.%f"
"""Form of the times in the files."""


# What is here, and its form


def place_of(name: str) -> Path:
    """Return where a released file lies, here or not yet."""
    return recordings_folder() / FOLDER / TABLES / name


def absent() -> list[str]:
    """Return which listed files of the trial are not here."""
    names = (*released_chains(), QUATERNIONS, CAPTURE)
    return [name for name in names if not place_of(name).is_file()]


def unlike_released() -> list[str]:
    """Return which files that are here are not those that the authors released, by their hashes."""
    return [path for path, state in states(FOLDER).items() if state == "another"]


FILES_HERE = """
{% if missing %}
Of the authors' files these are missing: {{ missing | join(", ") }}.
{% else %}
All files are here.
{% endif %}
{% if unlike %}
Not the released files, by their hashes: {{ unlike | join(", ") }}.
{% else %}
Their hashes are the published ones.
{% endif %}
"""


def files_in_words() -> str:
    """Return which listed files are here, which are missing, and which are not the released ones."""
    missing, special = absent(), {CAPTURE: "the motion capture", QUATERNIONS: "the raw quaternions"}
    tables = len(released_chains())
    if len(missing) == tables + 2:
        megabytes = 1e-6 * sum(source.size or 0 for source in listed_files(FOLDER))
        return (
            f"They are {tables} tables of the models ({megabytes:.0f} MB), the motion capture and the raw quaternions"
            " (sizes not listed)."
        )
    own, unlike = (
        {name: f"`{name.rpartition('/')[2]}`" for name in names} for names in (missing, unlike_released())
    )
    return sentences(
        FILES_HERE, missing=[special.get(name, own[name]) for name in own], unlike=unlike.values()
    )


FETCH = "```bash\n.venv/bin/repro fetch martin2022\nmake page P=imu_markers\n```"


def clock_s(times: pd.Series, owner: str) -> np.ndarray:
    """Return the seconds since the first of the times in a file."""
    try:
        read = pd.to_datetime(times, format=CLOCK)
    except (ValueError, TypeError):
        raise bad_input("time", owner, "yyyy/mm/dd/HH:MM:SS.ffffff", repr(times.iloc[0])) from None
    return (read - read.iloc[0]).dt.total_seconds().to_numpy()


def read_csv(path: Path) -> pd.DataFrame:
    """Return a file with commas as it stands."""
    try:
        return pd.read_csv(path, low_memory=False, skipinitialspace=True)
    except (pd.errors.EmptyDataError, pd.errors.ParserError, UnicodeDecodeError) as error:
        raise bad_input("file", path.name, "rows of as many values, with commas", error) from None


def read_columns(path: Path, columns: list[str]) -> pd.DataFrame:
    """Return columns of a file as numbers, and its column ``time`` as it stands."""
    table = read_csv(path)
    lost = [name for name in ("time", *columns) if name not in table]
    require(
        not lost, "columns", path.name, f"time, {columns[0]} … {columns[-1]}", f"no {', '.join(lost[:4])}"
    )
    require(len(table) >= LEAST_ROWS, "rows", path.name, f"{LEAST_ROWS} or more", len(table))
    values = table[columns].apply(pd.to_numeric, errors="coerce")
    odd = np.flatnonzero(~np.isfinite(values.to_numpy(float)).all(axis=1))
    if odd.tolist() == [len(table) - 1]:  # a last line that was not written to its end
        return values.assign(time=table["time"])[:-1]
    require(not len(odd), "rows", path.name, "numbers", f"none in line {odd[0] + 2 if len(odd) else 0}")
    return values.assign(time=table["time"])


def read_table(path: Path) -> np.ndarray:
    """Return the points ``[rows, 8, 3]`` [m] in a table of a model, NaN where the model gave none."""
    columns = [f".{name}{k}" for k in range(8) for name in ("ID_", "x", "y", "z")]
    values = read_columns(path, columns)[columns].to_numpy(float).reshape(-1, 8, 4)
    given = values[..., :1] == np.arange(8)[:, None]  # a point that was not given has the number 0
    points = np.where(given, values[..., 1:], np.nan)
    reach = float(np.nanmax(np.linalg.norm(points, axis=-1), initial=0.0))
    require(0.1 < reach < 1.0, "points", path.name, "in metres, up to 0.1 to 1 m away", f"{reach:.3g}")
    return points


def read_clock(path: Path) -> np.ndarray:
    """Return the times of the rows of a table, from 0 [s]."""
    since = clock_s(read_columns(path, [".ID_0"])["time"], path.name)
    require((np.diff(since) >= 0).all(), "time", path.name, "increasing", "a step back")
    return since


def recorded_tables() -> dict[str, np.ndarray]:
    """Return the tables of the models that are found, by name."""
    places = {name: place_of(name) for name in released_chains()}
    return {name: read_table(path) for name, path in places.items() if path.is_file()}


def read_quaternions(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return times [s] and orientations ``[t, 9, 4]`` of an upright base and eight IMUs, as the IMUs sent them.

    Each row is a message of one IMU, 0 to 7. The columns are inferred: those of the topic ``quat_meas`` in the
    released bags, written as the tables of the models are. There the y axis of an IMU points along the arm.
    """
    messages = read_columns(path, [".ID", ".w", ".x", ".y", ".z"])
    since = clock_s(messages["time"], path.name)
    order = np.argsort(since, kind="stable")  # messages may be written in another order than they were sent
    messages, since = messages.iloc[order], since[order]
    number = messages[".ID"].to_numpy()
    q = messages[[".x", ".y", ".z", ".w"]].to_numpy()
    size = np.linalg.norm(q, axis=1)
    own = [(number == k) & (np.abs(size - 1) < 0.05) for k in range(8)]  # an IMU that starts sends zeros
    counts = [int(one.sum()) for one in own]
    require(
        min(counts) >= LEAST_ROWS, "messages", path.name, f"{LEAST_ROWS} or more of each IMU", min(counts)
    )
    start, end = max(since[one][0] for one in own), min(since[one][-1] for one in own)
    clock = since[own[7]][(since[own[7]] >= start) & (since[own[7]] <= end)]
    imus = [np.tile([0.0, 0.0, 0.0, 1.0], (len(clock), 1))]
    for one in own:
        first = np.r_[True, np.diff(since[one]) > 0]  # of two messages at one time the first
        turned_by = Slerp(since[one][first], Rotation.from_quat(q[one][first]))(clock)
        imus.append((turned_by * Rotation.from_euler("x", -90, degrees=True)).as_quat())
    return clock, np.stack(imus, axis=1)


# The chains behind the tables


class Released(NamedTuple):
    """What gave a table: a chain, and by number the distances of its points from the chain's origin [m]."""

    arm: Arm
    arcs: dict[int, float]

    def points(self, q: np.ndarray) -> np.ndarray:
        """Return its points as in the tables: from the chain's own origin [m]."""
        reach = sum(self.arm.link_lengths)
        return shape(q, self.arm, [min(arc, reach) for arc in self.arcs.values()]) - self.arm.origin


def released_chains() -> dict[str, Released]:
    """Return chain and points of each released table."""
    rigid = Arm(range(1, 8), POSITIONS[1:8], [0.102, *[0.08] * 6], origin=ORIGIN)

    def joints(first: float) -> dict[int, float]:
        return {0: 0.0} | {k: first + 0.08 * (k - 1) for k in range(1, 8)}

    middles = {0: 0.0285} | {k: 0.017 + 0.08 * k for k in range(1, 8)}
    fewer: dict[str, Released] = {}
    for n in (2, 4):
        fewer[f"fly/less_imu/less_imu_{n}.csv"] = Released(released_arm("rigid", n), joints(0.062))
        fewer[f"fly/pcc16/pcc16_{n}.csv"] = Released(released_arm("pcc", n), {4: 0.3022, 7: 0.5422})
    return {
        RIGID_FILE: Released(rigid, joints(0.102)),
        PCC_1: Released(released_arm("pcc", 8, 8), joints(0.057)),
        **{
            f"elephant/pcc/pcc{n}.csv": Released(released_arm("pcc", 8, 8 * n), middles) for n in (2, 4, 6, 8)
        },
        **fewer,
    }


def synthetic_tables(trial: Trial) -> dict[str, np.ndarray]:
    """Return what the tables would hold for a synthetic trial, all but rigid.csv some rows later."""
    made = {}
    for name, chain in released_chains().items():
        rows = 0 if name == RIGID_FILE else LATER
        points = np.full((len(trial.time_s) + rows, 8, 3), np.nan)
        points[rows:, list(chain.arcs)] = chain.points(trial.orientations)
        points[:rows] = points[rows]
        made[name] = points.astype(np.float32).astype(float)  # the released numbers have 32 bits
    return made


# The orientations behind the tables


def paired(made: np.ndarray, points: np.ndarray) -> tuple[slice, slice, int]:
    """Return the rows of two tables that belong together, and by how many the second is later, to be closest."""

    def rows(later: int) -> tuple[slice, slice, int]:
        first, end = max(0, -later), min(len(made), len(points) - later)
        return slice(first, end), slice(first + later, end + later), later

    def distance(later: int) -> float:
        i, j, _ = rows(later)
        return float(np.median(np.linalg.norm(made[i][::10] - points[j][::10], axis=-1)))

    return rows(min(range(-LARGEST_SHIFT, LARGEST_SHIFT + 1), key=distance))


INVERSE = np.array([-1.0, -1.0, -1.0, 1.0])


def turned(direction: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Return quaternions that turn about the z axis by an angle and then take it to directions ``[rows, 3]``."""
    x, y, z = direction.T
    q = np.stack([-y, x, 0 * x, 1 + z], axis=-1)
    q = np.where(
        1 + z[:, None] > 1e-12, q / np.sqrt(2 + 2 * np.maximum(z[:, None], -1 + 1e-12)), [1.0, 0, 0, 0]
    )
    about = np.stack([0 * x, 0 * x, np.sin(angle / 2), np.cos(angle / 2)], axis=-1)
    return product(q, about)


def next_imu(before: np.ndarray, halfway: np.ndarray, along: np.ndarray) -> np.ndarray:
    """Return quaternions with z axes ``along``, halfway to which from those before the z axes are ``halfway``."""
    h_0 = turned(halfway, 0 * halfway[:, 0])
    a, b = (Rotation.from_quat(q).apply(v, inverse=True) for q, v in ((before, halfway), (h_0, along)))
    h = turned(halfway, np.arctan2(b[:, 1], b[:, 0]) - np.arctan2(a[:, 1], a[:, 0]))
    found = product(product(h, before * INVERSE), h)
    # Two directions are four equations for three unknowns: what rounding leaves goes into the direction halfway.
    rest = np.cross(Rotation.from_quat(found).apply(UP), along)
    return product(Rotation.from_rotvec(rest).as_quat(), found)


def last_imu(before: np.ndarray, third: np.ndarray, start: np.ndarray, step: np.ndarray) -> np.ndarray:
    """Return IMU #8: of the turns about the z axes a third of the way to it, the one whose step comes closest.

    The step [m] is over six of the eight sub-segments between IMU #4 and it.
    """
    link = Arm([0, 1], [0.0, 0.32], [0.32], sub_segments=8)

    def ended(angle: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        h = product(turned(third, angle), before * INVERSE)
        end = product(product(h, h), product(h, before))
        found = pcc_extended(np.stack([start, end], axis=1), link, 0.24)[:, 0]
        return end, found - step, np.abs(h[:, 3]) > np.cos(np.radians(30.5))

    angles, sizes = np.linspace(-np.pi, np.pi, 72, endpoint=False), []
    for start_angle in angles:
        _, error, shorter = ended(np.full(len(third), start_angle))
        sizes.append(np.where(shorter, np.linalg.norm(error, axis=1), np.inf))
    angle = angles[np.argmin(sizes, axis=0)]
    for _ in range(8):  # Gauss and Newton, half a start angle at most
        error, ahead = ended(angle)[1], ended(angle + 1e-6)[1]
        slope = (ahead - error) / 1e-6
        change = (slope * error).sum(axis=1) / np.maximum((slope**2).sum(axis=1), 1e-30)
        angle = angle - np.clip(change, -np.pi / 72, np.pi / 72)
    return ended(angle)[0]


def trial_orientations(tables: dict[str, np.ndarray]) -> np.ndarray:
    """Return base and IMUs ``[rows, 9, 4]`` of the trial behind the released tables, by four of them."""
    steps = [np.diff(tables[name], axis=1) for name in (RIGID_FILE, PCC_1)]
    along, halfway = (x / np.linalg.norm(x, axis=-1, keepdims=True) for x in steps)
    halfway = halfway[LATER:][: len(along)]
    along = along[: len(halfway)]
    upright, before, imus = (
        np.tile([0.0, 0.0, 0.0, 1.0], (len(along), 1)),
        np.tile(HALF_TURN, (len(along), 1)),
        [],
    )
    for k in range(7):
        before = next_imu(before, halfway[:, k], along[:, k])
        imus.append(before)
    q, rest = np.stack([upright, *imus, before], axis=1), []  # IMU #8 is still unknown
    for name, told in ((PCC_2, range(7)), (PCC_16_2, (4,))):
        chain = released_chains()[name]
        made = Released(chain.arm, {k: chain.arcs[k] for k in told}).points(q)
        i, j, _ = paired(made, tables[name][:, list(told)])
        q, rest = q[i], [*(points[i] for points in rest), tables[name][j]]
    # From point 6 of pcc2.csv half a link on to IMU #7, then half a link along the first of two sub-segments.
    chain = released_chains()[PCC_2]
    half = Released(chain.arm, {6: chain.arcs[6], 7: sum(chain.arm.link_lengths[:-1])})
    third = rest[0][:, 7] - rest[0][:, 6] - np.diff(half.points(q), axis=1)[:, 0]
    third /= np.linalg.norm(third, axis=-1, keepdims=True)
    q[:, 8] = last_imu(q[:, 7], third, q[:, 4], rest[1][:, 7] - rest[1][:, 4])
    return q


def compared(tables: dict[str, np.ndarray], q: np.ndarray, source: str) -> pd.DataFrame:
    """Return how far the points of each table are from its chain's, without rows of a tie between two half turns."""
    lines = []
    for name, points in tables.items():
        chain = released_chains()[name]
        made, points = chain.points(q), points[:, list(chain.arcs)]
        i, j, later = paired(made, points)
        used = chain.arm.select(q[i])
        tied = (np.abs((used[:, :-1] * used[:, 1:]).sum(axis=-1)) < 1e-6).any(axis=1) & np.any(
            chain.arm.sub_segments
        )
        off = np.linalg.norm(made[i] - points[j], axis=-1)[~tied]
        lines.append({
            "file": name,
            "rows": len(off),
            "later": later,
            "half_turns": int(tied.sum()),
            "median_um": 1e6 * np.median(off),
            "largest_um": 1e6 * off.max(),
            "same_percent": 100 * (off <= SAME_M).mean(),
            "source": source,
        })  # fmt: skip
    return pd.DataFrame(lines)


def tables_compared(synthetic: Trial) -> pd.DataFrame:
    """Return how far all tables are from our chains: the released ones, or those of a synthetic trial."""
    tables, source = recorded_tables(), "recorded"
    if not set(NEEDED) <= set(tables):
        tables, source = synthetic_tables(synthetic), "synthetic"
    return compared(tables, trial_orientations(tables), source)


HEADS = {"file": "table", "rows": "rows", "median_um": "median [µm]", "largest_um": "largest [µm]"}
"""Of the distances between tables and chains, as a reader sees them."""


def tables_in_words(files: pd.DataFrame) -> str:
    """Return how well our chains give the released tables: those that are here, or those that were here once."""
    recorded = (files["source"] == "recorded").all()
    tried = files if recorded else study("martin_files")
    within = tried["largest_um"] <= 1
    if recorded:
        return (
            f"**On the authors' files.** {within.sum()} of {len(files)} tables follow to a micrometre in every point"
            f" of every row. We left out {files['half_turns'].max()} rows in which the base and"
            " IMU 1 are half a turn apart."
        )
    return (
        f"We have tried {len(tried)} of the {len(files)} files. Of our tables, {within.sum()} agree with them to a"
        f" micrometre in every point, the {'others' if (~within).sum() > 1 else 'other one'} to"
        f" {number(tried['largest_um'].max(), 2)} µm."
    )
