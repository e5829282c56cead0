"""A soft arm as a Cosserat rod (PyElastica): clamped upright at its base, heavy, and pulled by a stick.

Base frame: z up, origin at the clamp; the undeformed rod lies along z. A frame of the rod has its z axis along it;
nothing twists the rod but its own shape.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import elastica
import numpy as np
from edition1.errors import bad_input
from jaxtyping import Float
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation
from tqdm import tqdm

from edition1_companion.twins.imu_errors import continuous_signs


@dataclass(frozen=True)
class Rod:
    """What the rod is made of; by default the arm of Martin et al. (2022).

    Parameters
    ----------
    length_m, radius_m
        660 mm and 12.5 mm (section III-A).
    youngs_modulus_pa
        2 MPa, Gent's formula for the silicone's Shore 45A; the shear modulus is a third of it (incompressible).
    density
        1240 kg/m³, assumed.
    imu_arcs_m
        Distances of the IMUs from the base [m] (Table I).
    imu_mass_kg
        3 g per IMU, assumed.
    elements
        Number of elements.
    translational_damping, rotational_damping
        Drag on every node [kg/s] and on every element [kg m²/s], assumed. A rotational drag much above the
        default would hold back bending itself.
    gravity
        Acceleration downwards [m/s²].
    """

    length_m: float = 0.66
    radius_m: float = 0.0125
    youngs_modulus_pa: float = 2e6
    density: float = 1240.0
    imu_arcs_m: tuple[float, ...] = (0.08, 0.16, 0.24, 0.32, 0.40, 0.48, 0.56, 0.64)
    imu_mass_kg: float = 0.003
    elements: int = 40
    translational_damping: float = 0.08
    rotational_damping: float = 4e-6
    gravity: float = 9.81

    @property
    def bending_stiffness(self) -> float:
        """E I [N m²]."""
        return self.youngs_modulus_pa * np.pi / 4 * self.radius_m**4


@dataclass(frozen=True)
class Stick:
    """A spring and a damper between a point of the rod and a hand.

    Parameters
    ----------
    path
        Position of the hand [m], base frame, of times [s] after the start of the simulation.
    arc_m
        Distance of the point from the base [m].
    stiffness, damping
        Of the spring [N/m] and of the damper [N s/m], assumed.
    """

    path: Callable[[np.ndarray], np.ndarray]
    arc_m: float
    stiffness: float = 150.0
    damping: float = 1.0


@dataclass(frozen=True)
class RodMotion:
    """Samples of a simulated rod.

    Attributes
    ----------
    rod
        What moved.
    time_s
        Times after the start [s].
    nodes
        Positions [m] of the nodes, base to tip.
    frames
        Quaternions XYZW of the elements, element to base.
    """

    rod: Rod
    time_s: Float[np.ndarray, " samples"]
    nodes: Float[np.ndarray, "samples nodes 3"]
    frames: Float[np.ndarray, "samples elements 4"]

    def positions(self, arcs_m: Float[np.ndarray, " points"]) -> Float[np.ndarray, "samples points 3"]:
        """Positions [m] at distances [m] from the base along the undeformed rod: a cubic spline of the nodes."""
        arcs = np.linspace(0.0, self.rod.length_m, self.rod.elements + 1)
        return CubicSpline(arcs, self.nodes, axis=1)(arcs_m)

    def orientations(self, arcs_m: Float[np.ndarray, " points"]) -> Float[np.ndarray, "samples points 4"]:
        """Unit quaternions XYZW at such distances: a cubic spline of the elements, clamped at the base."""
        centres = (np.arange(self.rod.elements) + 0.5) * self.rod.length_m / self.rod.elements
        frames = np.concatenate(
            [np.broadcast_to([0.0, 0.0, 0.0, 1.0], self.frames[:, :1].shape), self.frames], 1
        )
        spline = CubicSpline(np.append(0.0, centres), continuous_signs(frames, axis=1), axis=1)(arcs_m)
        return spline / np.linalg.norm(spline, axis=-1, keepdims=True)


def simulate_rod(
    rod: Rod, stick: Stick, *, duration_s: float, rate_hz: float, dt_s: float = 2.5e-4, progress: bool = False
) -> RodMotion:
    """Move a rod from rest, straight and upright, and sample it from time 0 on.

    Position Verlet steps of Cosserat dynamics with bending, twist, shear and stretch. The first element stays
    upright, so that bending starts half an element above the base.

    Parameters
    ----------
    rod, stick
        What moves, and what moves it.
    duration_s
        Length of the simulation [s].
    rate_hz
        Samples per second [Hz]; their interval is rounded to a whole number of steps.
    dt_s
        Step [s]; a longitudinal wave must not pass an element in it.
    progress
        Show a progress bar.

    Raises
    ------
    InputError
        If the stick is not on the rod, the rate is above that of the steps, or the rod has become unstable (too long
        a step).
    """
    if not 0 <= stick.arc_m <= rod.length_m:
        raise bad_input("stick", "simulate_rod", f"on the rod of {rod.length_m:g} m", f"{stick.arc_m:g} m")
    every = round(1 / (rate_hz * dt_s))
    if every < 1:
        raise bad_input(
            "rate_hz", "simulate_rod", f"at most one sample per step of {dt_s:g} s", f"{rate_hz:g} Hz"
        )
    samples = int(duration_s / (every * dt_s) + 1e-9) + 1
    system, body = _assembled(rod, stick, (samples - 1) * every, dt_s)
    stepper, time, nodes, frames = elastica.PositionVerlet(), 0.0, [], []
    for sample in tqdm(range(samples), disable=not progress, mininterval=2):
        for _ in range(every if sample else 0):
            time = stepper.step(system, time, dt_s)
        nodes.append(body.position_collection.T.copy())
        frames.append(body.director_collection.T.copy())  # [elements, 3, 3]: the columns are the axes
        if not np.abs(nodes[-1]).max() < 2 * rod.length_m:  # also where it is not finite
            raise bad_input("dt_s", "simulate_rod", "short enough for a stable rod [s]", f"{dt_s:g}")
    quaternions = np.stack([Rotation.from_matrix(matrices).as_quat() for matrices in frames])
    return RodMotion(rod, np.arange(samples) * every * dt_s, np.stack(nodes), quaternions)


class _System(elastica.BaseSystemCollection, elastica.Constraints, elastica.Forcing, elastica.Damping):
    """PyElastica's modules that are needed here."""


class _Pull(elastica.NoForces):
    """The stick's force, shared by the two nodes around its point in the ratio of their distances."""

    def __init__(self, rod: Rod, stick: Stick, steps: int, dt_s: float) -> None:
        self.stick, self.dt_s = stick, dt_s
        self.nodes, self.shares = _nodes_around(rod, stick.arc_m)
        middles = (np.arange(steps) + 0.5) * dt_s  # forces act in the middle of a step
        self.hand = stick.path(middles)
        self.hand_velocity = np.gradient(self.hand, dt_s, axis=0)

    def apply_forces(self, system: Any, time: Any = 0.0) -> None:
        step = int(time / self.dt_s)
        position = system.position_collection[:, self.nodes] @ self.shares
        velocity = system.velocity_collection[:, self.nodes] @ self.shares
        force = self.stick.stiffness * (self.hand[step] - position)
        force += self.stick.damping * (self.hand_velocity[step] - velocity)
        system.external_forces[:, self.nodes] += np.outer(force, self.shares)


def _assembled(rod: Rod, stick: Stick, steps: int, dt_s: float) -> tuple[_System, Any]:
    """Put together what PyElastica steps."""
    body = elastica.CosseratRod.straight_rod(
        rod.elements,
        np.zeros(3),
        np.array([0.0, 0.0, 1.0]),
        np.array([1.0, 0.0, 0.0]),
        rod.length_m,
        rod.radius_m,
        rod.density,
        youngs_modulus=rod.youngs_modulus_pa,
        shear_modulus=rod.youngs_modulus_pa / 3,
    )
    for arc in rod.imu_arcs_m:
        nodes, shares = _nodes_around(rod, arc)
        body.mass[nodes] += rod.imu_mass_kg * shares
    system = _System()
    system.append(body)
    base = {"constrained_position_idx": (0,), "constrained_director_idx": (0,)}
    system.constrain(body).using(elastica.OneEndFixedBC, **base)
    gravity = np.array([0.0, 0.0, -rod.gravity])
    system.add_forcing_to(body).using(elastica.GravityForces, acc_gravity=gravity)
    system.add_forcing_to(body).using(_Pull, rod, stick, steps, dt_s)
    system.dampen(body).using(
        elastica.AnalyticalLinearDamper,
        translational_damping_constant=rod.translational_damping,
        rotational_damping_constant=rod.rotational_damping,
        time_step=dt_s,
    )
    system.finalize()
    return system, body


def _nodes_around(rod: Rod, arc_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Two neighbouring nodes around an arc length, and their shares of what stands there."""
    place = arc_m / rod.length_m * rod.elements
    first = min(int(place), rod.elements - 1)
    return np.array([first, first + 1]), np.array([1 - (place - first), place - first])
