"""What `rig link` learns of a watchdog is the board's own word, told while no force acts: the
finding and the certificate say so.
"""

import pytest
from support.boards import board_params
from support.models import servo_params

from hapticd.rig.certificate import NOT_VERIFIED
from hapticd.rig.steps.link import try_watchdog
from hapticd.run.lockstep import LockStepClient
from hapticd.sim.axis import Axis

SAID = "as reported by the board; no force was on, so the end of a force was not measured"


@pytest.mark.parametrize("honest", [True, False])
def test_the_finding_says_whose_word_it_is(monkeypatch, honest):
    """A board that says that it tripped, and leaves its torque as it was, is found to be as good:
    its torque was 0.
    """
    if not honest:
        monkeypatch.setattr(Axis, "_cut_torque", lambda axis: None)
    with LockStepClient(servo_params(), board_params(watchdog_ms=20.0)) as bench:
        found = try_watchdog(bench, bench.stack.loop.connection.check.report()["board"])
    assert {one.verdict for one in found.findings} == {"ok"}
    assert found.findings[0].what.endswith(f"ms without frames, {SAID}")


def test_the_certificate_names_it_as_not_verified():
    (line,) = [one for one in NOT_VERIFIED if "watchdog" in one]
    assert "board's word alone" in line
    assert "force ends" in line
