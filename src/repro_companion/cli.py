"""The command ``repro``: what is rewritten is here, every other command is the first edition's."""

from __future__ import annotations

import sys

from edition1_companion.cli import app, main

__all__ = ["app", "main"]

if __name__ == "__main__":
    sys.exit(main())
