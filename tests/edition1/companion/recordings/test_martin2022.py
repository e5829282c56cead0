"""The bags of Martin et al.: small bags written here, and the released ones where they are found."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.spatial.transform import Rotation

from edition1.errors import InputError
from edition1.estimation.imu_chain import adjacent_angles, link_orientations, rigid_body
from edition1.estimation.imu_models import pcc_extended
from edition1.estimation.imu_selection import Selection
from edition1_companion.recordings import martin2022
from edition1_companion.recordings.martin2022 import find_bag, one_clock, read_messages, read_readings
from edition1_companion.twins.imu_stream import synthetic_stream

MESSAGE = """std_msgs/Header header
uint8 ID
float32 w
float32 x
float32 y
float32 z
================================================================================
MSG: std_msgs/Header
uint32 seq
time stamp
string frame_id
"""
ROUND_NS = 28_000_000


def write_bag(path: Path, readings: pd.DataFrame, topic: str = "/quat_meas", message: str = MESSAGE) -> Path:
    """Write a real ROS 1 bag with the layout of the authors' files."""
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(message, "estimator/msg/quat"))
    quat = store.types["estimator/msg/quat"]
    header, stamp = store.types["std_msgs/msg/Header"], store.types["builtin_interfaces/msg/Time"]
    with Writer(path) as bag:
        connection = bag.add_connection(topic, "estimator/msg/quat", typestore=store)
        for r in readings.itertuples():
            fields = (np.float32(v) for v in (r.w, r.x, r.y, r.z)[: message.count("float32")])
            content = quat(header(r.sequence, stamp(0, 0), ""), r.imu, *fields)
            time_ns = 10**18 + round(r.time_s * 1e9)
            bag.write(connection, time_ns, store.serialize_ros1(content, "estimator/msg/quat"))
    return path


@pytest.fixture
def readings() -> pd.DataFrame:
    return synthetic_stream(seed=0, duration_s=4.0)


@pytest.fixture
def bag(tmp_path, readings) -> Path:
    return write_bag(tmp_path / "small.bag", readings)


def test_bag_round_trip(bag, readings):
    found = read_readings(bag)
    assert list(found.columns) == list(readings.columns)
    np.testing.assert_allclose(found.to_numpy(float), readings.to_numpy(float), atol=1e-6)


def test_topic_is_found_with_or_without_slash(bag):
    pd.testing.assert_frame_equal(read_messages(bag, "quat_meas"), read_messages(bag, "/quat_meas"))


def test_bag_without_the_topic_names_those_it_has(tmp_path, readings):
    path = write_bag(tmp_path / "other.bag", readings, topic="/markers")
    with pytest.raises(InputError, match=r"topic of other\.bag must be .*the bag has /markers.*quat_meas\."):
        read_readings(path)


def test_bag_with_the_topic_but_no_message(tmp_path, readings):
    with pytest.raises(InputError, match=r"topic of empty\.bag must be one with messages"):
        read_readings(write_bag(tmp_path / "empty.bag", readings.head(0)))


def test_topic_with_other_messages(tmp_path, readings):
    path = write_bag(tmp_path / "other.bag", readings, message=MESSAGE.replace("float32 z\n", ""))
    with pytest.raises(InputError, match=r"topic quat_meas of other\.bag must be messages with .*\['z'\]"):
        read_readings(path)


@pytest.mark.parametrize("part", [0.0, 0.001, 0.05, 0.3, 0.5, 0.8, 0.95, 0.99, 0.9999])
def test_truncated_bag(tmp_path, bag, part):
    whole = bag.read_bytes()
    path = tmp_path / "cut.bag"
    path.write_bytes(whole[: int(len(whole) * part)])
    with pytest.raises(InputError, match=r"file of cut\.bag must be a complete ROS 1 bag; instead received"):
        read_readings(path)


def test_file_that_is_no_bag(tmp_path):
    path = tmp_path / "text.bag"
    path.write_text("time,x,y,z\n")
    with pytest.raises(InputError, match="must be a complete ROS 1 bag"):
        read_readings(path)


def test_missing_file(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"There is no bag none\.bag"):
        read_readings(tmp_path / "none.bag")


def test_find_bag_without_data(tmp_path, monkeypatch):
    monkeypatch.setenv("REPRO_DATA_DIR", str(tmp_path))
    assert find_bag("prev_saved_data_to_play.bag") is None
    with pytest.raises(InputError, match=r"name of find_bag must be one of prev_saved_data_to_play\.bag, "):
        find_bag("nonsense.bag")


def test_find_bag_refuses_another_file_of_that_name(tmp_path, monkeypatch):
    monkeypatch.setenv("REPRO_DATA_DIR", str(tmp_path))
    path = tmp_path / martin2022.BAG_FOLDER / "freshly_recorded_data.bag"
    path.parent.mkdir(parents=True)
    path.write_bytes(b"#ROSBAG V2.0\n")
    with pytest.raises(
        InputError, match=r"must be the released file, sha256 3cb51b20.*; instead received sha256"
    ):
        find_bag(path.name)


def constant_turn(between: str) -> tuple[np.ndarray, np.ndarray]:
    """Angles about z of all IMUs at the samples, for a stream in which all turn at 1 rad/s; and the times."""
    sequence = np.arange(240)
    time_s = sequence / 280
    q = Rotation.from_rotvec(np.outer(time_s, [0, 0, 1])).as_quat()
    frame = pd.DataFrame(
        {"sequence": sequence, "time_s": time_s, "imu": sequence % 8} | dict(zip("xyzw", q.T, strict=True))
    )
    stream = one_clock(frame, between=between)
    return 2 * np.arctan2(stream.orientations[..., 2], stream.orientations[..., 3]), stream.time_s


def test_interpolation_is_exact_for_a_constant_turn():
    angles, time_s = constant_turn("interpolate")
    np.testing.assert_allclose(angles, np.tile(time_s[:, None], (1, 8)), atol=1e-14)


def test_hold_takes_the_latest_reading():
    angles, time_s = constant_turn("hold")
    np.testing.assert_allclose(angles, time_s[:, None] - np.arange(7, -1, -1) / 280, atol=1e-14)


def test_sign_flips_are_counted_and_made_continuous(readings):
    flipped = readings.copy()
    some = np.random.default_rng(0).random(len(readings)) < 0.3
    flipped.loc[some, list("xyzw")] *= -1
    clean, stream = one_clock(readings), one_clock(flipped)
    assert clean.facts["sign_flips"].sum() == 0
    assert stream.facts["sign_flips"].sum() > 300
    assert ((stream.orientations[1:] * stream.orientations[:-1]).sum(-1) > 0).all()
    np.testing.assert_allclose(np.abs((stream.orientations * clean.orientations).sum(-1)), 1, atol=1e-12)
    np.testing.assert_allclose(stream.facts["largest_step_deg"], clean.facts["largest_step_deg"])


def test_nearly_unit_quaternions_are_rescaled_and_counted(readings):
    q = readings[list("xyzw")].to_numpy()
    readings[list("xyzw")] = q / np.linalg.norm(q, axis=1, keepdims=True)
    readings.loc[[9, 17], list("xyzw")] *= 1.0009
    stream = one_clock(readings)
    assert stream.facts["rescaled"].tolist() == [0, 2, 0, 0, 0, 0, 0, 0]
    assert stream.facts["largest_norm_error"][1] == pytest.approx(0.0009)
    np.testing.assert_allclose(np.linalg.norm(stream.orientations, axis=-1), 1, atol=1e-12)


def test_repeats_and_jumps_are_counted_and_kept(readings):
    readings.loc[[18, 26], list("xyzw")] = readings.loc[10, list("xyzw")].to_numpy(float)
    before = one_clock(readings)
    turn = Rotation.from_rotvec([0, 0, 0.6])
    late = readings["imu"].eq(5) & (readings["time_s"] > 3)
    readings.loc[late, list("xyzw")] = (turn * Rotation.from_quat(readings.loc[late, list("xyzw")])).as_quat()
    stream = one_clock(readings)
    assert before.facts["repeats"][2] >= 2
    assert len(stream.jumps) == len(before.jumps) + 1
    last = stream.jumps.iloc[-1]
    assert (last["imu"], last["time_s"]) == (5, readings.loc[late, "time_s"].iloc[0])
    assert last["step_deg"] == pytest.approx(np.degrees(0.6), abs=8)
    assert last["axis_z"] > 0.95
    assert stream.facts["jumps"].sum() == len(stream.jumps)


def test_missing_messages_are_counted_not_filled(readings):
    kept = readings.drop(index=[*range(83, 86), *range(400, 480)])
    stream, whole = one_clock(kept), one_clock(readings)
    assert stream.lost == 83
    assert (stream.facts["gaps"] >= 1).all()
    assert (stream.facts["samples_in_gaps"][:7] >= 1).all()
    assert len(stream.time_s) == len(whole.time_s) - 10


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (
            lambda r: r.assign(imu=r["imu"].where(r.index != 20, 3)),
            "ids of readings .* duplicated: 3 after 3 at row 20",
        ),
        (
            lambda r: r.assign(imu=r["imu"].replace({3: 4, 4: 3})),
            "ids of readings must be in turn, 0 to 7; instead received an id out of order: 3 after 4",
        ),
        (
            lambda r: r[r["imu"] != 6],
            r"ids of readings must be 0 to 7, each present; instead received \[0, 1, 2, 3,",
        ),
        (lambda r: r.assign(imu=r["imu"].replace({6: 9})), "ids of readings must be 0 to 7"),
        (
            lambda r: r.assign(time_s=r["time_s"].where(r.index != 50, 0.0)),
            "time_s of readings must be increasing",
        ),
        (lambda r: r.assign(time_s=r["time_s"].where(r.index != 50, np.nan)), "must be finite; .* in row 50"),
        (lambda r: r.assign(x=r["x"].where(r.index != 50, np.inf)), "must be finite; .* in row 50"),
        (
            lambda r: r.assign(sequence=r["sequence"].where(r.index != 50, 7)),
            "sequence of readings must be increasing",
        ),
        (
            lambda r: r.assign(w=r["w"] * (1 + 0.01 * (r.index == 50))),
            "must be unit within 0.001; .* in row 50",
        ),
        (lambda r: r.drop(columns="w"), "columns of readings must be .*none of .'w'."),
        (lambda r: r.head(9), "must be at least two per IMU|over some common time"),
    ],
)
def test_readings_that_cannot_be_trusted_are_refused(readings, spoil, message):
    with pytest.raises(InputError, match=message):
        one_clock(spoil(readings))


def test_time_stamps_out_of_order_in_a_bag(tmp_path, readings):
    """The reader sorts by time, so that a wrong time stamp shows in the messages' numbers."""
    readings.loc[50, "time_s"] = readings.loc[70, "time_s"] + 1e-4
    path = write_bag(tmp_path / "late.bag", readings)
    with pytest.raises(InputError, match="sequence of readings must be increasing in order of time"):
        one_clock(read_readings(path))


@pytest.mark.parametrize("arguments", [{"between": "guess"}, {"jump_deg": 0.0}, {"jump_deg": np.nan}])
def test_bad_options_are_refused(readings, arguments):
    with pytest.raises(InputError, match=f"Input {next(iter(arguments))} of one_clock"):
        one_clock(readings, **arguments)


def released(name: str) -> Path:
    path = find_bag(name)
    if path is None:
        pytest.skip(f"{name} is not below REPRO_DATA_DIR")
    return path


def test_released_bag_has_the_known_rate_jumps_and_angles():
    stream = one_clock(read_readings(released("prev_saved_data_to_play.bag")))
    facts = stream.facts
    assert stream.time_s[-1] - stream.time_s[0] == pytest.approx(113.2, abs=0.1)
    # 34.8 Hz is the rate of the median interval; over the whole recording it is 34.3 Hz.
    np.testing.assert_allclose(1e3 / facts["median_interval_ms"], 34.8, atol=0.1)
    np.testing.assert_allclose(facts["rate_hz"], 34.34, atol=0.01)
    assert facts["largest_step_deg"].min() == pytest.approx(24.4, abs=0.1)
    assert facts["largest_step_deg"].max() == pytest.approx(36.8, abs=0.1)
    assert np.degrees(adjacent_angles(stream.orientations)).max() == pytest.approx(82.5, abs=1.0)
    assert (stream.lost, facts["gaps"].sum(), facts["sign_flips"].sum(), facts["repeats"].sum()) == (
        0,
        0,
        0,
        4,
    )
    assert facts["largest_norm_error"].max() < 1e-4


def test_isolated_jumps_of_the_released_bag_are_changes_of_heading():
    jumps = one_clock(read_readings(released("prev_saved_data_to_play.bag"))).jumps
    heading = jumps[jumps["axis_z"].abs() > 0.95]
    assert sorted(heading["imu"]) == [0, 1, 2, 3, 4, 5, 7]
    assert heading["step_deg"].between(25, 37).all()
    others = jumps.drop(heading.index)
    assert set(others["imu"]) == {5, 6, 7}
    assert others["time_s"].between(24, 30).all()


def test_second_released_bag_can_be_read():
    stream = one_clock(read_readings(released("freshly_recorded_data.bag")))
    assert stream.time_s[-1] - stream.time_s[0] == pytest.approx(16.1, abs=0.1)
    assert stream.facts["largest_step_deg"].max() == pytest.approx(175.1, abs=0.1)


def test_chain_gives_the_positions_that_the_authors_recorded_beside_the_readings():
    """Topic model_3D_pcc holds a chain of links of 102 and 6 x 80 mm along the y axes of IMUs 0 to 6."""
    path = released("prev_saved_data_to_play.bag")
    readings, model = read_readings(path), read_messages(path, "model_3D_pcc")
    tracks = [readings[readings["imu"] == imu] for imu in range(7)]
    rows = [np.searchsorted(track["time_s"], model["time_s"]) - 1 for track in tracks]
    latest = np.stack([t[list("xyzw")].to_numpy()[row] for t, row in zip(tracks, rows, strict=True)], axis=1)
    older = latest.copy()
    older[:, 0] = tracks[0][list("xyzw")].to_numpy()[rows[0] - 1]
    theirs = model[[f"{axis}{k}" for k in range(8) for axis in "xyz"]].to_numpy().reshape(-1, 8, 3)
    lengths = [0.102] + [0.08] * 6
    off_latest, off_older = (
        np.linalg.norm(rigid_body(link_orientations(q, "y"), lengths) - theirs, axis=2).max(axis=1)
        for q in (latest, older)
    )
    assert (off_latest < 1e-6).mean() > 0.9
    # The others were computed just before the newest reading of IMU 0 arrived.
    assert np.minimum(off_latest, off_older).max() < 1e-6


@pytest.mark.parametrize(("marker", "arc_m"), [(0, 0.3564), (1, 0.6044)])
def test_chain_gives_the_markers_that_the_authors_recorded_beside_the_readings(marker, arc_m):
    """Topic markers: eight PCC-extended links with sub-segments of their own, from a base turned by half a turn.

    A message was computed from the readings of some moment close to it. The first ones hold readings from before the
    recording began, which nobody has.
    """
    path = released("freshly_recorded_data.bag")
    readings, sent = read_readings(path), read_messages(path, "markers")
    sent = sent[sent["ID"] == marker]
    points, ids = sent[["x", "y", "z"]].to_numpy(), readings["imu"].to_numpy()
    newest = np.stack([np.where(ids == imu, np.arange(len(ids)), -1) for imu in range(8)], axis=1)
    newest = np.maximum.accumulate(newest)  # of each IMU, after every reading
    q = link_orientations(readings[list("xyzw")].to_numpy(), "y")
    latest = np.searchsorted(readings["time_s"], sent["time_s"]) - 1
    closest = np.full(len(sent), np.inf)
    for before in range(-2, 5):  # readings between the one used and the message
        row = np.clip(latest - before, 0, len(ids) - 1)
        known = (newest[row] >= 0).all(axis=1)
        nine = np.concatenate(
            [np.tile([0.0, 0.0, 1.0, 0.0], (known.sum(), 1, 1)), q[newest[row[known]]]], axis=1
        )
        off = np.linalg.norm(markers_of_the_bag(nine, arc_m) - points[known], axis=1)
        closest[known] = np.minimum(closest[known], off)
    assert len(sent) in (4418, 4419)
    assert closest[8:].max() < 1e-6


def markers_of_the_bag(nine, arc_m):
    """Link by link, since each has its own number of sub-segments: base to IMU #1 62.2 mm, the others 80 mm."""
    position, left = np.zeros((len(nine), 3)), arc_m
    for link, n in enumerate((4, 4, 2, 1, 5, 2, 4, 2)):
        length = 0.0622 if link == 0 else 0.08
        made = Selection((0, 1), (0.0, length), (length,), sub_links=n)
        position = position + pcc_extended(nine[:, link : link + 2], made, [min(left, length)])[:, 0]
        left = max(left - length, 0.0)
    return position
