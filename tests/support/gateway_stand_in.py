"""A small servo for tests of the gateway: it owns a mailbox, executes commands at its ticks and
writes records. It renders no force.

Its answers follow the contract of the mailbox: two commands per tick, effective values in every
answer, a second answer for scheduled sets. Its state machine is the error-free path of the safety
table.
"""

import sys
import time
from pathlib import Path
from typing import Any

from hapticd.core.environment import Environment
from hapticd.core.params import (
    DeviceParams,
    GatewayParams,
    GatewaySetup,
    RealtimeParams,
    SafetyParams,
    ScaleParams,
    ServoParams,
    UsbParams,
)
from hapticd.core.units import NS_PER_S, Clock, MonotonicClock, VirtualClock
from hapticd.mailbox import layout
from hapticd.mailbox.layout import Command, Result, State, Value
from hapticd.mailbox.servo_side import ServoMailbox
from hapticd.protocol.view import configured
from hapticd.usb.codec import encode_in
from hapticd.usb.frames import InFrame

CONFIG_HASH = "c" * 64
JUDGED = range(Value.STIFFNESS, Value.ACTIVE_DAMPING_ON + 1)
NEXT_STATE = {
    Command.ENABLE: {State.DISABLED: State.ENABLED, State.ENABLED: State.ENABLED},
    Command.DISABLE: {
        state: state if state in (State.STOPPED, State.FAULT) else State.DISABLED for state in State
    },
    Command.STOP: {state: state if state is State.FAULT else State.STOPPED for state in State},
    Command.RESET: {
        State.STOPPED: State.DISABLED,
        State.FAULT: State.DISABLED,
        State.DISABLED: State.DISABLED,
    },
    Command.ZERO: {State.DISABLED: State.DISABLED},
    Command.HOME: {State.DISABLED: State.HOMING},
    Command.PERTURB_START: {State.ENABLED: State.ENABLED},
    Command.PERTURB_STOP: {state: state for state in State},
    Command.FAULT: dict.fromkeys(State, State.FAULT),
    Command.WITHHOLD: {State.DISABLED: State.DISABLED},
}


def setup(instance: str = "default", **gateway: Any) -> GatewaySetup:
    """A device with round numbers: 1 mN/count of probe force, damping up to 2 N s/m, probe up
    to 1 N; any free port.
    """
    scale = ScaleParams(1e-3)
    device = DeviceParams(
        "stand-in",
        "S1",
        position=ScaleParams(5e-7),
        force=scale,
        active_damping=scale,
        probe_torque=ScaleParams(1e-3, -1, 2.0),
        probe_velocity=ScaleParams(1e-4),
        current=scale,
        voltage=scale,
        emf_velocity=scale,
        temperature=scale,
        force_limit_n=8.0,
        active_damping_limit_ns_per_m=2.0,
        probe_limit_n=1.0,
        temperature_limit_c=100.0,
        speed_limit_m_per_s=5.0,
    )
    servo = ServoParams(
        instance,
        True,
        Environment(),
        device,
        SafetyParams(),
        RealtimeParams(grace_s=0.0),
        UsbParams(),
        config_hash=CONFIG_HASH,
    )
    return GatewaySetup(servo, GatewayParams(**({"telemetry_port": 0, "flight_s": 5.0} | gateway)))


class StandInServo:
    """A substitute servo; `tick()` runs one tick and the mailbox exists from the start. `deaf`:
    takes no commands; `mute`: gives no answers.
    """

    def __init__(
        self,
        folder: Path,
        clock: Clock,
        rate_hz: float = 1000.0,
        config_hash: str = CONFIG_HASH,
    ) -> None:
        self.clock = clock
        self.rate_hz = rate_hz
        start_ns = max(clock.now_ns(), 1)
        self.mailbox = ServoMailbox(folder, rate_hz, config_hash, True, start_ns)
        self.mailbox.report({"granted": "nothing"})
        self.mailbox.publish()
        self.ticks = 0
        self.state = State.DISABLED
        self.fault = 0
        self.revision = 0
        self.actor = 0
        self.perturbing = self.deaf = self.mute = False
        self.values = list(configured(setup().servo))
        self.scheduled: list[tuple[Any, ...]] = []
        self.word_pressers: set[int] = set()
        self.taken: list[tuple[int, int]] = []  # (kind, actor) in the order of execution
        self.terms = layout.ANY_TERMS
        self.probe_index = 0
        self.probe_pairs = 4
        self.flags = 0
        self.force_n = 1.5
        self.effect: float | None = None  # damping that the board reports; None: as commanded
        self.frame = bytes(64)

    def tick(self, count: int = 1) -> None:
        """Run `count` ticks; with a virtual clock, one period each."""
        for _ in range(count):
            if isinstance(self.clock, VirtualClock):
                self.clock.time_ns += round(NS_PER_S / self.rate_hz)
            self._obey()
            self._publish()
            self.ticks += 1
            self.mailbox.words[layout.SERVO_BEAT_WORD] = self.clock.now_ns()

    def _obey(self) -> None:
        for _ in range(0 if self.deaf else 2):
            if command := self.mailbox.take():
                self._command(command)
        pressed = self.mailbox.stop_word.pressed
        if pressed:
            self.word_pressers.add(self.mailbox.stop_word.presser)
            self.mailbox.stop_word.take_back()
        if pressed and self.state not in (State.STOPPED, State.FAULT):
            self.state = State.STOPPED
            self.fault = 1
            self.actor = 2
            self.revision = layout.following(self.revision)
        for command in [one for one in self.scheduled if one[3] <= self.ticks]:
            self.scheduled.remove(command)
            self._apply(command)

    def _command(self, command: tuple[Any, ...]) -> None:
        seq, kind, actor, apply_tick, values = command
        if kind != Command.TERMS:  # the gateway's own
            self.taken.append((kind, actor))
        if kind in (Command.SET, Command.DAMPING):
            if 0 < apply_tick < self.ticks:
                self._answer(seq, Result.REFUSED_LATE)
            elif apply_tick > self.ticks:
                self.scheduled.append(command)
                self._answer(seq, Result.SCHEDULED, apply_tick)
            else:
                self._apply(command)
        elif kind == Command.CANCEL:
            self._cancel(actor, int(values[0]))
            self._answer(seq, Result.APPLIED)
        elif kind == Command.WITHDRAWN:
            self._answer(seq, Result.CANCELLED)
        elif kind == Command.TERMS:
            self.terms = int(values[Value.TERMS])
            self._end([one for one in self.scheduled if self._foreign(one[4], True)])
            self._answer(seq, Result.APPLIED)
        elif self._foreign(values):
            self._answer(seq, Result.REFUSED_TERMS)
        elif self.state not in NEXT_STATE[Command(kind)]:
            self._answer(seq, Result.REFUSED_STATE)
        else:
            self.state = NEXT_STATE[Command(kind)][self.state]
            self.actor = actor
            self.fault = 1 if kind == Command.STOP else 0
            self.perturbing = kind == Command.PERTURB_START or (
                self.perturbing and kind != Command.PERTURB_STOP
            )
            self.played = values[Value.SAMPLES], values[Value.LOOP]
            if self.state is not State.ENABLED:
                self.values[Value.LIMIT_CYCLE_FAULTS] = 1.0
                self.perturbing = False
            self.revision = layout.following(self.revision)
            self._answer(seq, Result.APPLIED)

    def _cancel(self, actor: int, mask: int) -> None:
        self._end([one for one in self.scheduled if one[2] != actor and int(one[4][0]) & mask])

    def _foreign(self, values: tuple[float, ...], unnamed: bool = False) -> bool:
        """Whether other terms than those that count are named, or none where that counts too."""
        if not int(values[0]) >> Value.TERMS & 1:
            return unnamed
        return values[Value.TERMS] not in (self.terms, layout.ANY_TERMS)

    def _end(self, gone: list[tuple[Any, ...]]) -> None:
        self.scheduled = [one for one in self.scheduled if one not in gone]
        for one in gone:
            self._answer(one[0], Result.CANCELLED)

    def _apply(self, command: tuple[Any, ...]) -> None:
        seq, _, actor, _, values = command
        named = int(values[0]) >> Value.ENVIRONMENT_REVISION & 1
        now = self.values[Value.ENVIRONMENT_REVISION]
        if self._foreign(values):
            self._answer(seq, Result.REFUSED_TERMS)
            return
        if named and values[Value.ENVIRONMENT_REVISION] != now:
            self._answer(seq, Result.REFUSED_REVISION)
            return
        self.actor = actor
        for place in range(1, Value.ENVIRONMENT_REVISION):
            if int(values[0]) >> place & 1:
                self.values[place] = values[place]
        self.revision = layout.following(self.revision)
        if any(int(values[0]) >> place & 1 for place in JUDGED):
            self.values[Value.ENVIRONMENT_REVISION] = float(layout.following(int(now)))
        self._answer(seq, Result.APPLIED, end=self.ticks + 50)

    def _answer(
        self, seq: int, result: Result, first: int | None = None, end: int | None = None
    ) -> None:
        first = self.ticks if first is None else first
        if not self.mute:
            self.mailbox.answer(
                seq, result, self.fault, self.revision, (first, end or first), tuple(self.values)
            )

    def _publish(self) -> None:
        now_ns = self.clock.now_ns()
        v = self.values
        plan = layout.PLAN.pack(
            self.revision,
            self.state,
            self.fault,
            self.perturbing,
            True,
            self.actor,
            int(v[Value.LEASE_CONTROL]),
            int(v[Value.LEASE_ACTIVE_DAMPING]),
            1.0,
            v[2],
            v[3],
            v[4],
            v[13],
            v[13],
            v[9],
            v[11],
            0.0,
            int(v[12]),
            7 if v[Value.LIMIT_CYCLE_FAULTS] else 2,
            int(v[Value.ENVIRONMENT_REVISION]),
            0,
        )
        pairs = tuple((self.probe_index + n & 0x7FFF, -n) for n in range(self.probe_pairs))
        self.frame = encode_in(
            InFrame(
                self.ticks & 0xFFFF,
                0,
                0,
                0,
                0,
                0,
                0,
                0,
                0,
                0,
                8,
                1,
                0,
                self.probe_index & 0xFFFFFFFF,
                pairs,
            )
        )
        self.probe_index += self.probe_pairs
        values = (
            self.ticks,
            now_ns,
            now_ns // 1000,
            plan,
            self.flags,
            0,
            0,
            3,
            self.ticks,
            1e-3,
            0.25,
            2.0,
            0.1,
            0.2,
            0.3,
            0.4,
            self.force_n,
            0.01,
            0.02,
            25.0,
            0.5,
            12.0,
            0.24,
            1000,
            20000,
            8000,
            30000,
            4000,
            0,
            0,
            0,
            125,
            1,
            126,
            v[13] * v[14] if self.effect is None else self.effect,
            -1,
            -1,
            0,
            self.frame,
            bytes(32),
            self.ticks,
        )
        offset = layout.TELEMETRY_OFFSET + self.ticks % layout.RING_RECORDS * layout.RECORD.size
        layout.RECORD.pack_into(self.mailbox.ring, offset, *values)
        self.mailbox.publish_head(layout.TELEMETRY_HEAD_WORD, self.ticks + 1)


def main(folder: Path, rate_hz: float) -> None:
    """Run a live substitute servo until its standard input is closed."""
    import select

    servo = StandInServo(folder, MonotonicClock(), rate_hz)
    deadline_ns = servo.clock.now_ns()
    while not select.select([sys.stdin], [], [], 0)[0]:
        servo.tick()
        deadline_ns = max(deadline_ns + round(NS_PER_S / rate_hz), time.monotonic_ns() - NS_PER_S)
        servo.clock.sleep_until_ns(deadline_ns)
    servo.mailbox.close()


if __name__ == "__main__":
    main(Path(sys.argv[1]), float(sys.argv[2]))
