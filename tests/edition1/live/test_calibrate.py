"""Calibration of described robots: errors found again, what poses leave open, files, and a person at a port."""

import contextlib
import json
import math
import os
import subprocess
import sys
import threading
import time
import tty
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from edition1.errors import InputError
from edition1.estimation.calibration import calibrate as calibrate_geometry
from edition1.robot_file.calibration_file import RobotCalibration
from edition1.robot_file.load import load_robot
from edition1.sensing.placement import Tolerances, placed
from edition1_live.record.recording import read_recording
from edition1_live.robot.calibrate import Priors, calibrate, pose_covariance, report
from edition1_live.robot.calibration_port import guide, port_frames
from edition1_live.robot.calibration_poses import read_poses, recorded_readings
from edition1_live.wire.formats import encode
from edition1_live.wire.frame import Frame

ROBOTS = Path(__file__).parents[3] / "data" / "robots"
ROBOT = load_robot(ROBOTS / "one_segment.toml")
POSE_M = 1e-4
COVARIANCE = pose_covariance(ROBOT, POSE_M, 0.01)


def generator(seed):
    return torch.Generator().manual_seed(seed)


def random_poses(robot, n, seed=0):
    share = torch.rand(n, robot.robot.n_q, dtype=torch.float64, generator=generator(seed))
    return robot.lower + (robot.upper - robot.lower) * share


def built(robot, seed, *, offset=0.0, earth=(0.0, 0.0, 0.0)):
    """Robot as it was really made: geometry, gains and moments drawn from their tolerances."""
    scale = Tolerances().of_parameters(robot.robot, len(robot.moments))
    errors = scale * torch.randn(len(scale), dtype=torch.float64, generator=generator(seed))
    parts = placed(robot.robot, robot.moments, errors)
    return replace(
        robot,
        robot=replace(robot.robot, magnets=parts.magnets, sensors=parts.sensors),
        moments=parts.moments,
        gain=robot.gain * parts.gain,
        offset=robot.offset + offset * torch.randn(len(robot.gain), generator=generator(seed + 1)).double(),
        earth_mt=torch.tensor(earth, dtype=torch.float64),
    )


def noisy(x, size, seed):
    return x + size * torch.randn(x.shape, dtype=torch.float64, generator=generator(seed))


def session(robot, truth, seed, n=30):
    q = random_poses(robot, n, seed)
    return noisy(truth.values(q), robot.noise, seed + 1), noisy(q, POSE_M, seed + 2)


def rms(model, truth, q):
    return float((model.values(q) - truth.values(q)).square().mean().sqrt())


@pytest.mark.parametrize(("name", "least"), [("one_segment", 10.0), ("three_segments", 10.0)])
def test_thirty_poses_lower_the_error_of_poses_not_seen(name, least):
    """Magnets off by 0.5 mm and 2 degrees, sensors by 1 %: geometric mean over robots; noise-free unseen poses."""
    robot = load_robot(ROBOTS / f"{name}.toml")
    covariance = pose_covariance(robot, POSE_M, 0.01)
    unseen, ratios = random_poses(robot, 100, seed=99), []
    for seed in range(3):
        truth = built(robot, 100 * seed)
        found = calibrate(robot, *session(robot, truth, 100 * seed + 7), covariance)
        ratios.append(rms(robot, truth, unseen) / rms(robot.calibrated(found), truth, unseen))
        assert found.before > 3 * found.after
        assert 0.5 < found.chi2 < 1.5
        assert (found.poses, found.held_out) == (30, 7)
    assert math.prod(ratios) ** (1 / len(ratios)) > least
    assert min(ratios) > 4


def test_offsets_and_the_earth_field_are_found():
    truth = built(ROBOT, 1, offset=0.2, earth=(0.02, 0.0, -0.045))
    found = calibrate(ROBOT, *session(ROBOT, truth, 5, n=60), COVARIANCE)
    unseen = random_poses(ROBOT, 100, seed=99)
    assert rms(ROBOT, truth, unseen) > 10 * rms(ROBOT.calibrated(found), truth, unseen)
    deviation = dict(zip(found.names, found.deviation.tolist(), strict=True))
    for j in range(3):
        assert abs(float(found.offset[j] - truth.offset[j])) < 4 * deviation[f"sensor {j + 1} offset"]
    for k, axis in enumerate("xyz"):
        assert abs(float(found.earth_mt[k] - truth.earth_mt[k])) < 4 * deviation[f"Earth field along {axis}"]


def test_uncertainty_is_what_the_estimates_scatter():
    """Offsets and Earth field drawn from their priors: errors are as large as stated."""
    priors, z = Priors(placement=Tolerances(), offset_mt=0.1, earth_mt=0.03), []
    for seed in range(12):
        earth = 0.03 * torch.randn(3, generator=generator(seed), dtype=torch.float64)
        truth = built(ROBOT, 100 * seed, offset=0.1, earth=tuple(earth.tolist()))
        found = calibrate(ROBOT, *session(ROBOT, truth, 100 * seed + 7, n=20), COVARIANCE, priors=priors)
        error = torch.cat([found.offset - truth.offset, found.earth_mt - truth.earth_mt])
        z.append(error / found.deviation[-6:])
    assert 0.7 < float(torch.stack(z).square().mean().sqrt()) < 1.3


def test_without_offsets_and_earth_it_is_the_calibration_of_the_geometry():
    truth = built(ROBOT, 3)
    values, q = session(ROBOT, truth, 8)
    priors = Priors(placement=Tolerances(), offset_mt=1e-9, earth_mt=1e-9)
    ours = calibrate(ROBOT, values, q, COVARIANCE, priors=priors)
    theirs = calibrate_geometry(
        ROBOT.robot,
        q,
        COVARIANCE,
        values,
        ROBOT.moments,
        noise_mt=ROBOT.noise,
        tolerances=Tolerances(),
        iterations=12,
    )
    torch.testing.assert_close(ours.parameters, theirs.estimate, rtol=1e-6, atol=1e-9)
    torch.testing.assert_close(ours.deviation[:-6], theirs.deviation, rtol=1e-6, atol=0)


def test_a_unit_does_not_change_what_is_found(tmp_path):
    text = (ROBOTS / "one_segment.toml").read_text()
    text = text.replace('unit = "mT"', 'unit = "mV"').replace("noise_mt = 7.1e-4", "noise_mv = 0.355")
    path = tmp_path / "mv.toml"
    path.write_text(text.replace("\nradial_mm", "\ngain_mv_per_mt = 500\noffset_mv = 1250\nradial_mm"))
    robot = load_robot(path)
    values, q = session(ROBOT, built(ROBOT, 3, offset=0.1), 8)
    ours, theirs = (
        calibrate(robot, 1250 + 500 * values, q, COVARIANCE),
        calibrate(ROBOT, values, q, COVARIANCE),
    )
    torch.testing.assert_close(ours.parameters, theirs.parameters, rtol=1e-6, atol=1e-9)
    torch.testing.assert_close(ours.offset, 500 * theirs.offset, rtol=1e-6, atol=1e-9)
    torch.testing.assert_close(ours.deviation[-6:-3], 500 * theirs.deviation[-6:-3], rtol=1e-6, atol=0)
    assert ours.after == pytest.approx(500 * theirs.after)
    unseen = random_poses(robot, 20, seed=99)
    found = robot.calibrated(ours), ROBOT.calibrated(theirs)
    torch.testing.assert_close(
        found[0].values(unseen), 1250 + 500 * found[1].values(unseen), rtol=1e-9, atol=1e-6
    )


def test_poses_that_bend_one_way_only_leave_parameters_open():
    """Bent to +x: nothing tells the Earth field along y, and where the magnet is across the bend hardly shows."""
    bend = torch.linspace(0, 0.02, 30, dtype=torch.float64)
    q = torch.stack([bend, 0 * bend, 0.003 + 0.1 * bend], dim=-1)
    one_way = calibrate(ROBOT, ROBOT.values(q), q, COVARIANCE)
    both_ways = calibrate(ROBOT, *session(ROBOT, ROBOT, 0), COVARIANCE)
    open_one_way = " ".join(one_way.undetermined)
    for name in ("Earth field along y", "magnet 1 y", "magnet 1 tilt about x", "sensor 1 azimuth"):
        assert name in open_one_way
    assert len(one_way.undetermined) > len(both_ways.undetermined)
    assert not any(
        name in " ".join(both_ways.undetermined) for name in ("sensor 1 azimuth", "sensor 1 offset")
    )
    # what is open stays near the file
    k = one_way.names.index("magnet 1 y")
    assert abs(float(one_way.parameters[k])) < 1e-5
    assert float(one_way.deviation[k]) > 0.9 * Tolerances().magnet_position_m
    assert "Not determined by these poses, kept near the robot file within the tolerance:" in report(
        one_way, "mT"
    )
    assert "Earth field along y" in report(one_way, "mT")


def test_the_report_tells_residuals_and_doubts():
    truth = built(ROBOT, 3)
    values, q = session(ROBOT, truth, 8)
    found = calibrate(ROBOT, values, q, COVARIANCE)
    text = report(found, "mT")
    assert (
        f"poses held out of the fit: {found.before:.3g} mT as described, {found.after:.3g} mT calibrated"
        in text
    )
    assert "chi2 should" not in text
    few = calibrate(ROBOT, values[:7], q[:7], COVARIANCE)
    assert (few.before, few.after, few.held_out) == (None, None, 0)
    assert "No residual of poses held out of the fit: that takes 8 poses." in report(few, "mT")
    wrong = calibrate(ROBOT, values.flip(0), q, COVARIANCE)
    assert "chi2 should be near 1: noise, poses or parts are farther off than stated." in report(wrong, "mT")


def test_the_file_returns_the_same_bits(tmp_path):
    found = calibrate(ROBOT, *session(ROBOT, built(ROBOT, 3), 8), COVARIANCE)
    path = tmp_path / "calibration.json"
    found.write(path)
    again = RobotCalibration.read(path)
    for name, value in vars(found).items():
        other = getattr(again, name)
        assert torch.equal(other, value) if isinstance(value, torch.Tensor) else other == value
    loaded, q = load_robot(ROBOTS / "one_segment.toml", path), random_poses(ROBOT, 5)
    assert torch.equal(loaded.values(q), ROBOT.calibrated(found).values(q))
    assert path.stat().st_size < 1000 * len(found.names)


def test_a_calibration_belongs_to_one_file(tmp_path):
    found = calibrate(ROBOT, *session(ROBOT, ROBOT, 8), COVARIANCE)
    path, other = tmp_path / "c.json", tmp_path / "one_segment.toml"
    found.write(path)
    other.write_text((ROBOTS / "one_segment.toml").read_text() + "\n# changed\n")
    with pytest.raises(InputError) as error:
        load_robot(other, path)
    assert str(error.value) == (
        f"Input calibration of one_segment.toml must be made with one_segment.toml as it is now (sha256 "
        f"{load_robot(other).sha256[:12]}); instead received one made with one_segment.toml of sha256 "
        f"{ROBOT.sha256[:12]}."
    )


def test_wrong_calibration_files(tmp_path):
    path = tmp_path / "c.json"
    with pytest.raises(InputError, match="must be a file that repro calibrate wrote"):
        RobotCalibration.read(path)
    path.write_text("{")
    with pytest.raises(InputError, match="file of c.json must be JSON that repro calibrate wrote"):
        RobotCalibration.read(path)
    path.write_text('{"schema": 1}')
    with pytest.raises(InputError) as error:
        RobotCalibration.read(path)
    assert str(error.value) == (
        "Input schema of c.json must be 2 (older files lack the uncertainty of their parameters: calibrate again); "
        "instead received 1."
    )
    calibrate(ROBOT, *session(ROBOT, ROBOT, 8), COVARIANCE).write(path)
    content = json.loads(path.read_text())
    path.write_text(json.dumps({k: v for k, v in content.items() if k != "chi2"}))
    with pytest.raises(InputError, match="instead received a difference in chi2"):
        RobotCalibration.read(path)
    path.write_text(json.dumps(content | {"offset": [0.0, None, 1.0]}))
    with pytest.raises(InputError, match=r"offset of c.json must be a list of finite numbers"):
        RobotCalibration.read(path)
    path.write_text(json.dumps(content | {"offset": [0.0]}))
    with pytest.raises(InputError, match=r"names of c.json must be those of 26 numbers; instead received 28"):
        RobotCalibration.read(path)
    rows = [row[:-2] for row in content["covariance"][:-2]]
    fewer = content | {"offset": [0.0], "names": content["names"][:-2], "covariance": rows}
    path.write_text(json.dumps(fewer))
    with pytest.raises(
        InputError, match="must be of 3 offsets and 3 components of the Earth field; .* 1 and 3"
    ):
        load_robot(ROBOTS / "one_segment.toml", path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"robot_sha256": 5}, "robot_sha256 of c.json must be text; instead received 5."),
        ({"names": None}, "names of c.json must be a list of texts; instead received None."),
        ({"names": [None]}, "names of c.json must be a list of texts; instead received [None]."),
        ({"undetermined": "abc"}, "undetermined of c.json must be a list of texts; instead received 'abc'."),
        (
            {"parameters": [True]},
            "parameters of c.json must be a list of finite numbers; instead received [True].",
        ),
        (
            {"earth_mt": [math.nan, 0, 0]},
            "earth_mt of c.json must be three finite numbers; instead received [nan",
        ),
        ({"earth_mt": [[0], 0, 0]}, "earth_mt of c.json must be three finite numbers; instead received [[0]"),
        ({"chi2": 10**400}, "chi2 of c.json must be a finite number; instead received 1000"),
        ({"before": "1"}, "before of c.json must be a finite number, or null; instead received '1'."),
        ({"poses": 2.5}, "poses of c.json must be a whole number, not negative; instead received 2.5."),
        ({"covariance": [[1.0, 2.0]]}, "covariance of c.json must be a square table of finite numbers; "),
        (
            {"covariance": [[1.0]]},
            "covariance of c.json must be symmetric, 28 x 28; instead received shape (1, 1)",
        ),
        (
            {"covariance": {}},
            "covariance of c.json must be a square table of finite numbers; instead received {}",
        ),
    ],
)
def test_damaged_calibration_files(tmp_path, change, message):
    path = tmp_path / "c.json"
    calibrate(ROBOT, *session(ROBOT, ROBOT, 8, n=8), COVARIANCE).write(path)
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(InputError) as error:
        RobotCalibration.read(path)
    assert str(error.value).startswith(f"Input {message}")


@pytest.mark.parametrize(
    "content",
    [
        "[" * 10**6,
        '{"schema": ' * 10**5,
        "9" * 5000,
        b"\xff\xfe",
        '{"schema": 2, "parameters": [1e',
    ],
)
def test_files_that_are_no_json(tmp_path, content):
    path = tmp_path / "c.json"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(InputError, match="file of c.json must be JSON that repro calibrate wrote"):
        RobotCalibration.read(path)


def test_a_covariance_with_a_negative_variance_is_refused(tmp_path):
    path = tmp_path / "c.json"
    calibrate(ROBOT, *session(ROBOT, ROBOT, 8, n=8), COVARIANCE).write(path)
    content = json.loads(path.read_text())
    content["covariance"][0][1] = content["covariance"][1][0] = 1.0
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match="must be that of random numbers; .* one with a negative variance"):
        RobotCalibration.read(path)
    content["covariance"][0][1] = 2.0
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match="must be symmetric, 28 x 28"):
        RobotCalibration.read(path)


def test_wrong_input():
    q = random_poses(ROBOT, 10)
    values = ROBOT.values(q)
    with pytest.raises(InputError) as error:
        calibrate(ROBOT, values[:, :2], q, COVARIANCE)
    assert str(error.value) == (
        "Input values of calibrate must be of 3 channels, as described in one_segment.toml; instead received shape "
        "(10, 2)."
    )
    with pytest.raises(InputError, match="must be at least one pose; instead received none"):
        calibrate(ROBOT, values[:0], q[:0], COVARIANCE)
    with pytest.raises(InputError, match=r"q_covariance of calibrate must be of last dimensions \(3, 3\)"):
        calibrate(ROBOT, values, q, COVARIANCE[:2, :2])
    with pytest.raises(InputError):
        calibrate(ROBOT, values * math.nan, q, COVARIANCE)
    with pytest.raises(InputError, match="must be a robot with magnets and magnetic sensors"):
        calibrate(load_robot(ROBOTS / "imu_arm.toml"), values, q, COVARIANCE)
    with pytest.raises(InputError, match="Input priors of Priors must be positive"):
        Priors(offset_mt=0.0)
    with pytest.raises(InputError, match="Input pose noise of calibrate must be positive"):
        pose_covariance(ROBOT, 0.0, 1.0)


def table(tmp_path, q, times=None, name="poses.csv"):
    header = ["delta_x_1_mm", "delta_y_1_mm", "delta_L_1_mm"]
    rows = (1e3 * q).tolist()
    if times is not None:
        header, rows = [*header, *times[0]], [[*row, *time] for row, time in zip(rows, times[1], strict=True)]
    path = tmp_path / name
    path.write_text("\n".join([",".join(header), *(",".join(map(repr, row)) for row in rows)]) + "\n")
    return path


def recorded(tmp_path, truth, q, hold_s=1.0):
    """Recording of a board that holds every pose for a while; the file is written as a recorder writes it."""
    from edition1_live.record.recording_file import RecordingFile

    path = tmp_path / "held.rec"
    start = {"format": "frames", "start_unix_s": 0.0, "start_host_ns": 0}
    rate, k = 50, 0
    with RecordingFile(path, start) as file:
        for pose in truth.values(q).repeat_interleave(int(rate * hold_s), dim=0):
            value = noisy(pose, ROBOT.noise, k)
            file.append(round(k * 1e9 / rate), [Frame(0, k, 20000 * k, tuple(value.tolist()))])
            k += 1
    return path


RATE_NOTE = "50 frames arrive per second; one_segment.toml says rate_hz = 1000."


def test_poses_of_a_recording_are_averaged(tmp_path):
    q = random_poses(ROBOT, 12)
    path = recorded(tmp_path, ROBOT, q)
    recording = read_recording(path)
    middle = [[k + 0.5] for k in range(len(q))]
    spans = [[k + 0.1, k + 0.9] for k in range(len(q))]
    for times, count in (((["time_s"], middle), 25), ((["start_s", "end_s"], spans), 40)):
        poses = read_poses(table(tmp_path, q, times), ROBOT)
        torch.testing.assert_close(poses.q, q, rtol=0, atol=1e-15)
        taken = recorded_readings(recording, ROBOT, poses)
        assert taken.notes == (RATE_NOTE,)
        error = (taken.values - ROBOT.values(q)) / (ROBOT.noise / math.sqrt(count))
        assert 0.7 < float(error.square().mean().sqrt()) < 1.3
    moving = read_poses(table(tmp_path, q[:1], (["start_s", "end_s"], [[0.5, 1.5]])), ROBOT)
    assert recorded_readings(recording, ROBOT, moving).notes == (
        "Pose 1 was not still: its readings scatter by more than 5 times the noise of one_segment.toml.",
        RATE_NOTE,
    )


def test_recordings_and_tables_that_do_not_fit(tmp_path):
    q = random_poses(ROBOT, 3)
    recording = read_recording(recorded(tmp_path, ROBOT, q))
    late = read_poses(table(tmp_path, q, (["time_s"], [[0.5], [1.5], [7.0]])), ROBOT)
    with pytest.raises(InputError) as error:
        recorded_readings(recording, ROBOT, late)
    assert str(error.value) == (
        "Input pose 3 of the table must be within the recording (0.000 to 2.980 s); instead received no frame from "
        "6.75 to 7.25 s."
    )
    with pytest.raises(InputError, match="must be given with time_s, or start_s and end_s; .* no times"):
        recorded_readings(recording, ROBOT, read_poses(table(tmp_path, q), ROBOT))
    three = load_robot(ROBOTS / "three_segments.toml")
    with pytest.raises(
        InputError,
        match="of three_segments.toml must be one with frames of 9 values .* 150 frames of 3 values",
    ):
        recorded_readings(recording, three, late)
    other = replace(recording, metadata=recording.metadata | {"format": "hall"})
    with pytest.raises(InputError, match="must be of the format frames; instead received hall"):
        recorded_readings(other, ROBOT, late)
    path = tmp_path / "poses.csv"
    for text, message in (
        ("delta_x_1_m,delta_y_1_mm,delta_L_1_mm\n1,2,3\n", "instead received none called delta_x_1_mm"),
        ("delta_x_1_mm,delta_y_1_mm,delta_L_1_mm,x\n1,2,3,4\n", "and times; instead received also x"),
        (
            "delta_x_1_mm,delta_y_1_mm,delta_L_1_mm,end_s\n1,2,3,4\n",
            "must be time_s, or start_s and end_s; .* end_s",
        ),
        (
            "delta_x_1_mm,delta_y_1_mm,delta_L_1_mm\n1,2,3\n1,,3\n",
            "must be complete; .* a number missing in pose 2",
        ),
        (
            "delta_x_1_mm,delta_y_1_mm,delta_L_1_mm\n1,a,3\n",
            "delta_y_1_mm in line 2 of poses.csv must be a number",
        ),
        ("delta_x_1_mm,delta_y_1_mm,delta_L_1_mm\n", "must be at least one pose; instead received none"),
        (
            "delta_x_1_mm,delta_y_1_mm,delta_L_1_mm,start_s,end_s\n1,2,3,4,4\n",
            "after start_s; .* 4 in pose 1",
        ),
    ):
        path.write_text(text)
        with pytest.raises(InputError, match=message):
            read_poses(path, ROBOT)
    with pytest.raises(
        InputError, match="must be a CSV with the columns delta_x_1_mm, delta_y_1_mm, delta_L_1_mm"
    ):
        read_poses(tmp_path / "none.csv", ROBOT)


class Bench:
    """A robot on a real pseudo-terminal that can be brought into a pose; sends frames all the time."""

    def __init__(self, robot, truth):
        self.robot, self.truth = robot, truth
        self._master, slave = os.openpty()
        tty.setraw(slave)
        os.set_blocking(self._master, False)
        self.port, self._slave = os.ttyname(slave), slave
        self._values = truth.values(robot.start)
        self._on, self.shaky = True, False
        self._thread = threading.Thread(target=self._send)
        self._thread.start()

    def bring(self, q):
        self._values = self.truth.values(q)

    def _send(self):
        draw, k = generator(0), 0
        while self._on:
            size = self.robot.noise * (50 if self.shaky else 1)
            values = self._values + size * torch.randn(3, generator=draw, dtype=torch.float64)
            with contextlib.suppress(BlockingIOError):  # nobody reads: a board does not wait either
                os.write(self._master, encode("frames", Frame(0, k, k, tuple(values.tolist()))))
            time.sleep(1e-3)
            k += 1

    def close(self):
        self._on = False
        self._thread.join()
        os.close(self._master)
        os.close(self._slave)


@pytest.fixture
def bench():
    truth = built(ROBOT, 3)
    found = Bench(ROBOT, truth)
    yield found
    found.close()


@pytest.mark.skipif(sys.platform == "win32", reason="needs a pseudo-terminal")
def test_a_person_at_a_port(tmp_path, bench):
    """The command in a process of its own, asked and answered through pipes, at a real pseudo-terminal."""
    q = random_poses(ROBOT, 10)
    output = tmp_path / "calibration.json"
    program = "import sys; from cyclopts import App; from edition1_companion.cli_calibrate import calibrate; "
    program += (
        "app = App(); app.command(calibrate); sys.exit(app(sys.argv[1:], result_action='return_value'))"
    )
    options = ["--robot", ROBOTS / "one_segment.toml", "--poses", table(tmp_path, q), "-o", output]
    options += ["--pose-noise-mm", "0.01"]
    command = [sys.executable, "-u", "-c", program, "calibrate", bench.port, *map(str, options)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        shown = ""
        for k, pose in enumerate(q):
            while not shown.endswith("press Enter. "):
                letter = process.stdout.read(1)
                assert letter, shown
                shown += letter
            assert f"Pose {k + 1} of 10: delta_x_1 {1e3 * float(pose[0]):g} mm" in shown
            shown = ""
            bench.bring(pose)
            time.sleep(0.05)
            process.stdin.write("\n")
            process.stdin.flush()
        rest = process.communicate(timeout=60)[0]
    assert process.returncode == 0, rest
    assert f"Written: {output}" in rest
    assert "10 poses, 28 parameters" in rest
    found = load_robot(ROBOTS / "one_segment.toml", output)
    assert rms(ROBOT, bench.truth, q) > 10 * rms(found, bench.truth, q)


@pytest.mark.skipif(sys.platform == "win32", reason="needs a pseudo-terminal")
def test_frames_from_before_the_key_are_not_taken(tmp_path, bench):
    """The robot stays in the wrong pose while it is asked for: readings of that time must not count."""
    q = random_poses(ROBOT, 3)
    poses = read_poses(table(tmp_path, q), ROBOT)
    asked, said = [], []

    def ask(question):
        k = (0, 1, 1, 2)[len(asked)]  # the second pose is not still at first: it is asked for once more
        bench.bring(q[(k + 1) % 3])
        time.sleep(0.1)
        bench.shaky = len(asked) == 1
        bench.bring(q[k])
        time.sleep(0.05)
        asked.append(question)

    taken = guide(ROBOT, poses, port_frames(bench.port, 115200, ROBOT, print), say=said.append, ask=ask)
    assert said == ["That was not still: once more."]
    assert [question.split(":")[0] for question in asked] == [f"Pose {k} of 3" for k in (1, 2, 2, 3)]
    assert [note for note in taken.notes if "rate_hz" not in note] == []
    torch.testing.assert_close(taken.values, bench.truth.values(q), rtol=0, atol=5e-4)


def test_streams_that_end_stall_or_do_not_fit(tmp_path):
    poses = read_poses(table(tmp_path, random_poses(ROBOT, 2)), ROBOT)
    gate = threading.Event()

    def after_key(frames, pause):
        gate.wait()
        for frame in frames:
            time.sleep(pause)
            yield frame

    def silent():
        gate.wait()
        yield Frame(0, 0, 0, (1.0, 2.0, 3.0))
        threading.Event().wait()

    def run(frames, **options):
        gate.clear()
        answer = lambda _: threading.Timer(0.05, gate.set).start()  # noqa: E731
        return guide(ROBOT, poses, frames, say=print, ask=answer, **options)

    with pytest.raises(InputError) as error:
        run(after_key(iter([Frame(0, 0, 0, (1.0, 2.0, 3.0))] * 3), 0.1))
    assert str(error.value) == (
        "Input frames of repro calibrate must be 0.5 s of them for a pose; instead received 3 of them: the stream "
        "ended."
    )
    with pytest.raises(InputError, match=r"must be 0\.5 s of them for a pose; .* none for 0\.6 s"):
        run(silent(), silence_s=0.3, patience_s=0.6)
    with pytest.raises(
        InputError, match="must be of 3 channels, as described in one_segment.toml; .* 2 values"
    ):
        run(after_key(iter([Frame(0, 0, 0, (1.0, 2.0))] * 500), 1e-3))
