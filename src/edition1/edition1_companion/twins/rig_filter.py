r"""Ours for the rig of Baaij et al. 2023, section 5: bend, elongation and bias, from readings alone.

A map from bend to readings, polynomial in :math:`(\Delta_x, \Delta_y)`, is fitted to T5.train by linear least squares
(`edition1_companion.twins.rig_map`). A recording then has a bias :math:`c`, common to the three sensors and
constant, and each sensor an error :math:`e` that comes and goes:

.. math:: u_t = h(\Delta_{x,t}, \Delta_{y,t}) + c\,(1, 1, 1)^T + e_t + w_t .

The bend moves with white acceleration, :math:`e` is a Gauss-Markov process, :math:`w` white noise; their sizes are
those of T5.train. For each of some values of :math:`c` an iterated Kalman filter follows bend, rate and :math:`e`;
the values are weighted by their prior and by the likelihood of all readings up to the present frame; the estimate is
the mean of the mixture. A single filter with :math:`c` in its state loses the bend where the map is folded: each
linearisation adds information on :math:`c` that is not there. Values held fixed do not.

By the drawing, elongation moves the three readings alike, by :math:`g \approx 52` mV/mm: the readings do not tell
it from the bias. With the priors :math:`b \sim N(0, \sigma_b^2)` of the bias proper and
:math:`\Delta_L \sim N(\bar\Delta_L, \sigma_L^2)`, :math:`c = b + g\,(\Delta_L - \bar\Delta_L)` is split as the
priors demand; :math:`\bar\Delta_L = a_0 + a_1 (\Delta_x^2 + \Delta_y^2)` is fitted to T5.train and leaves
:math:`\sigma_L`. The covariance adds what T5 cannot show: other recordings differ from it in shape and elongation.

The residual at the estimate, in units of the error of the map, tells where the bend is lost. After :data:`LASTING`
frames above :data:`RESIDUAL` a new bank starts at the first of them, by the search of frame 0. It is taken if it
halves the residual and ends elsewhere; else the filter goes on, and its frames are *suspicious*.
Where nothing is lost, but the readings have become another function of the bend, a new start fits better near the
old one, and may err more: hence "elsewhere", added after a look at the random twins of seeds 0 to 23.

The bank was preferred to a single filter, and its settings were looked at, on random twins of seeds 1000 to 1003,
which no page shows: half and twice the prior of the bias, or half the distance between its values, change the mean
error there by less than 3 %.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import Generic, TypeVar

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from edition1.estimation.base import Estimate, Trajectory, check_start, track, usable
from edition1.estimation.consistency import WINDOW, Status
from edition1_companion.recordings.rig_robot import RIG_RATE_HZ, RIG_SENSORS
from edition1_companion.twins.rig_bank import BankState, BendBank, OursConfig
from edition1_companion.twins.rig_map import BendMap

_M = TypeVar("_M")

RESIDUAL = 4.0
"""Root mean square over the sensors, in units of the error of the map: above it, something is wrong."""
LASTING = 20
"""So many frames in a row above it, and a new start is searched; and again after as many."""
ELSEWHERE_MM = 5.0
"""A new start ends elsewhere if its bend is farther from the old one [mm]: what the page calls lost."""


@dataclass(frozen=True)
class BatchState(Generic[_M]):
    """The newest estimate, and the filter of each member of the batch, which all run on their own."""

    q: Float[Tensor, "*batch n_q"]
    members: tuple[_M, ...]


def batch_of(member: _M, q0: Float[Tensor, "*batch n_q"], owner: str) -> BatchState[_M]:
    """State before the first readings, the same for all members of the batch of ``q0``."""
    check_start(q0, None, owner, n_q=3)
    return BatchState(q0, (member,) * math.prod(q0.shape[:-1]))


def sensor_rows(u: Tensor, use: Tensor) -> Float[np.ndarray, "members 3"]:
    """Readings of each member of a batch, NaN where they are not used."""
    return torch.where(use, u, torch.nan).detach().double().reshape(-1, RIG_SENSORS).numpy()


@dataclass(frozen=True)
class _Watched:
    """A bank, what is held against it, and the newest readings with the square that was left of each."""

    bank: BankState
    recent: tuple[tuple[Float[np.ndarray, " 3"], float], ...] = ()
    lasting: int = 0
    since: int = WINDOW
    anew: int = 0

    @property
    def status(self) -> Status:
        doubtful = self.lasting >= LASTING or self.since < WINDOW
        return Status.SUSPICIOUS if doubtful else Status.CONSISTENT


@dataclass(frozen=True)
class BendFilter:
    """Ours as an estimator: readings [mV], 40 Hz, to bend and elongation [m], with the common bias beside them.

    Parameters
    ----------
    bend_map
        From :func:`~edition1_companion.twins.rig_map.fit_map`.
    config
        Settings.
    """

    bend_map: BendMap
    config: OursConfig = field(default_factory=OursConfig)

    @cached_property
    def _bank(self) -> BendBank:
        return BendBank(self.bend_map, self.config)

    def init(self, q0: Float[Tensor, "*batch n_q"], *, seed: int = 0) -> BatchState[_Watched]:
        """State before the first readings, which alone say where it starts: of ``q0`` only the batch counts."""
        return batch_of(_Watched(self._bank.start()), q0, "BendFilter")

    def step(
        self,
        state: BatchState[_Watched],
        u: Float[Tensor, "*batch 3"],
        t: float,
        *,
        mask: Tensor | None = None,
        known: Tensor | None = None,
    ) -> tuple[BatchState[_Watched], Estimate]:
        """Take in the next readings; beside those of :meth:`BendBank.estimate` two diagnostics.

        ``status`` is a number of :class:`edition1.estimation.consistency.Status`: *suspicious* while no new start
        explains the readings, and just after one; ``anew`` how often the filter was started anew.
        """
        use = usable(u, mask, "BendFilter")
        members = tuple(map(self._watched, state.members, sensor_rows(u, use)))
        found = self._bank.estimate(
            [member.bank for member in members],
            u,
            use,
            known,
            status=[member.status for member in members],
            anew=[member.anew for member in members],
        )
        return BatchState(found.q.to(state.q), members), found

    def _watched(self, old: _Watched, reading_mv: np.ndarray) -> _Watched:
        """A member after the next reading, started anew if that explains the newest ones much better."""
        bank = self._bank.step(old.bank, reading_mv)
        recent = (*old.recent, (reading_mv, bank.square))[-LASTING:]
        lasting = old.lasting + 1 if bank.square > RESIDUAL**2 else 0
        if lasting and lasting % LASTING == 0:
            fresh, squares = self._bank.start(), []
            for reading, _ in recent:
                fresh = self._bank.step(fresh, reading)
                squares.append(fresh.square)
            better = np.mean(squares) < 0.25 * np.mean([was for _, was in recent])
            if better and np.hypot(*(fresh.mean_mm - bank.mean_mm)[:2]) > ELSEWHERE_MM:
                return _Watched(fresh, recent, since=0, anew=old.anew + 1)
        return _Watched(bank, recent, lasting, old.since + 1, old.anew)


def filtered(
    bend_map: BendMap, readings_mv: Float[np.ndarray, "t 3"], config: OursConfig | None = None
) -> Trajectory:
    """Ours on a whole recording; of it the readings alone."""
    q0 = torch.zeros(3, dtype=torch.float64)
    ours = BendFilter(bend_map, config or OursConfig())
    return track(ours, torch.from_numpy(readings_mv), q0, rate_hz=RIG_RATE_HZ)
