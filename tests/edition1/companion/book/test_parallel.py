"""Tasks in processes of their own, or in this one."""

import os

from edition1_companion.book.parallel import in_processes
from edition1_companion.book.points import BESIDE_OTHERS


def test_tasks_run_in_processes_of_their_own_but_not_beside_other_notebooks(monkeypatch):
    ((name, value),) = BESIDE_OTHERS.items()
    monkeypatch.delenv(name, raising=False)
    assert os.getpid() not in in_processes([os.getpid, os.getpid], 2)
    monkeypatch.setenv(name, value)
    assert in_processes([os.getpid, os.getpid]) == [os.getpid()] * 2
