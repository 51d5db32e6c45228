"""`zero` makes the origin where the handle is: at a position that came in its tick and that the
positions before it lead to, or not at all.
"""

import pytest
from support.boards import board_params
from support.models import COUNT_M, device_params, servo_params

from hapticd.mailbox.layout import Command, Result
from hapticd.model.params import HandParams, InjectionParams, TouchParams
from hapticd.protocol.view import as_records
from hapticd.run.lockstep import LockStep

AT_REST = TouchParams()
DRAWN = TouchParams(hands=(HandParams("push", 0.01, 0.1, 0.05),))  # away, by 10 mm and more
GLITCH_COUNTS = round(4e-3 / COUNT_M)


def zeroed_at(tick, injection, touch=AT_REST):
    """What `zero` says in that tick of the board, and how far the origin then is from where the
    handle truly was, in metres.
    """
    servo = servo_params(device=device_params(acceleration_limit_m_per_s2=500.0))
    with LockStep(servo, board_params(touch=touch, injections=(injection,))) as stack:
        stack.run(tick - stack.loop.tick)
        plant = stack.backend._port.board._axis
        answer = stack.do(Command.ZERO)
        true_m = plant.plant.encoder(plant.state, plant.force_n, plant.damping_n)
        homed = bool(as_records(stack.run(1))["homed"][-1])
        origin_m = stack.loop.state[0].plan.origin * COUNT_M
    return answer.result, homed, origin_m - true_m


@pytest.mark.parametrize("after", [1, 3, 100, 400])
@pytest.mark.parametrize("kind", ["drop_in", "drop_out", "corrupt_in"])
def test_zero_is_refused_while_no_frame_comes(kind, after):
    gap = InjectionParams(kind, tick=100, count=600)
    result, homed, _ = zeroed_at(100 + after, gap, DRAWN)
    assert result is Result.REFUSED_SAMPLE
    assert not homed


@pytest.mark.parametrize("counts", [GLITCH_COUNTS, -GLITCH_COUNTS])
@pytest.mark.parametrize("late", [-1, 0, 1])
def test_zero_is_refused_at_a_glitch_and_just_behind_it(late, counts):
    """The sample behind a glitch is good, but nothing tells it from one."""
    glitch = InjectionParams("encoder_jump", tick=100, value=counts)
    result, homed, _ = zeroed_at(101 + late, glitch)
    assert result is Result.REFUSED_SAMPLE
    assert not homed


@pytest.mark.parametrize("touch", [AT_REST, DRAWN], ids=["at rest", "drawn away"])
@pytest.mark.parametrize("tick", [5, 90, 110, 500])
def test_zero_is_made_where_the_handle_is(tick, touch):
    glitch = InjectionParams("encoder_jump", tick=100, value=GLITCH_COUNTS)
    result, homed, off_m = zeroed_at(tick, glitch, touch)
    assert result is Result.APPLIED
    assert homed
    assert abs(off_m) < 1e-4
