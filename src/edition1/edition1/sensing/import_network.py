"""Weights of a network trained elsewhere, made a file of this project: safetensors with a manifest beside it."""

from __future__ import annotations

import hashlib
import pickle
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file
from torch import Tensor

from edition1.errors import bad_input, require
from edition1.sensing.network import paper_network
from edition1.sensing.weights import save_weights

_NESTED = ("state_dict", "model_state_dict", "model", "network")
"""Names under which programs keep the weights within a file of more."""


def import_network(source: Path | str, target: Path | str, *, exponential_head: bool = False) -> Path:
    """Write the weights of a network of the paper's architecture as a robot file takes them (``[model] networks``).

    The architecture is that of :func:`~edition1.sensing.network.paper_network`: a batch norm of the relations as angles,
    then four times a linear layer, ReLU and a batch norm with 96, 256, 64 and 24 nodes, and a linear layer. Layers
    may have other names: they are then taken in order (of their numbers, in safetensors), and the kind and shape of
    every one is checked. Weights are stored as float32.

    Parameters
    ----------
    source
        State dict: a file of ``torch.save`` (``.pt``, ``.pth``; read without running any code in it) or safetensors.
    target
        The new file, ``.safetensors``; its manifest comes beside it.
    exponential_head
        Whether the last layer is the signed exponential of section 4.2, which has no weights.

    Returns
    -------
    Path
        The target.

    Raises
    ------
    InputError
        If the source is no state dict, a layer has another kind or shape, or a weight is not finite; the message
        names it. If the target has another ending or is there already.
    """
    source, target = Path(source), Path(target)
    if target.suffix != ".safetensors" or target.exists() or target.with_suffix(".json").exists():
        raise bad_input("target", "import_network", "a new file that ends in .safetensors", target)
    weights = _state_dict(source)
    first = next(iter(weights.values()))
    network = paper_network(first.numel(), torch.Generator(), exponential_head=exponential_head)
    wanted = network.state_dict()
    named = _without_prefix(weights)
    if named.keys() != wanted.keys():
        named = dict(zip(wanted, weights.values(), strict=False)) if len(weights) == len(wanted) else named
    theirs = dict(zip(named, weights, strict=True))
    for name, ours in wanted.items():
        expected = f"the paper's network with {name} of shape {tuple(ours.shape)}"
        if name not in named:
            raise bad_input("weights", str(source), expected, f"{len(named)} weights: {', '.join(weights)}")
        found, called = named[name], theirs[name]
        if found.shape != ours.shape or called.rpartition(".")[2] != name.rpartition(".")[2]:
            raise bad_input("weights", str(source), expected, f"{called} of shape {tuple(found.shape)}")
        if not bool(torch.isfinite(found).all()):
            raise bad_input("weights", str(source), "finite", f"{called} with numbers that are not")
    if extra := [theirs[name] for name in named if name not in wanted]:
        raise bad_input(
            "weights", str(source), f"the {len(wanted)} of the paper's network", f"also {extra[0]}"
        )
    network.load_state_dict(named)
    about = {"imported_from": source.name, "imported_sha256": hashlib.sha256(source.read_bytes()).hexdigest()}
    save_weights(network, target, {"recipe": "paper", "exponential_head": exponential_head, **about})
    return target


def _state_dict(path: Path) -> dict[str, Tensor]:
    expected = "a state dict: a file of torch.save, or safetensors"
    require(path.is_file(), "source", "import_network", expected, f"{path}, which is not there")
    try:
        if path.suffix == ".safetensors":
            # the file keeps no order
            content: Any = dict(sorted(load_file(path).items(), key=lambda item: _place(item[0])))
        else:
            content = torch.load(path, map_location="cpu", weights_only=True)
    except (SafetensorError, pickle.UnpicklingError, RuntimeError, ValueError, OSError, EOFError) as error:
        raise bad_input("source", "import_network", expected, f"{path}, which is none") from error
    if isinstance(content, Mapping) and (inner := [content[x] for x in _NESTED if x in content]):
        content = inner[0]
    # a network averaged over epochs (SWA) counts them
    weights = {k: v for k, v in content.items() if k != "n_averaged"} if isinstance(content, Mapping) else {}
    if not weights or not all(isinstance(k, str) and isinstance(v, Tensor) for k, v in weights.items()):
        raise bad_input("source", "import_network", expected, f"{path} with {type(content).__name__}")
    return weights


_KINDS = ("weight", "bias", "running_mean", "running_var", "num_batches_tracked")


def _place(name: str) -> tuple[list[tuple[int, str]], int]:
    """Return what sorts the weights of a network as torch lists them, for layers with numbers."""
    layer, _, kind = name.rpartition(".")
    parts = [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", layer)]
    return parts, _KINDS.index(kind) if kind in _KINDS else len(_KINDS)


def _without_prefix(weights: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Return weights without what all names begin with, such as ``module.``; a network in a module has that."""
    named = dict(weights)
    while len(heads := {name.partition(".")[0] for name in named}) == 1 and all(
        "." in name for name in named
    ):
        (head,) = heads
        named = {name.removeprefix(f"{head}."): value for name, value in named.items()}
    return named
