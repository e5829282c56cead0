"""Points of a sweep on a Dask cluster that is there already, after a look at every worker.

Needs the optional extra ``cluster`` (``dask[distributed]``).
"""

from __future__ import annotations

import logging
import platform
import re
import sys
from collections.abc import Iterator, Sequence
from functools import lru_cache
from importlib import import_module
from pathlib import Path
from typing import Any

from edition1 import __version__
from edition1.errors import InputError, bad_input
from edition1_companion.book.digests import combined_digest, tree_digests
from edition1_companion.book.points import Outcome, Point, Runner, RunnerGone, run_point
from edition1_companion.book.provenance import PACKAGES
from edition1_companion.book.sweep_grid import OWNER

TIMEOUT_S = 10
"""How long a scheduler may take to answer [s]."""


@lru_cache(maxsize=1)
def identity() -> dict[str, str]:
    """Return what must be the same on every worker: version and source (a hash) of repro, version of Python."""
    folders = [Path(str(import_module(name).__file__)).parent for name in PACKAGES]
    source = combined_digest([tree_digests(folder) for folder in folders])[:16]
    return {
        "version of repro": __version__,
        "source of repro": source,
        "version of Python": platform.python_version(),
    }


def difference(worker: str, theirs: Any, ours: dict[str, str]) -> InputError | None:
    """Return what to say of a worker whose :func:`identity` is not ours, None if it is.

    Parameters
    ----------
    worker
        Its address.
    theirs
        What it returned, or the exception that it raised.
    ours
        What is expected.
    """
    if isinstance(theirs, BaseException):
        return bad_input(f"worker {worker}", OWNER, "able to import this repro", repr(theirs))
    for name, value in ours.items():
        if theirs.get(name) != value:
            return bad_input(
                f"worker {worker}", OWNER, f"of the same {name} as here, {value}", theirs.get(name)
            )
    return None


def run_checked(point: Point, expected: dict[str, str]) -> Outcome:
    """Run a point on a worker, which may have joined after the sweep began, if it is the repro expected."""
    from distributed import get_worker

    # a worker is asked once: what it has imported does not change
    found = difference(get_worker().address, identity(), expected)
    return Outcome(point.index, str(found)) if found else run_point(point)


def connect(address: str) -> Any:
    """Return a Dask client of a scheduler all of whose workers have the repro that is here.

    Parameters
    ----------
    address
        Such as ``tcp://host:8786`` or ``tls://host:8786``; certificates are those of Dask's configuration.

    Raises
    ------
    InputError
        If Dask is not installed, the address is not one or does not answer, or a worker has another version or
        source of repro; the message names the worker.
    """
    if not re.fullmatch(r"(tcp|tls)://\S+:\d+", address):
        raise bad_input("scheduler", OWNER, "an address such as tcp://host:8786", address)
    try:
        from distributed import Client
    except ImportError as error:
        must_be = "left out, or Dask be installed (pip install 'repro-soft-robots[cluster]')"
        raise bad_input("scheduler", OWNER, must_be, address) from error
    try:
        client = Client(address, timeout=TIMEOUT_S, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:  # a TypeError where TLS lacks its certificates
        must_be = "the address of a Dask scheduler that answers"
        raise bad_input("scheduler", OWNER, must_be, f"{address} ({error})") from error
    try:
        if not client.ncores():
            print(f"Waiting for a worker of {address}.", file=sys.stderr, flush=True)
            client.wait_for_workers(1)
        check_workers(client)
    except BaseException:
        client.close()
        raise
    return client


def check_workers(client: Any) -> None:
    """Ask every worker for its :func:`identity`.

    Raises
    ------
    InputError
        If one is not ours; the message names the worker.
    """
    for worker, theirs in sorted(client.run(identity, on_error="return").items()):
        if error := difference(worker, theirs, identity()):
            raise error


def cluster_runner(client: Any) -> Runner:
    """Return a runner on the workers of a Dask client, each of which runs as many points as it has threads.

    It raises :class:`~edition1_companion.book.points.RunnerGone` where the scheduler goes away.
    """

    def run(points: Sequence[Point]) -> Iterator[Outcome]:
        from distributed import as_completed

        # All points are handed over at once: a cluster that grows with its queue sees how long it is.
        futures = client.map(run_checked, points, expected=identity(), pure=False)
        point_of = dict(zip(futures, points, strict=True))
        for future in as_completed(futures, loop=client.loop):
            if future.cancelled():  # nobody here cancels: the client does so when it loses the scheduler
                # it would print how its attempt to connect again ends when it is closed
                logging.getLogger("distributed.client").setLevel(logging.CRITICAL)
                raise RunnerGone("The scheduler is gone")
            error = future.exception()
            said = f"{type(error).__name__}: {error}"
            yield future.result() if error is None else Outcome(point_of[future].index, said)

    return run
