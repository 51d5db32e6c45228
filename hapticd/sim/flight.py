"""Asynchronous transfers of the simulated board.

It implements the interface of `usb.flight` to a backend: one OUT and one IN are submitted, and
reaped when they are complete. The bus (`sim.bus`) determines when each packet is on the wire. There
is no background activity: whenever the host polls, `play` performs the past events in the order of
time. A waiting IN takes the first frame of the board, an OUT reaches the board when it has passed
the bus.

As in usbfs, an OUT is copied when it is submitted and an IN when it is reaped. An OUT that meets
NAK stays pending, and is retried whenever the host polls. A failed transfer ends with its error;
one of a removed device ends with ENODEV.

Limitations: the board's state between two polls of the host is not updated. A board must have one
owner.
"""

import errno
from array import array
from typing import TYPE_CHECKING

from hapticd.core.clock import Clock
from hapticd.sim.bus import Bus
from hapticd.sim.errors import usb_error
from hapticd.sim.injection import Port, TransferFault

if TYPE_CHECKING:
    from hapticd.sim.backend import PluggedDevice, SimulatedBackend

PENDING = -1  # in place of the number of bytes
EVER_NS = 1 << 62


class Flight:
    """At most one OUT and one IN of `device`, the board behind `port`."""

    def __init__(
        self,
        backend: "SimulatedBackend",
        port: Port,
        device: "PluggedDevice",
        out_endpoint: int,
        in_endpoint: int,
        bus: Bus,
        clock: Clock,
    ) -> None:
        self._backend = backend
        self._port = port
        self._device = device
        self._out_endpoint = out_endpoint
        self._in_endpoint = in_endpoint
        self._bus = bus
        self._clock = clock
        self._out: bytes | None = None  # in transit, not in the board yet
        self._refused = False  # it has met NAK
        self._arrives_ns = 0
        self._out_done_ns = 0
        self._out_failure: Exception | None = None
        self._asked_ns = EVER_NS  # no IN is requested
        self._packet: bytes | None = None  # taken from the board
        self._in_done_ns = EVER_NS
        self._in_failure: Exception | None = None

    def submit_out(self, data: "array[int]") -> None:
        """Send `data`. ENODEV."""
        now_ns = self._submitted_ns()
        if self._out_endpoint in self._device.halted:
            self._out_done_ns = now_ns
            self._out_failure = usb_error(errno.EPIPE)
            return
        self._out = data.tobytes()
        self._arrives_ns, self._out_done_ns = self._bus.out(now_ns, len(data))
        if self._arrives_ns <= now_ns:
            self._deliver(self._out, now_ns)

    def submit_in(self) -> None:
        """Request a packet. ENODEV."""
        now_ns = self._submitted_ns()
        self._asked_ns = now_ns
        self._in_done_ns = EVER_NS
        if self._in_endpoint in self._device.halted:
            self._in_failure = usb_error(errno.EPIPE)
            self._in_done_ns = now_ns

    def out_done(self, wait_ns: int) -> bool:
        """Return whether the OUT has arrived, after waiting for at most `wait_ns`.

        USBError if it failed.
        """
        now_ns = self._clock.now_ns()
        deadline_ns = now_ns + wait_ns
        while not (self._out_ended(now_ns) or self._out_ended(now_ns := self._look())):
            if now_ns >= deadline_ns:
                return False
            self._backend.wait_until(min(deadline_ns, self._next_ns(now_ns)))
        failure = self._out_failure
        if failure is not None:
            self._out_failure = None
            raise failure
        return True

    def in_done(self, buffer: "array[int]", wait_ns: int) -> int:
        """Return the bytes of the IN, now in `buffer`, or PENDING after `wait_ns`. USBError if it
        failed.
        """
        deadline_ns = self._clock.now_ns() + wait_ns
        while (now_ns := self._look()) < self._in_done_ns:
            if now_ns >= deadline_ns:
                self._port.advance(now_ns)
                return PENDING
            self._backend.wait_until(min(deadline_ns, self._next_ns(now_ns)))
        self._asked_ns = EVER_NS
        failure, packet = self._in_failure, self._packet
        self._in_failure = self._packet = None
        if failure is not None:
            raise failure
        assert packet is not None
        if len(packet) > len(buffer):
            raise usb_error(errno.EOVERFLOW)
        memoryview(buffer)[: len(packet)] = packet
        return len(packet)

    def clear_halt(self, endpoint: int) -> None:
        """Clear the halt of an endpoint. ENODEV."""
        self._look()
        assert self._device.owner is not None
        self._backend.clear_halt(self._device.owner, endpoint)

    def cancel(self) -> None:
        """Cancel both; a packet already in the board stays there."""
        self.play()
        self._out = None
        self._asked_ns = EVER_NS

    def play(self) -> None:
        """Perform the events up to now."""
        self._play(self._clock.now_ns())

    def _look(self) -> int:
        """Perform `play` and return the time [ns]. ENODEV."""
        now_ns = self._clock.now_ns()
        self._play(now_ns)
        if self._device.gone and self._out_failure is None:
            raise usb_error(errno.ENODEV)
        return now_ns

    def _submitted_ns(self) -> int:
        now_ns = self._clock.now_ns()
        submitted_ns = self._bus.submitted_ns(now_ns)
        if submitted_ns > now_ns:
            self._backend.wait_until(submitted_ns)
        return self._look()

    def _out_ended(self, now_ns: int) -> bool:
        return self._out is None and self._out_done_ns <= now_ns

    def _next_ns(self, now_ns: int) -> int:
        """Return the time of the next event, as far as it is known."""
        coming = [self._in_done_ns]
        if self._out is None:
            coming.append(self._out_done_ns)
        elif not self._refused:
            coming.append(self._arrives_ns)
        if self._waits():
            due_ns = self._port.next_in_ns()
            if due_ns is not None:
                coming.append(self._bus.polled_ns(self._asked_ns, due_ns))
        return min((one for one in coming if one > now_ns), default=EVER_NS)

    def _waits(self) -> bool:
        """Return whether an IN is requested and has not arrived."""
        return self._asked_ns < self._in_done_ns == EVER_NS

    def _play(self, now_ns: int) -> None:
        if self._out is not None and self._arrives_ns <= now_ns:
            arrives_ns = now_ns if self._refused else self._arrives_ns
            self._serve(arrives_ns)
            self._deliver(self._out, arrives_ns)
        self._serve(now_ns)

    def _deliver(self, data: bytes, t_ns: int) -> None:
        if self._device.gone:
            return
        self._refused = False
        try:
            self._backend.deliver(memoryview(data), t_ns)
        except TransferFault as fault:
            if fault.number == errno.ETIMEDOUT:
                self._refused = True
                self._arrives_ns = t_ns + 1
                return
            self._out_failure = self._backend.failure(fault, self._device, self._out_endpoint)
        self._out = None
        self._out_done_ns = max(self._out_done_ns, t_ns)

    def _serve(self, now_ns: int) -> None:
        """Pass the board's frame to a waiting IN, if the controller has polled it."""
        while self._waits() and not self._device.gone:
            due_ns = self._port.next_in_ns()
            if due_ns is None:
                return
            polled_ns = self._bus.polled_ns(self._asked_ns, due_ns)
            if polled_ns > now_ns:
                return
            try:
                self._packet = self._port.poll_in(polled_ns)
            except TransferFault as fault:
                self._in_failure = self._backend.failure(fault, self._device, self._in_endpoint)
            if self._packet is not None or self._in_failure is not None:
                self._in_done_ns = self._bus.received_ns(polled_ns)
