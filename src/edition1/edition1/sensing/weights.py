"""Trained weights as files: safetensors, and a manifest beside them that says what they are."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError
from safetensors.torch import load, save
from torch import Tensor, nn

from edition1.errors import bad_input, require
from edition1.sensing.network import paper_network


def save_weights(network: nn.Module, path: Path, manifest: Mapping[str, Any]) -> None:
    """Write weights to ``path`` and their manifest beside it (``.json``), each whole or not at all.

    Parameters
    ----------
    network
        Any network; its parameters and buffers are written.
    path
        Ends in ``.safetensors``. It appears last: where it is, the manifest is too.
    manifest
        What can be said of the training: ``recipe``, seeds, data and metrics. The hash of the weights and the
        versions of torch, NumPy and magpylib are added.
    """
    weights = save({k: v.detach().cpu().contiguous() for k, v in network.state_dict().items()})
    versions = {name: version(name) for name in ("torch", "numpy", "magpylib")}
    full = {**manifest, "weights_sha256": hashlib.sha256(weights).hexdigest(), "versions": versions}
    path.parent.mkdir(parents=True, exist_ok=True)
    # A line for each entry: the losses of 250 epochs would be 500 lines otherwise.
    entries = ",\n".join(f" {json.dumps(key)}: {json.dumps(value)}" for key, value in full.items())
    _write(path.with_suffix(".json"), f"{{\n{entries}\n}}\n".encode())
    _write(path, weights)


def read_manifest(path: Path) -> dict[str, Any]:
    """Manifest of the weights at ``path``.

    Raises
    ------
    InputError
        If the weights or the manifest are not there, or the manifest cannot be read.
    """
    if not path.is_file():
        expected = "a file of trained weights (the networks are made by `make train`)"
        raise bad_input("path", "read_manifest", expected, path)
    beside = path.with_suffix(".json")
    if not beside.is_file():
        expected = f"weights with their manifest {beside.name} beside them"
        raise bad_input("path", "read_manifest", expected, f"{path} alone")
    try:
        manifest = json.loads(beside.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:  # no text, no JSON, or nested without end
        raise bad_input("manifest", str(beside), "JSON", error) from error
    require(isinstance(manifest, dict), "manifest", str(beside), "a JSON object", manifest)
    return manifest


def _load_weights(network: nn.Module, path: Path) -> nn.Module:
    """Fill a network with the weights at ``path`` and set it to evaluation mode; return it.

    Raises
    ------
    InputError
        As :func:`read_manifest`; if the weights are not those of the manifest, or of another architecture.
    """
    weights, wanted = _read(path, read_manifest(path)), network.state_dict()
    for name in sorted(weights.keys() | wanted.keys()):
        shapes = [tuple(x[name].shape) if name in x else "nothing" for x in (wanted, weights)]
        if shapes[0] != shapes[1]:
            expected = f"of the architecture {type(network).__name__} with {name} of shape {shapes[0]}"
            raise bad_input("weights", str(path), expected, f"{name}: {shapes[1]}")
    network.load_state_dict(weights)
    return network.eval()


def load_paper_network(path: Path) -> nn.Sequential:
    """Network of the paper's recipe in evaluation mode; the number of its inputs is that of the weights.

    Raises
    ------
    InputError
        As :func:`_load_weights`, or if the weights are of another recipe.
    """
    manifest = read_manifest(path)
    require(manifest.get("recipe") == "paper", "recipe", str(path), "'paper'", repr(manifest.get("recipe")))
    first = _read(path, manifest).get("0.weight")
    network = paper_network(
        1 if first is None else first.numel(),
        torch.Generator(),
        exponential_head=bool(manifest.get("exponential_head")),
    )
    _load_weights(network, path)
    return network


def _read(path: Path, manifest: Mapping[str, Any]) -> dict[str, Tensor]:
    content = path.read_bytes()
    digest, expected = hashlib.sha256(content).hexdigest(), manifest.get("weights_sha256")
    if digest != expected:
        raise bad_input(
            "weights", str(path), f"those of its manifest (sha256 {expected})", f"sha256 {digest}"
        )
    try:
        return load(content)
    except SafetensorError as error:
        raise bad_input("weights", str(path), "a safetensors file", error) from error


def _write(path: Path, content: bytes) -> None:
    partial = path.with_name(f".{path.name}.partial")
    partial.write_bytes(content)
    os.replace(partial, path)
