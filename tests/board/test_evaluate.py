"""Files of motion capture, and the search for a lag between readings and motion capture."""

from datetime import datetime
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from repro import InputError
from repro_board.evaluate import read_motive, search_lag, undo_exchanges

KINDS = ["Rotation"] * 4 + ["Position"] * 3 + ["Error Per Marker"]
AXES = [*"XYZWXYZ", "error"]


def write_motive(
    path: Path, bodies: dict[str, np.ndarray], *, version="1.21", unit="Millimeters", rate_hz=120, start=None
) -> Path:
    """Write poses ``[t, 7]``, quaternion and position in the unit, as Motive exports them."""
    scale = {"Millimeters": 1e3, "Meters": 1.0}[unit]
    n, names = len(next(iter(bodies.values()))), [name for name in bodies for _ in range(8)]
    labels = version != "1.21"
    at = (
        f"Capture Start Time,{start:%Y-%m-%d %I.%M.%S}.{start.microsecond // 1000:03d} {start:%p},"
        if start
        else ""
    )
    head = [
        [f"Format Version,{version},Take Name,{path.stem},Export Frame Rate,{rate_hz},{at}"
         f"Total Frames in Take,{n},Total Exported Frames,{n},Rotation Type,Quaternion,Length Units,{unit}"],
        [""],
        ["", "Type" * labels, *["Rigid Body"] * len(names)],
        ["", "Name" * labels, *names],
        ["", "ID" * labels, *["1"] * len(names)],
        ["", "", *KINDS * len(bodies)],
        ["Frame", "Time", *AXES * len(bodies)],
    ]  # fmt: skip
    lines = [",".join(row) for row in head]
    for k in range(n):
        cells = [str(k), f"{k / rate_hz:.6f}"]
        for poses in bodies.values():
            lost, row = np.isnan(poses[k]).any(), [*poses[k, :4], *scale * poses[k, 4:], 0.05]
            cells += [""] * 8 if lost else [f"{x:.6f}" for x in row]
        lines.append(",".join(cells))
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def turning(n: int = 30) -> dict[str, np.ndarray]:
    """Two bodies, one of them lost in the fourth frame."""
    half = np.linspace(0, 0.3, n)
    poses = np.stack(
        [0 * half, 0 * half, np.sin(half), np.cos(half), 0.01 * half, 0.1 + 0 * half, -half], axis=-1
    )
    moving = poses.copy()
    moving[3] = np.nan
    return {"Ground": np.tile(poses[:1], (n, 1)), "Module": moving}


@pytest.mark.parametrize(
    ("version", "unit"), [("1.21", "Millimeters"), ("1.23", "Meters"), ("1.23", "Millimeters")]
)
def test_poses_come_back_in_metres_whatever_version_and_unit(tmp_path, version, unit):
    start, bodies = datetime(2021, 3, 12, 21, 50, 1, 253000), turning()
    take = read_motive(write_motive(tmp_path / "a.csv", bodies, version=version, unit=unit, start=start))
    assert (take.name, take.started, take.rate_hz, take.missing) == ("a", start, 120.0, 0)
    np.testing.assert_allclose(take.times, np.arange(30) / 120, atol=1e-6)
    assert list(take.bodies) == ["Ground", "Module"]
    for name, poses in bodies.items():
        np.testing.assert_allclose(take.bodies[name], poses, rtol=0, atol=1e-6)


def test_a_body_is_lost_as_a_whole_by_an_empty_cell_and_by_a_quaternion_of_zeros(tmp_path):
    bodies = turning()
    path = write_motive(tmp_path / "a.csv", bodies, version="1.23", unit="Meters")
    lines = path.read_text(encoding="utf-8").splitlines()
    cells = lines[7 + 10].split(",")
    lines[7 + 10] = ",".join([*cells[:-2], "", cells[-1]])  # no z
    cells = lines[7 + 12].split(",")
    lines[7 + 12] = ",".join([*cells[:10], "0", "0", "0", "0", *cells[14:]])
    path.write_text("\n".join(lines), encoding="utf-8")
    take = read_motive(path)
    assert np.flatnonzero(np.isnan(take.bodies["Module"]).all(axis=1)).tolist() == [3, 10, 12]
    assert np.isfinite(take.bodies["Ground"]).all()


def test_frames_that_a_header_announces_in_vain_are_counted(tmp_path):
    path = write_motive(tmp_path / "a.csv", turning())
    path.write_text("\n".join(path.read_text(encoding="utf-8").splitlines()[:-4]), encoding="utf-8")
    take = read_motive(path)
    assert (len(take.times), take.missing) == (26, 4)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("Version,1.21", "Version,1.31", "Format Version of a.csv must be 1.20 to 1.29; instead received 1.31."),
        ("Quaternion", "XYZ", "Rotation Type of a.csv must be Quaternion; instead received XYZ."),
        ("Units,Millimeters", "Units,Feet", "Length Units of a.csv must be Millimeters or Centimeters or Meters"),
        ("Length Units", "Coordinate Space,Local,Length Units", "Coordinate Space of a.csv must be Global"),
        ("Exported Frames,30", "Exported Frames,many", "header of a.csv must be one with frame rate"),
        ("Frame,Time", "Number,Time", "header of a.csv must be one with frame rate"),
        ("Position", "Place", "rigid bodies of a.csv must be there with rotation and position"),
        ("\n9,0.075000,", "\n9,,", "times of a.csv must be increasing from frame to frame"),
        ("\n9,0.075000,0.0", "\n9,0.075000,x", "frames of a.csv must be rows of numbers"),
        ("\n9,0.075000,0.0", "\n9,0.075000,0.5", "quaternions of a.csv must be unit within 0.01"),
    ],
)  # fmt: skip
def test_other_files_are_refused(tmp_path, old, new, message):
    path = write_motive(tmp_path / "a.csv", turning())
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new), encoding="utf-8")
    with pytest.raises(InputError) as caught:
        read_motive(path)
    assert message in str(caught.value)


@pytest.mark.parametrize("content", [b"", b"time,x\n1,2\n", b"Format\xff\xfe"])
def test_what_is_no_export_is_refused(tmp_path, content):
    path = tmp_path / "a.csv"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"(Format Version|content) of a\.csv must be"):
        read_motive(path)


ONE = Rotation.from_rotvec(np.radians(178) * np.array([0.0, np.sin(0.3), np.cos(0.3)]))
OTHER = Rotation.from_rotvec(np.radians(179.5) * np.array([0.89, 0.0, -0.456]))


def bending(n: int = 1320) -> Rotation:
    """A body that bends by 50 degrees and back."""
    angle = 50 * np.sin(np.linspace(0, np.pi, n)) ** 2
    return Rotation.from_rotvec(angle[:, None] * [0.87, 0.0, -0.5], degrees=True)


def exchanged(truth: Rotation, turn: Rotation, *stretches: tuple[int, int]) -> Rotation:
    """Turn a body in its own axes in some frames."""
    q = truth.as_quat()
    for a, b in stretches:
        q[a:b] = (truth[a:b] * turn).as_quat()
    return Rotation.from_quat(q)


def off_deg(found: np.ndarray, truth: Rotation) -> np.ndarray:
    known = np.isfinite(found[:, 0])
    return np.degrees((Rotation.from_quat(found[known]).inv() * truth[known]).magnitude())


def test_exchanged_markers_are_undone_where_they_are_and_nowhere_else():
    """Single frames, a stretch over the peak, two exchanges that follow each other, and lost frames."""
    truth, one, other = bending(), ((200, 202), (300, 301), (600, 900)), ((500, 505), (900, 940))
    seen = exchanged(exchanged(truth, ONE, *one), OTHER, *other).as_quat()
    seen[[100, 1319]] = np.nan
    found, undone = undo_exchanges(seen)
    expected = np.zeros(1320, dtype=bool)
    for a, b in (*one, *other):
        expected[a:b] = True
    np.testing.assert_array_equal(undone, expected)
    assert np.flatnonzero(np.isnan(found).any(axis=1)).tolist() == [100, 1319]
    assert off_deg(found, truth).max() < 0.2
    np.testing.assert_array_equal(found[~undone], seen[~undone])


@pytest.mark.parametrize("step_deg", [20.0, 60.0, 85.0])
def test_a_body_that_really_turns_fast_is_left_alone(step_deg):
    angle = np.concatenate(
        [np.zeros(50), np.arange(0, 181, step_deg), np.full(50, 180.0), np.arange(180, -1, -step_deg)]
    )
    seen = Rotation.from_rotvec(angle[:, None] * [0.0, 0.0, 1.0], degrees=True).as_quat()
    found, undone = undo_exchanges(seen)
    assert not undone.any()
    np.testing.assert_array_equal(found, seen)


def test_what_is_no_exchange_is_left_out():
    """A jump by 120 degrees, and a half turn that is seen once: nothing says that it is always the same."""
    truth, turn = bending(), Rotation.from_euler("x", 120, degrees=True)
    for seen, lost in ((exchanged(truth, turn, (400, 420)), 20), (exchanged(truth, ONE, (1200, 1320)), 120)):
        found, undone = undo_exchanges(seen.as_quat())
        assert not undone.any()
        assert np.isnan(found).any(axis=1).sum() == lost
        assert off_deg(found, truth).max() < 1e-5


def test_a_body_that_is_never_seen_is_refused():
    with pytest.raises(
        InputError, match="quaternions of undo_exchanges must be there.*received 5 lost frames"
    ):
        undo_exchanges(np.full((5, 4), np.nan))


def motion(n: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    slow = np.cumsum(rng.normal(size=(n, 3)), axis=0)
    return (slow - slow.mean(0)) / slow.std(0)


def readings(q: np.ndarray) -> np.ndarray:
    x, y, z = q.T
    return np.stack([3 * x - y + 0.5 * x * y, y + z, 2 * z + 0.3 * x * x], axis=-1)


@pytest.mark.parametrize("lag", [-900, -37, 0, 5, 700])
def test_finds_any_lag_of_up_to_half_the_recording(lag):
    q = motion(4000)
    u = readings(q) + 0.01 * np.random.default_rng(1).normal(size=(4000, 3))
    a, b = (q[:-lag], u[lag:]) if lag > 0 else (q[-lag:], u[: 4000 + lag])
    found = search_lag(a, b, 40)
    assert found.lag_s == -lag / 40
    assert found.best == pytest.approx(0.01, rel=0.1)


def test_residuals_are_those_of_least_squares_over_what_both_have():
    q = motion(300)
    u = readings(q) + np.sin(np.arange(300))[:, None]
    q[20:25], u[100:103, 1] = np.nan, np.nan
    low, up = np.triu_indices(3)
    columns = np.column_stack([np.ones(300), q, q[:, low] * q[:, up]])
    both = np.isfinite(columns).all(1) & np.isfinite(u).all(1)
    left = u[both] - columns[both] @ np.linalg.lstsq(columns[both], u[both], rcond=None)[0]
    assert search_lag(q, u, 40).residual == pytest.approx(np.sqrt((left**2).mean()), rel=1e-5)


def test_gaps_of_motion_capture_do_not_end_it():
    q = motion(2000)
    u = readings(q)
    q[::50] = np.nan
    q[700:760] = np.nan
    assert search_lag(q[12:], u[:-12], 40).lag_s == 0.3


def test_a_motion_without_end_has_its_smallest_lag():
    t = np.arange(4000) / 40
    q = np.stack([np.sin(2 * np.pi * t / 5), np.cos(4 * np.pi * t / 5)], axis=-1)
    assert search_lag(q, q @ [[1.0, 2.0], [3.0, 1.0]], 40).lag_s == 0.0


@pytest.mark.parametrize(
    ("q", "u", "message"),
    [
        ((100, 2), (99, 2), "readings of search_lag must be one row for each of 100 poses"),
        ((79, 2), (79, 2), "motion of search_lag must be two seconds long or more; instead received 1.975 s"),
    ],
)
def test_what_cannot_be_compared_is_refused(q, u, message):
    with pytest.raises(InputError) as caught:
        search_lag(np.zeros(q), np.zeros(u), 40)
    assert message in str(caught.value)


def test_mostly_missing_poses_are_refused():
    q = motion(200)
    q[:120] = np.nan
    with pytest.raises(InputError, match="motion of search_lag must be there in most frames.*120 of 200"):
        search_lag(q, readings(motion(200)), 40)
