"""One run of an emulated board into the recorder: what was sent, and what the recorder made of it."""

from __future__ import annotations

import math
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from edition1.errors import require
from edition1_companion.twins.takes import Take
from edition1_live.emulate.board import Passage, passages
from edition1_live.emulate.emulator import Emulator
from edition1_live.emulate.faults import Faults
from edition1_live.emulate.links import open_link
from edition1_live.record.recorder import record
from edition1_live.record.recording import Recording, read_recording
from edition1_live.wire.frame import Frame


@dataclass(frozen=True)
class Run:
    """What was sent, and what the recorder made of it.

    Attributes
    ----------
    sent
        What the board sent, as it arrived at the port.
    recording
        The recording.
    """

    sent: list[Passage]
    recording: Recording

    @property
    def counters(self) -> dict[str, int]:
        """Counters of the recorder."""
        return self.recording.metadata["counters"]

    def matches(self) -> np.ndarray:
        """Of each accepted frame, which of the sent ones it is; -1 where it was never sent so."""
        sent = [frame for passage in self.sent for frame in passage.frames]
        intact = np.concatenate([passage.intact for passage in self.sent]).tolist()
        return matched([frame for _, frame in self.recording.as_frames()], sent, intact)


def matched(accepted: Sequence[Frame], sent: Sequence[Frame], intact: Sequence[bool]) -> np.ndarray:
    """Find accepted frames in order among those sent; -1 where there is none.

    The next intact one comes before everything behind it; so an accepted frame is that one, or a damaged one
    before it that reads the same, or was never sent so.

    Examples
    --------
    >>> frames = [Frame(0, None, None, (x,)) for x in (1.0, 1.0, 2.0)]
    >>> matched([frames[0], Frame(0, None, None, (7.0,)), frames[2]], frames, [False, True, True])
    array([ 1, -1,  2])
    """
    found, start = np.full(len(accepted), -1), 0
    following = np.flatnonzero(intact).tolist()
    following.reverse()
    for k, frame in enumerate(accepted):
        until = following[-1] if following else len(sent)
        if until < len(sent) and sent[until] == frame:
            found[k] = following.pop()
        elif frame in sent[start:until]:
            found[k] = sent.index(frame, start, until)
        else:
            continue
        start = int(found[k]) + 1
    return found


def play_and_record(
    take: Take, faults: Faults, *, readings: int, seed: int, speed: float = math.inf, port: str = ""
) -> Run:
    """Play readings over and over into a port, and record it until the port disappears at the end.

    Parameters
    ----------
    take
        What to play.
    faults
        Of line and board.
    readings
        How many.
    seed
        Of the faults.
    speed
        Times real time; infinite: as fast as it is read.
    port
        ``pty`` or ``socket``; by default a pseudo-terminal where there are any.
    """
    sent = list(passages(islice(take.readings(loop=True), readings), take.format, faults, seed=seed))
    ended = threading.Event()
    with (
        TemporaryDirectory() as folder,
        Emulator(sent, open_link(port), speed=speed, hang_up=True) as emulator,
    ):

        def told(_: str) -> None:
            if emulator.finished.is_set():  # the port is gone for good
                ended.set()

        path = Path(folder) / "recording"
        record(emulator.address, take.format, path, stop=ended, warn=told)
        require(path.is_file(), "faults", "play_and_record", "such that a reading arrives", faults)
        return Run(sent, read_recording(path))
