"""Recordings of a SYNTHETIC twin of the rig: training part of T5, and test parts."""

from edition1_companion.recordings.baaij2023 import Recording, split
from edition1_companion.twins.pneumatic_actuation import TRAJECTORIES
from edition1_companion.twins.pneumatic_rig import record_twin
from edition1_companion.twins.rig_networks import RECORDING_SEED
from edition1_companion.twins.rig_twins import nominal_twin


def recorded(trajectories=TRAJECTORIES, twin=None, longest_s=None) -> tuple[Recording, dict[str, Recording]]:
    """Return T5.train and the test part of each trajectory, T5 among them, whole for T4."""
    found = record_twin(
        twin or nominal_twin(), seed=RECORDING_SEED, trajectories=trajectories, longest_s=longest_s
    ).read
    tests = {name: part if name == "T4" else split(part)[1] for name, part in found.items()}
    return split(found["T5"])[0], tests
