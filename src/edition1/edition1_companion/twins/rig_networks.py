"""The networks of Baaij et al. 2023, section 5, trained on recordings T5 of the digital twins; they are SYNTHETIC."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import product
from pathlib import Path
from typing import ClassVar

import torch
from torch import Tensor, nn

from edition1.errors import bad_input
from edition1.sensing.ensemble import SeedEnsemble
from edition1.sensing.training import SPLIT, train_paper
from edition1.sensing.weights import load_paper_network, read_manifest, save_weights
from edition1_companion.recordings.baaij2023 import Recording, split
from edition1_companion.recordings.rig_robot import RIG_SENSORS
from edition1_companion.twins.networks import rows_sha256, training_record
from edition1_companion.twins.pneumatic_rig import TwinConfig, record_twin
from edition1_companion.twins.rig_files import SYNTHETIC
from edition1_companion.twins.rig_twins import nominal_twin, second_twin

RIG_LEARNING_RATE = 5e-5
"""Learning rate of the networks of section 5; readings are in mV, which makes the loss large."""
RECORDING_SEED = 0
"""Seed of the twin's recordings that the networks are trained on, and that Table 2 is evaluated on."""
RIG_SEEDS = (0, 1, 2)
"""Seeds of the committed networks."""


@dataclass(frozen=True)
class RigSpec:
    """One network of the paper's recipe for one sensor of the rig (section 5.4).

    Parameters
    ----------
    sensor
        Sensor whose reading it predicts, from 0.
    seed
        Split of the data, initial weights and dropout.
    second
        Whether it is of the second twin, not of the nominal one.
    """

    sensor: int
    seed: int
    second: bool = False

    learning_rate: ClassVar[float] = RIG_LEARNING_RATE

    @property
    def name(self) -> str:
        """File name without ending."""
        return f"rig_{'second_' if self.second else ''}sensor{self.sensor + 1}_seed{self.seed}"

    @property
    def twin(self) -> TwinConfig:
        """The twin that it is trained on."""
        return second_twin() if self.second else nominal_twin()

    def rows(self) -> tuple[Tensor, Tensor]:
        """Relations and readings [mV] of T5.train of its twin, float32: 70 % of them train."""
        return sensor_rows(training_part(self.twin), self.sensor)


def rig_specs() -> Iterator[RigSpec]:
    """Yield the networks of Table 2: three sensors and three seeds, for each of two twins."""
    for second, seed, sensor in product((False, True), RIG_SEEDS, range(RIG_SENSORS)):
        yield RigSpec(sensor, seed, second)


def sensor_rows(part: Recording, sensor: int) -> tuple[Tensor, Tensor]:
    """Relations as angles, of the robot as drawn, and readings [mV] of one sensor, float32."""
    xi = torch.from_numpy(part.relations()[:, sensor]).float().contiguous()
    return xi, torch.from_numpy(part.u[:, sensor]).float().contiguous()


def train_rig(
    spec: RigSpec,
    folder: Path,
    checkpoints: Path,
    *,
    part: Recording | None = None,
    progress: bool = True,
) -> Path:
    """Train one network, or go on with it, and write its weights and manifest; return the weights' path.

    Parameters
    ----------
    spec
        Which network.
    folder, checkpoints
        Of the weights, and of the state between runs.
    part
        What it is trained on; T5.train of its twin when not given.
    progress
        Show a progress bar.

    Raises
    ------
    FloatingPointError
        If the training diverges.
    InputError
        If the folder has this network trained on other readings.
    """
    target = folder / f"{spec.name}.safetensors"
    xi, u = spec.rows() if part is None else sensor_rows(part, spec.sensor)
    if target.exists():
        if read_manifest(target).get("data_sha256") != rows_sha256(xi, u):
            expected = "trained on these readings (move them away to train anew)"
            raise bad_input("networks", target.name, expected, "trained on others")
        return target
    network, metrics, curve = train_paper(
        xi,
        u,
        seed=spec.seed,
        learning_rate=spec.learning_rate,
        checkpoint=checkpoints / f"{spec.name}.safetensors",
        unit="mV",
        progress=progress,
    )
    origin = {"twin_sha256": spec.twin.sha256} if part is None else {"recording": part.name}
    return save_rig_network(network, spec, folder, (xi, u), metrics, curve, **origin)


def save_rig_network(
    network: nn.Module,
    spec: RigSpec,
    folder: Path,
    rows: tuple[Tensor, Tensor],
    metrics: dict[str, float],
    curve: Tensor | None = None,
    *,
    recording: str = f"{SYNTHETIC}_T5",
    twin_sha256: str | None = None,
) -> Path:
    """Write a trained network and its manifest; return the weights' path.

    Parameters
    ----------
    network, spec, folder
        What, which, and where.
    rows, metrics
        What it was trained on, and its errors [mV].
    curve
        Losses of every epoch, as :func:`~edition1.sensing.training.train_paper` returns them.
    recording
        Name of the recording whose training part that is.
    twin_sha256
        Hash of the twin that made it, with the seed ``RECORDING_SEED``; none for a recording of the authors.
    """
    twin = {"recording_seed": RECORDING_SEED, "twin_sha256": twin_sha256}
    manifest = {
        "recipe": "paper",
        "sensor": spec.sensor,
        "seed": spec.seed,
        "learning_rate": spec.learning_rate,
        "recording": f"{recording}_train",
        **({} if twin_sha256 is None else twin),
        "data_sha256": rows_sha256(*rows),
        **training_record("mV", metrics, curve),
    }
    path = folder / f"{spec.name}.safetensors"
    save_weights(network, path, manifest)
    return path


def rig_networks(
    folder: Path, seeds: Sequence[int], *, second: bool = False, twin_sha256: str | None = None
) -> SeedEnsemble:
    """Trained networks, one for each sensor and seed.

    Parameters
    ----------
    folder
        Of the weights.
    seeds
        Seeds of the networks.
    second
        Whether those of the second twin.
    twin_sha256
        Hash of the twin that they must have been trained on; not checked when not given.

    Raises
    ------
    InputError
        If one of them is not there, or was trained on another twin.
    """
    by_seed = []
    for seed in seeds:
        paths = [folder / f"{RigSpec(j, seed, second).name}.safetensors" for j in range(RIG_SENSORS)]
        for path in paths:
            found = read_manifest(path).get("twin_sha256")
            if twin_sha256 is not None and found != twin_sha256:
                raise bad_input("networks", path.name, f"trained on the twin {twin_sha256}", found)
        by_seed.append([load_paper_network(path) for path in paths])
    return SeedEnsemble(by_seed, range(RIG_SENSORS))


def trained_on(part: Recording, folder: Path, seeds: Sequence[int], *, second: bool = False) -> bool:
    """Whether a folder has the networks of all sensors and seeds, trained on just these readings, by this recipe."""
    for sensor in range(RIG_SENSORS):
        wanted = rows_sha256(*sensor_rows(part, sensor))
        for seed in seeds:
            path = folder / f"{RigSpec(sensor, seed, second).name}.safetensors"
            manifest = read_manifest(path) if path.is_file() else {}
            if (manifest.get("data_sha256"), manifest.get("split")) != (wanted, SPLIT):
                return False
    return True


@cache
def training_part(config: TwinConfig) -> Recording:
    """T5.train of a twin, through its raw files and the pipeline; synthetic."""
    twin = record_twin(config, seed=RECORDING_SEED, trajectories=["T5"])
    return split(twin.read["T5"])[0]
