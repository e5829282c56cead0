"""Both recipes: determinism, resuming, averaging of weights, batch-norm refresh, divergence, and a real fit."""

import math
from itertools import pairwise

import pytest
import torch
from torch import nn

from edition1.errors import InputError
from edition1.sensing import training
from edition1.sensing._paper_training import first_draws, rmse
from edition1.sensing.fast_training import _split_rows, train_dipole_residual, train_fast
from edition1.sensing.network import DipoleResidual, PerSensor, paper_network
from edition1.sensing.relations import relations
from edition1.sensing.training import train_paper
from edition1_companion.twins.networks import segment_rows, train_own, training_rows
from edition1_companion.twins.training_set import training_set


@pytest.fixture(scope="module")
def rows():
    """Two batches of training rows after the split."""
    xi, u = training_rows(1, 0, False, samples=600)
    return xi[:1700], u[:1700]


def one_segment_rows(samples):
    data = training_set(1, seed=1, samples=samples)
    return segment_rows(data, relations(data.robot, data.q).cosines(), 0)


@pytest.fixture(scope="module")
def cosine_rows():
    return one_segment_rows(4000)


def paper(rows, path, **options):
    defaults = {"seed": 0, "learning_rate": 0.05, "epochs": 4, "swa_start": 2, "progress": False}
    return train_paper(*rows, checkpoint=path, **(defaults | options))


def error_on_validation_rows(network, rows, seed=0):
    """By the rule of the released code, with torch's own random numbers."""
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        order = torch.randperm(len(rows[0]))
    validation = order[len(order) - int(0.3 * len(order)) :]
    return rmse(network.eval(), rows[0][validation], rows[1][validation])


def equal(a, b):
    return all(
        torch.equal(x, y) for x, y in zip(a.state_dict().values(), b.state_dict().values(), strict=True)
    )


def test_split_is_a_partition():
    train, validation = _split_rows(1000, 3)
    assert len(validation) == 300
    assert sorted(torch.cat([train, validation]).tolist()) == list(range(1000))
    assert not torch.equal(train, _split_rows(1000, 4)[0])


class TestStreamOfTheReleasedCode:
    """What seed n means: everything is drawn as a program draws that seeds torch and then trains."""

    def test_first_weights_of_the_published_network(self):
        """One segment, seed 0, 360,000 rows: near those of the released network, which are 250 epochs further."""
        network, *_ = first_draws(360_000, 5, 0)
        found = network[2].weight.detach().flatten()[:4]
        assert found.tolist() == pytest.approx([0.209, -0.090, -0.332, -0.002], abs=6e-4)
        released = [0.173, -0.136, -0.325, 0.050]
        assert found.tolist() == pytest.approx(released, abs=0.06)

    @pytest.mark.parametrize("rows", [1001, 1700])
    def test_all_draws_are_those_of_torch(self, rows):
        with torch.random.fork_rng():
            torch.manual_seed(7)
            order = torch.randperm(rows)
            widths = (9, 96, 256, 64, 24, 1)
            layers = [nn.Linear(a, b) for a, b in pairwise(widths)]
            data = torch.utils.data.TensorDataset(order)
            loaded = lambda: iter(torch.utils.data.DataLoader(data, 650))  # noqa: E731
            loaded()
            loaded()
            mask = nn.functional.dropout(torch.ones(650, 9), 0.01)
        network, generator, train, validation = first_draws(rows, 9, 7)
        assert torch.equal(torch.cat([train, validation]), order)
        assert len(validation) == int(0.3 * rows)
        ours = [m for m in network if isinstance(m, nn.Linear)]
        for a, b in zip(ours, layers, strict=True):
            assert torch.equal(a.weight, b.weight)
            assert torch.equal(a.bias, b.bias)
        training.begin_pass(generator)
        assert torch.equal(network[1](torch.ones(650, 9)), mask)

    def test_three_epochs_are_those_of_a_plain_program(self, rows, tmp_path):
        """Loaders, torch's own dropout and its averaging of weights, written out without this project."""
        xi, u = rows
        widths = (xi.shape[1], 96, 256, 64, 24)
        with torch.random.fork_rng():
            torch.manual_seed(5)
            order = torch.randperm(len(xi))
            cut = len(xi) - int(0.3 * len(xi))
            layers = [nn.BatchNorm1d(widths[0])]
            for a, b in pairwise(widths):
                layers += [nn.Dropout(0.01), nn.Linear(a, b), nn.ReLU(), nn.BatchNorm1d(b)]
            network = nn.Sequential(*layers, nn.Linear(24, 1))
            data = torch.utils.data.TensorDataset(xi, u)
            load, check = (
                torch.utils.data.DataLoader(torch.utils.data.Subset(data, part.tolist()), 650)
                for part in (order[:cut], order[cut:])
            )
            optimiser, average = torch.optim.SGD(network.parameters(), lr=0.05), torch.optim.swa_utils
            average = average.AveragedModel(network)
            iter(check)
            for epoch in range(3):
                if epoch >= 1:
                    average.update_parameters(network)
                for x, y in load:
                    optimiser.zero_grad()
                    nn.functional.mse_loss(network(x).squeeze(), y).backward()
                    optimiser.step()
                iter(check)
            torch.optim.swa_utils.update_bn(load, average)
        found, *_ = paper(rows, tmp_path / "state", seed=5, epochs=3, swa_start=2)
        with torch.no_grad():
            expected = average.module.eval()(xi).squeeze()
            torch.testing.assert_close(found(xi), expected, rtol=1e-5, atol=1e-5)


class TestPaperRecipe:
    def test_same_seed_same_bits(self, rows, tmp_path):
        (a, *_), (b, *_), (c, *_) = (paper(rows, tmp_path / f"{k}", seed=k // 2) for k in range(3))
        assert equal(a, b)
        assert not equal(a, c)
        assert not a.training

    def test_resumed_equals_uninterrupted(self, rows, tmp_path, monkeypatch):
        """Interrupted in the middle of the third epoch, after its first batch."""
        expected, metrics, curve = paper(rows, tmp_path / "whole")
        epoch, calls = training._epoch, []

        def interrupted(network, optimiser, x, y):
            calls.append(1)
            if len(calls) == 3:
                epoch(network, optimiser, x[:650], y[:650])
                raise KeyboardInterrupt
            return epoch(network, optimiser, x, y)

        monkeypatch.setattr(training, "_epoch", interrupted)
        with pytest.raises(KeyboardInterrupt):
            paper(rows, tmp_path / "parts")
        network, again, same = paper(rows, tmp_path / "parts")
        assert len(calls) == 3 + 2  # two whole epochs, one lost, two more
        assert equal(network, expected)
        assert again == metrics
        assert torch.equal(same, curve)

    def test_state_of_another_training_is_refused(self, rows, tmp_path):
        xi, u = rows
        paper(rows, tmp_path / "state")
        for others in ((xi, u + 1e-3), (xi + 1e-3, u)):
            with pytest.raises(InputError, match="Input checkpoint of train_paper must be of the same data"):
                paper(others, tmp_path / "state")

    def test_result_is_the_mean_of_the_weights_at_the_beginnings_of_epochs(self, rows, tmp_path, monkeypatch):
        """From the second epoch on: after 1, 2, 3 and 4 of five epochs."""
        epoch, begins = training._epoch, []

        def recorded(network, optimiser, x, y):
            begins.append([p.detach().clone() for p in network.parameters()])
            return epoch(network, optimiser, x, y)

        monkeypatch.setattr(training, "_epoch", recorded)
        network, *_ = paper(rows, tmp_path / "state", epochs=5, swa_start=2)
        for p, *at_beginnings in zip(network.parameters(), *begins[1:], strict=True):
            torch.testing.assert_close(p.detach(), torch.stack(at_beginnings).mean(0))

    def test_curve_holds_the_losses_of_every_epoch(self, rows, tmp_path, monkeypatch):
        """Those on the validation rows without dropout, from the weights at the end of the epoch."""
        save, ends = training._save, []

        def recorded(path, network, *others):
            ends.append(error_on_validation_rows(network, rows) ** 2)
            save(path, network, *others)

        monkeypatch.setattr(training, "_save", recorded)
        _, _, curve = paper(rows, tmp_path / "state")
        assert curve.shape == (4, 2)
        assert curve[:, 1].tolist() == pytest.approx(ends)
        assert float(curve[3, 0]) < float(curve[0, 0])

    def test_refreshed_batch_norm_has_the_statistics_of_the_data(self):
        """The first one sees the raw inputs: mean over batches of their means and (unbiased) variances."""
        network = paper_network(5, torch.Generator().manual_seed(0))
        x = 2 + 3 * torch.randn(3 * training.BATCH, 5, generator=torch.Generator().manual_seed(1))
        network(x)  # statistics that must be forgotten
        training.refresh_batch_norm(network, x)
        batches = x.unflatten(0, (3, -1))
        torch.testing.assert_close(network[0].running_mean, batches.mean(1).mean(0))
        torch.testing.assert_close(network[0].running_var, batches.var(1).mean(0))
        assert network[0].momentum == 0.1

    def test_metrics_are_those_of_the_result(self, rows, tmp_path):
        network, metrics, _ = paper(rows, tmp_path / "state")
        assert metrics["rmse_validation"] == pytest.approx(error_on_validation_rows(network, rows))

    def test_divergence_is_an_error(self, rows, tmp_path):
        with pytest.raises(FloatingPointError, match="no longer finite in epoch 0: lower learning_rate"):
            paper(rows, tmp_path / "state", learning_rate=1e30)

    def test_global_generator_is_left_alone(self, rows, tmp_path):
        before = torch.get_rng_state()
        paper(rows, tmp_path / "state", epochs=1)
        assert torch.equal(torch.get_rng_state(), before)


class TestFastRecipe:
    @pytest.mark.parametrize("trainer", [train_fast, train_dipole_residual])
    def test_same_seed_same_bits(self, cosine_rows, trainer):
        before = torch.get_rng_state()
        a, b, c = (trainer(*cosine_rows, seed=s, epochs=1, progress=False)[0] for s in (0, 0, 1))
        assert equal(a, b)
        assert not equal(a, c)
        assert not a.training
        assert torch.equal(torch.get_rng_state(), before)

    def test_metrics_are_those_of_the_result(self, cosine_rows):
        for trainer in (train_fast, train_dipole_residual):
            network, metrics = trainer(*cosine_rows, seed=0, epochs=2, progress=False)
            _, validation = _split_rows(len(cosine_rows[0]), 0)
            with torch.no_grad():
                error = network(cosine_rows[0][validation]) - cosine_rows[1][validation]
            assert metrics["rmse_validation"] == pytest.approx(float(error.square().mean().sqrt()), rel=0.02)

    def test_a_field_of_dipoles_is_left_without_remainder(self, cosine_rows):
        xi = cosine_rows[0].double()
        coefficients = torch.tensor([0.065, 2e-4]).double()
        network, _ = train_dipole_residual(
            xi, DipoleResidual.terms(xi) @ coefficients, seed=0, epochs=1, progress=False
        )
        torch.testing.assert_close(network.coefficients.double(), coefficients, rtol=1e-5, atol=0)

    def test_small_set_is_learnt(self):
        """A tenth of the training set: far below the 0.02 mT of the paper's networks, ring ``"released"``."""
        data = training_set(1, seed=1, samples=12_000)
        for recipe, limit in (("fast", 0.02), ("dipole", 0.004)):
            networks, metrics = train_own(data, seed=0, recipe=recipe)
            assert metrics[0]["rmse_validation"] < limit
            xi, u = one_segment_rows(100)
            with torch.no_grad():
                predicted = PerSensor(networks, [0])(xi[:, None].double())[:, 0]
            assert float((predicted - u).square().mean().sqrt()) < 2 * limit

    def test_progress_bar_shows_the_loss(self, cosine_rows, capsys):
        train_fast(*cosine_rows, seed=0, epochs=1)
        assert "rmse_mT=" in capsys.readouterr().err

    def test_divergence_is_an_error(self, cosine_rows):
        with pytest.raises(FloatingPointError, match=r"no longer finite in epoch \d: lower learning_rate"):
            train_fast(*cosine_rows, seed=0, learning_rate=1e30, progress=False)

    def test_bad_input(self):
        with pytest.raises(
            InputError, match="Input u of train_fast must be one for each of 9 rows, at least 4"
        ):
            train_fast(torch.zeros(9, 5), torch.zeros(8), seed=0)


def test_linear_layers_start_with_the_usual_bounds():
    network = paper_network(13, torch.Generator().manual_seed(0))
    for m in network:
        if isinstance(m, nn.Linear):
            bound = 1 / math.sqrt(m.in_features)
            assert float(m.weight.detach().abs().max()) <= bound
            assert float(m.weight.detach().abs().max()) > 0.8 * bound
