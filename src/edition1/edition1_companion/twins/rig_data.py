"""What Table 2 of Baaij et al. 2023 is made from: the authors' recordings, or those of a SYNTHETIC twin.

Trained on T5.train; tested on the ends of T0, T1, T2, T3 and T5, and on the whole of T4.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from edition1.errors import bad_input
from edition1_companion.recordings.baaij2023 import (
    FOLDER,
    NAMES,
    Recording,
    process,
    raw_paths,
    split,
)
from edition1_companion.recordings.released import not_released
from edition1_companion.recordings.rig_robot import RIG_RATE_HZ
from edition1_companion.recordings.sources import data_dir
from edition1_companion.twins.pneumatic_actuation import TRAJECTORIES
from edition1_companion.twins.pneumatic_rig import TwinConfig, record_twin
from edition1_companion.twins.rig_networks import RECORDING_SEED
from edition1_companion.twins.rig_twins import nominal_twin

SOURCES = ("auto", "recorded", "twin")


@dataclass(frozen=True)
class RigData:
    """What Table 2 is made from.

    Attributes
    ----------
    train
        T5.train.
    tests
        Test part of each trajectory, whole for T4.
    twin_sha256
        Hash of the digital twin that recorded them; None for recorded files.
    own_files
        Names of recorded files that are not the authors': none of the twin's, and none where all are theirs.
    """

    train: Recording
    tests: dict[str, Recording]
    twin_sha256: str | None
    own_files: tuple[str, ...] = ()

    @property
    def label(self) -> str:
        """Who recorded it, for titles."""
        if self.twin_sha256 is not None:
            return "SYNTHETIC, digital twin"
        return "recordings of your own under these names" if self.own_files else "recorded by the authors"

    @property
    def remarks(self) -> list[str]:
        """What is to be said with all results: files that are not the authors', and alignments in doubt."""
        own = ", ".join(self.own_files[:2]) + (f" and {n - 2} more" if (n := len(self.own_files)) > 2 else "")
        differ = [f"Not the authors' files, so nothing is compared with print: {own}."] if own else []
        parts = {part.name: part.remarks for part in (self.train, *self.tests.values())}
        return [*differ, *(remark for remarks in parts.values() for remark in remarks)]

    def shortened(self, longest_s: float) -> dict[str, Recording]:
        """Beginnings of the test parts, of at most this length [s]; all of them for 0."""
        kept = slice(0, round(longest_s * RIG_RATE_HZ) or None)
        return {
            name: replace(part, frame=part.frame[kept], q=part.q[kept], u=part.u[kept])
            for name, part in self.tests.items()
        }


def load_recordings(
    source: str = "auto",
    *,
    trajectories: Sequence[str] = TRAJECTORIES,
    test_share: float = 0.3,
    folder: Path | None = None,
    config: TwinConfig | None = None,
    longest_s: float | None = None,
    sources: Path | None = None,
) -> RigData:
    """Training part of T5 and test parts.

    Parameters
    ----------
    source
        ``"recorded"``: raw files under the authors' names; ``"twin"``: the digital twin, synthetic; ``"auto"``: the
        first if all files are found.
    trajectories
        Which ones to test on.
    test_share
        Share of the test parts: 0.3 in the released code, 0.2 in section 5.3.
    folder
        The paper's folder, see `edition1_companion.recordings.baaij2023.raw_paths`.
    config
        The twin; the nominal one when not given.
    longest_s
        Cut the twin's sequences to this length [s].
    sources
        List of the public recordings, ``data/sources.json``: recorded files are the authors' where they have its
        hashes, and are aligned by the released rule. Others, and all without the list, are called the reader's own.

    Raises
    ------
    InputError
        If the source or a trajectory is unknown, there is none, or recorded files were asked for and are not there.
    """
    if source not in SOURCES:
        raise bad_input("source", "load_recordings", f"one of {', '.join(map(repr, SOURCES))}", repr(source))
    if not trajectories or not set(trajectories) <= set(TRAJECTORIES):
        expected = f"among {', '.join(TRAJECTORIES)}, at least one"
        raise bad_input("trajectories", "load_recordings", expected, trajectories)
    wanted = [name for name in TRAJECTORIES if name in trajectories or name == "T5"]
    paths = {name: raw_paths(NAMES[name], folder) for name in wanted}
    missing = [name for name in wanted if not all(path.is_file() for path in paths[name])]
    if source == "recorded" and missing:
        expected = "recorded: the authors' raw files of " + ", ".join(wanted)
        raise bad_input("source", "load_recordings", expected, f"none of {', '.join(missing)}")
    digest, own = None, []
    if source == "twin" or missing:
        twin = config or nominal_twin()
        recorded = record_twin(twin, seed=RECORDING_SEED, trajectories=wanted, longest_s=longest_s).read
        digest = twin.sha256
    else:
        files = [path for name in wanted for path in paths[name]]
        place = folder or data_dir() / FOLDER
        own = [p.name for p in files] if sources is None else not_released(files, FOLDER, place, sources)
        rule = "noise" if own else "released"
        recorded = {name: process(NAMES[name], folder, rule=rule) for name in wanted}
    train, _ = split(recorded["T5"], test_share)
    tests = {
        name: recorded[name] if name == "T4" else split(recorded[name], test_share)[1]
        for name in wanted
        if name in trajectories
    }
    return RigData(train, tests, digest, tuple(own))
