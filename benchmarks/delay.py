"""Delay from a sample to its force on the model of full-speed USB: transfers in flight compared
with sequential ones.

Servo and simulated board run on virtual time at 1 kHz on each bus of `sim.bus.BAND`, in SEEDS
histories of it. Each mode measures its bus and sets its phase as with a real board; the figure
comes from the records, by the board's clock. The worst bus counts, among those that keep the rate
with sequential transfers; the note lists the others, with the delay in flight. All of it is
"model": no real bus was measured for it.

Limitations: a bus with host costs that no machine has (they dominate the ratio).
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from benchmarks import targets
from benchmarks.figures import Figure, compared
from benchmarks.stand import settings
from hapticd.mailbox.layout import Command, Result
from hapticd.model.params import BusParams
from hapticd.protocol.view import as_records
from hapticd.run.lockstep import LockStep
from hapticd.settings.build import board_params, servo_params
from hapticd.sim.bus import BAND

TARGETS = targets.of("delay")
SEEDS = 3
TICKS = 1000
SETTLED = 50  # ticks after enabling
NOT_HELD = float("inf")


def measure() -> Iterator[Figure]:
    """Measure the band."""
    pairs = {name: (delay_us(bus, True), delay_us(bus, False)) for name, bus in BAND.items()}
    ratios = {name: flight / turn for name, (flight, turn) in pairs.items() if turn < NOT_HELD}
    worst = max(ratios, key=lambda name: ratios[name])
    others = [f"{name} {pairs[name][0]:.0f} us" for name in pairs if name not in ratios]
    typical = float(np.median(list(ratios.values())))
    note = (
        f"model; worst: {worst}; best {min(ratios.values()):.2f}, median {typical:.2f}; not held"
        f" one after the other: {', '.join(others)}"
    )
    flight_us, turn_us = pairs[worst]
    yield compared("delay_ratio", TARGETS["delay_ratio"], flight_us, "us", turn_us, note)


def delay_us(bus: BusParams, in_flight: bool) -> float:
    """Return the median delay over SEEDS histories; NOT_HELD if one of them does not
    keep the rate.
    """
    return float(np.mean([_delay_us(bus, in_flight, seed) for seed in range(1, SEEDS + 1)]))


def _delay_us(bus: BusParams, in_flight: bool, seed: int) -> float:
    stand = settings()
    servo = servo_params(stand, "bench")
    servo = replace(servo, usb=replace(servo.usb, in_flight=in_flight))
    board = board_params(stand)
    assert board is not None
    board = replace(board, bus=bus, seed=seed, sample_phase=0.875)
    with LockStep(servo, board) as stack:
        stack.run(10)
        if stack.do(Command.ENABLE).result is not Result.APPLIED:
            return NOT_HELD
        records = as_records(stack.run(TICKS))[SETTLED:]
    known = records["delay_us"] >= 0
    return float(np.median(records["delay_us"][known]))
