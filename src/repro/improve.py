"""What would help a design: a search over where its chips and magnets may be, and over how many chips it has.

A good layout has a small median deviation of the tip (:func:`.median_tip`). We draw layouts at random within the
ranges, and refine the best of them by moving one part at a time, by smaller and smaller steps. A chip that is added
is a copy of another one, where it helps most.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from repro.chain import Place
from repro.check import DesignCheck, check_design, length_in_words, median_tip
from repro.common import InputError, require
from repro.parts import Assembly, Sensor
from repro.plots import plot_chips
from repro.sensing import sensing_of

_AS_BUILT = 0.2
"""Share of the layouts that are tried where each takes the tolerances too, which is slow."""
_DRAWN, _STARTS, _STEPS = 0.3, 4, (0.5, 0.01)
"""Share of the layouts that are drawn, how many of them are refined, and the first and last step, of a range."""
_FEWER, _MORE, _OTHER = 2, 3, 0.2
"""Chips fewer and more than the design has that are tried, and the share of the layouts for each number."""
_SHAPES = 64
"""Random shapes in which a layout is tried."""
_ENOUGH = "This design needs no better one. State a smaller target to look for one."
_NO_HELP = 0.01
"""A change that makes the deviation smaller by less than this share is not made."""


class ChipsAgainstError(NamedTuple):
    """The best layout with a number of chips: median deviation of the tip after a calibration and before [m].

    Neither is above what is known without readings.
    """

    chips: int
    calibrated: float
    as_built: float


@dataclass(frozen=True, repr=False)
class Improvement(DesignCheck):
    """A better design: its check, and how it came about. ``print`` shows it.

    Parameters
    ----------
    robot
        The better robot; the old one where none was found or none was sought.
    before
        The check of the old one.
    remarks
        What was free, and what came out, in words.
    changes
        What to change, the most helpful change first, and the median deviation of the tip before and after each.
    by_chips
        The best layouts found, by their number of chips.
    """

    robot: Assembly
    before: DesignCheck
    remarks: tuple[str, ...]
    changes: tuple[str, ...]
    by_chips: tuple[ChipsAgainstError, ...]

    def __repr__(self) -> str:
        """Return the check of the better design, then the changes, the most helpful first."""
        helpful, more = self.changes[:3], len(self.changes) - 3
        rest = [f"and {more} smaller change{'s' if more > 1 else ''}"] if more > 0 else []
        table = [
            f"{row.chips} chip{'s'[row.chips < 2 :]}: {length_in_words(row.calibrated)} after a calibration, "
            f"{length_in_words(row.as_built) if row.as_built < self.spread else 'as good as nothing'} before"
            for row in self.by_chips
        ]
        return "\n".join([*self.remarks, *helpful, *rest, *table, super().__repr__()])

    def plot(self, axes: Any = None) -> Any:
        """Draw the deviation of the tip over the number of chips: :func:`repro.plots.plot_chips`."""
        return plot_chips(self.by_chips, axes)


def improve_design(
    robot: Assembly,
    *,
    target: float | None = None,
    as_built: bool = False,
    samples: int = 400,
    seed: int = 0,
    tries: int = 500,
    show: Callable[[object], None] | None = None,
) -> Improvement:
    """Look for a better design where one cannot work or misses a target: see :meth:`repro.Robot.check`.

    Parameters
    ----------
    robot
        As it is drawn. What may change is ``free`` of its magnets and sensors; where none states any, chips and
        magnets may move along their segments, and around the backbone if they are off it.
    target
        Median deviation of the tip that is wanted [m].
    as_built
        Make the deviation before a calibration small, else the one after.
    samples, seed
        As for a check. The same seed finds the same design.
    tries
        Layouts that are tried with the chips of the design; each other number of chips takes a fifth of it more.
    show
        Is called with a sentence on the progress.

    Raises
    ------
    InputError
        As :func:`.check_design`; if nothing may change, a range leaves its segment, or the robot is not as drawn.

    Examples
    --------
    >>> from repro import ConstantCurvature, Disc, Magnet, Robot, Sensor
    >>> magnet = Magnet(Disc(2e-3, 1e-3, 1300.0), segment=1, at=0.11)
    >>> robot = Robot(
    ...     [ConstantCurvature(0.11, 0.022)], [magnet], [Sensor(1, 0.0, axes=3)],
    ...     lower=[-0.02, -0.02, 0.0], upper=[0.02, 0.02, 0.006], noise=0.02,
    ... )
    >>> improve_design(robot).can_work
    True
    """
    require(tries >= 20, "tries", "improve", "at least 20", tries)
    require(target is None or target > 0, "target", "improve", "positive [m]", target)
    before = check_design(robot, samples=samples, seed=seed)
    stays = Improvement(**vars(before), robot=robot, before=before, remarks=(), changes=(), by_chips=())
    if not falls_short(before, target, as_built):
        return replace(stays, remarks=(_ENOUGH,))
    start, remark = _with_freedom(robot)
    budget = int(tries * (_AS_BUILT if as_built else 1.0))
    found = _Search(as_built, seed, budget, show or (lambda _: None)).by_chips(start)
    by_chips = tuple(_row(k, found[k], before.spread, samples, seed) for k in sorted(found))

    n = len(robot.sensors)
    checks = {k: check_design(found[k], samples=samples, seed=seed) for k in sorted(found) if k >= n}
    chips = next((k for k in checks if not falls_short(checks[k], target, as_built)), n)
    steps = _steps(start, found[chips], lambda x: _tip(x, as_built=as_built, samples=samples, seed=seed))
    few = [k for k, step in enumerate(steps, 1) if step.after <= (1 + _NO_HELP) * steps[-1].after]
    taken = steps[: min(few, default=0)]
    check = check_design(taken[-1].robot, samples=samples, seed=seed) if taken else before
    if falls_short(check, target, as_built):
        taken, check = steps, checks[chips]
    lost = any(old and not new for old, new in zip(before.grades, check.grades, strict=True))
    if not taken or lost or not median_of(check, as_built) < median_of(before, as_built):
        return replace(stays, remarks=(remark, "No better layout was found."), by_chips=by_chips)
    better = taken[-1].robot.replaced(moments=None)
    outcome = _outcome(len(better.sensors) - n, falls_short(check, target, as_built))
    return Improvement(
        **vars(check), robot=better, before=before, remarks=(remark, outcome),
        changes=tuple(step.words for step in taken), by_chips=by_chips,
    )  # fmt: skip


def _row(chips: int, robot: Assembly, spread: float, samples: int, seed: int) -> ChipsAgainstError:
    calibrated, as_built = (median_tip(robot, as_built=x, samples=samples, seed=seed) for x in (False, True))
    return ChipsAgainstError(chips, min(calibrated, spread), min(as_built, spread))


def median_of(check: DesignCheck, as_built: bool) -> float:
    """Return the median deviation of the tip before a calibration or after one [m]."""
    return float(np.median(check.tip_as_built if as_built else check.tip_within_bounds))


def falls_short(check: DesignCheck, target: float | None, as_built: bool = False) -> bool:
    """Whether a design cannot work, or misses a target of the median deviation of the tip [m]."""
    return not check.can_work or (target is not None and median_of(check, as_built) > target)


def _outcome(more: int, short: bool) -> str:
    if short:
        return "No layout was found that is good enough. This is the best one with as many chips."
    return (
        f"It works with {more} more chip{'s' if more > 1 else ''}."
        if more
        else "It works with as many chips."
    )


def _with_freedom(robot: Assembly) -> tuple[Assembly, str]:
    """Return the robot whose parts say what is free, and say it in words; refuse one where nothing is."""
    drawn = robot.model is None and robot.moments is None
    require(drawn, "robot", "improve", "as drawn", "one with trained networks or calibrated magnets")
    remark = "Free is what the design marks as such."
    if not any(part.free for part in (*robot.magnets, *robot.sensors)):
        remark = (
            "Nothing is marked as free: chips and magnets may move along their whole segments, and around the "
            "backbone where they are off it; sizes stay."
        )
        parts = {kind: [_loose(robot, part) for part in own] for kind, own in _parts(robot).items()}
        robot = robot.replaced(**parts)
    parts = (*robot.magnets, *robot.sensors)
    free = [(part, name, *ends) for part in parts for name, ends in (part.free or {}).items()]
    require(free, "robot", "improve", "one of which something may change", "none")
    for part, name, low, high in free:
        within = low - 1e-9 <= _value(part, name) <= high + 1e-9
        require(within, f"free {name}", type(part).__name__, "a range with what it is now in it", (low, high))
        for at in (low, high) if name == "at" else ():
            robot.check_place(part.place._replace(at=at), "free at")
    sizes = any(name not in ("at", "azimuth") for _, name, _, _ in free)
    return robot.replaced(moments=None if sizes else sensing_of(robot).moments), remark


def _loose(robot: Assembly, part: Any) -> Any:
    """Return a part that may be anywhere along its segment, and around the backbone if it is off it."""
    reach = robot.segments[part.place.segment - 1].length if part.place.segment else 0.0
    ranges = {"at": (0.0, reach)} if reach else {}
    ranges |= {"azimuth": (0.0, 2 * math.pi)} if np.any(part.place.position[:2]) else {}
    return replace(part, free=ranges)


def _value(part: Any, name: str) -> float:
    """Return a free number as it is [m, rad]; an azimuth from the lower end of its range on."""
    if name == "azimuth":
        low, (x, y, _) = part.free[name][0], part.place.position
        return low + (math.atan2(y, x) - low + 1e-9) % (2 * math.pi) - 1e-9
    return part.at if name == "at" else vars(part.shape)[name]


def _moved(part: Any, rng: np.random.Generator, reach: float | None) -> Any:
    """Return a part with other numbers: all over their ranges, or within a share of these around what they are."""
    for name, (low, high) in part.free.items():
        unit = (
            math.pi / 180 if name == "azimuth" else 1e-3
        )  # what a file says in tenths of it is the same number
        far = rng.uniform(-1, 1) * (high - low)
        value = (low + high + far) / 2 if reach is None else _value(part, name) + reach * far
        if name == "azimuth" and high - low > 2 * math.pi - 1e-9:
            value = low + (value - low) % (2 * math.pi)
        value = min(max(round(value / unit, 1) * unit, low), high)
        if name == "azimuth" and part.position is not None:
            x, y, z = (1e3 * float(x) for x in part.position)
            xy = [round(math.hypot(x, y) * f(value), 3) for f in (math.cos, math.sin)]
            part = replace(part, position=np.multiply([*xy, z], 1e-3).tolist())
        elif name in ("at", "azimuth"):
            part = replace(part, **{name: value})
        else:
            with suppress(InputError):  # a ring without a wall stays as it is
                part = replace(part, shape=replace(part.shape, **{name: value}))
    return part


def _parts(robot: Assembly) -> dict[str, list[Any]]:
    """Return what may move, by its kind, in lists of their own."""
    return {"magnets": [*robot.magnets], "sensors": [*robot.sensors]}


def _free_parts(robot: Assembly) -> list[tuple[str, int]]:
    return [(kind, k) for kind, own in _parts(robot).items() for k, part in enumerate(own) if part.free]


class _Search:
    """Looks for the layout with the smallest median deviation of the tip."""

    def __init__(self, as_built: bool, seed: int, budget: int, show: Callable[[object], None]) -> None:
        self.as_built, self.seed, self.budget, self.show = as_built, seed, budget, show
        self.rng = np.random.default_rng(seed)

    def error(self, robot: Assembly) -> float:
        """Return the median deviation of the tip [m]; infinite where magnets touch, or no reading is a number."""
        with suppress(InputError):
            return _tip(robot, as_built=self.as_built, samples=_SHAPES, seed=self.seed)
        return math.inf

    def moved(
        self, robot: Assembly, parts: Sequence[tuple[str, int]], reach: float | None = None
    ) -> Assembly:
        """Return the robot with some parts moved."""
        both = _parts(robot)
        for kind, k in parts:
            both[kind][k] = _moved(both[kind][k], self.rng, reach)
        return robot.replaced(**both)

    def refined(self, robot: Assembly, tries: int, first: float) -> tuple[float, Assembly]:
        """Return the best of a robot and its neighbours: one part after the other moves, by smaller steps."""
        parts, error = _free_parts(robot), self.error(robot)
        for k, reach in enumerate(np.geomspace(first, _STEPS[1], tries)):
            trial = self.moved(robot, [parts[k % len(parts)]], float(reach))
            after = self.error(trial)
            if after < error:
                robot, error = trial, after
        return error, robot

    def best(self, robot: Assembly) -> Assembly:
        """Return the best robot with these chips."""
        parts, share = _free_parts(robot), int((1 - _DRAWN) * self.budget / 2)
        drawn = [robot, *(self.moved(robot, parts) for _ in range(int(_DRAWN * self.budget)))]
        starts = sorted(drawn, key=self.error)[:_STARTS]
        refined = [self.refined(x, share // _STARTS, _STEPS[0]) for x in starts]
        return self.refined(min(refined, key=lambda x: x[0])[1], share, _STEPS[0] / 2)[1]

    def by_chips(self, robot: Assembly) -> dict[int, Assembly]:
        """Return the best robots with as many chips as the design has, some fewer, and some more."""
        n, tries = len(robot.sensors), int(_OTHER * self.budget / 2)
        movable = [k for kind, k in _free_parts(robot) if kind == "sensors"]
        self.show(f"Looking for the best places of {n} chips ...")
        found = {n: self.best(robot)}
        more = range(n + 1, n + 1 + _MORE)
        fewer = range(n - 1, max(n - 1 - _FEWER, 0), -1)
        for count in [*more, *fewer] if movable else []:
            self.show(f"... and of {count} chips ...")
            if count < n:
                last = found[count + 1]
                trials = [
                    last.replaced(sensors=[x for x in last.sensors if x is not gone]) for gone in last.sensors
                ]
            else:
                last = found[count - 1]
                grown = [
                    last.replaced(sensors=[*last.sensors, _copy(last, last.sensors[k])]) for k in movable
                ]
                trials = [self.moved(grown[k % len(grown)], [("sensors", count - 1)]) for k in range(tries)]
            found[count] = self.refined(min(trials, key=self.error), tries, _STEPS[0] / 2)[1]
        return found


def _copy(robot: Assembly, chip: Sensor) -> Sensor:
    """Return a chip like another one, with a name and channels of its own."""
    name, channels = f"chip {len(robot.sensors) + 1}", None
    if chip.channels:
        last = max((c for x in robot.sensors for c in x.channels or () if isinstance(c, int)), default=0)
        channels = [last + k if last else f"{name} {'xyz'[k - 1]}" for k in range(1, chip.axes + 1)]
    return replace(chip, name=name, channels=channels)


def _touching(robot: Assembly) -> bool:
    """Whether magnets on one segment are closer than their heights."""
    along = [(m.segment, m.at, vars(m.shape).get("height", vars(m.shape).get("edge"))) for m in robot.magnets]
    return any(
        a[0] == b[0] and abs(a[1] - b[1]) < (a[2] + b[2]) / 2 for k, a in enumerate(along) for b in along[:k]
    )


def _tip(robot: Assembly, **how: Any) -> float:
    """Return the median deviation of the tip [m]; infinite where magnets touch."""
    return math.inf if _touching(robot) else median_tip(robot, **how)


class _Step(NamedTuple):
    """A change in words, the deviation after it [m], and the robot then."""

    words: str
    after: float
    robot: Assembly


def _steps(old: Assembly, new: Assembly, error: Callable[[Assembly], float]) -> list[_Step]:
    """Return the changes from a robot to another one, each time the most helpful one."""
    were, become = _parts(old), _parts(new)
    kept = {(kind, k): x for kind, own in were.items() for k, x in enumerate(own)}
    left = {
        (kind, k) for kind, own in become.items() for k, x in enumerate(own) if x is not kept.get((kind, k))
    }
    done = set[tuple[str, int]]()

    def mixed(done: set[tuple[str, int]]) -> Assembly:
        parts = dict[str, list[Any]]()
        for kind, own in become.items():
            both = [x if (kind, k) in done else kept.get((kind, k)) for k, x in enumerate(own)]
            parts[kind] = [part for part in both if part is not None]
        return old.replaced(**parts)

    steps, said = list[_Step](), _reached(old, error(old))
    while left:
        after, change = min((error(mixed(done | {x})), x) for x in left)
        left, done = left - {change}, done | {change}
        words = f"{_in_words(old, new, *change)}: {said} → {(then := _reached(mixed(done), after))}"
        steps.append(_Step(words, after, mixed(done)))
        said = then
    return steps


def _reached(robot: Assembly, error: float) -> str:
    return "magnets touch" if _touching(robot) else length_in_words(error)


def _in_words(old: Assembly, new: Assembly, kind: str, k: int) -> str:
    """Say what changes of a part."""
    part, sensor, own = _parts(new)[kind][k], kind == "sensors", _parts(old)[kind]
    azimuth = f"azimuth {math.degrees(math.atan2(part.place.position[1], part.place.position[0])) % 360:.4g}°"
    if k >= len(own):
        return f"one more chip at {1e3 * part.at:.4g} mm of segment {part.segment}, {azimuth}"
    was, words, name = own[k], list[str](), new.part_names[k] if sensor else f"magnet {k + 1}"
    moved, size = 1e3 * (part.at - was.at), {} if sensor else vars(was.shape)
    if moved and sensor and new.magnets:
        nearer, magnet = _nearer(new, was.place, part.place)
        words.append(f"{abs(nearer):.2g} mm {'nearer to' if nearer > 0 else 'farther from'} magnet {magnet}")
    elif moved:
        words.append(f"{abs(moved):.2g} mm towards the {'tip' if moved > 0 else 'base'}")
    words += [f"to {1e3 * part.at:.4g} mm"] if moved else []
    words += [f"to {azimuth}"] if not np.allclose(part.place.position, was.place.position) else []
    words += [
        f"{x} {1e3 * vars(part.shape)[x]:.4g} mm for {1e3 * size[x]:.4g}"
        for x in size
        if vars(part.shape)[x] != size[x]
    ]
    return f"{name} {', '.join(words)}"


def _nearer(robot: Assembly, was: Place, now: Place) -> tuple[float, int]:
    """Return by how much a place is nearer to its magnet at rest [mm], and which magnet that is."""
    at = [was, now, *(magnet.place for magnet in robot.magnets)]
    p = 1e3 * robot.poses(robot.usual_shape, at)[:, :3, 3]
    far = np.linalg.norm(p[2:] - p[1], axis=1)
    magnet = int(far.argmin())
    return float(np.linalg.norm(p[2 + magnet] - p[0]) - far[magnet]), magnet + 1
