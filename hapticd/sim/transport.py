"""The simulated board at the end of a bus that takes its time, and how a board is put together.

A transfer of a real USB stack is submitted, waits for its place on the bus, and wakes its caller:
a pair of 32 bytes out and 64 bytes in takes 0.33 ms at the median in a Linux kernel, 0.48 ms at the
99th percentile. Here an OUT reaches the board `out_transport_us` after the host began to write, and
the write returns then. A read takes the packet that waits, or the next one as soon as it is
latched, and returns `in_transport_us` later; meanwhile what the board latches waits in the board,
queued or replaced. A control transfer takes both. In virtual time the clock moves, live it passes.

What would break it: a time-out shorter than the transport (the packet is delivered all the same,
late, as libusb does when its timer fires late).
"""

from array import array
from collections.abc import Callable

from hapticd.clock import Clock
from hapticd.params import BoardParams
from hapticd.sim.backend import Handle, SimulatedBackend, Unready
from hapticd.sim.board import make_board
from hapticd.sim.injection import Port, with_injections
from hapticd.units import NS_PER_US


class DistantBackend(SimulatedBackend):
    """A SimulatedBackend whose transfers take time [ns], one for each direction."""

    def __init__(self, port: Port, clock: Clock, out_ns: int, in_ns: int, unready: Unready) -> None:
        super().__init__(port, clock, unready=unready)
        self._out_ns = out_ns
        self._in_ns = in_ns

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
        self._pass(self._out_ns + self._in_ns)
        return super().ctrl_transfer(handle, request_type, request, value, index, data, timeout_ms)

    def bulk_write(
        self, handle: Handle, endpoint: int, interface: int, data: "array[int]", timeout_ms: int
    ) -> int:
        self._pass(self._out_ns)
        return super().bulk_write(handle, endpoint, interface, data, timeout_ms)

    def bulk_read(
        self, handle: Handle, endpoint: int, interface: int, buffer: "array[int]", timeout_ms: int
    ) -> int:
        count = super().bulk_read(handle, endpoint, interface, buffer, timeout_ms)
        self._pass(self._in_ns)
        return count

    intr_write = bulk_write
    intr_read = bulk_read

    def _pass(self, transport_ns: int) -> None:
        self._wait_until(self._clock.now_ns() + transport_ns)


def make_backend(
    params: BoardParams, clock: Clock, on_slip: Callable[[int], None] | None = None
) -> SimulatedBackend:
    """The backend at which the board of `params` is plugged in. ConfigError if they describe none.

    `on_slip(ns)` is called with the time that a paused host cost the simulation.
    """
    port = with_injections(make_board(params, on_slip), params)
    unready = Unready(params.rights_s, params.hello_s, params.boot_loader_s)
    if not params.out_transport_us and not params.in_transport_us:
        return SimulatedBackend(port, clock, unready=unready)
    out_ns = round(params.out_transport_us * NS_PER_US)
    return DistantBackend(port, clock, out_ns, round(params.in_transport_us * NS_PER_US), unready)
