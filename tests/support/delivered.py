"""Flights of the paper's device with estimated active damping, and the closed form of the damping
that its circuit delivers (Weir, Colgate and Peshkin 2008, section 5).
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from hapticd.core.arrays import Records
from hapticd.core.params import ServoParams
from hapticd.guard.delivered import Delivered, Estimate, Shortfall
from hapticd.mailbox.layout import Command, Value
from hapticd.model.params import BoardParams, HandParams, InjectionParams, TouchParams
from hapticd.protocol.view import as_records
from hapticd.run.lockstep import LockStep, scene_params
from support.tree import ROOT

LEVEL = 1.74
GAIN = 1.0 + 0.05820105820105820  # of the multiplier of weir2008
N_PER_A = 0.016492422502470644 / 0.01
LEFT_OHM = 1.6 * 0.00393 * 13.67318908684  # of the winding, that is not compensated
FREE = (0.0, 0.0, 0.0)
SCENES = ROOT / "config" / "scenes"
DISPLAY = (100.0, 1.0, 0.01)
HAND = HandParams("hold", stiffness_n_per_m=300.0, damping_ns_per_m=3.0, tremor_m=2e-3)


def circuit(level: float, left_ohm: float = LEFT_OHM, gain: float = GAIN) -> float:
    """Delivered damping: alpha g b with alpha = 1 / (1 + g b dR / K^2)."""
    return gain * level / (1.0 + gain * level * left_ohm / N_PER_A**2)


def shaken(stack: LockStep, seed: int, rms_n: float, ticks: int) -> None:
    """By white noise at 4 kHz."""
    samples = 4 * ticks
    noise = np.random.default_rng(seed).standard_normal(samples) * rms_n / 2.0
    counts = np.round(32767.0 * np.clip(noise, -1.0, 1.0)).astype(int)
    stack.load_waveform(counts.tolist())
    stack.do(Command.PERTURB_START, {Value.SAMPLES: float(samples), Value.LOOP: 0.0})


def damped(stack: LockStep, level: float) -> None:
    on = {Value.ACTIVE_DAMPING: level, Value.ACTIVE_DAMPING_ON: 1.0}
    stack.do(Command.DAMPING, on if level else {Value.ACTIVE_DAMPING_ON: 0.0})


def rendered(environment: Sequence[float]) -> dict[Value, float]:
    """Return the values of a set that changes K, B and M at once."""
    places = (Value.STIFFNESS, Value.VIRTUAL_DAMPING, Value.MASS)
    return {**dict(zip(places, environment, strict=True)), Value.RAMP_S: 0.0}


def begun(stack: LockStep, environment: Sequence[float], level: float) -> None:
    """Force on, at once."""
    stack.run(5)
    stack.do(Command.SET, rendered(environment))
    stack.do(Command.ENABLE)
    damped(stack, level)


def parts(
    touch: TouchParams | None = None,
    injections: tuple[InjectionParams, ...] = (),
    limit_n: float = 8.0,
    **board: Any,
) -> tuple[ServoParams, BoardParams]:
    """Servo and board of the paper's device."""
    servo, plain = scene_params("fig4")
    servo = replace(servo, safety=replace(servo.safety, force_limit_n=limit_n))
    return servo, replace(plain, touch=touch, injections=injections, **board)


@cache
def flown(
    environment: Sequence[float] = DISPLAY,
    level: float = LEVEL,
    rms_n: float = 0.21,
    seed: int = 1,
    ticks: int = 3000,
    shaken_ticks: int = 3000,
    **board: Any,
) -> tuple[ServoParams, Records]:
    """Servo and records of a flight of the paper's device under white noise."""
    servo, with_board = parts(**board)
    with LockStep(servo, replace(with_board, seed=seed)) as stack:
        begun(stack, environment, level)
        if rms_n:
            shaken(stack, seed, rms_n, shaken_ticks)
        stack.run(ticks)
        return servo, as_records(b"".join(stack.blocks))


def followed(
    servo: ServoParams, records: Records, at_once: int = 20, relied_on: float | None = None
) -> tuple[Estimate, list[Shortfall]]:
    delivered = Delivered(servo, lambda: relied_on)
    blocks = np.split(records, range(at_once, len(records), at_once))
    lows = [low for block in blocks for low in delivered.take(block)]
    return delivered.estimate, lows


def holds(found: Estimate, truth: float) -> bool:
    assert found.low is not None, found.basis
    assert found.high is not None
    return found.low <= truth <= found.high
