"""Simulated USB: a full-speed bus, asynchronous transfers over it, and the errors of libusb.

Errors (`usb_error`). Numbers, codes and texts are those of pyusb on libusb 1.0 on Linux.

Bus (`FullSpeedBus`). Full-speed USB behind an xHCI controller, on the clock of the simulation. A
frame of 1 ms begins with its SOF, on a separate clock, and then carries the periodic transfers of
other devices. Bulk transfers follow as soon as there is room, and no transaction crosses the end of
a frame.

    one packet    13 bytes of overhead and the data at 12 Mbit/s: 51.3 us for 64 bytes, 59.3 us
                  with the worst bit stuffing (USB 2.0, table 5-9 and section 5.11.3)
    bulk IN       NAK until the board has a frame; the controller polls again at its own interval
                  (16 us is the reset value of NAK_POLL in the RP2040's host controller; a
                  controller based on microframes takes 125 us)
    interrupt     once a frame, at a place in it that the controller chooses
    hub           behind a high-speed hub each direction begins with a microframe: at its boundary,
                  and one later where the hub needs two (USB 2.0, section 11.14)
    completion    at most one interrupt in `moderation_us` (xhci-pci.c of Linux: 40 us)
    host          submission, completion and wake-up each take four fifths of their mean and an
                  exponential rest: 99th percentile over median 1.8, between the 1.2 and 2.4 of
                  cyclictest on a quiet and on a loaded machine. The means are assumed, except for
                  the wake-up's 13 us (cyclictest) and its system calls.

Checks of the model: 19 packets of 64 bytes fit into a frame (USB 2.0, table 5-9). 1,024 bytes of
bulk take 1.68 ms out and 1.35 ms in on an STM32 with one buffer (zephyr #97729). It answers each
OUT with NAK once and is ready again about 30 us after each packet. One interrupt transfer at a time
takes 0.5 to 1 ms (rusb #21). All results of this model are labelled "model" and stated as a band
over `BAND`, since no bus was measured for it. Limitations: transfers of more than one packet, two
of one direction at once, a controller that serves bulk by microframes only.

Asynchronous transfers (`Flight`). They implement the interface of `usb.flight` to a backend: one
OUT and one IN are submitted, and reaped when they are complete. The bus determines when each packet
is on the wire. There is no background activity: whenever the host polls, `play` performs the past
events in the order of time. A waiting IN takes the first frame of the board, an OUT reaches the
board when it has passed the bus.

As in usbfs, an OUT is copied when it is submitted and an IN when it is reaped. An OUT that meets
NAK stays pending, and is retried whenever the host polls. A failed transfer ends with its error;
one of a removed device ends with ENODEV. A board must have one owner. Limitations: the board's
state between two polls of the host is not updated.
"""

import errno
from array import array
from math import ceil
from random import Random
from typing import TYPE_CHECKING, NamedTuple

from usb.core import USBError, USBTimeoutError

from hapticd.core.units import NS_PER_MS, NS_PER_US, Clock
from hapticd.model.params import BusParams
from hapticd.sim.injection import Port, TransferFault
from hapticd.usb.frames import HELLO_BYTES, IN_BYTES, PACKET_BYTES

if TYPE_CHECKING:
    from hapticd.sim.backend import PluggedDevice, SimulatedBackend


# --- errors ---------------------------------------------------------------------------------------

LIBUSB_ERRORS = {  # errno: (libusb code, libusb_strerror)
    errno.EIO: (-1, "Input/Output Error"),
    errno.EINVAL: (-2, "Invalid parameter"),
    errno.EACCES: (-3, "Access denied (insufficient permissions)"),
    errno.ENODEV: (-4, "No such device (it may have been disconnected)"),
    errno.ENOENT: (-5, "Entity not found"),
    errno.EBUSY: (-6, "Resource busy"),
    errno.ETIMEDOUT: (-7, "Operation timed out"),
    errno.EOVERFLOW: (-8, "Overflow"),
    errno.EPIPE: (-9, "Pipe error"),
    errno.EINTR: (-10, "System call interrupted (perhaps due to signal)"),
    errno.ENOMEM: (-11, "Insufficient memory"),
    errno.ENOSYS: (-12, "Operation not supported or unimplemented on this platform"),
}


def usb_error(number: int) -> Exception:
    """Return the exception of pyusb's libusb1 backend for `number`; ENOSYS is not a
    USBError there.
    """
    code, text = LIBUSB_ERRORS[number]
    if number == errno.ENOSYS:
        return NotImplementedError(text)
    error: Exception = (USBTimeoutError if number == errno.ETIMEDOUT else USBError)(
        text, code, number
    )
    return error


# --- bus ------------------------------------------------------------------------------------------

MICROFRAMES = 8  # in a frame
BIT_NS = 1000.0 / 12.0
OVERHEAD_BYTES = 13  # of a bulk or interrupt transaction
SOF_NS = round(35 * BIT_NS)  # its packet, with SYNC and EOP
END_NS = round(32 * BIT_NS)  # the wire must be idle this long before the end of a frame (EOF1)
SETUP_BYTES = 8
FIXED = 0.8  # share of a host's cost that never varies

BAND = {  # uncertainties of a bus, one at a time
    "root port": BusParams(),
    "interrupt": BusParams(transfer="interrupt"),
    "worst bit stuffing": BusParams(bit_stuffing=1.0),
    "asked by microframes": BusParams(nak_us=125.0),
    "asked at once": BusParams(nak_us=8.0),
    "hub, one microframe": BusParams(hub_microframes=1),
    "hub, two microframes": BusParams(hub_microframes=2),
    "no moderation": BusParams(moderation_us=0.0),
    "moderation 100 us": BusParams(moderation_us=100.0),
    "frames drift": BusParams(frame_ppm=100.0),
    "other devices": BusParams(periodic_us=200.0, busy=0.3),
    "quick host": BusParams(submit_us=4.0, complete_us=6.0, wake_us=8.0),
    "slow host": BusParams(submit_us=20.0, complete_us=30.0, wake_us=40.0),
}


class TransferTime(NamedTuple):
    """Times of a transfer: of the packet at the board, and of completion in the host's kernel."""

    board_ns: int
    host_ns: int


class FixedBus:
    """A bus with the same time for every transfer of a direction. Each method but `polled_ns` is
    called once a transfer, in the order of time.
    """

    def __init__(self, out_ns: int = 0, in_ns: int = 0) -> None:
        self._out_ns = out_ns
        self._in_ns = in_ns

    def submitted_ns(self, t_ns: int) -> int:
        """Return when a submission that begins at `t_ns` returns."""
        return t_ns

    def out(self, t_ns: int, size: int) -> TransferTime:
        """Transfer an OUT of `size` bytes, submitted by `t_ns`."""
        return TransferTime(t_ns + self._out_ns, t_ns + self._out_ns)

    def polled_ns(self, asked_ns: int, ready_ns: int) -> int:
        """Return when the controller takes an IN that was submitted by `asked_ns` and is in the
        board from `ready_ns` on.
        """
        return ready_ns if ready_ns > asked_ns else asked_ns

    def received_ns(self, polled_ns: int) -> int:
        """Return when the host's kernel has the IN taken at `polled_ns`."""
        return polled_ns + self._in_ns

    def woken_ns(self, t_ns: int) -> int:
        """Return when a thread runs that waited for a completion at `t_ns`."""
        return t_ns

    def control_ns(self, t_ns: int) -> int:
        """Return when a control transfer that begins at `t_ns` returns."""
        return t_ns + self._out_ns + self._in_ns


class FullSpeedBus:
    """The bus of `params`, in one of its possible histories, chosen by `seed`; its methods are
    those of a FixedBus.
    """

    def __init__(self, params: BusParams, seed: int = 1) -> None:
        self._params = params
        self._random = Random(seed)
        self._frame_ns = NS_PER_MS * (1.0 + 1e-6 * params.frame_ppm)
        self._origin_ns = self._random.randrange(NS_PER_MS)  # of a SOF
        # position in the frame of interrupt endpoints: out, in
        self._places = (self._random.random(), self._random.random())
        self._nak_ns = max(1, round(params.nak_us * NS_PER_US))
        if params.hub_microframes:
            self._nak_ns = max(self._nak_ns, NS_PER_MS // MICROFRAMES)
        self._interrupt_ns = -NS_PER_MS

    def submitted_ns(self, t_ns: int) -> int:
        return t_ns + self._cost_ns(self._params.submit_us)

    def out(self, t_ns: int, size: int) -> TransferTime:
        end_ns = self.transacted_ns(self._served_ns(t_ns, 0), self.wire_ns(size))
        return TransferTime(end_ns, self._completed_ns(self._split_ns(end_ns)))

    def polled_ns(self, asked_ns: int, ready_ns: int) -> int:
        if self._params.transfer == "interrupt":
            return self._served_ns(max(asked_ns, ready_ns), 1)
        naks = max(0, ceil((ready_ns - asked_ns) / self._nak_ns))
        return self._split_ns(asked_ns) + naks * self._nak_ns

    def received_ns(self, polled_ns: int) -> int:
        end_ns = self.transacted_ns(polled_ns, self.wire_ns(IN_BYTES))
        return self._completed_ns(self._split_ns(end_ns))

    def woken_ns(self, t_ns: int) -> int:
        return t_ns + self._cost_ns(self._params.wake_us)

    def control_ns(self, t_ns: int) -> int:
        t_ns = self.submitted_ns(t_ns)
        for size in (SETUP_BYTES, PACKET_BYTES, HELLO_BYTES - PACKET_BYTES, 0):
            t_ns = self._split_ns(self.transacted_ns(self._split_ns(t_ns), self.wire_ns(size)))
        return self.woken_ns(self._completed_ns(t_ns))

    def wire_ns(self, size: int) -> int:
        """Return the time of a transaction with `size` bytes of data on the wire."""
        least_ns = 8 * BIT_NS * (OVERHEAD_BYTES + size)
        most_ns = 9107.0 + 83.54 * int(3.167 + 7.0 / 6.0 * 8.0 * size)  # section 5.11.3
        return round(least_ns + self._params.bit_stuffing * (most_ns - least_ns))

    def transacted_ns(self, t_ns: int, wire_ns: int) -> int:
        """Return the end of a transaction that may begin at `t_ns` and takes `wire_ns`."""
        params = self._params
        if params.busy and self._random.random() < params.busy:
            t_ns += round(self._random.random() * self.wire_ns(PACKET_BYTES))
        taken_ns = SOF_NS + round(params.periodic_us * NS_PER_US)
        frame = int((t_ns - self._origin_ns) // self._frame_ns)
        while True:
            begin_ns = max(t_ns, self._sof_ns(frame) + taken_ns)
            frame += 1
            if begin_ns + wire_ns <= self._sof_ns(frame) - END_NS:
                return begin_ns + wire_ns

    def _sof_ns(self, frame: int) -> int:
        return self._origin_ns + round(frame * self._frame_ns)

    def _served_ns(self, t_ns: int, direction: int) -> int:
        """Return when the controller begins with an endpoint that is ready at `t_ns`."""
        if self._params.transfer == "bulk":
            return self._split_ns(t_ns)
        place_ns = self._origin_ns + self._places[direction] * self._frame_ns
        return round(place_ns + ceil((t_ns - place_ns) / self._frame_ns) * self._frame_ns)

    def _split_ns(self, t_ns: int) -> int:
        """Return the next slot through a high-speed hub from `t_ns` on."""
        microframes = self._params.hub_microframes
        if not microframes:
            return t_ns
        microframe_ns = self._frame_ns / MICROFRAMES
        boundary = ceil((t_ns - self._origin_ns) / microframe_ns)
        return self._origin_ns + round((boundary + microframes - 1) * microframe_ns)

    def _completed_ns(self, t_ns: int) -> int:
        moderation_ns = round(self._params.moderation_us * NS_PER_US)
        self._interrupt_ns = max(t_ns, self._interrupt_ns + moderation_ns)
        return self._interrupt_ns + self._cost_ns(self._params.complete_us)

    def _cost_ns(self, mean_us: float) -> int:
        varies = (1.0 - FIXED) * self._random.expovariate(1.0)
        return round((FIXED + varies) * mean_us * NS_PER_US)


Bus = FixedBus | FullSpeedBus

# --- asynchronous transfers -----------------------------------------------------------------------

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
