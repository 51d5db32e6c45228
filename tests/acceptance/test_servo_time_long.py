"""Time is time, not ticks: ramps, holds and budgets end by the clock, and a silent link does not
stretch the ticks.
"""

import pytest
from support.boards import board_params
from support.models import servo_params
from test_servo_time import elapsed_s, slow_host

from hapticd.core.params import SafetyParams
from hapticd.mailbox.layout import Command, Value
from hapticd.run.lockstep import LockStep

pytestmark = pytest.mark.usefixtures("either_way")


@pytest.mark.parametrize("pause_ms", [0.0, 1.4, 3.7])
def test_ramps_and_holds_end_by_the_clock_on_a_slow_host(pause_ms):
    params = servo_params(safety=SafetyParams(safe_active_damping_ns_per_m=1.0))
    tick_s = 0.001 + 2 * pause_ms * 1e-3
    with LockStep(params, board_params(mass_kg=1.0)) as stack:
        stack.run(20)
        slow_host(stack, pause_ms)
        stack.run(3)
        stack.do(Command.SET, {Value.STIFFNESS: 100.0, Value.RAMP_S: 1.0})
        assert elapsed_s(stack, lambda record: record["stiffness_n_per_m"] == 100.0) == (
            pytest.approx(1.0, abs=2 * tick_s)
        )
        stack.do(Command.ENABLE)
        assert elapsed_s(stack, lambda record: record["gain"] == 1.0) == (
            pytest.approx(0.5, abs=2 * tick_s)
        )
        stack.do(Command.STOP)
        assert elapsed_s(stack, lambda record: record["gain"] == 0.0) == (
            pytest.approx(0.02, abs=2 * tick_s)
        )
        level = "active_damping_ns_per_m"
        assert elapsed_s(stack, lambda record: record[level] > 0.999) == (
            pytest.approx(0.03, abs=2 * tick_s)  # 20 N s/m a second, 20 ms of which are over
        )
        assert elapsed_s(stack, lambda record: record[level] < 0.999) == (
            pytest.approx(1.95, abs=3 * tick_s)
        )
        assert elapsed_s(stack, lambda record: record[level] == 0.0) == (
            pytest.approx(0.5, abs=2 * tick_s)
        )
