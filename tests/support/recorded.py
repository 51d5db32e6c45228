"""The whole stack in lock-step with the gateway's publisher: every message that a recorder would
receive.
"""

from collections.abc import Generator, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from hapticd.core.arrays import Records
from hapticd.core.params import GatewayParams, GatewaySetup, GuardParams, ServoParams
from hapticd.core.units import NS_PER_MS, NS_PER_S, VirtualClock
from hapticd.gateway.publisher import Publisher
from hapticd.guard.status import Guard
from hapticd.mailbox.layout import Command, Value
from hapticd.model.params import BoardParams
from hapticd.protocol.answers import Hello, Status
from hapticd.protocol.journal import Actors, Journal
from hapticd.protocol.view import ServoView, as_records
from hapticd.recording import replay
from hapticd.recording.recorder import RecordingParams, record
from hapticd.run.lockstep import LockStep
from support.boards import board_params
from support.guard_stub import StubWorker
from support.models import servo_params

UNIX_NS = 1_800_000_000 * NS_PER_S
TOPICS = ("servo.raw", "probe", "event", "flight")
AT_ONCE = 20


class RecordedFlight:
    """A servo in the air and its published messages. Use as a context manager."""

    def __init__(
        self,
        params: ServoParams | None = None,
        board: BoardParams | None = None,
        flight_s: float = 5.0,
        policy: str = "warn",
        worker: StubWorker | None = None,
    ) -> None:
        self.params = params or servo_params()
        self.stack = LockStep(self.params, board or board_params())
        self.setup = GatewaySetup(
            self.params, GatewayParams(flight_s=flight_s), guard=GuardParams(policy=policy)
        )
        self.journal = Journal(self.unix_ns)
        self.view = ServoView(self.stack.mailbox.folder, self.params, self.unix_ns)
        self.guard = Guard(self.view, self.journal, self.setup.guard, worker)
        self.publisher = Publisher(
            self.view,
            Actors(self.view.next_actor),
            self.journal,
            self.setup,
            self.guard,
            self.unix_ns,
        )
        self.messages: list[tuple[str, bytes]] = []
        for topic in TOPICS:
            self.publisher.subscribe(b"a", b"\1" + topic.encode(), self.unix_ns())

    def unix_ns(self) -> int:
        return UNIX_NS + self.stack.clock.now_ns()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.view.drop()
        self.stack.__exit__(kind, error, trace)
        self.publisher.flight.close()

    def fly(self, ticks: int) -> None:
        """Run `ticks`; the gateway polls every 20."""
        for _ in range(0, ticks, AT_ONCE):
            self.stack.run(AT_ONCE)
            self.look()

    def look(self) -> None:
        """Run one poll of the gateway."""
        now_ns = self.stack.clock.now_ns()
        self.view.refresh(now_ns)
        self.guard.tend(now_ns)
        self.messages += self.publisher.messages(now_ns, self.unix_ns())

    def move(self) -> None:
        """Enabled, K 50 N/m and B 2 N s/m, with noise on the perturbation input."""
        self.stack.run(5)
        self.stack.do(Command.SET, {Value.STIFFNESS: 50.0, Value.VIRTUAL_DAMPING: 2.0})
        self.stack.do(Command.ENABLE)
        self.stack.load_waveform(np.random.default_rng(7).integers(-3000, 3001, 8000).tolist())
        self.stack.do(Command.PERTURB_START, {Value.SAMPLES: 8000.0, Value.LOOP: 1.0})

    def set_off(self, stiffness: float, counts: list[int]) -> None:
        """Enabled with that stiffness [N/m], then pushed by `counts` of the perturbation input."""
        self.stack.run(5)
        self.stack.do(Command.SET, {Value.STIFFNESS: stiffness, Value.RAMP_S: 0.0})
        self.stack.do(Command.ENABLE)
        self.stack.load_waveform(counts)
        self.fly(520)
        self.stack.do(Command.PERTURB_START, {Value.SAMPLES: float(len(counts)), Value.LOOP: 0.0})

    @property
    def records(self) -> Records:
        """Everything that was flown."""
        return as_records(b"".join(self.stack.blocks))

    def leg(self) -> replay.Segment:
        """Return the segment from the first checkpoint of the servo to the end."""
        checkpoint = self.publisher.flight._checkpoints[0]
        requests, _, lost = self.stack.gateway.journal(0)
        assert lost == 0
        records = self.records
        return replay.Segment(
            checkpoint.tick,
            checkpoint.state,
            records[records["tick"] >= checkpoint.tick],
            [one for one in requests if one.tick >= checkpoint.tick],
        )


class Source:
    """Replaces hapticd.client.Client: plays `messages` once; each poll takes `look_ms`."""

    def __init__(self, flight: RecordedFlight, clock: VirtualClock, look_ms: int = 20) -> None:
        self.played = list(flight.messages)
        self.params = flight.params
        self._clock = clock
        self._look_ms = look_ms

    def hello(self) -> Hello:
        return Hello(1000.0, True, self.params, instance="test", version="0.1.0")

    def status(self) -> Status:
        report = {
            "realtime": {"fifo": {"granted": True, "text": ""}},
            "board": {"serial": "SIM0001"},
        }
        return Status(state="enabled", config_hash="c" * 64, winding_c=25.0, servo=report)

    def messages(
        self, topics: Sequence[str], look_s: float = 0.05
    ) -> Generator[tuple[str, bytes] | None, None, None]:
        assert set(topics) == set(TOPICS)
        for place, message in enumerate(self.played):
            yield message
            if place % 5 == 4:
                self._clock.time_ns += 5 * self._look_ms * NS_PER_MS
                yield None
        while True:
            self._clock.time_ns += self._look_ms * NS_PER_MS
            yield None


def room(folder: Path) -> int:
    """A disk with space."""
    return 10**12


def recorded_into(
    file: Path, flight: RecordedFlight, seconds: float | None = None, **more: Any
) -> dict[str, Any]:
    """A recording of everything that was published; it ends by silence unless `seconds` are
    enough.
    """
    clock = VirtualClock(NS_PER_S)
    return record(
        Source(flight, clock),
        RecordingParams(file, seconds, "a note"),
        lambda: False,
        clock=clock,
        free_bytes=room,
        **more,
    )
