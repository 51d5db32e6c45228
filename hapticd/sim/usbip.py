"""The simulated board on the USB bus of any Linux: a USB/IP server.

The kernel of the attaching machine (module vhci_hcd) enumerates the board as if it were plugged in
there. The real usbcore, usbfs, libusb, udev and their permissions are then between it and the
daemon. Protocol: Documentation/usb/usbip_protocol.rst of the Linux kernel, version 1.1.1. All
numbers are big-endian, except for the setup bytes, which are USB's own.

A client requests the list of devices, or imports one; after an import its connection carries
numbered transfers. CMD_SUBMIT requests one; RET_SUBMIT answers when it ends, for an IN when the
board has latched a frame. CMD_UNLINK cancels a pending one (libusb's time-out); its answer reports
whether the cancellation was in time. The end of a connection is an unplugged cable, and an import
is a plug: the board powers up. A server cannot plug in a board again, so a board that an injected
fault has unplugged refuses imports while it is away.

One thread waits for sockets and for the board at once. Between transfers the board is played every
HEARTBEAT_NS, because its watchdog would otherwise stand still with the host.

Limitations: a client that reads nothing (it is dropped after PATIENCE_S), isochronous transfers,
two boards in one server. USB/IP has no authentication: any process that reaches the port controls
the board.
"""

import errno
import socket
import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from select import POLLIN, poll
from time import sleep
from typing import NamedTuple

from hapticd.core.errors import ConfigError
from hapticd.core.units import NS_PER_MS, NS_PER_S, Clock
from hapticd.sim import usb_device
from hapticd.sim.injection import TransferFault
from hapticd.usb.codec import VENDOR_CLASS

__all__ = ["BUS_ID", "UsbipServer"]

BUS_ID = "1-1"
VERSION = 0x0111
OP_REQ_DEVLIST = 0x8005
OP_REP_DEVLIST = 0x0005
OP_REQ_IMPORT = 0x8003
OP_REP_IMPORT = 0x0003
CMD_SUBMIT = 1
CMD_UNLINK = 2
RET_SUBMIT = 3
RET_UNLINK = 4
DONE = 0
BUSY = 2  # ST_DEV_BUSY
NO_DEVICE = 4  # ST_NODEV

OPERATION = struct.Struct(">HHI")  # version, code, status
BUS_ID_BYTES = 32
# path, bus id, bus, device, speed, vendor, product, version, class, subclass, protocol,
# configuration, configurations, interfaces
DEVICE = struct.Struct(f">256s{BUS_ID_BYTES}s3I3H6B")
COUNT = struct.Struct(">I")
INTERFACE = struct.Struct(">4B")
URB = struct.Struct(">5I28s")  # command, number, device, direction, endpoint, the rest
SUBMIT = struct.Struct(">IiiiI8s")  # flags, length, start frame, packets, interval, setup
UNLINK = struct.Struct(">I24x")
RETURN = struct.Struct(">5IiiiiI8x")  # header; status, length, start frame, packets, errors

LONGEST_BYTES = 16 * 1024  # of one transfer; the board's are one packet
RECEIVE_BYTES = 64 * 1024
HEARTBEAT_NS = 2 * NS_PER_MS
IDLE_NS = 200 * NS_PER_MS
POLL_STEP_S = 1e-3  # resolution of poll()
SLEEP_S = 1e-4  # sleep for shorter waits: the maximum delay of input
PATIENCE_S = 2.0
MOST_WAITING = 256  # transfers; a kernel has a few for each endpoint
MOST_PEERS = 8  # beyond that the oldest peer without an import is dropped
Tell = Callable[[str], None]


class PendingSubmit(NamedTuple):
    """A transfer without an answer so far."""

    number: int
    endpoint: int  # with its direction; 0: a request, which is never answered
    room: int


class PeerClosed(Exception):
    """The connection has ended, for any reason."""


class Peer:
    """One connection: first questions, after an import transfers."""

    def __init__(self, connection: socket.socket, name: str) -> None:
        self.connection = connection
        self.name = name
        self.received = b""
        self.waiting: list[PendingSubmit] = []
        connection.settimeout(PATIENCE_S)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def receive(self) -> None:
        """Receive the available bytes. PeerClosed."""
        try:
            more = self.connection.recv(RECEIVE_BYTES)
        except OSError as error:
            raise PeerClosed from error
        if not more:
            raise PeerClosed
        self.received += more

    def take(self, size: int) -> bytes | None:
        """Return the next `size` bytes, once they have arrived."""
        if len(self.received) < size:
            return None
        taken = self.received[:size]
        self.received = self.received[size:]
        return taken

    def send(self, *parts: bytes) -> None:
        """Send `parts`. PeerClosed."""
        try:
            self.connection.sendall(b"".join(parts))
        except OSError as error:
            raise PeerClosed from error

    def answer(self, number: int, status: int, length: int, data: bytes = b"") -> None:
        """Send RET_SUBMIT: the transfer has ended, with `status` 0 or a negative errno."""
        self.send(RETURN.pack(RET_SUBMIT, number, 0, 0, 0, status, length, 0, 0, 0), data)


class UsbipServer:
    """Offers `device` on `host`:`port` (0: any free one, see `address`). ConfigError if that is
    taken. `tell(text)` is called when the board is attached and when it is detached.
    """

    def __init__(
        self, device: usb_device.UsbDevice, clock: Clock, host: str, port: int, tell: Tell
    ) -> None:
        self._device = device
        self._clock = clock
        self._tell = tell
        self._peers: list[Peer] = []
        self._importer: Peer | None = None
        self._away_until_ns = 0
        self._stopping = False
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        shown = f"[{host}]" if ":" in host else host
        try:
            self._listener = socket.create_server((host, port), family=family)
        except OSError as error:
            raise ConfigError(
                f"--usbip {shown}:{port}: {error.strerror}; name another HOST:PORT, or 0 for any"
                " free port"
            ) from error
        self.address = f"{shown}:{self._listener.getsockname()[1]}"

    def stop(self) -> None:
        """End `serve` soon."""
        self._stopping = True

    def serve(self) -> None:
        """Serve until `stop`."""
        try:
            while not self._stopping:
                ready = self._readable()
                if self._listener.fileno() in ready:
                    self._accept()
                for peer in [one for one in self._peers if one.connection.fileno() in ready]:
                    self._guarded(peer, self._serve_peer)
                if self._importer is not None:
                    self._guarded(self._importer, self._complete)
        finally:
            self._listener.close()
            for peer in self._peers:
                peer.connection.close()

    def _readable(self) -> set[int]:
        """Wait for input until the next transfer is due; return the ready descriptors."""
        # a new object each time: connections change; `select` accepts no descriptor above 1023
        poller = poll()
        for one in (self._listener, *(peer.connection for peer in self._peers)):
            poller.register(one, POLLIN)
        pause_s = self._pause_s()
        if pause_s < POLL_STEP_S:  # poll counts whole milliseconds
            sleep(min(pause_s, SLEEP_S))
            pause_s = 0.0
        return {descriptor for descriptor, _ in poller.poll(int(pause_s / POLL_STEP_S))}

    def _pause_s(self) -> float:
        """Return the time without work unless input arrives."""
        if self._importer is None:
            return IDLE_NS / NS_PER_S
        due_ns = self._device.next_in_ns() if self._importer.waiting else None
        now_ns = self._clock.now_ns()
        pause_ns = HEARTBEAT_NS if due_ns is None else min(HEARTBEAT_NS, due_ns - now_ns)
        return max(0, pause_ns) / NS_PER_S

    def _accept(self) -> None:
        try:
            connection, (host, port, *_) = self._listener.accept()
            self._peers.append(Peer(connection, f"{host}:{port}"))
        except OSError:  # it has left already, or there are no descriptors
            return
        if len(self._peers) > MOST_PEERS:
            self._drop(next(peer for peer in self._peers if peer is not self._importer))

    def _guarded(self, peer: Peer, act: Callable[[Peer], None]) -> None:
        """Call `act`, and close this connection when it ends."""
        try:
            act(peer)
        except TransferFault as pulled:
            self._away_until_ns = self._clock.now_ns() + round((pulled.away_s or 0) * NS_PER_S)
            self._drop(peer)
        except PeerClosed:
            self._drop(peer)

    def _drop(self, peer: Peer) -> None:
        self._peers.remove(peer)
        peer.connection.close()
        if peer is self._importer:
            self._importer = None
            self._tell(f"detached from {peer.name}")

    def _serve_peer(self, peer: Peer) -> None:
        peer.receive()
        while self._serve_transfer(peer) if peer is self._importer else self._serve_question(peer):
            pass

    # --- questions --------------------------------------------------------------------------------
    def _serve_question(self, peer: Peer) -> bool:
        """Serve one question, if it is complete; return whether there may be another."""
        if len(peer.received) < OPERATION.size:
            return False
        _version, code, _status = OPERATION.unpack_from(peer.received)
        if code == OP_REQ_DEVLIST:
            one = INTERFACE.pack(VENDOR_CLASS, 0, 0, 0)
            head = OPERATION.pack(VERSION, OP_REP_DEVLIST, DONE)
            peer.send(head, COUNT.pack(1), self._about(), one)
            raise PeerClosed
        if code != OP_REQ_IMPORT:
            raise PeerClosed
        question = peer.take(OPERATION.size + BUS_ID_BYTES)
        if question is None:
            return False
        self._import(peer, question[OPERATION.size :].rstrip(b"\0").decode(errors="replace"))
        return True

    def _import(self, peer: Peer, bus_id: str) -> None:
        now_ns = self._clock.now_ns()
        away = bus_id != BUS_ID or now_ns < self._away_until_ns
        status = NO_DEVICE if away else BUSY if self._importer is not None else DONE
        reply = OPERATION.pack(VERSION, OP_REP_IMPORT, status)
        if status != DONE:
            peer.send(reply)
            raise PeerClosed
        self._device.plug(now_ns)
        self._importer = peer
        self._tell(f"attached to {peer.name}")
        peer.send(reply, self._about())

    def _about(self) -> bytes:
        """Return the board's description in the protocol."""
        one = usb_device.device_descriptor(1)
        return DEVICE.pack(
            f"/sys/devices/simulated/{BUS_ID}".encode(),
            BUS_ID.encode(),
            one.bus,
            one.address,
            one.speed,
            one.idVendor,
            one.idProduct,
            one.bcdDevice,
            one.bDeviceClass,
            one.bDeviceSubClass,
            one.bDeviceProtocol,
            self._device.configuration,
            one.bNumConfigurations,
            1,
        )

    # --- transfers --------------------------------------------------------------------------------
    def _serve_transfer(self, peer: Peer) -> bool:
        """Serve one transfer or its unlink, if it is complete; return whether there may
        be another.
        """
        if len(peer.received) < URB.size:
            return False
        command, number, _device, inwards, endpoint, rest = URB.unpack_from(peer.received)
        if command == CMD_UNLINK:
            peer.take(URB.size)
            self._unlink(peer, number, *UNLINK.unpack(rest))
            return True
        _flags, length, _start, _packets, _interval, setup = SUBMIT.unpack(rest)
        if command != CMD_SUBMIT or not 0 <= length <= LONGEST_BYTES:
            raise PeerClosed
        transfer = peer.take(URB.size + (0 if inwards else length))
        if transfer is None:
            return False
        data = memoryview(transfer)[URB.size :]
        address = endpoint | (usb_device.IN_BIT if inwards and endpoint else 0)
        with _reported(peer, number):
            self._submit(
                peer, PendingSubmit(number, address, length), usb_device.Setup.of(setup), data
            )
        return True

    def _submit(
        self, peer: Peer, urb: PendingSubmit, setup: usb_device.Setup, data: memoryview
    ) -> None:
        """Begin a transfer; it ends here or waits."""
        now_ns = self._clock.now_ns()
        if urb.endpoint == 0:
            reply = self._device.control(setup, now_ns)
            if reply is not None:
                inwards = setup.request_type & usb_device.IN_BIT
                return peer.answer(urb.number, DONE, len(reply) if inwards else urb.room, reply)
        elif not urb.endpoint & usb_device.IN_BIT and self._device.write(
            urb.endpoint, data, now_ns
        ):
            return peer.answer(urb.number, DONE, urb.room)
        if len(peer.waiting) >= MOST_WAITING:
            raise PeerClosed
        peer.waiting.append(urb)
        return None

    def _unlink(self, peer: Peer, number: int, victim: int) -> None:
        """Cancel `victim`; status 0 means that it had ended before."""
        left = [urb for urb in peer.waiting if urb.number != victim]
        status = DONE if len(left) == len(peer.waiting) else -errno.ECONNRESET
        peer.waiting = left
        peer.send(RETURN.pack(RET_UNLINK, number, 0, 0, 0, status, 0, 0, 0, 0))

    def _complete(self, peer: Peer) -> None:
        """Play the board, and complete waiting transfers in order."""
        now_ns = self._clock.now_ns()
        self._device.advance(now_ns)
        for urb in [one for one in peer.waiting if one.endpoint & usb_device.IN_BIT]:
            with _reported(peer, urb.number):
                packet = self._device.read(urb.endpoint, urb.room, now_ns)
                if packet is None:
                    return
                peer.answer(urb.number, DONE, len(packet), packet)
            peer.waiting.remove(urb)


@contextmanager
def _reported(peer: Peer, number: int) -> Iterator[None]:
    """End a failing transfer with its errno; re-raise an unplug."""
    try:
        yield
    except TransferFault as fault:
        peer.answer(number, -fault.number, 0)
        if fault.away_s is not None:
            raise
