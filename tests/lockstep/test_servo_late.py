"""Each late tick has its cause in the record, whatever made it late and whichever way frames go."""

from collections import Counter
from collections.abc import Callable
from random import Random
from typing import Any

import pytest
from support.boards import board_params
from support.models import servo_params

from hapticd.core.arrays import Records
from hapticd.core.params import UsbParams
from hapticd.mailbox.layout import STAGES, Command, LateCause, Value
from hapticd.protocol.view import as_records
from hapticd.run.lockstep import LockStep
from hapticd.sim.bus import BAND, Bus, TransferTime

pytestmark = pytest.mark.usefixtures("either_way")

PERIOD_NS = 1_000_000
EVERY = 24  # ticks between two culprits
TALLIED = 256  # ticks between two visits of what a tick publishes now and then
TRIALS = 20
RIGHT = 0.9  # share of the late ticks
SHORTEST_NS, LONGEST_NS = 1_100_000, 2_600_000  # of what a culprit holds up
SERVO = servo_params(usb=UsbParams(timeout_ms=5))  # an IN that is late still comes
BUSES = ("root port", "slow host")
# in flight, one after the other; what no time tells apart there is TRANSFER
CULPRITS = {
    "wake": (LateCause.WAKE, LateCause.WAKE),
    "submission": (LateCause.SUBMISSION, LateCause.TRANSFER),
    "bus": (LateCause.BUS, LateCause.TRANSFER),
    "completion of IN": (LateCause.COMPLETION, LateCause.TRANSFER),
    "completion of OUT": (LateCause.NONE, LateCause.TRANSFER),  # in flight no tick waits for it
    "step": (LateCause.STEP, LateCause.STEP),
    "publish": (LateCause.PUBLISH, LateCause.PUBLISH),
}


class SeededBus:
    """`bus`, where `culprit` holds up the next transfer that it can; a slow bus an OUT and the IN
    after it (an IN alone counts as completion).
    """

    def __init__(self, bus: Bus) -> None:
        self._bus = bus
        self.culprit = ""
        self.held_ns: list[int] = []
        self.woken_ns = bus.woken_ns
        self.control_ns = bus.control_ns
        self.polled_ns = bus.polled_ns

    def _by(self, culprit: str) -> int:
        return self.held_ns.pop() if self.held_ns and self.culprit == culprit else 0

    def submitted_ns(self, t_ns: int) -> int:
        return self._bus.submitted_ns(t_ns) + self._by("submission")

    def out(self, t_ns: int, size: int) -> TransferTime:
        slow_ns = self._by("bus")
        passed = self._bus.out(t_ns, size)
        board_ns, host_ns = passed.board_ns + slow_ns, passed.host_ns + slow_ns
        return TransferTime(board_ns, host_ns + self._by("completion of OUT"))

    def received_ns(self, polled_ns: int) -> int:
        slow_ns = self._by("completion of IN")
        if len(self.held_ns) == 1:  # the OUT before was slow
            slow_ns += self._by("bus")
        return self._bus.received_ns(polled_ns) + slow_ns


class Bench:
    """A servo that renders a spring over the bus `name`, and culprits that make it late."""

    def __init__(self, name: str = "root port", seed: int = 1) -> None:
        self.stack = LockStep(SERVO, board_params(bus=BAND[name], seed=seed))
        self.in_flight = self.stack.device.link.in_flight
        self._random = Random(seed)
        self._held_ns: dict[str, int] = {}  # by the stage of the servo
        backend = self.stack.backend
        backend._bus = self._bus = SeededBus(backend._bus)
        if backend._flight is not None:
            backend._flight._bus = self._bus
        loop: Any = self.stack.loop
        loop.wait = self._held("wake", loop.wait)
        loop.step = self._held("step", loop.step)
        loop._tally = self._held("publish", loop._tally)
        self.stack.run(5)
        self.stack.do(Command.ENABLE)
        self.stack.do(Command.SET, {Value.STIFFNESS: 100.0, Value.RAMP_S: 0.0})
        self.stack.run(EVERY)

    def __enter__(self) -> "Bench":
        return self

    def __exit__(self, *_: object) -> None:
        self.stack.close()

    def _held(self, stage: str, action: Callable[..., Any]) -> Callable[..., Any]:
        def held(*given: Any) -> Any:
            found = action(*given)
            self.stack.clock.time_ns += (held_ns := self._held_ns.pop(stage, 0))
            return found + held_ns if stage == "wake" else found

        return held

    def hold(self, culprit: str, held_ns: int) -> None:
        """The next tick that it can, `culprit` holds up."""
        if culprit in STAGES:
            self._held_ns[culprit] = held_ns
        else:
            self._bus.culprit = culprit
            self._bus.held_ns = [held_ns] * (2 if culprit == "bus" else 1)

    def run(self, ticks: int = EVERY) -> Records:
        return as_records(self.stack.run(ticks))

    def causes(self, culprit: str) -> Counter[LateCause]:
        """How often which cause was found for it."""
        found: Counter[LateCause] = Counter()
        for _ in range(TRIALS):
            self.hold(culprit, self._random.randint(SHORTEST_NS, LONGEST_NS))
            causes = self.run(TALLIED if culprit == "publish" else EVERY)["late_cause"]
            found.update(LateCause(cause) for cause in causes if cause)
        return found


@pytest.mark.parametrize("name", BUSES)
@pytest.mark.parametrize("culprit", CULPRITS)
def test_nine_late_ticks_of_ten_have_the_cause_that_was_seeded(culprit: str, name: str) -> None:
    with Bench(name) as bench:
        cause = CULPRITS[culprit][not bench.in_flight]
        right = {cause} if bench.in_flight or culprit != "bus" else {cause, LateCause.BUS}
        found = bench.causes(culprit)
    assert found.total() >= (TRIALS if cause else 0)
    assert sum(found[one] for one in right) >= RIGHT * found.total(), found


def test_tick_on_time_has_no_cause() -> None:
    with Bench() as bench:
        records = bench.run(1000)
    assert not records["lost_slots"].any()
    assert not records["late_cause"].any()
    assert not records["late_ns"].any()


@pytest.mark.parametrize("more_ns", [-300_000, 300_000])
def test_of_two_culprits_the_greater_is_the_cause(more_ns: int) -> None:
    with Bench() as bench:
        found = set()
        for held_ns in range(600_000, 1_600_000, 100_000):
            bench.hold("step", held_ns)
            bench.hold("wake", held_ns + more_ns)
            found |= set(bench.run()["late_cause"].tolist())
    assert found == {LateCause.NONE, LateCause.WAKE if more_ns > 0 else LateCause.STEP}


def test_record_after_a_late_tick_says_by_how_much_it_was_late() -> None:
    """Its parts, less a period; the lost slots show in the same record."""
    with Bench() as bench:
        bench.hold("step", 2_345_678)
        records = bench.run()
    (place,) = records["late_ns"].nonzero()[0]
    *parts, _ = (records[f"{stage}_ns"][place - 1] for stage in STAGES)
    late_ns = sum(parts) + records["publish_ns"][place] - PERIOD_NS
    assert records["late_ns"][place] == late_ns > 2_345_678 - PERIOD_NS
    assert records["slot"][place] - records["slot"][place - 1] == 3
    assert records["late_cause"][place] == LateCause.STEP


def test_pause_of_hours_has_a_cause() -> None:
    with Bench() as bench:
        bench.hold("wake", 10**13)
        records = bench.run()
    (place,) = records["late_ns"].nonzero()[0]
    assert records["late_ns"][place] == 2**31 - 1
    assert records["late_cause"][place] == LateCause.WAKE
