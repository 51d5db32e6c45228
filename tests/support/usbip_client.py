"""The client end of a USB/IP connection, as the kernel's driver speaks it, written from the
kernel's usbip_protocol.rst only.
"""

import socket
import struct
from typing import NamedTuple

DEADLINE_S = 60.0
BUS_ID = b"1-1".ljust(32, b"\0")
IMPORT = struct.pack(">HHI", 0x0111, 0x8003, 0) + BUS_ID
DEVICES = struct.pack(">HHI", 0x0111, 0x8005, 0)
DEVICE_BYTES = 0x138  # of the device in a reply
VENDOR_IN = 0xC0


class Answer(NamedTuple):
    """Of a transfer (command 3) or an unlink (4)."""

    command: int
    number: int
    status: int
    data: bytes


def exactly(connection: socket.socket, size: int) -> bytes:
    """`size` bytes, or EOFError."""
    found = b""
    while len(found) < size:
        more = connection.recv(size - len(found))
        if not more:
            raise EOFError(f"{len(found)} of {size} bytes")
        found += more
    return found


class Client:
    """A host that attaches the board at `address` (host:port)."""

    def __init__(self, address: str) -> None:
        host, _, port = address.rpartition(":")
        self.connection = socket.create_connection((host, int(port)), DEADLINE_S)
        self.number = 0
        self.inwards: dict[int, bool] = {}

    def attach(self) -> int:
        """Import the board; the status of the reply, 0 if it is ours now."""
        self.connection.sendall(IMPORT)
        version, code, status = struct.unpack(">HHI", exactly(self.connection, 8))
        assert (version, code) == (0x0111, 0x0003)
        if status == 0:
            exactly(self.connection, DEVICE_BYTES)
        return int(status)

    def submit(
        self,
        endpoint: int,
        inwards: bool,
        data: bytes = b"",
        room: int = 0,
        setup: bytes = bytes(8),
    ) -> int:
        """Begin a transfer; its number."""
        self.number += 1
        self.inwards[self.number] = inwards
        length = room if inwards else len(data)
        head = struct.pack(">5I", 1, self.number, 0x00010002, inwards, endpoint)
        rest = struct.pack(">IiiiI8s", 0, length, 0, -1, 0, setup)
        self.connection.sendall(head + rest + data)
        return self.number

    def unlink(self, victim: int) -> int:
        """Unlink a transfer; return the number of the request."""
        self.number += 1
        head = struct.pack(">5I", 2, self.number, 0x00010002, 0, 0)
        self.connection.sendall(head + struct.pack(">I24x", victim))
        return self.number

    def answer(self) -> Answer:
        """Return the next answer. EOFError when the board has left."""
        head = exactly(self.connection, 48)
        command, number, _device, _direction, _endpoint, status, length = struct.unpack_from(
            ">5Iii", head
        )
        carries = command == 3 and self.inwards[number]
        return Answer(command, number, status, exactly(self.connection, length) if carries else b"")

    def control(self, request_type: int, request: int, value: int, index: int, room: int) -> Answer:
        """Run a control transfer without data to its end."""
        setup = struct.pack("<BBHHH", request_type, request, value, index, room)
        self.submit(0, bool(request_type & 0x80), room=room, setup=setup)
        return self.answer()

    def write(self, data: bytes) -> Answer:
        """One OUT transfer, to its end."""
        self.submit(1, False, data)
        return self.answer()

    def close(self) -> None:
        self.connection.close()
