"""A trial of the whole product in lock-step on the emulated board. Servo, link and wire are those
of `assembly.lockstep`. The chip replaces the simulated board, with the display of fig. 7 at its
pins.

The board measures no torque and no velocity, so a second instrument does. It shakes the display and
records interval means at 4 kHz, like a separate data acquisition.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest

from hapticd.core.arrays import Floats
from hapticd.core.params import ServoParams
from hapticd.core.units import PROBE_RATE_HZ, Clock
from hapticd.model.params import BoardParams
from hapticd.run import lockstep
from hapticd.run.lockstep import LockStepClient, scene_params
from hapticd.usb.codec import I16_HIGHEST, U16_HIGHEST
from hapticd.zwidth.live import allowed_waveform
from hapticd.zwidth.sources import Trial
from hapticd.zwidth.store import TrialRecord
from support.pico_backend import PicoBackend
from support.pico_chip import UNIQUE_ID
from support.pico_firmware import LACKS, Defines, image, start_chip
from support.pico_plant import Rig

PIECES = 4  # of the plant in an interval of the instrument
PHASE = 0.8125  # of a period: with transfers in flight a full-speed bus leaves that
WATCHDOG_MS = 250.0
CHUNK_TICKS = 500


class Display(NamedTuple):
    """Servo and board of fig. 7, with a phase that the bus of a board can meet."""

    servo: ServoParams
    board: BoardParams


def display() -> Display:
    """Return the display for both kinds of board."""
    servo, board = scene_params("fig7")
    relied_on = tuple(one for one in servo.device.relies_on if one not in LACKS)
    device = replace(servo.device, serial=UNIQUE_ID, relies_on=relied_on)
    servo = replace(servo, device=device, usb=replace(servo.usb, serial=UNIQUE_ID, in_flight=True))
    board = replace(board, serial=UNIQUE_ID, sample_phase=PHASE, watchdog_ms=WATCHDOG_MS)
    return Display(servo, board)


def scales_of(board: BoardParams) -> Defines:
    """The macros of config.h for the board's full scales."""
    return (
        (
            "DAMPING_FULL_SCALE_NS_PER_M",
            f"{board.active_damping_ns_per_m_per_count * U16_HIGHEST}f",
        ),
        ("CURRENT_FULL_SCALE_A", f"{board.current_a_per_count * I16_HIGHEST}f"),
        ("FORCE_FULL_SCALE_N", f"{board.force_n_per_count * I16_HIGHEST}f"),
        ("FORCE_LIMIT_N", f"{board.force_limit_n}f"),
        ("POSITION_M_PER_COUNT", f"{board.position_m_per_count}f"),
        ("WATCHDOG_MS", str(round(board.watchdog_ms))),
    )


class Instrument:
    """Shake the plant of `rig` by `force_n` (samples,) [N] from the next interval on, and measure
    the signals of its probe.
    """

    def __init__(self, rig: Rig, force_n: Floats) -> None:
        self._rig = rig
        self._force_n = force_n
        self._first = (rig.piece // PIECES + 8) * PIECES  # beyond the plan
        self._begin: tuple[float, float] | None = None
        self.force: list[float] = []
        self.velocity: list[float] = []
        rig.torque_n = self._shake
        rig.on_piece = self._passed

    def _shake(self, piece: int) -> float:
        sample = (piece - self._first) // PIECES
        return float(self._force_n[sample]) if 0 <= sample < self._force_n.size else 0.0

    def _seen(self, state: tuple[float, ...]) -> tuple[float, float]:
        plant = self._rig.plant
        kept = plant.impulse(state, 0.0, 0.0) if plant.impulse else 0.0
        return plant.travel(state, 0.0, 0.0), kept

    def _passed(self, piece: int, state: tuple[float, ...]) -> None:
        if piece < self._first - 1 or (piece + 1) % PIECES:
            return
        seen = self._seen(state)
        if self._begin is not None:
            travel_m, kept_ns = (now - then for now, then in zip(seen, self._begin, strict=True))
            self.velocity.append(travel_m * PROBE_RATE_HZ)
            self.force.append(self._shake(piece) + kept_ns * PROBE_RATE_HZ)
        self._begin = seen


@contextmanager
def chip_in_lock_step(shown: Display) -> Iterator[tuple[LockStepClient, Rig]]:
    """Yield a bench with the chip as its board; AssertionError at the end if the chip
    complained.
    """
    rig = Rig(start_chip(image(scales_of(shown.board))), replace(shown.board, lacks=LACKS))

    def backend(_board: BoardParams, clock: Clock) -> PicoBackend:
        return PicoBackend(rig, clock)

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(lockstep, "simulated_backend", backend)
        bench = LockStepClient(shown.servo, shown.board)
    try:
        bench.stack.device.set_phase(PHASE * bench.stack.device.period_us)
        bench.run(5)
        yield bench, rig
        bench.close()
        assert rig.chip.complaints() == []
    finally:
        rig.chip.close()


def _rendered(bench: LockStepClient, trial: Trial) -> None:
    """The environment of the trial is rendered."""
    stiffness, damping, mass = trial.environment
    level = trial.active_damping_ns_per_m
    bench.set(K=stiffness, B=damping, M=mass, active_damping=level)
    bench.damping("on" if level else "off")
    bench.enable()


def record_on_chip(trial: Trial) -> TrialRecord:
    """The trial, recorded by the second instrument. AssertionError if it ends early."""
    shown = display()
    waveform = allowed_waveform(trial, float(shown.servo.device.probe_limit_n))
    samples = round(trial.seconds * PROBE_RATE_HZ)
    with chip_in_lock_step(shown) as (bench, rig):
        _rendered(bench, trial)
        instrument = Instrument(rig, waveform)
        while len(instrument.force) < samples:
            bench.run(CHUNK_TICKS)
        state = bench.status().state
    assert state == "enabled", state
    force, velocity = (np.array(one[:samples]) for one in (instrument.force, instrument.velocity))
    return TrialRecord(force, velocity, PROBE_RATE_HZ, "pico", simulated=True)


def fault_on_chip(trial: Trial) -> str:
    """The fault that ends a trial which runs away."""
    shown = display()
    waveform = allowed_waveform(trial, float(shown.servo.device.probe_limit_n))
    with chip_in_lock_step(shown) as (bench, rig):
        _rendered(bench, trial)
        Instrument(rig, waveform)
        while bench.status().state == "enabled":
            bench.run(CHUNK_TICKS)
        return str(bench.status().fault)
