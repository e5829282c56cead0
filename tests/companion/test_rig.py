"""The rig of Table 2: stored recordings, closed forms, files, alignment, filters, published cells."""

import json
import re
from contextlib import nullcontext
from dataclasses import replace
from hashlib import sha256
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from repro import GradientDescent, InputError, Sensing, track
from repro.chain import place
from repro_companion.papers import fetch, rig, simulated_rig, table_2
from repro_companion.scorecard import published
from tests.library.robots import STORED

LOUD = SimpleNamespace(**(vars(simulated_rig.RIG) | {"noise": 3.6, "inflated_noise": 8.25}))
"""Fifteen times the noise."""
FIRST = SimpleNamespace(
    **vars(simulated_rig.RIG)
    | {
        "places": {},
        "sensitivity": ((-1665.0, -1358.0, 4515.0), (-2461.0, 875.0, 4264.0), (-4111.0, -677.0, 2764.0)),
        "rest": (1032.0, 915.4, 1159.5),
        "curvature": ((-2.18, -0.55, -0.66), (-0.69, -0.09, 0.5), (-1.04, -0.23, 0.19)),
        "ripple": (4.0, 0.95, 2.8),
    }
)
"""The rig of the first edition, whose recordings had one place and other sensors."""


@pytest.fixture(scope="module")
def t1():
    return simulated_rig.simulated("T1")


def test_simulated_recordings_are_those_of_the_first_edition():
    t1 = simulated_rig.simulated("T1", FIRST)
    assert len(t1) == 3460
    np.testing.assert_array_equal(t1.u[::20], STORED["rig_u"])
    # The first edition had the place of the markers in single precision, so a last digit of a file may differ.
    assert (np.abs(t1.q[::20] - STORED["rig_q"]) < 1e-15).mean() > 0.99
    np.testing.assert_allclose(t1.q[::20], STORED["rig_q"], rtol=0, atol=2e-6)


def of_ring(q):
    """What motion capture sees of the base, and of the ring in configurations."""
    T = rig.robot().poses(q, [place("ring", 1, rig.MARKERS_AT)])[:, 0]
    xyzw = Rotation.from_matrix(T[:, :3, :3]).inv().as_quat()
    turned = simulated_rig._capture_axes
    ring = np.column_stack([turned(xyzw[:, :3]), xyzw[:, 3], turned(T[:, :3, 3])])
    return np.array([0, 0, 0, 1, *turned(np.array([[0, 0, rig.BASE_HEIGHT]]))[0]]), ring


def test_the_pose_of_the_ring_gives_the_configuration():
    q = np.random.default_rng(0).uniform(-1, 1, (200, 3)) * [9e-3, 9e-3, 3e-3]
    q[0] = 0.0
    q[1, :2] = 1e-9  # nearly straight
    np.testing.assert_allclose(rig.configurations(rig.Capture(*of_ring(q)), "law"), q, atol=1e-10)


@pytest.mark.parametrize("name", rig.TRAJECTORIES)
def test_a_motion_is_taken_to_the_place_of_its_recording(name):
    """Means and deviations are those read off the networks, and elongation rises with bend as it does there."""
    place, bend = simulated_rig.PLACES[name], np.random.default_rng(0).normal([1, 2], [3, 4], (500, 2))
    matrix, shift = simulated_rig.placement(place, bend)
    at = bend @ matrix.T + shift
    x, y = ((bend - bend.mean(0)) / bend.std(0)).T
    np.testing.assert_allclose(at[:, 0], place.centre[0] - place.spread_x * x)
    np.testing.assert_allclose(at[:, 1], place.centre[1] - place.spread_y[0] * x + place.spread_y[1] * y)
    running = np.arange(500) > 100
    elongation = simulated_rig.elongations(place, at, running)
    np.testing.assert_allclose(np.polyfit((at**2).sum(1), elongation, 1)[0], place.rise)
    assert elongation[running].mean() == pytest.approx(place.elongation)


def test_a_simulated_recording_stands_at_its_place(t1):
    """Its elongation rises with bend as read off the networks, and sensors do not feel that."""
    place, q = simulated_rig.PLACES["T1"], 1e3 * t1.q
    np.testing.assert_allclose(q.mean(axis=0), [*place.centre, place.elongation], atol=0.05)
    assert q[:, 0].std() == pytest.approx(place.spread_x, abs=0.05)
    assert np.polyfit((q[:, :2] ** 2).sum(axis=1), q[:, 2], 1)[0] == pytest.approx(place.rise, abs=1e-3)
    level = SimpleNamespace(
        **vars(simulated_rig.RIG) | {"places": {"T1": place._replace(elongation=5.5, rise=0.0)}}
    )
    longer = simulated_rig.simulated("T1", level)
    np.testing.assert_array_equal(longer.u, t1.u)
    assert 1e3 * longer.q[:, 2].mean() == pytest.approx(5.5, abs=0.05)


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """The authors' two files of one trajectory, and what is in them."""
    folder, held = tmp_path_factory.mktemp("rig"), {}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(simulated_rig, "aligned", lambda q, u, name: held.update(u=u))
        patch.setattr(simulated_rig, "configurations", lambda capture, name: held.update(capture=capture))
        simulated_rig.simulated("T1")
    base, ring = held["capture"]
    header = {
        "Format Version": "1.23",
        "Take Name": "T1",
        "Rotation Type": "Quaternion",
        "Length Units": "Meters",
    }
    columns = [*rig.BODY, ("Mean Marker Error", "")]
    lines = [",".join(f"{key},{value}" for key, value in header.items()), ""]
    for words in (["Rigid Body"] * 16, ["Base"] * 8 + ["Ring"] * 8, ["ID"] * 16):
        lines.append(",".join(["", "", *words]))
    lines += [
        ",".join([*first, *(2 * [words[k] for words in columns])])
        for k, first in ((0, ("", "")), (1, ("Frame", "Time")))
    ]
    for k, pose in enumerate(ring):
        cells = [
            *(f"{x:.6f}" for x in base),
            "0.0001",
            *("" if np.isnan(x) else f"{x:.6f}" for x in pose),
            "0.0001",
        ]
        lines.append(",".join([str(k), f"{k / rig.RATE_HZ:.6f}", *cells]))
    capture, sensors = folder / "T1_Quat.csv", folder / "T1_SV.csv"
    capture.write_text("\n".join(lines) + "\n", encoding="utf-8")
    pd.DataFrame(held["u"], columns=["u1", "u2", "u3"]).to_csv(sensors, index=False, float_format="%.4f")
    return capture, sensors


def test_files_in_the_authors_formats_give_the_recording(files, t1):
    capture, sensors = files
    found = rig.aligned(rig.configurations(rig.read_capture(capture), "T1"), rig.read_readings(sensors), "T1")
    np.testing.assert_array_equal(found.u, t1.u)
    np.testing.assert_array_equal(found.q, t1.q)


@pytest.fixture
def released(files, tmp_path, monkeypatch):
    """Recordings of our own in the released form: twelve files, whose hashes are on the list."""
    monkeypatch.setenv("REPRO_DATA_DIR", str(tmp_path))
    monkeypatch.setattr(fetch, "project_folder", lambda: tmp_path)
    listed = []
    for whole in rig.NAMES.values():
        for path, of_t1 in zip(rig.raw_files(tmp_path / rig.FOLDER, whole), files, strict=True):
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(of_t1.read_bytes())
            own = {
                "path": str(path.relative_to(tmp_path / "baaij2023")),
                "sha256": sha256(path.read_bytes()).hexdigest(),
            }
            listed.append(own)
    about = {"repository": "https://github.com/o/n", "commit": "a1" * 20, "files": listed}
    about["readers"] = [{"files": "", "page": "table_2", "use": "all"}]
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "sources.json").write_text(json.dumps({"baaij2023": about}), encoding="utf-8")
    return tmp_path / rig.FOLDER


def test_with_recordings_in_the_released_form_all_rows_are_comparable(released, t1):
    data = table_2.load("recorded")
    assert data.source == "recorded"
    np.testing.assert_array_equal(data.tests["T4"].u, t1.u)
    q, u = data.beginnings(15.0)
    table = table_2.errors(data, {"known": q[:, :, None] + 1e-3}, u[:, :, None] + 1.0, 15.0)
    none = pd.DataFrame(columns=["step", "row", "quantity", "lowest", "middle", "highest", "chaotic"]).astype(
        {"chaotic": bool}
    )
    lines = table_2.scorecard_rows(table, data, 15.0, none)
    assert len(lines) == 37
    assert lines["comparable"].all()
    assert lines["setting"].str.startswith("authors' files").all()
    assert not lines["note"].str.contains("synthetic").any()


def test_changed_recordings_are_the_readers_own(released):
    path = rig.raw_files(released, rig.NAMES["T3"])[1]
    path.write_text(path.read_text(encoding="utf-8") + "\n", encoding="utf-8")
    assert table_2.load("recorded").source == "own"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("1.23", "1.24"), "Format Version of {} must be 1.23; instead received 1.24."),
        (("Meters", "Millimeters"), "Length Units of {} must be Meters; instead received Millimeters."),
        (("Rotation,Rotation", "Position,Rotation"), "columns of the base of {} must be rotation X"),
        (("\n5,0.125", "\n5,0.325"), "times of {} must be 1/40 s apart; instead received other steps."),
    ],
)
def test_other_files_of_motion_capture_are_refused(files, tmp_path, change, message):
    other = tmp_path / "other_Quat.csv"
    text = files[0].read_text(encoding="utf-8")
    assert change[0] in text
    other.write_text(text.replace(*change, 1), encoding="utf-8")
    with pytest.raises(InputError, match=re.escape(message.format(other.name))):
        rig.read_capture(other)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("u1,u2\n1,2\n", "columns of SV.csv must be u1, u2, u3; instead received u1, u2."),
        ("u1,u2,u3\n1,2,x\n", "readings of SV.csv must be numbers [mV]"),
        ("u1,u2,u3\n1,2,\n1,2,3\n", "readings of SV.csv must be complete up to the end"),
        ("u1,u2,u3\n1,2,2047.9375\n", "readings of SV.csv must be between 0.0 and 2047.9375 mV"),
    ],
)
def test_other_files_of_readings_are_refused(tmp_path, text, message):
    path = tmp_path / "SV.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=re.escape(message)):
        rig.read_readings(path)


def test_a_ring_that_is_lost_for_long_is_refused():
    ring = np.tile([0.0, 0.0, 0.0, 1.0, 0.0, 0.1, 0.0], (9, 1))
    ring[3:6] = np.nan
    with pytest.raises(InputError, match="lost for at most 2 frames.*instead received lost for 3 frames"):
        rig.configurations(rig.Capture(ring[0], ring), "gap")


def test_two_lost_frames_are_interpolated_whatever_the_signs_of_the_quaternions():
    s = np.linspace(0.0, 1.0, 60)[:, None]
    q = np.sin(np.add(s, [0.0, 1.0, 2.0])) * [9e-3, 9e-3, 3e-3] - [0.0, 0.0, 3e-3]
    base, ring = of_ring(q - q[0])
    whole = rig.configurations(rig.Capture(base, ring), "whole")
    ring[:, :4] *= np.random.default_rng(0).choice([-1.0, 1.0], (60, 1))
    ring[[7, 8, 20, 33, 34, 50]] = np.nan
    np.testing.assert_allclose(rig.configurations(rig.Capture(base, ring), "seen"), whole, atol=1e-5)


def test_an_alignment_is_doubted_by_half_and_an_eighth_of_a_second_and_refused_by_twice_and_half():
    """How much better the readings fit the motion elsewhere, and how far away; noise hides it."""
    said = set()
    slow = np.cumsum(np.random.default_rng(1).normal(size=(2000, 3)), axis=0)
    q, noise = slow / slow.std(0), np.random.default_rng(0).normal(size=(2000, 3))
    for late in (5, 6, 19, 21):
        for size in (0.02, 0.14, 0.2, 0.25, 0.35):
            u = np.roll(q, late, axis=0)[late:] + size * noise[late:]
            found = rig.search_lag(q[late:], u, rig.RATE_HZ)
            gain, far = found.residual / found.best, abs(found.lag_s)
            assert far == pytest.approx(late / rig.RATE_HZ, abs=0.03)
            expected = (
                "refused" if gain >= 2 and far >= 0.5 else "doubt" if gain > 1.5 and far > 0.125 else ""
            )
            with pytest.raises(InputError) if expected == "refused" else nullcontext():
                words = " ".join(rig.doubts(q[late:], u, "a"))
                assert ("doubt" in words) == bool(words) == (expected == "doubt")
            said.add((late, expected))
    assert said >= {
        (5, ""),
        (6, "doubt"),
        (19, "doubt"),
        (21, "doubt"),
        (21, "refused"),
        (21, ""),
    }


@pytest.mark.parametrize("seed", [0, 3])
def test_loud_readings_are_aligned_like_quiet_ones(seed):
    quiet, loud = simulated_rig.simulated("T1", seed=seed), simulated_rig.simulated("T1", LOUD, seed=seed)
    # Both have one motion; how much of it is cut says where the readings were taken to begin.
    shifts = range(-5, 6)
    n = min(len(quiet), len(loud)) - 10
    off = [np.abs(loud.q[5 : 5 + n] - quiet.q[5 + k : 5 + k + n]).max() for k in shifts]
    assert abs(shifts[int(np.argmin(off))]) <= 2


@pytest.mark.parametrize("late", [200, -100])
def test_a_false_start_is_refused_even_by_a_whole_period(monkeypatch, late):
    """T1 repeats every 5 s: only the inflation at the beginning tells the periods apart."""
    right = rig.start_of_readings
    monkeypatch.setattr(rig, "start_of_readings", lambda u, name: max(right(u, name) + late, 0))
    with pytest.raises(InputError, match="alignment of synthetic_T1 must be that of the first inflation"):
        simulated_rig.simulated("T1")


def test_a_change_of_six_times_the_noise_is_a_start():
    """Readings of -1 and 1 mV in turn differ by 2 mV, as those with a noise of root two; six times that is 8.49."""
    u = np.tile((-1.0) ** np.arange(11)[:, None], (1, 3))
    u[10] = 8.6
    assert rig.start_of_readings(u, "made") == 10


def test_a_start_is_the_row_where_the_rise_passes_three_times_the_noise():
    """It takes a change of six times the noise, 8.49 mV, to be one; three times that is 4.24 mV."""
    u = np.tile((-1.0) ** np.arange(14)[:, None], (1, 3))
    u[10:] = np.array([4.2, 4.3, 6.0, 8.6])[:, None]
    assert rig.start_of_readings(u, "made") == 11
    with pytest.raises(InputError, match="start of made must be readings that change by"):
        rig.start_of_readings(u[:13], "made")


def test_readings_of_another_motion_are_said_to_hardly_follow(t1):
    noise = np.random.default_rng(0).normal(size=t1.u.shape)
    assert "hardly follow" in rig.doubts(t1.q, noise, "noise")[0]


@pytest.fixture(scope="module")
def data(t1):
    tests = {
        name: replace(t1, name=name, q=t1.q[:80] + 1e-3 * k, u=t1.u[:80])
        for k, name in enumerate(rig.TRAJECTORIES)
    }
    return table_2.Data(t1, tests, "simulated")


def test_errors_are_those_of_eq_13(data):
    q, u = data.beginnings(1.0)
    off = np.where(np.arange(len(q)) % 4, 0.0, 2.0)[
        :, None, None, None
    ]  # once in four frames: 1 in the mean square
    found = {"known": q[:, :, None] + off * [1e-3, -2e-3, 0.0]}
    table = table_2.errors(data, found, u[:, :, None] + off * [3.0, 0.0, 6.0], 1.0)
    cells = table[table["row"] == table_2.row_name("T4")].set_index(["quantity", "unit"])["error"]
    whole = data.tests["T4"]
    assert cells["delta_x", "mm"] == pytest.approx(1.0)
    assert cells["delta_y", "%"] == pytest.approx(100 * 2e-3 / np.ptp(whole.q[:, 1]))
    assert cells["e_u", "mV"] == pytest.approx(3.0)
    assert cells["e_u", "%"] == pytest.approx(300 / np.ptp(whole.u))


def test_the_rows_are_the_printed_ones_and_not_comparable(data):
    q, u = data.beginnings(1.0)
    seeds = np.array([0.0, 1.0, 5.0])[:, None]  # their mean is 2, their deviation the root of 7
    table = table_2.errors(data, {"known": q[:, :, None] + 1e-3 * seeds}, u[:, :, None] + seeds, 1.0)
    moved = pd.DataFrame(
        [("published", table_2.row_name("T1"), "delta_x", 1.0, 1.5, 2.24, True)],
        columns=["step", "row", "quantity", "lowest", "middle", "highest", "chaotic"],
    )
    lines = table_2.scorecard_rows(table, data, 1.0, moved)
    key = ["row", "quantity", "unit"]
    printed = pd.concat([published("baaij2023", a) for a in ("Table 2", "Abstract", "Section 5.5")])
    assert set(map(tuple, lines[key].to_numpy())) <= set(map(tuple, printed[key].to_numpy()))
    assert len(lines) == 35 + 2
    assert not lines["comparable"].any()
    own = lines[lines["unit"] != "%"]
    np.testing.assert_allclose(own[["regenerated", "regenerated_std"]], [[2, 7**0.5]] * len(own))
    relative = (
        lines["unit"].eq("%") & lines["artefact"].eq("Table 2") & lines["quantity"].str.startswith("delta")
    )
    mean = lines.loc[relative, "regenerated"].mean()
    assert lines.loc[lines["artefact"] == "Abstract", "regenerated"].item() == pytest.approx(mean)
    noted = lines[lines["note"].str.contains("decided by rounding: 32 other starts give 1 to 2.24 mm")]
    assert set(noted["row"]) == {table_2.row_name("T1")}


def test_the_largest_jump_is_replayed_iterate_by_iterate(data):
    sensing = Sensing(rig.robot(), table_2.networks(data, 0), earth=rig.EARTH)
    q, u = (values[:, 2] for values in data.beginnings(2.0))
    known = np.where([False, False, True], q, np.nan)
    descent = GradientDescent(sensing, table_2.STEP_SIZE, table_2.MOMENTUM, table_2.ITERATIONS)
    found = track(descent, u, q[0], rate_hz=rig.RATE_HZ, known=known).q
    k, grid, (path, half) = table_2.largest_jump([sensing], q, u, found[:, None])
    bends = 1e3 * found[:, :2]
    assert k == 1 + np.linalg.norm(np.diff(bends, axis=0), axis=1).argmax()
    tried = path[["delta_x_mm", "delta_y_mm"]].to_numpy()
    np.testing.assert_allclose(tried[0], bends[k - 1], rtol=0, atol=1e-12)
    np.testing.assert_allclose(tried[path["rmse_mV"].argmin()], bends[k], rtol=0, atol=1e-6)
    halved = half[["delta_x_mm", "delta_y_mm"]].to_numpy()
    np.testing.assert_allclose(2 * (halved[1] - halved[0]), tried[1] - tried[0], rtol=1e-9)
    drawn = np.concatenate([bends, tried, halved])  # no path leaves the map
    low, high = grid[["delta_x_mm", "delta_y_mm"]].min(), grid[["delta_x_mm", "delta_y_mm"]].max()
    np.testing.assert_allclose((drawn.min(0) - low, high - drawn.max(0)), 2.0, rtol=1e-9)


def study(robot, method, error, **shares):
    """Rows of the study of filters for one robot and method: errors of two recordings along both axes."""
    rows = pd.DataFrame(error, columns=["delta_x", "delta_y"])
    return rows.assign(robot=robot, method=method, recording=["T0", "T1"], **shares)


def test_methods_are_means_over_the_seeds_beside_those_on_networks(data):
    q, u = data.beginnings(1.0)
    seeds = np.array([1e-3, 2e-3, 6e-3])[:, None]
    found = {"known": q[:, :, None] + seeds, "ours": (q - 4e-3)[:, :, None]}
    table = table_2.errors(data, found, np.stack([u] * 3, 2), 1.0)
    own = [
        study("authors' networks", "filter", [[1, 2], [3, 4]]),
        study("random rig 0", "filter", [[8, 8], [8, 8]]),
    ]
    lines = table_2.methods(table, pd.concat(own))
    assert lines["recording"].tolist() == [name for name in rig.TRAJECTORIES for _ in "xy"]
    np.testing.assert_allclose(lines[["known", "ours"]], [[3.0, 4.0]] * 12)
    assert lines["filter"].dropna().tolist() == [1, 2, 3, 4]
    assert [*table_2.methods(table, own[0][:0])] == ["recording", "quantity", "known", "ours"]
    shown = table_2.with_axes(lines)
    assert [*shown] == ["bend", "known", "ours", "filter"]
    assert shown["bend"].tolist()[:3] == ["T0,\u00a0Δx", "T0,\u00a0Δy", "T1,\u00a0Δx"]


def test_a_judgement_has_geometric_means_the_worst_recording_and_medians_of_random_rigs():
    shares = {"far_percent": [1.0, 9.0], "far_unsaid_percent": [2.0, 0.0], "covered_percent": [10.0, 30.0]}
    parts = []
    for robot, factor in (
        ("networks", 1.0),
        ("random rig 0", 2.0),
        ("random rig 1", 4.0),
        ("random rig 2", 9.0),
    ):
        parts += [
            study(robot, "descent", [[2.0, 2.0], [2.0, 2.0]]),
            study(robot, "half step", [[1.0, 1.0], [4.0, 4.0]]),
        ]
        parts.append(study(robot, "filter", factor * np.array([[1.0, 4.0], [4.0, 1.0]]), **shares))
        parts.append(study(robot, "filter, own biases", [[8.0, 8.0], [8.0, 8.0]]))
    table = table_2.judgement(pd.concat(parts))
    assert table["robot"].tolist() == ["networks", "3 random rigs"]
    np.testing.assert_allclose(table.loc[0].iloc[1:].astype(float), [1.0, 1.0, 4.0, 9.0, 2.0, 20.0])
    assert table.loc[1, "of_descent"] == pytest.approx(4.0)
    assert [*table] == [*table_2.JUDGEMENT]


def test_claims_are_means_and_limits_of_what_is_printed_in_percent(data):
    printed = published("baaij2023", "Table 2")
    q, u = data.beginnings(1.0)
    table = table_2.errors(data, {"known": q[:, :, None] + 1e-3}, u[:, :, None] + 2.0, 1.0)
    found = table_2.claims(printed, {"here": table}).set_index("claim")
    assert found.loc["readings: mean 3.1", "Table 2"] == "3.1"
    assert found.loc["readings: 0.6 to 4.6", "Table 2"] == "0.6 to 4.6"
    assert found.loc["bend: mean 4.5", "Table 2"] == "4.5"
    assert found.loc["bend: 1.9 to 13.6", "Table 2"] == "1.4 to 13.6"
    assert found.loc["readings: mean 3.1", "here"] == f"{200 / np.ptp(data.tests['T0'].u):.1f}"


def test_claims_compare_means_of_the_same_motions(data):
    """Where a table lacks T4, its mean stands beside the means of the others without T4."""
    printed = published("baaij2023", "Table 2")
    without = printed.assign(elongation="known", error=printed["value"]).query("row != 'T5.train->T4'")
    found = table_2.claims(printed, {"here": without}).set_index("claim")
    assert found.loc["bend: mean 4.5"].tolist() == ["4.5", "–"]
    assert found.loc["bend: mean without T4"].tolist() == ["4.9", "4.9"]
    assert found.loc["readings: mean without T4"].tolist() == ["3.6", "3.6"]


class Squares:
    """Readings of the square of one bend and of the other bend [mV]: two valleys, on either side of zero."""

    def __call__(self, q):
        return np.stack([1.6e6 * q[:, 0] ** 2, 2e4 * q[:, 1], 0 * q[:, 0]], axis=-1)

    def linearise(self, q):
        J = np.zeros((len(q), 3, 3))
        J[:, 0, 0], J[:, 1, 1] = 3.2e6 * q[:, 0], 2e4
        return self(q), J


def test_estimates_in_another_valley_are_counted():
    """One is close, one comes back, one stays where the loss is as low, one where it is lower than at the truth."""
    q = np.tile([1e-2, 0.0, 0.0], (4, 1))
    estimates, measured = q.copy(), q.copy()
    estimates[:, 0], measured[:, 0] = [1.2e-2, 1.6e-2, -1.1e-2, -2e-2], [1e-2, 1e-2, 1e-2, 2e-2]
    words = table_2.trapped_in_words([Squares()], q, Squares()(measured), estimates[:, None])
    assert "We take the 3 estimates that are more than 5 mm off" in words
    assert (
        "1,000 steps of 1/20 of the size. 2 of them still end more than 5 mm off, in another valley" in words
    )
    assert "lower than the loss at the true bend in 1 of these 2." in words
    assert "a descent from a single start" not in words
    assert not table_2.trapped_in_words([Squares()], q[:1], Squares()(measured[:1]), estimates[:1, None])


@pytest.mark.parametrize(("off_mm", "outside"), [(0.0, False), (0.49, False), (0.51, True), (20.0, True)])
def test_bends_are_outside_from_half_a_millimetre_on_whatever_the_elongation(data, off_mm, outside):
    one = replace(data.train, q=data.train.q[:1])
    for step in np.array([[1, 0, 0], [0, -1, 0], [0.6, 0.8, 1e3]]):
        assert table_2.outside(one, one.q + 1e-3 * off_mm * step).tolist() == [outside]
    assert not table_2.outside(data.train, data.train.q).any()


@pytest.mark.parametrize(("half", "chaotic"), [(0.0495, False), (0.0505, True)])
def test_rounding_decides_where_the_error_of_one_seed_moves_by_a_tenth(half, chaotic):
    study = pd.DataFrame(
        [
            ("published", "a", s, k, x + s, 1.0 + half * (k - 1) * s)
            for s in (0, 1)
            for k, x in enumerate((1.0, 1.2, 1.9))
        ],
        columns=["step", "row", "seed", "start", "delta_x", "delta_y"],
    )
    found = table_2.ranges_over_starts(study).set_index("quantity")
    assert found.loc["delta_x", ["lowest", "middle", "highest"]].tolist() == pytest.approx([1.5, 1.7, 2.4])
    assert found["chaotic"].to_dict() == {"delta_x": True, "delta_y": chaotic}


def test_recordings_that_are_asked_for_must_be_there(monkeypatch, tmp_path):
    monkeypatch.setenv("REPRO_DATA_DIR", str(tmp_path))
    with pytest.raises(InputError, match="none of T0, T1, T2, T3, T4, T5"):
        table_2.load("recorded")


def test_the_first_seven_tenths_of_t5_train_and_all_else_tests(monkeypatch):
    """Eleven frames: seven and four; of T4 all are tests."""
    frames = np.arange(33.0).reshape(11, 3)
    monkeypatch.setattr(table_2, "simulated", lambda name: rig.Recording(name, frames, frames))
    data = table_2.load("simulated")
    assert data.train.u[:, 0].tolist() == [0, 3, 6, 9, 12, 15, 18]
    for name, test in data.tests.items():
        np.testing.assert_array_equal(test.q, frames if name == "T4" else frames[7:])


def test_a_landscape_has_root_mean_squares_that_are_clipped():
    """Readings that are 0, 3 and 6 mV off have the root of 15; with 400 mV more it would be above 100."""
    low, high = np.array([[0.0, 0.0], [2e-3, 4e-3]])
    grid = table_2.landscape(lambda q: [0, 3, 6] + 1e5 * q[:, [1]], np.zeros(3), np.zeros(3), low, high, 2)
    np.testing.assert_allclose(grid, [[0, 0, 15**0.5], [2, 0, 15**0.5], [0, 4, 100], [2, 4, 100]])


def test_figures_show_a_minute_ten_times_a_second_and_five_even_times_with_the_largest_error():
    q = 1e-6 * np.arange(2500)[:, None] * [1.0, 2.0, 0.0]
    table = table_2.paths(table_2.Data(None, {"T0": rig.Recording("T0", q, q)}, "simulated"))
    np.testing.assert_allclose(table["time_s"], np.arange(600) / 10)
    np.testing.assert_allclose(table[["delta_x_mm", "delta_y_mm"]], 1e3 * q[:2400:4, :2])
    tip = table[["tip_x_mm", "tip_y_mm", "tip_z_mm"]]
    np.testing.assert_allclose(tip, 1e3 * rig.robot().tip(q[:2400:4])[:, :3, 3])
    found = np.repeat(q[:11, None], 2, axis=1)
    found[7, 1, 0] += 1e-3
    found[3, 0, 2] += 9e-3  # the elongation is no error of the bend
    times, truth, seeds = table_2.stills(q[:11], found)
    chosen = [0, 2, 4, 6, 7, 8]
    np.testing.assert_allclose(times, np.array(chosen) / 40)
    np.testing.assert_array_equal([truth, *seeds.swapaxes(0, 1)], [q[chosen], *found[chosen].swapaxes(0, 1)])


def test_a_descent_starts_straight_and_its_map_reaches_a_millimetre_beyond_all_bends(data):
    part, k = data.tests["T5"], 40
    sensing = Sensing(rig.robot(), table_2.networks(data, 0), earth=rig.EARTH)
    grid, path = table_2.loss_and_descent(sensing, part, k)
    tried, drawn = path[["delta_x_mm", "delta_y_mm"]].to_numpy(), grid[["delta_x_mm", "delta_y_mm"]]
    bends = 1e3 * part.q[:, :2]
    np.testing.assert_allclose([bends.min(0) - drawn.min(), drawn.max() - bends.max(0)], 1.0)
    straight = part.q[k] * [0, 0, 1]
    assert tried[0].tolist() == [0, 0]
    assert path["rmse_mV"][0] == pytest.approx(np.sqrt(((sensing(straight) - part.u[k]) ** 2).mean()))
