"""A board on a pseudo-terminal."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from pty_board import Board

from edition1_live.follow import session

collect_ignore = ["conftest.py"]  # it has no examples to run, and other folders have a module of this name


@pytest.fixture
def board(tmp_path: Path) -> Iterator[Board]:
    """Plugged in at first; unplugged at the end if the test has not done so."""
    board = Board(tmp_path)
    board.plug_in()
    yield board
    if board.master >= 0:
        board.unplug()


@pytest.fixture
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """A queue that no pause of the computer fills."""
    monkeypatch.setattr(session, "SHORTEST_QUEUE", 1000)
