"""`rig link` on the simulated board, as it is and with faults that somebody put in."""

import dataclasses

import pytest
from support.boards import board_params
from support.models import servo_params
from test_rig_link import SECONDS, found, watched

from hapticd.model.params import InjectionParams
from hapticd.rig.steps.link import measure
from hapticd.run.lockstep import LockStepClient
from hapticd.usb.frames import StatusBit


def test_a_good_board_has_its_delay_and_no_complaint():
    """Sampled 0.875 periods after the command: 125 us from sample to force."""
    values, findings = found()
    assert values["delay"].value == pytest.approx(125.0, abs=2.0)
    assert values["clock drift"].value == pytest.approx(0.0, abs=1.0)
    assert {one.verdict for one in findings.values()} == {"ok"}
    assert findings["watchdog of the board"].verdict == "ok"
    assert 249.0 <= values["watchdog"].low < values["watchdog"].high <= 251.0


def test_missing_frames_are_counted_and_refused_with_a_remedy():
    lost = InjectionParams("drop_in", probability=0.01)
    _, findings = found(injections=(lost,))
    assert findings["missing_in"].verdict == "refused"
    assert "cable" in findings["missing_in"].remedy
    assert findings["write_errors"].verdict == "ok"


@pytest.mark.parametrize("ms", [20.0, 50.0, 333.0])
def test_the_time_of_a_watchdog_lies_in_an_interval_of_a_period(ms):
    result, status, lost = watched(ms)
    (value,) = [one for one in result.values if one.name == "watchdog"]
    assert value.low <= ms <= value.high <= value.low + 1.0
    assert "tripped, it holds the damping" in [one.what for one in result.findings]
    assert status["state"] == 0
    assert not status["status"] & StatusBit.WATCHDOG
    assert status["active_damping_ns_per_m"] == 0.0
    assert lost == 0


def test_a_watchdog_that_is_later_than_the_hello_says_is_a_warning():
    def late(axis):
        axis._watchdog = round(1.2 * axis._watchdog)

    result, _, _ = watched(change=late)
    (found,) = [one for one in result.findings if one.what.startswith("watchdog")]
    assert found.verdict == "warning"
    assert "50 ms" in found.remedy
    (value,) = [one for one in result.values if one.name == "watchdog"]
    assert value.low <= 60.0 <= value.high


def test_what_a_board_lacks_is_named_with_what_is_lost():
    with LockStepClient(servo_params(), board_params(lacks=("emergency_stop",))) as bench:
        result = measure(bench, SECONDS)
    assert any(
        one.what == "it lacks EMERGENCY_STOP" and one.verdict == "warning"
        for one in result.findings
    )


def test_missing_features_are_named():
    servo = servo_params()
    lacking = dataclasses.replace(servo.device, relies_on=("probe", "temperature"))
    with LockStepClient(
        dataclasses.replace(servo, device=lacking), board_params(lacks=("temperature",))
    ) as bench:
        result = measure(bench, SECONDS)
    assert any("temperature" in one.what and one.verdict == "refused" for one in result.findings)


def test_a_board_that_drops_its_damping_with_the_torque_is_refused():
    def dropping(axis):
        held = axis._fail_safe

        class Dropping(type(axis)):
            __slots__ = ()

            def _fail_safe(self):
                held()
                self._damp(0)

        axis.__class__ = Dropping

    result, _, _ = watched(change=dropping)
    assert any("held for 2 s" in one.remedy for one in result.findings)
    assert not result.settled
