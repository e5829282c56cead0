"""The trained networks of Baaij et al. 2023, sections 3 and 4: what each was trained on, how, and its file."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path

from safetensors.torch import save_file
from torch import Tensor

from repro.sensing.relations import relations
from repro.sensing.training import train_paper
from repro.simulation.training_set import training_set

DATA_SEED = 1
SEEDS = (0, 1, 2)
PCC_LEARNING_RATE = 0.18


@dataclass(frozen=True)
class NetworkSpec:
    """One network of the paper's recipe: shared by the sensors of one segment (section 3.2).

    Parameters
    ----------
    n_segments
        Segments of the robot.
    segment
        Segment whose sensors it predicts, from 0.
    earth
        Trained with an Earth field of random direction (last section of Table 1).
    seed
        Initial weights, dropout and split of the data.
    """

    n_segments: int
    segment: int
    earth: bool
    seed: int

    @property
    def name(self) -> str:
        """File name without ending."""
        kind = "earth" if self.earth else "pcc"
        return f"{kind}_nb{self.n_segments}_segment{self.segment + 1}_seed{self.seed}"


def specs() -> Iterator[NetworkSpec]:
    """Yield the 27 networks of Table 1: robots of 1, 2 and 3 segments, and 3 segments with an Earth field."""
    for n_segments, earth in ((1, False), (2, False), (3, False), (3, True)):
        for seed in SEEDS:
            for segment in range(n_segments):
                yield NetworkSpec(n_segments, segment, earth, seed)


def training_rows(
    n_segments: int, segment: int, earth: bool, *, samples: int = 120_000
) -> tuple[Tensor, Tensor]:
    """Relations as angles and readings of the sensors of one segment, float32: 360,000 rows."""
    data = training_set(n_segments, seed=DATA_SEED, samples=samples, earth=earth)
    here = [j for j, i in enumerate(data.robot.sensors.segment) if i == segment]
    xi = relations(data.robot, data.q, data.earth_axis).angles()[:, here]
    return xi.flatten(0, 1).float().contiguous(), data.u[:, here].flatten().float().contiguous()


def train(spec: NetworkSpec, folder: Path, checkpoints: Path, *, progress: bool = True) -> Path:
    """Train one network, or go on with it, and write its weights and manifest; return the weights' path."""
    target = folder / f"{spec.name}.safetensors"
    if target.exists():
        return target
    xi, u = training_rows(spec.n_segments, spec.segment, spec.earth)
    network, metrics = train_paper(
        xi,
        u,
        seed=spec.seed,
        learning_rate=PCC_LEARNING_RATE,
        checkpoint=checkpoints / f"{spec.name}.safetensors",
        progress=progress,
    )
    digest = hashlib.sha256(xi.numpy().tobytes() + u.numpy().tobytes()).hexdigest()
    folder.mkdir(parents=True, exist_ok=True)
    partial = folder / f".{spec.name}.partial"
    save_file({k: v.contiguous() for k, v in network.state_dict().items()}, partial)
    manifest = {
        "recipe": "paper",
        **asdict(spec),
        "learning_rate": PCC_LEARNING_RATE,
        "data_seed": DATA_SEED,
        "data_sha256": digest,
        "weights_sha256": hashlib.sha256(partial.read_bytes()).hexdigest(),
        "metrics_mt": metrics,
        "versions": {name: version(name) for name in ("torch", "numpy", "magpylib")},
    }
    (folder / f"{spec.name}.json").write_text(json.dumps(manifest, indent=1) + "\n")
    os.replace(partial, target)
    return target
