"""Play what a board sends into a port that a recorder can open: a pseudo-terminal, or a TCP port of this computer.

Nothing is lost on the way: whoever reads too slowly holds the board up, and no more is kept than the buffers of the
operating system hold. While nobody has the port open, a board that plays in time goes on and its frames are lost, as
on a real port; one that plays as fast as it is read waits. Stalls take their time in both.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterable

import numpy as np

from edition1.errors import bad_input
from edition1_live.emulate.board import Passage
from edition1_live.emulate.links import Link

_SETTLE_S = 0.25
"""From the opening of a port to the first byte [s]; drivers clear their buffers as they open one."""
_POLL_S = 0.02
"""How often the emulator looks for a reader, or whether it shall stop [s]."""


class Emulator:
    """Plays passages into a port: in a ``with`` statement, in a thread of its own. The port is there on entry.

    Parameters
    ----------
    passages
        From :func:`edition1_live.emulate.board.passages`.
    link
        The port; only the emulator's thread uses it.
    speed
        Times real time; infinite: as fast as it is read.
    hang_up
        At the end let the port disappear, instead of waiting until the reader leaves.
    each
        Called after every writing with the time before it, by the monotonic clock [ns], and how many bytes it took.

    Raises
    ------
    InputError
        If the speed is not above zero.

    Attributes
    ----------
    finished
        Set when everything was sent.
    """

    def __init__(
        self,
        passages: Iterable[Passage],
        link: Link,
        *,
        speed: float = 1.0,
        hang_up: bool = False,
        each: Callable[[int, int], None] = lambda _began_ns, _sent: None,
    ) -> None:
        if not speed > 0:
            link.remove()
            raise bad_input("speed", "Emulator", "above zero", speed)
        self._passages, self._link, self._speed, self._hang_up = passages, link, float(speed), hang_up
        self._each, self._paced = each, math.isfinite(speed)
        self._zero = math.nan  # when the board was switched on, by the monotonic clock [s]
        self._stopped = threading.Event()
        self._ready = threading.Event()
        self._ended = threading.Event()
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._run, daemon=True)
        self.finished = threading.Event()

    @property
    def address(self) -> str:
        """What to open: the path of a pseudo-terminal, or ``socket://…``."""
        return self._link.address

    def wait(self) -> None:
        """Wait until it has ended; within the ``with`` statement.

        In short sleeps: an interruption may come at any time, and in the wait for a lock it may leave that locked.
        Interrupted in ``is_alive``, Python 3.11 takes a thread that runs for one that has ended.
        """
        while not self._ended.is_set():
            time.sleep(_POLL_S)

    def _run(self) -> None:
        """Play to the end and remove the port."""
        link = self._link
        try:
            link.appear()
            self._ready.set()
            if self._reader_settled():
                self._play()
            self.finished.set()
            while not self._hang_up and link.has_reader() and not self._stopped.wait(_POLL_S):
                pass
        except BaseException as error:  # raised again in the thread that plays it
            self._error = error
        finally:
            link.remove()
            self.finished.set()
            self._ready.set()
            self._ended.set()

    def stop(self) -> None:
        """Let it end, soon."""
        self._stopped.set()

    def __enter__(self) -> Emulator:
        self._thread.start()
        self._ready.wait()
        if self._error is not None:
            self.__exit__()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()
        self._thread.join()
        if self._error is not None:
            raise self._error

    def _reader_settled(self) -> bool:
        while not self._link.has_reader():
            if self._stopped.wait(_POLL_S):
                return False
        return not self._stopped.wait(_SETTLE_S)

    def _play(self) -> None:
        connection = 0
        for passage in self._passages:
            if passage.connection != connection:
                connection = passage.connection
                self._link.vanish()
                self._sleep(self._until(float(passage.time_s[0])))
                self._link.appear()
                if not self._paced and not self._reader_settled():
                    return
            if not self._paced and not self._sleep(passage.silent_s):
                return
            if not self._send(passage):
                return

    def _send(self, passage: Passage) -> bool:
        """Send a passage; return whether to go on."""
        data = memoryview(passage.data)
        while data and not self._paced:
            if self._stopped.is_set() or not (self._link.has_reader() or self._reader_settled()):
                return False
            data = data[self._write(data) :]
        sent = k = 0
        while k < len(passage.frames) and self._paced:
            if not self._sleep(self._until(float(passage.time_s[k]))):
                return False
            now_s = (time.monotonic() - self._zero) * self._speed
            k = max(k + 1, int(np.searchsorted(passage.time_s, now_s, side="right")))
            end = int(passage.ends[k - 1])
            while sent < end and self._link.has_reader() and not self._stopped.is_set():
                sent += self._write(data[sent:end])
            sent = end
        return True

    def _write(self, data: memoryview) -> int:
        began_ns = time.monotonic_ns()
        if sent := self._link.write(data, _POLL_S):
            self._each(began_ns, sent)
        return sent

    def _until(self, time_s: float) -> float:
        """How long to wait until a time of the board [s], which begins with the first frame."""
        if not self._paced:
            return 0.0
        if math.isnan(self._zero):
            self._zero = time.monotonic() - time_s / self._speed
        return self._zero + time_s / self._speed - time.monotonic()

    def _sleep(self, seconds: float) -> bool:
        """Wait; return whether to go on."""
        if seconds <= 0:
            return not self._stopped.is_set()
        return not self._stopped.wait(seconds)
