"""Weights on disk: what is written comes back, what does not fit is refused with a clear message."""

import hashlib
import json

import pytest
import torch

from edition1.errors import InputError
from edition1.sensing.network import CosineNetwork, DipoleResidual, paper_network
from edition1.sensing.weights import _load_weights, load_paper_network, read_manifest, save_weights


def generator(seed=0):
    return torch.Generator().manual_seed(seed)


@pytest.fixture
def saved(tmp_path):
    path = tmp_path / "networks" / "pcc.safetensors"
    network = paper_network(9, generator())
    network(torch.rand(30, 9, generator=generator()))  # gives the batch norms statistics
    save_weights(network, path, {"recipe": "paper", "seed": 0, "metrics_mt": {"rmse_train": 0.01}})
    return path, network.eval()


def test_round_trip(saved):
    path, network = saved
    loaded = load_paper_network(path)
    x = torch.rand(10, 9, generator=generator(1))
    assert not loaded.training
    assert torch.equal(loaded(x), network(x))


def test_manifest_says_what_the_weights_are(saved):
    path, _ = saved
    manifest = json.loads(path.with_suffix(".json").read_text())
    assert manifest == read_manifest(path)
    assert manifest["recipe"] == "paper"
    assert manifest["metrics_mt"] == {"rmse_train": 0.01}
    assert manifest["weights_sha256"] == hashlib.sha256(path.read_bytes()).hexdigest()
    assert manifest["versions"].keys() == {"torch", "numpy", "magpylib"}
    assert sorted(p.name for p in path.parent.iterdir()) == ["pcc.json", "pcc.safetensors"]


def test_same_weights_same_bytes(saved, tmp_path):
    path, network = saved
    save_weights(network, tmp_path / "again.safetensors", {"recipe": "paper"})
    assert (tmp_path / "again.safetensors").read_bytes() == path.read_bytes()


def test_own_networks_round_trip(tmp_path):
    def make(seed):
        return DipoleResidual(
            torch.rand(2, generator=generator(seed)), CosineNetwork(5, generator(seed), (4,))
        )

    save_weights(make(0), tmp_path / "own.safetensors", {"recipe": "dipole"})
    x = torch.rand(10, 5, generator=generator())
    assert torch.equal(_load_weights(make(1), tmp_path / "own.safetensors")(x), make(0)(x))


def test_missing_file(tmp_path):
    with pytest.raises(
        InputError, match=r"a file of trained weights \(the networks are made by `make train`\)"
    ):
        load_paper_network(tmp_path / "none.safetensors")


def test_missing_manifest(saved):
    path, _ = saved
    path.with_suffix(".json").unlink()
    with pytest.raises(InputError, match=r"must be weights with their manifest pcc.json beside them"):
        load_paper_network(path)


@pytest.mark.parametrize(("text", "expected"), [("{", "must be JSON"), ("[]", "must be a JSON object")])
def test_manifest_that_is_none(saved, text, expected):
    path, _ = saved
    path.with_suffix(".json").write_text(text)
    with pytest.raises(InputError, match=expected):
        load_paper_network(path)


def test_wrong_hash(saved):
    path, _ = saved
    digest = read_manifest(path)["weights_sha256"]
    content = bytearray(path.read_bytes())
    content[-1] ^= 1
    path.write_bytes(content)
    with pytest.raises(InputError, match=rf"must be those of its manifest \(sha256 {digest}\); instead"):
        load_paper_network(path)


def test_file_that_is_not_safetensors(saved):
    path, _ = saved
    path.write_bytes(b"nothing")
    manifest = read_manifest(path) | {"weights_sha256": hashlib.sha256(b"nothing").hexdigest()}
    path.with_suffix(".json").write_text(json.dumps(manifest))
    with pytest.raises(InputError, match="must be a safetensors file"):
        load_paper_network(path)


def test_other_recipe(tmp_path):
    path = tmp_path / "fast.safetensors"
    save_weights(CosineNetwork(5, generator()), path, {"recipe": "fast"})
    with pytest.raises(InputError, match="Input recipe of .* must be 'paper'; instead received 'fast'"):
        load_paper_network(path)


def test_other_architecture(tmp_path):
    path = tmp_path / "wrong.safetensors"
    save_weights(CosineNetwork(5, generator()), path, {"recipe": "paper"})
    expected = r"of the architecture Sequential with 0.bias of shape \(1,\); instead received 0.bias: nothing"
    with pytest.raises(InputError, match=expected):
        load_paper_network(path)


def test_other_number_of_magnets(saved):
    path, _ = saved
    with pytest.raises(InputError, match=r"with 0.bias of shape \(5,\); instead received 0.bias: \(9,\)"):
        _load_weights(paper_network(5, generator()), path)
