"""The commands for a robot of one's own; ``repro`` includes them."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from repro.common import InputError

COMMANDS = {"check": "Say whether a robot can work, before any reading is taken."}
"""Names, and what they do in one line."""


def main(words: Sequence[str] | None = None) -> int:
    """Run a command, and return its exit status: 1 for a robot that cannot work, 2 for input that cannot be used."""
    parser = argparse.ArgumentParser(prog="repro", description="The shape of a soft robot from its sensors.")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    check = commands.add_parser("check", help=COMMANDS["check"], description=COMMANDS["check"])
    check.add_argument("robot", help="a robot file (TOML)")
    check.add_argument("--samples", type=int, default=400, metavar="N", help="random shapes (default: 400)")
    given = parser.parse_args(words)
    try:
        return _check(given.robot, given.samples)
    except (InputError, OSError) as error:
        print(f"repro {given.command}: {error}", file=sys.stderr)
        return 2


def _check(path: str, samples: int) -> int:
    from repro.check import check_design
    from repro.robot_file import load_robot

    found = check_design(load_robot(path), samples=samples)
    print(found)
    return 0 if found.can_work else 1


if __name__ == "__main__":
    sys.exit(main())
