r"""Estimators on the bend tests of Mitchell et al. 2021 (Fig. 9): the paper's filter, and ours with its calibrations.

**Ours** fits the bend to the two ratios of the transverse over the axial field
(:class:`~edition1_companion.twins.field_ratios.FieldRatios`), less those of the first two seconds, in which the module
is taken to be straight; each reading alone. Reasons: the sensor changes its gain and the module its length during a
test, and the ratios depend little on either; two ratios determine two coordinates, so there is one solution and no
need for particles; and the noise, 0.3 deg, is small beside the errors of the model, so that a motion model gains
little.

What could be tuned is fixed here before an error is computed: arc length 13 mm for ours, the masks of the loaders,
the seconds at rest, the bend above which a direction counts.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
import torch
from jaxtyping import Float
from torch import Tensor

from edition1.errors import require
from edition1.estimation.base import track
from edition1.estimation.particle_filter import ParticleFilter
from edition1.estimation.regions import Disc
from edition1.kinematics.bend import MAX_BEND, bend_angle_and_direction, bend_vector
from edition1.sensing.bend_sensor import BendSensor
from edition1_companion.recordings.mitchell2021_conventions import model_axes, noise_of_sigma
from edition1_companion.twins.bend_curves import SENSOR_NOISE_MT
from edition1_companion.twins.bend_tests import BendTake
from edition1_companion.twins.field_ratios import FieldRatios, invert, transverse_to_axial

OUR_LENGTH_MM = 13.0
"""Arc length of ours, that of the released code for the recorded data [mm]."""
LEAST_BEND_DEG = 20.0
"""Directions are compared where motion capture sees at least this bend [deg]."""
THINNED = 8
"""Calibrations use every eighth reading: neighbours are nearly the same."""
LARGEST_CALIBRATED_DEG = 60.0
"""Calibration readings are used up to this bend, a little beyond the tests' [deg]."""
PAPER_SETTINGS = {
    "paper, as printed": {"process_noise_pi": 0.002, "axial": True, "zeroed": False},
    "paper, as released": {"process_noise_pi": 0.0005, "axial": False, "zeroed": True},
}
"""The paper's filter: the experiments' process noise and all three axes; and as the released code treats recordings:
process noise 0.001 pi/2, axial component dropped, transverse ones less the mean of the first 100 readings."""
SIGMA_MT = 0.01
"""Sigma of eq. (1) in the released code; the paper does not state it [mT]."""
IDENTITY = torch.eye(2, dtype=torch.float64)


@dataclass(frozen=True)
class Calibration:
    """Matrix of :class:`~edition1_companion.twins.field_ratios.FieldRatios`, by linear least squares on the ratios.

    Attributes
    ----------
    name
        What it was fitted to.
    matrix
        The matrix.
    in_capture_frame
        Whether directions estimated with it are azimuths of the motion capture.
    spread_rad
        Root mean square error of the bend angle on the readings that it was fitted to [rad]: part of the reported
        uncertainty.
    """

    name: str
    matrix: Float[Tensor, "2 2"]
    in_capture_frame: bool
    spread_rad: float


NONE = Calibration("none", IDENTITY, False, 0.0)


def fit(
    name: str,
    measured: Float[Tensor, "n 2"],
    q: Float[Tensor, "n 2"],
    sensor: BendSensor,
    *,
    per_axis: bool = False,
    in_capture_frame: bool = True,
) -> Calibration:
    """Fit a factor and a turn about the body, or with ``per_axis`` all four elements, to known bends.

    Parameters
    ----------
    name, in_capture_frame
        As for :class:`Calibration`.
    measured
        Ratios less those at rest.
    q
        Bend vectors [rad].
    sensor
        The sensor as drawn.
    per_axis
        Also a factor for each transverse axis; needs several directions.

    Raises
    ------
    InputError
        If no bend is known.
    """
    require(len(q), "bends", f"calibration {name!r}", "known at one reading or more", "none")
    h = transverse_to_axial(sensor(q))
    if per_axis:
        # by sums, as below: the last digits of LAPACK's least squares change from run to run
        gram, right = ((h.unsqueeze(-1) * x.unsqueeze(-2)).sum(0) for x in (h, measured))
        matrix = torch.linalg.solve(gram, right).T
    else:
        h_c, m_c = torch.view_as_complex(h.contiguous()), torch.view_as_complex(measured.contiguous())
        factor = (m_c * h_c.conj()).sum() / (h_c * h_c.conj()).sum()
        matrix = torch.stack(
            [torch.stack([factor.real, -factor.imag]), torch.stack([factor.imag, factor.real])]
        )
    found, _ = invert(measured, FieldRatios(sensor, matrix), 1.0)
    error = torch.linalg.vector_norm(found, dim=-1) - torch.linalg.vector_norm(q, dim=-1)
    return Calibration(name, matrix, in_capture_frame, float((error**2).mean().sqrt()))


def fit_takes(
    name: str, takes: Sequence[BendTake], sensor: BendSensor, *, per_axis: bool = False
) -> Calibration:
    """Fit to motion capture (y axis) in bend tests; parameters as for :func:`fit`."""
    measured, q = [], []
    for take in takes:
        known = torch.from_numpy(take.truth["bend_rad"].notna().to_numpy(copy=True))
        truth = torch.from_numpy(take.truth[["bend_rad", "direction_rad"]].to_numpy(copy=True))[known]
        measured.append(take.ratios[known][::THINNED])
        q.append(bend_vector(truth[:, 0], truth[:, 1])[::THINNED])
    return fit(name, torch.cat(measured), torch.cat(q), sensor, per_axis=per_axis)


def fit_readings(readings: pd.DataFrame, sensor: BendSensor) -> Calibration:
    """Fit to the calibration readings: medians of each file, less the mean of those at 0 deg.

    Directions are nominal ones, not those of motion capture.

    Parameters
    ----------
    readings
        Table of :func:`edition1_companion.recordings.mitchell2021_tables.read_calibration`.
    sensor
        The sensor as drawn.
    """
    pose = ["direction_rad", "bend_rad", "repeat"]
    files = readings.groupby(pose, as_index=False).median()
    files = files[files["bend_rad"] <= np.radians(LARGEST_CALIBRATED_DEG) + 1e-9]
    field = torch.from_numpy(files[["bx_mT", "by_mT", "bz_mT"]].to_numpy(copy=True))
    seen = transverse_to_axial(model_axes(field))
    straight = torch.from_numpy((files["bend_rad"] == 0).to_numpy(copy=True))
    known = torch.from_numpy(files[["bend_rad", "direction_rad"]].to_numpy(copy=True))
    q = bend_vector(known[:, 0], known[:, 1])
    return fit("calibration readings", seen - seen[straight].mean(0), q, sensor, in_capture_frame=False)


def calibrations(
    take: BendTake, takes: Sequence[BendTake], sensor: BendSensor, readings: pd.DataFrame
) -> list[Calibration]:
    """Calibrations that a take may be judged with: none of them has seen it.

    None; the other try of the same test (repeatability), where there is one; all takes of the other tests, with a
    common factor and with one per axis; the calibration readings, where there are some.
    """
    found = [NONE]
    same = [other for other in takes if other.test == take.test and other.attempt != take.attempt]
    others = [other for other in takes if other.test != take.test]
    if same:
        found.append(fit_takes("other try", same, sensor))
    if others:
        found.append(fit_takes("other tests", others, sensor))
    if len({other.test for other in others}) > 1:
        found.append(fit_takes("other tests, per axis", others, sensor, per_axis=True))
    if len(readings):
        found.append(fit_readings(readings, sensor))
    return found


def ours(
    take: BendTake, calibration: Calibration, sensor: BendSensor, *, zeroed: bool = True
) -> pd.DataFrame:
    """Estimates of ours: ``bend_rad, direction_rad, deviation_rad`` at each reading.

    Parameters
    ----------
    take
        A bend test.
    calibration
        From other readings.
    sensor
        The sensor as drawn.
    zeroed
        Whether the ratios at rest are subtracted.
    """
    measured = take.ratios if zeroed else take.ratios + take.rest
    noise = SENSOR_NOISE_MT / float(take.field[:, 2].abs().median())
    q, deviation = invert(measured, FieldRatios(sensor, calibration.matrix), noise)
    table = _angles(q)
    table["deviation_rad"] = np.hypot(deviation.numpy(), calibration.spread_rad)
    return table


def paper_filters(
    runs: Sequence[tuple[BendTake, float]], *, particles: int = 1000, seed: int = 0
) -> list[dict[str, pd.DataFrame]]:
    """Estimates of the paper's filter in both of :data:`PAPER_SETTINGS`, for each run by setting; no deviations.

    The cloud starts straight and is in single precision, whose rounding, 3e-6 mT, is far below sigma. The released
    code resamples before it estimates and takes the direction over all particles; here both settings have the order
    and the estimate of the paper.

    Parameters
    ----------
    runs
        Bend tests, each with the arc length of the model [mm].
    particles, seed
        As for the filter.
    """
    steps = max(len(take.field) for take, _ in runs)
    fields, masks = [], []
    for setting in PAPER_SETTINGS.values():
        across = torch.tensor([1.0, 1.0, 0.0]) * setting["zeroed"]
        zeroed = [take.field - across * take.rest_field for take, _ in runs]
        # Shorter takes go on with their last reading; what is estimated there is dropped.
        padded = [torch.cat([u, u[-1:].expand(steps - len(u), 3)]) for u in zeroed]
        fields.append(torch.stack(padded, dim=1))
        masks.append(torch.tensor([True, True, setting["axial"]]).expand(steps, 1, 3))
    walk = torch.tensor([setting["process_noise_pi"] for setting in PAPER_SETTINGS.values()]) * math.pi
    lengths_mm = torch.tensor([length_mm for _, length_mm in runs])
    of_length = [(BendSensor(1e-3 * x), lengths_mm == x) for x in lengths_mm.unique().tolist()]

    def sensing(q: Tensor) -> Tensor:
        u = q.new_empty(*q.shape[:-1], 3)
        for sensor, mine in of_length:
            u[:, mine] = sensor(q[:, mine])
        return u

    cloud = ParticleFilter(
        sensing,
        walk[:, None, None].expand(-1, 1, 2),
        noise_of_sigma(SIGMA_MT),
        Disc(MAX_BEND),
        particles=particles,
        estimate="best tenth",
        resampling="multinomial",
    )
    u = torch.stack(fields, dim=1).float()
    found = track(cloud, u, torch.zeros(*u.shape[1:3], 2), seed=seed, mask=torch.stack(masks, dim=1))
    return [
        {name: _angles(found.q[: len(take.field), s, k].double()) for s, name in enumerate(PAPER_SETTINGS)}
        for k, (take, _) in enumerate(runs)
    ]


def _angles(q: Tensor) -> pd.DataFrame:
    bend, direction = bend_angle_and_direction(q)
    return pd.DataFrame(
        {"bend_rad": bend.numpy(), "direction_rad": direction.numpy(), "deviation_rad": np.nan}
    )
