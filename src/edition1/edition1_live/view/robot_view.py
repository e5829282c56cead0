"""Robots and their configurations as shapes to look at: recorded, with traces, or live."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from edition1.errors import bad_input
from edition1.kinematics.motion import backbone_motion
from edition1.kinematics.mounts import Mounts, magnet_mounts
from edition1.kinematics.robot import Robot
from edition1_live.view.shape_view import Markers, Shape, ShapeView, Traces

POINTS_PER_SEGMENT = 9
"""Enough for a segment bent by a half turn to look smooth."""
_LEAST_RADIUS = 0.05  # of the body, as a part of the length, where nothing else tells it


def shape_view(
    robot: Robot,
    q: Float[Tensor, "t n_q"],
    *,
    times: Float[np.ndarray, " t"],
    label: str,
    estimate: Float[Tensor, "t n_q"] | None = None,
    covariance: Float[Tensor, "t n_q n_q"] | None = None,
    traces: Sequence[Traces] = (),
) -> ShapeView:
    """Return a view of a robot over time, with its configuration as traces.

    Parameters
    ----------
    robot
        One robot, not a batch.
    q
        True configurations; the magnets and sensors are drawn there.
    times
        Their times [s].
    label
        What there is to see; times, motion and error of the tip are added in numbers.
    estimate
        Estimated configurations at the same times.
    covariance
        Covariances of the estimate, or of ``q`` where there is none: drawn as a tube along the backbone.
    traces
        More panels, such as the readings of the sensors.

    Raises
    ------
    InputError
        If the robot is a batch of robots, or what :class:`~edition1_live.view.shape_view.ShapeView` refuses.
    """
    if robot.magnets.local.ndim > 3 or robot.sensors.local.ndim > 3:
        raise bad_input("robot", "shape_view", "one robot", "a batch of robots")
    deviation = (
        None
        if covariance is None
        else backbone_deviation(robot, q if estimate is None else estimate, covariance)
    )
    points = backbone_points(robot, q)
    if estimate is None:
        shapes = (Shape("shape", points, deviation),)
    else:
        guess = Shape("estimate", backbone_points(robot, estimate), deviation, role="estimate")
        shapes = (Shape("truth", points), guess)
    return ShapeView(
        label=" ".join([label, *_in_numbers(shapes, times)]),
        time_s=times,
        shapes=shapes,
        radius_m=body_radius(robot),
        magnets=_markers(robot, q, robot.magnets),
        sensors=_markers(robot, q, robot.sensors),
        traces=(*_configuration(robot, q, estimate), *traces),
    )


def backbone_points(robot: Robot, q: Float[Tensor, "*batch n_q"]) -> Float[np.ndarray, "*batch k 3"]:
    """Points along the backbone [m], nine per segment, neighbours sharing theirs."""
    return robot.mount_poses(q, _along(robot))[..., :3, 3].detach().double().numpy(force=True)


def backbone_deviation(
    robot: Robot, q: Float[Tensor, "*batch n_q"], covariance: Float[Tensor, "*batch n_q n_q"]
) -> Float[np.ndarray, "*batch k"]:
    r"""Largest standard deviation [m] in any direction of each of the :func:`backbone_points`.

    By linear propagation: the square root of the largest eigenvalue of :math:`J \Sigma J^T`, with the derivatives
    :math:`J` of a point by the configuration.

    Examples
    --------
    Bending by 0.01 rad of standard deviation moves the tip of a straight segment of 0.11 m by half of that times
    its length:

    >>> from edition1.kinematics.paper_robots import pcc_robot
    >>> deviation = (0.01 * torch.tensor([0.022, 0.0, 0.0], dtype=torch.float64)) ** 2
    >>> float(backbone_deviation(pcc_robot(), torch.zeros(3, dtype=torch.float64), torch.diag(deviation))[-1])
    0.00055
    """
    _, derivatives = backbone_motion(robot, q, _along(robot))
    by_q = derivatives[..., :3, 3]  # [*batch, k, n_q, 3]
    spread = by_q.transpose(-1, -2) @ covariance.unsqueeze(-3).to(by_q) @ by_q
    largest = torch.linalg.eigvalsh(spread)[..., -1].clamp(min=0)  # rounding makes a zero slightly negative
    return largest.sqrt().detach().double().numpy(force=True)


def live_scene(robot: Robot, *, label: str, covariance: bool = False) -> dict[str, Any]:
    """What the viewer needs to know of a robot before its first shape: pass it to ``reproViewer.mount``.

    Parameters
    ----------
    robot
        What is estimated.
    label
        What there is to see, in words.
    covariance
        Whether the shapes will come with a covariance.
    """
    reach, radius = 1e3 * robot.length, 1e3 * body_radius(robot)
    side = (
        0.7 * reach + radius
    )  # of a segment bent by a half turn, the tip is 0.64 of its length from the base
    shape = {"name": "estimate", "role": "estimate"}
    scene: dict[str, Any] = {
        "label": label,
        "box": [[-side, -side, 0.0], [side, side, 1.15 * reach]],
        "radius": radius,
        "shapes": [{**shape, "deviation": []} if covariance else shape],
    }
    return scene | {
        name: {} for name, mounts in (("magnets", robot.magnets), ("sensors", robot.sensors)) if len(mounts)
    }


def live_frame(
    robot: Robot, q: Float[Tensor, " n_q"], covariance: Float[Tensor, "n_q n_q"] | None = None
) -> dict[str, Any]:
    """One shape [mm] as JSON takes it: pass it to ``update`` of the viewer's handle."""
    shape = {"points": _flat(1e3 * backbone_points(robot, q), 2)}
    if covariance is not None:
        shape["deviation"] = _flat(1e3 * backbone_deviation(robot, q, covariance), 3)
    frame: dict[str, Any] = {"shapes": [shape]}
    for name, mounts in (("magnets", robot.magnets), ("sensors", robot.sensors)):
        if (markers := _markers(robot, q, mounts)) is not None:
            frame[name] = {
                "points": _flat(1e3 * markers.points_m, 2),
                "directions": _flat(markers.directions, 4),
            }
    return frame


def body_radius(robot: Robot) -> float:
    """Radius [m] of the body that is drawn: of the segments, else that of the outermost sensor."""
    known = [float(segment.radius) for segment in robot.segments if hasattr(segment, "radius")]  # pyright: ignore[reportAttributeAccessIssue]
    if known:
        return max(known)
    outer = torch.linalg.vector_norm(robot.sensors.local[..., :2, 3], dim=-1)
    return max(_LEAST_RADIUS * robot.length, float(outer.max()) if outer.numel() else 0.0)


def _along(robot: Robot) -> Mounts:
    """Places along the backbone; where segments meet only that of the lower one."""
    segment, axial = [], []
    for i, part in enumerate(robot.segments):
        for d in torch.linspace(0, part.length, POINTS_PER_SEGMENT, dtype=torch.float64)[i > 0 :]:
            segment.append(i)
            axial.append(float(d))
    return magnet_mounts(segment, axial)


def _markers(robot: Robot, q: Tensor, mounts: Mounts) -> Markers | None:
    if not len(mounts):
        return None
    T = robot.mount_poses(q.reshape(-1, robot.n_q), mounts).detach().double().numpy(force=True)
    return Markers(T[..., :3, 3], T[..., :3, 2])


def _configuration(robot: Robot, q: Tensor, estimate: Tensor | None) -> list[Traces]:
    """Panels of the configuration variables: lengths in mm, angles in rad."""
    lengths = [k for k, name in enumerate(robot.coordinates) if name.startswith("delta_")]
    angles = [k for k in range(robot.n_q) if k not in lengths]
    panels = []
    for chosen, factor, unit in ((lengths, 1e3, "mm"), (angles, 1.0, "rad")):
        values, estimates = (
            {}
            if x is None
            else {robot.coordinates[k]: factor * x[:, k].detach().double().numpy(force=True) for k in chosen}
            for x in (q, estimate)
        )
        if chosen:
            panels.append(Traces("configuration", unit, values, estimates))
    return panels


def _in_numbers(shapes: tuple[Shape, ...], times: np.ndarray) -> list[str]:
    """Sentences on the motion of the tip, and on how far off its estimate is."""
    tips = [1e3 * shape.points_m[:, -1] for shape in shapes]
    aside = np.linalg.norm(tips[0][:, :2], axis=-1)
    said = [
        f"{len(times)} frames from {times[0]:.4g} to {times[-1]:.4g} s.",
        f"The tip is {aside.min():.1f} to {aside.max():.1f} mm off the axis of the base.",
    ]
    if len(tips) > 1:
        errors = np.linalg.norm(tips[1] - tips[0], axis=-1)
        said.append(
            f"The estimated tip is {np.median(errors):.2f} mm from the true one in the median, "
            f"{errors.max():.2f} mm at most."
        )
    return said


def _flat(values: np.ndarray, digits: int) -> list[float]:
    return np.round(values, digits).ravel().tolist()
