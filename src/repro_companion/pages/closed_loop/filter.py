r"""Ours for a loop, which knows its commands: the lag of the readings, and a motion model with the command as input.

Beside :class:`~repro_companion.twins.rig_filter.BendFilter`, and around it, so that its bank of filters stays
what it is; with the numbers of `repro_companion.pages.closed_loop.identification`:

* **The lag.** From a reading, the lag :math:`\ell` at the predicted bend is taken off before the update. Its error, a
  share :math:`\rho` of it, is added to the noise of the reading, and fades with the lag of the segment. When exactly
  a command takes effect is not known to a few milliseconds: the share is that of the larger lag, with the command up
  to the reading or with the one that follows.
* **The command.** Instead of moving at a constant velocity, the bend is expected at :math:`f(s)`, plus a rest
  :math:`\delta` that relaxes, :math:`x_k = f(s_k) + e^{-\tau/T_\delta} (x_{k-1} - f(s_{k-1}))`.

Without a lag and without the command it is the filter of Table 2, to the bit. Neither is an estimator of the library:
what was commanded is an input beside the readings.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float

from repro_companion.pages.closed_loop.identification import Segment
from repro_companion.recordings.rig_robot import RIG_RATE_HZ, RIG_SENSORS
from repro_companion.twins.rig_filter import BendFilter, BendState
from repro_companion.twins.rig_map import BendMap

REST_MM = 0.5
"""Standard deviation of the rest in the filter [mm]. In the experiment it is a fraction of that, but a rig may have
changed since: chosen on a twin that had become softer, with references and seeds that are not judged."""
STILL = 1e-3
"""Rate [mm/s] and density of acceleration [mm/s^1.5] of the rest, in effect none: it moves as it relaxes."""


@dataclass(frozen=True)
class LoopState:
    """The filter after a reading; no array is ever changed.

    Attributes
    ----------
    bank
        Of the bank of filters.
    torque
        Commanded torque after its lag.
    lag_mv
        Size of the lag of each sensor whose error has not faded yet.
    """

    bank: BendState
    torque: Float[np.ndarray, " 2"]
    lag_mv: Float[np.ndarray, " 3"]

    @property
    def bend_mm(self) -> Float[np.ndarray, " 2"]:
        """Bend after the newest reading [mm], the mean of all filters; NaN before the first."""
        return self.bank.bend_mm


@dataclass(frozen=True)
class LoopFilter:
    """Ours with the lag of the readings, and with the command as input if wished.

    Parameters
    ----------
    bend_map
        Readings by bend.
    segment
        How the segment follows its commands.
    follows
        Whether the bend is expected to follow the command; otherwise it moves as in the filter of Table 2.
    rest_mm
        Standard deviation of the rest [mm].
    """

    bend_map: BendMap
    segment: Segment
    follows: bool
    rest_mm: float = REST_MM

    @cached_property
    def _map(self) -> BendMap:
        known = replace(self.bend_map, error_mv=self.segment.error_mv)
        return replace(known, acceleration=STILL, rate=STILL) if self.follows else known

    def init(self) -> LoopState:
        """State before the first reading, after a long time without torque."""
        return LoopState(BendFilter(self._map).init(), np.zeros(2), np.zeros(RIG_SENSORS))

    def step(
        self,
        state: LoopState,
        reading_mv: Float[np.ndarray, " 3"],
        torque: Float[np.ndarray, " 2"],
        following: Float[np.ndarray, " 2"],
    ) -> LoopState:
        """State after the next reading, 40 Hz.

        Parameters
        ----------
        state
            After the reading before.
        reading_mv
            The reading.
        torque
            Commanded from the reading before to this one: over the reference, turned to where it bends.
        following
            Commanded from this reading to the next.
        """
        segment, dt = self.segment, 1.0 / RIG_RATE_HZ
        s = torque + (state.torque - torque) * segment.fading
        bank = self._moved(state.bank, state.torque, s) if self.follows else state.bank
        bend, rate = bank.mean_mm[:2], bank.mean_mm[2:]
        expected = (bend + dt * rate)[None] if bank.frame else segment.bend_mm(s[None])
        rates = (np.stack([torque, following]) - s) / segment.lag_s
        lag, ahead = segment.lag_mv(np.stack([s, s]), rates, np.repeat(expected, 2, axis=0))
        # A jump that counts a few milliseconds early would otherwise be taken for a bend, and for a bias.
        size = np.maximum(np.maximum(np.abs(lag), np.abs(ahead)), segment.fading * state.lag_mv)
        noise = np.hypot(self._map.noise_mv, segment.share * size)
        bank = BendFilter(replace(self._map, noise_mv=noise)).step(bank, reading_mv - lag)
        return LoopState(bank, s, size)

    def _moved(self, bank: BendState, before: np.ndarray, now: np.ndarray) -> BendState:
        """Move all filters with the command, up to the next reading."""
        if bank.frame == 0:
            return bank
        segment = self.segment
        old, new = segment.bend_mm(np.stack([before, now]))
        kept = float(np.exp(-1.0 / RIG_RATE_HZ / segment.apart_s))
        states, moments, mean = bank.states.copy(), bank.moments.copy(), bank.mean_mm.copy()
        states[:, :2] = new + kept * (states[:, :2] - old)
        mean[:2] = new + kept * (mean[:2] - old)
        moments[:, :2] *= kept
        moments[:, :, :2] *= kept
        moments[:, :2, :2] += self.rest_mm**2 * (1.0 - kept**2) * np.eye(2)
        return replace(bank, states=states, moments=moments, mean_mm=mean)


@dataclass(frozen=True)
class CommandState:
    """Commanded torque after its lag, and the bend that it lets expect [mm]."""

    torque: Float[np.ndarray, " 2"]
    bend_mm: Float[np.ndarray, " 2"]


@dataclass(frozen=True)
class CommandAlone:
    """What the command lets expect: it is told the readings, and does not use them."""

    segment: Segment

    def init(self) -> CommandState:
        """State after a long time without torque."""
        return CommandState(np.zeros(2), self.segment.bend_mm(np.zeros((1, 2)))[0])

    def step(
        self,
        state: CommandState,
        reading_mv: Float[np.ndarray, " 3"],
        torque: Float[np.ndarray, " 2"],
        following: Float[np.ndarray, " 2"],
    ) -> CommandState:
        """State after the next reading, 40 Hz."""
        s = torque + (state.torque - torque) * self.segment.fading
        return CommandState(s, self.segment.bend_mm(s[None])[0])
