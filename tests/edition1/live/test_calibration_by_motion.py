"""Calibration from motion alone: the truth lies within what is stated, what is open is named, nonsense is refused."""

import contextlib
import os
import re
import signal
import subprocess
import sys
import threading
import time
import tty
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from test_calibrate import built, noisy, random_poses

from edition1.errors import InputError
from edition1.estimation.levenberg_marquardt import jacobian
from edition1.robot_file.calibration_file import RobotCalibration
from edition1.robot_file.load import load_robot
from edition1.sensing.placement import Tolerances
from edition1_companion.cli_calibrate import calibrate as command
from edition1_live.emulate.robot_readings import course, readings_along, true_robot
from edition1_live.own.motion import Beginning, at_elongation
from edition1_live.own.samples import timed_readings
from edition1_live.own.self_calibration import PRIORS, report, self_calibrate
from edition1_live.record.recording import read_recording
from edition1_live.robot.calibrate import Priors, calibrate, pose_covariance
from edition1_live.robot.readings_file import Readings
from edition1_live.wire.formats import encode
from edition1_live.wire.frame import Frame

TEXT = (Path(__file__).parents[3] / "data" / "robots" / "one_segment.toml").read_text()
TEXT = TEXT.replace("rate_hz = 1000.0", "rate_hz = 10.0")
IMU = "\n[[imus]]\nstream = 1\nsegment = 1\nat_mm = 110.0\nmounted = [0.0, 0.0, 0.6, 0.8]\n"
HANGING = "base_orientation = [1.0, 0.0, 0.0, 0.0]\n"
TIGHT = Priors(
    Tolerances(1e-6, 1e-5, 1e-5, 1e-5, 1e-5, PRIORS.placement.sensor_gain, PRIORS.placement.moments),
    earth_mt=1e-5,
)
"""The place of the parts is known."""
needs_pty = pytest.mark.skipif(sys.platform == "win32", reason="needs a pseudo-terminal")


def described(folder, text):
    path = folder / "robot.toml"
    path.write_text(text)
    return load_robot(path)


def drifted(robot, rng):
    """Robot whose moments, gains and offsets have changed, and by how much, in the order of the filter."""
    m, g, o = (
        x * rng.standard_normal(n) for x, n in ((0.05, 1), (0.05, len(robot.gain)), (0.5, len(robot.gain)))
    )
    stronger = tuple(replace(x, polarisation_mt=(1 + m[0]) * x.polarisation_mt) for x in robot.magnets)
    gain, offset = robot.gain * (1 + torch.from_numpy(g)), robot.offset + robot.gain * torch.from_numpy(o)
    moments = (1 + m[0]) * robot.moments
    return replace(robot, gain=gain, offset=offset, moments=moments, magnets=stronger), np.concatenate(
        [m, g, o]
    )


def in_motion(robot, truth, rng, *, seconds=20.0, seed=0, heading=0.1):
    """Readings of the true robot along a course; the headings of its IMUs are wrong."""
    time_s = np.arange(round(seconds * robot.rate_hz)) / robot.rate_hz
    found = readings_along(truth, time_s, course(robot, time_s, seed=seed), rng=rng)
    turned, frames = Rotation.from_rotvec([0.0, 0.0, heading]), []
    for t, stream, values in found.readings():
        sent = values if stream == 0 else tuple((turned * Rotation.from_quat(values)).as_quat())
        frames.append((round(1e9 * t), Frame(stream, None, round(1e6 * t), sent)))
    return timed_readings(Readings(frames, 0.0, []), robot)


def test_the_truth_lies_within_the_stated_uncertainty(tmp_path):
    """Parts are off by their tolerances, too, and nobody says by how much."""
    robot, z = described(tmp_path, HANGING + TEXT + IMU), []
    for seed in range(3):
        rng = np.random.default_rng([1, seed])
        parts = true_robot(robot, 1.0, seed=seed)
        parts = replace(parts, gain=robot.gain, offset=robot.offset, magnets=robot.magnets)
        truth, true = drifted(parts, rng)
        found = self_calibrate(robot, in_motion(robot, truth, rng, seed=seed))
        names, value, std, prior = zip(*found.parameters, strict=True)
        assert names == ("moment 1", *(f"{kind} {k}" for kind in ("gain", "offset") for k in (1, 2, 3)))
        z.append((np.array(value) - true) / std)
        assert max(std[-3:]) < 0.5 * prior[-1]  # offsets become known
    assert 0.5 < np.sqrt(np.square(z).mean()) < 1.5
    assert np.abs(z).max() < 4


def exactly(robot, like):
    """A calibration that knows: the place of the parts is as described."""
    same = {"parameters": 0 * like.parameters, "offset": 0 * like.offset, "earth_mt": robot.earth_mt}
    return replace(like, **same, covariance=0 * like.covariance)


def test_magnets_alone_learn_nothing_from_how_the_robot_moves(tmp_path):
    """As many readings as unknowns: what is off stays within what is stated, and next to all of it is left open."""
    robot, z = described(tmp_path, TEXT), []
    for seed in range(3):
        rng = np.random.default_rng([7, seed])
        truth, true = drifted(robot, rng)
        found = self_calibrate(robot, in_motion(robot, truth, rng, seed=seed), priors=TIGHT)
        _, value, std, prior = map(np.array, zip(*found.parameters, strict=True))
        z.append((value - true) / std)
        assert (std[:4] > 0.8 * prior[:4]).all()
    assert np.abs(z).max() < 4


def test_two_segments_are_found_too_and_what_is_known_exactly_adds_nothing(tmp_path):
    """Eight sensors and two IMUs; only the common factor of moment and gains is left open."""
    text = (Path(__file__).parents[3] / "data" / "robots" / "two_segments.toml").read_text()
    imus = "".join(f"\n[[imus]]\nstream = {k}\nsegment = {k}\nat_mm = 70.0\n" for k in (1, 2))
    robot = described(tmp_path, text.replace("rate_hz = 100.0", "rate_hz = 10.0") + imus)
    rng = np.random.default_rng(8)
    truth, true = drifted(robot, rng)
    moving = in_motion(robot, truth, rng, seconds=10.0)
    straight = robot.start[None]
    known = exactly(robot, calibrate(robot, truth.values(straight), straight, torch.eye(6).double()))
    found = self_calibrate(robot, moving, earlier=known)
    names, value, std, prior = zip(*found.parameters, strict=True)
    assert names[0] == "moment of all"
    z = (np.array(value) - true) / std
    assert 0.3 < np.sqrt(np.square(z).mean()) < 2
    assert np.abs(z).max() < 4
    assert max(std[9:]) < 0.2 * prior[-1]
    nearly = self_calibrate(robot, moving, priors=TIGHT)
    np.testing.assert_allclose(nearly.parameters[-1][1:3], found.parameters[-1][1:3], rtol=0.02)


def test_a_ratio_that_motion_does_not_determine_is_named_and_kept(tmp_path):
    """One magnet before one sensor on a robot that does not stretch: only the product of moment and gain is read."""
    one = TEXT[: TEXT.index("[[sensors]]", TEXT.index("[[sensors]]") + 1)]
    one = one.replace("delta_L_mm = [0.0, 6.6]", "delta_L_mm = [3.3, 3.35]")
    robot, rng = described(tmp_path, one + IMU + 'heading = "free"\n'), np.random.default_rng(2)
    truth, (moment, gain, _) = drifted(robot, rng)
    found = self_calibrate(robot, in_motion(robot, truth, rng, heading=2.0), priors=TIGHT)
    ratio = "The ratio of {} and {} is not determined by this motion."
    open_ = found.calibration.undetermined
    assert {ratio.format("moment 1", "gain 1"), ratio.format("gain 1", "moment 1")} & set(open_)
    names, covariance = found.calibration.names, found.calibration.covariance
    here = [names.index("moment A1"), names.index("sensor 1 gain")]
    C, x = covariance[here][:, here].numpy(), found.calibration.parameters[here].numpy()
    ratio_std, product_std = (np.sqrt(w @ C @ w) for w in (np.array([1, -1]), np.array([1, 1])))
    assert ratio_std > 0.9 * 0.05 * 2**0.5
    assert abs(x.sum() - moment - gain) < 4 * product_std
    assert product_std < 0.8 * ratio_std
    assert open_[-1].startswith(
        "The place and tilt of magnets and sensors and the Earth field are not determined"
    )
    assert f"  {open_[0]}" in report(found)


def test_an_earlier_calibration_is_kept_and_brought_up_to_date(tmp_path):
    """Calibrated in poses, then moments, gains and offsets drift: readings of poses not seen are predicted again."""
    robot, rng = described(tmp_path, HANGING + TEXT + IMU), np.random.default_rng(3)
    then, q = built(robot, 3, offset=0.1), random_poses(robot, 40)
    covariance = pose_covariance(robot, 1e-4, 0.01)
    earlier = calibrate(robot, noisy(then.values(q), robot.noise, 4), noisy(q, 1e-4, 5), covariance)
    now, _ = drifted(then, rng)
    values = now.values(torch.from_numpy(course(robot, np.arange(200) / 10, seed=1)))
    moving = in_motion(robot, now, rng, seed=1)
    moving = replace(moving, signal=noisy(values - robot.offset, robot.noise, 6).numpy())
    found = self_calibrate(robot, moving, earlier=earlier).calibration
    unseen = random_poses(robot, 50, seed=9)
    error = [float((robot.calibrated(x).values(unseen) - now.values(unseen)).std()) for x in (earlier, found)]
    assert error[0] > 3 * error[1]
    placement = torch.tensor([not {"moment", "gain", "offset"} & set(name.split()) for name in found.names])
    before, after = (torch.cat([x.parameters, x.offset, x.earth_mt])[placement] for x in (earlier, found))
    assert torch.equal(before, after)
    kept = [x.covariance[placement][:, placement] for x in (earlier, found)]
    torch.testing.assert_close(*kept, rtol=1e-9, atol=1e-18)
    found.write(tmp_path / "again.json")
    assert torch.equal(RobotCalibration.read(tmp_path / "again.json").covariance, found.covariance)


def test_a_unit_does_not_change_what_is_found(tmp_path):
    robot, rng = described(tmp_path, TEXT), np.random.default_rng(6)
    text = TEXT.replace('unit = "mT"', 'unit = "mV"').replace("noise_mt = 7.1e-4", "noise_mv = 0.355")
    millivolts = described(
        tmp_path, text.replace("\nradial_mm", "\ngain_mv_per_mt = 500\noffset_mv = 1250\nradial_mm")
    )
    moving = in_motion(robot, drifted(robot, rng)[0], rng, seconds=6)
    ours = self_calibrate(millivolts, replace(moving, signal=500 * moving.signal)).calibration
    theirs = self_calibrate(robot, moving).calibration
    torch.testing.assert_close(ours.parameters, theirs.parameters, rtol=1e-6, atol=1e-9)
    torch.testing.assert_close(ours.offset, 500 * theirs.offset, rtol=1e-6, atol=1e-9)
    torch.testing.assert_close(ours.deviation[-6:-3], 500 * theirs.deviation[-6:-3], rtol=1e-6, atol=0)


def test_a_length_that_is_known_tells_the_moment_from_it(tmp_path):
    """A segment that is longer reads much like a weaker magnet; every error stays within what is stated."""
    robot, z = described(tmp_path, TEXT + IMU), []
    kept = at_elongation(robot, 0.0, 0.2e-3)
    straight = robot.start[None]
    for seed in range(3):
        rng = np.random.default_rng([9, seed])
        truth, true = drifted(robot, rng)
        bending = replace(truth, lower=kept.lower, upper=kept.upper)
        moving = in_motion(kept, bending, rng, seed=seed)
        known = exactly(robot, calibrate(robot, truth.values(straight), straight, torch.eye(3).double()))
        with_length, without = (self_calibrate(one, moving, earlier=known) for one in (kept, robot))
        _, value, std, _ = map(np.array, zip(*with_length.parameters, strict=True))
        z.append((value - true) / std)
        products = [shared_factor_std(found) for found in (with_length, without)]
        assert products[0] < 0.5 * products[1]
    assert 0.3 < np.sqrt(np.square(z).mean()) < 1.7
    assert np.abs(z).max() < 4
    with pytest.raises(
        InputError, match=r"elongation of repro calibrate --self must be within the bounds of del"
    ):
        at_elongation(robot, -0.1e-3, 0.2e-3)


def test_what_a_straight_robot_reads_is_known_from_then_on(tmp_path):
    """By one reading in a pose that is known, in closed form; magnets alone learn no more of it from the motion."""
    robot, z = described(tmp_path, TEXT), []
    C = pose_covariance(robot, 0.2e-3, 0.01)
    begins = Beginning.straight(robot, float(robot.start[2]), C)
    read, by_q = robot.sensing()(robot.start)[0], jacobian(robot.sensing(), robot.start)[1][0]
    sizes = PRIORS.placement.moments * read, PRIORS.placement.sensor_gain * read, PRIORS.offset_mt
    prior = float(torch.tensor(sizes).square().sum())
    reading = float(by_q @ C @ by_q) + robot.noise**2
    closed_form = (1 / (1 / prior + 1 / reading)) ** 0.5
    assert closed_form < 0.05 * prior**0.5
    for seed in range(3):
        rng = np.random.default_rng([10, seed])
        truth, true = drifted(robot, rng)
        moving = in_motion(robot, truth, rng, seed=seed)
        found = self_calibrate(robot, moving, priors=TIGHT, begins=begins)
        _, value, std, _ = map(np.array, zip(*found.parameters, strict=True))
        z.append((value - true) / std)
        slope = torch.zeros(len(found.calibration.names), dtype=torch.float64)
        for name, value in (("moment A1", read), ("sensor 1 gain", read), ("sensor 1 offset", 1.0)):
            slope[found.calibration.names.index(name)] = value
        left = float((slope @ found.calibration.covariance @ slope).sqrt())
        assert closed_form < left < 1.3 * closed_form  # the filter takes a share of a reading for noise, too
    assert 0.3 < np.sqrt(np.square(z).mean()) < 1.7
    assert np.abs(z).max() < 4


def test_straight_is_without_bend_at_an_elongation_and_of_no_azimuth(tmp_path):
    robot = described(tmp_path, TEXT)
    bounds = "kappa_0_rad = [-1.0, 1.0]\nkappa_1_rad = [-1.0, 1.0]\nphi_deg = [0.0, 360.0]\n"
    text = re.sub(r"(delta_[xy]|radius)_mm = .*\n", "", TEXT).replace("delta_L_mm", f"{bounds}delta_L_mm")
    affine = described(tmp_path, text.replace("constant_curvature", "affine_curvature"))
    begins = Beginning.straight(robot, 1e-3, pose_covariance(robot, 0.2e-3, 0.01))
    assert begins.q.tolist() == [0.0, 0.0, 1e-3]
    assert begins.covariance.diagonal().sqrt().tolist() == pytest.approx([0.2e-3] * 3)
    assert affine.robot.coordinates == ("kappa_0_1", "kappa_1_1", "phi_1", "delta_L_1")
    begins = Beginning.straight(affine, 1e-3, pose_covariance(affine, 0.2e-3, 0.01))
    assert begins.q.tolist() == [0.0, 0.0, float(affine.start[2]), 1e-3]
    assert float(begins.covariance[2, 2].sqrt()) == pytest.approx(
        float(affine.upper[2] - affine.lower[2]) / 12**0.5
    )


def shared_factor_std(found):
    """Uncertainty of the mean of moment times gains, which alone the readings have."""
    names = found.calibration.names
    moment = torch.tensor(["moment" in name for name in names]).double()
    gains = torch.tensor([name.endswith("gain") for name in names]).double()
    a = moment / moment.sum() + gains / gains.sum()
    return float((a @ found.calibration.covariance @ a).sqrt())


def refused(call):
    with pytest.raises(InputError) as error:
        call()
    return str(error.value)


def test_motion_that_says_nothing_is_refused(tmp_path):
    rng = np.random.default_rng(4)
    robot = described(tmp_path, TEXT + IMU)
    short = in_motion(robot, robot, rng, seconds=3)
    assert refused(lambda: self_calibrate(robot, short)) == (
        "Input readings of repro calibrate --self must be of at least 5 s in which every segment bends every way; "
        "instead received 2.9 s."
    )
    magnetic = described(tmp_path, TEXT)
    silent = in_motion(magnetic, magnetic, rng, seconds=6)
    silent = replace(silent, signal=np.full_like(silent.signal, np.nan))
    assert refused(lambda: self_calibrate(magnetic, silent)) == (
        "Input readings of repro calibrate --self must be numbers in some time step; instead received none."
    )
    noise = rng.normal(scale=robot.noise, size=silent.signal.shape)
    for at_rest, most in ((0 * noise, "0 mT"), (0 * noise - 3.7, "0 mT"), (noise, "0.0007")):
        still = replace(silent, signal=at_rest)
        said = refused(lambda still=still: self_calibrate(magnetic, still))
        assert "of a robot in motion, by which some reading scatters over more than 5 times its noise" in said
        assert f"; instead received readings that scatter over {most}" in said
    other = in_motion(robot, replace(robot, gain=-robot.gain), rng, seconds=6)
    assert refused(lambda: self_calibrate(robot, other)).startswith(
        "Input readings of repro calibrate --self must be those of robot.toml in motion (usual causes if not: axes "
        "exchanged or of the wrong sign, another unit than the file says"
    )
    leaning = described(tmp_path, "base_orientation = [0.6, 0.0, 0.0, 0.8]\n" + TEXT + IMU)
    assert refused(lambda: self_calibrate(leaning, in_motion(leaning, leaning, rng))) == (
        "Input base_orientation of robot.toml must be upright, or upside down: to IMUs the vertical is the axis of "
        "the base; instead received (0.6, 0.0, 0.0, 0.8)."
    )


def test_options_that_do_not_fit_are_refused(tmp_path):
    described(tmp_path, TEXT)
    options = {"robot": tmp_path / "robot.toml", "output": tmp_path / "new.json"}
    assert refused(lambda: command("port", **options)) == (
        "Input poses of repro calibrate must be given (--poses POSES.csv), or --self; instead received neither."
    )
    poses = tmp_path / "poses.csv"
    assert refused(lambda: command("port", **options, poses=poses, by_motion=True)) == (
        f"Input poses of repro calibrate --self must be left out; instead received {poses}."
    )
    assert refused(lambda: command("port", **options, poses=poses, elongation_mm=0.0)) == (
        "Input elongation of repro calibrate must be left out without --self; instead received 0.0."
    )
    exact = {"elongation_mm": 0.0, "pose_noise_mm": 0.0}
    assert refused(lambda: command("port", **options, by_motion=True, **exact)).startswith(
        "Input pose noise of calibrate must be positive; instead received 0.0 m"
    )
    assert refused(lambda: command("port", **options, by_motion=True, elongation_mm=7.0)) == (
        "Input elongation of repro calibrate --self must be within the bounds of delta_L_mm in robot.toml; "
        "instead received 7 mm."
    )
    assert refused(lambda: command("port", **options, by_motion=True, straight_mm=7.0)) == (
        "Input straight of repro calibrate --self must be no bend and an elongation within the bounds in robot.toml; "
        "instead received 7 mm."
    )
    held = {"elongation_mm": 1.0, "straight_mm": 3.0}
    assert refused(lambda: command("port", **options, by_motion=True, **held)).endswith("received 3 mm.")
    assert refused(lambda: command("port", **options, poses=poses, straight_mm=0.0)) == (
        "Input straight of repro calibrate must be left out without --self; instead received 0.0."
    )
    assert refused(lambda: command("port", **options, poses=poses, calibration=poses)) == (
        f"Input calibration of repro calibrate must be left out without --self; instead received {poses}."
    )


@pytest.fixture
def moving(tmp_path):
    """Give the port of a robot that moves, and what starts its calibration there, or from a file."""
    robot = described(tmp_path, TEXT)
    truth, _ = drifted(robot, np.random.default_rng(5))
    master, slave = os.openpty()
    tty.setraw(slave)
    os.set_blocking(master, False)
    over = threading.Event()

    def send():
        began, k = time.monotonic(), 0
        while not over.wait(0.05):
            t = np.array([time.monotonic() - began])
            (values,) = readings_along(truth, t, course(robot, t)).values.tolist()
            with contextlib.suppress(BlockingIOError):
                os.write(master, encode("frames", Frame(0, k, round(1e6 * t[0]), tuple(values))))
            k += 1

    def start(source, *options):
        line = [
            sys.executable,
            "-m",
            "edition1_companion.cli",
            "calibrate",
            source,
            "--self",
            "--duration",
            "7",
        ]
        line += ["--robot", str(tmp_path / "robot.toml"), "-o", str(tmp_path / "found.json")]
        line += options
        return subprocess.Popen(line, stdout=-1, stderr=-1, text=True)

    sender = threading.Thread(target=send)
    sender.start()
    yield os.ttyname(slave), start
    over.set()
    sender.join()
    os.close(master)
    os.close(slave)


@needs_pty
def test_a_robot_moves_at_a_port(moving, tmp_path):
    """The command in a process of its own; the recording that it leaves gives the same calibration again."""
    (port, start), output = moving, tmp_path / "found.json"
    said, wrong = start(port).communicate(timeout=300)
    assert "bend every segment every way, and stretch it" in said, wrong
    assert "offset 3: " in said
    assert said.endswith(f"Written: {output}\n")
    first = output.read_bytes()
    assert load_robot(tmp_path / "robot.toml", output).error is not None
    output.unlink()
    said, _ = start(port).communicate(timeout=300)
    assert "found.rec holds an earlier motion, which is used; to record anew, move it away." in said
    assert output.read_bytes() == first


@needs_pty
@pytest.mark.parametrize("name", ["SIGINT", "SIGKILL"])
def test_a_motion_that_was_interrupted_is_kept_and_not_used_silently(moving, tmp_path, name):
    """Neither by the same command, nor from the file, where it is too short."""
    (port, start), file = moving, tmp_path / "found.rec"
    process, deadline = start(port, "--straight-mm", "3.3"), time.monotonic() + 60
    while not file.exists():
        assert time.monotonic() < deadline
        time.sleep(0.05)
    time.sleep(1.0)
    process.send_signal(number := getattr(signal, name))
    said, _ = process.communicate(timeout=60)
    assert process.returncode == (130 if number == signal.SIGINT else -number)
    assert "begin straight, bend every segment every way, and stretch it" in said
    assert (f"Interrupted: {file} keeps what came." in said) == (number == signal.SIGINT)
    kept = file.read_bytes()
    again = start(port)
    _, wrong = again.communicate(timeout=60)
    assert again.returncode == 2
    assert (
        "repro: Input earlier motion of repro calibrate --self must be recorded to its end (to record"
        in wrong
    )
    frames = len(read_recording(file).frames)
    assert f"instead received one that was interrupted after {frames} frames." in wrong
    _, wrong = start(str(file)).communicate(timeout=60)
    assert "must be of at least 5 s in which every segment bends every way" in wrong
    assert file.read_bytes() == kept
    assert not (tmp_path / "found.json").exists()
