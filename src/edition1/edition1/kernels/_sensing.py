"""Sensor models compiled: readings and their slopes by configuration, for whole batches in one call.

Networks are evaluated in the precision of their weights, as in torch, and everything else in double precision. torch
remains the reference.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from edition1.errors import InputError, bad_input, require
from edition1.kernels._motion import Chain, array, chain, move, scratch
from edition1.kernels._multipole import ORDERS, multipole
from edition1.kernels._network import NO_NETWORK, Layers, layers, nodes, predict
from edition1.kernels._relations import pairs, pull_back, relate, see, wrenches
from edition1.kernels.compilation import machine_code
from edition1.sensing.ensemble import SeedEnsemble
from edition1.sensing.linearised import LinearisedSensing
from edition1.sensing.magnetic import MagneticSensing
from edition1.sensing.multipole import MultipoleField
from edition1.sensing.network import CosineNetwork, PerSensor
from edition1.sensing.seen_directions import SeenDirections
from edition1.sensing.stacked import StackedSensing

SUPPORTED = (
    "LinearisedSensing, or MagneticSensing with a MultipoleField on cosines, networks of the paper or on cosines "
    "(alone, in PerSensor or in SeedEnsemble), or one of them with SeenDirections in StackedSensing"
)


class Tables(NamedTuple):
    """A sensor model as arrays; the first dimension of each goes with a column of :meth:`CompiledSensing.which`."""

    chain: Chain
    moments: np.ndarray
    """Moments ``[fields, m, terms]`` [mT m^(l+2)]; no terms for networks."""
    gain: np.ndarray
    """Gains ``[gains, s]``."""
    seen: np.ndarray
    """Directions ``[k, 3]`` fixed in the base of which the last ``k`` sensors see a component."""
    earth: np.ndarray
    """Direction ``[earths, 3]`` of the Earth field for networks, the field itself [mT] else."""
    angles: bool
    layers: Layers


class CompiledSensing:
    """A sensor model whose readings and slopes come from one compiled kernel; made by :func:`edition1.kernels.compiled`.

    Weights and mounts are copied: later changes to the model have no effect on the kernel. Networks are evaluated in
    the precision of their weights.

    Parameters
    ----------
    sensing
        :class:`~edition1.sensing.linearised.LinearisedSensing`, or
        :class:`~edition1.sensing.magnetic.MagneticSensing` with a multipole field or networks; or one of them and
        :class:`~edition1.sensing.seen_directions.SeenDirections` in :class:`~edition1.sensing.stacked.StackedSensing`.

    Raises
    ------
    InputError
        If the model is another one, or does not fit its robot.
    """

    is_compiled = True

    def __init__(self, sensing: Callable[[Tensor], Tensor]) -> None:
        self.reference = sensing
        whole, seen, noise = sensing, None, [torch.ones(()), torch.ones(())]
        if isinstance(sensing, StackedSensing) and len(sensing.parts) == 2:
            noise = [torch.as_tensor(x, dtype=torch.float64) for x in sensing.noise]
            sensing, beside = sensing.parts
            if not isinstance(beside, SeenDirections):
                raise bad_input("sensing.parts", "compiled", SUPPORTED, type(beside).__name__)
            seen = beside
        if isinstance(sensing, LinearisedSensing):
            earth = torch.zeros(3) if sensing.earth_mt is None else sensing.earth_mt
            gain, model, angles = sensing.gain, sensing.moment_rows, False
        elif isinstance(sensing, MagneticSensing):
            earth = torch.tensor([1.0, 0.0, 0.0]) if sensing.earth_axis is None else sensing.earth_axis
            earth = earth.double() / torch.linalg.vector_norm(earth.double(), dim=-1, keepdim=True)
            gain, angles = None, sensing.inputs == "angles"
            if isinstance(sensing.model, MultipoleField) and not angles:
                model = sensing.model.moments
                model, earth = model.reshape(-1, model.shape[-1]), sensing.model.earth_mt * earth
            else:
                model = _ensemble(sensing.model, len(sensing.robot.sensors))
        else:
            raise bad_input("sensing", "compiled", SUPPORTED, type(sensing).__name__)
        robot = sensing.robot
        n_m, mounts = len(robot.magnets), robot.magnets.joined(robot.sensors)
        gain = torch.ones(len(robot.sensors)) if gain is None else gain
        directions = torch.zeros(0, 3)
        if seen is not None:
            mounts, directions = mounts.joined(seen.axes), seen.directions.repeat_interleave(3, 0)
            scale = (1 / noise[1]).expand(*gain.shape[:-1], len(directions))
            gain = torch.cat([gain.double() / noise[0], scale], dim=-1)
        self.n_sensors = gain.shape[-1]
        links, robots = chain(robot, mounts)
        if isinstance(model, SeedEnsemble):
            # An ensemble of one's own making has no dimension for seeds.
            self.n_seeds = model.n_seeds if model is getattr(sensing, "model", None) else None
            moments, fields, networks = torch.zeros(1, n_m, 0), torch.Size(), layers(model)
        else:
            self.n_seeds, networks, fields = None, NO_NETWORK, model.shape[:-2]
            moments = model.expand(*fields, n_m, -1).reshape(-1, n_m, model.shape[-1])
            if moments.shape[-1] > ORDERS:
                raise bad_input("moments", "compiled", f"at most {ORDERS}", moments.shape[-1])
        self.batches = (robots, fields, gain.shape[:-1], earth.shape[:-1])
        constants = array(moments), array(gain.reshape(-1, self.n_sensors)), array(directions)
        self.tables = Tables(links, *constants, array(earth.reshape(-1, 3)), angles, networks)
        self.n_q = robot.n_q
        # Those of the last batch: an estimator asks for the same ones at every time step.
        self._rows: tuple[torch.Size, np.ndarray] | None = None
        rank = max(map(len, self.batches))
        batch = self.batch(() if self.n_seeds is None else (self.n_seeds, *(1,) * rank))
        whole(torch.zeros(*batch, self.n_q, dtype=torch.float64))  # refuses what does not fit

    def __call__(self, q: Float[Tensor, "*q n_q"]) -> Float[Tensor, "*batch s"]:
        """Readings by torch, with what autograd needs of them."""
        return self.reference(q)

    def batch(self, *shapes: Sequence[int]) -> torch.Size:
        """Shape of the batch of results for operands with these batches."""
        return torch.Size(np.broadcast_shapes(*shapes, *self.batches))  # torch's own takes ten times as long

    def which(self, batch: torch.Size) -> np.ndarray:
        """Rows of the tables for every member of a batch: robot, field or seed, gain, Earth field.

        Raises
        ------
        InputError
            If the first dimension of the batch is not that of the seeds.
        """
        if self._rows is not None and self._rows[0] == batch:
            return self._rows[1]
        columns = [
            torch.arange(shape.numel()).reshape(shape).expand(batch).flatten() for shape in self.batches
        ]
        if self.n_seeds is not None:
            if batch[:1] != (self.n_seeds,):
                expected = f"of first dimension {self.n_seeds} (seeds)"
                raise bad_input("q", "SeedEnsemble", expected, f"a batch of shape {tuple(batch)}")
            columns[1] = torch.arange(self.n_seeds).repeat_interleave(batch[1:].numel())
        self._rows = batch, torch.stack(columns, dim=-1).numpy()
        return self._rows[1]

    def batch_of(self, owner: str, q: Tensor, u: Tensor, *others: Tensor) -> torch.Size:
        """Shape of the batch of configurations, readings and others that an estimator works on.

        Raises
        ------
        InputError
            If configurations or readings are not those of the robot.
        """
        for name, x, n in (("q", q, self.n_q), ("u", u, self.n_sensors)):
            require(x.shape[-1:] == (n,), name, owner, f"of last dimension {n}", f"shape {tuple(x.shape)}")
        return self.batch(*(x.shape[:-1] for x in (q, u, *others)))

    def linearise(
        self, q: Float[Tensor, "*q n_q"]
    ) -> tuple[Float[Tensor, "*batch s"], Float[Tensor, "*batch s n_q"]]:
        """Readings and their derivatives with respect to ``q``, in double precision."""
        batch = self.batch(q.shape[:-1])
        found = _evaluate_all(self.tables, self.which(batch), rows(q, batch, self.n_q))
        u, J = (torch.from_numpy(x).reshape((*batch, *x.shape[1:])) for x in found)
        return u, J


def rows(x: Tensor, batch: torch.Size, n: int) -> np.ndarray:
    """One row of ``n`` numbers for every member of a batch, as kernels take them."""
    return array(x.expand(*batch, n)).reshape(-1, n)


def _ensemble(model: Callable[[Tensor], Tensor], n_sensors: int) -> SeedEnsemble:
    """Networks as an ensemble; one of a single seed unless it is one already."""
    if isinstance(model, SeedEnsemble):
        return model
    if not isinstance(model, nn.Sequential | CosineNetwork | PerSensor):
        raise bad_input("sensing.model", "compiled", SUPPORTED, type(model).__name__)
    if any(m.training for m in model.modules() if isinstance(m, nn.BatchNorm1d)):
        raise bad_input("sensing.model", "compiled", "in evaluation mode", "in training")
    of_sensor = model.network_of_sensor if isinstance(model, PerSensor) else [0] * n_sensors
    try:
        return SeedEnsemble([list(model.networks) if isinstance(model, PerSensor) else [model]], of_sensor)
    except InputError as error:
        raise bad_input("sensing.model", "compiled", SUPPORTED, "networks of another kind") from error


@machine_code()
def room(tables):
    """Room for one evaluation."""
    return scratch(tables.chain), pairs(tables.moments.shape[1]), nodes(tables.layers)


@machine_code()
def evaluate(tables, which, q, wanted, slopes, u, J, space):
    """Readings ``u`` of the sensors ``wanted`` of one member, and the rows of ``J`` if ``slopes``."""
    motion, pair, hidden = space
    chain, n_m, xi, gradient = tables.chain, tables.moments.shape[1], pair.xi, pair.gradient
    networks, unseen = len(tables.layers.widths) > 0, len(u) - len(tables.seen)
    move(chain, which[0], q, slopes, motion)
    for s in range(len(u)):
        if not wanted[s]:
            continue
        j, gain = n_m + s, tables.gain[which[2], s]
        if s >= unseen:
            u[s] = gain * see(motion.axis, j, tables.seen[s - unseen], pair)
            if slopes:
                pull_back(chain, motion, j, gain, pair, J[s])
            continue
        relate(motion.axis, motion.position, j, tables.earth[which[3]], tables.angles, pair)
        if networks:
            reading = predict(tables.layers, tables.layers.network[which[1], s], xi, slopes, gradient, hidden)
        else:
            reading, gradient[0] = xi[0], 1.0
            for k in range(n_m):
                at, moments = 1 + 4 * k, tables.moments[which[1], k]
                part, gradient[at], gradient[at + 1], gradient[at + 2], gradient[at + 3] = multipole(
                    moments, xi[at], xi[at + 1], xi[at + 2], xi[at + 3]
                )
                reading += part
        u[s] = gain * reading
        if slopes:
            wrenches(motion.position, j, tables.angles, pair)
            pull_back(chain, motion, j, gain, pair, J[s])


@machine_code()
def _evaluate_all(tables, which, q):
    """Readings and slopes of all members of a flat batch."""
    n, n_s, n_q = len(q), tables.gain.shape[1], q.shape[1]
    u, J, space = np.empty((n, n_s)), np.empty((n, n_s, n_q)), room(tables)
    wanted = np.ones(n_s, dtype=np.bool_)
    for i in range(n):
        evaluate(tables, which[i], q[i], wanted, True, u[i], J[i], space)
    return u, J
