"""Sensors and magnets in any direction, and unlike magnets: against magpylib's objects, and what is refused."""

import math

import magpylib as magpy
import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from edition1.errors import InputError
from edition1.kernels._sensing import CompiledSensing
from edition1.kinematics.mounts import directed_sensors, magnet_mounts, sensor_mounts
from edition1.robot_file.load import load_robot
from edition1.sensing.linearised import LinearisedSensing
from edition1.sensing.magnetic import readings
from edition1.sensing.placement import PlacedReadings, parameter_names, placed
from edition1_live.robot.calibrate import calibrate, pose_covariance

RING = 'kind = "ring"\nouter_diameter_mm = {}\ninner_diameter_mm = 3\nheight_mm = 4\npolarisation_mt = {}\n'
AXES = ([1, 0, 0], [0, -2, 0], [0.5, 0, 0.5])
HEAD = """
[stream]
format = "frames"
rate_hz = 100
unit = "mT"
noise_mt = 0.001
"""
SEGMENT = """
[[segments]]
kind = "constant_curvature"
length_mm = 100
radius_mm = 20
"""


def magnet(segment, at, size=8, polarisation=1200, rest=""):
    return f"[[magnets]]\nsegment = {segment}\nat_mm = {at}\n{RING.format(size, polarisation)}{rest}\n"


def triple(first, segment, at, place=""):
    """Return a three-axis sensor; its axes are not the ones of the cross-section."""
    return "".join(
        f"[[sensors]]\nchannel = {first + k}\nsegment = {segment}\nat_mm = {at}\n{place}\ndirection = {axis}\n"
        for k, axis in enumerate(AXES)
    )


OFF_AXIS = (
    HEAD
    + SEGMENT
    + magnet(1, 40, rest="direction = [3, 0, 0]")
    + triple(1, 1, 90, "radial_mm = 12\nazimuth_deg = 50")
)
UNLIKE = (
    "earth_mt = [0.02, 0.01, -0.04]"
    + HEAD
    + SEGMENT * 2
    + magnet(1, 40, 8, 1200)
    + magnet(2, 20, 14, -900, "direction = [1, 1, 0.2]")
    + triple(1, 1, 90, "radial_mm = 12\nazimuth_deg = 50")
    + triple(4, 2, 70)
)


def written(tmp_path, text):
    path = tmp_path / "arm.toml"
    path.write_text(text)
    return path


def configurations(found, n=40):
    generator = torch.Generator().manual_seed(0)
    share = torch.rand(n, len(found.lower), dtype=torch.float64, generator=generator)
    return found.lower + (found.upper - found.lower) * share


def by_objects(found, q, places, axes):
    """Readings of magpylib's own objects, posed by hand: magnets by their axes, sensors where the file puts them."""
    sources = []
    for T, ring in zip(found.robot.magnet_poses(q).numpy(), found.magnets, strict=True):
        pose = {"position": T[:3, 3], "orientation": Rotation.from_matrix(T[:3, :3])}
        for diameter, sign in ((ring.outer_diameter, 1), (ring.inner_diameter, -1)):
            polarization = (0, 0, sign * ring.polarisation_mt / 1e3)
            sources.append(
                magpy.magnet.Cylinder(polarization=polarization, dimension=(diameter, ring.height), **pose)
            )
    u = []
    for (segment, at, radial, azimuth), axis in zip(places, axes, strict=True):
        frame = found.robot.mount_poses(q, magnet_mounts([segment], at))[0].numpy()
        place = frame[:3, :3] @ [radial * math.cos(azimuth), radial * math.sin(azimuth), 0] + frame[:3, 3]
        field = 1e3 * magpy.getB(sources, place, sumup=True) + found.earth_mt.numpy()
        u.append(float(field @ frame[:3, :3] @ axis / np.linalg.norm(axis)))
    return u


@pytest.mark.parametrize(
    ("text", "places"),
    [
        (OFF_AXIS, [(0, 0.09, 0.012, math.radians(50))] * 3),
        (UNLIKE, [(0, 0.09, 0.012, math.radians(50))] * 3 + [(1, 0.07, 0.0, 0.0)] * 3),
    ],
)
def test_directions_and_unlike_magnets_read_as_magpylib(tmp_path, text, places):
    """Transverse ring, three-axis sensor beside the backbone, two unlike rings; torch and compiled to rounding."""
    found = load_robot(written(tmp_path, text))
    q = configurations(found)
    axes = np.array(AXES * (len(places) // 3), dtype=float)
    u, J = found.sensing().linearise(q)
    expected = torch.tensor([by_objects(found, x, places, axes) for x in q], dtype=torch.float64)
    assert float((u - expected).abs().max()) < 2e-5
    assert float(expected.abs().max()) > 0.2
    torch.testing.assert_close(
        readings(found.robot, q, found.magnets, earth_mt=found.earth_mt), expected, rtol=0, atol=1e-9
    )
    for theirs, ours in zip(CompiledSensing(found.sensing()).linearise(q), (u, J), strict=True):
        torch.testing.assert_close(theirs, ours, rtol=1e-11, atol=1e-11)
    by_hand = torch.func.jacrev(found.sensing())(q[0])
    torch.testing.assert_close(by_hand, J[0], rtol=1e-12, atol=1e-12)
    step = 1e-6 * torch.eye(len(q[0])).double()
    numeric = torch.stack([found.sensing()(q[0] + d) - found.sensing()(q[0] - d) for d in step], -1) / 2e-6
    torch.testing.assert_close(J[0], numeric, rtol=1e-4, atol=1e-4)


def test_magnets_that_are_alike_share_their_moments(tmp_path):
    alike = (
        UNLIKE.replace(magnet(2, 20, 14, -900, ""), magnet(2, 20)).replace("14", "8").replace("-900", "1200")
    )
    found = load_robot(written(tmp_path, alike))
    assert found.moments.ndim == 1
    assert found.magnet == found.magnets[0] == found.magnets[1]
    rows = LinearisedSensing(
        found.robot, found.moments.expand(2, -1), found.gain, found.earth_mt, per_magnet=True
    )
    q = configurations(found)
    assert torch.equal(rows(q), found.sensing()(q))
    assert load_robot(written(tmp_path, UNLIKE)).magnet is None


def test_unlike_magnets_are_calibrated_each_by_itself(tmp_path):
    """Readings of a robot whose moments differ from the file by some per cent, of each magnet another one."""
    found = load_robot(written(tmp_path, UNLIKE))
    names = parameter_names(found.robot, found.moments.shape)
    assert names[-10:-8] == ("magnet 1 moment A1", "magnet 1 moment A3")
    assert names[-5] == "magnet 2 moment A1"
    q, p = configurations(found, 60), torch.zeros(len(names)).double()
    p[names.index("magnet 1 moment A1")], p[names.index("magnet 2 moment A1")] = 0.03, -0.04
    model = PlacedReadings(found.robot, q, found.moments, found.earth_mt)
    u, J, _ = model.linearise(p)
    true = placed(found.robot, found.moments, p)
    sensing = LinearisedSensing(found.robot, true.moments, earth_mt=found.earth_mt, per_magnet=True)
    torch.testing.assert_close(u, sensing(q), rtol=0, atol=1e-12)
    step = 1e-6 * torch.eye(len(names)).double()
    numeric = torch.stack([model.linearise(p + d)[0] - model.linearise(p - d)[0] for d in step], -1) / 2e-6
    torch.testing.assert_close(J, numeric, rtol=1e-5, atol=1e-6)
    calibration = calibrate(found, u, q, pose_covariance(found, 1e-5, 1e-3))
    path = tmp_path / "calibration.json"
    calibration.write(path)
    moments = load_robot(tmp_path / "arm.toml", path).moments[:, 0] / found.moments[:, 0]
    np.testing.assert_allclose(moments, [1.03, 0.96], atol=5e-3)


def test_directions_equal_azimuth_and_tilt_where_both_can_say_it():
    azimuth, tilt = (torch.linspace(a, b, 13).double() for a, b in ((0.0, 6.0), (-3.0, 3.0)))
    mounts = sensor_mounts([0] * 13, 0.1, 0.013, azimuth, tilt)
    same = directed_sensors([0] * 13, 0.1, 0.013, azimuth, 3 * mounts.local[:, :3, 2])
    torch.testing.assert_close(same.local, mounts.local, rtol=0, atol=1e-15)
    along = magnet_mounts([0, 0], 0.05, [[0.0, 0.0, 1.0], [0.0, 0.0, -2.0]]).local
    assert torch.equal(along[0], torch.eye(4).double())
    assert along[1, :3, 2].tolist() == [0, 0, -1]
    R = directed_sensors(
        [0] * 50, 0.1, 0.01, 1.0, torch.randn(50, 3, generator=torch.Generator().manual_seed(0))
    ).local[:, :3, :3]
    torch.testing.assert_close(R @ R.mT, torch.eye(3).double().expand(50, 3, 3))
    torch.testing.assert_close(torch.det(R), torch.ones(50).double())


def line_of(text, wanted, nth=0):
    return [k for k, line in enumerate(text.split("\n"), start=1) if line.startswith(wanted)][nth]


WRONG = [
    ("direction = [1, 0, 0]", "direction = [0, 0, 0.0]", "direction",
     "three numbers along x, y, z of the cross-section, not all zero", "[0, 0, 0.0]"),
    ("direction = [1, 0, 0]", "direction = [0, 1]", "direction",
     "three numbers along x, y, z of the cross-section, not all zero", "[0, 1]"),
    ("direction = [1, 0, 0]", "tilt_deg = 30\ndirection = [1, 0, 0]", "tilt_deg",
     "left out: direction (line {direction}) says where the sensor points", "30"),
]  # fmt: skip


@pytest.mark.parametrize(("old", "new", "key", "must_be", "received"), WRONG)
def test_wrong_directions_of_sensors(tmp_path, old, new, key, must_be, received):
    text = OFF_AXIS.replace(old, new)
    with pytest.raises(InputError) as error:
        load_robot(written(tmp_path, text))
    must_be = must_be.format(
        direction=line_of(text, "direction = [1, 0, 0]") if "direction (" in must_be else 0
    )
    assert str(error.value) == (
        f"Input {key} of arm.toml, line {line_of(text, new.split('=')[0], new.startswith('direction'))}, "
        f"[[sensors]] 1, must be {must_be}; instead received {received}."
    )


def test_wrong_directions_elsewhere(tmp_path):
    with pytest.raises(InputError, match=r"\[\[magnets\]\] 1, must be three numbers along x, y, z"):
        load_robot(written(tmp_path, OFF_AXIS.replace("direction = [3, 0, 0]", "direction = [0, 0, 0]")))
    text = OFF_AXIS.replace("radial_mm = 12\n", "")
    with pytest.raises(
        InputError, match=r"azimuth_deg of .* must be left out on the backbone: direction \(line"
    ):
        load_robot(written(tmp_path, text))
    with pytest.raises(InputError, match="Input direction of directed_sensors must be not zero"):
        directed_sensors([0], 0.1, 0.0, 0.0, [[0.0, 0.0, 0.0]])
    with pytest.raises(InputError, match=r"Input direction of magnet_mounts must be of shape \(2, 3\)"):
        magnet_mounts([0, 0], 0.1, [[0.0, 0.0, 1.0]])
    found = load_robot(written(tmp_path, UNLIKE))
    with pytest.raises(InputError, match="moments of LinearisedSensing must be a row for each of 2 magnets"):
        LinearisedSensing(found.robot, found.moments[0], per_magnet=True)
