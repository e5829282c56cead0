"""The networks that Baaij et al. released, trained on their recordings, and robots whose readings they are.

The recordings behind Table 2 carry no licence, and neither do these networks: both are read where a reader has put
them. A released file is TorchScript, which is code, so it is loaded here alone and only when one asks for it. Its
weights become a `repro.networks.Network`, and nothing else of it is used.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from repro import Sensing
from repro.common import bad_input, require
from repro.networks import Network, network_of
from repro_companion.papers import rig, simulated_rig, table_2
from repro_companion.run import recordings_folder

FOLDER = Path("baaij2023_networks", "statedicts")
SEEDS = (0, 1)
"""Those of the list of files; the authors released three."""
LEFT_OUT = {"T4": "its networks disagree: from seed to seed their readings differ by 4.7 mV"}
FORM = "of the released form: norm, four blocks of linear layer, ReLU and norm, then a linear layer"
NOISE_MV = 0.24
"""Noise at rest, section 5.2."""
PARTS = {
    "nn.input_batch": 0,
    **{
        f"nn.block{k}.{part}": 2 * k - (part == "linear")
        for k in (1, 2, 3, 4)
        for part in ("linear", "batch")
    },
    "nn.final_linear": 9,
}
"""Parts of the released module and their places in the order of the layers."""


def load_released(path: Path) -> Network:
    """Return the network of a released TorchScript file; norms become part of the linear layers.

    The file is run to see that both predict the same readings, so load only files that you trust.

    Raises
    ------
    InputError
        If there is no such file, or it holds a module of another form.
    """
    import torch

    require(path.is_file(), "path", "load_released", "a file", f"{path}, which does not exist")
    try:
        module = torch.jit.load(path, map_location="cpu").double().eval()
    except (RuntimeError, ValueError) as error:
        reason = str(error).strip().rpartition("\n")[2]
        raise bad_input("path", "load_released", "a TorchScript file", f"{path.name}: {reason}") from error
    state = {}
    for name, value in module.state_dict().items():
        part, _, key = name.rpartition(".")
        require(part in PARTS, path.name, "load_released", FORM, f"one with {name}")
        state[f"{PARTS[part]}.{key}"] = value.numpy()
    absent = [part for part, place in PARTS.items() if f"{place}.weight" not in state]
    require(not absent, path.name, "load_released", FORM, f"one with nothing of {', '.join(absent[:1])}")
    network = network_of(state)
    xi = np.random.default_rng(0).standard_normal((16, network.n_inputs))
    xi = state["0.running_mean"] + xi * np.sqrt(state["0.running_var"])
    with torch.no_grad():
        off = float(np.abs(module(torch.from_numpy(xi)).numpy() - network(xi)).max())
    require(off < 1e-6, path.name, "load_released", FORM, f"one whose readings differ by {off:.3g} from it")
    return network


def load_sensing(trajectory: str, seed: int) -> Sensing:
    """Return the readings that the networks of one recording and seed predict."""
    folder, name = recordings_folder() / FOLDER, rig.NAMES[trajectory]
    files = [folder / f"torchscript_pl_db_{name}_s{j}_seed_{seed}.pt" for j in range(rig.SENSORS)]
    return Sensing(rig.robot(), [load_released(path) for path in files], earth=rig.EARTH)


def robots() -> table_2.Data:
    """Return synthetic recordings whose readings are the mean over the networks of each recording, and noise.

    The motion is that of the simulated rig. T4 is left out.
    """
    recordings = {}
    for number, name in enumerate(rig.TRAJECTORIES):
        if name in LEFT_OUT:
            continue
        q = simulated_rig.simulated(name).q
        u = np.mean([load_sensing(name, seed)(q) for seed in SEEDS], axis=0)
        noise = NOISE_MV * np.random.default_rng(number).standard_normal(u.shape)
        recordings[name] = rig.Recording(name, q, u + noise)
    return table_2.divided(recordings, "networks")
