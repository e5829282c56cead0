"""Independent pieces of an experiment, one process each."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import Any, TypeVar

import pandas as pd

from edition1_companion.book.points import BESIDE_OTHERS

T = TypeVar("T")


def in_processes(tasks: Sequence[Callable[[], T]], jobs: int | None = None) -> list[T]:
    """Run tasks side by side, each in one thread of a fresh process; return their results in order.

    Parameters
    ----------
    tasks
        Functions of modules, or ``functools.partial`` of such: they are pickled.
    jobs
        Processes at a time; when not given one beside other notebooks
        (:data:`~edition1_companion.book.points.BESIDE_OTHERS`), else one per core. With one nothing is started: results
        are the same.
    """
    ((beside, _),) = BESIDE_OTHERS.items()
    jobs = min(jobs or int(os.environ.get(beside, 0)) or os.cpu_count() or 1, len(tasks))
    if jobs <= 1:
        return [task() for task in tasks]
    # spawn: a forked copy of a process that runs threads (a notebook's kernel) may hang
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn"), initializer=_one_thread) as pool:
        return list(pool.map(_call, tasks))


def table_in_processes(tasks: Sequence[Callable[[], pd.DataFrame]], jobs: int | None = None) -> pd.DataFrame:
    """Run tasks as :func:`in_processes` does; return their tables one below the other."""
    return pd.concat(in_processes(tasks, jobs), ignore_index=True)


def _one_thread() -> None:
    import torch

    torch.set_num_threads(1)


def _call(task: Callable[[], Any]) -> Any:
    return task()
