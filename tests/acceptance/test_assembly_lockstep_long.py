"""The whole stack on virtual time: the paper's settings, every injected fault, receipts,
energy, memory.
"""

import gc

import numpy as np
import pytest
from support.boards import board_params
from support.models import COUNT_NS_PER_M, servo_params
from test_assembly_lockstep import FIG_4, FIG_7, enable, perturbed

from hapticd.core.faults import BY_CODE
from hapticd.core.params import RealtimeParams, UsbParams
from hapticd.mailbox.layout import Command, Flag, Result, Value
from hapticd.model.params import InjectionParams
from hapticd.protocol.view import as_records
from hapticd.run.lockstep import LockStep
from hapticd.servo.safety import State


def test_figure_7_added_damping_is_toggled_live_and_slows_the_device():
    with LockStep(servo_params(), board_params()) as stack:
        enable(stack, FIG_7)
        perturbed(stack)
        without = as_records(stack.run(8000))
        receipt = stack.do(
            Command.DAMPING, {Value.ACTIVE_DAMPING: 1.74, Value.ACTIVE_DAMPING_ON: 1.0}
        )
        assert receipt.effective[Value.ACTIVE_DAMPING] == pytest.approx(1.74, abs=COUNT_NS_PER_M)
        stack.run(200)
        added = as_records(stack.run(8000))
        stack.do(Command.DAMPING, {Value.ACTIVE_DAMPING_ON: 0.0})
        stack.run(200)
        again = as_records(stack.run(8000))
    assert set(added["active_damping_ns_per_m"]) == {receipt.effective[Value.ACTIVE_DAMPING]}
    slow = added["velocity_m_per_s"].std()
    fast = without["velocity_m_per_s"].std()
    assert slow < 0.8 * fast
    assert again["velocity_m_per_s"].std() == pytest.approx(fast, rel=0.1)
    assert set(again["active_damping_ns_per_m"]) == {0.0}


@pytest.mark.parametrize(
    ("kind", "value", "code"),
    [
        ("amplifier_fault", 0.05, "board_fault"),
        ("encoder_fault", 0.05, "board_fault"),
        ("over_temperature", 0.05, "over_temperature"),
        ("encoder_jump", 1_000_000, "sensor_range"),
        ("sensor_extreme", 32767, "over_temperature"),
        ("unplug", 0.2, "usb_lost"),
        ("io_error", 0.0, "usb_lost"),
    ],
)
def test_serious_fault_stops_safely_and_can_be_reset(kind, value, code):
    injections = (InjectionParams(kind, tick=1000, value=value),)
    with LockStep(servo_params(), board_params(injections=injections)) as stack:
        enable(stack, FIG_4)
        perturbed(stack)
        flown = as_records(stack.run(3000))
        assert flown["state"][-1] == State.FAULT
        assert flown["fault"][-1] == BY_CODE[code].number
        first = int(np.argmax(flown["state"] == State.FAULT))
        assert not flown["force_n"][first + 25 :].any()
        assert stack.do(Command.ENABLE).result is Result.REFUSED_STATE
        assert stack.do(Command.RESET).result is Result.APPLIED
        stack.run(50)
        if code in ("usb_lost", "sensor_range") or kind == "encoder_fault":
            assert stack.do(Command.ENABLE).result is Result.REFUSED_NOT_HOMED
            assert stack.do(Command.ZERO).result is Result.APPLIED
        assert stack.do(Command.ENABLE).result is Result.APPLIED
        after = as_records(stack.run(600))
    assert after["state"][-1] == State.ENABLED
    assert not after["flags"][-10:].any()


@pytest.mark.parametrize("rate_hz", [1000.0, 2000.0, 4000.0, 8000.0])
def test_every_rate_flies_the_same_environment(rate_hz):
    params = servo_params(realtime=RealtimeParams(rate_hz=rate_hz, mode="off"))
    with LockStep(params, board_params(rate_hz=rate_hz)) as stack:
        enable(stack, FIG_4)
        perturbed(stack)
        flown = as_records(stack.run(int(rate_hz)))
        settled = flown[flown["gain"] == 1.0]
    assert not (settled["flags"] & ~np.uint32(Flag.RAMPING)).any()
    assert np.abs(np.diff(flown["board_us"]) - 1e6 / rate_hz).max() <= 1.0


def test_two_runs_are_equal_to_the_byte():
    blocks = []
    for _ in range(2):
        with LockStep(
            servo_params(), board_params(injections=(InjectionParams("drop_in", probability=0.01),))
        ) as stack:
            enable(stack, FIG_4)
            perturbed(stack)
            stack.run(2000)
            blocks.append(b"".join(stack.blocks))
    assert blocks[0] == blocks[1]


def test_passive_environment_never_gains_energy():
    with LockStep(servo_params(), board_params()) as stack:
        enable(stack, FIG_4)
        perturbed(stack)
        flown = as_records(stack.run(20_000))
    total = flown["work_j"]
    assert total[-1] < total[0]
    assert total[-1] < -1e-3


def test_lost_board_leaves_no_garbage_in_circles():
    """The servo never collects, so nothing may depend on it: re-plugs, refused rights, small
    faults.
    """
    faults = ("stall_in", "stall_out", "babble", "drop_in", "corrupt_in", "duplicate_in")
    injections = (
        InjectionParams("unplug", probability=0.02, value=0.02),
        *(InjectionParams(kind, probability=0.02) for kind in faults),
    )
    with LockStep(
        servo_params(usb=UsbParams(serial="SIM0001")),
        board_params(injections=injections),
        keep=False,
    ) as stack:
        stack.run(500)
        gc.collect()
        gc.disable()
        try:
            stack.run(1500)
            stack.backend.unplug(0.0)
            stack.backend.access_denied = True
            stack.run(3000)
            garbage = gc.collect()
        finally:
            gc.enable()
    assert stack.gateway.counters()["reconnects"] > 3
    assert garbage == 0


def test_figure_4_environment_renders_on_the_simulated_board():
    with LockStep(servo_params(), board_params()) as stack:
        enable(stack, FIG_4)
        perturbed(stack)
        flown = as_records(stack.run(5000))
    assert set(flown["state"]) == {State.ENABLED}
    assert not flown["flags"].any()
    expected = flown["stiffness_force_n"] + flown["virtual_damping_force_n"] + flown["mass_force_n"]
    assert np.abs(flown["force_n"] - expected).max() <= 0.5 * 8.0 / 32767 * 1.0001
    assert np.allclose(flown["stiffness_force_n"], -100.0 * flown["position_m"], rtol=1e-12, atol=0)
    assert 1e-5 < np.abs(flown["position_m"]).max() < 5e-3
