"""The simulated board at the end of a bus that takes its time, and how a board is put together.

One transfer after the other, as libusb's synchronous calls do it: a write is submitted, reaches the
board, and returns when its caller has been woken. A read takes the packet that waits, or the next
one as soon as it is latched and the controller asks for it; meanwhile what the board latches waits
in the board, queued or replaced. In virtual time the clock moves, live it passes. The bus is either
`sim.bus.FixedBus`, a time for each direction (`out_transport_us`, `in_transport_us`: 0.33 ms a pair
at the median in a Linux kernel, 0.48 ms at the 99th percentile), or the model `FullSpeedBus`.
Transfers in flight take the same bus (`sim.flight`).

What would break it: a time-out shorter than the transport (the packet is delivered all the same,
late, as libusb does when its timer fires late).
"""

from array import array
from collections.abc import Callable

from hapticd.core.clock import Clock
from hapticd.core.params import BoardParams
from hapticd.core.units import NS_PER_US
from hapticd.sim.backend import Handle, SimulatedBackend, Unready
from hapticd.sim.board import make_board
from hapticd.sim.bus import FixedBus, FullSpeedBus
from hapticd.sim.descriptors import Transfer
from hapticd.sim.injection import with_injections

__all__ = ["make_backend"]


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
    """The backend at which the board of `params` is plugged in. ConfigError if they describe none.

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
