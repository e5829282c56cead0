r"""A model of the arm between IMUs as an estimator: quaternions in, positions along the arm and their covariance out.

The configuration of a soft arm has no finite list of coordinates; what the models state is where its points
are. So ``q`` holds the positions of points at given arc lengths, flattened, and the readings ``u`` the
quaternions of the selected IMUs, flattened. Nothing is carried from one time step to the next.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from edition1.errors import bad_input, require
from edition1.estimation._quaternions import filled, neighbours
from edition1.estimation.base import Estimate, check_start, usable
from edition1.estimation.imu_models import ShapeModel
from edition1.estimation.imu_selection import Selection
from edition1.estimation.orientations import exponential, product

_ROUGHNESS = 0.86
"""Assumed random walk of the orientation along the arm [rad/sqrt(m)]: 14 deg over 80 mm, the middle of the median
angles between adjacent IMUs in the released recording."""

_STEP_RAD = 1e-4  # of the differences: error 1e-9 by the third derivative, 1e-12 by rounding


@dataclass(frozen=True)
class _ShapeState:
    """The last estimate; the next one does not depend on it."""

    q: Float[Tensor, "*batch n_q"]


@dataclass(frozen=True)
class ImuShape:
    r"""Estimator that applies a model to the orientations of one moment.

    An IMU with any component masked or NaN is left out as a whole, and its orientation filled from the others
    by interpolation along the arc. The covariance follows by linear propagation: each IMU has an
    independent error of ``noise_rad`` about each axis, the base (number 0) none, and a filled one has that of
    a random walk along the arc, pinned to the IMUs there are: between two of them at distances :math:`a, b`
    the variance about each axis is :math:`\varrho^2 ab/(a + b)`, beyond the last at distance :math:`a` it is
    :math:`\varrho^2 a`, in addition to the error of the IMUs it was filled from. The error of the model
    between IMUs is not part of it.

    Parameters
    ----------
    model
        One of the models of `edition1.estimation.imu_models`.
    selection
        The IMUs that the readings come from.
    arc_lengths
        Points of the arm whose positions are estimated: distances from the base along the chain [m].
    noise_rad
        Standard deviation of an orientation about each axis [rad].
    roughness
        :math:`\varrho` [rad/sqrt(m)].

    Raises
    ------
    InputError
        If there is no point, or the noise or the roughness is not positive.

    Examples
    --------
    >>> from edition1.estimation.imu_models import pcc_extended
    >>> from edition1.estimation.imu_selection import Selection
    >>> two = Selection((0, 8), (0.0, 0.64), (0.64,), sub_links=16)
    >>> method = ImuShape(pcc_extended, two, (0.32, 0.64), noise_rad=0.01)
    >>> upright = torch.tensor([0.0, 0.0, 0.0, 1.0] * 2, dtype=torch.float64)
    >>> _, estimate = method.step(method.init(torch.zeros(6, dtype=torch.float64)), upright, 0.0)
    >>> estimate.q.reshape(2, 3).round(decimals=6) + 0.0  # both points of an upright arm [m]
    tensor([[0.0000, 0.0000, 0.3200],
            [0.0000, 0.0000, 0.6400]], dtype=torch.float64)
    """

    model: ShapeModel
    selection: Selection
    arc_lengths: tuple[float, ...]
    noise_rad: float
    roughness: float = _ROUGHNESS

    def __post_init__(self) -> None:
        require(self.arc_lengths, "arc_lengths", "ImuShape", "at least one point", self.arc_lengths)
        require(self.noise_rad > 0, "noise_rad", "ImuShape", "positive [rad]", self.noise_rad)
        require(self.roughness > 0, "roughness", "ImuShape", "positive [rad/sqrt(m)]", self.roughness)

    def init(self, q0: Float[Tensor, "*batch n_q"], *, seed: int = 0) -> _ShapeState:
        """State at ``q0``; neither it nor the seed has an effect on the estimates."""
        check_start(q0, None, "ImuShape", n_q=3 * len(self.arc_lengths))
        return _ShapeState(q0)

    def step(
        self,
        state: _ShapeState,
        u: Float[Tensor, "*batch s"],
        t: float,
        *,
        mask: Tensor | None = None,
        known: Tensor | None = None,
    ) -> tuple[_ShapeState, Estimate]:
        """Positions from the quaternions ``u``.

        ``u_hat`` holds the quaternions that were used: rescaled, and filled where one is missing. ``masked``
        in the diagnostics counts the IMUs left out, ``missing`` names them. Coordinates that are ``known``
        are held, and the others corrected by what the covariance says about them (conditional mean and
        covariance).

        Raises
        ------
        InputError
            Readings that are not four per IMU, of which no IMU is left, or not unit within 1e-3.
        """
        imus = len(self.selection.imus)
        if u.shape[-1:] != (4 * imus,):
            raise bad_input("u", "ImuShape", f"of last dimension {4 * imus}", f"shape {tuple(u.shape)}")
        use = usable(u, mask, "ImuShape").unflatten(-1, (imus, 4)).all(-1)
        if not bool(use.any(-1).all()):
            raise bad_input("u", "ImuShape", "at least one IMU that is whole and not masked", "none")
        missing = (~use).cpu().numpy()
        readings = u.detach().cpu().to(torch.float64).numpy().reshape(*missing.shape, 4)
        readings = np.where(missing[..., None], np.nan, readings)
        used = filled(readings, self.selection.arcs)
        q = self._positions(used)
        J = self._jacobian(readings, used, missing)
        C = J @ self._orientation_covariance(missing) @ np.swapaxes(J, -1, -2)
        q, C = torch.from_numpy(q), torch.from_numpy(C)
        if known is not None:
            q, C = _conditioned(q, C, known.detach().cpu().to(torch.float64))
        estimate = Estimate(
            q=q.to(state.q),
            covariance=C.to(state.q),
            u_hat=torch.from_numpy(used).flatten(-2).to(u),
            diagnostics={
                "masked": (~use).sum(-1),
                "missing": ~use,
                "chi2": q.new_zeros(
                    q.shape[:-1]
                ),  # the models follow every orientation: nothing is left over
                "dof": torch.zeros(q.shape[:-1], dtype=torch.int64),
            },
        )
        return _ShapeState(estimate.q), estimate

    def _positions(self, orientations: np.ndarray) -> np.ndarray:
        points = self.model(orientations, self.selection, self.arc_lengths)
        return points.reshape(*points.shape[:-2], -1)

    def _jacobian(self, readings: np.ndarray, used: np.ndarray, missing: np.ndarray) -> np.ndarray:
        """Derivative ``[..., n_q, 3 imus]`` by turns in the world frame, by central differences.

        The turn of an IMU that is there also turns those that are filled from it.
        """
        columns = []
        for imu in range(missing.shape[-1]):
            turns = np.zeros((6, *used.shape[:-1], 3))
            for axis in range(3):
                turns[2 * axis, ..., imu, axis], turns[2 * axis + 1, ..., imu, axis] = _STEP_RAD, -_STEP_RAD
            steps = exponential(turns)
            moved = filled(product(steps, readings), self.selection.arcs)
            gone = np.broadcast_to(missing[..., imu, None, None], moved.shape)
            moved = np.where(gone, product(steps, used), moved)
            q = self._positions(moved)
            columns.append((q[::2] - q[1::2]) / (2 * _STEP_RAD))
        return np.moveaxis(np.concatenate(columns), 0, -1)

    def _orientation_covariance(self, missing: np.ndarray) -> np.ndarray:
        """Covariance ``[..., 3 imus, 3 imus]`` of the turns of :meth:`_jacobian`."""
        imus = missing.shape[-1]
        noise = np.diag([0.0 if imu == 0 else self.noise_rad**2 for imu in self.selection.imus])
        per_axis = np.broadcast_to(noise, (*missing.shape, imus)).copy()
        for pattern in np.unique(missing.reshape(-1, imus), axis=0):
            lost = np.ix_(np.flatnonzero(pattern), np.flatnonzero(pattern))
            rows = (missing == pattern).all(axis=-1)
            block = np.where(pattern[:, None] | pattern, 0.0, noise)
            block[lost] = self._random_walk(pattern)[lost]
            per_axis[rows] = block
        return np.einsum("...ij,ab->...iajb", per_axis, np.eye(3)).reshape(
            *missing.shape[:-1], 3 * imus, 3 * imus
        )

    def _random_walk(self, missing: np.ndarray) -> np.ndarray:
        """Covariance per axis of filled orientations about their mean: a random walk pinned where IMUs are."""
        arcs, imus = self.selection.arcs, len(missing)
        C = np.zeros((imus, imus))
        ends = {int(imu): neighbours(missing, arcs, int(imu)) for imu in np.flatnonzero(missing)}
        for i, (before, after, share_i) in ends.items():
            for j, (*same, share_j) in ends.items():
                # In one gap between the same IMUs, and beyond the end on the same side of the last one.
                if same == [before, after] and (before != after or (i < before) == (j < before)):
                    nearer = min(abs(arcs[k] - arcs[before]) for k in (i, j))
                    C[i, j] = self.roughness**2 * nearer * (1 - max(share_i, share_j))
        return C


def _conditioned(q: Tensor, C: Tensor, known: Tensor) -> tuple[Tensor, Tensor]:
    """Mean and covariance given the coordinates that are not NaN."""
    held = ~torch.isnan(known).expand_as(q)
    both = held.unsqueeze(-1) & held.unsqueeze(-2)
    inverse = torch.linalg.pinv(torch.where(both, C, 0.0), hermitian=True, rtol=1e-12)
    gain = torch.where(held.unsqueeze(-2), C, 0.0) @ inverse
    corrected = q + (gain @ torch.where(held, known - q, 0.0).unsqueeze(-1)).squeeze(-1)
    free = ~held.unsqueeze(-1) & ~held.unsqueeze(-2)
    return torch.where(held, known, corrected), torch.where(free, C - gain @ C, 0.0)
