"""Random requests of two clients under a strict guard whose damping and verdicts come when they
come: force is only there for an enable that nothing took back.
"""

import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule
from support.gateway_rig import CommandServerRig, packed
from support.guard_stages import LEVEL_NS_PER_M, STIFF, Flight
from support.guard_stub import StubWorker, stage, verdict
from test_gateway_lifecycle import STRICT, bounded, scheduled

from hapticd.core.errors import MailboxError
from hapticd.core.units import NS_PER_MS
from hapticd.guard import terms
from hapticd.guard.status import MOST_RECORDS
from hapticd.mailbox.layout import State

CLIENTS = st.sampled_from([b"a", b"b"])
STAGES = [stage({"active_damping": 1.5}), stage({"K": 100.0}, at_least=1.5)]


class Lifecycle(RuleBasedStateMachine):
    """What the servo does, beside which enables are still valid."""

    def __init__(self) -> None:
        super().__init__()
        self.folder = tempfile.TemporaryDirectory(prefix="hapticd-")
        self.worker = StubWorker(
            lambda asked: {"action": "stage", "stages": STAGES, "verdict": verdict()}
        )
        self.rig = CommandServerRig(Path(self.folder.name), self.worker)
        self.rig.run(MOST_RECORDS)
        self.rig.ask(cmd="guard", policy="refuse")
        self.valid: set[bytes] = set()  # clients whose enable nothing has taken back
        self.was = State.DISABLED

    def teardown(self) -> None:
        self.folder.cleanup()

    @rule(client=CLIENTS)
    def enable(self, client: bytes) -> None:
        self.rig.send(packed(cmd="enable"), client=client)
        self.valid.add(client)

    @rule(client=CLIENTS, cmd=st.sampled_from(["disable", "stop", "reset", "zero"]))
    def take_back(self, client: bytes, cmd: str) -> None:
        self.rig.send(packed(cmd=cmd), client=client)
        refused = cmd in ("reset", "zero") and self.rig.servo.state is State.ENABLED
        if not refused:
            self.valid.clear()

    @rule(client=CLIENTS)
    def change(self, client: bytes) -> None:
        self.rig.send(packed(cmd="set", K=5, active_damping=1.5), client=client)

    @rule(client=CLIENTS)
    def leave(self, client: bytes) -> None:
        self.rig.server.leave(client)
        if self.rig.servo.state is not State.ENABLED:
            self.valid.discard(client)

    @rule(policy=st.sampled_from(["warn", "refuse", "clamp"]))
    def policy(self, policy: str) -> None:
        self.rig.send(packed(cmd="guard", policy=policy), client=b"operator")

    @rule(effect=st.sampled_from([0.0, 1.5]), silent=st.booleans())
    def outside(self, effect: float, silent: bool) -> None:
        self.rig.servo.effect = effect
        self.worker.silent = silent

    @precondition(lambda self: self.rig.servo.state is not State.ENABLED)
    @rule()
    def another_gateway(self) -> None:
        self.rig.run(3)  # what was posted is obeyed
        self.rig.start_gateway()
        if self.rig.servo.state is not State.ENABLED:
            self.valid.clear()

    @rule(ticks=st.integers(1, 30))
    def ticks(self, ticks: int) -> None:
        for _ in range(ticks):
            self.rig.run()

    @rule(ms=st.integers(1, 900))
    def stall(self, ms: int) -> None:
        self.rig.clock.time_ns += ms * NS_PER_MS
        self.rig.look()

    @invariant()
    def force_has_its_enable(self) -> None:
        state = self.rig.servo.state
        if state is State.ENABLED and self.was is not State.ENABLED:
            assert self.valid
        self.was = state


TestLifecycle = Lifecycle.TestCase
TestLifecycle.settings = settings(
    max_examples=60,
    stateful_step_count=30,
    deadline=None,
    derandomize=True,
    phases=(Phase.explicit, Phase.generate),
)


@pytest.fixture
def worker() -> StubWorker:
    return StubWorker()


@pytest.fixture
def rig(tmp_path: Path, worker: StubWorker) -> CommandServerRig:
    rig = CommandServerRig(tmp_path, worker)
    rig.run(MOST_RECORDS)
    return rig


def test_terms_that_could_not_be_kept_are_tried_again(
    rig: CommandServerRig, monkeypatch: pytest.MonkeyPatch
) -> None:
    def no_room(*_: object) -> None:
        raise MailboxError("no room")

    with monkeypatch.context() as patch:
        patch.setattr(terms, "write_terms", no_room)
        rig.ask(cmd="guard", policy="refuse")
        rig.run(2000)
    warnings = [one for one in rig.journal.recent if one["code"] == "terms_not_kept"]
    assert len(warnings) == 1
    rig.run(1100)
    rig.start_gateway()
    rig.run(5)
    assert rig.guard.policy == "refuse"


def test_client_numbers_go_on_with_the_next_gateway(rig: CommandServerRig) -> None:
    first = rig.ask(b"a", cmd="hello", name="a")["result"]["actor"]
    rig.start_gateway()
    rig.run(2)
    assert rig.ask(b"b", cmd="hello", name="b")["result"]["actor"] > first


@pytest.fixture
def flight() -> Iterator[Flight]:
    flight = Flight()
    yield flight
    flight.stack.close()


@pytest.mark.parametrize("policy", STRICT)
def test_bounded_level_of_active_damping_ends_at_its_tick(flight: Flight, policy: str) -> None:
    reply, begin = bounded(flight, policy, active_damping=LEVEL_NS_PER_M)
    assert reply["ok"]
    flight.worker.silent = True
    records = flight.fly(400)
    asked = records["active_damping_asked_ns_per_m"]
    assert asked[records["tick"] == begin + 1] > 1.7
    assert asked[records["tick"] == begin + 21] == 0.0


def test_unsafe_bounded_change_is_refused_and_schedules_nothing(flight: Flight) -> None:
    reply, _ = bounded(flight, "refuse", **STIFF)
    assert reply["error"]["code"] == "guard"
    records = flight.fly(200)
    assert not records["stiffness_n_per_m"].any()
    assert flight.stack.loop.state[0].plan.scheduled == ()


def test_bounded_change_for_whose_end_there_is_no_room_does_not_begin(flight: Flight) -> None:
    flight.ask(cmd="guard", policy="warn")
    tick = flight.view.tick
    for place in range(15):
        assert flight.ask(cmd="set", K=1.0 + place, at_tick=tick + 2000 + place)["ok"]
    begin = flight.view.tick + 50
    reply = flight.ask(cmd="set", K=50.0, ramp_s=0.0, at_tick=begin, until_tick=begin + 20)
    assert not reply["ok"]
    assert len(scheduled(flight)) == 15
    assert not flight.fly(200)["stiffness_n_per_m"].any()
