"""The real servo loop on the machine's clock inside a worker, enabled without a gateway process."""

import atexit
import dataclasses
import json
import os
import shutil
from collections import Counter
from collections.abc import Callable
from pathlib import Path

from benchmarks.records import place
from benchmarks.worker import BenchError
from hapticd.core.params import ServoParams, from_plain
from hapticd.core.units import NS_PER_S, NS_PER_US, MonotonicClock
from hapticd.mailbox import files, layout
from hapticd.mailbox.client_side import GatewayMailbox
from hapticd.mailbox.layout import COMMAND_VALUES, Command
from hapticd.mailbox.servo_side import ServoMailbox
from hapticd.model.params import BoardParams
from hapticd.servo.late import spinning_wait
from hapticd.servo.loop import ServoLoop
from hapticd.servo.plan import SETTLED
from hapticd.usb.codec import Link
from hapticd.usb.device import Device

FOR_EVER_S = 1e6  # no heartbeat here
ACTOR = 1
CHUNK_S = 0.05
SETTLE_CHUNKS = 100
LATE_CAUSE = place("late_cause")
NO_VALUES = (0.0,) * COMMAND_VALUES


def read_parameters(path: str) -> tuple[ServoParams, BoardParams]:
    """Read servo and board of a `stand.parameter_file`; the servo runs without a heartbeat."""
    plain = json.loads(Path(path).read_text())
    servo = from_plain(ServoParams, plain[files.SERVO_JSON], path)
    safety = dataclasses.replace(servo.safety, gateway_timeout_s=FOR_EVER_S)
    return dataclasses.replace(servo, safety=safety), from_plain(
        BoardParams, plain[files.BOARD_JSON], path
    )


class BenchServo:
    """A servo on `link`; `before(ticks)` is called before every run."""

    def __init__(
        self, params: ServoParams, link: Link, before: Callable[[int], None] = lambda _: None
    ) -> None:
        path = files.prepare_folder(files.runtime_folder(f"bench-{os.getpid()}"))
        atexit.register(shutil.rmtree, path, ignore_errors=True)
        self._before, self.clock, rate_hz = before, MonotonicClock(), params.realtime.rate_hz
        self.device = Device(link, rate_hz)
        self.device.connect()
        self.mailbox = ServoMailbox(
            path, rate_hz, params.config_hash, params.simulated, self.clock.now_ns()
        )
        self.mailbox.publish()
        self.gateway = GatewayMailbox(path)
        wait = spinning_wait(int(params.realtime.spin_us * NS_PER_US), int(NS_PER_S / rate_hz))
        self.loop = ServoLoop(params, self.device, self.mailbox, self.clock, wait)
        self._chunk = int(CHUNK_S * rate_hz)

    def run(self, ticks: int) -> bytes:
        """Run `ticks` ticks from now on; return their records."""
        first = self.loop.tick
        self._before(ticks)
        self.loop.restart_clock()
        self.loop.run(ticks)
        return self.gateway.records(first, ticks)[0]

    def enable(self) -> None:
        """Enable, and wait for the end of the gain ramp. BenchError if the servo refuses."""
        self.gateway.beat(self.clock.now_ns())
        self.gateway.post(Command.ENABLE, ACTOR, 0, NO_VALUES)
        self.settle()
        results = [answer.result for answer in self.gateway.answers()]
        if results != [layout.Result.APPLIED]:
            raise BenchError(f"the servo was not enabled: {results}")

    def settle(self) -> None:
        """Run until no ramp runs, including the one after a pause. BenchError if that
        does not end.
        """
        self._before(SETTLE_CHUNKS * self._chunk)
        self.loop.restart_clock()
        for _ in range(SETTLE_CHUNKS):
            self.loop.run(self._chunk)
            if self.loop.state[SETTLED].wake_tick > self.loop.slot:
                return
        raise BenchError(
            "the servo's ramp does not end: the machine pauses it again and again; quiet the"
            " machine"
        )

    def late_ticks(self, ticks: int) -> dict[str, int]:
        """Return how many of `ticks` ticks end beyond the next deadline, with or without grace, by
        LateCause. They run in pieces that fit into the ring, each after `settle`.
        """
        found: Counter[str] = Counter()
        while ticks:
            piece = min(ticks, layout.RING_RECORDS // 2)
            found.update(self._late_piece(piece))
            ticks -= piece
        return found

    def _late_piece(self, ticks: int) -> Counter[str]:
        self.settle()
        before = self._late()
        first = self.loop.tick
        self.loop.run(ticks)
        records = layout.RECORD.iter_unpack(self.gateway.records(first, ticks)[0])
        causes = [record[LATE_CAUSE] for record in records][1:]  # each is that of the tick before
        known = Counter(layout.LateCause(cause).name for cause in causes if cause)
        known["LAST"] = self._late() - before - known.total()
        return +known

    def _late(self) -> int:
        counted = self.gateway.counters()
        return counted["late_events"] + counted["grace_late_events"]
