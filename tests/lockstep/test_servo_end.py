"""A clean end is as safe as a crash: seen at the board's own outputs, the force fades without a
step and the damping stays to the last frame, which the board's watchdog then holds and releases.
"""

from collections.abc import Callable
from itertools import pairwise, zip_longest
from typing import NamedTuple

import pytest
from support.boards import board_params
from support.models import COUNT_NS_PER_M, servo_params

from hapticd.core.errors import LinkLost
from hapticd.core.params import SafetyParams
from hapticd.core.units import NS_PER_MS
from hapticd.mailbox.daemons import press_stop
from hapticd.mailbox.layout import Command, Result, State, Value
from hapticd.run.lockstep import LockStep
from hapticd.servo.plan import SETTLED
from hapticd.sim.axis import DAMPING_HOLD_S, DAMPING_RELEASE_S
from hapticd.usb import codec
from hapticd.usb.frames import OutFlag

pytestmark = pytest.mark.usefixtures("either_way")


SPRING = {Value.STIFFNESS: 200.0, Value.VIRTUAL_DAMPING: 5.0, Value.RAMP_S: 0.0}
ADDED = {Value.ACTIVE_DAMPING: 1.74, Value.ACTIVE_DAMPING_ON: 1.0}
PUSH_COUNTS = 16_000  # of 32767 = 2 N: held against the spring
SETTLED_TICKS = 1500
FADE_TICKS = 20
WATCHDOG_MS = 20


class Outputs(NamedTuple):
    """What the board puts out at one moment."""

    t_ns: int
    force_n: float
    damping_n: float  # N s/m


class Watched:
    """A rendering servo whose board's outputs are noted after every OUT."""

    def __init__(self, stack: LockStep) -> None:
        self.stack = stack
        self.seen: list[Outputs] = []
        self.axis = stack.backend._port._axis  # type: ignore[attr-defined]
        deliver = stack.backend.deliver

        def noted(data: memoryview, t_ns: int) -> None:
            deliver(data, t_ns)
            self.note()

        stack.backend.deliver = noted

    def note(self) -> None:
        """Note the outputs as they are now."""
        self.seen.append(Outputs(self.stack.clock.now_ns(), self.axis.force_n, self.axis.damping_n))

    def press_into_the_spring(self) -> None:
        """About 1 N of spring force, at rest, active damping on."""
        stack = self.stack
        stack.run(5)
        for kind, values in ((Command.SET, SPRING), (Command.DAMPING, ADDED), (Command.ENABLE, {})):
            assert stack.do(kind, values).result is Result.APPLIED
        stack.run(520)
        stack.load_waveform([PUSH_COUNTS] * 4000)
        stack.do(Command.PERTURB_START, {Value.SAMPLES: 4000.0, Value.LOOP: 1.0})
        stack.run(SETTLED_TICKS)
        self.seen.clear()

    def watch_the_board_alone(self, ms: int) -> list[Outputs]:
        """What it puts out in the time after its servo has gone."""
        self.seen.clear()
        for _ in range(ms):
            self.stack.clock.sleep_until_ns(self.stack.clock.now_ns() + NS_PER_MS)
            self.stack.backend._port.poll_in(self.stack.clock.now_ns())
            self.note()
        return self.seen


def ended(stack: LockStep) -> None:
    """End the servo as SIGTERM does; the board lives on."""
    stack.loop.stopping = True
    stack.run(1)  # ends at once
    stack.loop.finish()
    stack.loop.finish = lambda: None  # type: ignore[method-assign]


def steps(seen: list[Outputs]) -> float:
    """Greatest change of force from one OUT to the next [N]."""
    return max(abs(after.force_n - before.force_n) for before, after in pairwise(seen))


def fade(end: Callable[[LockStep], object]) -> list[Outputs]:
    """The board's outputs from the last frame under full force on, ended in that way."""
    with LockStep(servo_params(), board_params()) as stack:
        watched = Watched(stack)
        watched.press_into_the_spring()
        stack.run(1)
        end(stack)
        return watched.seen


def assert_same_road(seen: list[Outputs], road: list[Outputs]) -> None:
    """OUT by OUT the same forces; all that one has more is none."""
    for one, other in zip_longest(seen, road):
        assert (one.force_n if one else 0.0) == (other.force_n if other else 0.0)


def stopped(stack: LockStep) -> None:
    press_stop(stack.mailbox.folder)
    stack.run(FADE_TICKS + 1)


def test_force_fades_without_a_step_when_the_process_ends() -> None:
    seen = fade(ended)
    held_n = abs(seen[0].force_n)
    assert held_n == pytest.approx(0.98, abs=0.1)
    assert seen[-1].force_n == 0.0
    # the law goes on with the motion, which begins as the push ends (ADR-0010)
    assert steps(seen) <= 0.3 * held_n
    assert_same_road(seen, fade(stopped))


@pytest.mark.parametrize("asked", ["enabled", "disabled", "stopped"])
def test_damping_stays_to_the_last_frame_and_the_board_holds_and_releases_it(asked: str) -> None:
    with LockStep(servo_params(), board_params(watchdog_ms=20.0)) as stack:
        watched = Watched(stack)
        watched.press_into_the_spring()
        if asked == "disabled":
            stack.do(Command.DISABLE)
        if asked == "stopped":
            press_stop(stack.mailbox.folder)
        stack.run(100)
        before = watched.seen[-1].damping_n
        assert before == pytest.approx(1.74, abs=COUNT_NS_PER_M)
        watched.seen.clear()
        ended(stack)
        assert {one.damping_n for one in watched.seen} == {before}
        gone_ns = watched.seen[-1].t_ns
        alone = watched.watch_the_board_alone(3000)
    assert not any(one.force_n for one in alone)
    since_s = [(one.t_ns - gone_ns) * 1e-9 - WATCHDOG_MS * 1e-3 for one in alone]
    for after_s, one in zip(since_s, alone, strict=True):
        left = 1.0 - (after_s - DAMPING_HOLD_S) / DAMPING_RELEASE_S
        expected = before * min(1.0, max(0.0, left))
        # released in the steps of the board's 4 kHz clock, seen once in a millisecond
        assert one.damping_n == pytest.approx(expected, abs=before / DAMPING_RELEASE_S * 0.0015)
    assert alone[-1].damping_n == 0.0


def test_end_during_a_stop_goes_on_with_its_ramp() -> None:
    def in_the_middle(stack: LockStep) -> None:
        press_stop(stack.mailbox.folder)
        stack.run(FADE_TICKS // 2)
        ended(stack)

    assert_same_road(fade(in_the_middle), fade(stopped))


def test_second_signal_does_not_shorten_the_end() -> None:
    def hurried(stack: LockStep) -> None:
        run = stack.loop.run

        def signalled(ticks: int | None = None) -> None:
            run(ticks)
            stack.loop.stopping = True

        stack.loop.run = signalled  # type: ignore[method-assign]
        ended(stack)

    assert_same_road(fade(hurried), fade(stopped))


def test_nobody_commands_a_servo_that_ends() -> None:
    with LockStep(servo_params(), board_params()) as stack:
        watched = Watched(stack)
        watched.press_into_the_spring()
        run = stack.loop.run

        def disturbed(ticks: int | None = None) -> None:
            if stack.gateway.backlog < 10:
                stack.command(Command.SET, SPRING | {Value.STIFFNESS: 1000.0})
                stack.command(Command.RESET)
                stack.command(Command.ENABLE)
            run(ticks)

        stack.loop.run = disturbed  # type: ignore[method-assign]
        taken = stack.mailbox.taken
        ended(stack)
        assert stack.mailbox.taken == taken
        last = codec.decode_out(bytes(stack.device.out_buffer))
    assert (last.flags, last.torque) == (int(OutFlag.FIFO_CLEAR), 0)
    assert watched.seen[-1].force_n == 0.0
    assert_same_road(watched.seen, fade(ended)[1:])


def test_end_with_a_slow_ramp_waits_for_it() -> None:
    with LockStep(servo_params(safety=SafetyParams(stop_ramp_s=0.3)), board_params()) as stack:
        watched = Watched(stack)
        watched.press_into_the_spring()
        ended(stack)
        assert len(watched.seen) >= 300


def test_end_without_a_board_ends() -> None:
    with LockStep(servo_params(), board_params()) as stack:
        stack.run(5)
        stack.backend.unplug()
        stack.run(5)
        ended(stack)
        with pytest.raises(LinkLost):
            stack.device.link.read(stack.device.in_buffer)


STATES: list[tuple[Callable[[LockStep], object], State]] = [
    (lambda stack: None, State.DISABLED),
    (lambda stack: stack.do(Command.ENABLE), State.STOPPED),
    (lambda stack: stack.do(Command.STOP), State.STOPPED),
]


@pytest.mark.parametrize(("asked", "state"), STATES)
def test_end_under_force_is_a_stop_of_the_servos_own_and_else_changes_nothing(
    asked: Callable[[LockStep], object], state: State
) -> None:
    with LockStep(servo_params(), board_params()) as stack:
        stack.run(5)
        asked(stack)
        stack.run(100)
        ended(stack)
        plan = stack.loop.state[SETTLED].plan
    assert plan.state is state
    if state is State.STOPPED:
        assert plan.actor in (0, 1)
