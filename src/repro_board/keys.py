"""Keys in the terminal while a port is read: n writes a note into the recording, u lets go of the port.

They are read where standard input is a terminal, one by one and unseen; at the end it is as it was before.
"""

from __future__ import annotations

import codecs
import os
import re
import select
import sys
import termios
import threading
import tty
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from repro_board.record import MOST_LETTERS, Writer, plain
from repro_board.session import UPLOAD_S, Port

_ARROWS = re.compile(r"\x1b[\[O][0-9;]*[A-Za-z~]")
"""Keys without a letter, such as arrows."""
_INPUT = 0
"""The file of standard input."""


class Keys:
    """What was typed so far, and what is said of it."""

    def __init__(self, port: Port, writer: Writer | None) -> None:
        self.port, self.writer, self.read = port, writer, False
        self._note: str | None = None
        self._began_ns, self._answer = 0, ""

    def press(self, letters: str) -> None:
        """Act on keys, in their order."""
        for key in _ARROWS.sub("", letters):
            if self._note is not None:
                self._type(key, self._note)
                if self._note is None:  # what was pasted behind a line is no key
                    break
            elif key == "n":
                self._begin()
            elif key == "u":
                self.port.let_go()

    def _begin(self) -> None:
        if self.writer is None:
            self._answer = "A note needs a recording (-o FILE.rec)."
        elif not self.writer.received:
            self._answer = "A note needs a recording, and nothing has arrived yet."
        else:
            self._note, self._began_ns, self._answer = "", self.writer.now_ns(), ""

    def _type(self, key: str, note: str) -> None:
        if key in "\r\n":
            self.finish()
        elif key == "\x1b":
            self._note = None
        elif key in "\x08\x7f":
            self._note = note[:-1]
        elif key.isprintable() and len(note) < MOST_LETTERS:
            self._note = note + key

    def finish(self) -> None:
        """Write the note that was begun, if there is one."""
        text, self._note = plain(self._note or ""), None
        if text and self.writer is not None:
            try:
                self.writer.note(self._began_ns, text)
                self._answer = f"Noted: {text}"
            except OSError as error:
                self._answer = str(error)

    def lines(self) -> tuple[str, ...]:
        """Return what is shown: the note that is typed, or what became of it, and which keys there are."""
        if not self.read:
            return ()
        if (note := self._note) is not None:
            return (
                f"Note: {note}_",
                f"Enter keeps it, Esc drops it. {MOST_LETTERS - len(note)} letters are left.",
            )
        port = f"u lets go of the port for {UPLOAD_S:.0f} s, to upload firmware"
        if left := self.port.free_s:
            port = f"u takes the port back at once ({left:.0f} s left)"
        first = "n writes a note into the recording, " if self.writer else ""
        return (*([self._answer] if self._answer else []), f"Keys: {first}{port}, Ctrl-C ends.")

    def listen(self, over: threading.Event) -> None:
        """Read keys until it is over. A job in the background would be stopped for that, so it waits."""
        decoder = codecs.getincrementaldecoder("utf-8")("replace")
        with suppress(OSError):  # the terminal was closed
            while not over.is_set():
                if select.select([_INPUT] if _in_front() else [], [], [], 0.1)[0]:
                    if not (data := os.read(_INPUT, 1024)):
                        return
                    self.press(decoder.decode(data))


def _in_front() -> bool:
    """Whether the terminal is ours: a job in the background is stopped where it reads or sets it."""
    try:
        return os.tcgetpgrp(_INPUT) == os.getpgrp()
    except OSError:  # it controls no job
        return True


@contextmanager
def keyboard(port: Port, writer: Writer | None) -> Iterator[Keys]:
    """Read keys where standard input is a terminal; use it where signals end nothing by themselves."""
    keys, over = Keys(port, writer), threading.Event()
    if sys.stdin is None or not os.isatty(_INPUT) or not _in_front():
        yield keys
        return
    before, thread = (
        termios.tcgetattr(_INPUT),
        threading.Thread(target=keys.listen, args=(over,), daemon=True),
    )
    keys.read = True
    thread.start()
    try:
        tty.setcbreak(_INPUT, termios.TCSADRAIN)
        yield keys
    finally:
        if _in_front():
            with suppress(termios.error):  # the terminal was closed
                termios.tcsetattr(_INPUT, termios.TCSADRAIN, before)
        over.set()
        thread.join()
        keys.finish()
