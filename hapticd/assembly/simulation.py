"""The simulated board behind a pyusb backend, with the faults that its parameters ask for."""

from collections.abc import Callable

from hapticd.clock import Clock
from hapticd.params import BoardParams
from hapticd.sim.backend import SimulatedBackend
from hapticd.sim.board import BoardModel
from hapticd.sim.injection import with_injections


def simulated_backend(
    params: BoardParams, clock: Clock, on_slip: Callable[[int], None] | None = None
) -> SimulatedBackend:
    """A backend with one board plugged in; `on_slip(ns)` hears of time that a paused host cost
    the simulation.
    """
    return SimulatedBackend(with_injections(BoardModel(params, on_slip), params), clock)
