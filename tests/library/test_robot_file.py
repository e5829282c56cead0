"""Robot files: old ones as the first edition read them, parts as people buy them, what is refused or doubted."""

from __future__ import annotations

import json
import re
import shutil
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import repro
from repro import InputError, calibrate, load_robot, simulated_readings
from repro.estimators.calibration import _own_hash, load_calibration
from repro.networks import load_network

from .robots import STORED

ROOT = Path(__file__).parents[2]
ROBOTS = ROOT / "data" / "robots"
ONE = (ROBOTS / "one_segment.toml").read_text(encoding="utf-8")
ARM = (repro.example() / "robot.toml").read_text(encoding="utf-8")
NETWORK = ROOT / "data" / "networks" / "pcc_nb1_segment1_seed0.safetensors"
SENSOR = ONE[ONE.index("[[sensors]]") :].split("\n\n")[0]
JOINT = """
[stream]
rate_hz = 100.0
noise_mt = 0.006
[[segments]]
kind = "ball_joint"
rx_deg = [-40.0, 40.0]
ry_deg = 0.0
[[segments]]
kind = "link"
length_mm = 12.0
[[magnets]]
kind = "cube"
segment = 2
at_mm = 6.0
side_mm = 4.0
polarisation_mt = 1300.0
tolerance = { at_mm = 2.0, side_mm = 1.0, polarisation_percent = 20.0, tilt_deg = 10.0 }
[[sensors]]
axes = 3
channels = [1, 2, 3]
segment = 0
position_mm = [0.0, 0.0, -8.0]
range_mt = 130.0
"""


def read(folder: Path, text: str, name: str = "robot.toml") -> repro.Robot:
    (folder / name).write_text(text, encoding="utf-8")
    return load_robot(folder / name)


@pytest.mark.parametrize("path", sorted(ROBOTS.glob("*.toml")), ids=lambda path: path.stem)
def test_old_files_say_what_the_first_edition_read(path):
    """Bounds, noise and readings in the unit of the file; the new library has all of them in mT."""
    robot = load_robot(path)
    old = {name: STORED[f"file_{path.stem}_{name}"] for name in ("bounds", "rate", "noise", "streams")}
    np.testing.assert_array_equal([robot.lower, robot.upper], old["bounds"])
    assert robot.rate_hz == old["rate"]
    assert robot.noise is not None
    if robot.sensors:
        q = robot.lower + (robot.upper - robot.lower) * np.random.default_rng(0).random((20, robot.n_q))
        per_mt = robot.per_reading("per_mt", 1.0, 1.0)
        expected = STORED[f"file_{path.stem}_readings"] / per_mt
        np.testing.assert_allclose(robot.sensing()(q), expected, rtol=1e-11, atol=1e-12)
        np.testing.assert_allclose(robot.noise * np.abs(per_mt), old["noise"])
    assert [imu.channels for imu in robot.imus] == old["streams"].tolist()


def test_parts_as_people_buy_them():
    """The example: chips are one sensor of three readings, discs are discs, and one number fixes a coordinate."""
    robot = load_robot(repro.example() / "robot.toml")
    assert robot.part_names == ("B1", "B2", "B3", "B4")
    assert robot.names[:4] == ("B1x", "B1y", "B1z", "B2x")
    assert robot.parts.tolist() == [0] * 3 + [1] * 3 + [2] * 3 + [3] * 3
    assert set(robot.range) == {50.0}
    assert set(robot.resolution) == {0.005}
    assert set(robot.noise) == {0.005}
    assert robot.magnets[0].shape == repro.Disc(12e-3, 6e-3, 1300.0)
    assert robot.magnets[0].tolerance == pytest.approx(
        {"at": 5e-4, "polarisation": 0.05, "tilt": np.radians(2)}
    )
    assert robot.fixed.tolist() == [False, False, True] * 2
    assert robot.lower[:3].tolist() == [-0.012, -0.012, 0.0]


def test_a_joint_over_one_chip(tmp_path):
    """A hinge, a link and a cube: the readings are those of the same robot written in Python."""
    robot = read(tmp_path, JOINT)
    magnet = repro.Magnet(repro.Cube(4e-3, 1300.0), 2, 6e-3)
    chip = repro.Sensor(0, 0.0, position=[0.0, 0.0, -8e-3], axes=3)
    drawn = repro.Robot([repro.BallJoint("xy"), repro.Link(0.012)], [magnet], [chip])
    q = np.array([0.4, 0.0])
    np.testing.assert_allclose(robot.sensing()(q), repro.Sensing(drawn)(q), rtol=1e-13)
    assert robot.coordinates == ("rotation_x_1", "rotation_y_1")
    assert robot.magnets[0].tolerance == pytest.approx(
        {"at": 2e-3, "size": 1e-3, "polarisation": 0.2, "tilt": np.radians(10)}
    )
    np.testing.assert_allclose([robot.lower, robot.upper], [[-np.radians(40), 0], [np.radians(40), 0]])


def test_a_link_aside_and_a_base_that_is_turned(tmp_path):
    """What the file says of links is the same robot written in Python."""
    base = '[[segments]]\nkind = "link"\nlength_mm = 0.0\norientation = [0.0, 0.6, 0.0, 0.8]\n'
    base += "tolerance = { tilt_deg = 3.0 }\n"
    elbow = '[[segments]]\nkind = "link"\nlength_mm = 50.0\noffset_mm = [0.0, 20.0, -5.0]\n'
    elbow += "tolerance = { offset_mm = 2.0 }\n"
    robot = read(tmp_path, f'{base}[[segments]]\nkind = "ball_joint"\nrx_deg = [-40.0, 40.0]\n{elbow}')
    drawn = repro.Robot(
        [
            repro.Link(0.0, orientation=[0, 0.6, 0, 0.8]),
            repro.BallJoint("x"),
            repro.Link(0.05, offset=[0, 0.02, -5e-3]),
        ]
    )
    np.testing.assert_allclose(robot.tip([0.3]), drawn.tip([0.3]), rtol=0, atol=1e-15)
    assert [link.tolerance for link in robot.segments[::2]] == [
        {"tilt": pytest.approx(np.radians(3.0))},
        {"offset": pytest.approx(2e-3)},
    ]
    with pytest.raises(InputError, match="line 2, .*orientation of Link must be unit quaternions"):
        read(tmp_path, base.replace("0.8", "0.9").replace("[[segments]]", "\n[[segments]]"))
    with pytest.raises(InputError, match="offset_mm of robot.toml, line 4.*3 numbers"):
        read(tmp_path, elbow.replace("20.0, ", ""))


def test_a_free_body_has_no_bounds_of_its_turns(tmp_path):
    free = '[[segments]]\nkind = "free"\nx_mm = [-50, 50]\ny_mm = [-50, 50]\nz_mm = 20.0\n'
    free += "start = { x_mm = 10, rx_deg = 90 }"
    robot = read(tmp_path, free)
    np.testing.assert_allclose(robot.upper, [0.05, 0.05, 0.02, np.pi, np.pi, np.pi])
    np.testing.assert_allclose(robot.start, [0.01, 0.0, 0.02, np.pi / 2, 0.0, 0.0])
    assert robot.fixed.tolist() == [False, False, True, False, False, False]


def test_units_of_readings_become_mt(tmp_path):
    """Counts, microtesla and gains: noise and offset of the file are in its unit, ours in mT."""
    raw = ONE.replace('unit = "mT"\nnoise_mt = 7.1e-4', 'unit = "raw"\nnoise_raw = 2.0')
    raw = raw.replace("radial_mm = 13.0", "radial_mm = 13.0\ngain_raw_per_mt = -100.0\noffset_raw = 50")
    robot = read(tmp_path, raw)
    assert robot.noise.tolist() == [0.02] * 3
    assert [sensor.offset for sensor in robot.sensors] == [-0.5] * 3
    chip = """[[segments]]\nkind = "link"\nlength_mm = 10.0\n[[sensors]]\naxes = 3\nsegment = 1\nat_mm = 0.0
gain_raw_per_mt = [1331.0, -1331.0, 826.0]\noffset_raw = [0, 0, 1331]\nnoise_raw = 2.662\n"""
    earth = 'earth_mt = [0.02, 0.03, -0.04]\n[stream]\nunit = "raw"\nnoise_raw = 1.0\n'
    robot = read(tmp_path, earth + chip)
    counts = robot.sensors[0].per_mt * robot.sensing()([])
    np.testing.assert_allclose(counts, [1331 * 0.02, -1331 * 0.03, 826 * -0.04 + 1331])
    np.testing.assert_allclose(robot.noise, 0.002)
    micro = ONE.replace('unit = "mT"\nnoise_mt = 7.1e-4', 'unit = "uT"\nnoise_ut = 0.71')
    assert read(tmp_path, micro).noise == pytest.approx([7.1e-4] * 3)
    own = ONE.replace(SENSOR, SENSOR + "\nnoise_mt = 0.1\ngain = 2.0", 1)
    robot = read(tmp_path, own)
    assert robot.noise.tolist() == [0.1, 7.1e-4, 7.1e-4]
    q = [0.001, 0.0, 0.0]
    np.testing.assert_allclose(
        robot.sensing()(q), load_robot(ROBOTS / "one_segment.toml").sensing()(q) * [2, 1, 1]
    )


def test_imus_in_a_world_of_their_own(tmp_path):
    text = (ROBOTS / "imu_arm.toml").read_text(encoding="utf-8")
    text = f"base_orientation = [0.0, 0.0, 1.0, 0.0]\n{text}".replace(
        "stream = 1\n", "stream = 1\ntolerance = { heading_deg = 180.0 }\n"
    )
    robot = read(tmp_path, text)
    assert robot.imus[0].world == [0.0, 0.0, 1.0, 0.0]
    assert robot.imus[1].tolerance == pytest.approx({"heading": np.pi})
    assert robot.noise == pytest.approx(np.radians(0.2))


REFUSED = {
    "metres": (
        ("length_mm = 110.0", "length_mm = 0.11"),
        "length_mm line 12, [[segments]] 1, must be between 1 and 5000 [mm]; instead received 0.11 (in metres?).",
    ),
    "tesla": (
        ("1450.0 #", "1.45 #"),
        "must be of a magnitude between 10 and 2000 [mT]; instead received 1.45 (in tesla?).",
    ),
    "gauss": (("1450.0 #", "14500 #"), "instead received 14500 (in gauss?)."),
    "swapped bounds": (
        ("[-20.73, 20.73]", "[20.73, -20.73]"),
        "delta_x_mm line 14, [[segments]] 1, must be [lowest, highest], at least 0.05 apart",
    ),
    "bounds in metres": (("[-20.73, 20.73]", "[-0.02, 0.02]"), "instead received [-0.02, 0.02] (in metres?)"),
    "a key of another unit": (
        ("length_mm", "length_m"),
        "length_m line 12, [[segments]] 1, must be length_mm;",
    ),
    "a misspelt key": (("at_mm = 55.0", "att_mm = 55.0"), "att_mm line 21, [[magnets]] 1, must be at_mm;"),
    "a misspelt kind": (
        ("constant_curvature", "constant_curvatur"),
        "kind line 11, [[segments]] 1, must be constant_curvature; instead received 'constant_curvatur'.",
    ),
    "a missing key": (
        ("radius_mm = 22.0\n", ""),
        "radius_mm line 10, [[segments]] 1, must be given: between 0.5 and 500 [mm]; instead received nothing.",
    ),
    "no place": (
        ("at_mm = 55.0\n", ""),
        "at_mm line 18, [[magnets]] 1, must be given on segment 1; instead received nothing.",
    ),
    "beyond the end": (
        ("at_mm = 55.0", "at_mm = 120.0"),
        "robot.toml, line 21, [[magnets]] 1: Input segment, at_mm of Robot must be between 0 and 110 mm along segm",
    ),
    "no such segment": (
        ("segment = 1\nat_mm = 55", "segment = 2\nat_mm = 55"),
        "[[magnets]] 1: Input segment, at_mm of Robot must be on a segment from 0 (base) to 1; instead received 2",
    ),
    "not TOML": (
        ("length_mm = 110.0", "length_mm = 110,0"),
        "must be valid TOML in UTF-8; instead received Expected newline",
    ),
    "microtesla as mT": (("[stream]", "earth_mt = [18.0, 1.0, 45.0]\n[stream]"), "together at most 1 [mT]"),
    "another unit": (('unit = "mT"', 'unit = "uT"'), "noise_mt line 8, [stream], must be noise_ut;"),
    "one channel twice": (
        ("channel = 2", "channel = 1"),
        "channel line 35, [[sensors]] 2, must be another than in robot.toml, line 28, [[sensors]] 1;",
    ),
    "axes of one sensor": (
        (SENSOR, SENSOR + "\norientation = [0, 0, 0, 1]"),
        "line 27, [[sensors]] 1: Input orientation of Sensor must be for three axes; direction is for one; instead",
    ),
    "two directions": (
        (SENSOR, SENSOR + "\ndirection = [1, 0, 0]\ntilt_deg = 30"),
        "tilt_deg line 34, [[sensors]] 1, must be left out beside direction (line 33); instead received 30.",
    ),
    "a tolerance of nothing": (
        ("height_mm = 6.0", "height_mm = 6.0\ntolerance = { tlt_deg = 1.0 }"),
        "tlt_deg line 25, [[magnets]] 1, must be tilt_deg;",
    ),
    "diameters": (
        ("inner_diameter_mm = 12.0", "inner_diameter_mm = 30.0"),
        "inner_diameter_mm line 23, [[magnets]] 1, must be below outer_diameter_mm; instead received 30.",
    ),
    "a start outside": (
        ("delta_L_mm = [0.0, 6.6]", "delta_L_mm = [0.0, 6.6]\nstart = { delta_L_mm = 9.0 }"),
        "delta_L_mm line 17, [[segments]] 1, must be within its bounds; instead received 9.0.",
    ),
    "no segment": (
        (ONE, "[stream]"),
        "segments line 1, must be given: at least one table [[segments]]; instead received nothing.",
    ),
    "a table for tables": (
        (ONE, "segments = 3"),
        "segments line 1, must be tables [[segments]]; instead received 3.",
    ),
}


@pytest.mark.parametrize(("change", "message"), REFUSED.values(), ids=REFUSED)
def test_mistakes_are_named_with_line_and_key(tmp_path, change, message):
    old, new = change
    assert old in ONE
    with pytest.raises(InputError) as refused:
        read(tmp_path, ONE.replace(old, new, 1))
    assert message in str(refused.value).replace(" of robot.toml,", "")


DOUBTED = {
    "radians": (
        ("azimuth_deg = 120.0", "azimuth_deg = 2.0944"),
        "line 39, [[sensors]] 2: azimuth_deg = 2.0944 looks like radians.",
    ),
    "gauss": (
        ("[stream]", "earth_mt = [0.18, 0.01, 0.45]\n[stream]"),
        "line 4: earth_mt = [0.18, 0.01, 0.45] has a length of 0.48 mT, which is doubtful.",
    ),
    "noise in tesla": (
        ("7.1e-4", "7.1e-7"),
        "line 8, [stream]: noise_mt = 7.1e-07 is a noise of 7.1e-07 mT, which is doubtful.",
    ),
    "noise in microtesla": (
        ("7.1e-4", "0.71"),
        "line 8, [stream]: noise_mt = 0.71 is a noise of 0.71 mT, which is doubtful.",
    ),
    "w first": (
        ("[stream]", "base_orientation = [1, 0, 0, 0]\n[stream]"),
        "line 4: base_orientation = [1, 0, 0, 0] looks as if w came first.",
    ),
}


@pytest.mark.parametrize(("change", "message"), DOUBTED.values(), ids=DOUBTED)
def test_what_is_only_doubtful_is_a_warning_with_its_line(tmp_path, change, message):
    with pytest.warns(UserWarning, match=re.escape(f"robot.toml, {message}")):
        read(tmp_path, ONE.replace(*change, 1))


@pytest.mark.parametrize("degrees", ["3.0", "5.5", "0.0", "360.0"])
def test_small_round_angles_are_believed(tmp_path, degrees):
    read(tmp_path, ONE.replace("azimuth_deg = 120.0", f"azimuth_deg = {degrees}", 1))


def test_files_that_are_not_there_or_no_text(tmp_path):
    with pytest.raises(
        InputError, match="path of load_robot must be a robot file that exists; instead received nope.toml"
    ):
        load_robot("nope.toml")
    with pytest.raises(InputError, match="must be a robot file that exists; instead received 3"):
        load_robot(3)
    (tmp_path / "robot.toml").write_text(ONE, encoding="utf-16")
    with pytest.raises(InputError, match="file of robot.toml must be valid TOML in UTF-8"):
        load_robot(tmp_path / "robot.toml")
    (tmp_path / "robot.toml").write_bytes(b"\xef\xbb\xbf" + ONE.replace("\n", "\r\n").encode())
    assert load_robot(tmp_path / "robot.toml").n_q == 3


@pytest.mark.parametrize("text", ["\\u001b]0;owned\\u0007", "two\\nlines", ""])
def test_a_name_is_one_that_a_terminal_can_show(tmp_path, text):
    """Else a file of somebody else's could write anything there."""
    named = f'[[sensors]]\nname = "{text}"\n'
    with pytest.raises(
        InputError, match=r"\[\[sensors\]\] 1, must be a name in one line that can be printed"
    ):
        read(tmp_path, ONE.replace("[[sensors]]\n", named, 1))


@pytest.mark.parametrize("q", ["[0, 0, 0, 0]", "[0.0, 0.0, 0.0, 2.0]", "[0, 0, 1]"])
def test_an_orientation_of_the_base_is_one_also_without_imus(tmp_path, q):
    with pytest.raises(InputError, match="base_orientation of robot.toml, line 1, must be 4 numbers, a unit"):
        read(tmp_path, f"base_orientation = {q}\n{ONE}")


class TestNetworks:
    """Networks named by a file: numbers in safetensors, in its folder; nothing else is read."""

    def test_a_robot_with_a_trained_network(self, tmp_path):
        shutil.copy(NETWORK, tmp_path / "net.safetensors")
        robot = read(tmp_path, f'{ONE}\n[model]\nnetworks = ["net.safetensors"]\n')
        expected = repro.Sensing(load_robot(ROBOTS / "one_segment.toml"), load_network(NETWORK))
        q = [0.005, 0.001, 0.002]
        np.testing.assert_array_equal(robot.sensing()(q), expected(q))

    @pytest.mark.parametrize(
        ("name", "message"),
        [
            (
                "net.pt",
                "must be a list of safetensors files (TorchScript is a program, which a file cannot start; load",
            ),
            (
                "../net.safetensors",
                "must be files in the folder of the robot file; instead received ../net.saf",
            ),
            (
                "none.safetensors",
                "robot.toml, line 48, [model]: Input path of load_network must be a file; instead received",
            ),
        ],
    )
    def test_other_files_are_refused_unread(self, tmp_path, name, message):
        folder = tmp_path / "robot"
        folder.mkdir()
        for path in (folder / "net.pt", tmp_path / "net.safetensors"):
            path.write_bytes(b"not to be read")
        with pytest.raises(InputError, match=re.escape(message)):
            read(folder, f'{ONE}[model]\nnetworks = ["{name}"]\n')


class TestCalibrationFile:
    """What a calibration found: back as it was written; changed, foreign and impossible ones are refused."""

    @pytest.fixture(scope="class")
    @classmethod
    def written(cls, tmp_path_factory):
        robot = load_robot(ROBOTS / "one_segment.toml")
        q = robot.lower + (robot.upper - robot.lower) * np.random.default_rng(1).random((15, 3))
        found = calibrate(robot, q, 1.01 * simulated_readings(robot, q), robot.noise)
        path = tmp_path_factory.mktemp("calibration") / "calibration.json"
        found.save(path)
        return path, found

    def test_it_comes_back_as_it_was(self, written):
        path, found = written
        back = load_calibration(path, load_robot(ROBOTS / "one_segment.toml"))
        np.testing.assert_allclose(back.deviation, found.deviation, rtol=1e-12)
        robot = load_robot(ROBOTS / "one_segment.toml", path)
        q = [0.01, -0.003, 0.001]
        np.testing.assert_array_equal(robot.sensing()(q), found.sensing()(q))

    def test_another_robot_or_content_is_refused(self, written, tmp_path):
        path, _ = written
        with pytest.raises(
            InputError,
            match="must be made with two_segments.toml as it is now; instead received one made with 'one_",
        ):
            load_robot(ROBOTS / "two_segments.toml", path)
        changed = tmp_path / "changed.json"
        changed.write_text(path.read_text().replace('"chi2": ', '"chi2": 1'), encoding="utf-8")
        with pytest.raises(
            InputError, match="sha256 of changed.json must be the hash of a file as it was written"
        ):
            load_robot(ROBOTS / "one_segment.toml", changed)
        with pytest.raises(InputError, match="calibration of load_calibration must be a file that exists"):
            load_robot(ROBOTS / "one_segment.toml", tmp_path / "none.json")
        changed.write_text("[", encoding="utf-8")
        with pytest.raises(InputError, match="file of changed.json must be JSON"):
            load_robot(ROBOTS / "one_segment.toml", changed)
        with pytest.raises(InputError, match="must be of a robot that load_robot has read"):
            replace(written[1], described=written[1].described.replaced(source=None)).save(changed)

    @pytest.mark.parametrize(
        ("changes", "message"),
        [
            ({"estimate": np.full(22, -2.0)}, "estimate of changed.json must be within 10 of its tolerances"),
            ({"estimate": np.zeros(3)}, "estimate of changed.json must be numbers of shape (22)"),
            (
                {"tolerances": ["none"] * 22},
                "tolerances of changed.json must be numbers; instead received list",
            ),
            ({"covariance": np.diag([np.inf] + [1.0] * 21)}, "covariance of changed.json must be finite"),
            (
                {"covariance": np.diag([1e308] + [1.0] * 21)},
                "covariance of changed.json must be that of random",
            ),
            (
                {"covariance": np.diag([-1.0] + [1.0] * 21)},
                "covariance of changed.json must be that of random",
            ),
            ({"covariance": 1.001 * np.eye(22)}, "covariance of changed.json must be that of random"),
            (
                {"covariance": np.eye(22) + np.eye(22, k=1) / 9},
                "covariance of changed.json must be that of random",
            ),
            ({"model_error": -np.eye(3)}, "model_error of changed.json must be a covariance of readings"),
            ({"model_error": np.eye(3, k=1)}, "model_error of changed.json must be a covariance of readings"),
            ({"covariance": 1 - 2 * np.eye(22)}, "covariance of changed.json must be that of random"),
            (
                {"schema": 2},
                "sha256 of changed.json must be the hash of a file as it was written, of schema 3",
            ),
        ],
    )
    def test_values_that_cannot_be(self, written, tmp_path, changes, message):
        """Even with the hash of what they hold."""
        content = json.loads(written[0].read_text(encoding="utf-8"))
        assert len(content["names"]) == 22
        content |= {name: np.asarray(value).tolist() for name, value in changes.items()}
        content["sha256"] = _own_hash(content)
        path = tmp_path / "changed.json"
        path.write_text(json.dumps(content), encoding="utf-8")
        with pytest.raises(InputError, match=re.escape(message)):
            load_robot(ROBOTS / "one_segment.toml", path)


def test_bounds_that_are_left_out_are_ninety_degrees_and_a_tenth_of_the_length(tmp_path):
    """Of an affine segment kappa_1 may be twice as much; angles come round."""
    arc = '[[segments]]\nkind = "constant_curvature"\nlength_mm = 100.0\nradius_mm = 20.0\n'
    affine = '[[segments]]\nkind = "affine_curvature"\nlength_mm = 200.0\n'
    robot = read(tmp_path, f'{arc}{affine}[[segments]]\nkind = "ball_joint"\n')
    q = np.pi / 2
    high = [0.02 * q, 0.02 * q, 0.01, q, 2 * q, np.pi, 0.02, np.pi, np.pi, np.pi]
    np.testing.assert_allclose([robot.lower, robot.upper], [np.negative(high), high])
    for shortest in (-99.9, -100.0):
        with (
            pytest.raises(InputError, match="above -100 .mm., which leaves")
            if shortest < -99.95
            else nullcontext()
        ):
            read(tmp_path, f"{arc}delta_L_mm = [{shortest}, 10.0]\n")


@pytest.mark.parametrize(("high", "start", "good"), [(180, 200, True), (170, 200, False), (170, 170, True)])
def test_a_start_is_within_its_bounds_unless_the_angle_comes_round(tmp_path, high, start, good):
    joint = f'[[segments]]\nkind = "ball_joint"\nrx_deg = [-180, {high}]\nstart = {{ rx_deg = {start} }}\n'
    with nullcontext() if good else pytest.raises(InputError, match="rx_deg .*must be within its bounds"):
        assert read(tmp_path, joint).start == pytest.approx(np.radians([start]))


def test_what_newcomers_mistake_is_answered_where_it_stands(tmp_path):
    text = (repro.example() / "robot.toml").read_text()
    for old, new, message in (
        ('unit = "mT"', 'unit = "microtesla"', "unit of robot.toml, line 7, [stream], must be one of 'mT'"),
        ("[[sensors]] ", "[[sensor]] ", "sensor of robot.toml, line "),
        ("axes = 3\n", "", "must be 1 columns, one for every axis"),
        ("range_mt = 50.0", "range_mt = 0.008", "0.008 (in tesla?)"),
        ("at_mm = 70.0", "at_mm = 95.0", "between 0 and 90 mm along segment 1; instead received 95 mm"),
        (
            "delta_L_mm = 0.0",
            "delta_L_mm = [-95.0, 5.0]",
            "above -90 [mm], which leaves no length; instead received [-95",
        ),
        ('name = "B2"', 'name = "B1"', "must be another than in robot.toml, line "),
    ):
        assert old in text
        (tmp_path / "robot.toml").write_text(text.replace(old, new, 1))
        with pytest.raises(InputError, match=re.escape(message)) as caught:
            load_robot(tmp_path / "robot.toml")
        assert "line 1," not in str(caught.value)


def test_metres_and_tesla_in_keys_of_chips_are_doubted(tmp_path):
    text = (repro.example() / "robot.toml").read_text()
    for old, new, message in (
        ("at_mm = 0.5,", "at_mm = 0.0005,", "at_mm = 0.0005 looks like metres"),
        ("[stream]", "earth_mt = [2e-5, 0.0, -4.5e-5]\n[stream]", "which is doubtful"),
        ("radial_mm = 12.0\nazimuth_deg = 0.0", "position_mm = [0.012, 0.0, 0.0]", "looks like metres"),
    ):
        with pytest.warns(UserWarning, match=message):
            read(tmp_path, text.replace(old, new, 1))
