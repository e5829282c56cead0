"""Table 2: errors by hand, ours on a toy without noise and blind to the truth, rows of the scorecard, its figures."""

import hashlib
import json
from dataclasses import replace
from functools import cache

import numpy as np
import pandas as pd
import pytest
import torch
from scipy.signal import lfilter

from edition1.errors import InputError
from edition1.estimation.base import track
from edition1.estimation.kalman_filter import IteratedKalmanFilter
from edition1.sensing.ensemble import SeedEnsemble
from edition1.sensing.network import paper_network
from edition1.sensing.training import train_paper
from edition1_companion.book.project import find_project
from edition1_companion.book.published import read_published
from edition1_companion.pages.table_2.scorecard import OWN_NOTE, table_2_rows, table_2_setting
from edition1_companion.pages.table_2.tables import (
    all_cells,
    landscape,
    ours_errors,
    ours_runs,
    series_table,
    shapes_table,
    stills,
    trajectories_table,
)
from edition1_companion.recordings.baaij2023 import FOLDER, NAMES, Recording, raw_paths, split
from edition1_companion.twins import rig_descent as table2
from edition1_companion.twins import rig_networks as rig_training
from edition1_companion.twins.compiled_rig_filter import bank_step
from edition1_companion.twins.pneumatic_rig import record_rig, record_twin
from edition1_companion.twins.rig_bank import OursConfig
from edition1_companion.twins.rig_data import load_recordings
from edition1_companion.twins.rig_files import write_recording
from edition1_companion.twins.rig_filter import filtered
from edition1_companion.twins.rig_map import DEGREE, correlation_s, fit_map, monomials
from edition1_companion.twins.rig_networks import (
    RigSpec,
    rig_networks,
    rig_specs,
    train_rig,
    trained_on,
    training_part,
)
from edition1_companion.twins.rig_twins import nominal_twin, random_twin, second_twin

SLOPES = np.array([[-5300.0, 900.0, -4300.0], [-3000.0, -2800.0, -1200.0]])
LEVEL = np.array([1282.0, 1205.0, 1387.0])


def spiral(n, seed=0):
    """Bends that fill a disc of 8 mm, and a constant elongation."""
    s, turn = np.linspace(0, 1, n), np.random.default_rng(seed).uniform(0, 2 * np.pi)
    r, phi = 8e-3 * np.sqrt(s), 40 * np.pi * s + turn
    return np.stack([r * np.cos(phi), r * np.sin(phi), np.full(n, 4.5e-3)], axis=-1)


def linear_twin(q, bias=0.0):
    """Readings that are linear in the bend, without noise."""
    return Recording("toy", np.arange(len(q)), q, LEVEL + q[:, :2] @ SLOPES + bias)


def noisy(recording, seed=0):
    """With white noise of 0.5 mV, and of 0.02 mm on the elongation."""
    g = np.random.default_rng(seed)
    q = recording.q + [0.0, 0.0, 2e-5] * g.standard_normal(recording.q.shape)
    return replace(recording, q=q, u=recording.u + 0.5 * g.standard_normal(recording.u.shape))


@cache
def short_data():
    """Two minutes of T5 and of T3 of the nominal twin; synthetic."""
    return load_recordings("twin", trajectories=("T3", "T5"), longest_s=60.0)


def degrees(train, candidates=(2, 3, 4, 5, 6, 7, 8), blocks=5):
    """Error of the map on held-out blocks of T5.train, by its degree; nothing else was used to choose."""
    rows, block = [], np.arange(len(train)) * blocks // len(train)
    for degree in candidates:
        columns, square = monomials(1e3 * train.q[:, :2], degree), 0.0
        for k in range(blocks):
            kept = block != k
            factors = np.linalg.lstsq(columns[kept], train.u[kept], rcond=None)[0]
            square += ((train.u[~kept] - columns[~kept] @ factors) ** 2).mean() / blocks
        rows.append({"degree": degree, "readings_mV": square**0.5})
    return pd.DataFrame(rows)


class TestErrors:
    def test_readings_are_normalised_by_the_pooled_range_with_offsets(self):
        u = np.array([[100.0, 200.0, 300.0], [110.0, 190.0, 350.0]])
        part = Recording("toy", np.arange(2), np.zeros((2, 3)), u)
        # Errors of the sensors: 3 and 1 (RMS sqrt 5), 2 and 2 (2), 0 and 0. Range: 350 - 100.
        predicted = u[:, None] + np.array([[3.0, 2.0, 0.0], [1.0, -2.0, 0.0]])[:, None]
        cells = table2.reading_errors(predicted, part, part)
        e_u = (5**0.5 + 2 + 0) / 3
        assert [c["error"] for c in cells] == pytest.approx([e_u, 100 * e_u / 250])
        assert [c["unit"] for c in cells] == ["mV", "%"]

    def test_ranges_are_those_of_the_whole_part(self):
        q = np.array([[0.0, 0.0, 0.0], [2e-3, 1e-3, 0.0], [8e-3, 4e-3, 0.0]])
        whole = linear_twin(q)
        part = Recording("toy", np.arange(2), q[:2], whole.u[:2])
        found = q[:2, None] + np.array([1e-3, -1e-3, 0.0])
        cells = {(c["quantity"], c["unit"]): c["error"] for c in table2.bend_errors(found, part, whole)}
        assert cells == pytest.approx(
            {("delta_x", "mm"): 1, ("delta_x", "%"): 12.5, ("delta_y", "mm"): 1, ("delta_y", "%"): 25}
        )


class TestOurs:
    def test_exact_where_readings_are_linear_and_without_noise(self):
        bend_map = fit_map(linear_twin(spiral(2000)), degree=1)
        test = linear_twin(spiral(2000, seed=1)[:400])
        run = filtered(bend_map, test.u)
        assert np.abs(run.q[:, :2].numpy() - test.q[:, :2])[40:].max() < 2e-5
        assert abs(run.diagnostics["bias_mv"][-1]) < 1e-6

    def test_bias_is_found_where_the_slopes_do_not_hide_it(self):
        """The normal of these slopes is nearly across (1, 1, 1): far from all of a bias shows in a frame."""
        train = noisy(linear_twin(spiral(4000)))
        test = noisy(linear_twin(spiral(4000, seed=1)[:2000], bias=-3.0), seed=1)
        run = filtered(fit_map(train, degree=1), test.u)
        # The elongation takes its share of what the sensors have in common.
        bias_mv = run.diagnostics["bias_mv"][-1].item()
        share = bias_mv / -3.0
        assert 0.5 < share <= 1.0
        elongation = run.q[-1, 2].item() - train.q[:, 2].mean()
        slope = fit_map(train, degree=1).elongation_slope
        assert bias_mv + slope * 1e3 * elongation == pytest.approx(-3.0, abs=0.3)
        assert np.abs(run.q[-1, :2].numpy() - test.q[-1, :2]).max() < 3e-4
        assert run.diagnostics["bias_deviation_mv"][-1] < run.diagnostics["bias_deviation_mv"][0]

    def test_truth_and_future_readings_do_not_enter(self):
        data = short_data()
        bend_map = fit_map(data.train)
        part = data.tests["T3"]
        moved = replace(part, q=part.q + 1e-3)
        first = ours_runs(bend_map, {"T3": part})["T3"]
        second = ours_runs(bend_map, {"T3": moved})["T3"]
        assert torch.equal(first.q, second.q)
        assert torch.equal(first.covariance, second.covariance)
        half = filtered(bend_map, part.u[: len(part) // 2])
        np.testing.assert_allclose(half.q, first.q[: len(half.q)], atol=1e-12)

    def test_one_filter_of_the_bank_is_the_kalman_filter(self):
        """A linear map, one bias and no slow errors: the same as the filter in torch, an independent route."""
        g, n = np.random.default_rng(0), 60
        factors = np.array([[10.0, 20.0, 30.0], [-5.0, 1.0, -4.0], [-3.0, -3.0, -1.0]])
        path = np.cumsum(0.05 * g.standard_normal((n, 2)), axis=0)
        u = factors[0] + path @ factors[1:] + 0.5 * g.standard_normal((n, 3))
        width = 20.0
        spread = np.array([*[2 * width / 12**0.5] * 2, 2.0, 2.0, *[1e-6] * 3])
        model = (
            factors, 1, 1.0, np.zeros(1), np.zeros((1, 2)), width * np.array([[-1.0, -1.0], [1.0, 1.0]]),
            np.array([1 / 40, 1.0, 3.0, 5.0]), np.full(3, 0.5), np.full(3, 1e-6),
        )  # fmt: skip
        bank, parts = (np.zeros((1, 7)), np.diag(spread**2)[None], np.zeros(1)), []
        for frame, reading in enumerate(u):
            *bank, mean, covariance, weight, _, _ = bank_step(frame, reading, *bank, *model)
            parts.append((mean, covariance, weight))
        means, covariances, weights = (np.stack(x) for x in zip(*parts, strict=True))
        bound, one = torch.full((2,), width, dtype=torch.float64), torch.ones(2, dtype=torch.float64)
        level, slopes = torch.from_numpy(factors[0]), torch.from_numpy(factors[1:])
        method = IteratedKalmanFilter(
            lambda q: level + q @ slopes, -bound, bound, 3.0 * one, 2.0 * one, noise_mt=0.5
        )
        found = track(method, torch.from_numpy(u), torch.zeros(2, dtype=torch.float64), rate_hz=40.0)
        np.testing.assert_allclose(means[:, :2], found.q.numpy(), atol=1e-6)
        assert found.covariance is not None
        np.testing.assert_allclose(covariances, found.covariance.numpy(), rtol=1e-4, atol=1e-9)
        assert (weights == 1.0).all()

    def test_covariance_is_that_of_many_noisy_recordings(self):
        """Known map, white noise of its own size, no other shape: the spread of the last bend is what it says."""
        train = noisy(linear_twin(spiral(4000)))
        config = OursConfig(shape_mv=1e-3, bias_mv=5.0, step_mv=0.5, widest_mv=15.0)
        bend_map, test = fit_map(train, degree=1), linear_twin(spiral(4000, seed=1)[2000:2060])
        g = np.random.default_rng(2)
        runs = [
            filtered(bend_map, noisy(test, seed=100 + k).u + 5 * g.standard_normal(), config)
            for k in range(40)
        ]
        error = np.stack([run.q[-1, :2].numpy() - test.q[-1, :2] for run in runs])
        C = np.stack([run.covariance[-1, :2, :2].numpy() for run in runs])
        normalised = np.einsum("ni,ni->n", error, np.linalg.solve(C, error[..., None])[..., 0])
        assert normalised.mean() == pytest.approx(2.0, abs=0.95)  # 2 +- 0.32 for 40 draws

    def test_elongation_that_goes_with_the_bend_is_in_the_map_and_not_in_its_spread(self):
        train = noisy(linear_twin(spiral(4000)))
        bend_mm, free = 1e3 * train.q[:, :2], 0.02 * np.random.default_rng(3).standard_normal(4000)
        longer = 5.4 + 0.025 * (bend_mm**2).sum(axis=1) + free
        bend_map = fit_map(replace(train, q=np.column_stack([train.q[:, :2], 1e-3 * longer])), degree=1)
        assert bend_map.elongation_mm == pytest.approx([5.4, 0.025], rel=2e-3)
        assert bend_map.elongation_spread_mm == pytest.approx(0.02, rel=0.05)
        assert np.abs(bend_map.elongation(bend_mm) - longer + free).max() < 5e-3

    def test_elongation_interval_holds_the_spread_between_recordings(self):
        """Known map, recordings whose mean elongation differs by the known 0.3 mm: 95 % of the intervals hold."""
        train = noisy(linear_twin(spiral(4000)))
        bend_map, test, g = (
            fit_map(train, degree=1),
            linear_twin(spiral(4000, seed=1)[:400]),
            np.random.default_rng(4),
        )
        run = filtered(bend_map, noisy(test, seed=5).u)
        deviation = run.covariance[-1, 2, 2].sqrt().item()
        errors = run.q[-1, 2].item() - test.q[-1, 2] + 3e-4 * g.standard_normal(2000)
        assert (np.abs(errors) < 1.96 * deviation).mean() == pytest.approx(0.95, abs=0.03)

    def test_settings_come_from_the_training_part(self):
        train = noisy(linear_twin(spiral(4000)))
        table = degrees(train, (1, 2))
        assert list(table.columns) == ["degree", "readings_mV"]
        assert table["readings_mV"].to_numpy() == pytest.approx([0.5, 0.5], rel=0.05)
        bend_map = fit_map(train, degree=1)
        assert bend_map.noise_mv == pytest.approx([0.5] * 3, rel=0.05)
        assert (bend_map.error_mv < 0.15).all()

    def test_degree_of_the_page_is_chosen_on_the_training_part(self):
        """The rule in words: the smallest within 3 % of the best."""
        table = degrees(training_part(nominal_twin()))
        good = table[table["readings_mV"] < 1.03 * table["readings_mV"].min()]
        assert good["degree"].min() == DEGREE

    def test_time_of_a_gauss_markov_error_is_found(self):
        g, keep = np.random.default_rng(0), np.exp(-1 / 40 / 1.5)
        error = lfilter([1.0], [1.0, -keep], g.standard_normal((200_000, 3)), axis=0)
        assert correlation_s(error) == pytest.approx(1.5, rel=0.1)
        assert correlation_s(error + 3 * error.std() * g.standard_normal(error.shape)) == pytest.approx(
            1.5, rel=0.2
        )

    def test_slopes_are_those_of_the_map(self):
        bend_map = fit_map(linear_twin(spiral(2000)), degree=2)
        np.testing.assert_allclose(
            bend_map.slopes(np.zeros((2, 2))), np.stack([1e-3 * SLOPES.T] * 2), atol=1e-6
        )


class TestData:
    def test_parts_of_the_twin(self):
        data = short_data()
        assert list(data.tests) == ["T3", "T5"]
        assert data.twin_sha256 == nominal_twin().sha256
        assert len(data.train) / len(data.tests["T5"]) == pytest.approx(7 / 3, rel=0.01)
        assert len(data.shortened(2.0)["T3"]) == 80
        assert len(data.shortened(0.0)["T3"]) == len(data.tests["T3"])

    @pytest.mark.parametrize(
        ("options", "message"),
        [
            ({"source": "rig"}, "Input source of load_recordings must be one of 'auto'"),
            ({"trajectories": ("T9",)}, "Input trajectories of load_recordings must be among T0"),
            ({"source": "recorded"}, "must be recorded: the authors' raw files of T0"),
        ],
    )
    def test_wrong_input_is_refused(self, options, message, tmp_path):
        with pytest.raises(InputError, match=message):
            load_recordings(**{"folder": tmp_path} | options)


@pytest.fixture
def found(tmp_path, monkeypatch):
    """Made-up files of T3 and T5 under the authors' names, where recordings are looked for; and their list."""
    monkeypatch.setenv("REPRO_DATA_DIR", str(tmp_path))
    listed = []
    for trajectory in ("T3", "T5"):
        raw = record_rig(nominal_twin(), trajectory, seed=3, duration_s=30.0)
        for path in write_recording(tmp_path / FOLDER, NAMES[trajectory], raw.track, raw.readings_mv):
            place = path.relative_to(tmp_path / FOLDER).as_posix()
            listed.append({"path": place, "sha256": hashlib.sha256(path.read_bytes()).hexdigest()})
    source = {"repository": "https://github.com/owner/name", "commit": "0" * 40, "files": listed}
    manifest = tmp_path / "sources.json"
    manifest.write_text(json.dumps({FOLDER: source}))
    return manifest


class TestFilesUnderTheAuthorsNames:
    TRAJECTORIES = ("T3", "T5")

    def test_that_are_not_theirs_get_no_verdict(self, found):
        data = load_recordings(trajectories=self.TRAJECTORIES, sources=find_project().data / "sources.json")
        assert data.label == "recordings of your own under these names"
        assert data.twin_sha256 is None
        assert len(data.own_files) == 4
        assert data.remarks[0].startswith(
            "Not the authors' files, so nothing is compared with print: 2022-05-02_T3"
        )
        setting = table_2_setting(None, own_files=True)
        assert setting.startswith("recordings not of the authors; as released")
        table = TestScorecard().errors()
        best = table[["row", "quantity", "unit", "error"]]
        rows = scorecard_rows(table, setting=setting, own_files=True, best=best)
        assert not any(row["comparable"] for row in rows)
        assert {row["note"] for row in rows} == {OWN_NOTE}
        assert not any("best" in row for row in rows)

    def test_without_a_list_none_are_theirs(self, found):
        assert load_recordings(trajectories=self.TRAJECTORIES).own_files

    def test_with_their_hashes_are_compared_and_one_other_byte_is_not(self, found):
        theirs = load_recordings("recorded", trajectories=self.TRAJECTORIES, sources=found)
        assert theirs.twin_sha256 is None
        assert theirs.own_files == ()
        assert theirs.label == "recorded by the authors"
        assert theirs.remarks == []
        path = raw_paths(NAMES["T3"])[1]
        path.write_bytes(path.read_bytes()[:-2] + b"1\n")
        data = load_recordings("recorded", trajectories=self.TRAJECTORIES, sources=found)
        assert data.own_files == (path.name,)


class TestNetworks:
    def test_one_for_each_twin_sensor_and_seed(self):
        names = [spec.name for spec in rig_specs()]
        assert len(set(names)) == 18
        assert (names[0], names[-1]) == ("rig_sensor1_seed0", "rig_second_sensor3_seed2")

    def test_is_written_once_with_its_manifest_and_belongs_to_its_twin(self, tmp_path, monkeypatch):
        def short(xi, u, **options):
            return train_paper(xi, u, epochs=1, swa_start=0, **options)

        monkeypatch.setattr(rig_training, "train_paper", short)
        for sensor in range(3):
            path = train_rig(RigSpec(sensor, 4), tmp_path, tmp_path, part=short_data().train, progress=False)
        manifest = json.loads(path.with_suffix(".json").read_text())
        assert manifest["recording"] == "synthetic_T5_train"
        assert manifest["learning_rate"] == 5e-5
        assert manifest["metrics_mv"].keys() == {"rmse_train", "rmse_validation"}
        assert manifest["loss_by_epoch"]["unit"] == "mV^2"
        assert "twin_sha256" not in manifest  # given a recording, it does not know of which twin
        monkeypatch.delattr(rig_training, "train_paper")  # a second call trains nothing
        assert train_rig(RigSpec(2, 4), tmp_path, tmp_path, part=short_data().train) == path
        assert rig_networks(tmp_path, [4]).n_sensors == 3
        with pytest.raises(InputError, match="must be trained on the twin"):
            rig_networks(tmp_path, [4], twin_sha256=random_twin(0).sha256)

    def test_recorded_anew_is_trained_anew_and_says_so(self, tmp_path, monkeypatch, capsys):
        """The same twin, name and number of frames, other noise: the networks of before must not answer for it."""

        def short(xi, u, **options):
            return train_paper(xi, u, epochs=1, swa_start=0, **options)

        monkeypatch.setattr(rig_training, "train_paper", short)
        committed, cache = tmp_path / "committed", tmp_path / "cache"
        anew = record_twin(nominal_twin(), seed=1, trajectories=("T5",), longest_s=60.0).read["T5"]
        n = min(len(short_data().train), len(split(anew)[0]))
        before, after = (
            replace(short_data(), train=replace(part, frame=part.frame[:n], q=part.q[:n], u=part.u[:n]))
            for part in (short_data().train, split(anew)[0])
        )
        assert before.train.name == after.train.name
        first = table2.networks(before, [4], committed, cache, progress=False)
        said = capsys.readouterr().out
        assert f"No networks are kept that were trained on this synthetic_T5 ({n} frames" in said
        assert "3 are trained now" in said
        second = table2.networks(after, [4], committed, cache, progress=False)
        assert "3 are trained now" in capsys.readouterr().out
        xi = torch.from_numpy(after.train.relations()[None, :5]).float()
        with torch.no_grad():
            assert not torch.equal(first(xi), second(xi))
        monkeypatch.delattr(rig_training, "train_paper")  # each is kept for its own readings
        again = table2.networks(before, [4], committed, cache, progress=False)
        with torch.no_grad():
            assert torch.equal(first(xi), again(xi))
        assert capsys.readouterr().out == ""
        kept = next(cache.glob("synthetic_T5_*"))
        other = before if trained_on(after.train, kept, [4]) else after
        with pytest.raises(
            InputError, match=r"networks of rig_sensor1_seed4\.safetensors must be trained on"
        ):
            train_rig(RigSpec(0, 4), kept, kept, part=other.train, progress=False)

    def test_training_shows_no_bar_in_a_notebook(self, tmp_path, monkeypatch, capsys):
        def short(xi, u, **options):
            return train_paper(xi, u, epochs=2, swa_start=0, **options)

        monkeypatch.setattr(rig_training, "train_paper", short)
        table2.networks(short_data(), [4, 5], tmp_path, tmp_path)
        shown = capsys.readouterr()
        assert shown.err == ""  # as in a kernel, no terminal
        assert "6 are trained now, about a minute each." in shown.out

    @pytest.mark.skipif(
        not all(
            (find_project().data / "networks" / f"{spec.name}.safetensors").exists() for spec in rig_specs()
        ),
        reason="the networks of the rig are made by make train",
    )
    @pytest.mark.parametrize("second", [False, True])
    def test_committed_ones_belong_to_their_twin(self, second):
        folder, twins = find_project().data / "networks", (nominal_twin(), second_twin())
        own, other = (training_part(twins[k]) for k in (second, not second))
        found = rig_networks(folder, (0, 1, 2), second=second, twin_sha256=twins[second].sha256)
        assert found.n_seeds == 3
        assert trained_on(own, folder, (0, 1, 2), second=second)
        assert not trained_on(other, folder, (0, 1, 2), second=second)
        assert not trained_on(short_data().train, folder, (0, 1, 2), second=second)


def toy_networks(seeds=2):
    """Networks on angles that are not trained: enough for shapes and the flow of a run."""
    return SeedEnsemble(
        [
            [paper_network(5, torch.Generator().manual_seed(10 * s + j)).eval() for j in range(3)]
            for s in range(seeds)
        ],
        range(3),
    )


@cache
def short_run(solver="torch"):
    parts = short_data().shortened(0.2)
    return table2.paper_method(parts, toy_networks(), (0, 1), mean_elongation_m=4.5e-3, solver=solver)


class TestPaperMethod:
    def test_elongation_is_held_at_the_truth_or_at_its_mean(self):
        run, part = short_run(), short_data().shortened(0.2)["T3"]
        assert np.array_equal(run.estimates["known", "T3"][:, 0, 2], part.q[:, 2])
        assert (run.estimates["mean", "T3"][:, :, 2] == 4.5e-3).all()
        assert run.predicted["T3"].shape == (8, 2, 3)

    def test_one_row_for_each_cell_and_ranges_of_the_whole_part(self):
        table = table2.paper_errors(short_run(), short_data())
        assert len(table) == 2 * 2 * 2 * 6  # elongations, trajectories, seeds, cells
        assert set(table["row"]) == {"T5.train->T3.test", "T5.train->T5.test"}
        known = table[table["elongation"] == "known"]
        assert (known.groupby(["row", "quantity", "unit"])["error"].count() == 2).all()


class TestFigureTables:
    def test_descent_of_the_landscape_is_that_of_the_method(self):
        """From a straight start, with the elongation known, the best of 20 evaluations."""
        data, model = short_data(), toy_networks()
        grid, path = landscape(data, model, (0, 1), time_s=1.0, points=10)
        assert len(grid) == 100
        assert len(path) == 21
        assert grid["rmse_mV"].max() <= 100.0
        one = replace(data.tests["T5"], q=data.tests["T5"].q[40:41], u=data.tests["T5"].u[40:41])
        sensing = table2.rig_sensing(model)
        gamma = torch.tensor(table2.STEP_SIZE, dtype=torch.float64)
        descent = table2.GradientDescent(sensing, gamma, table2.MOMENTUM, table2.ITERATIONS)
        q0 = torch.from_numpy(one.q[0] * [0.0, 0.0, 1.0]).expand(2, 3)
        _, found = descent.step(descent.init(q0), torch.from_numpy(one.u[0]).expand(2, 3), 0.0)
        best = path[path["iteration"] >= 0].sort_values("rmse_mV").iloc[0]
        assert 1e3 * float(found.q[0, 0]) == pytest.approx(best["delta_x_mm"], rel=1e-6)

    def test_time_beyond_the_part_is_refused(self):
        with pytest.raises(InputError, match="within T5's test part"):
            landscape(short_data(), toy_networks(), (0, 1), time_s=1e4)

    def test_tables_for_figures(self):
        data, run = short_data(), short_run()
        ours = ours_runs(fit_map(data.train), data.tests)
        series = series_table(run, ours, ("T3", "T5"))
        assert len(series) == 2 * 2 * 8
        assert series.notna().all(axis=None)
        shapes, parts = stills(run)
        assert set(shapes["seed"]) == {-1, 0, 1}
        assert set(parts["part"]) == {"magnet", "sensor"}
        paths = trajectories_table(data.tests, longest_s=1.0)
        straight = paths["tip_z_mm"] <= 106.05 + 4.7
        assert straight.all()
        assert len(paths) == 20
        assert set(shapes_table(data.tests, shapes=3)["shape"]) == {0, 1, 2}


def scorecard_rows(table, **options):
    """Rows of recordings by the authors, without a best value or a chaotic row, if not said otherwise."""
    none = {
        "best": table[["row", "quantity", "unit", "error"]].iloc[:0],
        "rounding": pd.DataFrame({"chaotic": [False]}),
    }
    return table_2_rows(table, **({"setting": "x", "synthetic": False, "own_files": False} | none | options))


class TestScorecard:
    @staticmethod
    def errors():
        """Printed cells of Table 2 as if three seeds gave each of them exactly."""
        rows = []
        for key in published():
            for seed in range(3):
                value = float(published()[key].value)
                rows.append(
                    dict(zip(("row", "quantity", "unit"), key[2:], strict=True))
                    | {"seed": seed, "error": value}
                )
        return pd.DataFrame(rows)

    def test_every_published_key_is_there_and_none_else(self):
        rows = scorecard_rows(self.errors(), synthetic=True)
        keys = {(r["artefact"], r["row"], r["quantity"], r["unit"]) for r in rows}
        expected = {
            (key.artefact, key.row, key.quantity, key.unit)
            for key in read_published(find_project().published)
            if key.paper == "baaij2023"
            and (key.artefact in ("Table 2", "Section 5.5") or key.row == "experiments mean relative error")
        }
        assert keys == expected
        assert len(rows) == 37

    def test_means_of_the_text_follow_from_the_printed_cells(self):
        rows = {r["artefact"]: r for r in scorecard_rows(self.errors())}
        assert rows["Abstract"]["regenerated"] == pytest.approx(4.5, abs=0.05)
        assert rows["Section 5.5"]["regenerated"] == pytest.approx(3.1, abs=0.05)

    def test_twin_is_never_comparable_and_has_no_best(self):
        best = self.errors()
        synthetic = scorecard_rows(self.errors(), synthetic=True, best=best)
        assert all(
            r["comparable"] is False and "best" not in r and "synthetic" in r["note"] for r in synthetic
        )
        recorded = scorecard_rows(self.errors(), best=best)
        assert all("comparable" not in r for r in recorded)
        assert {r["quantity"] for r in recorded if "best" in r} == {"delta_x", "delta_y", "mean"}

    def test_setting_names_the_twin_and_what_was_cut(self):
        text = table_2_setting("0123456789", longest_s=5.0)
        assert text.startswith("synthetic twin 01234567; as released")
        assert text.endswith("here the first 5 s of each test part")
        assert "split 70/30" in text
        assert "synthetic" not in table_2_setting(None)

    def test_means_need_all_trajectories(self):
        part = self.errors()
        part = part[part["row"] != "T5.train->T4"]
        assert {r["artefact"] for r in scorecard_rows(part, synthetic=True)} == {"Table 2"}


@cache
def published():
    rows = read_published(find_project().published)
    return {key: row for key, row in rows.items() if key.artefact == "Table 2" and key.paper == "baaij2023"}


def test_beside_has_every_row_and_column():
    data = short_data()
    bend_map = fit_map(data.train)
    paper = table2.paper_errors(short_run(), data)
    ours = ours_errors(ours_runs(bend_map, data.shortened(0.2)), bend_map, data)
    printed = pd.DataFrame(
        [
            {
                "row": key.row,
                "quantity": key.quantity,
                "unit": key.unit,
                "published": 1.0,
                "published_std": 0.1,
            }
            for key in published()
        ]
    )
    table = all_cells(printed, paper, ours)
    assert len(table) == 12
    assert table.notna().all(axis=None)
