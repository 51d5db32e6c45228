"""The emulated board with a simulated device at its pins, in lock-step.

The plant advances in the pieces of the simulated board, 62.5 us at 1 kHz, ahead of the chip under
held outputs. The chip gets the encoder's counts at the ends of the next pieces, and makes their
edges. A changed output acts from the next piece on, and the plan is computed again.

Limitations: a plant whose encoder jumps farther in a piece than the decoder can follow.
"""

import errno
from collections.abc import Callable
from math import floor
from typing import Any

from hapticd.core.units import NS_PER_MS, NS_PER_S
from hapticd.model.params import BoardParams
from hapticd.model.step import SUBSTEPS_PER_TICK, make_plant
from support.pico_chip import PicoChip, Result, Verb

AHEAD = 16
NEAR_NS = 0.01  # of floating-point times
INSTRUCTION_NS = 1000.0  # by which the processor may be beyond the end of a run
ADDRESS = 7
ATTACH_NS = 100 * NS_PER_MS  # within which the pull-up has to come
RESET_NS = 10 * NS_PER_MS
RECOVERY_NS = 2 * NS_PER_MS  # after SET_ADDRESS
SET_ADDRESS = bytes((0, 5, ADDRESS, 0, 0, 0, 0, 0))
CONTROL_NS = 50 * NS_PER_MS


class Rig:
    """`chip` with a plant at its pins: that of `params`, or `plant`."""

    def __init__(self, chip: PicoChip, params: BoardParams, plant: Any = None) -> None:
        self.chip = chip
        self.params = params
        self.piece_ns = NS_PER_S / (SUBSTEPS_PER_TICK * params.rate_hz)
        self.plant = plant or make_plant(params)
        self.piece = 0  # of the plant, begun
        self.torque_n: Callable[[int], float] = _nothing  # a perturbation, by the piece
        # called with a piece that has passed, and the state at its end
        self.on_piece: Callable[[int, tuple[float, ...]], None] | None = None
        self._planned = [self.plant.rest(0.0)]  # states at the ends of pieces from `piece` on
        self._anew = True
        self.force_n = self.damping_ns_per_m = 0.0
        self.zero = self._count_of(self._planned[0])

    # --- the plant --------------------------------------------------------------------------------
    @property
    def now_ns(self) -> float:
        """The chip's time."""
        return self.chip.state.now_ns

    @property
    def state(self) -> tuple[float, ...]:
        """Of the plant at the beginning of the running piece."""
        return self._planned[0]

    def _count_of(self, state: tuple[float, ...]) -> int:
        seen_m = self.plant.encoder(state, 0.0, 0.0)
        return floor(seen_m / self.params.position_m_per_count + 0.5)

    def _hold_outputs(self) -> None:
        state = self.chip.state
        torque_n = state.torque * self.params.force_n_per_count
        self.force_n = torque_n if state.amplifier else 0.0
        self.damping_ns_per_m = state.damping * self.params.active_damping_ns_per_m_per_count

    def _plan(self) -> list[int]:
        """The states of the next pieces, and the encoder's counts there."""
        self._hold_outputs()
        states = [self._planned[0]]
        for piece in range(self.piece, self.piece + AHEAD):
            drive_n = self.torque_n(piece)
            held = (self.force_n, drive_n, self.damping_ns_per_m)
            states.append(self.plant.step(states[-1], *held, 1))
        self._planned = states
        return [self._count_of(state) - self.zero for state in states[1:]]

    def advance(self, until_ns: float, done: Callable[[], bool] | None = None) -> None:
        """Run chip and plant to `until_ns`, or until `done()`."""
        while self.now_ns < until_ns - NEAR_NS and not (done and done()):
            counts = self._plan() if self._anew else None
            ahead_ns = (self.piece + len(self._planned) - 1) * self.piece_ns
            self.chip.run(min(until_ns, ahead_ns), counts)
            self._settle()

    def _settle(self) -> None:
        """Count the pieces that have passed; a new plan is due at an end of one."""
        passed = floor((self.now_ns + NEAR_NS) / self.piece_ns)
        while self.piece < passed:
            if self.on_piece is not None:
                self.on_piece(self.piece, self._planned[1])
            del self._planned[0]
            self.piece += 1
        at_end = self.now_ns - passed * self.piece_ns <= INSTRUCTION_NS
        self._anew = at_end and (bool(self.chip.state.changed) or len(self._planned) == 1)

    # --- the host's end ---------------------------------------------------------------------------
    def wait(self, number: int, patience_ns: float) -> Result:
        """Return how a transfer ended; cancel one that did not (ETIMEDOUT)."""
        results = self.chip.results
        self.advance(self.now_ns + patience_ns, lambda: number in results)
        if number in results:
            return results.pop(number)
        self.chip.cancel(number)
        return Result(-errno.ETIMEDOUT, b"")

    def control(self, setup: bytes, length: int = 0, patience_ns: float = CONTROL_NS) -> Result:
        """A request to endpoint 0, to its end."""
        return self.wait(self.chip.submit(0, length, b"", setup), patience_ns)

    def connected(self) -> bool:
        """Whether the board pulls the bus up."""
        return bool(self.chip.state.connected)

    def plug(self) -> bool:
        """Do the work of a hub and its driver: wait for the pull-up, reset the bus, assign an
        address. Return whether the board was found.
        """
        self.advance(self.now_ns + ATTACH_NS, self.connected)
        if not self.connected():
            return False
        self.chip.tell(Verb.BUS_RESET)
        self.advance(self.now_ns + RESET_NS)
        found = self.control(SET_ADDRESS).status == 0
        self.advance(self.now_ns + RECOVERY_NS)
        return found

    def power_cycle(self) -> None:
        """Supply off and on; the encoder counts from here."""
        self.chip.tell(Verb.POWER_UP)
        self.zero = self._count_of(self.state)


def _nothing(_piece: int) -> float:
    return 0.0
