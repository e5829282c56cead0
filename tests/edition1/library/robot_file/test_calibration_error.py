"""What a calibration leaves uncertain, carried into estimates: slopes, covariance, and whether ellipsoids hold."""

import json
import math
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from scipy.stats import chi2

from edition1.errors import InputError
from edition1.kernels._placement import PlacementSlopes
from edition1.kinematics.motion import backbone_motion
from edition1.kinematics.mounts import magnet_mounts
from edition1.robot_file.load import load_robot
from edition1.sensing.placement import PlacedReadings, Tolerances, placed
from edition1_live.follow.robot_estimator import robot_estimator
from edition1_live.robot.calibrate import Priors, calibrate, pose_covariance

ROBOTS = Path(__file__).parents[4] / "data" / "robots"
NETWORKS = ROBOTS.parent / "networks"
SIX_SENSORS = "".join(
    f"[[sensors]]\nchannel = {k + 4}\nsegment = 1\nat_mm = 100.0\nradial_mm = 13.0\nazimuth_deg = {60 + 120 * k}\n"
    for k in range(3)
)


def normal(shape, generator):
    return torch.randn(shape, generator=generator, dtype=torch.float64)


def random_q(robot, n, generator, share=1.0):
    unit = torch.rand(n, robot.robot.n_q, dtype=torch.float64, generator=generator)
    return robot.lower + (robot.upper - robot.lower) * ((1 - share) / 2 + share * unit)


def built(robot, generator, priors):
    """Robot as it was really made: everything drawn from the priors."""
    scale = priors.placement.of_parameters(robot.robot, len(robot.moments))
    parts = placed(robot.robot, robot.moments, scale * normal(len(scale), generator))
    return replace(
        robot,
        robot=replace(robot.robot, magnets=parts.magnets, sensors=parts.sensors),
        moments=parts.moments,
        gain=robot.gain * parts.gain,
        offset=robot.offset + priors.offset_mt * robot.gain * normal(len(robot.gain), generator),
        earth_mt=robot.earth_mt + priors.earth_mt * normal(3, generator),
    )


def calibrated(robot, truth, poses, generator):
    """Calibrated in random poses, known as well as the command takes for granted."""
    covariance = pose_covariance(robot, 2e-4, math.radians(0.5))
    q = random_q(robot, poses, generator)
    values = truth.values(q) + robot.noise * normal((poses, robot.channels), generator)
    measured = q + covariance.diagonal().sqrt() * normal(q.shape, generator)
    return robot.calibrated(calibrate(robot, values, measured, covariance))


def squared(error, covariance):
    return (error * torch.linalg.solve(covariance, error.unsqueeze(-1)).squeeze(-1)).sum(-1)


def tip(robot, q):
    """Position of the tip, and its slopes."""
    last = robot.robot.segments[-1]
    poses, motion = backbone_motion(
        robot.robot, q, magnet_mounts([len(robot.robot.segments) - 1], last.length)
    )
    return poses[:, 0, :3, 3], motion[:, 0, :, :3, 3].mT


@pytest.mark.parametrize("name", ["one_segment", "three_segments", "bend_sensor"])
def test_slopes_are_those_of_the_torch_model(name):
    robot, generator = load_robot(ROBOTS / f"{name}.toml"), torch.Generator().manual_seed(0)
    q = random_q(robot, 4, generator)
    scale = Tolerances().of_parameters(robot.robot, len(robot.moments))
    p, earth = scale * normal(len(scale), generator), torch.tensor([0.02, 0.01, -0.04]).double()
    _, J, _ = PlacedReadings(robot.robot, q, robot.moments, earth).linearise(p)
    slopes = PlacementSlopes(robot.robot, robot.moments, p, robot.gain, earth)
    found = torch.from_numpy(slopes(q.numpy()))
    wanted = robot.gain.unsqueeze(-1) * J
    torch.testing.assert_close(
        found[..., : len(p)], wanted, rtol=1e-9, atol=1e-12 * float(wanted.abs().max())
    )


def test_slopes_by_offsets_and_earth_field_by_differences():
    robot, generator = load_robot(ROBOTS / "one_segment.toml"), torch.Generator().manual_seed(0)
    robot = replace(robot, gain=robot.gain * torch.tensor([500.0, -400.0, 300.0]), noise=0.3)
    truth = built(robot, generator, Priors())
    found = calibrated(robot, truth, 20, generator)
    q, calibration, h = random_q(robot, 1, generator), found.error.calibration, 1e-6
    J = torch.from_numpy(found.error._slopes(q.numpy()))[0, :, -6:]
    for k in range(6):
        move = h * (torch.arange(6) == k).double()
        moved = replace(
            calibration, offset=calibration.offset + move[:3], earth_mt=calibration.earth_mt + move[3:]
        )
        slope = (robot.calibrated(moved).values(q) - found.values(q))[0] / h
        torch.testing.assert_close(J[:, k], slope, rtol=1e-5, atol=1e-5)
    S, slopes = calibration.covariance, torch.from_numpy(found.error._slopes(q.numpy()))
    torch.testing.assert_close(found.error(q), slopes @ S @ slopes.mT, rtol=1e-8, atol=1e-10)


@pytest.mark.parametrize("poses", [20, 40])
def test_ellipsoids_of_calibrated_robots_hold(poses):
    """Three segments; robots drawn from the priors; configurations that the calibration has not seen."""
    robot, hits, nees = load_robot(ROBOTS / "three_segments.toml"), [], []
    for seed in range(4):
        generator = torch.Generator().manual_seed(1000 * seed + poses)
        truth = built(robot, generator, Priors())
        found = calibrated(robot, truth, poses, generator)
        method = robot_estimator(found).method.estimator  # of a batch, which is not watched
        q = random_q(robot, 30, generator, share=0.8)
        u = (truth.values(q) + robot.noise * normal((30, 9), generator))[:, list(robot.channel)]
        _, estimate = method.step(method.init(q, seed=0), u - found.offset, 0.0)
        at, J = tip(robot, estimate.q)
        of_q = squared(estimate.q - q, estimate.covariance)
        of_tip = squared(at - tip(robot, q)[0], J @ estimate.covariance @ J.mT)
        hits.append(torch.stack([of_q < chi2.ppf(0.95, 9), of_tip < chi2.ppf(0.95, 3)]).double())
        nees.append(torch.stack([of_q / 9, of_tip / 3]))
        plain = squared(
            estimate.q - q, method.estimator.step(method.init(q, seed=0), u - found.offset, 0.0)[1].covariance
        )
        assert float((plain < chi2.ppf(0.95, 9)).double().mean()) < 0.1, "noise alone explains nothing"
    held, normalised = torch.stack(hits).mean((0, 2)), torch.stack(nees).mean((0, 2))
    assert bool((held > 0.88).all()), held
    assert bool(((normalised > 0.7) & (normalised < 1.4)).all()), normalised


def test_chi_square_of_calibrated_robots_is_one_per_degree_of_freedom(tmp_path):
    """Six sensors for three coordinates: what the noise cannot explain is the error of the calibration."""
    path = tmp_path / "six.toml"
    path.write_text((ROBOTS / "one_segment.toml").read_text() + SIX_SENSORS)
    robot, ratios, systematic = load_robot(path), [], []
    for seed in range(5):
        generator = torch.Generator().manual_seed(seed)
        truth = built(robot, generator, Priors())
        found = calibrated(robot, truth, 10, generator)
        method = robot_estimator(found).method.estimator  # of a batch, which is not watched
        q = random_q(robot, 30, generator, share=0.8)
        u = truth.values(q) + robot.noise * normal((30, 6), generator) - found.offset
        _, estimate = method.step(method.init(q, seed=0), u, 0.0)
        assert bool((estimate.diagnostics["dof"] == 3).all())
        ratios.append(estimate.diagnostics["chi2"] / 3)
        systematic.append(estimate.diagnostics["systematic"])
    assert 0.6 < float(torch.stack(ratios).mean()) < 1.5
    assert 0.1 < float(torch.stack(systematic).mean()) <= 1.0


def test_the_error_of_networks_is_that_of_their_manifest(tmp_path):
    name = min(NETWORKS.glob("pcc_nb1_*.safetensors"))
    for suffix in (".safetensors", ".json"):
        shutil.copy(name.with_suffix(suffix), tmp_path / f"net{suffix}")
    path = tmp_path / "robot.toml"
    path.write_text((ROBOTS / "one_segment.toml").read_text() + '\n[model]\nnetworks = ["net.safetensors"]\n')
    robot, manifest = load_robot(path), json.loads((tmp_path / "net.json").read_text())
    rmse = manifest["metrics_mt"]["rmse_validation"]
    torch.testing.assert_close(robot.error(robot.start), rmse**2 * torch.eye(3).double())
    method = robot_estimator(robot).method.estimator
    q = robot.start + torch.tensor([0.003, -0.002, 0.0])
    options = method.init(q, seed=0), robot.sensing()(q).detach(), 0.0
    whole, noise = (m.step(*options)[1].covariance for m in (method, method.estimator))
    torch.testing.assert_close(whole, noise * (1 + (rmse / robot.noise) ** 2), rtol=1e-3, atol=1e-12)
    manifest["metrics_mt"]["rmse_validation"] = -1.0
    (tmp_path / "net.json").write_text(json.dumps(manifest))
    with pytest.raises(
        InputError, match=r"manifest of net.json must be with the validation error rmse_validation"
    ):
        load_robot(path)
    del manifest["metrics_mt"]
    (tmp_path / "net.json").write_text(json.dumps(manifest))
    robot = load_robot(path)  # as of weights that were imported
    assert robot.error is None
    assert robot.notes[-1] == (
        "robot.toml: no error of the networks is known; what estimates state holds the noise alone."
    )
    robot_estimator(robot).prepared()
