"""The recorded trial: orientations found again in synthetic tables, and the released ones where they are found."""

import hashlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation
from short_arm import short_arm

from edition1.errors import InputError
from edition1.estimation.imu_chain import sensor_orientations
from edition1.estimation.orientations import tangents
from edition1_companion.pages.how_many_imus.curves import frames_along
from edition1_companion.pages.recorded_trial import captured, recorded
from edition1_companion.pages.recorded_trial.recorded import (
    bag_orientations,
    compare_files,
    fewer_imus,
    figure_5,
    link_lengths,
    load_trial,
    rows_later,
    synthetic_outputs,
)
from edition1_companion.pages.recorded_trial.released import (
    NEEDED,
    PCC_1,
    PCC_2,
    PCC_16_2,
    RIGID,
    ReleasedChain,
    compared,
    half_turns,
    released_chains,
    trial_orientations,
)
from edition1_companion.recordings import martin2022_trial
from edition1_companion.recordings.martin2022_trial import (
    MARKER_POINTS,
    ORIGIN_M,
    OUTPUT_FOLDER,
    OUTPUTS,
    SCORED_ROWS,
    MarkerCapture,
    ModelOutput,
    find_output,
    read_output,
)
from edition1_companion.twins.arm_recording import MotionCapture
from edition1_companion.twins.arm_trial import draw, drawn
from edition1_companion.twins.imu_errors import PERFECT

PUBLISHED = pd.read_csv(Path(__file__).parents[4] / "data" / "published" / "published.csv")


@pytest.fixture(scope="module")
def arm():
    return short_arm()


@pytest.fixture(scope="module")
def trial(arm):
    return drawn(arm, 0, PERFECT, MotionCapture(noise_m=0.0)).trial


@pytest.fixture(scope="module")
def real_sensors(arm):
    """A trial whose IMUs are mounted and turned a little about the arm, as real ones are."""
    return draw(arm, 0).trial


@pytest.fixture
def nothing_found(tmp_path, monkeypatch):
    monkeypatch.setenv("REPRO_DATA_DIR", str(tmp_path))
    return tmp_path


def angles_deg(a, b):
    turn = Rotation.from_quat(a.reshape(-1, 4)).inv() * Rotation.from_quat(b.reshape(-1, 4))
    return np.degrees(turn.magnitude()).reshape(a.shape[:-1])


class TestFramesAlong:
    def test_z_axes_are_the_directions(self):
        d = np.random.default_rng(0).normal(size=(20, 5, 3))
        d /= np.linalg.norm(d, axis=-1, keepdims=True)
        frames = frames_along(d)
        np.testing.assert_allclose(tangents(frames[:, 1:]), d, atol=1e-12)
        np.testing.assert_array_equal(frames[:, 0], np.tile([0, 0, 0, 1], (20, 1)))

    def test_turns_are_the_smallest(self):
        d = np.random.default_rng(1).normal(size=(20, 4, 3))
        d /= np.linalg.norm(d, axis=-1, keepdims=True)
        frames = frames_along(d)
        turns = Rotation.from_quat(frames[:, 2]) * Rotation.from_quat(frames[:, 1]).inv()
        np.testing.assert_allclose(turns.magnitude(), np.arccos((d[:, 0] * d[:, 1]).sum(axis=-1)), atol=1e-7)

    def test_straight_arm(self):
        np.testing.assert_array_equal(frames_along(np.tile([0.0, 0.0, 1.0], (3, 1)))[3], [0, 0, 0, 1])


class TestOrientations:
    def test_those_of_the_imus_are_found_again(self, real_sensors):
        """From positions of 32 bits, as in the released tables; on a straight link the turn about it is not told."""
        found = trial_orientations(synthetic_outputs(real_sensors))
        off = angles_deg(found.orientations, real_sensors.orientations)
        assert off.shape == (len(real_sensors.time_s), 9)
        assert np.percentile(off, 99) < 0.01
        assert off[:, 1:8][found.told_deg.min(axis=1) > 1].max() < 0.01
        assert found.unevenness_deg.max() < 1e-4

    def test_tables_that_are_earlier_or_later(self, real_sensors):
        outputs = synthetic_outputs(real_sensors, later=9)
        cut = outputs[PCC_16_2]
        outputs[PCC_16_2] = ModelOutput(cut.points[15:], cut.replay_s[15:])  # 6 rows earlier than rigid.csv
        found = trial_orientations(outputs)
        off = angles_deg(found.orientations, real_sensors.orientations[6:])
        assert np.percentile(off, 99) < 0.01
        assert compared(PCC_16_2, outputs[PCC_16_2], found.orientations)["later"] == 0
        assert compared(PCC_1, outputs[PCC_1], found.orientations)["later"] == 15

    def test_tables_that_are_missing_short_or_without_points(self, real_sensors):
        outputs = synthetic_outputs(real_sensors)
        with pytest.raises(
            InputError, match=rf"outputs of trial_orientations must be .* none of \['{PCC_2}'\]"
        ):
            trial_orientations({name: outputs[name] for name in NEEDED if name != PCC_2})
        short = ModelOutput(outputs[RIGID].points[:60], outputs[RIGID].replay_s[:60])
        with pytest.raises(InputError, match="rows of a released table must be 80 in common at least"):
            trial_orientations(outputs | {RIGID: short})
        with pytest.raises(InputError, match=f"points of {PCC_1} must be given in every row"):
            trial_orientations(outputs | {PCC_1: outputs[PCC_16_2]})
        with pytest.raises(InputError, match="points of a released table must be given at"):
            compared(PCC_1, outputs[PCC_16_2], real_sensors.orientations)


class TestComparison:
    def test_every_table_follows(self, real_sensors):
        outputs = synthetic_outputs(real_sensors)
        table = compare_files(recorded.Trial(outputs, trial_orientations(outputs), "synthetic"))
        assert table["file"].tolist() == list(released_chains())
        assert set(table["file"]) == set(OUTPUTS)
        assert table["largest_um"][:5].max() < 0.2
        assert table["same_percent"].min() > 99
        assert rows_later(table) == 6

    def test_each_setting_matters(self, real_sensors, monkeypatch):
        """A chain with the printed interpolation, an upright base or another origin does not give the table."""
        outputs, chains = synthetic_outputs(real_sensors), released_chains()
        nine = real_sensors.orientations
        for changed, at_least_um in (
            ({"interpolation": "midpoints"}, 1e3),
            ({"base_turn": (0.0, 0.0, 0.0, 1.0)}, 1e3),
        ):
            made = replace(chains[PCC_2].made, **changed)
            other = ReleasedChain(made, chains[PCC_2].arcs)
            monkeypatch.setattr(
                "edition1_companion.pages.recorded_trial.released.released_chains", lambda c=other: {PCC_2: c}
            )
            assert compared(PCC_2, outputs[PCC_2], nine)["median_um"] > at_least_um

    def test_half_a_turn_has_no_shorter_way(self):
        nine = np.tile([0.0, 0.0, 0.0, 1.0], (3, 9, 1))
        nine[1:, 1:] = [0.0, 0.0, np.sin(0.1), np.cos(0.1)]
        chains = released_chains()
        assert half_turns(chains[PCC_1].made, nine).tolist() == [True, False, False]
        assert not half_turns(chains[RIGID].made, nine).any()


def test_links_of_synthetic_outputs(trial):
    table = link_lengths(synthetic_outputs(trial)[RIGID])
    assert table["expected_mm"].tolist() == [102.0] + [80.0] * 6
    assert table["largest_error_mm"].max() < 1e-4


class TestFigure5:
    def test_settings_of_a_straight_arm(self):
        """All turns about the vertical: no shape differs, but for the points of the file and the short link."""
        table = figure_5(np.tile([0.0, 0.0, 0.0, 1.0], (3, 9, 1)), PUBLISHED)
        medians = table.set_index(["n_imus", "chain", "marker"])["median_mm"]
        for marker in ("M1", "M2"):
            for n in (2, 4):
                assert medians[n, "as described", marker] == pytest.approx(0, abs=1e-9)
                assert medians[n, "base turned, at the markers", marker] == pytest.approx(0, abs=1e-9)
                assert medians[n, "as in the file", marker] == pytest.approx(40, abs=1e-9)
            assert medians[8, "as in the file", marker] == pytest.approx(5.2, abs=1e-9)
        printed = table.set_index(["n_imus", "marker"])["printed_median_mm"]
        assert printed[2, "M2"].unique().tolist() == [128.0]

    def test_a_turned_base_is_felt_most_by_two_imus(self, real_sensors):
        table = figure_5(real_sensors.orientations, PUBLISHED).set_index(["chain", "marker", "n_imus"])[
            "median_mm"
        ]
        turned = [table["base turned, at the markers", "M1", n] for n in (2, 4, 8)]
        assert turned == sorted(turned, reverse=True)
        for n, one in zip((2, 4, 8), turned, strict=True):
            assert one > 1.5 * table["as described", "M1", n]


class TestFewerImus:
    def test_all_models_agree_on_a_straight_arm(self):
        table = fewer_imus(np.tile([0.0, 0.0, 0.0, 1.0], (3, 9, 1)))
        np.testing.assert_allclose(table["median_mm"], 0, atol=1e-9)

    def test_fewer_are_further_away(self, trial):
        table = fewer_imus(trial.orientations[::10])
        at = table[table["point_mm"] == 600].set_index(["model", "n_imus"])["median_mm"]
        for model in ("spline", "PCC-extended, 16 segments"):
            own = [at[model, n] for n in (2, 4, 8) if (model, n) in at.index]
            assert own == sorted(own, reverse=True)
        assert ("spline", 8) not in at.index  # the reference


class TestWithoutRecordings:
    def test_nothing_found(self, arm, nothing_found):
        found = load_trial(arm)
        assert found.source == "synthetic"
        assert len(found.outputs[PCC_2].points) == len(found.outputs[RIGID].points) + 6
        assert found.notes == (f"Not found: {', '.join(OUTPUTS)}.",)
        assert found.scored.shape[1:] == (9, 4)
        orientations, source = bag_orientations("prev_saved_data_to_play.bag", arm)
        assert (source, orientations.shape[1:]) == ("synthetic", (9, 4))
        with pytest.raises(InputError, match="Input name of find_bag"):
            bag_orientations("other.bag", arm)

    def test_some_found(self, arm, nothing_found, monkeypatch, real_sensors):
        """Only the first of the tables: synthetic, and the others named; then a needed and another one damaged."""
        place = written_outputs(nothing_found, monkeypatch, {RIGID: synthetic_outputs(real_sensors)[RIGID]})
        found = load_trial(arm)
        assert found.source == "synthetic"
        assert found.notes == (f"Not found: {', '.join(name for name in OUTPUTS if name != RIGID)}.",)
        less = "fly/less_imu/less_imu_2.csv"
        (place / less).parent.mkdir(parents=True)
        (place / less).write_bytes(b"\xff\xfe\x00damaged")
        found = load_trial(arm)
        assert found.notes[0].startswith(
            f"Input {less} of {OUTPUT_FOLDER} must be the released file, sha256 f2d57ecf"
        )
        assert less not in found.notes[1]
        (place / RIGID).write_text((place / RIGID).read_text()[:-1000])
        with pytest.raises(InputError, match=rf"Input {RIGID} of .* must be the released file, sha256"):
            load_trial(arm)

    def test_those_needed_found(self, arm, nothing_found, monkeypatch, real_sensors):
        outputs = synthetic_outputs(real_sensors)
        written_outputs(nothing_found, monkeypatch, {name: outputs[name] for name in NEEDED})
        found = load_trial(arm)
        assert found.source == "recorded"
        assert list(found.outputs) == [name for name in OUTPUTS if name in NEEDED]
        assert compare_files(found)["same_percent"].min() > 99


def written_outputs(folder, monkeypatch, outputs):
    """Write tables as the released ones are, and take their hashes for those of the released ones."""
    place = folder / OUTPUT_FOLDER
    for name, output in outputs.items():
        start = pd.Timestamp("2022-02-23 15:44:33")
        times = (start + pd.to_timedelta(output.replay_s, unit="s")).strftime("%Y/%m/%d/%H:%M:%S.%f")
        columns = {"time": times}
        for k in range(8):
            given = np.isfinite(output.points[:, k, 0])
            columns[f".ID_{k}"] = np.where(given, k, 0)
            columns |= {f".{a}{k}": np.where(given, output.points[:, k, n], 0.0) for n, a in enumerate("xyz")}
        (place / name).parent.mkdir(parents=True, exist_ok=True)
        pd.DataFrame(columns).to_csv(place / name, index=False, float_format="%.12g")
        monkeypatch.setitem(OUTPUTS, name, hashlib.sha256((place / name).read_bytes()).hexdigest())
    return place


class TestRealErrors:
    """The route for the motion-capture file, on a capture made from known points."""

    @pytest.fixture
    def models(self, trial):
        made = synthetic_outputs(trial)
        return made[RIGID], made[PCC_2]

    @pytest.fixture(autouse=True)
    def short(self, monkeypatch):
        monkeypatch.setattr(captured, "SCORED_ROWS", (100, 1150))

    def capture(self, rigid, move=(0.0, 0.0, 0.0)):
        """What would be seen of the rigid-body model itself, 3 s late, with a gap."""
        markers = rigid.points[:, list(MARKER_POINTS)] + [0, 0, ORIGIN_M] + np.array(move)
        markers[200:220, 1] = np.nan
        return MarkerCapture(rigid.replay_s + 3.0, markers, 20)

    def test_a_model_has_no_error_against_itself(self, models):
        table = captured.capture_errors(*models, 6, self.capture(models[0]))
        own = table[table["output"] == "rigid.csv"]
        assert own["median_mm"].max() < 0.2  # the delay to 0.1 ms, and linear interpolation
        other = table[table["output"] == "pcc2.csv"]
        assert other["median_mm"].min() > 1
        assert own["samples"].max() <= 1050 - 20

    def test_an_offset_is_an_error_until_the_frame_is_fitted(self, models):
        move = np.array([0.006, -0.014, -0.034])
        table = captured.capture_errors(*models, 6, self.capture(models[0], move))
        own = table[table["output"] == "rigid.csv"].set_index(["frame", "marker"])["median_mm"]
        np.testing.assert_allclose(own["origins at the base"], 1e3 * np.linalg.norm(move), atol=0.2)
        assert own["fitted to the first half"].max() < 0.2

    def test_no_file(self, models, nothing_found):
        table, said = captured.real_errors(*models, 6, {})
        assert table.empty
        assert list(table.columns) == captured.COLUMNS
        assert said == "Motion capture not found: no real errors are stated."

    def test_a_file_without_and_with_a_layout(self, models, nothing_found, monkeypatch):
        capture = self.capture(models[0])
        numbers = np.column_stack(
            [capture.time_s, np.zeros((len(capture.time_s), 3)), capture.markers.reshape(-1, 6)]
        )
        names = ["t", "bx", "by", "bz", "x1", "y1", "z1", "x2", "y2", "z2"]
        path = nothing_found / OUTPUT_FOLDER / martin2022_trial.CAPTURE
        path.parent.mkdir(parents=True)
        pd.DataFrame(numbers, columns=names).to_csv(path, index=False)
        content = path.read_bytes()
        blob = hashlib.sha1(b"blob %d\0" % len(content) + content).hexdigest()
        monkeypatch.setattr(martin2022_trial, "CAPTURE_BLOB", blob)
        table, said = captured.real_errors(*models, 6, {})
        assert table.empty
        assert said.startswith(
            "Motion capture found, but what its columns hold is not named: no real errors. Input"
        )
        layout = {"header_row": 0, "first_row": 1, "time_s": "t", "base": names[1:4], "M1": names[4:7]}
        with pytest.raises(InputError, match="names M2"):
            captured.real_errors(*models, 6, layout)
        whole = layout | {"M2": names[7:], "metres_per_unit": 1}
        table, said = captured.real_errors(*models, 6, whole)
        assert said == f"Motion capture found: {len(numbers)} frames, 20 marker positions not seen."
        expected = captured.capture_errors(*models, 6, capture)
        pd.testing.assert_frame_equal(table, expected, rtol=1e-6)


@pytest.fixture(scope="module")
def released():
    outputs = {name: read_output(path) for name in OUTPUTS if (path := find_output(name))}
    if missing := [name for name in NEEDED if name not in outputs]:
        pytest.skip(f"the recordings are not found: {', '.join(missing)}")
    return outputs, trial_orientations(outputs)


class TestReleased:
    """The released tables, where they are found."""

    @pytest.mark.parametrize("name", [name for name in OUTPUTS if name != PCC_16_2])
    def test_points_to_a_micrometre(self, released, name):
        """Every point of every row, but for rows in which base and IMU are half a turn apart (3 of 8,515)."""
        outputs, found = released
        if name not in outputs:
            pytest.skip(f"the recording is not found: {name}")
        line = compared(name, outputs[name], found.orientations)
        assert line["largest_um"] <= 1.0
        assert line["half_turns"] <= 3
        assert line["rows"] >= 7500

    def test_points_of_pcc16_2(self, released):
        """M1 to a micrometre where the turn of IMU #4 is told; M2 for its two equations too many.

        M1 depends on how IMU #4 is turned about the arm, which straight links before it do not tell: there 1e-5 m.
        M2 is no test of its own: IMU #8 is in no other table found here than ``pcc2.csv``, whose last point has two
        equations for it. It is computed from these and the three of M2; for three unknowns, that leaves two.
        """
        outputs, found = released
        points = released_chains()[PCC_16_2].points(found.orientations)
        later = compared(PCC_16_2, outputs[PCC_16_2], found.orientations)["later"]
        theirs = outputs[PCC_16_2].points[later : later + len(points)][:, [4, 7]]
        m1 = np.linalg.norm(points[:, 0] - theirs[:, 0], axis=-1)
        told = found.told_deg[:, :4].min(axis=1) > 1.7
        assert told.mean() > 0.9
        assert m1[told].max() <= 1e-6
        assert (m1 <= 1e-6).mean() > 0.995
        assert m1.max() < 1.1e-5
        assert np.sqrt((m1**2).mean()) < 3e-7
        step = np.linalg.norm(np.diff(points - theirs, axis=1)[:, 0], axis=-1)
        assert step.max() <= 1e-6

    def test_tables_agree_on_the_orientations(self, released):
        """The two equations that each angle has agree to the rounding of the tables."""
        _, found = released
        assert len(found.orientations) == 8515
        assert found.unevenness_deg.max() < 1e-4
        tangent = np.linalg.norm(tangents(found.orientations), axis=-1)
        np.testing.assert_allclose(tangent, 1, atol=1e-12)

    def test_orientations_are_readings_of_the_sensor(self, released):
        """Nothing was said of the sensor's steps of 2^-14; the orientations of IMU #1 are on them in every row."""
        _, found = released
        q = sensor_orientations(found.orientations[:, 1], "y")
        closest = np.full(len(q), np.inf)
        for norm in 2**14 + np.arange(-3.0, 3.01, 0.1):  # of whole numbers near 2^14, not known
            whole = np.round(q * norm)
            whole /= np.linalg.norm(whole, axis=-1, keepdims=True)
            closest = np.minimum(closest, np.linalg.norm(whole - q, axis=-1))
        assert closest.max() < 3e-7  # a hundredth of what any orientation would be off

    def test_figure_5_with_two_imus(self, released):
        """The released chain is as far from the spline as the figure prints at M1, the described one half of that."""
        _, found = released
        table = figure_5(found.orientations[slice(*SCORED_ROWS)], PUBLISHED)
        at = table.set_index(["n_imus", "chain", "marker"])
        assert at["median_mm"][2, "as in the file", "M1"] == pytest.approx(115, abs=1)
        assert at["q75_mm"][2, "as in the file", "M1"] == pytest.approx(159, abs=1.5)
        assert at["median_mm"][2, "as in the file", "M2"] == pytest.approx(115, abs=1)
        assert at["q75_mm"][2, "as in the file", "M2"] == pytest.approx(151, abs=1.5)
        assert at["median_mm"][2, "as described", "M1"] == pytest.approx(61, abs=1)
