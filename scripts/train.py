"""Train the networks of the paper that data/networks does not have yet, and go on where it stopped: ``make train``.

There are 27 networks for Table 1, 27 for section 4.4 and 9 for Table 2; each takes minutes on one core. Three of our
own, for Table 1's page, take seconds.
"""

from __future__ import annotations

import hashlib
import platform
import re
import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import cyclopts
import numpy as np
import torch
from training import save_network, train_fast, train_paper
from training_sets import DATA_SEED, SAMPLES, SegmentNetwork, trained_networks

from repro.common import Array
from repro_companion.papers import rig, table_2
from repro_companion.papers.baaij import SEEDS

ROOT = Path(__file__).resolve().parents[1]
SPLIT = (
    "p = torch.randperm(rows) after torch.manual_seed(seed); p[:rows - int(0.3 rows)] train, "
    "in this order and never shuffled; the rest validate"
)


@dataclass(frozen=True)
class OwnNetwork(SegmentNetwork):
    """Our own network for the sensors of one segment: it takes relations as cosines and trains in seconds."""

    @property
    def name(self) -> str:
        """File name without its ending."""
        return super().name.replace("pcc", "fast")

    def rows(self, samples: int = SAMPLES) -> tuple[Array, Array]:
        """Return relations as cosines and readings."""
        xi, u = super().rows(samples)
        distances = slice(1, None, 4)
        cosines = np.cos(xi)
        cosines[:, distances] = xi[:, distances]
        return cosines, u


def main(
    *,
    only: str = "",
    recordings: bool = False,
    folder: Path = ROOT / "data/networks",
    checkpoints: Path = ROOT / ".cache/networks",
) -> int:
    """Train the networks of the paper that are not there yet; go on where it stopped.

    Parameters
    ----------
    only
        Train only those whose name starts with this, such as pcc_nb1.
    recordings
        Train the nine networks for the authors' recordings instead (``repro fetch baaij2023 --page table_2``). They
        stand in REPRO_DATA_DIR.
    folder
        Folder of the networks.
    checkpoints
        Folder of the state between runs.
    """
    torch.set_num_threads(1)  # several of these run side by side faster than one with several threads
    if recordings:
        return train_for_recordings()
    own = [OwnNetwork(1, 0, earth=False, seed=seed) for seed in SEEDS]
    of_rig = [table_2.RigNetwork(sensor, seed) for seed in SEEDS for sensor in range(rig.SENSORS)]
    wanted = [spec for spec in (*trained_networks(), *of_rig, *own) if spec.name.startswith(only)]
    missing = [spec for spec in wanted if not (folder / f"{spec.name}.safetensors").exists()]
    if not wanted:
        print(f"train.py: no network has a name that starts with {only!r}.", file=sys.stderr)
        return 2
    print(f"{len(wanted) - len(missing)} of {len(wanted)} networks are there.")
    for spec in missing:
        xi, u = spec.rows()
        if isinstance(spec, OwnNetwork):
            network, errors = train_fast(xi, u, spec.seed, progress=spec.name)
            about = {"recipe": "fast", **asdict(spec), "data_seed": DATA_SEED, "data_sha256": sha256(xi, u)}
            about |= {"metrics_mt": errors, "threads": 1}
            save_network(network, folder / f"{spec.name}.safetensors", about)
            continue
        state = checkpoints / f"{spec.name}.state"
        network, errors, losses = train_paper(xi, u, spec.seed, spec.learning_rate, state, progress=spec.name)
        about = {
            "recipe": "paper",
            **settings(spec),
            "data_sha256": sha256(xi, u),
            **record(spec, errors, losses),
        }
        save_network(network, folder / f"{spec.name}.safetensors", about)
    return 0


def train_for_recordings() -> int:
    """Train the networks that the recordings of Table 2 in REPRO_DATA_DIR do not have yet."""
    data = table_2.load("recorded")
    for seed in table_2.SEEDS:
        for sensor, path in enumerate(table_2.network_files(data, seed)):
            if not path.is_file():
                path.parent.mkdir(parents=True, exist_ok=True)
                xi, u = table_2.training_rows(data.train, sensor)
                state = path.with_suffix(".state")
                network, errors, _ = train_paper(
                    xi, u, seed, table_2.LEARNING_RATE, state, progress=path.stem
                )
                about = {"recipe": "paper", "sensor": sensor, "seed": seed, "rmse_mv": errors}
                save_network(network, path, about)
    return 0


def settings(spec: Any) -> dict[str, Any]:
    """Return which network it is and what its rows come from."""
    origin = spec.origin if isinstance(spec, table_2.RigNetwork) else {"data_seed": DATA_SEED}
    return {**asdict(spec), "learning_rate": spec.learning_rate, **origin}


def sha256(xi: Array, u: Array) -> str:
    """Return the hash of the rows that a network is trained on."""
    return hashlib.sha256(xi.tobytes() + u.tobytes()).hexdigest()


def record(spec: Any, errors: dict[str, float], losses: Array) -> dict[str, Any]:
    """Return what came of the training, and on which processor, which decides its last digits."""
    unit = "mV" if isinstance(spec, table_2.RigNetwork) else "mT"
    info = Path("/proc/cpuinfo")  # of Linux
    model = re.search(r"^model name\s*: (.*)$", info.read_text(), re.M) if info.is_file() else None
    # Five digits: for a plot, and to see where another training parts from this one.
    train, validation = ([float(f"{x:.5g}") for x in column] for column in losses.T)
    return {
        f"metrics_{unit.lower()}": errors,
        "loss_by_epoch": {"unit": f"{unit}^2", "train": train, "validation": validation},
        "split": SPLIT,
        "threads": torch.get_num_threads(),
        "processor": model[1] if model else platform.processor() or platform.machine(),
    }


if __name__ == "__main__":
    sys.exit(cyclopts.run(main))
