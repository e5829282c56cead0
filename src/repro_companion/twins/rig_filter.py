r"""Ours for the rig of Baaij et al. 2023, section 5: bend, elongation and bias, from readings alone.

A map from bend to readings, polynomial in :math:`(\Delta_x, \Delta_y)`, is fitted to T5.train by linear least squares
(`repro_companion.twins.rig_map`). A recording then has a bias :math:`c`, common to the three sensors and
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

from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float, Int

from repro.estimation.consistency import WINDOW, Status
from repro_companion.recordings.rig_robot import RIG_RATE_HZ, RIG_SENSORS
from repro_companion.twins.compiled_rig_filter import bank_start, bank_step, filter_bank
from repro_companion.twins.rig_map import SCALE_MM, BendMap

RESIDUAL = 4.0
"""Root mean square over the sensors, in units of the error of the map: above it, something is wrong."""
LASTING = 20
"""So many frames in a row above it, and a new start is searched; and again after as many."""
ELSEWHERE_MM = 5.0
"""A new start ends elsewhere if its bend is farther from the old one [mm]: what the page calls lost."""


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
class OursRun:
    """What ours finds on a recording.

    Attributes
    ----------
    q
        Configuration [m].
    covariance
        Its covariance [m²]; that of bend and elongation with one another is left out.
    bias_mv, bias_deviation_mv
        Common bias and its standard deviation, given the readings so far.
    status
        Of each frame, a number of :class:`repro.estimation.consistency.Status`: *suspicious* while no new start
        explains the readings, and just after one. Empty, reading by reading.
    anew
        How often the filter was started anew, up to each frame.
    """

    q: Float[np.ndarray, "t 3"]
    covariance: Float[np.ndarray, "t 3 3"]
    bias_mv: Float[np.ndarray, " t"]
    bias_deviation_mv: Float[np.ndarray, " t"]
    status: Int[np.ndarray, " watched"] = field(default_factory=lambda: np.zeros(0, dtype=int))
    anew: Int[np.ndarray, " watched"] = field(default_factory=lambda: np.zeros(0, dtype=int))


@dataclass(frozen=True)
class BendState:
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
    """

    frame: int
    states: Float[np.ndarray, "filters 7"]
    moments: Float[np.ndarray, "filters 7 7"]
    log_weights: Float[np.ndarray, " filters"]
    mean_mm: Float[np.ndarray, " 4"]
    covariance_mm2: Float[np.ndarray, "2 2"]
    weights: Float[np.ndarray, " filters"]

    @property
    def bend_mm(self) -> Float[np.ndarray, " 2"]:
        """Bend after the newest reading [mm], the mean of all filters; NaN before the first."""
        return self.mean_mm[:2]


@dataclass(frozen=True)
class BendFilter:
    """Ours, reading by reading or on a whole recording: bend, elongation and common bias.

    Parameters
    ----------
    bend_map
        From :func:`~repro_companion.twins.rig_map.fit_map`.
    config
        Settings.
    """

    bend_map: BendMap
    config: OursConfig = field(default_factory=OursConfig)

    def init(self) -> BendState:
        """State before the first reading."""
        biases = self.config.biases()
        states, moments = bank_start(len(biases), *self._start())
        mean, covariance, weights = (np.full(shape, np.nan) for shape in (4, (2, 2), len(biases)))
        return BendState(0, states, moments, self._log_prior(), mean, covariance, weights)

    def step(self, state: BendState, reading_mv: Float[np.ndarray, " 3"]) -> BendState:
        """State after the next reading, 40 Hz."""
        found = bank_step(
            state.frame,
            np.ascontiguousarray(reading_mv),
            state.states,
            state.moments,
            state.log_weights,
            *self._map(),
            self._firsts(reading_mv) if state.frame == 0 else np.zeros((len(state.log_weights), 2)),
            *self._rest(),
        )
        return BendState(state.frame + 1, *found)

    def found(self, state: BendState) -> OursRun:
        """Bend, elongation and bias after a reading, as a run of one frame; NaN before the first."""
        return self._run(state.mean_mm[None], state.covariance_mm2[None], state.weights[None])

    def whole(self, readings_mv: Float[np.ndarray, "t 3"]) -> OursRun:
        """All frames of a recording: as in steps, to the bit as far as the bend goes, up to the first new start."""
        u = np.ascontiguousarray(readings_mv)
        found = self._bank(u)
        square = self._square(u, found)
        status, anew, lasting, since = (
            np.full(len(u), Status.CONSISTENT),
            np.zeros(len(u), dtype=int),
            0,
            WINDOW,
        )
        for k in range(len(u)):
            lasting, since = lasting + 1 if square[k] > RESIDUAL**2 else 0, since + 1
            if lasting and lasting % LASTING == 0:
                recent = slice(k - LASTING + 1, k + 1)
                fresh = self._bank(u[recent])
                better = self._square(u[recent], fresh).mean() < 0.25 * square[recent].mean()
                if better and np.hypot(*(fresh[0][-1] - found[0][k])[:2]) > ELSEWHERE_MM:
                    for old, new in zip(found, self._bank(u[recent.start :]), strict=True):
                        old[k:] = new[LASTING - 1 :]
                    square[k:] = self._square(u[k:], tuple(x[k:] for x in found))
                    anew[k:] += 1
                    lasting = since = 0
            if lasting >= LASTING or since < WINDOW:
                status[k] = Status.SUSPICIOUS
        return replace(self._run(*found), status=status, anew=anew)

    def _bank(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return filter_bank(
            u, *self._map(), self._log_prior(), self._firsts(u[0]), *self._start(), *self._rest()
        )

    def _log_prior(self) -> np.ndarray:
        return -0.5 * (self.config.biases() / self._common()) ** 2

    def _square(self, u: np.ndarray, found: tuple[np.ndarray, ...]) -> np.ndarray:
        means, _, weights = found
        apart = u - self.bend_map(means[:, :2]) - (weights @ self.config.biases())[:, None]
        return ((apart / self._unit()) ** 2).mean(axis=1)

    def _unit(self) -> np.ndarray:
        return np.hypot(self.bend_map.noise_mv, self.bend_map.error_mv)

    def _map(self) -> tuple[np.ndarray, int, float, np.ndarray]:
        return self.bend_map.factors, self.bend_map.degree, SCALE_MM, self.config.biases()

    def _start(self) -> tuple[np.ndarray, np.ndarray]:
        bend_map = self.bend_map
        start = np.concatenate([bend_map.mean_mm, np.zeros(2 + RIG_SENSORS)])
        # A bend of another recording may lie anywhere in the box: twice the spread of T5 covers it.
        return start, np.concatenate([2 * bend_map.spread_mm, [bend_map.rate] * 2, bend_map.error_mv])

    def _rest(self) -> tuple[np.ndarray, ...]:
        bend_map = self.bend_map
        numbers = [1.0 / RIG_RATE_HZ, bend_map.error_s, bend_map.acceleration, self.config.iterations]
        bounds = np.stack([bend_map.lower, bend_map.upper])
        return bounds, np.array(numbers), bend_map.noise_mv, bend_map.error_mv

    def _firsts(self, reading_mv: np.ndarray) -> np.ndarray:
        bend_map = self.bend_map
        apart = (reading_mv - self.config.biases()[:, None])[:, None] - bend_map(bend_map.starts)
        return bend_map.starts[((apart / self._unit()) ** 2).sum(axis=-1).argmin(axis=1)]

    def _spread_l(self) -> float:
        return self.config.elongation_spread * self.bend_map.elongation_spread_mm

    def _common(self) -> float:
        return float(np.hypot(self.config.bias_mv, self.bend_map.elongation_slope * self._spread_l()))

    def _run(self, means: np.ndarray, covariances: np.ndarray, weights: np.ndarray) -> OursRun:
        bend_map, config, biases = self.bend_map, self.config, self.config.biases()
        g, spread_l = bend_map.elongation_slope, self._spread_l()
        bend = means[:, :2]
        J = bend_map.slopes(bend)
        prior = np.diag(bend_map.spread_mm**-2)
        shape = np.linalg.inv(J.transpose(0, 2, 1) @ J / config.shape_mv**2 + prior)
        c = weights @ biases
        c_variance = weights @ biases**2 - c**2 + config.step_mv**2 / 12
        share = g * spread_l**2 / self._common() ** 2  # millimetres of elongation for each millivolt of c
        rest = spread_l**2 * (1 - g * share)
        covariance = np.zeros((len(c), 3, 3))
        covariance[:, :2, :2] = covariances + shape
        elongation, slopes = bend_map.elongation(bend)
        by_bend = np.einsum("ti,tij,tj->t", slopes, covariance[:, :2, :2], slopes)
        covariance[:, 2, 2] = by_bend + rest + share**2 * c_variance + config.elongation_mm**2
        return OursRun(
            q=1e-3 * np.column_stack([bend, elongation + share * c]),
            covariance=1e-6 * covariance,
            bias_mv=(1 - g * share) * c,
            bias_deviation_mv=np.sqrt(g**2 * rest + (1 - g * share) ** 2 * c_variance),
        )
