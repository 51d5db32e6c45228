"""The operators' page without a browser: what waits for one, who may talk to it, what is sent, and
the one file that is not ours.
"""

import json
import socket
import struct
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from support.daemon import until


@pytest.mark.process
@pytest.mark.usefixtures("runtime")
def test_a_verb_that_is_tied_ends_with_its_parent() -> None:
    """A parent that is killed says nothing to anybody; the verb is one that needs no daemon."""
    tied = [
        sys.executable,
        "-m",
        "hapticd",
        "console",
        "--instance",
        "nobody",
        "--json",
        "--parent",
    ]
    program = f"""
import os, subprocess, time
child = subprocess.Popen({tied!r} + [str(os.getpid())])
print(child.pid, flush=True)
time.sleep(600)
"""
    with subprocess.Popen(
        [sys.executable, "-c", program], stdout=subprocess.PIPE, text=True
    ) as parent:
        assert parent.stdout is not None
        child = Path("/proc") / parent.stdout.readline().strip()
        assert json.loads(parent.stdout.readline())["ok"]  # it serves
        parent.kill()
    until(lambda: not child.exists(), "its end")


def text_frame(payload: bytes, declared: int, final: bool = True) -> bytes:
    """A frame of a WebSocket, masked by zeros, that is to be `declared` bytes long."""
    return bytes([0x80 * final | 1, 0x80 | declared, 0, 0, 0, 0]) + payload


LEAVES = (
    text_frame(b'{"ack', 50),  # in a frame
    text_frame(b'{"ack', 5, final=False),  # between two
    text_frame(b"\xff\xfe", 2),  # no UTF-8
    bytes([0x87, 0x80, 0, 0, 0, 0]),  # of no kind
    bytes([0x82, 0x82, 0, 0, 0, 0]) + b"{}",  # bytes
)


@pytest.mark.process
@pytest.mark.usefixtures("runtime")
def test_nothing_is_printed_of_browsers_that_leave_in_the_middle_of_a_message() -> None:
    """Before and after the server has accepted them, with and without a farewell of TCP."""
    verb = [sys.executable, "-m", "hapticd", "console", "--instance", "nobody", "--json"]
    with subprocess.Popen(verb, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as page:
        assert page.stdout is not None
        assert page.stderr is not None
        port = urlsplit(json.loads(page.stdout.readline())["url"]).port
        for sent in LEAVES:
            for wait in (False, True):
                for reset in (False, True):
                    leave(port, sent, wait, reset)
        page.terminate()
        assert page.stderr.read() == ""


def leave(port: int | None, sent: bytes, wait: bool, reset: bool) -> None:
    """Open the page's socket, `wait` until it is accepted, send, and end the connection."""
    head = [
        "GET /live HTTP/1.1", f"Host: 127.0.0.1:{port}", f"Origin: http://127.0.0.1:{port}",
        "Upgrade: websocket", "Connection: Upgrade", "Sec-WebSocket-Version: 13",
        "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==", "", "",
    ]  # fmt: skip
    with socket.create_connection(("127.0.0.1", port)) as line, suppress(ConnectionError):
        line.sendall("\r\n".join(head).encode())
        if wait:
            line.recv(1000)
        line.sendall(sent)
        if reset:
            line.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        else:
            line.shutdown(socket.SHUT_WR)
            while line.recv(1 << 16):
                pass
