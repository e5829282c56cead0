"""Where recordings lie on this computer."""

from __future__ import annotations

import os
from pathlib import Path

import platformdirs


def data_dir() -> Path:
    """Return the folder of the recordings, absolute; it need not exist.

    The environment variable ``REPRO_DATA_DIR`` when it is set and not empty, else the user's cache
    (``~/.cache/repro`` on Linux, ``~/Library/Caches/repro`` on macOS).

    Returns
    -------
    Path
        The folder, with ``~`` expanded. Nothing is created: only the download of recordings writes there.
    """
    chosen = os.environ.get("REPRO_DATA_DIR", "")
    folder = (
        Path(chosen).expanduser() if chosen else Path(platformdirs.user_cache_dir("repro", appauthor=False))
    )
    return folder.absolute()
