"""Networks that are trained side by side: one step, the whole recipe, and the order of the rows."""

import numpy as np
import pytest
import torch
from edition1.kernels import training as together
from edition1.kernels._training_step import train_step
from edition1.kernels.training import _dropout, _workspace, train_together
from edition1.sensing.network import _PAPER_WIDTHS, paper_network
from edition1.sensing.training import train_paper
from edition1_companion.twins.rig_networks import RIG_LEARNING_RATE
from torch.nn.utils import parameters_to_vector


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
