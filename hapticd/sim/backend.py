"""The simulated board as a pyusb backend, so that the real `usb.core` runs on top of it.

It answers like libusb 1.0 on Linux (same exceptions, numbers and texts). A plugged device is
configured by the kernel. A claimed interface refuses other users and any change of configuration. A
halted endpoint stays halted until clear_halt. A handle of an unplugged device is permanently dead.
A device that is plugged again has a new address, and the dead one is still listed for one more
enumeration. A read waits until the IN is latched, in wall time and in virtual time, and always
ends.

A `DistantBackend` is at the end of a bus (`sim.bus`) with transfer times. Transfers are sequential,
like libusb's synchronous calls: a write is submitted, reaches the board, and returns when its
caller wakes. A read takes the waiting packet, or the next one when it is latched and the controller
polls it. Meanwhile the board queues or replaces latched packets. Asynchronous transfers use the
same bus (`sim.bus`).

Only one thread may use it (there is no lock within a tick). Limitations: a time-out shorter than
the transport (the packet is still delivered, late, as by libusb when its timer fires late).
"""

import errno
from array import array
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import NamedTuple, NoReturn

import usb.backend

from hapticd.core.units import NS_PER_MS, NS_PER_S, NS_PER_US, Clock, MonotonicClock
from hapticd.model.params import BoardParams
from hapticd.sim.board import make_board
from hapticd.sim.bus import Bus, FixedBus, Flight, FullSpeedBus, usb_error
from hapticd.sim.injection import Port, TransferFault, with_injections
from hapticd.sim.usb_device import (
    Transfer,
    configuration_descriptor,
    device_descriptor,
    endpoint_descriptor,
    interface_descriptor,
)
from hapticd.usb.codec import VENDOR_OUT

__all__ = ["SimulatedBackend", "make_backend"]

SPIN_NS = 60 * NS_PER_US  # a sleep of the machine is coarser than this
ENDLESS_MS = 60_000  # libusb's time-out 0 is endless; the simulated board gives up


class PluggedDevice:
    """One connection of the board to the bus, from plug to unplug."""

    def __init__(self, address: int, boot_loader: bool = False) -> None:
        self.address = address
        self.boot_loader = boot_loader
        self.gone = False
        self.configuration = 1  # Linux configures at enumeration
        self.owner: Handle | None = None
        self.halted: set[int] = set()


class Handle:
    """An opened device; two of them are two owners."""

    def __init__(self, device: PluggedDevice) -> None:
        self.device = device


class Unready(NamedTuple):
    """Time after a plug until the board is ready, and the boot loader's reply to HELLO."""

    rights_s: float = 0.0  # until it may be opened, as while udev runs
    hello_s: float = 0.0  # until it answers requests
    boot_loader_s: float = 0.0  # until the boot loader leaves the bus and the board appears
    boot_hello: bytes | None = None  # None: it stalls


READY = Unready()
NO_BUS = FixedBus()


class SimulatedBackend(usb.backend.IBackend):  # type: ignore[misc]  # pyusb has no types
    """pyusb backend over `port`. `access_denied` and `kernel_driver` may be set to simulate a
    misconfigured machine, `unready` boards that are present before they are ready.
    """

    def __init__(
        self,
        port: Port,
        clock: Clock,
        transfer: Transfer = "bulk",
        unready: Unready = READY,
        bus: Bus = NO_BUS,
    ) -> None:
        self._port = port
        self._clock = clock
        self._bus = bus
        self._flight: Flight | None = None
        self.deliver = port.on_out  # an OUT packet reaches the board, with either kind of transfer
        self._transfer = transfer
        self._spin_ns = SPIN_NS if isinstance(clock, MonotonicClock) else 0
        self._addresses = 0
        self._stale: PluggedDevice | None = None
        self._replug_ns: int | None = None
        self.access_denied = False
        self.kernel_driver = False
        self.unready = unready
        self._plugged_ns = 0
        self.device: PluggedDevice | None = None
        self.plug()

    # --- the cable --------------------------------------------------------------------------------
    def plug(self) -> None:
        """Plug the board in: it powers up and gets a new address. Do nothing if it is
        plugged in.
        """
        if self.device is None:
            self._addresses += 1
            self._replug_ns = None
            self._port.power_up()
            self.device = PluggedDevice(self._addresses, self.unready.boot_loader_s > 0.0)
            self._plugged_ns = self._clock.now_ns()

    def unplug(self, away_s: float | None = None) -> None:
        """Unplug the board; it returns by itself after `away_s`, if given."""
        if self.device is not None:
            self.device.gone = True
            self._stale = self.device
            self.device = None
        self._replug_ns = (
            None if away_s is None else self._clock.now_ns() + round(away_s * NS_PER_S)
        )

    # --- enumeration ------------------------------------------------------------------------------
    def enumerate_devices(self) -> Iterator[PluggedDevice]:
        if self._replug_ns is not None and self._clock.now_ns() >= self._replug_ns:
            self.plug()
        if self.device is not None and self.device.boot_loader:
            self._leave_boot_loader(self.device)
        stale = self._stale
        self._stale = None
        return iter([device for device in (stale, self.device) if device is not None])

    def _leave_boot_loader(self, device: PluggedDevice) -> None:
        """Leave the bus after the boot loader's time; the board then appears with a new address."""
        if self._since_plug(self.unready.boot_loader_s):
            device.gone = True
            self._stale = device
            self._addresses += 1
            self.device = PluggedDevice(self._addresses)

    def _since_plug(self, time_s: float) -> bool:
        """Return whether `time_s` has passed since the board was plugged in."""
        return self._clock.now_ns() - self._plugged_ns >= round(time_s * NS_PER_S)

    def get_parent(self, device: PluggedDevice) -> None:
        return None

    def get_device_descriptor(self, device: PluggedDevice) -> SimpleNamespace:
        return device_descriptor(device.address)

    def get_configuration_descriptor(self, device: PluggedDevice, index: int) -> SimpleNamespace:
        return configuration_descriptor(index)

    def get_interface_descriptor(
        self, device: PluggedDevice, index: int, alternate: int, _: int
    ) -> SimpleNamespace:
        return interface_descriptor(index, alternate)

    def get_endpoint_descriptor(
        self, device: PluggedDevice, index: int, _i: int, _a: int, _c: int
    ) -> SimpleNamespace:
        return endpoint_descriptor(index, self._transfer)

    # --- life of a handle -------------------------------------------------------------------------
    def open_device(self, device: PluggedDevice) -> Handle:
        if self.access_denied or not self._since_plug(self.unready.rights_s):
            raise usb_error(errno.EACCES)
        return Handle(_alive(device))

    def close_device(self, handle: Handle) -> None:
        _release(handle)

    def get_configuration(self, handle: Handle) -> int:
        return _alive(handle.device).configuration

    def set_configuration(self, handle: Handle, value: int) -> None:
        device = _alive(handle.device)
        if device.owner is not None:
            raise usb_error(errno.EBUSY)
        device.configuration = value
        # a new configuration resets every endpoint
        device.halted.clear()

    def claim_interface(self, handle: Handle, interface: int) -> None:
        device = _alive(handle.device)
        if device.owner not in (None, handle) or self.kernel_driver:
            raise usb_error(errno.EBUSY)
        device.owner = handle

    def release_interface(self, handle: Handle, interface: int) -> None:
        _release(handle)
        _alive(handle.device)

    def set_interface_altsetting(self, handle: Handle, interface: int, alternate: int) -> None:
        _alive(handle.device).halted.clear()

    def clear_halt(self, handle: Handle, endpoint: int) -> None:
        _alive(handle.device).halted.discard(endpoint)

    def reset_device(self, handle: Handle) -> None:
        _alive(handle.device).halted.clear()

    def is_kernel_driver_active(self, handle: Handle, interface: int) -> bool:
        _alive(handle.device)
        return self.kernel_driver

    def detach_kernel_driver(self, handle: Handle, interface: int) -> None:
        _alive(handle.device)
        if not self.kernel_driver:
            raise usb_error(errno.ENOENT)
        self.kernel_driver = False

    def attach_kernel_driver(self, handle: Handle, interface: int) -> None:
        _alive(handle.device)
        raise usb_error(errno.ENOENT)

    # --- transfers --------------------------------------------------------------------------------
    def ctrl_transfer(
        self,
        handle: Handle,
        request_type: int,
        request: int,
        value: int,
        index: int,
        data: "array[int]",
        timeout_ms: int,
    ) -> int:
        device = _alive(handle.device)
        if self._flight is not None:
            self._flight.play()
        vendor = request_type & VENDOR_OUT
        if vendor and not self._since_plug(self.unready.hello_s):
            self.wait_until(self._clock.now_ns() + (timeout_ms or ENDLESS_MS) * NS_PER_MS)
            raise usb_error(errno.ETIMEDOUT)
        if vendor and device.boot_loader:
            reply = self.unready.boot_hello
        else:
            reply = self._port.control(request_type, request, value, len(data))
        if reply is None:
            raise usb_error(errno.EPIPE)
        memoryview(data)[: len(reply)] = reply
        return len(reply)

    def bulk_write(
        self, handle: Handle, endpoint: int, interface: int, data: "array[int]", timeout_ms: int
    ) -> int:
        device = handle.device
        if device.gone or device.halted:
            self._check(device, endpoint)
        try:
            self.deliver(memoryview(data), self._clock.now_ns())
        except TransferFault as fault:
            self._fail(fault, device, endpoint, timeout_ms)
        return len(data)

    def bulk_read(
        self, handle: Handle, endpoint: int, interface: int, buffer: "array[int]", timeout_ms: int
    ) -> int:
        device = handle.device
        if device.gone or device.halted:
            self._check(device, endpoint)
        try:
            packet = self._port.poll_in(self._clock.now_ns())
            if packet is None:
                packet = self._wait(timeout_ms)
        except TransferFault as fault:
            self._fail(fault, device, endpoint, timeout_ms)
        if len(packet) > len(buffer):
            raise usb_error(errno.EOVERFLOW)
        memoryview(buffer)[: len(packet)] = packet
        return len(packet)

    # pyusb chooses one by the type of the endpoint; the board makes no difference
    intr_write = bulk_write
    intr_read = bulk_read

    def _wait(self, timeout_ms: int) -> bytes:
        """Return the next IN packet, if it arrives within the time allowed."""
        port = self._port
        clock = self._clock
        deadline_ns = clock.now_ns() + (timeout_ms or ENDLESS_MS) * NS_PER_MS
        while True:
            due_ns = port.next_in_ns()
            wake_ns = deadline_ns if due_ns is None else min(due_ns, deadline_ns)
            self.wait_until(wake_ns)
            packet = port.poll_in(clock.now_ns())
            if packet is not None:
                return packet
            if clock.now_ns() >= deadline_ns:
                raise usb_error(errno.ETIMEDOUT)

    def wait_until(self, wake_ns: int) -> None:
        """Return at `wake_ns`. It wakes early and spins the rest; virtual time needs no spin."""
        clock = self._clock
        clock.sleep_until_ns(wake_ns - self._spin_ns)
        while self._spin_ns and clock.now_ns() < wake_ns:
            pass

    def _check(self, device: PluggedDevice, endpoint: int) -> None:
        _alive(device)
        if endpoint in device.halted:
            raise usb_error(errno.EPIPE)

    def _fail(
        self, fault: TransferFault, device: PluggedDevice, endpoint: int, timeout_ms: int
    ) -> NoReturn:
        # the packet was not accepted: the host tries until its time is over
        if fault.number == errno.ETIMEDOUT:
            self.wait_until(self._clock.now_ns() + (timeout_ms or ENDLESS_MS) * NS_PER_MS)
        raise self.failure(fault, device, endpoint) from None

    def failure(self, fault: TransferFault, device: PluggedDevice, endpoint: int) -> Exception:
        """Return the error of a transfer with `fault`, and set the state of endpoint and cable."""
        if fault.number == errno.EPIPE:
            device.halted.add(endpoint)
        # the current transfer fails with its own number; only the next one finds no device
        if fault.away_s is not None:
            self.unplug(fault.away_s)
        return usb_error(fault.number)

    # --- transfers in flight ----------------------------------------------------------------------
    def transfers(self, out_endpoint: int, in_endpoint: int) -> Flight:
        """Return one OUT and one IN of the claimed board, submitted and reaped (`usb.flight`)."""
        assert self.device is not None
        ends = out_endpoint, in_endpoint
        self._flight = Flight(self, self._port, self.device, *ends, self._bus, self._clock)
        return self._flight


def _alive(device: PluggedDevice) -> PluggedDevice:
    if device.gone:
        raise usb_error(errno.ENODEV)
    return device


def _release(handle: Handle) -> None:
    if handle.device.owner is handle:
        handle.device.owner = None


class DistantBackend(SimulatedBackend):
    """A SimulatedBackend whose transfers take the time of its bus."""

    def ctrl_transfer(
        self,
        handle: Handle,
        request_type: int,
        request: int,
        value: int,
        index: int,
        data: "array[int]",
        timeout_ms: int,
    ) -> int:
        self.wait_until(self._bus.control_ns(self._clock.now_ns()))
        return super().ctrl_transfer(handle, request_type, request, value, index, data, timeout_ms)

    def bulk_write(
        self, handle: Handle, endpoint: int, interface: int, data: "array[int]", timeout_ms: int
    ) -> int:
        bus = self._bus
        passed = bus.out(bus.submitted_ns(self._clock.now_ns()), len(data))
        self.wait_until(passed.board_ns)
        count = super().bulk_write(handle, endpoint, interface, data, timeout_ms)
        self.wait_until(bus.woken_ns(passed.host_ns))
        return count

    def bulk_read(
        self, handle: Handle, endpoint: int, interface: int, buffer: "array[int]", timeout_ms: int
    ) -> int:
        bus = self._bus
        asked_ns = bus.submitted_ns(self._clock.now_ns())
        self.wait_until(asked_ns)
        count = super().bulk_read(handle, endpoint, interface, buffer, timeout_ms)
        polled_ns = bus.polled_ns(asked_ns, self._clock.now_ns())
        self.wait_until(bus.woken_ns(bus.received_ns(polled_ns)))
        return count

    intr_write = bulk_write
    intr_read = bulk_read


def make_backend(
    params: BoardParams, clock: Clock, on_slip: Callable[[int], None] | None = None
) -> SimulatedBackend:
    """Return the backend with the board of `params` plugged in. ConfigError for invalid ones.
    `on_slip(ns)` is called with the time that a paused host cost the simulation.
    """
    port = with_injections(make_board(params, on_slip), params)
    unready = Unready(params.rights_s, params.hello_s, params.boot_loader_s)
    if params.bus is not None:
        bus = FullSpeedBus(params.bus, params.seed)
        transfer: Transfer = "interrupt" if params.bus.transfer == "interrupt" else "bulk"
        return DistantBackend(port, clock, transfer, unready, bus)
    if not params.out_transport_us and not params.in_transport_us:
        return SimulatedBackend(port, clock, unready=unready)
    out_ns = round(params.out_transport_us * NS_PER_US)
    fixed = FixedBus(out_ns, round(params.in_transport_us * NS_PER_US))
    return DistantBackend(port, clock, unready=unready, bus=fixed)
