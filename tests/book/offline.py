"""Run a command without a network, where the system lets a program give it up: ``offline.py COMMAND …``.

On Linux the command gets a network of its own that holds nothing but itself. Elsewhere, or where that is not allowed,
it runs as it is, and a line says so.
"""

from __future__ import annotations

import os
import shutil
import socket
import struct
import subprocess
import sys

SET_FLAGS, UP = 0x8914, 0x41  # of Linux: SIOCSIFFLAGS; IFF_UP and IFF_RUNNING


def isolating() -> list[str] | None:
    """Return what runs a program in a network of its own, or None."""
    program = shutil.which("unshare")
    for options in (["--net"], ["--map-root-user", "--net"]):
        if (
            program
            and not subprocess.run([program, *options, "true"], check=False, capture_output=True).returncode
        ):
            return [program, *options]
    return None


def raise_loopback() -> None:
    """Switch on the address 127.0.0.1, by which notebooks talk to their kernels."""
    import fcntl

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
        fcntl.ioctl(any_socket, SET_FLAGS, struct.pack("16sH14x", b"lo", UP))


def main(arguments: list[str]) -> int:
    """Run the command; return its exit code."""
    if arguments[:1] == ["--inside"]:
        raise_loopback()
        os.execvp(arguments[1], arguments[1:])
    if (isolated := isolating()) is None:
        print("This system does not let a program give up the network: it stays.", file=sys.stderr)
        return subprocess.call(arguments)
    print(f"Without a network: {' '.join(arguments)}", flush=True)
    return subprocess.call([*isolated, sys.executable, __file__, "--inside", *arguments])


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
