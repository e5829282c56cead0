"""Robots of other laboratories: what a user's script finds on each of them, beside what its source states.

``data/others/robots.toml`` says whose robots they are. The scripts are ``data/others/NAME/use.py``. Each leaves its
``figures`` and, where there is a truth, what is judged: errors and the covariances that were stated for them. Three
robots have no licence: their files are read where they are, and elsewhere the page shows figures that were computed
from them.
"""

from __future__ import annotations

import contextlib
import importlib.util
import io
import os
import runpy
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from IPython.display import HTML
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

import repro
from repro.chain import point_on
from repro_companion.papers import toronto
from repro_companion.papers.fetch import states
from repro_companion.run import project_folder, recordings_folder
from repro_companion.show import number, rendered, sentences, study

LEVEL = 0.9
"""How much of the truth a stated region is to cover."""
FETCHED = ("hall_joint", "soft_arm_3000", "imu_chain")
"""Robots whose files have no licence: `repro fetch` brings them."""


class Found(NamedTuple):
    """What a robot is, its figures, and all names of its script; none where the figures were committed."""

    about: dict[str, Any]
    figures: dict[str, float]
    names: dict[str, Any]


def robots() -> dict[str, dict[str, Any]]:
    """Return the robots, and the words of their rows."""
    return tomllib.loads((project_folder() / "data/others/robots.toml").read_text(encoding="utf-8"))


def script(name: str) -> Path:
    """Return where a user's lines are."""
    return project_folder() / "data" / "others" / name / "use.py"


def written_lines(path: Path) -> int:
    """Return how many lines a user writes: neither blank nor a comment nor the first, which says what it is."""
    lines = path.read_text(encoding="utf-8").splitlines()[1:]
    return sum(not line.strip().startswith("#") for line in lines if line.strip())


def coverage(error: np.ndarray, C: np.ndarray) -> tuple[float, float]:
    """Return how many errors ``[n, m]`` their regions hold [%], and the median of the longest semi-axes."""
    edge = chi2(error.shape[1]).ppf(LEVEL)
    inside = np.einsum("ti,tij,tj->t", error, np.linalg.inv(C), error) < edge
    return 100 * float(inside.mean()), float(np.median(np.sqrt(edge * np.linalg.eigvalsh(C)[:, -1])))


def computed(name: str) -> Found:
    """Run a user's script, and return its figures with those of the stated regions and of the source's files."""
    with contextlib.redirect_stdout(io.StringIO()):
        names = runpy.run_path(str(script(name)))
    figures = {key: float(value) for key, value in names["figures"].items()}
    for case, judged in names.get("judged", {}).items():
        figures[f"{case}_covered_percent"], figures[f"{case}_longest"] = coverage(*judged)
    if name == "toronto":
        figures |= _of_toronto(names)
    for motion, (poses, good, _) in names.get("kept", {}).items():
        figures |= {f"{motion}_jumps": _jumps(poses), f"{motion}_jumps_kept": _jumps(poses[good])}
    return Found(robots()[name], figures, names)


def _of_toronto(names: Mapping[str, Any]) -> dict[str, float]:
    """Return the errors [mm] of the source's own filter on the trials that are here, evaluated as ours are."""
    errors = {}
    for trial, seconds in names["WINDOWS"].items():
        seen = toronto.capture(trial, names["DATA"] / trial, seconds)
        parts = toronto.released(seen, "filter", np.zeros(18)) or []
        rms = [1e3 * np.sqrt((e**2).sum(1).mean()) for e in parts]
        errors[f"{trial}_source_filter_mm"] = float(np.mean(rms))
    return errors


def found(name: str) -> Found:
    """Return what a robot gives: computed where all its files are as they were released, else as it was committed."""
    if name not in FETCHED:
        return computed(name)
    known = dict(study(f"others_{name}").to_numpy())
    ready = name != "imu_chain" or importlib.util.find_spec("vqf")
    if ready and {*states(name).values()} == {"released"}:
        os.environ["REPRO_DATA_DIR"] = str(recordings_folder())  # a user's script knows no cache
        return computed(name)
    return Found(robots()[name], known, {})


def rows(of_robots: Mapping[str, Found]) -> pd.DataFrame:
    """Return the table of the page, a row for each robot."""
    lines = []
    for name, (about, figures, names) in of_robots.items():
        covered = [f"{figures[f'{case}_covered_percent']:.0f} %" for case in about["cases"]]
        longest = [f"{number(figures[f'{case}_longest'], 2)}{about['unit']}" for case in about["cases"]]
        own = {key: about[key] for key in ("robot", "repository", "commit", "licence", "measured")}
        own |= {key: about[key].format_map(figures) for key in ("source", "ours", "monitor")}
        own |= {"covered": ", ".join(covered) or "–", "longest": ", ".join(longest) or "–"}
        own |= {"lines": written_lines(script(name))}
        lines.append({"name": name} | own | {"computed": "here" if names else "before"})
    return pd.DataFrame(lines)


def figures(of_robots: Mapping[str, Found]) -> pd.DataFrame:
    """Return all figures of all robots, a row each."""
    named = {name: pd.Series(own.figures, name="value") for name, own in of_robots.items()}
    return pd.concat(named, names=["robot", "figure"]).reset_index()


def table(of_rows: pd.DataFrame) -> HTML:
    """Return the table of the page; each robot leads to its repository."""
    return HTML(rendered("others.html", rows=of_rows.to_dict("records")))


IN_SHORT = """
**In short.** The public names were enough for all robots. Where a source states an error of the same task, ours is
smaller for {{ smaller | join(" and ") or "none" }}{{ ", and larger for " ~ larger | join(" and ") if larger }}.
{% if rod %}
On the continuum robot our filter has a
{{ "smaller" if rod.slow_free_space_rms_mm < rod.slow_free_space_source_filter_mm else "larger" }} error than the
source's in the slow trial, on which we chose its noise. In the other trial, when the arm is hit, we have
{{ rod.impulse_1_rms_mm | fixed(1) }} mm against {{ rod.impulse_1_source_filter_mm | fixed(1) }} mm.
{% endif %}
Do not trust the stated regions of a new robot before you have evaluated them. They should cover 90 %. In
{{ covered | length }} evaluations, {{ good or "none" }} cover{{ "s" if good < 2 }} between 85 and 95 %, {{ less or
"none" }} less and {{ more or "none" }} more, and the worst covers {{ covered | min | fixed(0) }} %.
"""
STATED = {
    "eflesh": ("eFlesh", "x_rms_mm", 0.5),
    "hall_joint": ("the Hall joint", "cycle_1_sample_rms_deg", 2.0),
}
"""Robots whose source states an error of the same task: our figure beside it, and that error."""


def in_short(of_robots: Mapping[str, Found]) -> str:
    """Return what the table comes to: errors beside those that sources state for the same task, and regions."""
    figures = {name: own.figures for name, own in of_robots.items()}
    below = {words: figures[name][figure] < error for name, (words, figure, error) in STATED.items()}
    smaller = [words for words, is_below in below.items() if is_below]
    larger = [words for words in below if words not in smaller]
    covered = [
        own.figures[f"{case}_covered_percent"] for own in of_robots.values() for case in own.about["cases"]
    ]
    good = sum(85 <= value <= 95 for value in covered)
    less, more = sum(value < 85 for value in covered), sum(value > 95 for value in covered)
    counts = {"covered": covered, "good": good, "less": less, "more": more}
    return sentences(IN_SHORT, smaller=smaller, larger=larger, rod=figures.get("toronto"), **counts)


# Pictures


def pictures(of_robots: Mapping[str, Found]) -> pd.DataFrame:
    """Return a shape of every robot [mm], seen from the side on which it bends; drawn by us where no file is here."""
    parts = []
    for name, own in of_robots.items():
        drawn = {look: own.about[look] for look in ("drawn", "bodies") if look in own.about}
        for look, points in (drawn or PICTURES[name](own.names)).items():
            about = {"look": look, "robot": own.about["robot"].split(",")[0], "bar_mm": own.about["bar_mm"]}
            parts.append(pd.DataFrame(np.array(points), columns=["x_mm", "z_mm"]).assign(**about))
    return pd.concat(parts, ignore_index=True)


def _sides(shape: np.ndarray, measured: np.ndarray) -> dict[str, np.ndarray]:
    """Return points ``[n, 3]`` in the plane of the base's axis and the tip, from the base on."""
    across = (shape[-1] - shape[0])[:2] / np.linalg.norm((shape[-1] - shape[0])[:2])
    named = {"shape": shape - shape[0], "measured": measured - shape[0]}
    return {name: np.stack([points[:, :2] @ across, points[:, 2]], axis=1) for name, points in named.items()}


def _fitted(robot: repro.Robot, fit: Any, measured: np.ndarray) -> dict[str, np.ndarray]:
    """Draw the shape that bends most and what was measured of it ``[t, n, 3]`` [m]."""
    base, arcs = fit.rig.base, np.linspace(0, robot.segments[0].length, 15)
    points = (measured - base[:3, 3]) @ base[:3, :3]
    most = np.linalg.norm(points[:, -1, :2], axis=1).argmax()
    ends = [segment.length / arcs[-1] for segment in robot.segments]
    places = [point_on(k, x * share) for k, share in enumerate(ends, 1) for x in arcs]
    return _sides(1e3 * robot.poses(fit.q[most], places)[:, :3, 3], 1e3 * points[most])


def _of_rod(names: Mapping[str, Any]) -> dict[str, np.ndarray]:
    """Draw the continuum robot where it bends most when it is hit."""
    fit, frames, p = names["shapes"]["impulse_1"]
    most = frames[np.linalg.norm(p[:, -1, :2] - p[:, 0, :2], axis=1).argmax()]
    arcs, now = np.linspace(0, names["LENGTH"], 40), slice(most, most + 1)
    shape = 1e3 * names["arm"].positions(fit.q[now], fit.covariance[now], arcs)[0][0]
    bodies = [x[np.abs(t - fit.times[most]).argmin()] for t, x in names["bodies"]]
    return _sides(shape, 1e3 * toronto.poses(np.array(bodies))[:, :3, 3])


PICTURES = {
    "toronto": _of_rod,
    "asl_trunk": lambda names: _fitted(names["arm"], names["whole"], names["poses"][..., :3]),
    "tentacle": lambda names: _fitted(
        names["robots"]["two arcs"], names["fits"]["two arcs"], names["markers"]
    ),
    "eflesh": lambda names: {
        "shape": 16.0 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]]),
        "measured": names["q"][3844::24, :2],
        "found": names["found"].q[0, ::24, :2],
    },
    "magnet_array": lambda names: {
        "sensors": pd.read_csv(names["DATA"] / "sensors.csv")[["x_mm", "z_mm"]],
        "shape": 1e3 * names["found"].q[:, [0, 2]],
    },
}
"""What is drawn of a robot, from the names of its script."""


# Errors


def _jumps(poses: np.ndarray) -> int:
    """Return how often a body turns by more than ten degrees from frame to frame."""
    turns = [Rotation.from_quat(poses[:, k, 3:]) for k in range(poses.shape[1])]
    return sum(int(((R[:-1].inv() * R[1:]).magnitude() > np.radians(10)).sum()) for R in turns)


def region(own: Found, case: str) -> pd.DataFrame:
    """Return errors [mm] along the axes, and the half-width of the stated interval of each."""
    error, C = own.names["judged"][case]
    half = np.sqrt(chi2(1).ppf(LEVEL) * np.diagonal(C, axis1=1, axis2=2))
    axes = [form.format(axis) for form in ("{}_mm", "half_{}_mm") for axis in "xyz"[: error.shape[1]]]
    return pd.DataFrame(np.concatenate([error, half], axis=1), columns=axes)


def tips_of_trunk(own: Found, every: int) -> pd.DataFrame:
    """Return how far the tip of the trunk is off [mm], by arcs alone and with what was learned; every n-th frame.

    Of the short motion all frames are there.
    """
    parts = []
    for motion, (_, kept, arcs) in own.names["kept"].items():
        learned, _ = own.names["judged"][motion]
        tip = pd.DataFrame({"motion": motion, "frame": np.flatnonzero(kept)[-len(arcs) :]})
        tip["arcs"] = np.linalg.norm(arcs, axis=1)
        tip["with what was learned"] = np.linalg.norm(learned, axis=1)
        parts.append(tip[:: every if motion == "adiabatic" else 1])
    return pd.concat(parts)
