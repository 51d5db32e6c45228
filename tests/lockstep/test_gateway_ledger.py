"""The energy ledger of a whole stack on virtual time, against the simulated device itself."""

import numpy as np
import pytest
from support.boards import board_params
from support.models import servo_params

from hapticd.mailbox.layout import Command, Value
from hapticd.model.params import InjectionParams
from hapticd.protocol.ledger import NAMES, Ledger, book, samples
from hapticd.protocol.view import as_records
from hapticd.run.lockstep import LockStep, scene_params
from hapticd.usb import codec
from hapticd.usb.frames import StatusBit

SPRING = {Value.STIFFNESS: 300.0, Value.VIRTUAL_DAMPING: 0.0, Value.MASS: 0.0, Value.RAMP_S: 0.1}
EVERYTHING = SPRING | {
    Value.VIRTUAL_DAMPING: 2.0,
    Value.MASS: 0.005,
    Value.WALL_STIFFNESS: 500.0,
    Value.WALL_POSITION: 2e-4,
    Value.WALL_SIDE: 1.0,
}
LOSSES = tuple(InjectionParams(kind, probability=0.01) for kind in ("drop_in", "drop_out"))


def flown(settings, ticks=1500, **board):
    """(servo, records) of a device that is shaken at 20 Hz by 0.5 N."""
    params = servo_params()
    wave = 8192 * np.sin(2.0 * np.pi * 20.0 * np.arange(8000) / 4000.0)
    with LockStep(params, board_params(**board)) as stack:
        stack.run(5)
        stack.do(Command.SET, settings)
        stack.do(Command.ENABLE)
        stack.load_waveform(np.round(wave).astype(int).tolist())
        stack.do(Command.PERTURB_START, {Value.SAMPLES: 8000.0, Value.LOOP: 1.0})
        stack.do(Command.DAMPING, {Value.ACTIVE_DAMPING: 0.5, Value.ACTIVE_DAMPING_ON: 1.0})
        stack.run(ticks)
        return params, as_records(b"".join(stack.blocks))


def sums(params, records, at_once=20):
    ledger = Ledger(params)
    parts = [ledger.take(records[n : n + at_once]) for n in range(0, len(records), at_once)]
    return dict(zip(NAMES, np.concatenate(parts).T, strict=True))


@pytest.mark.parametrize("phase", [0.875, 0.5, 0.125])
def test_rigid_device_leaves_nothing_unexplained(phase):
    """The whole is read off the frames of the board, the causes off what the law computed."""
    found = sums(*flown(EVERYTHING, sample_phase=phase))
    assert found["hold_delay"][-1] > 1e-5
    assert np.abs(found["unexplained"]).max() <= 0.02 * found["hold_delay"][-1]


@pytest.mark.parametrize("phase", [0.875, 0.5])
def test_work_on_the_device_is_its_motion_and_its_losses(phase):
    """From rest: command + probe = kinetic energy + friction, by the probe's own 4 kHz pairs."""
    params, records = flown(SPRING, sample_phase=phase)
    found = sums(params, records)
    board = board_params()
    frames = [codec.decode_in(bytes(frame)) for frame in records["in_frame"]]
    pairs = np.array([pair for frame in frames for pair in frame.pairs], float)
    force = pairs[:, 0] * board.probe_torque_n_per_count
    velocity = pairs[:, 1] * board.probe_velocity_m_per_s_per_count
    pushed = np.sum(force * velocity) / 4000.0
    lost = board.viscous_ns_per_m * np.sum(velocity**2) / 4000.0
    moving = 0.5 * board.mass_kg * velocity[-1] ** 2
    assert found["whole"][-1] == pytest.approx(
        moving + lost - pushed, abs=0.02 * found["hold_delay"][-1] + 0.01 * lost
    )


def test_causes_and_the_unexplained_are_the_whole_while_frames_are_lost():
    params, records = flown(EVERYTHING, injections=LOSSES)
    found = sums(params, records)
    causes = [name for name in NAMES if name not in ("whole", "electrical_commanded")]
    gross = sum(np.abs(np.diff(found[name])).sum() for name in causes)
    assert abs(sum(found[name][-1] for name in causes) - found["whole"][-1]) <= 1e-9 * gross
    assert found["gap"][-1] != 0.0


def test_nothing_is_in_effect_where_the_board_grants_no_torque():
    """The amplifier fails at 1 s: what was asked for last is not what was done."""
    injections = (InjectionParams("amplifier_fault", tick=1000, value=0.05),)
    params, records = flown(SPRING, 1200, injections=injections)
    found = sums(params, records)
    withheld = (records["status"] & StatusBit.ENABLED == 0) & (records["tick"] > 900)
    off = records["tick"] >= records["tick"][withheld][0]
    assert np.ptp(found["whole"][off] - found["electrical"][off]) == 0.0


def test_force_of_a_smoothed_motor_is_the_one_whose_current_flows():
    """The device of the paper with 31.6 Hz in its force: the ledger's motor against the current
    that the simulated board measures; `lag` is most of what the hold and the filter give away.
    """
    params, board = scene_params("fig4")
    wave = 8000 * np.sin(2.0 * np.pi * 20.0 * np.arange(8000) / 4000.0)
    with LockStep(params, board) as stack:
        stack.run(5)
        stack.do(Command.ENABLE)
        stack.load_waveform(np.round(wave).astype(int).tolist())
        stack.do(Command.PERTURB_START, {Value.SAMPLES: 8000.0, Value.LOOP: 1.0})
        stack.run(1500)
        records = as_records(b"".join(stack.blocks))
    read = samples(records, np.arange(len(records)), params)
    _, motor = book(read, 1e-3, smoothing_hz=params.device.force_smoothing_hz)
    flowing = records["current_a"] * board.torque_constant_n_per_a
    assert np.std(motor - flowing) < 0.01 * np.std(flowing)
    assert np.std(read["in_effect_n"] - flowing) > 0.3 * np.std(flowing)
    found = sums(params, records)
    assert found["lag"][-1] > 10.0 * found["hold_delay"][-1] > 0.0
