"""The recorded trial: chains that must agree on synthetic outputs, and the released ones where they are found."""

import hashlib
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation
from short_arm import short_arm

from repro.errors import InputError
from repro.estimation.orientations import tangents
from repro.experiments.martin2022 import captured
from repro.experiments.martin2022.draws import drawn
from repro.experiments.martin2022.recorded import (
    compare_chain,
    fewer_imus,
    frames_along,
    link_lengths,
    links,
    outputs,
    synthetic_outputs,
)
from repro.recordings import martin2022_capture
from repro.recordings.martin2022_capture import MarkerCapture
from repro.recordings.martin2022_outputs import MARKER_POINTS, ORIGIN_M, OUTPUT_FOLDER, OUTPUTS, find_output
from repro.sensing.inertial import PERFECT
from repro.simulation.arm_recording import MotionCapture

ROWS = (100, 1000)


@pytest.fixture(scope="module")
def arm():
    return short_arm()


@pytest.fixture(scope="module")
def trial(arm):
    return drawn(arm, 0, PERFECT, MotionCapture(noise_m=0.0)).trial


@pytest.fixture
def nothing_found(tmp_path, monkeypatch):
    monkeypatch.setenv("REPRO_DATA_DIR", str(tmp_path))
    return tmp_path


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


class TestComparison:
    def test_shift_is_found_and_directions_agree(self, trial):
        found = compare_chain(*synthetic_outputs(trial, shift=9), rows=ROWS)
        assert found.shift == 9
        # The rod hardly twists, so frames without twist are those of the IMUs.
        assert found.points["median_mm"].max() < 1.5
        assert found.points["direction_deg"].max() < 0.5
        assert len(found.over_time) == ROWS[1] - ROWS[0]
        np.testing.assert_allclose(
            found.points["median_mm"], found.over_time.drop(columns="row").median(), rtol=1e-12
        )

    def test_turn_about_the_arm_shows_in_the_link_from_the_base_and_is_found(self, trial):
        turn = Rotation.from_euler("z", 120, degrees=True)
        q = trial.orientations.copy()
        q[:, 1:] = (Rotation.from_quat(q[:, 1:].reshape(-1, 4)) * turn).as_quat().reshape(len(q), 8, 4)
        found = compare_chain(*synthetic_outputs(replace(trial, orientations=q)), rows=ROWS)
        assert found.turn_deg == pytest.approx(120, abs=2)
        assert found.points["turned_median_mm"].max() < 1.5
        assert found.points["median_mm"][1:].min() > 2
        assert found.points["from_second_median_mm"][2:].max() < 1.5
        straight = compare_chain(*synthetic_outputs(trial), rows=ROWS)
        assert straight.turn_deg == pytest.approx(0, abs=2)

    @pytest.mark.parametrize("rows", [(10, 500), (500, 400), (100, 10_000)])
    def test_rows_that_are_not_there(self, trial, rows):
        with pytest.raises(
            InputError, match=r"Input rows of compare_chain must be within 40 and \d+; instead"
        ):
            compare_chain(*synthetic_outputs(trial), rows=rows)


def test_links_of_synthetic_outputs(trial):
    table = link_lengths(synthetic_outputs(trial)[0])
    assert table["expected_mm"].tolist() == [102.0] + [80.0] * 6
    assert table["largest_error_mm"].max() < 1e-9


class TestFewerImus:
    def test_all_models_agree_on_a_straight_arm(self):
        table = fewer_imus(np.tile([0.0, 0.0, 0.0, 1.0], (3, 8, 1)))
        np.testing.assert_allclose(table["median_mm"], 0, atol=1e-9)

    def test_fewer_are_further_away(self, trial):
        table = fewer_imus(trial.orientations[::10, 1:])
        at = table[table["point_mm"] == 600].set_index(["model", "n_imus"])["median_mm"]
        spline = [at["spline", n] for n in (2, 4, 8)]
        assert spline == sorted(spline, reverse=True)
        assert ("PCC-extended, 16 segments", 8) not in at.index  # the reference


def test_without_recordings_a_synthetic_trial(arm, nothing_found):
    rigid, pcc, source = outputs(arm)
    assert source == "synthetic"
    assert len(pcc.points) == len(rigid.points) + 6
    orientations, source = links("prev_saved_data_to_play.bag", arm)
    assert (source, orientations.shape[1:]) == ("synthetic", (8, 4))
    with pytest.raises(InputError, match="Input name of find_bag"):
        links("other.bag", arm)


class TestRealErrors:
    """The route for the motion-capture file, on a capture made from known points."""

    @pytest.fixture
    def models(self, trial):
        return synthetic_outputs(trial)

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
        path = nothing_found / OUTPUT_FOLDER / martin2022_capture.CAPTURE
        path.parent.mkdir(parents=True)
        pd.DataFrame(numbers, columns=names).to_csv(path, index=False)
        content = path.read_bytes()
        blob = hashlib.sha1(b"blob %d\0" % len(content) + content).hexdigest()
        monkeypatch.setattr(martin2022_capture, "CAPTURE_BLOB", blob)
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


class TestReleased:
    """The released outputs, where they are found."""

    @pytest.fixture
    def released(self, arm):
        if None in [find_output(name) for name in OUTPUTS]:
            pytest.skip("the recordings are not found")
        return outputs(arm)[:2]

    def test_chain_follows_the_released_one(self, released):
        found = compare_chain(*released)
        assert found.shift == 6
        # Beyond the link from the base, which needs the headings, the directions are the same.
        assert found.points["direction_deg"][2:].max() < 0.6
        assert found.points["from_second_median_mm"].drop(0).max() < 2.0
        assert found.points["median_mm"].max() < 8.5
        assert 170 <= abs(found.turn_deg) <= 180
        assert found.points["turned_median_mm"].max() < 2.6
