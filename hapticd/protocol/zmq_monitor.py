"""What libzmq tells of a socket's connections: events of its monitor, one implementation for both
ends of a line with keys (`relay`, `client.listener`).

pyzmq has a reader of these messages as well, but it loads asyncio, which the relay has no memory
for. A monitor socket must have one reader.
"""

import struct
from collections.abc import Iterator
from typing import NamedTuple

import zmq

__all__ = ["take", "taken"]

LAYOUT = struct.Struct("=Hi")  # event, value: zmq_socket_monitor(3)


class Event(NamedTuple):
    """One event of a monitor."""

    kind: int  # zmq.EVENT_...
    value: int  # a descriptor, or what a failed handshake died of


def take(monitor: "zmq.Socket[bytes]") -> Event:
    """The next event; zmq.Again if there is none."""
    data, _endpoint = monitor.recv_multipart(zmq.NOBLOCK)
    return Event(*LAYOUT.unpack(data))


def taken(monitor: "zmq.Socket[bytes]") -> Iterator[Event]:
    """All events that are there."""
    while True:
        try:
            yield take(monitor)
        except zmq.Again:
            return
