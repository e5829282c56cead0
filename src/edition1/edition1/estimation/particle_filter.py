r"""Particle filter of Mitchell, Hurley and Onal 2021 (section II): weigh, predict, resample."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from edition1.errors import bad_input, require
from edition1.estimation._particle_cloud import Weighed, weighed
from edition1.estimation._particle_restart import contracted
from edition1.estimation._resampling import SCHEMES, resample, stream
from edition1.estimation.base import Estimate, check_start, redundancy, usable
from edition1.estimation.levenberg_marquardt import covariance
from edition1.estimation.regions import Region

_ESTIMATES = ("best tenth", "weighted", "Gauss-Newton")
_MOTIONS = ("random walk", "constant velocity")

_DRAWS = 50
"""Largest number of draws for a particle whose noise takes it out of the region; after that it stays."""
_DAMPING = 1e-6
"""Of the Gauss-Newton step, relative to the information on each coordinate."""


@dataclass(frozen=True)
class ParticleState:
    """Configurations and velocities of the particles before the next readings.

    Random numbers are a function of ``seed`` and ``steps``: a state stepped twice gives the same bits twice.
    """

    q: Float[Tensor, "*batch n n_q"]
    velocity: Float[Tensor, "*batch n n_q"]
    seed: int
    steps: int


@dataclass(frozen=True)
class ParticleFilter:
    r"""Estimator that carries the belief about the configuration as a cloud of particles.

    A step weighs every particle by the likelihood of the readings, takes the estimate, draws the particles anew by
    their weights and moves them: the order of the paper. The weight of a particle with predicted readings
    :math:`\hat u` is

    .. math:: w \propto \exp\left(-\frac{\|\hat u - u\|^2}{2 \sigma_n^2}\right),

    with the standard deviation :math:`\sigma_n` of a reading. **Eq. (1) of the paper has no factor 1/2**: its
    :math:`\sigma` is :math:`\sqrt 2\,\sigma_n`.

    Members of a batch share their random numbers, so that each gives what it would give alone.

    Parameters
    ----------
    sensing
        Configuration to predicted readings, any callable that takes batches: several segments, magnets and sensors. A
        :class:`~edition1.sensing.bend_sensor.BendSensor` as of :func:`edition1.kernels.compiled`, in a
        :class:`~edition1.estimation.regions.Disc`, gives the same particles to rounding, several times faster.
    process_noise
        Standard deviation of the noise that moves a particle in one step, for every coordinate, in its unit.
        Leading dimensions broadcast against the batch.
    noise_mt
        Standard deviation :math:`\sigma_n` of a reading, in its unit.
    region
        Where particles may be: noise that leads outside is drawn again (section II-C). Everywhere when not given.
    particles
        Number of particles.
    estimate
        ``"best tenth"``: unweighted mean of the bend angles, and circular mean of the bend directions, of the 10 %
        of particles with the largest weights, eqs (3)-(4); for bend vectors only. ``"weighted"``: mean of all by
        their weights. ``"Gauss-Newton"``: that mean, then one least-squares step on the readings.
    resampling
        ``"multinomial"`` as in the paper, or ``"systematic"``, which adds less noise.
    motion
        ``"random walk"``: noise on the configuration, as in the paper. ``"constant velocity"``: noise on a
        velocity that every particle carries.
    lost_at
        A filter counts as lost when its readings are this many standard deviations too unlikely for its cloud.
    restart
        Draw the cloud anew from the region when the filter is lost.

    Raises
    ------
    InputError
        If a number is not positive, a name is unknown, a restart has no region to draw from, or a compiled sensor
        model has no disc as its region.

    Examples
    --------
    >>> from edition1.estimation.base import track
    >>> from edition1.estimation.regions import Box
    >>> one = torch.ones(1, dtype=torch.float64)
    >>> method = ParticleFilter(lambda q: 2 * q, 0.05 * one, 0.02, region=Box(-one, one))
    >>> abs(float(track(method, one.expand(20, 1), 0 * one).q[-1]) - 0.5) < 0.01
    True
    """

    sensing: Callable[[Tensor], Tensor]
    process_noise: Float[Tensor, "*noise n_q"]
    noise_mt: float
    region: Region | None = None
    particles: int = 1000
    estimate: str = "weighted"
    resampling: str = "systematic"
    motion: str = "random walk"
    lost_at: float = 6.0
    restart: bool = False

    def __post_init__(self) -> None:
        owner = "ParticleFilter"
        if not bool((self.process_noise > 0).all()):
            raise bad_input("process_noise", owner, "positive", self.process_noise.tolist())
        for name in ("noise_mt", "particles", "lost_at"):
            require(getattr(self, name) > 0, name, owner, "positive", getattr(self, name))
        choices = {"estimate": _ESTIMATES, "resampling": SCHEMES, "motion": _MOTIONS}
        for name, known in choices.items():
            if getattr(self, name) not in known:
                choice = f"one of {', '.join(map(repr, known))}"
                raise bad_input(name, owner, choice, repr(getattr(self, name)))
        if self.estimate == "best tenth" and self._n_q != 2:
            expected = "'weighted' or 'Gauss-Newton' for a configuration that is no bend vector"
            raise bad_input("estimate", owner, expected, f"'best tenth' for {self._n_q} coordinates")
        if self.restart and self.region is None:
            raise bad_input("region", owner, "given for restart=True", None)
        _ = self._compiled  # refuses other regions now, not in the first step

    @cached_property
    def _compiled(self) -> Any:
        if not getattr(self.sensing, "is_compiled", False):
            return None
        from edition1.kernels._bend import CompiledBendSensor
        from edition1.kernels._cloud import CompiledCloud  # here: numba takes a second to import

        return (
            CompiledCloud(self.sensing, self.region) if isinstance(self.sensing, CompiledBendSensor) else None
        )

    @property
    def _n_q(self) -> int:
        return self.process_noise.shape[-1]

    def init(self, q0: Float[Tensor, "*batch n_q"], *, seed: int = 0) -> ParticleState:
        """Cloud around ``q0``, at rest: its spread is the process noise of one step.

        Raises
        ------
        InputError
            If ``q0`` is not finite, of the wrong width or outside the region, or the seed is negative.
        """
        owner = "ParticleFilter"
        check_start(q0, None, owner, n_q=self._n_q)
        if self.region is not None and not bool(self.region.contains(q0).all()):
            raise bad_input("q0", owner, f"within {self.region}", q0.tolist())
        require(seed >= 0, "seed", owner, "not negative", seed)
        q = q0.unsqueeze(-2).expand(*q0.shape[:-1], self.particles, -1)
        q, velocity = self._moved(q, torch.zeros_like(q), stream(seed, 0))
        return ParticleState(q, torch.zeros_like(velocity), seed, 1)

    @torch.no_grad()
    def step(
        self,
        state: ParticleState,
        u: Float[Tensor, "*batch s"],
        t: float,
        *,
        mask: Tensor | None = None,
        known: Tensor | None = None,
    ) -> tuple[ParticleState, Estimate]:
        """Weigh, predict, resample; one step of motion whatever ``t`` says.

        In the diagnostics: ``effective_sample_size``; ``surprise``, by how many standard deviations the readings
        are too unlikely for the cloud before it is weighed; and ``lost``, whether that is beyond ``lost_at``. The
        covariance is that of the weighted particles, for ``"Gauss-Newton"`` that of least squares.
        """
        use = usable(u, mask, "ParticleFilter")
        q, velocity = self._held(state.q, known), state.velocity
        found = self._weighed(q, u, use)
        unlikely = found.surprise
        lost = unlikely > self.lost_at
        if self.restart and bool(lost.any()):
            again = lost[..., None, None]
            q = torch.where(again, self._found_again(state, u, use, known), q)
            velocity = torch.where(again, 0.0, velocity)
            found = self._weighed(q, u, use)
        best, C = found.mean, found.covariance
        if found.best_tenth is not None:
            best = found.best_tenth
        elif self.estimate == "Gauss-Newton":
            best, C = self._gauss_newton(best, u, use, known)
        if known is not None:
            free = torch.isnan(known)
            best = torch.where(free, best, known)
            C = torch.where(free.unsqueeze(-1) & free.unsqueeze(-2), C, 0.0)
        u_hat = self._predicted(best)
        free = (
            torch.ones_like(best, dtype=torch.bool) if known is None else torch.isnan(known).expand_as(best)
        )
        diagnostics = {
            "effective_sample_size": found.effective_sample_size,
            "surprise": unlikely,
            "lost": lost,
            "masked": (~use).sum(-1),
            "chi2": (torch.where(use, u - u_hat, 0.0) / self.noise_mt).square().sum(-1),
            "dof": redundancy(use.sum(-1), free),
        }
        q, velocity = self._following(q, velocity, found.w, stream(state.seed, state.steps))
        following = ParticleState(q, velocity, state.seed, state.steps + 1)
        return following, Estimate(best, C, u_hat, diagnostics)

    def _predicted(self, q: Tensor) -> Tensor:
        return self._compiled.exact(q) if self._compiled is not None else self.sensing(q)

    def _weighed(self, q: Tensor, u: Tensor, use: Tensor) -> Weighed:
        top = self.estimate == "best tenth"
        if self._compiled is not None:
            return self._compiled.weigh(q, u, use, self.noise_mt, top=top)
        return weighed(q, self._error(q, u, use), use, self.noise_mt, top=top)

    def _following(
        self, q: Tensor, velocity: Tensor, w: Tensor, generator: np.random.Generator
    ) -> tuple[Tensor, Tensor]:
        """Particles drawn by their weights, after one step of motion, and their velocities."""
        moving = self.motion == "constant velocity"
        if self._compiled is not None:
            carried = velocity if moving else None
            return self._compiled.move(
                q, carried, w, self.process_noise, self.resampling, generator, _DRAWS + 1
            )
        drawn = resample(w, self.resampling, generator).unsqueeze(-1).expand_as(q)
        return self._moved(q.gather(-2, drawn), velocity.gather(-2, drawn) if moving else velocity, generator)

    def _held(self, q: Tensor, known: Tensor | None) -> Tensor:
        if known is None:
            return q
        held = known.unsqueeze(-2)
        return torch.where(torch.isnan(held), q, held)

    def _error(self, q: Tensor, u: Tensor, use: Tensor) -> Tensor:
        """Predicted less measured readings of every particle, zero for sensors that are not used."""
        return torch.where(use.unsqueeze(-2), self._predicted(q) - u.unsqueeze(-2), 0.0)

    def _moved(self, q: Tensor, velocity: Tensor, generator: np.random.Generator) -> tuple[Tensor, Tensor]:
        """Particles after one step of motion, and their velocities."""
        width = self.process_noise.to(q).unsqueeze(-2)

        def noise() -> Tensor:
            return torch.from_numpy(generator.standard_normal((self.particles, self._n_q))).to(q) * width

        drift = velocity if self.motion == "constant velocity" else torch.zeros_like(velocity)
        moved = drift + noise()
        if self.region is None:
            return q + moved, moved
        for _ in range(_DRAWS):
            inside = self.region.contains(q + moved)
            if bool(inside.all()):
                return q + moved, moved
            moved = torch.where(inside.unsqueeze(-1), moved, drift + noise())
        moved = torch.where(self.region.contains(q + moved).unsqueeze(-1), moved, 0.0)
        return q + moved, moved

    def _found_again(self, state: ParticleState, u: Tensor, use: Tensor, known: Tensor | None) -> Tensor:
        """Particles that start all over the region and contract to the readings."""
        assert self.region is not None
        generator = stream(state.seed, state.steps, restart=True)
        q = self.region.sample(self.particles, generator).to(u).expand(state.q.shape)
        hold, error = partial(self._held, known=known), partial(self._error, u=u, use=use)
        return contracted(q, hold, error, self.region, self.noise_mt, generator)

    def _gauss_newton(self, q: Tensor, u: Tensor, use: Tensor, known: Tensor | None) -> tuple[Tensor, Tensor]:
        """One least-squares step from ``q``, and the covariance of least squares."""
        # Central differences: they need nothing of the model, and one call.
        h = torch.finfo(q.dtype).eps ** (1 / 3)
        offset = h * torch.eye(self._n_q).to(q)
        around = q.unsqueeze(-2) + torch.cat([torch.zeros_like(offset[:1]), offset, -offset])
        error, up, down = self._error(around, u, use).split([1, self._n_q, self._n_q], dim=-2)
        J = (up - down).mT / (2 * h)
        free = torch.ones_like(q, dtype=torch.bool) if known is None else torch.isnan(known).expand_as(q)
        J = torch.where(free.unsqueeze(-2), J, 0.0)
        A = J.mT @ J
        # Damped a little: along a direction without information there is no step.
        damping = torch.where(free, _DAMPING * A.diagonal(dim1=-2, dim2=-1), 1.0)
        damping = damping.clamp_min(torch.finfo(A.dtype).tiny)
        moved = q - torch.linalg.solve(A + torch.diag_embed(damping), J.mT @ error.mT).squeeze(-1)
        if self.region is not None:
            moved = torch.where(self.region.contains(moved).unsqueeze(-1), moved, q)
        return moved, covariance(J, self.noise_mt, free)
