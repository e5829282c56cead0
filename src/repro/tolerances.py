"""A robot that is not as drawn: what may be off, by how much, and how its readings follow."""

from __future__ import annotations

import math
import re
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import TypeVar

import numpy as np
from scipy.spatial.transform import Rotation

from repro.chain import Link, Place, Segment, point_on
from repro.common import Array, require
from repro.magnets import Magnet, Shape
from repro.parts import Assembly, Sensor
from repro.sensing import Sensing, sensing_of

Described = TypeVar("Described", bound=Assembly)
"""The kind of robot that is described: what is found is of the same kind."""
_STEP = 1e-6
"""Of central differences, in every unit."""
_LINK = ("x", "y", "z", "tilt about x", "tilt about y", "tilt about z")
_MAGNET = ("x", "y", "z", "tilt about x", "tilt about y")


@dataclass(frozen=True)
class Tolerances:
    """How far a robot may be from its drawing: standard deviations. What a part states of its own comes first.

    A part may state more than these: place along the backbone, tilt of a sensor about all axes, size of a magnet.

    Parameters
    ----------
    magnet_position
        Centre of a magnet along each axis of its mount [m].
    magnet_tilt
        Tilt of a magnet about each transverse axis [rad].
    sensor_azimuth
        Azimuth of a sensor [rad].
    sensor_radius
        Its distance from the backbone, relative.
    sensor_tilt
        Its tilt about the tangential direction [rad]; of a chip with three axes about each of its axes.
    sensor_gain
        Gain of each of its axes, relative.
    moments
        Every multipole moment, relative; magnets of one shape share it.
    chip_position
        Place of a chip with three axes along each axis of the cross-section and along the backbone [m]. Azimuth and
        radius say nothing of a chip on the backbone.
    sensor_offset
        Reading of a sensor without a field [mT]. Zero: as stated.
    earth
        Field of the Earth along each axis of the base [mT]. Zero: as stated.

    Raises
    ------
    InputError
        If one of the first eight is not positive, or another one is negative.

    Examples
    --------
    >>> Tolerances(magnet_position=1e-3).magnet_tilt == math.radians(2.0)
    True
    """

    magnet_position: float = 0.5e-3
    magnet_tilt: float = math.radians(2.0)
    sensor_azimuth: float = 0.01 * 2 * math.pi
    sensor_radius: float = 0.01
    sensor_tilt: float = math.radians(1.0)
    sensor_gain: float = 0.01
    moments: float = 0.02
    chip_position: float = 0.3e-3
    sensor_offset: float = 0.0
    earth: float = 0.0

    def __post_init__(self) -> None:
        values = list(asdict(self).values())
        good = all(0 < x < math.inf for x in values[:8]) and all(0 <= x < math.inf for x in values[8:])
        require(good, "tolerances", "Tolerances", "positive, or zero for what is as drawn", self)


def placed(robot: Described, parameters: Mapping[str, float]) -> Described:
    r"""Return the robot whose parts are off their drawing by parameters, as :class:`Calibration` names them.

    Parts move within the cross-section that they are mounted on. Along the backbone a part follows its curve; at the
    end of a segment, and beyond it, it goes straight on. A dimension :math:`d` of a magnet that is off by :math:`x`
    is :math:`d\,e^{x/d}`, and its polarisation is multiplied by :math:`e^x`: neither changes its sign.

    Raises
    ------
    InputError
        If no robot is like that.
    """
    shapes, rows = _strengths(robot, parameters)
    magnets = [_magnet_off(robot, k, shapes[k], parameters) for k in range(len(robot.magnets))]
    sensors = [_sensor_off(robot, k, parameters) for k in range(len(robot.sensors))]
    relative = np.vectorize(parameters.get)(_moment_names(robot, rows.shape[1]), 0.0)
    earth = np.array([parameters.get(f"Earth field along {x}", 0.0) for x in "xyz"])
    if earth.any():
        robot = robot.replaced(earth=earth if robot.earth is None else robot.earth + earth)
    segments = [_segment_off(robot, k, parameters) for k in range(len(robot.segments))]
    return robot.replaced(segments=segments, magnets=magnets, sensors=sensors, moments=rows * (1 + relative))


def _segment_off(robot: Assembly, k: int, parameters: Mapping[str, float]) -> Segment:
    part, own = robot.segments[k], _own(parameters, f"segment {k + 1} ")
    if not isinstance(part, Link) or not own:
        return part
    moved, about = ([own[x] for x in names] for names in (_LINK[:3], _LINK[3:]))
    turned = part.end.rotation @ Rotation.from_rotvec(about).as_matrix()
    orientation = Rotation.from_matrix(turned).as_quat()
    return replace(part, offset=part.end.position + moved, orientation=orientation)


def _magnet_off(robot: Assembly, k: int, shape: Shape, parameters: Mapping[str, float]) -> Magnet:
    part, own = robot.magnets[k], _own(parameters, f"magnet {k + 1} ")
    R = part.place.rotation
    tilted = R @ Rotation.from_euler("XY", [own["tilt about x"], own["tilt about y"]]).as_matrix()
    at, beyond = _along(robot, part.place, own["along"])
    position = part.place.position + R @ [own[x] for x in "xyz"] + [0.0, 0.0, beyond]
    return replace(part, shape=shape, at=at, position=position, direction=tilted[:, 2])


def _sensor_off(robot: Assembly, k: int, parameters: Mapping[str, float]) -> Sensor:
    part, own = robot.sensors[k], _own(parameters, f"sensor {k + 1} ")
    around, outwards = Rotation.from_euler("z", own["azimuth"]), 1 + own["radius"]
    at, beyond = _along(robot, part.place, own["along"])
    position = part.place.position * [outwards, outwards, 1.0] + [own[x] for x in "xyz"]
    tilt = Rotation.from_euler("YXZ", [-own["tilt"], own["tilt about x"], own["tilt about z"]])
    R = around * Rotation.from_matrix(part.place.rotation) * tilt
    turned = {"direction": R.as_matrix()[:, 2]} if part.axes == 1 else {"orientation": R.as_quat()}
    gain = np.multiply(part.gain, [1 + own[x] for x in _per_axis("gain", part.axes)])
    offset = np.add(part.offset, [own[x] for x in _per_axis("offset", part.axes)])
    return replace(
        part, at=at, position=around.apply(position) + np.array([0.0, 0.0, beyond]), **turned,
        radial=0.0, azimuth=0.0, tilt=0.0, gain=tuple(gain.tolist()), offset=tuple(offset.tolist()),
    )  # fmt: skip


def _own(parameters: Mapping[str, float], owner: str) -> defaultdict[str, float]:
    """Return the parameters of a part by their names behind its own, zero if not given."""
    found = {x.removeprefix(owner): value for x, value in parameters.items() if x.startswith(owner)}
    return defaultdict(float, found)


def _sizes(shape: Shape) -> dict[str, float]:
    """Dimensions of a magnet that are there."""
    return {name: size for name, size in vars(shape).items() if name != "polarisation_mt" and size > 0}


def _per_axis(name: str, axes: int) -> list[str]:
    return [name] if axes == 1 else [f"{name} {axis}" for axis in "xyz"]


def _moment_names(robot: Assembly, terms: int) -> Array:
    """Names of the relative moments of every magnet ``[m, terms]``: magnets of one shape share theirs."""
    alike = len({magnet.shape for magnet in robot.magnets}) == 1
    owners = ["" if alike else f"magnet {k + 1} " for k in range(len(robot.magnets))]
    return np.array([[f"{owner}moment A{2 * k + 1}" for k in range(terms)] for owner in owners])


def _strengths(robot: Assembly, parameters: Mapping[str, float]) -> tuple[list[Shape], Array]:
    """Shapes of the magnets, and their moments without the relative changes of moments."""
    rows, shapes = np.array(sensing_of(robot).moments if robot.moments is None else robot.moments), []
    for k, magnet in enumerate(robot.magnets):
        name, old = f"magnet {k + 1} ", magnet.shape
        own = {x: size * math.exp(parameters.get(name + x, 0.0) / size) for x, size in _sizes(old).items()}
        own["polarisation_mt"] = old.polarisation_mt * math.exp(parameters.get(name + "polarisation", 0.0))
        shapes.append(replace(old, **own))
        if shapes[k] != old:
            orders = 2 * rows.shape[1] - 1
            rows[k] += shapes[k].multipoles(orders) - old.multipoles(orders)
    return shapes, rows


def priors_of(robot: Assembly, t: Tolerances) -> dict[str, float]:
    """Standard deviations of all that may be off, by name."""
    priors: dict[str, float] = {}
    for k, part in enumerate(robot.magnets):
        own = {"position": t.magnet_position, "tilt": t.magnet_tilt, **(part.tolerance or {})}
        stds = dict(zip(_MAGNET, [own["position"]] * 3 + [own["tilt"]] * 2, strict=True))
        stds |= {"along": own.get("at", 0.0), "polarisation": own.get("polarisation", 0.0)}
        stds |= dict.fromkeys(_sizes(part.shape), own.get("size", 0.0))
        priors |= {f"magnet {k + 1} {name}": std for name, std in stds.items()}
    for j, part in enumerate(robot.sensors):
        own, radial = dict(part.tolerance or {}), math.hypot(*part.place.position[:2])
        usual = 0.0 if "position" in own else 1.0  # a stated position says all about the place
        outwards = own["radius"] / radial if radial and "radius" in own else usual * t.sensor_radius
        stds = {"azimuth": own.get("azimuth", usual * t.sensor_azimuth), "radius": outwards}
        stds["tilt"] = own.get("tilt", t.sensor_tilt)
        stds |= dict.fromkeys(_per_axis("gain", part.axes), own.get("gain", t.sensor_gain))
        chip = part.axes == 3
        turned = own.get("tilt", t.sensor_tilt if chip else 0.0)
        stds |= dict.fromkeys(["tilt about x", "tilt about z"][: part.axes], turned)
        moved = t.chip_position if chip else 0.0
        stds |= dict.fromkeys("xy", own.get("position", moved))
        stds |= {"z": own.get("position", 0.0), "along": own.get("at", usual * moved)}
        stds |= dict.fromkeys(_per_axis("offset", part.axes), own.get("offset", t.sensor_offset))
        priors |= {f"sensor {j + 1} {name}": std for name, std in stds.items()}
    priors |= dict.fromkeys(
        _moment_names(robot, sensing_of(robot).moments.shape[1]).ravel().tolist(), t.moments
    )
    for k, link in enumerate(robot.segments):
        own = dict(link.tolerance or {}) if isinstance(link, Link) else {}
        stds = [own.get("offset", 0.0)] * 3 + [own.get("tilt", 0.0)] * 3
        priors |= {f"segment {k + 1} {name}": std for name, std in zip(_LINK, stds, strict=True)}
    priors |= dict.fromkeys([f"Earth field along {x}" for x in "xyz"], t.earth)
    return {name: std for name, std in priors.items() if std}


def in_words(robot: Assembly, parameter: str) -> str:
    """Return a parameter as sentences call it: that of a sensor begins with the name in the robot file.

    Examples
    --------
    >>> robot = Assembly([Link(0.1)], sensors=[Sensor(1, 0.05, name="B7")])
    >>> in_words(robot, "sensor 1 gain"), in_words(robot, "magnet 1 along")
    ('B7 gain', 'magnet 1 along')
    """
    own = re.match(r"sensor (\d+)", parameter)
    return robot.part_names[int(own[1]) - 1] + parameter[own.end() :] if own else parameter


def _along(robot: Assembly, where: Place, far: float) -> tuple[float, float]:
    """Place along its segment after a move, and how far beyond the end of the segment that is."""
    reach, at = robot.segments[where.segment - 1].length if where.segment else 0.0, where.at
    if 0 < at < reach:
        at = min(max(at + far, 0.0), reach)
    return at, where.at + far - at


def _about(axis: str, angle: float) -> Array:
    return Rotation.from_euler(axis, angle).as_matrix()


def slopes_of(described: Assembly, moved: Sensing, parameters: Mapping[str, float], q: Array) -> Array:
    """Return slopes of readings by the parameters ``[poses, s, k]``.

    The wrench of a pair times how the part moves, for what every calibration has; central differences for the rest.
    """
    robot, gain = moved.robot, moved.tables.gain
    u, wrench = moved.wrenches(q)
    on_backbone = [point_on(part.place.segment, part.place.at) for part in (*robot.magnets, *robot.sensors)]
    frames, n_m = robot.poses(q, on_backbone), len(robot.magnets)
    columns: dict[str, Array] = {}
    for k in range(n_m):
        columns |= _of_magnet(described, robot, k, frames[:, k], wrench[:, :, k], parameters)
    first = np.cumsum([0, *(part.axes for part in robot.sensors)])
    for j in range(len(robot.sensors)):
        rows = slice(first[j], first[j + 1])
        own = _of_sensor(
            described, robot, j, frames[:, n_m + j], wrench[:, rows].sum(2), u[:, rows], parameters
        )
        for name, slope in own.items():
            columns[name] = np.zeros(u.shape)
            columns[name][:, rows] = slope
    before, names = _strengths(described, parameters)[1], _moment_names(described, moved.moments.shape[1])
    for name in dict.fromkeys(names.T.ravel().tolist()):
        one = np.where(names == name, before, 0.0)
        columns[name] = Sensing(robot, moments=one)(q)[:, : len(gain)]
    columns = {name: slope * gain for name, slope in columns.items()}
    offsets = [
        f"sensor {j} {x}" for j, part in enumerate(robot.sensors, 1) for x in _per_axis("offset", part.axes)
    ]
    columns |= {
        name: np.broadcast_to(one, u.shape) for name, one in zip(offsets, np.eye(len(gain)), strict=True)
    }
    for name in parameters.keys() - columns.keys():
        up, down = (
            sensing_of(placed(described, {**parameters, name: parameters[name] + h}))(q)[:, : len(gain)]
            for h in (_STEP, -_STEP)
        )
        columns[name] = (up - down) / (2 * _STEP)
    return np.stack([columns[name] for name in parameters], axis=-1)


def _of_magnet(
    described: Assembly, robot: Assembly, k: int, frame: Array, wrench: Array, parameters: Mapping[str, float]
) -> dict[str, Array]:
    """Slopes of all readings by place and tilt of a magnet."""
    name, F = f"magnet {k + 1} ", frame[:, :3, :3]
    R = F @ described.magnets[k].place.rotation
    centre = frame[:, :3, 3] + F @ robot.magnets[k].place.position
    tilt = parameters.get(name + "tilt about x", 0.0)
    turns = np.stack([np.eye(3)[:, 0], _about("x", tilt)[:, 1]], axis=1)
    force = wrench[..., :3]
    torque = wrench[..., 3:] - np.cross(centre[:, None], force)
    by = np.concatenate([-force @ R, -torque @ (R @ turns)], axis=-1)
    return {name + x: by[..., c] for c, x in enumerate(_MAGNET)}


def _of_sensor(
    described: Assembly, robot: Assembly, j: int, frame: Array, wrench: Array, u: Array,
    parameters: Mapping[str, float],
) -> dict[str, Array]:  # fmt: skip
    """Slopes of a sensor's own readings by its place, tilt and gain."""
    name, part, place = f"sensor {j + 1} ", described.sensors[j], robot.sensors[j].place
    F, at = frame[:, :3, :3], frame[:, :3, 3] + frame[:, :3, :3] @ place.position
    azimuth, tilt = (parameters.get(name + x, 0.0) for x in ("azimuth", "tilt"))
    turned = _about("z", azimuth)
    force, torque = wrench[..., :3], wrench[..., 3:] - np.cross(at[:, None], wrench[..., :3])
    around = np.cross([0.0, 0.0, 1.0], place.position)
    outwards = turned @ (part.place.position * [1.0, 1.0, 0.0])
    across = -(turned @ part.place.rotation)[:, 1]
    tilted = turned @ part.place.rotation @ _about("y", -tilt)
    slopes = {
        "azimuth": _work(force, F @ around) + _work(torque, F[..., 2]),
        "radius": _work(force, F @ outwards),
        "tilt": _work(torque, F @ across),
        "tilt about x": _work(torque, F @ tilted[:, 0]),
        "tilt about z": _work(torque, F @ place.rotation[:, 2]),
    }
    slopes |= {x: _work(force, F @ turned[:, c]) for c, x in enumerate("xyz")}
    for axis, x in zip(np.eye(part.axes), _per_axis("gain", part.axes), strict=True):
        slopes[x] = u * axis / (1 + parameters.get(name + x, 0.0))
    return {name + x: slope for x, slope in slopes.items()}


def _work(force: Array, motion: Array) -> Array:
    return np.einsum("psi,pi->ps", force, motion)
