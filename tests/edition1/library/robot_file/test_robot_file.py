"""Robots in files: equal to the builders, an estimate from end to end, and what is said of a wrong file."""

import math
import re
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from edition1.errors import InputError
from edition1.estimation.base import track
from edition1.estimation.levenberg_marquardt import LevenbergMarquardt
from edition1.kernels import compiled
from edition1.kinematics.mounts import magnet_mounts
from edition1.kinematics.paper_robots import affine_robot, pcc_robot
from edition1.kinematics.robot import Robot
from edition1.robot_file._magnet_moments import cube_moments, moments_of
from edition1.robot_file._tables import MAGNET_KINDS, SEGMENT_KINDS
from edition1.robot_file._toml_lines import key_lines
from edition1.robot_file.load import load_robot
from edition1.sensing._multipoles import multipole_factors
from edition1.sensing.linearised import LinearisedSensing
from edition1.sensing.magnetic import readings
from edition1.sensing.magnets import B444B, Cube, ring
from edition1.sensing.weights import read_manifest
from edition1_companion.twins.bend_curves import bend_curve, bend_readings
from edition1_companion.twins.takes import open_take
from edition1_companion.twins.trajectories import lemniscate
from edition1_live.wire.formats import FORMATS

ROBOTS = Path(__file__).parents[4] / "data" / "robots"
NETWORKS = ROBOTS.parent / "networks"
ONE = (ROBOTS / "one_segment.toml").read_text()

AFFINE = """
earth_mt = [0.02, 0.0, -0.04]
[stream]
format = "frames"
rate_hz = 40
unit = "mT"
noise_mt = 0.001
[[segments]]
kind = "affine_curvature"
length_mm = 200
kappa_0_rad = [0, 0.942]
kappa_1_rad = [-3.77, 3.77]
phi_deg = [-180, 180]
delta_L_mm = [0, 6.6]
""" + "".join(
    f"""[[magnets]]
kind = "ring"
segment = 1
at_mm = {at}
outer_diameter_mm = 24
inner_diameter_mm = 12
height_mm = 6
polarisation_mt = 1450
"""
    for at in (50, 150)
)
AFFINE += "".join(
    f"[[sensors]]\nchannel = {k + 1}\nsegment = 1\nat_mm = {k % 3 * 100}\nradial_mm = 13\nazimuth_deg = {40 * k}\n"
    for k in range(9)
)


def written(tmp_path, text, name="arm.toml"):
    path = tmp_path / name
    path.write_text(text)
    return path


def line_of(text, wanted, nth=0):
    """Where a line stands, by plain counting: not by what is tested."""
    return [k for k, line in enumerate(text.split("\n"), start=1) if line.strip().startswith(wanted)][nth]


def assert_same_robot(found, robot):
    assert found.segments == robot.segments
    for name in ("magnets", "sensors"):
        ours, theirs = getattr(found, name), getattr(robot, name)
        assert ours.segment == theirs.segment
        torch.testing.assert_close(ours.axial, theirs.axial, rtol=0, atol=1e-15)
        torch.testing.assert_close(ours.local, theirs.local, rtol=0, atol=1e-15)


@pytest.mark.parametrize(("name", "n"), [("one_segment", 1), ("three_segments", 3)])
def test_shipped_robots_are_those_of_the_paper(name, n):
    found = load_robot(ROBOTS / f"{name}.toml")
    assert_same_robot(found.robot, pcc_robot(n))
    assert found.magnet == ring("released")
    bend, stretch = 22e-3 * math.radians(54), 6.6e-3
    box = torch.tensor([[-bend, -bend, 0] * n, [bend, bend, stretch] * n], dtype=torch.float64)
    torch.testing.assert_close(torch.stack([found.lower, found.upper]), box, rtol=0, atol=5e-6)
    assert found.start.tolist() == [0.0, 0.0, 0.0033] * n
    assert found.channel == tuple(range(3 * n))
    assert (found.channels, found.unit, found.notes) == (3 * n, "mT", ())


def test_an_affine_robot_is_that_of_the_paper(tmp_path):
    found = load_robot(written(tmp_path, AFFINE))
    assert_same_robot(found.robot, affine_robot(magnet_shift_m=0.0))
    assert found.start.tolist() == [0.0, 0.0, 0.0, 0.0033]
    assert found.upper[2] == math.pi
    assert found.sensing().earth_mt.tolist() == [0.02, 0.0, -0.04]


def test_the_arm_has_its_imus_where_table_1_has_them():
    found = load_robot(ROBOTS / "imu_arm.toml")
    assert np.allclose([imu.arc_m for imu in found.imus], np.cumsum((0.08,) * 8), rtol=0, atol=1e-15)
    assert [imu.stream for imu in found.imus] == list(range(8))
    assert {reading.stream for reading in open_take("arm").readings()} == set(range(8))
    with pytest.raises(
        InputError, match=r"imu_arm\.toml must be a robot with magnets and magnetic sensors; .*8 IMUs"
    ):
        found.sensing()


def test_the_bend_sensor_reads_what_its_board_sends():
    """Cube by its moments against magpylib, in the order, signs and counts of the recordings; 90 degrees at most."""
    found = load_robot(ROBOTS / "bend_sensor.toml")
    bend = bend_curve("flower")
    q = torch.cat([bend * 10e-3, torch.zeros(len(bend), 1).double()], dim=-1)
    counts = bend_readings(bend)[:, [1, 0, 2]] * torch.tensor([-1.0, 1.0, -1.0]) / 0.01
    assert float((found.values(q) - counts).abs().max()) < 2.0
    assert open_take("flower").format == found.format


def test_readings_are_those_of_magpylib():
    found, q = load_robot(ROBOTS / "three_segments.toml"), lemniscate(3, steps=40)
    torch.testing.assert_close(
        found.values(q), readings(pcc_robot(3), q, ring("released")), rtol=0, atol=5e-6
    )


@pytest.mark.parametrize("made", [lambda sensing: sensing, compiled], ids=["torch", "compiled"])
def test_estimates_from_values_of_frames(tmp_path, made):
    """Gains, offsets and an order of channels of their own; one channel is not used."""
    text = ONE.replace('unit = "mT"', 'unit = "mV"').replace(
        "noise_mt = 7.1e-4", "noise_mv = 0.5\nchannels = 4"
    )
    for channel, line in ((3, "offset_mv = 1300"), (1, "offset_mv = -40.5"), (4, "")):
        k = {3: 1, 1: 2, 4: 3}[channel]
        text = text.replace(
            f"channel = {k}\nsegment", f"gain_mv_per_mt = {-50 * k}\n{line}\nchannel = X{channel}\nsegment"
        )
    found = load_robot(written(tmp_path, text.replace("X", "")))
    assert found.channel == (2, 0, 3)
    assert found.gain.tolist() == [-50.0, -100.0, -150.0]
    q = lemniscate(1, steps=6)
    frames = found.values(q)
    assert bool((frames[:, 1] == 0).all())
    plain = readings(pcc_robot(1), q, ring("released"))
    torch.testing.assert_close(frames[:, 2], 1300 - 50 * plain[:, 0], rtol=0, atol=1e-3)
    u = torch.stack([found.signal(tuple(row.tolist())) for row in frames])
    method = LevenbergMarquardt(made(found.sensing()), found.lower, found.upper, noise_mt=found.noise)
    torch.testing.assert_close(track(method, u, found.start).q, q, rtol=0, atol=1e-9)


def test_a_network_and_a_model_of_ones_own(tmp_path):
    name = next(path for path in sorted(NETWORKS.glob("pcc_nb1_*.safetensors")))
    assert read_manifest(name)["recipe"] == "paper"
    for suffix in (".safetensors", ".json"):
        (tmp_path / f"net{suffix}").write_bytes(name.with_suffix(suffix).read_bytes())
    found = load_robot(written(tmp_path, ONE + '\n[model]\nnetworks = ["net.safetensors"]\n'))
    q = lemniscate(1, steps=20)
    exact = load_robot(ROBOTS / "one_segment.toml")
    error = (found.sensing()(q) - exact.sensing()(q)).square().mean().sqrt()
    assert float(error.detach()) < 0.05  # the network's own error is some hundredths of a millitesla
    compiled(found.sensing())  # is known to the kernel
    with pytest.raises(InputError, match=r"line \d+, \[model\], must be files beside this"):
        load_robot(written(tmp_path, ONE + '\n[model]\nnetworks = ["other.safetensors"]\n'))
    with pytest.raises(InputError, match="must be files: one for all sensors, one per segment, or one"):
        load_robot(written(tmp_path, ONE + '\n[model]\nnetworks = ["a", "b"]\n'))

    def dipole(cosines):
        d, alpha, beta, theta = cosines[..., 1:].unbind(-1)
        return exact.moments[0] * (3 * theta * beta - alpha) / d**3

    mine = exact.sensing(dipole)(q)
    assert float((mine - exact.sensing()(q)).abs().max()) < 0.25
    torch.testing.assert_close(mine.mean(0), exact.sensing()(q).mean(0), rtol=0.1, atol=0)


@pytest.mark.parametrize(
    ("distance_mm", "largest_mt"), [(10.0, 0.58), (13.0, 0.091), (15.0, 0.0333), (30.0, 3e-4)]
)
def test_what_the_moments_of_a_cube_leave_out(distance_mm, largest_mt):
    p = np.random.default_rng(0).normal(size=(2000, 3))
    p *= distance_mm * 1e-3 / np.linalg.norm(p, axis=1, keepdims=True)
    d = torch.full((len(p),), distance_mm * 1e-3, dtype=torch.float64)
    f, g = (
        x.numpy()[:, None] for x in multipole_factors(moments_of(B444B), d, torch.from_numpy(p[:, 2]) / d)
    )
    error = np.abs(f * [0, 0, 1] + g * p / (distance_mm * 1e-3) - B444B.field(p)).max()
    assert 0.8 * largest_mt < error < largest_mt


def test_on_the_axis_the_moments_of_a_cube_are_exact():
    z = torch.tensor([0.01, 0.015, 0.03], dtype=torch.float64)
    f, g = multipole_factors(torch.from_numpy(cube_moments(B444B, 21)), z, torch.ones(3).double())
    expected = B444B.field(np.column_stack([0 * z, 0 * z, z.numpy()]))[:, 2]
    np.testing.assert_allclose((f + g).numpy(), expected, rtol=1e-6)
    assert abs(cube_moments(Cube(1e-3, 1.0), 3)[1]) < 1e-25


def replaced(old, new, nth=0):
    """Text of one_segment.toml with the nth line that starts so replaced, and the number of that line."""
    lines = ONE.split("\n")
    k = line_of(ONE, old, nth)
    lines[k - 1] = new
    return "\n".join(lines), k


# line that is changed, what it becomes, table, what the key must be, what is received
WRONG = [
    ('length_mm', 'length_m = 0.11', '[[segments]] 1',
     'length_mm', 'a key that does not exist'),
    ('radius_mm', 'raduis_mm = 22.0', '[[segments]] 1',
     'radius_mm', 'a key that does not exist'),
    ('length_mm', 'length_mm = 0.11', '[[segments]] 1',
     'between 1 and 5000 [mm]', '0.11'),
    ('length_mm', "length_mm = '110'", '[[segments]] 1',
     'between 1 and 5000 [mm]', "'110'"),
    ('at_mm = 55', 'at_mm = 0.055', '[[magnets]] 1',
     '0, or between 0.1 and 5000 [mm]', '0.055'),
    ('radial_mm', 'radial_mm = 0.013', '[[sensors]] 1',
     '0, or between 0.1 and 500 [mm]', '0.013'),
    ('polarisation_mt', 'polarisation_mt = 1.45', '[[magnets]] 1',
     'of a magnitude between 10 and 2000 [mT]', '1.45'),
    ('delta_x_mm', 'delta_x_mm = [-0.02073, 0.02073]', '[[segments]] 1',
     '[lowest, highest], at least 0.05 apart and within 2000 of zero [mm]', '[-0.02073, 0.02073]'),
    ('kind = "ring"', "kind = 'disc'", '[[magnets]] 1',
     "one of 'ring', 'cube'", "'disc'"),
    ('inner_diameter', 'inner_diameter_mm = 24', '[[magnets]] 1',
     'below outer_diameter_mm, 24.0', '24'),
    ('unit', "unit = 'T'", '[stream]',
     "one of 'mT', 'mV', 'raw'", "'T'"),
    ('format', "format = 'binary'", '[stream]',
     "one of 'frames', 'hall', 'millivolts', 'quaternions', 'csv'", "'binary'"),
    ('noise_mt', 'noise_mv = 0.5', '[stream]',
     'noise_mt', 'a key that does not exist'),
    ('delta_L_mm', 'delta_L_mm = [-110, 6.6]', '[[segments]] 1',
     'above -110: a segment is longer than 0 (line 12) [mm]', '[-110, 6.6]'),
    ('channel = 2', 'channel = 100000000000000000000', '[[sensors]] 2',
     'a whole number from 1 to 255', '100000000000000000000'),
    ('channel = 2', 'channel = 119', '[[sensors]] 2',
     'at most 118 (line 5)', '119'),
    ('rate_hz', 'channels = 200\nrate_hz = 9', '[stream]',
     'at most 118, the values of a frame of this format', '200'),
    ('format', 'format = "quaternions"', '[stream]',
     'of magnetic sensors: quaternions are of IMUs', "'quaternions'"),
    ('segment = 1', 'segment = ' + 400 * '9', '[[magnets]] 1',
     'a whole number from 1 to 10000', 197 * '9' + '...'),
    ('length_mm', 'length_mm = ' + 400 * '9', '[[segments]] 1',
     'between 1 and 5000 [mm]', 197 * '9' + '...'),
    ('noise_mt', 'noise_mt = nan', '[stream]',
     'between 1e-09 and 1e+06 [mt]', 'nan'),
    ('[stream]', 'earth_mt = [0.0, 0.0, 48.0]\n[stream]', '',
     'three numbers along x, y, z of the base, together at most 1 [mT]', '[0.0, 0.0, 48.0]'),
    ('[stream]', '[streams]', '',
     'stream', 'a key that does not exist'),
]  # fmt: skip


@pytest.mark.parametrize(("old", "new", "table", "must_be", "received"), WRONG)
def test_wrong_keys_and_units_are_named_with_their_line(tmp_path, old, new, table, must_be, received):
    text, line = replaced(old, new)
    key = re.match(r"\W*(\w+)", new)[1]
    with pytest.raises(InputError) as error:
        load_robot(written(tmp_path, text))
    where = f"line {line}, {table}," if table else f"line {line},"
    assert (
        str(error.value)
        == f"Input {key} of arm.toml, {where} must be {must_be}; instead received {received}."
    )


def test_a_missing_key_is_named_with_the_line_of_its_table(tmp_path):
    text, _ = replaced("radius_mm", "# none")
    with pytest.raises(InputError) as error:
        load_robot(written(tmp_path, text))
    assert str(error.value) == (
        f"Input radius_mm of arm.toml, line {line_of(text, '[[segments]]')}, [[segments]] 1, must be given: "
        "between 0.5 and 500 [mm]; instead received nothing."
    )


def test_parts_outside_their_segment(tmp_path):
    text, line = replaced("at_mm = 110", "at_mm = 116.0", nth=1)
    with pytest.raises(InputError) as error:
        load_robot(written(tmp_path, text))
    assert str(error.value) == (
        f"Input at_mm of arm.toml, line {line}, [[sensors]] 2, must be at most 110, the length of segment 1 "
        f"(line {line_of(text, 'length_mm')}) [mm]; instead received 116.0."
    )
    text, line = replaced("segment = 1", "segment = 2", nth=3)
    with pytest.raises(
        InputError, match=rf"segment of arm.toml, line {line}, \[\[sensors\]\] 3, must be between 1 and 1"
    ):
        load_robot(written(tmp_path, text))


def test_two_sensors_on_one_channel(tmp_path):
    text, line = replaced("channel = 3", "channel = 1")
    with pytest.raises(InputError) as error:
        load_robot(written(tmp_path, text))
    first = line_of(text, "channel = 1")
    assert str(error.value) == (
        f"Input channel of arm.toml, line {line}, [[sensors]] 3, must be another channel than that of sensor 1 "
        f"(line {first}); instead received 1."
    )
    text, _ = replaced("noise_mt", "noise_mt = 7e-4\nchannels = 2")
    with pytest.raises(
        InputError, match=rf"must be at most 2 \(line {line_of(text, 'channels')}\); instead received 3"
    ):
        load_robot(written(tmp_path, text))


def test_a_sensor_without_a_magnet_is_warned_of_with_distances(tmp_path):
    text, _ = replaced("length_mm", "length_mm = 1500")
    text = text.replace("at_mm = 110.0", "at_mm = 1400.0", 1)
    found = load_robot(written(tmp_path, text))
    note, left_open = found.notes
    assert left_open.startswith(
        "arm.toml: at the start the readings do not determine, in units of the bounds: "
    )
    line = line_of(text, "[[sensors]]")
    assert note.startswith(
        f"arm.toml, line {line}: no magnet is in range of sensor 1 (magnet 1 at 1348 mm): "
    )
    signal = 2 * float(found.moments[0]) / 1.348**3
    assert note.endswith(f"the nearest gives it {signal:.2g} mT at most, with a noise of 0.00071.")


def test_a_sensor_inside_a_magnet_is_refused(tmp_path):
    text, line = replaced("at_mm = 110", "at_mm = 56.0")
    text = text.replace("radial_mm = 13.0", "radial_mm = 5.0", 1)
    with pytest.raises(
        InputError, match=rf"line {line}, \[\[sensors\]\] 1, must be farther than 12.4 mm from the centre"
    ):
        load_robot(written(tmp_path, text))


def test_a_segment_that_nothing_observes_is_refused(tmp_path):
    three = (ROBOTS / "three_segments.toml").read_text()
    text = three.replace("[[magnets]]", "[[magnets]] # moved").replace("segment = 1", "segment = 2")
    with pytest.raises(InputError) as error:
        load_robot(written(tmp_path, text))
    assert str(error.value) == (
        f"Input kind of arm.toml, line {line_of(text, 'kind')}, [[segments]] 1, must be of a segment between a "
        "magnet and a sensor, or below an IMU: nothing observes this one; instead received constant_curvature."
    )
    load_robot(written(tmp_path, text + "\n[[imus]]\nstream = 1\nsegment = 1\nat_mm = 50\n"))
    load_robot(written(tmp_path, "earth_mt = [0.0, 0.0, 0.05]\n" + text))


def test_unobserved_is_what_the_slopes_say():
    """Sensors at the tip of a segment see the magnet in the next one, which does not move with their own segment."""
    robot = pcc_robot(3)
    lone = Robot(robot.segments, magnet_mounts([1, 2], 0.055), robot.sensors)
    moments = torch.from_numpy(ring("released").multipoles(9))
    J = LinearisedSensing(lone, moments).linearise(lemniscate(3, steps=5))[1]
    assert float(J[..., :3].abs().max()) < 1e-12
    assert float(J[..., 3:].abs().amax((0, 1)).min()) > 1.0


def test_other_wrong_files(tmp_path):
    with pytest.raises(
        InputError, match=r"Input file of arm.toml must be valid TOML; .*\(at line 2, column 7\)"
    ):
        load_robot(written(tmp_path, "a = 1\nb = [ , ]\n"))
    with pytest.raises(InputError, match="must be a robot file; instead received"):
        load_robot(tmp_path / "none.toml")
    (tmp_path / "latin.toml").write_bytes(b"# \xe4\n")
    with pytest.raises(InputError, match="file of latin.toml must be text in UTF-8"):
        load_robot(tmp_path / "latin.toml")
    with pytest.raises(
        InputError, match=r"segments of arm.toml, line 1, must be given: at least one table \[\[segments"
    ):
        load_robot(written(tmp_path, '[stream]\nformat = "frames"\nrate_hz = 1.0\n'))
    with pytest.raises(
        InputError, match=r"Input sensors of arm.toml, line 1, must be tables \[\[sensors\]\]"
    ):
        load_robot(
            written(
                tmp_path,
                'sensors = 3\n[stream]\nformat = "frames"\n[[segments]]\nkind = "affine_curvature"\nlength_mm = 9\n',
            )
        )
    text = re.sub(r"(?s)\[\[magnets\]\].*?\n\n", "", ONE)
    with pytest.raises(InputError, match="nothing observes this one"):
        load_robot(written(tmp_path, text))
    with pytest.raises(InputError, match=r"line \d+, \[\[sensors\]\] 1, must be of a robot with \[\[magnets"):
        load_robot(written(tmp_path, "earth_mt = [0, 0, 0.05]\n" + text))
    arm = (ROBOTS / "imu_arm.toml").read_text()
    with pytest.raises(
        InputError, match=r"stream of arm.toml, line \d+, \[\[imus\]\] 4, must be another stream than that"
    ):
        load_robot(written(tmp_path, arm.replace("stream = 3", "stream = 0")))
    with pytest.raises(
        InputError, match=r"\[\[imus\]\] 3, must be farther from the base than the IMU before it"
    ):
        load_robot(written(tmp_path, arm.replace("segment = 3\nat", "segment = 1\nat")))


def test_a_frame_of_another_board(tmp_path):
    found = load_robot(ROBOTS / "one_segment.toml")
    with pytest.raises(InputError) as error:
        found.signal((1.0, 2.0))
    assert str(error.value) == (
        "Input frame of the stream must be of 3 channels, as described in one_segment.toml; instead received 2 "
        "values."
    )


def test_what_a_format_cannot_carry(tmp_path):
    """Lines of hall have three counts, those of millivolts are millivolts; both carry no IMUs."""
    hall = (ROBOTS / "bend_sensor.toml").read_text()
    text = hall.replace("channel = 2", "channel = 5")
    with pytest.raises(InputError) as error:
        load_robot(written(tmp_path, text))
    assert str(error.value) == (
        f"Input channel of arm.toml, line {line_of(text, 'channel = 5')}, [[sensors]] 2, must be at most 3 "
        f"(line {line_of(text, 'format')}); instead received 5."
    )
    with pytest.raises(
        InputError, match=r"channels of .* must be 3, the values of a frame of this format; .* 4"
    ):
        load_robot(written(tmp_path, hall.replace("rate_hz", "channels = 4\nrate_hz")))
    two = hall[: hall.rindex("[[sensors]]")]
    assert load_robot(written(tmp_path, two)).channels == 3
    text = ONE.replace('"frames"', '"millivolts"')
    with pytest.raises(InputError) as error:
        load_robot(written(tmp_path, text))
    assert str(error.value) == (
        f"Input unit of arm.toml, line {line_of(text, 'unit')}, [stream], must be 'mV', the unit of millivolts "
        f"(line {line_of(text, 'format')}); instead received 'mT'."
    )
    imu = "\n[[imus]]\nstream = 1\nsegment = 1\nat_mm = 50\n"
    with pytest.raises(
        InputError, match="format of .* must be 'frames' for magnetic sensors and IMUs together"
    ):
        load_robot(written(tmp_path, text + imu))
    arm = (ROBOTS / "imu_arm.toml").read_text().replace("quaternions", "hall")
    with pytest.raises(
        InputError, match="format of .* must be 'frames' or 'quaternions' for IMUs; .* 'hall'"
    ):
        load_robot(written(tmp_path, arm))


def test_a_byte_order_mark_is_read_and_deep_nesting_is_told(tmp_path):
    path = written(tmp_path, ONE)
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())
    assert load_robot(path).format == "frames"
    with pytest.raises(InputError) as error:
        load_robot(written(tmp_path, "a = " + 5000 * "["))
    assert str(error.value) == (
        "Input file of arm.toml must be valid TOML; instead received arrays or tables nested too deeply."
    )
    with pytest.raises(
        InputError, match="Input file of arm.toml must be valid TOML; instead received Exceeds"
    ):
        load_robot(written(tmp_path, "a = " + 5000 * "1"))


def test_fewer_readings_than_unknowns_are_told_with_what_stays_open(tmp_path):
    """Two sensors for three coordinates; and as many as coordinates, all of which say the same."""
    found = load_robot(written(tmp_path, ONE[: ONE.rindex("[[sensors]]")]))
    count, left_open = found.notes
    assert count.startswith("arm.toml: 2 readings for 3 unknowns. Those of one moment do not determine the")
    found_open = re.fullmatch(
        r"arm.toml: at the start the readings do not determine, in units of the bounds: (.*)\.", left_open
    )
    assert found_open is not None
    # the direction that two sensors at 0 and 120 degrees do not see, from their slopes
    J = found.sensing().linearise(found.start)[1] * (found.upper - found.lower)
    null = torch.linalg.svd(J).Vh[-1]
    said = {name: float(x) for x, name in re.findall(r"([-+]\d\.\d\d) (\S+)", found_open[1])}
    for name, x in zip(
        found.robot.coordinates, (null * null.abs().argmax().sign() * 1).tolist(), strict=True
    ):
        assert abs(abs(said.get(name, 0.0)) - abs(x)) < (
            0.006 if name in said else float(null.abs().max()) / 2
        )
    on_axis = ONE.replace("radial_mm = 13.0", "radial_mm = 0")
    (note,) = load_robot(written(tmp_path, on_axis)).notes
    assert note == (
        "arm.toml: at the start the readings do not determine, in units of the bounds: +1.00 delta_x_1; "
        "+1.00 delta_y_1."
    )
    polar = load_robot(written(tmp_path, AFFINE)).notes
    assert polar == (
        "arm.toml: at the start the readings do not determine, in units of the bounds: +1.00 phi_1. Bent, they do.",
    )


def test_windows_line_ends_count_the_same(tmp_path):
    text, line = replaced("length_mm", "length_m = 0.11")
    path = tmp_path / "arm.toml"
    path.write_bytes(text.replace("\n", "\r\n").encode())
    with pytest.raises(InputError, match=f"arm.toml, line {line},"):
        load_robot(path)


def test_every_kind_and_format_is_known():
    assert set(SEGMENT_KINDS) == {"constant_curvature", "affine_curvature"}
    assert set(MAGNET_KINDS) == {"ring", "cube"}
    for path in ROBOTS.glob("*.toml"):
        assert load_robot(path).format in FORMATS


def test_lines_among_comments_strings_and_arrays():
    text = '''# [[no]]
a = """
b = 1
[c]
""" # d = 2
e = [ # f = 3
  "]", 1,
  # ]
] # [[g]]
"h" = '#'
[i] # j
"k l" = { m = 1 }
[[n]]
o.p = 1
[[n]]
  q = "\\" [" # r
s = 2
[i.t]
u = 1
'''
    assert key_lines(text) == {
        ("a",): 2, ("e",): 6, ("h",): 10, ("i",): 11, ("i", "k l"): 12, ("n", 0): 13, ("n", 0, "o"): 14,
        ("n", 1): 15, ("n", 1, "q"): 16, ("n", 1, "s"): 17, ("i.t",): 18, ("i.t", "u"): 19,
    }  # fmt: skip


names = st.sampled_from(["length_mm", "radius_mm", "at_mm", "kind", "x"])
values = st.sampled_from(
    ["1.0", '"a # b"', "'[['", "[1, 2]", "[\n 1, # ]\n 2\n]", '"""\n[[x]]\ny = 1\n"""', "true"]
)


@given(
    st.lists(st.tuples(st.sampled_from(["segments", "magnets"]), st.dictionaries(names, values)), max_size=6)
)
def test_lines_of_generated_files(tables):
    """Every key is found where it was written, whatever stands in between."""
    text, expected, counts = "", {}, {}
    for name, keys in tables:
        k = counts[name] = counts.get(name, -1) + 1
        expected[name, k] = text.count("\n") + 2
        text += f"# [{name}]\n[[{name}]]\n"
        for key, value in keys.items():
            expected[name, k, key] = text.count("\n") + 1
            text += f"  {key} = {value} # = [\n"
    assert key_lines(text) == expected
