"""Random requests of two clients under a strict guard whose damping and verdicts come when they
come: force is only there for an enable that nothing took back.
"""

import tempfile
from pathlib import Path

from hypothesis import Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule
from support.gateway_rig import CommandServerRig, packed
from support.guard_stub import StubWorker, stage, verdict

from hapticd.core.units import NS_PER_MS
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
