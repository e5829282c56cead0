"""Own recordings with motion capture, on synthetic rigs: lag, calibration, errors, gaps, and what is refused."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import torch
from own_rig import ROBOTS, Rig, write
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from edition1.errors import InputError
from edition1.robot_file.load import load_robot
from edition1.robot_file.robot_file import RobotFile
from edition1_live.own import models
from edition1_live.own.fit import find_clock_lag, fit
from edition1_live.own.judge import Tracked, Truth, errors_of_estimates, tip_band, tip_positions
from edition1_live.own.poses import read_measured_poses
from edition1_live.own.results import write_results
from edition1_live.own.samples import TimedReadings, timed_readings
from edition1_live.robot.readings_file import read_readings

LAG_S = 0.37
NOISE = {"noise_m": 1e-4, "noise_rad": 0.01}


def command(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    full = [sys.executable, "-m", "edition1_companion.cli", "fit", *map(str, arguments)]
    return subprocess.run(full, cwd=folder, capture_output=True, text=True, check=False, timeout=500)


def told_lag_s(text: str) -> float:
    found = re.search(r"^Lag: (\S+) \+- \S+ ms", text, re.M)
    assert found is not None, text
    return float(found[1]) / 1e3


def tip_means(folder: Path) -> dict[tuple[str, str], float]:
    table = pd.read_csv(folder / "errors.csv")
    tip = table[table["quantity"] == "tip"]
    return dict(zip(zip(tip["model"], tip["estimator"], strict=True), tip["mean"], strict=True))


@pytest.fixture(scope="module")
def rig() -> Rig:
    return Rig.of("one_segment")


@pytest.fixture(scope="module")
def files(rig: Rig, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Readings and poses without gaps."""
    folder = tmp_path_factory.mktemp("fit")
    return rig.write_csv(folder / "readings.csv"), rig.write_poses(folder / "poses.csv", *rig.measured())


def own_readings(path: Path, robot: RobotFile) -> TimedReadings:
    return timed_readings(read_readings(path, robot), robot)


def both(rig: Rig, readings: Path, poses: Path):
    return own_readings(readings, rig.robot), read_measured_poses(poses, rig.robot, **NOISE)


def test_a_recording_and_poses_with_gaps(tmp_path, rig):
    """The whole command: a .rec with the board's clock, poses on another clock, two gaps; run again it refuses."""
    time_s, q = rig.measured(lag_s=LAG_S)
    keep = np.ones(len(time_s), dtype=bool)
    keep[300:350] = False  # 0.85 s, in the first part
    keep[1000:1030] = False  # 0.52 s, judged
    keep[1200] = False  # one frame is interpolated over
    rig.write_recording(tmp_path / "readings.rec")
    rig.write_poses(tmp_path / "poses.csv", time_s[keep], q[keep])
    options = ["readings.rec", "poses.csv", "--robot", ROBOTS / "one_segment.toml", "-o", "found"]
    done = command(tmp_path, *options, "--pose-noise-mm", "0.1")
    assert done.returncode == 0, done.stderr
    assert abs(told_lag_s(done.stdout) - LAG_S) < 2e-3, "a tenth of a sample"
    names = ["calibration.json", "errors.csv", "estimates.csv", "estimates.png", "report.txt"]
    assert sorted(os.listdir(tmp_path / "found")) == names
    assert sorted(os.listdir(tmp_path)) == ["found", "poses.csv", "readings.rec"]
    assert done.stdout.startswith((tmp_path / "found" / "report.txt").read_text())
    assert "gaps of over 0.0417 s: 2, not interpolated over." in done.stdout
    short = "Band of calibrated, kalman: the halves of the judged part must have 18 s of poses each"
    assert short in done.stdout
    tip = tip_means(tmp_path / "found")
    for name in ("levenberg_marquardt", "kalman"):
        assert tip["calibrated", name] < 0.1 * tip["described", name]
        assert tip["calibrated", name] < 0.5
    table = pd.read_csv(tmp_path / "found" / "estimates.csv")
    gap = (table["time_s"] > time_s[999] + LAG_S) & (table["time_s"] < time_s[1030] + LAG_S)
    masked = table["measured_delta_x_1_mm"].isna()
    assert masked.equals(gap | (masked & (table["time_s"] == table["time_s"].iloc[[0, -1]].max())))
    assert f"of which {masked.sum()} ({masked.mean():.1%}) have no measured pose" in done.stdout
    assert table["calibrated_kalman_delta_x_1_mm"].notna().all(), "estimates go on in gaps"
    loaded = load_robot(ROBOTS / "one_segment.toml", tmp_path / "found" / "calibration.json")
    assert float((loaded.offset - rig.offset).abs().max()) < 0.1
    before = (tmp_path / "found" / "report.txt").read_bytes()
    again = command(tmp_path, *options)
    assert (again.returncode, again.stdout) == (2, "")
    assert again.stderr == (
        "repro: Input output of repro fit must be a folder that does not exist yet; instead received found.\n"
    )
    assert (tmp_path / "found" / "report.txt").read_bytes() == before


def test_three_segments_by_the_poses_of_their_ends(tmp_path):
    rig = Rig.of("three_segments")
    rig.write_csv(tmp_path / "readings.csv")
    rig.write_ends(tmp_path / "ends.csv", *rig.measured(50.0, -1.234), unit="m")
    options = ["readings.csv", "ends.csv", "--robot", ROBOTS / "three_segments.toml", "-o", "new/found"]
    done = command(tmp_path, *options, "--pose-noise-mm", "0.1", "--share", "0.5")
    assert done.returncode == 0, done.stderr
    assert abs(told_lag_s(done.stdout) + 1.234) < 2e-3
    tip = tip_means(tmp_path / "new" / "found")
    for name in ("levenberg_marquardt", "kalman"):
        assert tip["calibrated", name] < 0.2 * tip["described", name]
    table = pd.read_csv(tmp_path / "new" / "found" / "errors.csv")
    coordinates = [f"delta_{axis}_{k}" for k in (1, 2, 3) for axis in "xyL"]
    assert list(table["quantity"][:11]) == [*coordinates, "configuration", "tip"]


def test_the_lag_follows_the_clocks(rig, tmp_path):
    """Another zero of either clock changes the lag by it; clocks that never meet start at their first rows."""
    readings, poses = both(
        rig, rig.write_csv(tmp_path / "r.csv"), rig.write_poses(tmp_path / "p.csv", *rig.measured())
    )
    lag = find_clock_lag(rig.robot, readings, poses, 10.0)
    assert find_clock_lag(rig.robot, readings, poses.counted_from(3.0), 10.0) == pytest.approx(
        lag + 3, abs=0.02
    )
    assert find_clock_lag(rig.robot, readings.counted_from(2.0), poses, 10.0) == pytest.approx(
        lag - 2, abs=0.02
    )
    since_1970 = readings.counted_from(-1.7e9)
    found = fit(rig.robot, since_1970, poses)
    assert "The clocks have no time in common: each is counted from its first row." in found.notes
    assert abs(found.lag.lag_s - 0.4) < 2e-3  # the first pose is 0.4 s after the first reading


def test_a_long_gap_does_not_change_the_lag(rig, tmp_path):
    """10 s without poses: interpolated over, they would be a straight line that correlates with something."""
    time_s, q = rig.measured()
    keep = (time_s < 7.0) | (time_s > 17.0)
    readings, poses = both(
        rig, rig.write_csv(tmp_path / "r.csv"), rig.write_poses(tmp_path / "p.csv", time_s[keep], q[keep])
    )
    assert poses.gaps == 1
    assert find_clock_lag(rig.robot, readings, poses, 10.0) == pytest.approx(LAG_S, abs=0.03)


def test_no_judged_pose_enters_an_estimate(rig, files, tmp_path):
    """Poses of the rest moved by 2 mm: estimates keep their bits, errors do not."""
    readings, poses = both(rig, *files)
    ours = fit(rig.robot, readings, poses)
    q = poses.q.clone()
    q[poses.time_s > ours.parts.rest_s[0] - LAG_S - 0.1, 0] += 2e-3
    moved = fit(rig.robot, readings, replace(poses, q=q))
    for one, other in zip(ours.tracks, moved.tracks, strict=True):
        assert torch.equal(one.q, other.q)
    mean = [float((found.tracks[1].q - found.truth.q)[:, 0].nanmean()) for found in (ours, moved)]
    assert mean[0] - mean[1] == pytest.approx(2e-3, rel=0.01)


def test_poses_that_jump_are_left_out_of_the_fit(rig, tmp_path):
    time_s, q = rig.measured()
    q[50:550:50] += torch.tensor([4e-3, -4e-3, 0.0])
    readings, poses = both(
        rig, rig.write_csv(tmp_path / "r.csv"), rig.write_poses(tmp_path / "p.csv", time_s, q)
    )
    found = fit(rig.robot, readings, poses)
    assert any(note.endswith("do not go with their readings: not fitted.") for note in found.notes)
    assert abs(found.lag.lag_s - LAG_S) < 2e-3
    table = errors_of_estimates(rig.robot, found.truth, found.tracks)
    tip = table[(table["quantity"] == "tip") & (table["model"] == "calibrated")]
    assert (tip["mean"] < 1.0).all()


def test_errors_of_known_size():
    """Errors drawn from the stated covariance: 95 % inside, normalised squares of mean 1; the tip by hand."""
    robot = load_robot(ROBOTS / "one_segment.toml")
    generator, n = torch.Generator().manual_seed(0), 4000
    q = torch.tensor([5e-3, -3e-3, 2e-3]).double().expand(n, 3)
    A = 1e-4 * torch.tensor([[1.0, 0.0, 0.0], [0.5, 1.0, 0.0], [0.0, 0.3, 0.7]]).double()
    P, R = (A @ A.mT).expand(n, 3, 3), 1e-8 * torch.eye(3).double().expand(n, 3, 3)
    draw = torch.randn(2, n, 3, generator=generator, dtype=torch.float64)
    estimate, measured = q + draw[0] @ A.mT, q + 1e-4 * draw[1]
    measured[::7] = torch.nan
    truth = Truth(measured, R, *tip_positions(robot, measured, R))
    track = Tracked("made up", "by hand", estimate, P, np.zeros(n))
    table = errors_of_estimates(robot, truth, [track]).set_index("quantity")
    assert list(table["frames"].unique()) == [n - len(range(0, n, 7))]
    for name in table.index:
        assert table["coverage"][name] == pytest.approx(0.95, abs=0.015)
        assert table["nees"][name] == pytest.approx(1.0, abs=0.06)
        assert table["coverage_alone"][name] < table["coverage"][name]
    away = (robot.robot.tip(estimate) - robot.robot.tip(torch.nan_to_num(measured)))[:, :3, 3]
    size = torch.linalg.vector_norm(away, dim=-1)[truth.known]
    assert table["mean"]["tip"] == pytest.approx(1e3 * float(size.mean()))
    assert table["percent_of_length"]["tip"] == pytest.approx(float(100 * size.mean() / 0.11))


def test_a_band_grows_by_what_the_covariance_lacks():
    """Errors twice as large as stated: the factor is that of the quantile of conformal prediction, and it holds."""
    robot = load_robot(ROBOTS / "one_segment.toml")
    generator, n = torch.Generator().manual_seed(0), 8000
    q = torch.tensor([5e-3, -3e-3, 2e-3]).double().expand(n, 3)
    P = 1e-10 * torch.eye(3, dtype=torch.float64).expand(n, 3, 3)
    estimate = q + 2e-5 * torch.randn(n, 3, generator=generator, dtype=torch.float64)
    truth = Truth(q, P, *tip_positions(robot, q, P))
    track = Tracked("made up", "by hand", estimate, P, np.zeros(n))
    band = tip_band(robot, truth, track, np.linspace(0.0, 79.99, n))
    blocks = 20  # of two seconds, in each half
    reached = 0.9 * (blocks + 1) / blocks
    assert band.grown == pytest.approx(2 * np.sqrt(chi2.ppf(reached, 3) / chi2.ppf(0.9, 3)), rel=0.03)
    assert band.held == pytest.approx(reached, abs=0.015)
    assert band.held_as_stated == pytest.approx(chi2.cdf(chi2.ppf(0.9, 3) / 4, 3), abs=0.03)
    assert band.least_s == pytest.approx(18.0)
    assert tip_band(robot, truth, track, np.linspace(0.0, 30.0, n)).grown == np.inf
    assert tip_band(robot, replace(truth, q=truth.q * np.nan), track, np.arange(8000.0)).grown == np.inf


def test_bodies_of_motive(rig, tmp_path):
    """A base that is turned and elsewhere, y up, frames without the tip: the configurations come back."""
    time_s, q = rig.measured(noise_m=0.0)
    base = np.array([0.4, -0.3, 0.1])
    path = rig.write_motive(tmp_path / "take.csv", time_s, q, base=base, gaps=slice(500, 560))
    poses = read_measured_poses(path, rig.robot, bodies=["Foot", "Tip"], **NOISE)
    seen = np.ones(len(q), dtype=bool)
    seen[500:560] = False
    torch.testing.assert_close(poses.q, q[seen], rtol=0, atol=5e-5)
    assert (poses.gaps, poses.frames) == (1, len(q))
    assert f"60 of {len(q)} rows of take.csv have no pose." in poses.notes
    for bodies, expected in (
        (
            ["Foot", "Top"],
            "Input body of take.csv must be rigid bodies of the file (Foot, Tip); instead received Top.",
        ),
        (
            [],
            "Input body of repro fit must be 1 different rigid bodies from base to tip, or 2 with one on the base; "
            "instead received none (use --body NAME).",
        ),
    ):
        with pytest.raises(InputError) as error:
            read_measured_poses(path, rig.robot, bodies=bodies, **NOISE)
        assert str(error.value) == expected
    path.write_text(path.read_text().replace("Length Units,Meters", "Length Units,Feet"))
    with pytest.raises(
        InputError, match="Length Units of take.csv must be Meters or Centimeters or Millimeters"
    ):
        read_measured_poses(path, rig.robot, bodies=["Foot", "Tip"], **NOISE)


def test_a_body_beside_the_tip_is_measured_while_the_robot_is_straight(rig, tmp_path):
    time_s = np.arange(600) / 100.0
    q = torch.where(torch.from_numpy(time_s)[:, None] < 1.0, 0.0, rig.q(time_s))
    T = rig.robot.robot.tip(q).numpy()
    turn = Rotation.from_euler("xyz", [10, -20, 70], degrees=True)
    position = T[:, :3, 3] + T[:, :3, :3] @ np.array([0.004, -0.01, 0.02])
    quaternion = (Rotation.from_matrix(T[:, :3, :3]) * turn).as_quat()
    table = {"time_s": time_s} | {f"{a}_1_mm": 1e3 * position[:, k] for k, a in enumerate("xyz")}
    path = write(tmp_path / "b.csv", table | {f"q{a}_1": quaternion[:, k] for k, a in enumerate("xyzw")})
    poses = read_measured_poses(path, rig.robot, straight_s=1.0, **NOISE)
    torch.testing.assert_close(poses.q, q, rtol=0, atol=1e-9)


def refusal(rig: Rig, readings: Path, poses: Path, **options: object) -> str:
    with pytest.raises(InputError) as error:
        fit(rig.robot, *both(rig, readings, poses), **options)
    return str(error.value)


def test_poses_of_another_motion_are_refused(rig, files, tmp_path):
    time_s, q = rig.measured()
    order = torch.randperm(len(q), generator=torch.Generator().manual_seed(0))
    shuffled = rig.write_poses(tmp_path / "p.csv", time_s, q[order])
    text = refusal(rig, files[0], shuffled)
    assert re.fullmatch(
        r"Input readings and poses of repro fit must be of one motion: readings that correlate by 0.8 with those "
        r"that one_segment.toml predicts; instead received r = 0.\d\d\d at \S+ s, at best.",
        text,
    ), text


@pytest.mark.parametrize(
    ("order", "sign", "words"),
    [
        ([1, 0, 2], [1, 1, 1], "x and y exchanged"),
        ([0, 1, 2], [-1, 1, 1], "x reversed"),
        ([1, 0, 2], [-1, 1, 1], r"\(x, y\) turned to \(y, -x\)"),
    ],
)
def test_wrong_axes_are_refused_and_named(rig, files, tmp_path, order, sign, words):
    time_s, q = rig.measured()
    wrong = q[:, order] * torch.tensor(sign)
    text = refusal(rig, files[0], rig.write_poses(tmp_path / "p.csv", time_s, wrong))
    assert re.fullmatch(
        r"Input readings and poses of repro fit must be of one motion, in the axes of one_segment.toml; "
        rf"instead received r = 0.\d+ at best, but 0.9\d\d with {words}.",
        text,
    ), text


def test_poses_with_y_up_are_refused(rig, tmp_path):
    time_s, q = rig.measured()
    path = rig.write_ends(tmp_path / "e.csv", time_s, q)
    head, *rows = path.read_text().splitlines()
    cells = [row.split(",") for row in rows]
    turned = [[c[0], c[1], c[3], f"{-float(c[2])!r}", c[4], c[6], f"{-float(c[5])!r}", c[7]] for c in cells]
    path.write_text("\n".join([head, *map(",".join, turned)]) + "\n")
    with pytest.raises(InputError, match="z along the straight robot to its tip; instead received"):
        read_measured_poses(path, rig.robot, **NOISE)


def test_wrong_units_are_refused(rig, files, tmp_path):
    time_s, q = rig.measured()
    with pytest.raises(InputError) as error:
        read_measured_poses(rig.write_poses(tmp_path / "a.csv", time_s, q / 1e3), rig.robot, **NOISE)
    assert re.fullmatch(
        r"Input poses of a.csv must be poses that move by 5 % of the bounds of one_segment.toml \(units\?\); "
        r"instead received delta_\S+ that moves by 0.1%, and no other by more.",
        str(error.value),
    ), error.value
    with pytest.raises(InputError) as error:
        read_measured_poses(rig.write_poses(tmp_path / "b.csv", time_s, q * 1e3), rig.robot, **NOISE)
    assert re.fullmatch(
        r"Input delta_\S+ of b.csv must be within the bounds of one_segment.toml, \S+ to \S+ "
        r"\(units, axes, bounds\?\); instead received \S+ to \S+, \d+ % of the poses far outside.",
        str(error.value),
    ), error.value
    ends = rig.write_ends(tmp_path / "c.csv", time_s, q, unit="mm")
    ends.write_text(ends.read_text().replace("_mm", "_m"))
    with pytest.raises(
        InputError, match="must be poses that the robot can take, in m or mm as their columns say"
    ):
        read_measured_poses(ends, rig.robot, **NOISE)
    with pytest.raises(InputError) as error:
        own_readings(rig.write_csv(tmp_path / "mv.csv", unit="mV"), rig.robot)
    assert str(error.value) == (
        "Input column u1_mV of mv.csv must be in mT, the unit of one_segment.toml; instead received mV."
    )
    loud = rig.write_csv(tmp_path / "ut.csv", values=1e3 * rig.values())
    assert re.fullmatch(
        r"Input readings of repro fit must be readings that move 0.5 to 2 times as much as one_segment.toml predicts "
        r"\(units\?\); instead received \d.*e?\+?\d* times as much.",
        refusal(rig, loud, files[1]),
    )


def test_recordings_that_are_too_short_or_apart_are_refused(rig, files, tmp_path):
    time_s, q = rig.measured()
    short = rig.write_poses(tmp_path / "s.csv", time_s[:600], q[:600])
    assert refusal(rig, files[0], short) == (
        "Input readings and poses of repro fit must be of 5 s to calibrate with and 5 s to judge, 1 s apart; "
        "instead received 10.0 s in common, a share of 0.4 to calibrate with."
    )
    assert refusal(rig, *files, longest_lag_s=0.37).startswith(
        "Input readings and poses of repro fit must be of clocks that differ by less than 0.3"
    )
    assert re.search(r"of one motion.*at best\.$", refusal(rig, *files, longest_lag_s=0.05))
    late = rig.write_poses(tmp_path / "l.csv", time_s + 24, q)
    assert "must be of one time within 10 s, with half of the shorter in common" in refusal(
        rig, files[0], late
    )
    assert "Input share of repro fit must be between 0 and 1" in refusal(rig, *files, share=1.0)


def test_a_motion_that_repeats_itself_is_refused(rig, tmp_path):
    """Three equal rounds of 5 s: lags of -5, 0 and 5 s explain the readings alike."""
    periodic = replace(rig, waves=torch.where(torch.tensor([True, False]), 0.2, rig.waves))
    readings = periodic.write_csv(tmp_path / "r.csv")
    poses = periodic.write_poses(tmp_path / "p.csv", *periodic.measured())
    assert (
        "must be alike at one lag only (a motion that repeats itself needs a smaller --longest-lag)"
        in refusal(periodic, readings, poses)
    )


def test_readings_are_found_by_the_names_of_their_columns(rig, tmp_path):
    """As by repro track: in any order, beside columns that are none; labels without a number are refused."""
    readings = own_readings(rig.write_csv(tmp_path / "r.csv"), rig.robot)
    table = pd.read_csv(tmp_path / "r.csv", dtype=str)
    table["temperature"] = "25"
    table[["u3_mT", "temperature", "u1_mT", "time_s", "u2_mT"]].to_csv(tmp_path / "o.csv", index=False)
    other = own_readings(tmp_path / "o.csv", rig.robot)
    np.testing.assert_array_equal(other.signal, readings.signal)
    np.testing.assert_array_equal(other.time_s, readings.time_s)
    np.testing.assert_allclose(readings.time_s, rig.readings_s, rtol=0, atol=1e-9)
    assert other.notes == ("Columns of o.csv that are not used: temperature.", *readings.notes)
    table.rename(columns={"u1_mT": "a"}).to_csv(tmp_path / "a.csv", index=False)
    with pytest.raises(
        InputError, match="channel 1 of a.csv must be one column: u1, u1_mT, channel_1 or sensor_1"
    ):
        own_readings(tmp_path / "a.csv", rig.robot)
    table[:2].to_csv(tmp_path / "short.csv", index=False)
    with pytest.raises(InputError, match="readings of repro fit must be of at least three time steps; .* 2"):
        own_readings(tmp_path / "short.csv", rig.robot)
    with pytest.raises(InputError, match="a recording, or a CSV of readings; .*no.csv, which is not there"):
        own_readings(tmp_path / "no.csv", rig.robot)


def test_poses_that_are_no_table_are_refused_with_column_and_line(rig, tmp_path):
    path = tmp_path / "p.csv"
    for text, expected in (
        ("", "Input table of p.csv must be a CSV of numbers with a header, separated by commas;"),
        (
            "a,b\n0,1\n",
            "Input times of p.csv must be one column, such as time_s; instead received none among a, b.",
        ),
        (
            "time_s,a,b,c\n0,1,2,3\n# pause\n1,1,x,3\n",
            "Input b in line 4 of p.csv must be a number (cells are separated by commas); instead received 'x'.",
        ),
        (
            "time_s,a,b,c\n0,1,2\n",
            "Input line 2 of p.csv must be of 4 cells, as the header; instead received 3.",
        ),
        (
            "time_s,a,b,c\n0,1,2,3\n1,1,2,3\n\n1,1,2,3\n",
            "Input time_s in line 5 of p.csv must be after the time before, 1 s; instead received 1 s.",
        ),
        ("time_s,a\n0,1\n1,1\n", "Input table of p.csv must be at least three rows; instead received 2."),
        ("time_s,a,a,c\n", "Input columns of p.csv must be of different names; instead received a twice."),
        (
            "time_s,delta_x_1_mm,delta_y_1_mm\n0,1,2\n1,1,2\n2,1,2\n",
            "Input columns of p.csv must be delta_x_1_mm, delta_y_1_mm, delta_L_1_mm; instead received none called",
        ),
    ):
        path.write_text(text)
        with pytest.raises(InputError) as error:
            read_measured_poses(path, rig.robot, **NOISE)
        assert str(error.value).startswith(expected)
    with pytest.raises(InputError, match="must be a CSV that is there"):
        read_measured_poses(tmp_path / "no.csv", rig.robot, **NOISE)


def test_nothing_is_left_when_writing_fails(rig, files, tmp_path, monkeypatch):
    readings, poses = both(rig, *files)
    found = fit(rig.robot, readings, poses)

    def full(*_: object, **__: object) -> None:
        raise OSError("No space left on device")

    monkeypatch.setattr("edition1.robot_file.calibration_file.RobotCalibration.write", full)
    with pytest.raises(OSError, match="No space"):
        write_results(tmp_path / "found", found, poses)
    assert os.listdir(tmp_path) == []


def test_networks_instead_of_a_calibration(rig, files, tmp_path, monkeypatch):
    monkeypatch.setattr(models, "TRAINING_STEPS", 600)
    readings, poses = both(rig, *files)
    found = fit(rig.robot, readings, poses, model="network")
    assert found.calibration is None
    write_results(tmp_path / "found", found, poses)
    tip = tip_means(tmp_path / "found")
    assert tip["network", "levenberg_marquardt"] < 0.3 * tip["described", "levenberg_marquardt"]
    assert {"sensor1.safetensors", "sensor3.json"} < set(os.listdir(tmp_path / "found"))
    with pytest.raises(InputError, match="Input model of repro fit must be calibration or network"):
        fit(rig.robot, readings, poses, model="magic")
