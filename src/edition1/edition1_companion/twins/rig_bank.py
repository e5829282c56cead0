"""The bank of Kalman filters of `edition1_companion.twins.rig_filter`, one for each common bias, and its mixture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from edition1.estimation.base import Estimate, held, redundancy
from edition1_companion.recordings.rig_robot import RIG_RATE_HZ, RIG_SENSORS
from edition1_companion.twins.compiled_rig_filter import bank_estimate, bank_step
from edition1_companion.twins.rig_map import SCALE_MM, BendMap


@dataclass(frozen=True)
class OursConfig:
    """Settings of ours: assumed, none is fitted to a test part.

    Parameters
    ----------
    bias_mv
        Standard deviation of the common bias; known are biases of -2 to -4 mV between the authors' recordings.
    widest_mv, step_mv
        Largest bias that is considered, and the distance between two.
    elongation_spread
        Standard deviation of the elongation, in units of what the square of the bend leaves of it in T5.train.
    shape_mv
        Standard deviation of a sensor's difference from the map in other recordings; known are 2 to 3 mV for slow
        and 3 to 7 mV for fast motion; in the covariance alone.
    elongation_mm
        Standard deviation of the elongation between recordings, as is known; in the covariance alone.
    iterations
        Largest number of iterations in an update.
    """

    bias_mv: float = 4.0
    widest_mv: float = 10.0
    step_mv: float = 1.0
    elongation_spread: float = 2.0
    shape_mv: float = 5.0
    elongation_mm: float = 0.3
    iterations: int = 5

    def biases(self) -> Float[np.ndarray, " values"]:
        """Values of the common bias [mV]: one filter for each."""
        half = round(self.widest_mv / self.step_mv)
        return self.step_mv * np.arange(-half, half + 1)


@dataclass(frozen=True)
class BankState:
    """The bank of filters after a reading; no array is ever changed.

    Attributes
    ----------
    frame
        How many readings it has seen.
    states, moments, log_weights
        State, covariance and logarithm of the weight of each filter.
    mean_mm, covariance_mm2, weights
        Of the mixture: bend [mm] and its rate [mm/s], covariance of the bend, and weight of each filter; NaN before
        the first reading.
    predicted_mv
        Readings that bend and bias of the mixture let expect.
    square
        Mean square of what is left of the reading, in units of its error.
    """

    frame: int
    states: Float[np.ndarray, "filters 7"]
    moments: Float[np.ndarray, "filters 7 7"]
    log_weights: Float[np.ndarray, " filters"]
    mean_mm: Float[np.ndarray, " 4"]
    covariance_mm2: Float[np.ndarray, "2 2"]
    weights: Float[np.ndarray, " filters"]
    predicted_mv: Float[np.ndarray, " 3"]
    square: float


@dataclass(frozen=True)
class BendBank:
    """A Kalman filter for each value of the bias, and what they say together; reading by reading, 40 Hz.

    Parameters
    ----------
    bend_map
        From :func:`~edition1_companion.twins.rig_map.fit_map`.
    config
        Settings.
    """

    bend_map: BendMap
    config: OursConfig = field(default_factory=OursConfig)

    def start(self) -> BankState:
        """State before the first reading."""
        bend_map, filters = self.bend_map, len(self._biases)
        # A bend of another recording may lie anywhere in the box: twice the spread of T5 covers it.
        spread = np.concatenate([2 * bend_map.spread_mm, [bend_map.rate] * 2, bend_map.error_mv])
        start = np.concatenate([bend_map.mean_mm, np.zeros(2 + RIG_SENSORS)])
        states, moments = np.tile(start, (filters, 1)), np.tile(np.diag(spread**2), (filters, 1, 1))
        log_prior = -0.5 * (self._biases / self._common) ** 2
        unknown = (np.full(shape, np.nan) for shape in (4, (2, 2), filters, 3))
        return BankState(0, states, moments, log_prior, *unknown, np.nan)

    def step(
        self,
        state: BankState,
        reading_mv: Float[np.ndarray, " 3"],
        noise_mv: Float[np.ndarray, " 3"] | None = None,
    ) -> BankState:
        """State after the next reading; with another white noise than that of the map if wished."""
        bend_map = self.bend_map
        found = bank_step(
            state.frame,
            np.ascontiguousarray(reading_mv),
            state.states,
            state.moments,
            state.log_weights,
            bend_map.factors,
            bend_map.degree,
            SCALE_MM,
            self._biases,
            self._firsts(reading_mv) if state.frame == 0 else state.states[:, :2].copy(),
            *self._motion,
            bend_map.noise_mv if noise_mv is None else noise_mv,
            bend_map.error_mv,
        )
        return BankState(state.frame + 1, *found)

    def estimate(
        self,
        states: Sequence[BankState],
        u: Float[Tensor, "*batch 3"],
        use: Tensor,
        known: Tensor | None,
        *,
        lag_mv: Float[np.ndarray, "states 3"] | float = 0.0,
        **more: Sequence[int],
    ) -> Estimate:
        """What the banks of a batch say after the readings ``u``, which lag by so much; ``more`` are diagnostics.

        ``bend_mm`` in the diagnostics is the bend in the unit of the banks, ``bias_mv`` and ``bias_deviation_mv`` the
        common bias and its standard deviation, given the readings so far. The covariance leaves out that of bend and
        elongation with one another.
        """
        slopes = self.bend_map.slopes(np.array([state.mean_mm[:2] for state in states]))
        found = [
            bank_estimate(
                state.mean_mm, state.covariance_mm2, state.weights, self._biases, J, *self._elsewhere
            )
            for state, J in zip(states, slopes, strict=True)
        ]
        q_mm, C_mm2, bias_mv, deviation_mv = (np.array(x) for x in zip(*found, strict=True))
        square, predicted = np.array([s.square for s in states]), np.array([s.predicted_mv for s in states])

        def batched(x: np.ndarray) -> Tensor:
            return torch.from_numpy(x.reshape(u.shape[:-1] + x.shape[1:])).to(u)

        q, free = held(batched(1e-3 * q_mm), known)
        C, used = batched(1e-6 * C_mm2), use.sum(-1)
        if known is not None:
            C = torch.where(free.unsqueeze(-1) & free.unsqueeze(-2), C, 0.0)
        diagnostics = {
            "masked": RIG_SENSORS - used,
            "chi2": used * batched(square),
            "dof": redundancy(used, free[..., :2]),
            "bend_mm": batched(q_mm[:, :2]),
            "bias_mv": batched(bias_mv),
            "bias_deviation_mv": batched(deviation_mv),
            **{name: torch.tensor(values).reshape(used.shape) for name, values in more.items()},
        }
        return Estimate(q, C, batched(predicted + lag_mv), diagnostics)

    @cached_property
    def _elsewhere(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """What other recordings may have, for :func:`bank_estimate`."""
        bend_map, config = self.bend_map, self.config
        spreads = self._spread_l, self._common, config.shape_mv, config.step_mv, config.elongation_mm
        return bend_map.spread_mm, bend_map.elongation_mm, np.array([bend_map.elongation_slope, *spreads])

    @cached_property
    def _motion(self) -> tuple[np.ndarray, np.ndarray]:
        """Bounds of the bend, and how it moves, for :func:`bank_step`."""
        bend_map = self.bend_map
        numbers = [1.0 / RIG_RATE_HZ, bend_map.error_s, bend_map.acceleration, self.config.iterations]
        return np.stack([bend_map.lower, bend_map.upper]), np.array(numbers)

    @cached_property
    def _biases(self) -> np.ndarray:
        return self.config.biases()

    @cached_property
    def _unit(self) -> np.ndarray:
        return np.hypot(self.bend_map.noise_mv, self.bend_map.error_mv)

    def _firsts(self, reading_mv: np.ndarray) -> np.ndarray:
        starts = self.bend_map.starts
        apart = (reading_mv - self._biases[:, None])[:, None] - self.bend_map(starts)
        return starts[np.nansum((apart / self._unit) ** 2, axis=-1).argmin(axis=1)]

    @cached_property
    def _spread_l(self) -> float:
        return self.config.elongation_spread * self.bend_map.elongation_spread_mm

    @cached_property
    def _common(self) -> float:
        return float(np.hypot(self.config.bias_mv, self.bend_map.elongation_slope * self._spread_l))
