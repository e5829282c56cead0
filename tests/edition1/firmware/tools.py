"""The compilers and the simulator that the firmware is tested with; run as a program, it installs what is missing."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

PACKAGES = [
    "gcc",
    "libc6-dev",
    "gcc-avr",
    "avr-libc",
    "arduino-core-avr",
    "libsimavr-dev",
    "libelf-dev",
    "gcc-arm-none-eabi",
    "libnewlib-arm-none-eabi",
]
HEADER = Path("/usr/include/simavr/sim_avr.h")
ARDUINO = Path("/usr/share/arduino/hardware/arduino/avr")


def missing() -> list[str]:
    """Return what is not there."""
    programs = [name for name in ("gcc", "avr-gcc", "arm-none-eabi-gcc") if shutil.which(name) is None]
    files = {"libsimavr": HEADER, "the Arduino core": ARDUINO}
    return programs + [name for name, path in files.items() if not path.exists()]


def main() -> int:
    """Make sure that all is there; return 0, or 1 where something is not and cannot be had."""
    if missing() and shutil.which("apt-get") and os.geteuid() == 0:
        print(
            f"Installing what the firmware is tested with: {', '.join(missing())} is missing.",
            file=sys.stderr,
        )
        apt = ["apt-get", "-qq", "-o", "Dpkg::Use-Pty=0"]
        environment = {**os.environ, "DEBIAN_FRONTEND": "noninteractive"}
        for command in ([*apt, "update"], [*apt, "install", "-y", "--no-install-recommends", *PACKAGES]):
            subprocess.run(command, env=environment, stdout=subprocess.DEVNULL, check=False)
    if missing():
        print(
            f"The firmware cannot be tested without {', '.join(missing())}. "
            f"Debian and Ubuntu: apt-get install {' '.join(PACKAGES)}",
            file=sys.stderr,
        )
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
