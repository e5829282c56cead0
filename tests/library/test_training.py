"""Training gives what the first edition's gave, weights the same readings without torch, slopes are differences."""

from __future__ import annotations

import hashlib
import json
import re
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import load_file
from torch import nn

from repro import InputError, training
from repro.networks import load_network
from repro.training import TorchModel, paper_network, save_network
from repro_companion.papers import baaij, rig
from scripts import train as script

from .robots import STORED
from .test_sensing import paper_networks

DATA = Path(__file__).parents[2] / "data" / "networks"
RNG = np.random.default_rng(0)
XI = RNG.uniform([0, 0.05, 0, 0, 0], [3, 0.2, 3, 3, 3], (1000, 5))
U = np.cos(XI[:, 2:]).sum(1) + 0.1 / XI[:, 1]
ROWS = (torch.from_numpy(XI).float(), torch.from_numpy(U).float())


def manifest(path: Path) -> dict:
    """Return what is said of weights in the file beside them, which names their hash."""
    found = json.loads(path.with_suffix(".json").read_text())
    assert found["weights_sha256"] == hashlib.sha256(path.read_bytes()).hexdigest()
    return found


def same(a: nn.Module, b: nn.Module) -> bool:
    """Return whether two networks have the same names and bits."""
    left, right = a.state_dict(), b.state_dict()
    return list(left) == list(right) and all(torch.equal(left[k], right[k]) for k in left)


def same_training(a, b) -> bool:
    return same(a[0], b[0]) and a[1] == b[1] and np.array_equal(a[2], b[2])


def paper(path: Path, rows=(XI, U), epochs: int = 3):
    return training.train_paper(*rows, 4, 0.05, path, epochs=epochs, swa_start=2)


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    return paper(tmp_path_factory.mktemp("trained") / "state")


def test_both_recipes_train_as_the_first_edition_did(trained):
    """Split, first weights, dropout and order of the rows are its own; sums may be rounded otherwise."""
    before = torch.get_rng_state()
    network, _, losses = trained
    np.testing.assert_allclose(losses, STORED["training_losses"], rtol=1e-4)
    expected = STORED["training_predicted"]
    np.testing.assert_allclose(network(ROWS[0][:50]).detach().numpy(), expected, rtol=0, atol=1e-4)
    assert not network.training
    fast, _ = training.train_fast(XI, U, 4, epochs=2)
    expected = STORED["fast_training_predicted"]
    np.testing.assert_allclose(fast(ROWS[0][:50]).detach().numpy(), expected, rtol=0, atol=1e-4)
    assert torch.equal(torch.get_rng_state(), before)


def test_an_interrupted_training_goes_on_to_the_same_bits(trained, tmp_path, monkeypatch):
    """Interrupted in the second batch of the second epoch, whose first batch is lost with it."""
    step, calls = training._step, []

    def interrupted(*given):
        calls.append(1)
        if len(calls) == 4:
            raise KeyboardInterrupt
        return step(*given)

    monkeypatch.setattr(training, "_step", interrupted)
    with pytest.raises(KeyboardInterrupt):
        paper(tmp_path / "state")
    assert same_training(paper(tmp_path / "state"), trained)
    assert len(calls) == 4 + 4  # two epochs of two batches were left
    assert [file.name for file in tmp_path.iterdir()] == ["state"]


def test_progress_is_shown_under_its_label(capsys):
    training.train_fast(XI, U, 0, epochs=1, progress="sensor 1")
    assert re.search(r"sensor 1: error \d\.\d{5}", capsys.readouterr().out)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda p: paper(p, (XI, U + 1e-3)),
            "Input checkpoint of train_paper must be of the same rows, seed",
        ),
        (lambda p: paper(p, epochs=2), "and of no more epochs (or not there); instead received"),
        (lambda p: paper(p, epochs=1), "Input swa_start of train_paper must be 1 to 1, the epochs; instead"),
        (lambda p: paper(p, (XI[:3], U[:3])), "Input rows of xi of train_paper must be at least 4; instead"),
        (lambda p: paper(p, (XI[:929], U[:929])), "so many that batches of 650 do not leave a single row"),
        (
            lambda p: training.train_fast(XI, U[1:], 0),
            "Input u of train_fast must be numbers of shape (1000)",
        ),
        (lambda p: training.train_fast(XI, U * np.nan, 0), "Input u of train_fast must be finite; instead"),
        (
            lambda p: training.train_paper(XI, U, 0, 1e30, p.parent / "new"),
            "no longer finite in epoch 0: lower learning",
        ),
    ],
)
def test_rows_and_checkpoints_that_do_not_fit_are_refused(tmp_path, call, message):
    paper(tmp_path / "state")
    with pytest.raises((InputError, FloatingPointError), match=re.escape(message)):
        call(tmp_path / "state")


@pytest.mark.parametrize("name", ["pcc_nb1_segment1_seed1", "pcc_nb3_segment2_seed0", "affine_sensor4_seed2"])
def test_committed_networks_read_the_same_without_torch(name):
    path = DATA / f"{name}.safetensors"
    network, ((expected,), _) = load_network(path), paper_networks([path], double=False)
    mean, spread = (x.numpy() for x in (expected[0].running_mean, expected[0].running_var.sqrt()))
    xi = mean + spread * RNG.standard_normal((200, network.n_inputs))
    # Near a corner of the network float32 and float64 may take different sides, and slopes differ there.
    found = zip(
        network.linearise(xi), TorchModel(expected, "angles").linearise(xi[None]), (5e-6, 2e-2), strict=True
    )
    for ours, exact, tolerance in found:
        np.testing.assert_allclose(ours, exact[0], rtol=0, atol=tolerance * np.abs(exact).max())
    assert manifest(path)["metrics_mt"]["rmse_validation"] < 0.05


def test_weights_that_are_written_are_read_and_the_manifest_names_their_hash(trained, tmp_path):
    about = {"recipe": "paper", "seed": 4, "metrics_mt": trained[1]}
    path = tmp_path / "new.safetensors"
    for network in (trained[0], training.train_fast(XI, U, 0, epochs=1)[0]):
        save_network(network, path, about)
        assert {key: manifest(path)[key] for key in about} == about
        assert load_file(path).keys() == network.state_dict().keys()
        expected = network(ROWS[0]).detach().numpy()
        np.testing.assert_allclose(
            load_network(path)(XI), expected, rtol=0, atol=1e-5 * np.abs(expected).max()
        )
    assert len(list(tmp_path.iterdir())) == 2


class Function(nn.Module):
    """A function as a module, with a weight to be moved to another dtype."""

    def __init__(self, function):
        super().__init__()
        self.function, self.weight = function, nn.Parameter(torch.tensor([1.0, -2.0, 3.0]))

    def forward(self, xi):
        return self.function(xi, self.weight)


TRAINED = paper_networks([DATA / "pcc_nb1_segment1_seed0.safetensors"], double=False)[0][0].train()
ROBOTS = Function(lambda xi, gains: gains * torch.sin(xi).prod(-1) / xi[:, :, 1])
SINGLE = Function(lambda xi, _: torch.sin(xi).prod(-1, keepdim=True) @ torch.ones(1, 1))
MODELS = {"paper": TRAINED, "smooth": training.FastNetwork(5), "robots": ROBOTS, "float32": SINGLE}


@pytest.mark.parametrize("name", MODELS)
def test_slopes_of_a_torch_model_are_those_of_differences(name):
    module = MODELS[name]
    model, xi = TorchModel(module, "angles"), XI[:24].reshape(4, 2, 3, 5)
    u, slopes = model.linearise(xi)
    assert u.dtype == slopes.dtype == np.float64
    h, tolerance = (3e-3, 1e-3) if name == "float32" else (1e-6, 1e-6)
    for k in range(5):
        step = h * np.eye(5)[k] * xi[..., 1:2]
        difference = (model(xi + step) - model(xi - step)) / (2 * step[..., k])
        np.testing.assert_allclose(slopes[..., k], difference, rtol=0, atol=tolerance * np.abs(slopes).max())
    np.testing.assert_allclose(model(xi[1, 1]), u[1, 1], rtol=1e-6)  # a robot does not depend on its batch
    assert model(xi[:0]).shape == (0, 2, 3)
    assert module.training  # it is a copy that was set to evaluation mode


@pytest.mark.filterwarnings("ignore:.torch.jit:DeprecationWarning")
@pytest.mark.parametrize(("name", "shape"), [("smooth", (6, 5)), ("robots", (2, 3, 5))])
def test_torchscript_reads_as_the_module_it_was_made_from(name, shape, tmp_path):
    torch.jit.trace(MODELS[name], torch.rand(shape)).save(tmp_path / "model.pt")
    xi = XI[:12].reshape(4, 3, 5)
    expected = TorchModel(MODELS[name], "angles").linearise(xi)
    for found, wanted in zip(
        TorchModel(tmp_path / "model.pt", "angles").linearise(xi), expected, strict=True
    ):
        np.testing.assert_allclose(found, wanted, rtol=1e-9, atol=1e-12)


@pytest.mark.filterwarnings("ignore:.torch.jit:DeprecationWarning")
@pytest.mark.parametrize(
    ("model", "message"),
    [
        (
            nn.Linear(5, 2),
            "rows of 5 relations, or 3 sensors x 5, to a reading each; instead received for (6, 5)",
        ),
        (paper_network(9), "for (6, 5) of torch.float64: running_mean should contain 5 elements not 9."),
        (
            Function(lambda xi, w: w.new_ones(len(xi))),
            "have finite slopes, not all zero; instead received slopes [[0",
        ),
        (
            Function(lambda xi, w: (0 * xi[:, 0]).sqrt()),
            "have finite slopes, not all zero; instead received slopes [[n",
        ),
        (
            Function(lambda xi, w: (xi + xi.mean(0))[:, 1]),
            "depends on the relations of that sensor alone; instead",
        ),
        (
            "none.pt",
            "must be a torch.nn.Module or the path of a TorchScript file; instead received none.pt: The",
        ),
        (__file__, "test_training.py: PytorchStreamReader"),
        (np.sin, "must be a torch.nn.Module or the path of a TorchScript file; instead received ufunc."),
    ],
)
def test_models_that_cannot_be_used_are_refused(model, message):
    with pytest.raises(InputError, match=re.escape(message)):
        TorchModel(model, "angles")(XI[:3])


@pytest.mark.parametrize(
    ("kind", "name", "origin"),
    [
        (baaij.AffineNetwork, "affine_sensor4_seed1", ("data_seed",)),
        (rig.RigNetwork, "rig_sensor2_seed0", ("recording", "recording_seed")),
    ],
)
def test_a_network_is_trained_once_and_written_with_the_manifest_of_the_committed_one(
    tmp_path, monkeypatch, kind, name, origin
):
    rows = tuple(x.numpy() for x in ROWS)
    monkeypatch.setattr(kind, "rows", lambda _: rows)
    monkeypatch.setattr(script, "train_paper", lambda xi, u, _, rate, state, **__: paper(state, (xi, u)))
    options = {"only": name, "folder": tmp_path / "networks", "checkpoints": tmp_path / "state"}
    assert script.main(**options) == 0
    found = manifest(tmp_path / "networks" / f"{name}.safetensors")
    committed = json.loads((DATA / f"{name}.json").read_text())
    assert committed.pop("exponential_head", False) is False  # the head of the text, which no network has
    assert list(found) == list(committed)
    kept = ("recipe", "sensor", "seed", "learning_rate", *origin, "split")
    assert [found[key] for key in kept] == [committed[key] for key in kept]
    monkeypatch.delattr(script, "train_paper")  # a second call trains nothing
    assert script.main(**options) == 0
    assert script.main(only="pcc_nb4") == 2
