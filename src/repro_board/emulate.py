"""A board that is not there: how its robot moves, what its sensors read, what it sends, and how all this fails.

Readings of a robot are simulated by magpylib, never by the multipoles that estimators use. All of it is synthetic.
"""

from __future__ import annotations

import contextlib
import math
import os
import select
import threading
import time
import tty
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from itertools import chain, count
from pathlib import Path
from socket import create_server

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from repro import Cube, Magnet, Robot, load_robot, simulated_readings
from repro.common import Array, bad_input, numbers, require, whole
from repro.tolerances import Tolerances, placed, priors_of
from repro_board.record import Recording, read_recording, stopping
from repro_board.wire import FORMATS, encode, text_line

SPEED = 0.5
"""Largest speed of every coordinate [widths of its bounds per second]."""
REACH = 0.9
"""How far a coordinate goes from the middle of its bounds, as a share of the way to them."""
MOVE_S, WINDOW = 0.5, (0.3, 0.9)
"""Time from one pose that is held to the next [s]; the part of the time in a pose that its table names."""
_EASE_S = 0.5
"""Time constant with which a motion begins [s]."""
_AHEAD_S = 0.1
"""Readings are simulated for so long at once, and sent in their time [s]."""
_SETTLE_S, _POLL_S = 0.25, 0.02
"""From the opening of a port to the first byte, as drivers clear their buffers; how often a port is looked at [s]."""
_MOST_HZ = 1e5
"""Readings per second, beyond what any line carries."""
_CARRIED = {"hall": (-8192.0, 8191.0, 0), "millivolts": (0.0, 2048.0, 4)}
"""What lines of a converter carry: from, to, decimals."""
FAULTS = ("missing", "unplugged", "stuck", "saturated", "scaled", "drifting", "spike", "frozen")
CHANCES = ("flips", "drops", "duplicates", "bursts", "stalls", "disconnects", "reboots")
"""Faults whose value is a chance."""
OF_THE_LINE = {
    **dict.fromkeys(CHANCES, 0.0),
    "burst_bytes": 32.0,
    "stall_s": 1.0,
    "away_s": 1.0,
    "boot_s": 0.5,
    "drift_ppm": 0.0,
}
"""Faults of a line and its board, and their values where none are given.

Chances of each byte that a bit of it flips, that it is lost, that it comes twice, that from it on ``burst_bytes``
or fewer are noise; of each reading that it and what follows is held back for ``stall_s``, that the port disappears
in the middle of it for ``away_s``, that the board starts anew, which takes ``boot_s``; how much its clock is fast
[parts per million].
"""
OF_SENSORS = {
    "saturate": "saturated",
    "gain": "scaled",
    "stick": "stuck",
    "unplug": "unplugged",
    "nan": "missing",
}
"""Faults whose value is the number of a sensor, from 1 (IMUs follow), in the order in which they act: see faulty.

Beside them there are ``magnet``, the distance [mm] of a foreign one of 1 A m^2 from the middle of the straight robot
along x, and ``noise``, how many times larger it is than stated.
"""


Faults = Mapping[str, object] | Iterable[tuple[str, object]]
"""Names and values."""
Motion = Callable[[Array], Array]
"""From times [s] to configurations ``[t, n_q]``."""


def course(robot: Robot, times: ArrayLike, *, seed: int = 0) -> Array:
    r"""Return configurations ``[t, n_q]`` of a smooth motion between the bounds of a robot.

    Every coordinate is the sum of two sines, whose frequencies, shares and signs are random. The motion begins at
    rest at the robot's start: its own time is :math:`t - \tau (1 - e^{-t/\tau})`.

    Parameters
    ----------
    robot
        With bounds.
    times
        Since the beginning [s].
    seed
        The same seed gives the same motion at whatever times.

    Raises
    ------
    InputError
        If the robot has no bounds.

    Examples
    --------
    >>> from repro import ConstantCurvature, Robot
    >>> robot = Robot([ConstantCurvature(0.1, 0.02)], lower=[-0.01, -0.01, 0.0], upper=[0.01, 0.01, 0.01])
    >>> course(robot, [0.0, 10.0]).round(4) + 0.0
    array([[0.    , 0.    , 0.005 ],
           [0.0067, 0.0043, 0.0011]])
    """
    middle, half, start = _bounds(robot, "course")
    rng, n = np.random.default_rng(seed), robot.n_q
    major = REACH * rng.uniform(0.6, 0.8, n)
    share = np.stack([major, REACH - major])
    ratio = np.stack([rng.uniform(0.7, 1.0, n), rng.uniform(1.5, 2.2, n)])
    # The speeds of both add up to the limit [rad/s].
    frequency = 2 * SPEED * ratio / (share * ratio).sum(axis=0)
    sign = rng.choice([-1.0, 1.0], n)
    away = np.divide(start - middle, REACH * half, out=np.zeros(n), where=half > 0)
    t = numbers(times, "times", "course", (None,))[:, None, None]
    t = t + _EASE_S * np.expm1(-t / _EASE_S)
    sines = share * np.sin(t * frequency + np.arcsin(np.clip(sign * away, -1, 1)))
    return middle + half * sign * sines.sum(axis=1)


def faulty(
    readings: ArrayLike,
    fault: str,
    columns: int | Sequence[int] | Array,
    since: int = 0,
    size: Array | float | None = None,
) -> Array:
    """Return readings of sensors that fail from one row on; the rows before stay as they are.

    ============ ==================================================================== ==========================
    fault        the columns read from then on                                        ``size``
    ============ ==================================================================== ==========================
    missing      nothing: NaN                                                         –
    unplugged    the same value, as an open input does                                that value, 0
    stuck        what they read in the row before                                     –
    saturated    no more than a limit, on either side of zero                         the limit; else the median
                                                                                      of what they read
    scaled       too much by a share                                                  the share, 0.05
    drifting     an error that grows by the same step in every row                    the step
    spike        one impossible value in that row only                                the value
    frozen       all columns, whatever is named, repeat the row before               –
    ============ ==================================================================== ==========================

    Parameters
    ----------
    readings
        Without a fault ``[t, s]``.
    fault
        One of the table.
    columns
        Readings that fail: one number, several for a whole chip, or a mask ``[s]``.
    since
        First row of the fault.
    size
        As the table says, in the unit of the readings.

    Raises
    ------
    InputError
        If there is no such fault, or it needs a size.

    Examples
    --------
    >>> u = np.arange(8.0).reshape(4, 2)
    >>> faulty(u, "stuck", 1, since=2)[:, 1]
    array([1., 3., 3., 3.])
    """
    owner = "faulty"
    require(fault in FAULTS, "fault", owner, f"one of {', '.join(FAULTS)}", repr(fault))
    u = numbers(readings, "readings", owner, (None, None), finite=False).copy()
    needs = fault in ("drifting", "spike")
    require(size is not None or not needs, "size", owner, f"given for {fault}", "nothing")
    chosen = np.zeros(u.shape[1], dtype=bool)
    chosen[columns] = True
    chosen |= fault == "frozen"
    late, before = u[since:, chosen], u[max(since - 1, 0), chosen]
    if fault == "spike":
        late[:1] = size
    elif fault == "saturated":
        limit = np.nanmedian(np.abs(u[:, chosen]), axis=0) if size is None else size
        late = np.clip(late, -limit, limit)
    else:
        steps = np.arange(1, len(late) + 1)[:, None]
        late = {
            "missing": np.full(late.shape, np.nan),
            "unplugged": np.full(late.shape, size or 0.0),
            "scaled": (1 + (0.05 if size is None else size)) * late,
            "drifting": late + (size or 0.0) * steps,
        }.get(fault, np.broadcast_to(before, late.shape))
    u[since:, chosen] = late
    return u


def _bounds(robot: Robot, owner: str) -> tuple[Array, Array, Array]:
    """Return middle and half width of the bounds of a robot, and where it starts."""
    if robot.lower is None or robot.upper is None:
        raise bad_input("robot", owner, "one with bounds", "none stated")
    middle = (robot.lower + robot.upper) / 2
    return middle, (robot.upper - robot.lower) / 2, middle if robot.start is None else robot.start


def spread_poses(robot: Robot, *, seed: int = 0) -> Array:
    """Return the start and configurations that fill the bounds evenly: eight for each coordinate, and at least 12."""
    middle, half, start = _bounds(robot, "spread_poses")
    n = max(12, 8 * int((~robot.fixed).sum()))
    cells = np.tile(np.arange(n - 1.0), (robot.n_q, 1))  # of a Latin hypercube
    away = 2 * (np.random.default_rng([seed, 4]).permuted(cells, axis=1).T + 0.5) / (n - 1) - 1
    return np.vstack([start, middle + REACH * half * away])


def held(poses: Array, hold_s: float, times: Array) -> Array:
    """Return configurations ``[t, n_q]`` of a robot that is held in each pose, and goes on to the next smoothly."""
    k, since_s = np.divmod(times, hold_s + MOVE_S)
    here, there = (poses[np.minimum(k.astype(int) + ahead, len(poses) - 1)] for ahead in (0, 1))
    s = np.clip((since_s - hold_s) / MOVE_S, 0.0, 1.0)[:, None]
    return here + (there - here) * s**3 * (10 - 15 * s + 6 * s**2)


def write_poses(path: Path, robot: Robot, poses: Array, hold_s: float) -> None:
    """Write the table of poses that are held to a new file: coordinates, and from when until when it stands."""
    units = robot.units
    names = [f"{name}_{unit}" for name, unit, _ in units]
    k = np.arange(len(poses))[:, None]
    windows = k * (hold_s + MOVE_S) + hold_s * np.array(WINDOW)
    table = np.hstack([poses * [factor for *_, factor in units], windows])
    with whole(path, "emulate") as part, part.open("w", encoding="utf-8") as file:
        np.savetxt(file, table, "%.6f", ",", header=",".join([*names, "start_s", "end_s"]), comments="")


def built(robot: Robot, tolerances: float, *, seed: int = 0) -> Robot:
    """Return a robot that was built from a drawing, and is off it by ``tolerances`` times what a calibration assumes.

    All magnets are stronger by one factor, that of their material. IMUs stay as they are.
    """
    fits = 0 <= tolerances <= 100 and not (tolerances and robot.model)
    require(fits, "tolerances", "emulate", "0 to 100, and 0 for a robot of networks", tolerances)
    if not tolerances or not robot.magnets:
        return robot
    stds = {name: std for name, std in priors_of(robot, Tolerances()).items() if "moment" not in name}
    stds["material"] = Tolerances().moments
    z = tolerances * np.random.default_rng([seed, 1]).standard_normal(len(stds))
    off = dict(zip(stds, z * list(stds.values()), strict=True))
    return placed(
        robot, off | {f"magnet {k + 1} polarisation": off["material"] for k in range(len(robot.magnets))}
    )


def faults_named(given: Faults, robot: Robot | None = None) -> dict[str, float]:
    """Return the values of all faults that the board of a robot, or of a recording, can have."""
    of_a_robot = {**dict.fromkeys(OF_SENSORS, 0.0), "magnet": 0.0, "noise": 1.0}
    found = OF_THE_LINE | (of_a_robot if robot else {})
    for name, value in dict(given).items():
        require(name in found, "fault", "emulate", f"one of {', '.join(found)}", name)
        if robot and name in OF_SENSORS:
            k = robot.part(value, "emulate")
            fits = k < len(robot.sensors) or name in ("stick", "unplug")
            require(fits, f"fault {name}", "emulate", "of a magnetic sensor", value)
            found[name] = k + 1.0
            continue
        found[name] = float(numbers(value, f"fault {name}", "emulate", ()))
        low, high = (-1e6 if name == "drift_ppm" else 0.0), (1.0 if name in CHANCES else 1e6)
        words = {"drift_ppm": "a number within 1e6 of zero"}.get(name, f"not negative, at most {high:g}")
        require(low <= found[name] <= high, f"fault {name}", "emulate", words, value)
    return found


def _fields(robot: Robot, q: Array) -> Array:
    """Return readings without noise ``[t, s]`` [mT, rad]."""
    gain, offset = robot.per_reading("gain", 1.0, 1.0), robot.per_reading("offset", 0.0, 0.0)
    return gain * simulated_readings(robot, q, robot.earth) + offset


def _blocks(
    robot: Robot, motion: Motion, rate_hz: float, faults: Mapping[str, float], since_s: float, seed: int
) -> Iterator[tuple[Array, Array]]:
    """Yield times [s] and readings ``[t, s]`` [mT, rad] of a robot in motion, with noise and faults of sensors."""
    rng, size = np.random.default_rng([seed, 2]), max(1, round(_AHEAD_S * rate_hz))
    noise = robot.per_reading("noise", 0.0, 0.0) if robot.noise is None else robot.noise
    # 1256.6 mT in a cube of 1 cm are 1 A m^2.
    foreign = Magnet(Cube(0.01, 1256.6), 0, 0.0, position=[faults["magnet"] / 1e3, 0.0, robot.length / 2])
    beside = robot.replaced(magnets=[*robot.magnets, foreign]) if faults["magnet"] else robot
    usual = np.median(np.abs(_fields(robot, motion(np.linspace(0.0, 60.0, 257)))), axis=0)
    step = np.where(robot.resolution > 0, robot.resolution, 1.0)
    before = None
    for k in count():
        times = np.arange(k * size, (k + 1) * size) / rate_hz
        q, late = motion(times), (times >= since_s - 1e-9)[:, None]
        u = np.where(late, _fields(beside, q), _fields(robot, q)) if faults["magnet"] else _fields(robot, q)
        u += np.where(late, faults["noise"], 1.0) * noise * rng.standard_normal(u.shape)
        u = np.concatenate([u[:1] if before is None else before, u])
        for name, fault in OF_SENSORS.items():
            if number := int(faults[name]):
                columns, imu = robot.parts == number - 1, number > len(robot.sensors)
                limit = usual[columns] if name == "saturate" else None
                fault = "missing" if name == "unplug" and imu else fault
                u = faulty(u, fault, columns, 1 + int((~late).sum()), limit)
        u = np.where(robot.resolution > 0, np.round(u / step) * step, u).clip(-robot.range, robot.range)
        before = u[-1:]
        yield times, u[1:]


def _channels(robot: Robot) -> list[int | str | None]:
    """Return the channel of each value of stream 0, None where a sensor states none: all but IMUs with a stream."""
    found = [x for sensor in robot.sensors for x in sensor.channels or [None] * sensor.axes]
    return found + [x for imu in robot.imus if isinstance(imu.channels, list | tuple) for x in imu.channels]


def _readings(
    robot: Robot, form: str, blocks: Iterable[tuple[Array, Array]]
) -> Iterator[tuple[float, int, Array]]:
    """Yield time, stream and values of readings."""
    n = robot.n_magnetic
    places = [x - 1 if isinstance(x, int) else k for k, x in enumerate(_channels(robot))]
    low, high, decimals = _CARRIED.get(form, (-math.inf, math.inf, 15))
    for times, u in blocks:
        values = np.zeros((len(u), max(places, default=-1) + 1))
        columns = [(u[:, :n] * robot.per_reading("per_mt", 1.0, 1.0)[:n]).clip(low, high).round(decimals)]
        streams = []
        for k, imu in enumerate(robot.imus):
            turns = u[:, n + 3 * k : n + 3 * k + 3]
            world = Rotation.from_quat([0, 0, 0, 1] if imu.world is None else imu.world)
            sent = (world * Rotation.from_rotvec(np.nan_to_num(turns))).as_quat()
            sent[np.isnan(turns[:, 0])] = np.nan
            if isinstance(imu.channels, list | tuple):
                columns.append(sent)
            else:
                streams.append((k + 1 if imu.channels is None else int(imu.channels), sent))
        values[:, places] = np.hstack(columns)
        streams += [(0, values)] if places else []  # last: beside what IMUs read at the same time
        for i, time_s in enumerate(times.tolist()):
            for stream, rows in streams:
                if rows is values or not np.isnan(rows[i, 0]):  # an IMU that is unplugged sends nothing
                    yield time_s, stream, rows[i]


def _recorded(recording: Recording, loop: bool) -> Iterator[tuple[float, int, Array]]:
    """Yield time, stream and values of a recording; in a loop it begins again one mean step after its end."""
    times = recording.times - recording.times[0]
    rows = len(set(times.tolist()))
    turn_s = times[-1] * rows / max(rows - 1, 1) or 1.0
    for turn in count() if loop else [0]:
        for time_s, sample in zip((times + turn * turn_s).tolist(), recording.samples, strict=True):
            yield time_s, sample.stream, sample.values


def _format(robot: Robot) -> str:
    """Return what the board of a robot sends: as its file says, else what carries its readings."""
    streams = any(not isinstance(imu.channels, list | tuple) for imu in robot.imus)
    fits = ("frames", *(["quaternions"] * (not robot.sensors))) if streams else FORMATS
    if robot.source is None:
        return "frames"
    form = robot.source.stream["format"] or ("csv" if not streams else fits[-1])
    words = f"one that carries the streams of IMUs: {' or '.join(fits)}"
    require(form in fits, "format", robot.source.name, words, form)
    return form


def board_bytes(
    source: Robot | Recording, *, rate_hz: float | None = None, motion: Motion | None = None,
    tolerances: float = 0.0, loop: bool = False, faults: Faults = (), fault_from: float = 0.0, seed: int = 0,
) -> Iterator[tuple[float, bytes]]:  # fmt: skip
    """Yield when a board sends [s], and what; no bytes at all: its port disappears until the next ones.

    Parameters
    ----------
    source
        A robot, whose file says format and rate of its board (frames without a file), or a recording.
    rate_hz
        Readings of a robot per second; as its file says if not given.
    motion
        From times [s] to configurations ``[t, n_q]`` of a robot, such as :func:`held` has them; by default it goes
        through its bounds for ever, as :func:`course` does.
    tolerances
        How far the robot is from its file: 0 as described, 1 as :func:`repro.calibrate` assumes.
    loop
        Begin a recording again at its end.
    faults
        Names and values, as ``{"flips": 1e-4, "unplug": 3}``: see ``OF_THE_LINE`` and, for a robot, ``OF_SENSORS``.
    fault_from
        When they begin [s]; the clock of the board drifts from the beginning.
    seed
        Of motion, noise, tolerances and faults: one seed, the same bytes.

    Raises
    ------
    InputError
        If an option does not fit the source, or it has no such fault.
    """
    require(0 <= fault_from < math.inf, "fault_from", "emulate", "0 or above [s]", fault_from)
    require(isinstance(seed, int) and seed >= 0, "seed", "emulate", "a whole number, 0 or above", seed)
    if not isinstance(source, Robot):
        fits = rate_hz is None and motion is None and not tolerances
        require(fits, "rate, hold_poses, tolerances", "emulate", "left out for a recording", "one of them")
        names = [f"{x}_{unit}" if unit else x for x, unit in zip(source.names, source.units, strict=True)]
        return _sent(
            _recorded(source, loop), str(source.format), names, faults_named(faults), fault_from, seed
        )
    rate = (source.rate_hz if rate_hz is None else rate_hz) or 0.0
    expected = f"above zero [Hz], here or in the robot file, and at most {_MOST_HZ:g}"
    require(0 < rate <= _MOST_HZ, "rate", "emulate", expected, rate_hz)
    fails, robot = faults_named(faults, source), built(source, tolerances, seed=seed)
    form = _format(source)
    carried = form in ("frames", "csv") or not fails["nan"]
    require(carried, "fault", "emulate", f"one that lines of {form} can carry", "nan")
    blocks = _blocks(robot, motion or partial(course, source, seed=seed), rate, fails, fault_from, seed)
    names = [x for x in _channels(source) if isinstance(x, str)]
    return _sent(_readings(source, form, blocks), form, names, fails, fault_from, seed)


def _sent(
    readings: Iterable[tuple[float, int, Array]], form: str, names: Sequence[str], faults: Mapping[str, float],
    since_s: float, seed: int,
) -> Iterator[tuple[float, bytes]]:  # fmt: skip
    """Yield the bytes of readings as a board and its line leave them, and when."""
    rng, sent = np.random.default_rng([seed, 3]), dict[int, int]()
    chances = [faults["stalls"], faults["disconnects"], faults["reboots"]]
    tick, booted_s, back_s, late_s = 1e6 * (1 + 1e-6 * faults["drift_ppm"]), 0.0, 0.0, 0.0
    # A board prints the names of its columns, if it knows any, when it starts.
    header = f"\r\n{','.join(names)}\r\n".encode() if names and form == "csv" else b""
    for time_s, stream, values in readings:
        number = sent.get(stream, 0)
        sent[stream] = number + (time_s >= booted_s)
        if time_s < max(booted_s, back_s):
            continue
        clock_us = round((time_s - booted_s) * tick)
        data = (
            encode(values, stream, number, clock_us) if form == "frames" else text_line(values, form, stream)
        )
        data = data if number else header + data
        stalls, leaves, reboots = (rng.random(3) < chances) if time_s >= since_s else (False, False, False)
        if time_s >= since_s:
            data = _damaged(data[: rng.integers(1, len(data))] if leaves or reboots else data, faults, rng)
        late_s = time_s + faults["stall_s"] if stalls else late_s
        back_s = time_s + faults["away_s"] if leaves else back_s
        if reboots:
            booted_s, sent = time_s + faults["boot_s"], {}
        if data:
            yield max(time_s, late_s), data
        if leaves:
            yield max(time_s, late_s), b""


def _damaged(data: bytes, faults: Mapping[str, float], rng: np.random.Generator) -> bytes:
    """Return what arrives of bytes that are sent over a bad line."""
    sent = np.frombuffer(data, np.uint8).copy()
    hit = {x: rng.random(len(sent)) < faults[x] for x in ("flips", "drops", "duplicates", "bursts")}
    for k in np.flatnonzero(hit["bursts"]):
        burst = sent[k : k + int(faults["burst_bytes"])]
        burst[:] = rng.integers(0, 256, len(burst))
    sent[hit["flips"]] ^= np.uint8(1) << rng.integers(0, 8, int(hit["flips"].sum()), dtype=np.uint8)
    return np.repeat(sent, np.where(hit["drops"], 0, 1 + hit["duplicates"])).tobytes()


class Emulator:
    """Plays what :func:`board_bytes` yields into a port: in a ``with`` statement, in a thread of its own.

    ``link`` is the number of a TCP port of this computer, 0 for a free one, or the name of a symbolic link to a
    pseudo-terminal, which goes and comes back with it. The board is switched on when a reader opens the port; a slow
    one holds it up. While nobody has it open, a board in real time goes on, and one as fast as it is read
    (``speed`` infinite) waits. At the end the port stays until the reader leaves.
    """

    def __init__(
        self, sent: Iterable[tuple[float, bytes]], link: Path | str | int = 0, *, speed: float = 1.0
    ) -> None:
        self._sent, self._speed, self._listener, self._port = sent, speed, None, -1
        self._failure: Exception | None = None
        self.ended, self._stopped = threading.Event(), threading.Event()
        """The port is gone."""
        self.address = str(Path(str(link)).absolute())
        """What to open: the path of a pseudo-terminal, or ``socket://...``."""
        if isinstance(link, int):
            require(0 <= link < 65536, "socket", "emulate", "a free port, 0 to 65535", link)
            try:
                self._listener = create_server(("127.0.0.1", link))
            except OSError as error:
                raise bad_input("socket", "emulate", "a free port", f"{link}: {error.strerror}") from error
            self._listener.setblocking(False)
            self.address = f"socket://127.0.0.1:{self._listener.getsockname()[1]}"
        elif Path(link).exists() and not Path(link).is_symlink():
            raise bad_input("port_file", "emulate", "a new name, or that of an earlier port", link)
        elif not Path(self.address).parent.is_dir():
            raise bad_input("port_file", "emulate", "in a folder that exists", link)
        self._appear()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> Emulator:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stopped.set()
        self._thread.join()
        if self._failure is not None:
            raise self._failure

    def _appear(self) -> None:
        if self._listener is None:
            self._port, reader = os.openpty()
            os.set_blocking(self._port, False)
            tty.setraw(reader)
            Path(self.address).unlink(missing_ok=True)
            Path(self.address).symlink_to(os.ttyname(reader))
            os.close(reader)  # from now on it hangs up whenever nobody has it open

    def _vanish(self) -> None:
        if self._listener is None:
            Path(self.address).unlink(missing_ok=True)
        if self._port >= 0:
            os.close(self._port)
        self._port = -1

    def _has_reader(self) -> bool:
        """Whether somebody has the port open; what a reader writes is not for us."""
        if self._listener is not None and self._port < 0:
            with contextlib.suppress(BlockingIOError):
                self._port = self._listener.accept()[0].detach()
                os.set_blocking(self._port, False)
        try:
            there = os.read(self._port, 4096) != b""
        except BlockingIOError:
            there = True
        except OSError:
            there = False
        if not there and self._listener is not None:
            self._vanish()
        return there

    def _run(self) -> None:
        try:
            self._play()
            while self._has_reader() and not self._stopped.wait(_POLL_S):
                pass
        except Exception as error:  # the thread that made the board raises it
            self._failure = error
        finally:
            self._vanish()
            if self._listener is not None:
                self._listener.close()
            self.ended.set()

    def _play(self) -> None:
        while not self._has_reader() and not self._stopped.wait(_POLL_S):
            pass
        self._stopped.wait(_SETTLE_S)
        began_s = time.monotonic()
        for time_s, data in self._sent:
            left = memoryview(data)
            self._stopped.wait(max(0.0, began_s + time_s / self._speed - time.monotonic()))
            if self._stopped.is_set():
                return
            if not data:
                self._stopped.wait(_POLL_S)  # for a reader to take the last bytes
                self._vanish()
            elif self._port < 0:
                self._appear()
            while left and not self._stopped.is_set():
                if self._has_reader():
                    select.select([], [self._port], [], _POLL_S)
                    with contextlib.suppress(OSError):  # it is full, or the reader has just left
                        left = left[os.write(self._port, left) :]
                elif self._speed < math.inf or self._stopped.wait(_POLL_S):
                    break


def emulate(
    source: Path, link: Path | str | int = 0, *, rate_hz: float | None = None, speed: float = 1.0,
    loop: bool = False, tolerances: float = 0.0, hold_poses: Path | None = None, hold_s: float | None = None,
    faults: Faults = (), fault_from: float = 0.0, seed: int = 0,
) -> int:  # fmt: skip
    """Play a robot file (``.toml``) or a recording into a port until somebody stops it; say what it is and where.

    With ``hold_poses`` the robot is held for ``hold_s`` (2 s if not given) in one pose after the other, and these are
    written to that new table; it stays in the last one. All else is as of :func:`board_bytes` and :class:`Emulator`.
    """
    require(speed > 0, "speed", "emulate", "above zero", speed)
    require(hold_s is None or hold_poses, "hold", "emulate", "left out without hold_poses", hold_s)
    robot = load_robot(source) if Path(source).suffix == ".toml" else None
    require(robot or not hold_poses, "hold_poses", "emulate", "left out for a recording", hold_poses)
    require(not (robot and loop), "loop", "emulate", "left out for a robot, which moves for ever", loop)
    require(faults or not fault_from, "fault_from", "emulate", "left out without a fault", fault_from)
    hold_s = 2.0 if hold_s is None else hold_s
    require(0 < hold_s < math.inf, "hold", "emulate", "above zero [s]", hold_s)
    poses = spread_poses(robot, seed=seed) if robot and hold_poses else None
    sent = board_bytes(
        robot or read_recording(source), rate_hz=rate_hz, tolerances=tolerances, loop=loop, faults=faults,
        motion=None if poses is None else partial(held, poses, hold_s), fault_from=fault_from, seed=seed,
    )  # fmt: skip
    first = next(sent)  # what cannot be sent is refused before there is a port
    board = Emulator(chain([first], sent), link, speed=speed)
    with stopping(board.ended), board:
        if robot and hold_poses and poses is not None:
            write_poses(hold_poses, robot, poses, hold_s)
        print(f"{Path(source).name}{', SYNTHETIC' if robot else ''}\nPort: {board.address}", flush=True)
        while not board.ended.is_set():  # in short sleeps: a signal must not find a wait with its lock
            time.sleep(_POLL_S)
    return 0
