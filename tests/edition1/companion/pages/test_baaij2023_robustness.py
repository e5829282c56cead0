"""Random twins: training side by side is the paper's, errors and ratios by hand, the step size of the descent."""

from dataclasses import replace
from functools import partial

import numpy as np
import pandas as pd
import pytest
import torch
from edition1.kernels import training as together
from edition1.kernels._training_step import train_step
from edition1.kernels.training import _dropout, _workspace, train_together
from edition1.sensing.network import _PAPER_WIDTHS, paper_network
from edition1.sensing.training import train_paper
from edition1_companion.book.project import find_project
from edition1_companion.pages.robustness import studies as robustness
from edition1_companion.twins import rig_descent as table2
from edition1_companion.twins.pneumatic_rig import record_rig
from edition1_companion.twins.rig_data import load_recordings
from edition1_companion.twins.rig_filter import filtered
from edition1_companion.twins.rig_map import fit_map
from edition1_companion.twins.rig_networks import RIG_LEARNING_RATE, rig_networks
from edition1_companion.twins.rig_twins import nominal_twin, random_twin
from torch.nn.utils import parameters_to_vector

NETWORKS = find_project().data / "networks"


def toy_rows(n=2000, seed=5):
    """Relations of the size of the rig's, and readings that follow one of them."""
    g = torch.Generator().manual_seed(seed)
    xi = torch.rand(n, 5, generator=g) * torch.tensor([0.3, 0.002, 0.3, 0.3, 0.3])
    xi = xi + torch.tensor([1.0, 0.06, 1.0, 1.0, 1.0])
    return xi, 1300 + 20 * xi[:, 2] + 5 * torch.randn(n, generator=g)


class TestTogether:
    def test_one_step_is_that_of_autograd(self):
        g = torch.Generator().manual_seed(0)
        network, widths = paper_network(5, g), (5, *_PAPER_WIDTHS)
        theta = parameters_to_vector(network.parameters()).detach().clone().numpy()
        start = theta.copy()
        x, y = toy_rows(650)
        g.manual_seed(1)
        loss = torch.nn.functional.mse_loss(network(x), y)
        gradient = torch.autograd.grad(loss, list(network.parameters()))
        g.manual_seed(1)
        kept, space = _dropout(650, widths, g), _workspace(650, widths)
        found = train_step(theta, x.numpy(), y.numpy(), widths, kept, space, np.float32(1e-3))
        assert found == pytest.approx(float(loss.detach()), rel=1e-6)
        expected = 1e-3 * parameters_to_vector(gradient).numpy()
        scale = np.abs(expected).max()
        np.testing.assert_allclose(start - theta, expected, atol=2e-5 * scale)

    def test_result_is_that_of_the_recipe(self, tmp_path):
        """Three epochs: rounding has not yet grown. The second set shows that sets do not mix."""
        rows, options = (
            toy_rows(),
            {"seed": 3, "learning_rate": RIG_LEARNING_RATE, "epochs": 3, "swa_start": 1},
        )
        alone, metrics, _ = train_paper(*rows, checkpoint=tmp_path / "a", progress=False, **options)
        (network, own), _ = train_together([rows, (rows[0], 2 * rows[1])], **options)
        with torch.no_grad():
            np.testing.assert_allclose(network(rows[0]).numpy(), alone(rows[0]).numpy(), atol=1e-3)
        assert own == pytest.approx(metrics, rel=1e-6)

    def test_shuffled_rows_are_all_the_rows_in_another_order_in_every_epoch(self, monkeypatch):
        seen = []

        def recorded(theta, x, y, *_):
            seen.append(y)
            return 0.0

        monkeypatch.setattr(together, "train_step", recorded)
        rows, options = toy_rows(500), {"seed": 3, "learning_rate": 0.1, "epochs": 2, "swa_start": 1}
        for shuffled in (False, True):
            train_together([rows], shuffled=shuffled, **options)  # 350 rows to train on, one batch
        first, second, *new = seen
        np.testing.assert_array_equal(first, second)
        for y in new:
            np.testing.assert_array_equal(np.sort(y), np.sort(first))
        assert len({y.tobytes() for y in (first, *new)}) == 3


def made_up(ours=(1.0, 2.0), known=2.0, family="first"):
    """Two twins, two trajectories; errors of the paper's method are the same everywhere."""
    rows = []
    for twin, error in enumerate(ours):
        for trajectory in ("T0", "T5"):
            errors = {f"{m}_delta_{a}_mm": known for m in robustness.METHODS for a in "xy"}
            errors |= {"ours_delta_x_mm": error, "ours_delta_y_mm": 4 * error}
            kind = {"hysteresis": "bouc-wen", "drift": ("ramp", "constant")[twin], "drift_mV": 1.0}
            extra = {"covered": 0.9, "nees": 1.0, "covered_delta_L": 1.0, "ours_delta_L_mm": 0.03}
            rows.append({"family": family, "twin": twin, **kind, "trajectory": trajectory, **errors, **extra})
    return pd.DataFrame(rows)


class TestTables:
    def test_ratio_is_the_geometric_mean_over_cells(self):
        table = robustness.ratio_by_twin(made_up())
        assert table["known"].tolist() == pytest.approx([1.0, 2.0])  # sqrt(1/2 * 4/2), sqrt(2/2 * 8/2)
        assert table["worst"].tolist() == ["T0 y: 2.00", "T0 y: 4.00"]
        assert table["covered"].tolist() == pytest.approx([0.9, 0.9])

    def test_medians_over_all_twins_and_by_kind(self):
        table = robustness.median_ratios(made_up(), draws=200).set_index(["kind", "against"])
        assert table.loc[("all", "known"), "median"] == pytest.approx(1.5)
        assert table.loc[("all", "mean"), "lost"] == 1
        assert table.loc[("ramp", "shorter"), ["low", "high"]].tolist() == pytest.approx([1.0, 1.0])
        assert table.loc[("all", "known"), "low"] == pytest.approx(1.0)
        assert table.loc[("all", "known"), "high"] == pytest.approx(2.0)

    def test_families_are_not_mixed(self):
        """The same twins with errors three times as large: each family keeps its own numbers."""
        one, other = made_up(), made_up(ours=(3.0, 6.0), family="second")
        medians = partial(robustness.median_ratios, draws=100)
        for tabled in (robustness.ratio_by_twin, medians, robustness.by_trajectory):
            both = tabled(pd.concat([one, other], ignore_index=True))
            columns = [c for c in both.columns if c not in ("low", "high")]  # their draws are others
            for table, name in ((one, "first"), (other, "second")):
                own = both[both["family"] == name].reset_index(drop=True)
                pd.testing.assert_frame_equal(own[columns], tabled(table)[columns])

    def test_trajectories_over_twins_and_axes(self):
        table = robustness.by_trajectory(made_up())
        assert table["trajectory"].tolist() == ["T0", "T5"]
        assert table["known"].tolist() == pytest.approx([2**0.5] * 2)  # of 1/2, 4/2, 2/2, 8/2
        assert table["lost_%"].tolist() == pytest.approx([50.0, 50.0])  # 4/2 and 8/2
        assert table["covered"].tolist() == pytest.approx([0.9, 0.9])


def test_study_of_one_twin_trains_what_is_missing_once(tmp_path, monkeypatch):
    """From nothing to the table, with networks of one epoch; the second call trains nothing."""
    monkeypatch.setattr(robustness, "train_together", partial(train_together, epochs=1, swa_start=0))
    options = {"family": "first", "progress": False}
    table = robustness.robustness_errors(twins=[0], seed=0, longest_s=0.5, cache=tmp_path, **options)
    assert table["trajectory"].tolist() == ["T0", "T1", "T2", "T3", "T4", "T5"]
    assert (table["frames"] == 20).all()
    assert np.isfinite(table.select_dtypes("number")).all(axis=None)
    folder = robustness.twin_folder(random_twin(0), tmp_path)
    assert rig_networks(folder, (0,), twin_sha256=random_twin(0).sha256).n_sensors == 3
    monkeypatch.delattr(robustness, "train_together")
    robustness.train_twins([0], 0, tmp_path, **options)


def test_twins_are_trained_together_where_their_recordings_are_of_one_size(tmp_path, monkeypatch):
    """Of the first family's recordings of T5, those of twins 0 and 1 differ by a row."""
    sizes = []

    def recorded(sets, **options):
        sizes.append([len(rows) for _, rows in sets])
        return train_together(sets, epochs=1, swa_start=0, **options)

    monkeypatch.setattr(robustness, "train_together", recorded)
    robustness.train_twins([0, 1], 0, tmp_path, family="first", progress=False)
    (fewer,), (more,) = (set(group) for group in sizes)
    assert more == fewer + 1
    for seed in (0, 1):
        twin = random_twin(seed)
        assert (
            rig_networks(robustness.twin_folder(twin, tmp_path), (0,), twin_sha256=twin.sha256).n_sensors == 3
        )


def test_families_share_what_they_should():
    first, second, own = (robustness.family_twin(name, 5) for name in robustness.FAMILIES)
    assert first == random_twin(5)
    assert second == random_twin(5, second=True)
    assert (own.board, own.bending, own.hysteresis) == (first.board, first.bending, first.hysteresis)
    # T5 has no bias, so it is the same recording, and the first family's networks were trained on it.
    readings = [record_rig(twin, "T5", seed=0, duration_s=5.0).readings_mv for twin in (first, own)]
    np.testing.assert_array_equal(*readings)
    biases = [
        record_rig(replace(own, gain_scatter=0.0), "T0", seed=k, duration_s=2.0).readings_mv.mean(axis=0)
        - record_rig(
            replace(own, gain_scatter=0.0, bias_scatter_mv=0.0), "T0", seed=k, duration_s=2.0
        ).readings_mv.mean(axis=0)
        for k in range(100)
    ]
    assert np.std(biases, axis=0) == pytest.approx([robustness.OWN_BIAS_MV] * 3, rel=0.25)
    assert abs(np.corrcoef(np.array(biases).T)[0, 1]) < 0.3


@pytest.fixture(scope="module")
def nominal():
    """T2 of the nominal twin, and its committed networks of the first seed."""
    data = load_recordings("twin", trajectories=("T2", "T5"))
    return data, rig_networks(NETWORKS, (0,), twin_sha256=nominal_twin().sha256)


class TestStepSize:
    def test_published_step_is_too_long_for_the_slopes_of_the_twin(self, nominal):
        """Momentum descent on a quadratic of curvature h is stable for step * h < 2 (1 + momentum)."""
        data, _ = nominal
        sensing = table2.rig_sensing(rig_networks(NETWORKS, (0,)).double())
        q = torch.from_numpy(data.tests["T2"].q[::20])
        slopes = torch.func.vmap(torch.func.jacrev(lambda x: sensing(x[None])[0]))(q)[..., :2]
        curvature = torch.linalg.eigvalsh(2 / 3 * slopes.mT @ slopes)[:, -1]
        unstable = table2.STEP_SIZE[0] * curvature > 2 * (1 + table2.MOMENTUM)
        assert float(unstable.double().mean()) > 0.7

    def test_half_the_step_and_twice_the_iterations_do_not_jump(self, nominal):
        """So the jumps are steps that are too long, not other minima; the physics is that of the same networks."""
        data, model = nominal
        errors = {}
        for shorter in (1, 2):
            run = table2.paper_method(
                {"T2": data.tests["T2"]},
                model,
                (0,),
                mean_elongation_m=4.5e-3,
                elongations=("known",),
                shorter=shorter,
            )
            apart = 1e3 * np.abs(run.estimates["known", "T2"][:, 0] - data.tests["T2"].q)[:, :2].max(axis=1)
            errors[shorter] = (apart > 2).mean()
        assert errors[1] > 0.05
        assert errors[2] < 0.03

    def test_ours_on_the_nominal_twin_is_not_lost_either(self, nominal):
        data, _ = nominal
        part = data.tests["T2"]
        run = filtered(fit_map(data.train), part.u)
        assert 1e3 * np.abs(run.q.numpy() - part.q)[:, :2].max() < 2.0
