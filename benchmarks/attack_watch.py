"""The judge of the attack: permitted behaviour of the simulated motor, observed only at the motor.

    authority   force only while the board grants torque, and only in a stay in `enabled` or
                `homing` that begins with an own enable or home that was answered `applied`
    clamp       never beyond the smaller of both force limits
    step        from one OUT to the next at most limits.force_step_n beyond the law's own step, for
                any command and any fault; a step to 0 removes force, and so does one towards 0
                once force has to end
    end         0 within 22 periods after the servo left those states, except for the first tick
                after a host stood still; at once for `disabled`
    silence     0 within the watchdog's time and a period after the last OUT accepted by the board

The motor is observed in every piece that the plant plays, so between two OUTs too. The motion of
the handle bounds the law's own step. The bound is K times the range of its position over the last
OUTs, B times that of its speed, M times that of its acceleration, and the same for the wall. This
is the plant's own motion, not the servo's estimate, and no filter passes more than the recent range
of its input. While an encoder is wrong or an amplifier does not follow its command, steps are not
judged, and the amplifier's own factor widens the clamp. The servo cannot detect this.

Of the servo's records only the state is used, for the time since which it requests no force; and
that state is checked against the commands.

Limitations: a device whose force scale has an offset, a filter of less than 50 Hz.
"""

from typing import Any, NamedTuple

import numpy as np

from hapticd.core.params import ServoParams
from hapticd.mailbox import layout
from hapticd.mailbox.layout import Command, Result, State, Value
from hapticd.model.composed import POSITION
from hapticd.model.params import BoardParams
from hapticd.model.step import SUBSTEPS_PER_TICK
from hapticd.run.lockstep import LockStep
from hapticd.servo.safety import GRANTED, LATCHED
from hapticd.sim.axis import NEVER
from hapticd.sim.injection import Injector

DTYPE = np.dtype([tuple(field) for field in layout.TELEMETRY])
END_PERIODS = 22  # from the tick that left `enabled` to no force
CALM_OUTS = 4  # over which the law's own step is evaluated
STRUCK_OUTS = 24  # the same, after lost samples or commands
SLACK_N = 0.02  # quantised positions through the derivative filters
MOST_TOLD = 20
SEQ_WORD = 0  # of an OUT frame in 16 bits


class Violation(NamedTuple):
    """One violation of a rule, with its place."""

    rule: str
    tick: int
    text: str


class Out(NamedTuple):
    """The motor around one OUT accepted by the board."""

    seq: int  # its number, also that of a tick's record
    before_n: float  # last force on the plant
    after_n: float
    position_m: float
    odd: bool  # the amplifier does not follow its command
    number: int  # number of earlier OUT attempts, by which faults strike


class Given(NamedTuple):
    """An answer to a command of the operator."""

    kind: int
    result: int
    tick: int
    values: tuple[float, ...]


class Watch:
    """Follows the motor of `stack`. `lies` are the OUT numbers at which an encoder is wrong."""

    def __init__(self, stack: LockStep, servo: ServoParams, board: BoardParams) -> None:
        port = stack.backend._port
        self._port: Any = port
        self._board: Any = port.board if isinstance(port, Injector) else port
        self._axis = self._board._axis
        self._stack = stack
        self._servo = servo
        self.limit_n = min(servo.safety.force_limit_n, servo.device.force_limit_n)
        self._widest = max(
            [1.0, *(abs(i.value) for i in board.injections if i.kind == "amplifier_gain")]
        )
        self._stuck_n = max(
            [0.0, *(abs(i.value) for i in board.injections if i.kind == "amplifier_stuck")]
        )
        self._silent = round(
            (board.watchdog_ms * servo.realtime.rate_hz / 1000 + 1) * SUBSTEPS_PER_TICK
        )
        self.outs: list[Out] = []
        self.given: list[Given] = []
        self.found: list[Violation] = []
        self._felt_n = 0.0
        self._taken_at = 0
        self._taken = self._board._next_seq
        self._watch_plant()
        self._watch_transfers(stack)

    def _watch_plant(self) -> None:
        axis = self._axis
        step = axis.plant.step
        half_n = 0.5 * abs(self._servo.device.force.per_count)  # limits are also rounded to counts
        most_n = self.limit_n + 1.001 * half_n
        odd_n = max(most_n * self._widest, self._stuck_n) * (1.0 + 1e-9)

        def watched(state: Any, force_n: float, torque_n: float, level: float, n: int) -> Any:
            self._felt_n = force_n
            if force_n:
                if not axis.live:
                    self.tell("authority", f"{force_n:.3f} N without the board's ENABLED")
                if not -most_n <= force_n <= most_n and (
                    axis.amplifier is None or not -odd_n <= force_n <= odd_n
                ):
                    self._beyond(force_n, odd_n)
                if axis.now - self._taken_at > self._silent and axis._alarm_at != NEVER:
                    self.tell("silence", f"{force_n:.3f} N although no OUT came")
            return step(state, force_n, torque_n, level, n)

        axis.plant = axis.plant._replace(step=watched)

    def _beyond(self, force_n: float, odd_n: float) -> None:
        """Report a force beyond the clamp, unless a recent OUT was accepted with a
        wrong amplifier.
        """
        odd = any(out.odd for out in self.outs[-3:])
        if not (odd and -odd_n <= force_n <= odd_n):
            self.tell("clamp", f"{force_n:.3f} N, limit {self.limit_n:g} N")

    def _watch_transfers(self, stack: LockStep) -> None:
        deliver = stack.backend.deliver
        board = self._board
        axis = self._axis

        def watched(data: memoryview, t_ns: int) -> None:
            deliver(data, t_ns)
            if board._next_seq != self._taken:
                self._taken = board._next_seq
                self._taken_at = axis.now
                self._note(board._echo)

        stack.backend.deliver = watched

    def _note(self, seq: int) -> None:
        axis = self._axis
        odd = axis.amplifier is not None
        number = getattr(self._port, "tick", 0)
        moved_m = axis.state[POSITION]
        self.outs.append(Out(seq, self._felt_n, axis.force_n, moved_m, odd, number))

    def tell(self, rule: str, text: str) -> None:
        """Note a violation at this moment."""
        known = any(one[:2] == (rule, self._stack.loop.tick) for one in self.found)
        if len(self.found) < MOST_TOLD and not known:
            self.found.append(Violation(rule, self._stack.loop.tick, text))

    def under_force(self) -> int:
        """Return the number of OUTs after which the motor had force."""
        return sum(1 for out in self.outs if out.after_n)

    def judge(self, records: Any, lies: "np.ndarray[Any, Any]") -> list[Violation]:
        """Return all violations of a flight. `records` are its ticks; `lies` shows whether an
        encoder was wrong (row 0) or something was lost (row 1) shortly before each OUT.
        """
        if len(self.outs) < STRUCK_OUTS:
            return self.found
        outs = Outs(*(np.array(column) for column in zip(*self.outs, strict=True)))
        # by their number: in flight the board receives an OUT after the call of its tick
        frames = np.ascontiguousarray(records["out_frame"]).view("<u2").reshape(len(records), -1)
        numbers = frames[:, SEQ_WORD]
        ticks = np.minimum(np.searchsorted(numbers, outs.seq), len(records) - 1)
        found = [*self._late_ends(outs, ticks, records), *self._unasked(records)]
        found += self._steps(outs, ticks, lies, np.isin(records["state"][ticks], list(GRANTED)))
        return self.found + found[: MOST_TOLD - len(self.found)]

    def _late_ends(self, outs: "Outs", ticks: Any, records: Any) -> list[Violation]:
        state = records["state"]
        granted = np.isin(state, list(GRANTED))
        latched = np.isin(state, list(LATCHED))
        since = np.maximum.accumulate(np.where(granted, np.arange(len(state)), -1))
        left_ns = records["time_ns"][np.minimum(since + 1, len(state) - 1)]
        period_ns = 1e9 / self._servo.realtime.rate_hz
        woken = (
            records["wake_ns"] > period_ns
        )  # the host stood still: this tick is the first to end
        in_time = records["time_ns"][ticks] - left_ns[ticks] <= END_PERIODS * period_ns
        fading = latched[ticks] & (in_time | woken[ticks])
        wrong = (outs.after_n != 0.0) & ~granted[ticks] & ~fading
        return [
            Violation(
                "end",
                int(ticks[one]),
                f"{outs.after_n[one]:.3f} N in {State(state[ticks[one]]).name}",
            )
            for one in np.flatnonzero(wrong)
        ]

    def _unasked(self, records: Any) -> list[Violation]:
        granted = np.isin(records["state"], list(GRANTED))
        begins = np.flatnonzero(granted[1:] & ~granted[:-1]) + 1
        asked = {
            one.tick
            for one in self.given
            if one.kind in (Command.ENABLE, Command.HOME) and one.result == Result.APPLIED
        }
        wrong = [tick for tick in records["tick"][begins].tolist() if tick not in asked]
        ended = [
            one.tick
            for one in self.given
            if one.kind == Command.STOP and one.result == Result.APPLIED and one.tick < len(records)
        ]
        deaf = [tick for tick in ended if records["state"][tick] not in LATCHED]
        return [
            *(Violation("authority", tick, "nobody enabled") for tick in wrong),
            *(Violation("end", tick, "a stop that was applied does not latch") for tick in deaf),
        ]

    def _steps(self, outs: "Outs", ticks: Any, lies: Any, granted: Any) -> list[Violation]:
        period_s = 1.0 / self._servo.realtime.rate_hz
        speed = np.diff(outs.position_m, prepend=outs.position_m[0]) / period_s
        push = np.diff(speed, prepend=0.0) / period_s
        k, b, m, wall_k, wall_b = self._highest(ticks)
        encoder, link = lies[:, np.minimum(outs.number, lies.shape[1] - 1)]
        moved = np.where(
            link, _range(outs.position_m, STRUCK_OUTS), _range(outs.position_m, CALM_OUTS)
        )
        speeds = _range(speed, STRUCK_OUTS)
        law_n = (k + wall_k) * moved + (b + wall_b) * speeds + m * _range(push, STRUCK_OUTS)
        law_n += wall_b * _range(np.abs(speed), STRUCK_OUTS)
        step_n = np.abs(outs.after_n - outs.before_n)
        bound_n = self._servo.device.force_step_n + SLACK_N
        told = encoder | outs.odd | np.roll(outs.odd, 1) | np.roll(outs.odd, 2)
        less = outs.after_n * (outs.before_n - outs.after_n) >= 0.0  # same sign, nearer to 0
        wrong = (step_n > bound_n + law_n) & ~(less & ~granted) & (outs.after_n != 0.0) & ~told
        return [
            Violation(
                "step",
                int(ticks[one]),
                f"{outs.before_n[one]:.3f} -> {outs.after_n[one]:.3f} N, the law's own"
                f" {law_n[one]:.3f} N",
            )
            for one in np.flatnonzero(wrong)
        ]

    def _highest(self, ticks: Any) -> Any:
        """Return the highest requested |K|, |B|, |M| and wall numbers up to each OUT."""
        highest = np.zeros((len(PARAMETERS), ticks.max() + 2))
        start = self._servo.environment
        highest[:, 0] = (
            start.stiffness_n_per_m,
            start.virtual_damping_ns_per_m,
            start.mass_kg,
            0.0,
            0.0,
        )
        for one in self.given:
            if one.result in (Result.APPLIED, Result.SCHEDULED) and one.tick < highest.shape[1]:
                asked = np.abs([one.values[place] for place in PARAMETERS])
                highest[:, one.tick] = np.maximum(highest[:, one.tick], asked)
        return np.maximum.accumulate(highest, axis=1)[:, ticks]


PARAMETERS = (
    Value.STIFFNESS,
    Value.VIRTUAL_DAMPING,
    Value.MASS,
    Value.WALL_STIFFNESS,
    Value.WALL_VIRTUAL_DAMPING,
)


class Outs(NamedTuple):
    """The columns of several Out."""

    seq: Any
    before_n: Any
    after_n: Any
    position_m: Any
    odd: Any
    number: Any


def _range(values: Any, outs: int) -> Any:
    """Return the range of `values` over each and the `outs` before it."""
    padded = np.concatenate((np.full(outs, values[0]), values))
    windows = np.lib.stride_tricks.sliding_window_view(padded, outs + 1)
    return np.ptp(windows, axis=1)
