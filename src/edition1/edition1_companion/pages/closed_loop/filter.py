r"""Ours for a loop, which knows its commands: the lag of the readings, and a motion model with the command as input.

Beside :class:`~edition1_companion.twins.rig_filter.BendFilter`, and around its bank of filters, which stays what it is;
with the numbers of `edition1_companion.pages.closed_loop.identification`:

* **The lag.** From a reading, the lag :math:`\ell` at the predicted bend is taken off before the update. Its error, a
  share :math:`\rho` of it, is added to the noise of the reading, and fades with the lag of the segment. When exactly
  a command takes effect is not known to a few milliseconds: the share is that of the larger lag, with the command up
  to the reading or with the one that follows.
* **The command.** Instead of moving at a constant velocity, the bend is expected at :math:`f(s)`, plus a rest
  :math:`\delta` that relaxes, :math:`x_k = f(s_k) + e^{-\tau/T_\delta} (x_{k-1} - f(s_{k-1}))`.

Without a lag and without the command it is the filter of Table 2, to the bit, up to a new start. Both are estimators
of readings beside which the commands stand: three readings [mV], the torque commanded from the reading before to this
one, and the torque commanded from this one to the next; over the reference, turned to where it bends.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from edition1.estimation.base import Estimate, held, usable
from edition1_companion.pages.closed_loop.identification import Segment
from edition1_companion.recordings.rig_robot import RIG_RATE_HZ, RIG_SENSORS
from edition1_companion.twins.rig_bank import BankState, BendBank
from edition1_companion.twins.rig_filter import BatchState, batch_of, sensor_rows
from edition1_companion.twins.rig_map import BendMap

REST_MM = 0.5
"""Standard deviation of the rest in the filter [mm]. In the experiment it is a fraction of that, but a rig may have
changed since: chosen on a twin that had become softer, with references and seeds that are not judged."""
STILL = 1e-3
"""Rate [mm/s] and density of acceleration [mm/s^1.5] of the rest, in effect none: it moves as it relaxes."""


@dataclass(frozen=True)
class Following:
    """A bank of filters that knows the commands, after a reading; no array is ever changed.

    Attributes
    ----------
    bank
        The bank.
    torque
        Commanded torque after its lag.
    lag_mv, size_mv
        Lag that was taken off the reading, and the size of that of each sensor whose error has not faded yet.
    """

    bank: BankState
    torque: Float[np.ndarray, " 2"]
    lag_mv: Float[np.ndarray, " 3"]
    size_mv: Float[np.ndarray, " 3"]


@dataclass(frozen=True)
class LoopFilter:
    """Ours with the lag of the readings, and with the command as input if wished, as an estimator at 40 Hz.

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
    def _bank(self) -> BendBank:
        known = replace(self.bend_map, error_mv=self.segment.error_mv)
        return BendBank(replace(known, acceleration=STILL, rate=STILL) if self.follows else known)

    def init(self, q0: Float[Tensor, "*batch n_q"], *, seed: int = 0) -> BatchState[Following]:
        """State before the first readings, after a long time without torque; of ``q0`` only the batch counts."""
        return batch_of(Following(self._bank.start(), np.zeros(2), *np.zeros((2, 3))), q0, "LoopFilter")

    def step(
        self,
        state: BatchState[Following],
        u: Float[Tensor, "*batch 7"],
        t: float,
        *,
        mask: Tensor | None = None,
        known: Tensor | None = None,
    ) -> tuple[BatchState[Following], Estimate]:
        """Take in the next readings and commands; diagnostics are those of the bank."""
        u, commands = _apart(u)
        use = usable(u, mask, "LoopFilter")
        members = tuple(map(self._after, state.members, sensor_rows(u, use), commands))
        lag_mv = np.stack([member.lag_mv for member in members])
        found = self._bank.estimate([member.bank for member in members], u, use, known, lag_mv=lag_mv)
        return BatchState(found.q.to(state.q), members), found

    def _after(self, old: Following, reading_mv: np.ndarray, commands: np.ndarray) -> Following:
        """A member after the next reading."""
        segment, dt = self.segment, 1.0 / RIG_RATE_HZ
        s = commands[0] + (old.torque - commands[0]) * segment.fading
        bank = self._moved(old.bank, old.torque, s) if self.follows else old.bank
        bend, rate = bank.mean_mm[:2], bank.mean_mm[2:]
        expected = (bend + dt * rate)[None] if bank.frame else segment.bend_mm(s[None])
        rates = (commands - s) / segment.lag_s
        lag, ahead = segment.lag_mv(np.stack([s, s]), rates, np.repeat(expected, 2, axis=0))
        # A jump that counts a few milliseconds early would otherwise be taken for a bend, and for a bias.
        size = np.maximum(np.maximum(np.abs(lag), np.abs(ahead)), segment.fading * old.size_mv)
        noise = np.hypot(self.bend_map.noise_mv, segment.share * size)
        return Following(self._bank.step(bank, reading_mv - lag, noise), s, lag, size)

    def _moved(self, bank: BankState, before: np.ndarray, now: np.ndarray) -> BankState:
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
class CommandAlone:
    """What the command lets expect, as an estimator: it is told the readings, and does not use them."""

    bend_map: BendMap
    segment: Segment

    def init(self, q0: Float[Tensor, "*batch n_q"], *, seed: int = 0) -> BatchState[Float[np.ndarray, " 2"]]:
        """State after a long time without torque: the torque after its lag; of ``q0`` only the batch counts."""
        return batch_of(np.zeros(2), q0, "CommandAlone")

    def step(
        self,
        state: BatchState[Float[np.ndarray, " 2"]],
        u: Float[Tensor, "*batch 7"],
        t: float,
        *,
        mask: Tensor | None = None,
        known: Tensor | None = None,
    ) -> tuple[BatchState[Float[np.ndarray, " 2"]], Estimate]:
        """Take in the next commands; ``torque`` in the diagnostics is the commanded one after its lag."""
        u, commands = _apart(u)
        use, torque = usable(u, mask, "CommandAlone"), commands[:, 0]
        s = torque + (np.stack(state.members) - torque) * self.segment.fading
        shape = u.shape[:-1]
        bend = np.concatenate([self.segment.bend_mm(row[None]) for row in s])
        q = 1e-3 * np.column_stack([bend, self.bend_map.elongation(bend)])
        u_hat = torch.from_numpy(self.bend_map(bend)).to(u).reshape(u.shape)
        unit = torch.from_numpy(np.hypot(self.bend_map.noise_mv, self.bend_map.error_mv))
        used = use.sum(-1)
        diagnostics = {
            "masked": RIG_SENSORS - used,
            "chi2": torch.where(use, (u - u_hat) / unit, 0.0).square().sum(-1),
            "dof": used,
            "bend_mm": torch.from_numpy(bend).to(u).reshape(*shape, 2),
            "torque": torch.from_numpy(s).to(u).reshape(*shape, 2),
        }
        q, _ = held(torch.from_numpy(q).to(u).reshape(*shape, 3), known)
        return BatchState(q.to(state.q), tuple(s)), Estimate(q, None, u_hat, diagnostics)


def _apart(
    u: Float[Tensor, "*batch 7"],
) -> tuple[Float[Tensor, "*batch 3"], Float[np.ndarray, "members 2 2"]]:
    """Readings, and of each member the torque up to this reading and from it."""
    readings, commands = u.split([RIG_SENSORS, 4], dim=-1)
    return readings, commands.double().reshape(-1, 2, 2).numpy()
