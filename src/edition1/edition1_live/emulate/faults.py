"""Faults of a serial line and of the board behind it; seeded, so that every run of a test meets the same ones."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Int

from edition1.errors import bad_input, require

_CHANCES = ("flips", "drops", "duplicates", "bursts", "stalls", "disconnects", "reboots")
"""Those of :class:`Faults` that are chances."""
NUMBERED = ("unplug", "stick", "saturate", "gain", "nan")
"""Faults of a sensor, whose value is its number."""


@dataclass(frozen=True)
class Faults:
    """What goes wrong, and how often; by default nothing.

    Parameters
    ----------
    flips, drops, duplicates
        Chance of each byte that one of its bits flips, that it is lost, that it comes twice.
    bursts
        Chance of each byte that from it on ``burst_bytes`` are replaced by noise.
    burst_bytes
        Length of a burst [bytes].
    stalls
        Chance of each frame that it and what follows is held back for ``stall_s``, and comes then.
    stall_s
        Length of a stall [s].
    disconnects
        Chance of each frame that the port closes in the middle of it and is away for ``away_s``. The board goes on:
        what it sends meanwhile is lost.
    away_s
        How long the port is away [s].
    reboots
        Chance of each frame that the board breaks off in the middle of it and starts anew: silent for ``boot_s``, its
        sequence numbers and its clock begin at zero. The port stays.
    boot_s
        How long a start takes [s].
    drift_ppm
        By how much the board's clock is fast [parts per million].

    Raises
    ------
    InputError
        If a chance is not from 0 to 1, a time is negative, or a burst has no byte.
    """

    flips: float = 0.0
    drops: float = 0.0
    duplicates: float = 0.0
    bursts: float = 0.0
    burst_bytes: int = 32
    stalls: float = 0.0
    stall_s: float = 1.0
    disconnects: float = 0.0
    away_s: float = 1.0
    reboots: float = 0.0
    boot_s: float = 0.5
    drift_ppm: float = 0.0

    def __post_init__(self) -> None:
        for name in _CHANCES:
            if not 0 <= getattr(self, name) <= 1:
                raise bad_input(name, "Faults", "a chance from 0 to 1", getattr(self, name))
        for name in ("stall_s", "away_s", "boot_s"):
            if not 0 <= getattr(self, name) < math.inf:
                raise bad_input(name, "Faults", "a time of 0 or more [s]", getattr(self, name))
        require(self.burst_bytes >= 1, "burst_bytes", "Faults", "1 or more", self.burst_bytes)
        if not abs(self.drift_ppm) < 1e6:
            raise bad_input("drift_ppm", "Faults", "between -1e6 and 1e6 [parts per million]", self.drift_ppm)


class Damaged(NamedTuple):
    """What arrives of some packets.

    Attributes
    ----------
    data
        The bytes, in order.
    ends
        Where in `data` what is left of each packet ends.
    whole
        Whether all bytes of the packet are there, unchanged, and no other between them.
    closed
        Whether its last byte arrived unchanged.
    """

    data: bytes
    ends: Int[np.ndarray, " packets"]
    whole: Bool[np.ndarray, " packets"]
    closed: Bool[np.ndarray, " packets"]


def damage(packets: Sequence[bytes], faults: Faults, rng: np.random.Generator) -> Damaged:
    """Send packets over a line with flips, drops, duplicates and bursts.

    Noise that happens to equal what it replaces changes nothing. A last byte that comes twice leaves its packet
    whole.

    Parameters
    ----------
    packets
        One after the other, none of them empty.
    faults
        Of which those of the bytes are used.
    rng
        Source of the random numbers.

    Examples
    --------
    >>> damage([b"abc", b"de"], Faults(), np.random.default_rng(0)).data
    b'abcde'
    """
    sent = np.frombuffer(b"".join(packets), np.uint8)
    ends = np.cumsum(np.fromiter(map(len, packets), np.intp, len(packets)))
    whole, closed = np.ones(len(packets), bool), np.ones(len(packets), bool)
    if not (faults.flips or faults.drops or faults.duplicates or faults.bursts):
        return Damaged(sent.tobytes(), ends, whole, closed)

    def drawn(chance: float) -> np.ndarray:
        return rng.integers(0, len(sent), rng.binomial(len(sent), chance))

    data = sent.copy()
    for start in drawn(faults.bursts):
        run = data[start : start + faults.burst_bytes]
        run[:] = rng.integers(0, 256, len(run), dtype=np.uint8)
    flipped = drawn(faults.flips)
    data[flipped] ^= np.uint8(1) << rng.integers(0, 8, len(flipped), dtype=np.uint8)
    twice, lost = drawn(faults.duplicates), drawn(faults.drops)
    copies = np.ones(len(sent), np.intp)
    copies[twice] = 2
    copies[lost] = 0

    last = ends - 1
    between = twice[~np.isin(twice, last)]  # a copy of the last byte lies behind the packet
    touched = np.concatenate([np.flatnonzero(data != sent), lost, between])
    whole[np.searchsorted(ends, touched, side="right")] = False
    closed[:] = (data[last] == sent[last]) & (copies[last] > 0)
    return Damaged(np.repeat(data, copies).tobytes(), np.cumsum(copies)[last], whole, closed)


def faults_named(given: Iterable[tuple[str, str]], *kinds: type) -> tuple[Any, ...]:
    """Return faults of each kind, from names and values as typed.

    Parameters
    ----------
    given
        Names of :class:`Faults` or :class:`~edition1_live.emulate.sensor_faults.SensorFaults`, and their values.
    kinds
        Which of the two there may be.

    Raises
    ------
    InputError
        If there is no such fault, it occurs twice, or its value is not a number that it can have.

    Examples
    --------
    >>> faults_named([("flips", "1e-4")], Faults)  # doctest: +ELLIPSIS
    (Faults(flips=0.0001, drops=0.0, ...),)
    """
    known = {field.name: (kind, type(field.default)) for kind in kinds for field in fields(kind)}
    values: dict[type, dict[str, float]] = {kind: {} for kind in kinds}
    for name, text in given:
        require(name in known, "fault", "repro emulate", f"one of {', '.join(known)}", name)
        kind, number = known[name]
        require(name not in values[kind], "fault", "repro emulate", "given once", f"{name} twice")
        must_be = "a whole number" if number is int else "a number"
        if name in NUMBERED:
            must_be = "the number of a sensor, from 1"
        try:
            values[kind][name] = number(text)
        except ValueError as error:
            raise bad_input(name, "repro emulate", must_be, repr(text)) from error
        require(name not in NUMBERED or values[kind][name] >= 1, name, "repro emulate", must_be, repr(text))
    return tuple(kind(**values[kind]) for kind in kinds)
