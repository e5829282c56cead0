"""Ports that are real: pseudo-terminals and sockets of this computer."""

from __future__ import annotations

import os
import re
import socket
import subprocess
import sys
import time

import pytest

from edition1.errors import InputError
from edition1_live.record.ports import close_port, listing, open_port, ports, read_available

pytestmark = pytest.mark.skipif(os.name != "posix", reason="pseudo-terminals")


@pytest.fixture
def terminal():
    board, port = os.openpty()
    yield board, os.ttyname(port)
    os.close(board)
    os.close(port)


def refused(port: str, baud: int = 115200) -> str:
    with pytest.raises(InputError) as caught:
        open_port(port, baud)
    return str(caught.value)


def test_ports_have_descriptions():
    for name, description in ports():
        assert name
        assert description
        assert f"{name} " in listing()
    if not ports():
        assert listing().startswith("No serial port found.")


def test_bytes_arrive_as_sent(terminal):
    board, name = terminal
    opened = open_port(name)
    assert read_available(opened, 0.01) == b""
    for chunk in (b"\x00\xff\r\n\x03\x04\x11\x13", bytes(range(256))):  # what a terminal would act on
        os.write(board, chunk)
        assert read_available(opened, 1.0) == chunk
    close_port(opened)


def test_a_socket_is_read_in_chunks_not_bytes():
    with socket.create_server(("localhost", 0)) as server:
        opened = open_port(f"socket://localhost:{server.getsockname()[1]}")
        board, _ = server.accept()
        board.sendall(b"x" * 1000)
        time.sleep(0.05)
        assert read_available(opened, 1.0) == b"x" * 1000
        assert read_available(opened, 0.01) == b""
        board.close()
        with pytest.raises(ConnectionResetError, match="was closed at the other side"):
            read_available(opened, 1.0)
        close_port(opened)


def test_a_port_that_disappears_raises():
    board, port = os.openpty()
    opened = open_port(os.ttyname(port))
    os.close(port)
    os.close(board)
    with pytest.raises(OSError):  # noqa: PT011  EIO or end of file, as the system has it
        read_available(opened, 1.0)
    close_port(opened)


def test_a_missing_port_names_those_found():
    message = refused("/dev/ttyNone")
    assert re.fullmatch(
        r"Input port of repro record must be one that is there \(found: .+\); "
        r"instead received /dev/ttyNone, which is not\.",
        message,
    )
    for name, _ in ports():
        assert name in message


def test_a_busy_port_says_so(terminal):
    _, name = terminal
    opened = open_port(name)
    expected = f"must be free (close the program that has it open); instead received {name}, which is in use."
    assert expected in refused(name)
    close_port(opened)
    close_port(open_port(name))


@pytest.mark.parametrize("gid", [20, 0])
def test_no_permission_says_which_group_to_join(terminal, gid):
    """As a user who may not, where the tests run as root."""
    grp = pytest.importorskip("grp")
    _, name = terminal
    root = os.geteuid() == 0
    if root:
        os.chown(name, 0, gid)
    os.chmod(name, 0o600 if root else 0)
    group = grp.getgrgid(os.stat(name).st_gid).gr_name
    script = """
import grp, os, sys  # grp while it can be read
from edition1_live.record.ports import open_port
if os.geteuid() == 0:
    os.setgroups([]); os.setgid(65534); os.setuid(65534)
try:
    open_port(sys.argv[1])
except ValueError as error:
    print(error)
"""
    ran = subprocess.run([sys.executable, "-c", script, name], capture_output=True, text=True, check=True)
    help_ = (
        f"usermod -aG {group} "
        if group not in ("root", "wheel")
        else "a udev rule gives it to dialout or uucp"
    )
    assert "Input port of repro record must be one that you may read and write (" in ran.stdout
    assert help_ in ran.stdout
    assert ran.stdout.endswith(f"instead received {name}, permission denied.\n")


def test_other_things_are_no_ports(tmp_path):
    (tmp_path / "file").write_text("")
    assert "must be a serial port" in refused(str(tmp_path / "file"))
    assert "must be a serial port" in refused(str(tmp_path))
    with socket.create_server(("localhost", 0)) as server:
        number = server.getsockname()[1]
    assert "must be reachable, as socket://HOST:PORT of a program that waits" in refused(
        f"socket://localhost:{number}"
    )


def test_an_impossible_rate_is_named(terminal):
    assert "Input baud of repro record must be a rate that the port can be set to" in refused(terminal[1], -1)
