"""IMUs mounted any way, alone and beside magnetic sensors; readings of magpylib, synthetic quaternions."""

import math
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import torch
from scipy.spatial.transform import Rotation

from edition1.errors import InputError
from edition1.kernels._sensing import CompiledSensing
from edition1.kinematics.mounts import magnet_mounts
from edition1.robot_file.imu_readings import sent as sent_by
from edition1.robot_file.load import load_robot
from edition1.sensing.magnetic import readings
from edition1_live.emulate.board import Reading, passages
from edition1_live.emulate.emulator import Emulator
from edition1_live.emulate.links import SocketLink
from edition1_live.follow import live_text, session
from edition1_live.follow.follower import Follower, track_readings
from edition1_live.follow.imu_streams import redundant
from edition1_live.follow.robot_estimator import robot_estimator
from edition1_live.follow.time_steps import TimeStep, TimeSteps
from edition1_live.own.fit import fit
from edition1_live.own.poses import read_measured_poses
from edition1_live.own.samples import timed_readings
from edition1_live.record.export import export
from edition1_live.record.recording import read_recording
from edition1_live.record.recording_file import RecordingFile
from edition1_live.robot.calibration_poses import Poses, coordinate_columns, recorded_readings
from edition1_live.robot.readings_file import read_readings
from edition1_live.wire.frame import Frame

NOISE_RAD = math.radians(0.3)
MOUNTED = Rotation.from_rotvec([[0.3, -1.2, 2.0], [2.0, 0.1, -0.4]])
BASE = Rotation.from_rotvec([1.9, 0.4, -0.8])


def quaternion(rotation):
    return [float(f"{x:.9f}") for x in rotation.as_quat()]


def both(base=BASE, heading="absolute"):
    """Two segments, two magnetic sensors in each and an IMU: alone neither sees all six coordinates."""
    text = f"base_orientation = {quaternion(base)}\nearth_mt = [0.01, 0.02, -0.04]\n"
    text += '[stream]\nformat = "frames"\nrate_hz = 50\nunit = "mT"\nnoise_mt = 0.001\nnoise_deg = 0.3\n'
    for i in (1, 2):
        text += '[[segments]]\nkind = "constant_curvature"\nlength_mm = 100\nradius_mm = 20\ndelta_L_mm = [0, 10]\n'
        text += f'[[magnets]]\nkind = "ring"\nsegment = {i}\nat_mm = 50\nouter_diameter_mm = {8 * i}\n'
        text += "inner_diameter_mm = 3\nheight_mm = 6\npolarisation_mt = 1200\n"
        for k in (0, 1):
            text += f"[[sensors]]\nchannel = {2 * i - k}\nsegment = {i}\nat_mm = 90\nradial_mm = 10\n"
            text += f"azimuth_deg = {90 * k}\n"
        known = heading if i == 2 else "absolute"
        text += f'[[imus]]\nstream = {i}\nsegment = {i}\nat_mm = 95\nheading = "{known}"\n'
        text += f"mounted = {quaternion(MOUNTED[i - 1])}\n"
    return text


def loaded(tmp_path, text):
    path = tmp_path / "arm.toml"
    path.write_text(text)
    return load_robot(path)


def quaternions(found, q, rng, *, noise_rad=NOISE_RAD, turned=0.0):
    """What the IMUs send: of the cross-sections, by the kinematics; the second is turned about the vertical."""
    mounts = magnet_mounts([imu.segment for imu in found.imus], [imu.at_m for imu in found.imus])
    R = found.robot.mount_poses(q, mounts)[:, :3, :3].numpy()
    noise = Rotation.from_rotvec(noise_rad * rng.standard_normal((len(found.imus), 3)))
    heading = Rotation.from_rotvec([[0, 0, 0]] * (len(found.imus) - 1) + [[0, 0, turned]])
    return (heading * Rotation.from_quat(sent_by(R, found.imus, found.base_orientation)) * noise).as_quat()


def frames(found, q, rng, **options):
    u = readings(found.robot, q, found.magnets, earth_mt=found.earth_mt).numpy()
    u += found.noise * rng.standard_normal(len(u))
    values = np.zeros(found.channels)
    values[list(found.channel)] = u
    rows = [values, *quaternions(found, q, rng, **options)]
    return tuple(Frame(k, 0, None, tuple(row.tolist())) for k, row in enumerate(rows))


def configurations(found, n, seed=0):
    generator = torch.Generator().manual_seed(seed)
    share = 0.1 + 0.8 * torch.rand(n, len(found.lower), dtype=torch.float64, generator=generator)
    return found.lower + (found.upper - found.lower) * share


@pytest.mark.parametrize("heading", ["absolute", "free"])
@pytest.mark.parametrize("name", ["levenberg_marquardt", "kalman"])
def test_magnets_and_imus_together_are_as_good_as_they_say(tmp_path, heading, name):
    """Errors in units of the covariance; a free heading may be any, and costs nothing of the truth."""
    found = loaded(tmp_path, both(heading=heading))
    assert not [note for note in found.notes if "readings" in note]
    estimator, rng = robot_estimator(found, name), np.random.default_rng(0)
    nees, chi2, n = [], [], 40
    for q in configurations(found, n):
        follower = Follower(estimator)
        for k in range(1 if name == "levenberg_marquardt" else 8):  # the filter begins wide and settles
            turned = rng.uniform(-3, 3) if heading == "free" else 0.0
            sent = frames(found, q, rng, turned=turned)
            u, estimate = follower.step(TimeStep(0.02 * k, 0, 0, sent))
        error = estimate.q - q
        nees.append(float(error @ torch.linalg.solve(estimate.covariance, error)))
        chi2.append(float((u - estimate.u_hat).square().sum()))
        assert not any(follower.missing)
    if name == "levenberg_marquardt":
        assert 6 - 4 * math.sqrt(12 / n) < np.mean(nees) < 6 + 4 * math.sqrt(12 / n)
        dof = len(u) - redundant(found, estimator.use) - 6
        assert dof == (4 if heading == "absolute" else 3)
        assert dof - 4 * math.sqrt(2 * dof / n) < np.mean(chi2) < dof + 4 * math.sqrt(2 * dof / n)
    else:
        assert np.mean(nees) < 8  # more certain than it says: the robot rests
    assert len(estimator.sensors) == len(estimator.shown(u)) == 6
    np.testing.assert_allclose(estimator.shown(u)[:4], [sent[0].values[k] for k in found.channel], atol=1e-12)


def test_compiled_is_torch(tmp_path):
    found = loaded(tmp_path, both(heading="free"))
    stacked, q = robot_estimator(found).stacked, configurations(found, 20)
    for ours, theirs in zip(CompiledSensing(stacked).linearise(q), stacked.linearise(q), strict=True):
        torch.testing.assert_close(ours, theirs, rtol=1e-11, atol=1e-8)  # in units of the noise
    with pytest.raises(InputError, match="sensing.parts of compiled must be LinearisedSensing, or"):
        CompiledSensing(replace(stacked, parts=(stacked.parts[0], stacked.parts[0])))


def test_neither_alone_sees_all_six_coordinates(tmp_path):
    text = both()
    start, last = text.index("[[imus]]"), text.rindex("[[imus]]")
    alone = text[:start] + text[text.index("[[segments]]", start) : last]
    path = tmp_path / "arm.toml"
    path.write_text(alone.replace("noise_deg = 0.3\n", ""))
    assert load_robot(path).notes[-2].startswith("arm.toml: 4 readings for 6 unknowns.")


def test_how_far_the_robot_leans_is_shown(tmp_path):
    found = loaded(tmp_path, both())
    q = torch.tensor([0.01, 0.0, 0.0, 0.01, 0.0, 0.0], dtype=torch.float64)
    sent = frames(found, q, np.random.default_rng(0), noise_rad=0.0)
    estimator = robot_estimator(found)
    leans = estimator.shown(estimator.readings(TimeStep(0.0, 0, 0, sent)))[4:]
    expected = [math.degrees(0.01 / 0.02 * share) for share in (0.95, 1.95)]
    np.testing.assert_allclose(leans, expected, rtol=1e-6)


def test_streams_of_other_rates_are_only_slower_and_a_silent_one_is_told(tmp_path):
    """Magnetic frames at 50 Hz, one IMU at 10 Hz, the other never; a quaternion that is none counts as missing."""
    found = loaded(tmp_path, both())
    estimator, rng = robot_estimator(found, "kalman"), np.random.default_rng(1)
    follower, steps, q = Follower(estimator), TimeSteps(estimator.streams, 50.0), configurations(found, 1)[0]
    estimates = []
    for k in range(90):
        sent = frames(found, q, rng)
        arrived = [sent[0], *([sent[1]] if k % 5 == 0 else [])]
        for step in steps.add(k * 20_000_000, arrived):
            u, estimate = follower.step(step)
            estimates.append((u, estimate))
    masked = [int(estimate.diagnostics["masked"]) for _, estimate in estimates]
    assert set(masked) == {9, 18}
    assert follower.missing[:5] == [0] * 5
    assert 30 < follower.missing[5] < 45
    assert follower.refused == 0
    broken = sent[0], sent[1]._replace(values=(0.5, 0.5, 0.5, 0.0)), sent[2]
    u, estimate = follower.step(TimeStep(2.0, 0, 0, broken))
    assert follower.missing[4] == 1
    assert int(u.isnan().sum()) == 9
    assert estimate is not None
    odd = TimeStep(2.1, 0, 0, (sent[0], Frame(1, 0, None, (0.0, 0.0, 1.0)), None))
    assert follower.step(odd)[1] is None
    assert "a quaternion of 4 values, as described in arm.toml; instead received 3" in follower.refusal


def test_a_board_that_sends_both_is_followed(tmp_path):
    found = loaded(tmp_path, both())
    rng, q = np.random.default_rng(2), configurations(found, 1)[0]
    board = [
        Reading(0.02 * k, frame.stream, frame.values)
        for k in range(60)
        for frame in frames(found, q, rng)
        if frame.stream == 0 or k % 2 == 0
    ]
    estimator, said, found_all = robot_estimator(found, failed=[4]), [], []
    stop = session.threading.Event()
    emulator = Emulator(passages(board, "frames"), SocketLink(), hang_up=True)

    def warn(text):
        said.append(text)
        if emulator.finished.is_set():
            stop.set()

    with emulator:
        state = session.follow(emulator.address, estimator, stop=stop, each=found_all.append, warn=warn)
    whole = [x for x in found_all if None not in x.step.frames]
    assert len(whole) > 20
    assert float((whole[-1].estimate.q - q).abs().max()) < 5e-3
    assert "Not used, as asked: sensor 4." in live_text.troubles(estimator, state)
    assert not [text for text in live_text.troubles(estimator, state) if "no reading" in text]


def test_a_calibration_takes_the_magnetic_stream_alone(tmp_path):
    """Four magnetic channels and quaternions of four values: they must not be mixed."""
    found = loaded(tmp_path, both())
    rng, q = np.random.default_rng(3), configurations(found, 2)
    about = {"format": "frames", "start_unix_s": 0.0, "start_host_ns": 0}
    with RecordingFile(tmp_path / "held.rec", about) as file:
        for k in range(40):
            for frame in frames(found, q[k // 20], rng):
                file.append(k * 20_000_000, [frame])
    window = np.array([[0.0, 0.39], [0.41, 0.8]])
    taken = recorded_readings(read_recording(tmp_path / "held.rec"), found, Poses(q, window, ("", "")))
    torch.testing.assert_close(taken.values, found.values(q), rtol=0, atol=2e-3)


def recorded_both(tmp_path, n):
    """Six magnetic channels of which four are used, quaternions, and what does not fit: a short one, a stream 7."""
    found = loaded(tmp_path, both().replace("noise_deg", "channels = 6\nnoise_deg"))
    rng, q = np.random.default_rng(4), configurations(found, 1)[0]
    about = {"format": "frames", "start_unix_s": 0.0, "start_host_ns": 0}
    with RecordingFile(tmp_path / "a.rec", about) as file:
        for k in range(n):
            sent = list(frames(found, q, rng))
            if k == 5:
                sent[1] = sent[1]._replace(values=sent[1].values[:3])
            if k == 6:
                sent.append(sent[2]._replace(stream=7))
            file.append(k * 20_000_000, sent)
    with (tmp_path / "a.rec").open("ab") as file:
        file.write(b"RRB1F")
    return found, q


LEFT_OUT = [
    "1 frames of stream 1 have another number of values than 4 and were left out.",
    "Streams that arm.toml does not have: 7 (1 frames).",
]


def test_a_recording_of_both_is_read_stream_by_stream(tmp_path):
    """Frames of IMUs are not measured by the number of magnetic channels; what is left out is said."""
    found, q = recorded_both(tmp_path, 20)
    readings = read_readings(tmp_path / "a.rec", found)
    assert readings.notes == [
        "Recording: 5 bytes of the recording are not whole and were left out.",
        *LEFT_OUT,
    ]
    widths = [(frame.stream, len(frame.values)) for _, frame in readings.frames]
    assert [widths.count(pair) for pair in ((0, 6), (1, 4), (2, 4))] == [20, 19, 20]
    estimates = []
    done, _ = track_readings(readings, robot_estimator(found), lambda _, found: estimates.append(found))
    assert done.missing == [0] * 6
    assert float((estimates[-1].q - q).abs().max()) < 5e-3
    window = np.array([[0.0, 1.0]])
    held = recorded_readings(read_recording(tmp_path / "a.rec"), found, Poses(q[None], window, ("",)))
    assert list(held.notes) == readings.notes
    torch.testing.assert_close(held.values[0, :4], found.values(q)[:4], rtol=0, atol=2e-3)


def test_a_table_of_both_gives_the_frames_of_the_recording(tmp_path):
    found, _ = recorded_both(tmp_path, 20)
    recording = read_readings(tmp_path / "a.rec", found)
    export(read_recording(tmp_path / "a.rec"), tmp_path / "a.csv")
    table = read_readings(tmp_path / "a.csv", found)
    assert table.notes == ["Columns of a.csv that are not used: u5, u6.", *LEFT_OUT[1:]]
    short = next(
        k for k, (_, frame) in enumerate(table.frames) if math.isnan(frame.values[-1]) and frame.stream
    )
    assert [frame.values[:4] for _, frame in (*table.frames[:short], *table.frames[short + 1 :])] == [
        frame.values[:4] for _, frame in recording.frames
    ]
    assert [len(frame.values) for _, frame in table.frames[:3]] == [6, 4, 4]
    text = (tmp_path / "a.csv").read_text()
    (tmp_path / "b.csv").write_text(text.replace("u1,u2", "u1_mT,u2", 1))
    with pytest.raises(
        InputError, match="columns of b.csv must be stream, u1, u2, u3, u4; .* none called u1"
    ):
        read_readings(tmp_path / "b.csv", found)


def test_magnets_and_imus_are_judged_by_motion_capture(tmp_path):
    """Every stream goes into the estimates; the residual is that of the magnetic sensors, in their unit."""
    found = loaded(tmp_path, both().replace("rate_hz = 50", "rate_hz = 20"))
    time_s, rng = np.arange(360) / 20, np.random.default_rng(5)
    waves = torch.from_numpy(rng.uniform(size=(2, 6, 2)))
    turns = (0.1 + 0.4 * waves[0]) * torch.from_numpy(time_s)[:, None, None] + waves[1]
    q = (found.lower + found.upper) / 2
    q = q + 0.4 * (found.upper - found.lower) * torch.sin(2 * math.pi * turns).mean(-1)
    with RecordingFile(
        tmp_path / "a.rec", {"format": "frames", "start_unix_s": 0.0, "start_host_ns": 0}
    ) as file:
        for t, pose in zip(time_s, q, strict=True):
            file.append(round(1e9 * t), list(frames(found, pose, rng)))
    columns = coordinate_columns(found)
    rows = pd.DataFrame((q / torch.tensor(list(columns.values()))).numpy(), columns=list(columns))
    rows.assign(time_s=time_s - 0.2).to_csv(tmp_path / "p.csv", index=False)
    poses = read_measured_poses(tmp_path / "p.csv", found, noise_m=1e-4, noise_rad=0.01)
    taken = timed_readings(read_readings(tmp_path / "a.rec", found), found)
    judged = fit(found, taken, poses)
    assert abs(judged.lag.lag_s - 0.2) < 5e-3
    for track in judged.tracks:
        assert float((track.q - judged.truth.q).abs().nanmean()) < 1e-3
        assert 0.2 < float(np.median(track.residual)) / found.noise < 2
    with pytest.raises(
        InputError, match="calibration for arm.toml, which has IMUs; instead received network"
    ):
        fit(found, taken, poses, model="network")


ARM = "".join(
    [
        '[stream]\nformat = "quaternions"\nrate_hz = 30\n',
        *(
            '[[segments]]\nkind = "constant_curvature"\nlength_mm = 100\nradius_mm = 20\n' * 2
            + "".join(f"[[imus]]\nstream = {i}\nsegment = {i}\nat_mm = 100\n#{i}\n" for i in (1, 2))
        ),
    ]
)


def test_a_chain_of_imus_mounted_any_way_on_a_base_turned_any_way(tmp_path):
    """Positions of points in the frame of the base are the same; without turns nothing changes, to the bit."""
    plain = loaded(tmp_path, ARM)
    text = f"base_orientation = {quaternion(BASE)}\n" + ARM
    for i in (1, 2):
        text = text.replace(f"#{i}\n", f"mounted = {quaternion(MOUNTED[i - 1])}\n")
    turned = loaded(tmp_path, text)
    q = configurations(plain, 1)[0]
    tips = []
    for found in (plain, turned):
        rows = quaternions(found, q, np.random.default_rng(0), noise_rad=0.0)
        sent = tuple(Frame(k + 1, None, None, tuple(row.tolist())) for k, row in enumerate(rows))
        follower = Follower(robot_estimator(found))
        u, estimate = follower.step(TimeStep(0.0, 0, 0, sent))
        tips.append(estimate.q)
        if found is plain:
            assert u[4:].tolist() == [x for frame in sent for x in frame.values]
    torch.testing.assert_close(tips[1], tips[0], rtol=0, atol=1e-8)
    straight = replace(plain, lower=plain.start, upper=plain.start).start
    assert float((tips[0][-3:] - plain.robot.tip(q)[:3, 3]).norm()) < 0.25 * float(straight.norm() + 0.2)


def line_of(text, wanted, nth=0):
    return [k for k, line in enumerate(text.split("\n"), start=1) if line.startswith(wanted)][nth]


@pytest.mark.parametrize(
    ("old", "new", "key", "must_be", "received"),
    [
        (f"mounted = {quaternion(MOUNTED[0])}", "mounted = [0, 0, 0.1, 1]", "mounted",
         "a unit quaternion [x, y, z, w] within 0.001, from the frame of the IMU to that of the cross-section",
         "[0, 0, 0.1, 1]"),
        (f"mounted = {quaternion(MOUNTED[0])}", "mounted = [0, 0, 1]", "mounted",
         "a unit quaternion [x, y, z, w] within 0.001, from the frame of the IMU to that of the cross-section",
         "[0, 0, 1]"),
        ("stream = 1\n", "stream = 0\n", "stream", "another than 0, the stream of the magnetic sensors", "0"),
        ("stream = 1\n", "stream = 300\n", "stream", "a whole number from 0 to 255", "300"),
        ('heading = "absolute"', 'heading = "unknown"', "heading", "one of 'absolute', 'free'", "'unknown'"),
    ],
)  # fmt: skip
def test_wrong_keys_of_imus(tmp_path, old, new, key, must_be, received):
    text = both().replace(old, new, 1)
    with pytest.raises(InputError) as error:
        loaded(tmp_path, text)
    line = line_of(text, new.strip())
    assert str(error.value) == (
        f"Input {key} of arm.toml, line {line}, [[imus]] 1, must be {must_be}; instead received {received}."
    )


def test_headings_of_imus_alone_are_absolute(tmp_path):
    with pytest.raises(
        InputError, match=r"heading of .*, \[\[imus\]\] 1, must be 'absolute' without magnetic"
    ):
        loaded(tmp_path, ARM.replace("#1", 'heading = "free"'))
    with pytest.raises(InputError, match="line 1, must be a unit quaternion .* to the world of the IMUs"):
        loaded(tmp_path, "base_orientation = [0, 0, 0, 2]\n" + ARM)
