"""Training gives what the first edition's gave, weights the same readings without torch, slopes are differences."""

from __future__ import annotations

import copy
import hashlib
import json
import re
from pathlib import Path

import numpy as np
import pytest
import torch
import training
from safetensors.torch import load_file
from torch import nn
from training import save_network
from training_sets import AffineNetwork

from repro import InputError, LevenbergMarquardt
from repro.networks import TorchModel, load_network
from repro_companion.papers import table_2
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


def by_autograd(module: nn.Module, xi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return readings of rows of relations and their slopes, by torch in float64."""
    x = torch.tensor(xi, requires_grad=True)
    u = copy.deepcopy(module).double()(x)
    (slopes,) = torch.autograd.grad(u.sum(), x)
    return u.detach().numpy(), slopes.numpy()


@pytest.mark.parametrize("name", ["pcc_nb1_segment1_seed1", "pcc_nb3_segment2_seed0", "affine_sensor4_seed2"])
def test_committed_networks_read_the_same_without_torch(name):
    path = DATA / f"{name}.safetensors"
    network, ((expected,), _) = load_network(path), paper_networks([path], double=False)
    mean, spread = (x.numpy() for x in (expected[0].running_mean, expected[0].running_var.sqrt()))
    xi = mean + spread * RNG.standard_normal((200, network.n_inputs))
    # Near a corner of the network float32 and float64 may take different sides, and slopes differ there.
    found = zip(network.linearise(xi), by_autograd(expected, xi), (5e-6, 2e-2), strict=True)
    for ours, exact, tolerance in found:
        np.testing.assert_allclose(ours, exact, rtol=0, atol=tolerance * np.abs(exact).max())
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


class Module(nn.Module):
    """Two readings of three coordinates."""

    def forward(self, q):
        return torch.stack([torch.sin(q).prod(-1), q[:, 0] * torch.exp(q[:, 1])], dim=-1)


def test_slopes_of_a_torch_model_are_those_of_differences():
    model, q = TorchModel(Module()), np.random.default_rng(0).uniform(0.2, 1.0, (2, 4, 3))
    u, slopes = model.linearise(q)
    assert (u.shape, slopes.shape) == ((2, 4, 2), (2, 4, 2, 3))
    steps = 1e-6 * np.eye(3)
    differences = [(model(q + step) - model(q - step)) / 2e-6 for step in steps]
    np.testing.assert_allclose(slopes, np.stack(differences, axis=-1), rtol=1e-7, atol=1e-8)
    np.testing.assert_allclose(model(q[1, 1]), u[1, 1], rtol=1e-14)
    with pytest.raises(
        InputError, match=r"must be one that returns readings \[1, s\]; instead received \(1,\)"
    ):
        TorchModel(lambda x: x.sum(dim=-1))([1.0, 2.0])


def test_an_estimator_takes_a_torch_model():
    model, q = TorchModel(Module()), np.array([0.7, 0.4, 0.5])
    fit = LevenbergMarquardt(model, [0.6, 0.1, 0.5], [0.9, 0.9, 0.5], noise=1e-3)
    _, found = fit.step(fit.init([0.65, 0.3, 0.5]), model(q))
    np.testing.assert_allclose(found.q, q, atol=1e-6)


@pytest.mark.parametrize(
    ("kind", "name", "origin"),
    [
        (AffineNetwork, "affine_sensor4_seed1", ("data_seed",)),
        (table_2.RigNetwork, "rig_sensor2_seed0", ("recording", "recording_seed")),
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
