"""Read the events of libzmq's monitor about a socket's connections, for both ends of a line with
keys (`relay`, `client.listener`).

pyzmq also has a reader of these messages, but it loads asyncio, which takes too much memory for the
relay. A monitor socket must have one reader.
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
    value: int  # a descriptor, or the error of a failed handshake


def take(monitor: "zmq.Socket[bytes]") -> Event:
    """Return the next event; zmq.Again without one."""
    data, _endpoint = monitor.recv_multipart(zmq.NOBLOCK)
    return Event(*LAYOUT.unpack(data))


def taken(monitor: "zmq.Socket[bytes]") -> Iterator[Event]:
    """Yield all waiting events."""
    while True:
        try:
            yield take(monitor)
        except zmq.Again:
            return
