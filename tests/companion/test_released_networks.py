"""Released networks: the importer against torch itself, other forms, and robots whose readings they are."""

from collections import OrderedDict
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import nn

from repro import InputError
from repro_companion.papers import released_networks, rig, simulated_rig
from repro_companion.papers.released_networks import load_released

pytestmark = pytest.mark.filterwarnings("ignore:.torch.jit:DeprecationWarning")
WIDTHS = (5, 96, 256, 64, 24)


class Released(nn.Module):
    """A module whose state has the names of the released one; ``order`` is that of its blocks."""

    def __init__(
        self, seed: int = 0, order: tuple[str, ...] = ("linear", "relu", "batch"), blocks: int = 4
    ) -> None:
        super().__init__()
        torch.manual_seed(seed)
        layers: OrderedDict[str, nn.Module] = OrderedDict(input_batch=nn.BatchNorm1d(5))
        for k in range(1, blocks + 1):
            parts = {
                "linear": nn.Linear(*WIDTHS[k - 1 : k + 1]),
                "relu": nn.ReLU(),
                "batch": nn.BatchNorm1d(WIDTHS[k]),
            }
            layers[f"block{k}"] = nn.Sequential(OrderedDict((name, parts[name]) for name in order))
        layers["final_linear"] = nn.Linear(WIDTHS[blocks], 1)
        self.nn = nn.Sequential(layers)
        for layer in self.modules():
            if isinstance(layer, nn.BatchNorm1d):
                for value, low in (
                    (layer.weight, 0.5),
                    (layer.bias, -1),
                    (layer.running_mean, -1),
                    (layer.running_var, 0.1),
                ):
                    nn.init.uniform_(value, low, 2.0)

    def forward(self, xi: torch.Tensor) -> torch.Tensor:
        return self.nn(xi).squeeze()


def saved(module: nn.Module, path: Path) -> Path:
    """Write a module as the released files are."""
    path.parent.mkdir(parents=True, exist_ok=True)
    torch.jit.script(module.eval()).save(str(path))
    return path


def test_imported_network_gives_the_readings_and_slopes_of_torch(tmp_path):
    module = Released()
    network = load_released(saved(module, tmp_path / "released.pt"))
    xi = torch.randn(50, 5, dtype=torch.float64, requires_grad=True)
    u = module.double()(xi)
    (slopes,) = torch.autograd.grad(u.sum(), xi)
    found, found_slopes = network.linearise(xi.detach().numpy())
    np.testing.assert_allclose(found, u.detach().numpy(), rtol=0, atol=1e-9)
    np.testing.assert_allclose(found_slopes, slopes.numpy(), rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    ("module", "message"),
    [
        (
            Released(order=("linear", "batch", "relu")),
            r"instead received one whose readings differ by .* from it",
        ),
        (Released(blocks=3), "instead received one with nothing of nn.block4.linear"),
        (nn.Sequential(nn.Linear(5, 1)), "instead received one with 0.weight"),
    ],
)
def test_another_form_is_refused(tmp_path, module, message):
    path = tmp_path / "other.pt"
    # Traced, because torch takes scripts of modules for one that differ in nothing but the order of their layers.
    torch.jit.trace(module.eval(), torch.rand(2, 5)).save(str(path))
    with pytest.raises(
        InputError, match=f"Input other.pt of load_released must be of the released form.*{message}"
    ):
        load_released(path)


def test_what_is_no_torchscript_is_refused(tmp_path):
    path = tmp_path / "text.pt"
    with pytest.raises(
        InputError, match=r"path of load_released must be a file; instead .*text.pt, which does not exist"
    ):
        load_released(path)
    path.write_text("text", encoding="utf-8")
    with pytest.raises(
        InputError, match=r"path of load_released must be a TorchScript file; instead received text.pt"
    ):
        load_released(path)


def test_robots_move_as_the_rig_and_read_the_mean_of_both_seeds(tmp_path, monkeypatch):
    """Networks of one number each: 100 mV by seed 0, 140 mV by seed 1."""
    monkeypatch.setenv("REPRO_DATA_DIR", str(tmp_path))
    folder = tmp_path / released_networks.FOLDER
    for seed, reading in enumerate((100.0, 140.0)):
        module = Released(seed)
        nn.init.zeros_(module.nn.final_linear.weight)
        nn.init.constant_(module.nn.final_linear.bias, reading)
        content = saved(module, folder / "one.pt").read_bytes()
        for name in rig.NAMES.values():
            for j in range(rig.SENSORS):
                (folder / f"torchscript_pl_db_{name}_s{j}_seed_{seed}.pt").write_bytes(content)
    bends = 1e-3 * np.random.default_rng(0).normal([1.0, 2.0, 0.0], [3.0, 4.0, 0.0], (400, 3))
    monkeypatch.setattr(simulated_rig, "simulated", lambda name: rig.Recording(name, bends, bends))
    data = released_networks.robots()
    assert list(data.tests) == ["T0", "T1", "T2", "T3", "T5"]
    for part in data.tests.values():
        assert part.u.mean() == pytest.approx(120.0, abs=0.1)
        assert part.u.std() == pytest.approx(0.24, rel=0.2)
        assert len(part) == 120
        np.testing.assert_array_equal(part.q, bends[-120:])
