"""Our filter of the rig on a toy and blind to the future; the rig's networks."""

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pandas as pd
import pytest
import torch
from scipy.signal import lfilter
from twin_of_the_rig import recorded

from edition1.errors import InputError
from edition1.estimation.base import track
from edition1.estimation.kalman_filter import IteratedKalmanFilter
from edition1.sensing.training import train_paper
from edition1_companion.book.project import find_project
from edition1_companion.recordings.baaij2023 import Recording
from edition1_companion.twins import rig_networks as rig_training
from edition1_companion.twins.compiled_rig_filter import bank_step
from edition1_companion.twins.rig_bank import OursConfig
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
    return recorded(("T3", "T5"), longest_s=60.0)


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

    def test_future_readings_do_not_enter(self):
        train, tests = short_data()
        bend_map, u = fit_map(train), tests["T3"].u
        whole, half = filtered(bend_map, u), filtered(bend_map, u[: len(u) // 2])
        np.testing.assert_allclose(half.q, whole.q[: len(half.q)], atol=1e-12)

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

    def test_on_the_nominal_twin_it_is_not_lost(self):
        train, tests = recorded(("T2", "T5"))
        part = tests["T2"]
        run = filtered(fit_map(train), part.u)
        assert 1e3 * np.abs(run.q.numpy() - part.q)[:, :2].max() < 2.0

    def test_slopes_are_those_of_the_map(self):
        bend_map = fit_map(linear_twin(spiral(2000)), degree=2)
        np.testing.assert_allclose(
            bend_map.slopes(np.zeros((2, 2))), np.stack([1e-3 * SLOPES.T] * 2), atol=1e-6
        )


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
            path = train_rig(RigSpec(sensor, 4), tmp_path, tmp_path, part=short_data()[0], progress=False)
        manifest = json.loads(path.with_suffix(".json").read_text())
        assert manifest["recording"] == "synthetic_T5_train"
        assert manifest["learning_rate"] == 5e-5
        assert manifest["metrics_mv"].keys() == {"rmse_train", "rmse_validation"}
        assert manifest["loss_by_epoch"]["unit"] == "mV^2"
        assert "twin_sha256" not in manifest  # given a recording, it does not know of which twin
        monkeypatch.delattr(rig_training, "train_paper")  # a second call trains nothing
        assert train_rig(RigSpec(2, 4), tmp_path, tmp_path, part=short_data()[0]) == path
        assert rig_networks(tmp_path, [4]).n_sensors == 3
        with pytest.raises(InputError, match="must be trained on the twin"):
            rig_networks(tmp_path, [4], twin_sha256=random_twin(0).sha256)

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
        assert not trained_on(short_data()[0], folder, (0, 1, 2), second=second)
