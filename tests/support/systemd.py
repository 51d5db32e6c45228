"""The units as systemd's own tools judge them, the promises they make, and the notifications of the
processes to systemd.
"""

import socket
import struct

DEADLINE_S = 60.0


# --- notifications to systemd ---------------------------------------------------------------------


class Service:
    """systemd's end of the notification socket: (pid of the sender, its lines)."""

    def __init__(self, address: str) -> None:
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_PASSCRED, 1)
        self.socket.settimeout(DEADLINE_S)
        self.socket.bind(address)

    def hear(self) -> tuple[int, list[str]]:
        text, ancillary, _, _ = self.socket.recvmsg(4096, socket.CMSG_SPACE(struct.calcsize("3i")))
        pid, _, _ = struct.unpack("3i", ancillary[0][2])
        return pid, text.decode().splitlines()
