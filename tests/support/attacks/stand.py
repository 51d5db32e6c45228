"""A servo, its simulated board and the command server on virtual time, judged at the board's motor.

The handle is so heavy that it stays in place, and PUSH is a wall around it. Any event that enables
force, an enable or a change of the environment, makes force at once. One criterion therefore
decides every attack on the life of a request: whether the simulated motor pushed. Replies and
records of the servo are not used.

Limitations: lives longer than about 5 s, in which the wall pushes the handle out of itself.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple, Self

from hapticd.core.params import GuardParams, SafetyParams
from hapticd.core.units import NS_PER_MS
from hapticd.gateway.command_server import CommandServer
from hapticd.guard.status import MOST_RECORDS, Guard
from hapticd.mailbox.client_side import GatewayMailbox
from hapticd.model.params import InjectionParams
from hapticd.protocol.journal import Journal
from hapticd.protocol.view import ServoView
from hapticd.run.lockstep import LockStep
from support.boards import board_params
from support.gateway_rig import UNIX_NS, decoded, packed
from support.guard_stub import StubWorker
from support.models import servo_params

NOTHING = "no attack"  # the control: force must act
ANSWERS = "worker answers"
SILENT = "worker silent"
WORKER = (ANSWERS, SILENT)
STRICT = ("clamp", "refuse", "follow")
LONG = 150  # ticks within which all that may follow has followed
Chosen = Mapping[str, str]  # the value that an attack drew for each of its features
HANDLE_KG = 400.0
PUSH = {"stiffness_n_per_m": 25.0, "virtual_damping_ns_per_m": 0.0, "position_m": 0.02, "side": -1}
PUSHES_N = 0.1  # of the 0.5 N that PUSH comes to
RAMP_TICKS = 40  # after which an enable has the whole force
SERVO = servo_params(safety=SafetyParams(enable_ramp_s=0.02, limit_cycle_faults=False))


class Moment(NamedTuple):
    """The board after a tick."""

    tick: int
    force_n: float
    active_damping_ns_per_m: float
    probe_n: float
    live: bool  # it grants torque

    @property
    def pushes(self) -> bool:
        """Whether the motor has force."""
        return abs(self.force_n) > PUSHES_N


class SlowWorker(StubWorker):
    """A worker that keeps its answers back while they are `held`."""

    held = False

    def answers(self) -> list[dict[str, Any]]:
        return [] if self.held else super().answers()


class Stand:
    """Use as a context manager. `ask` plays a client that waits for its reply."""

    def __init__(self, *injections: InjectionParams, policy: str = "warn") -> None:
        board = board_params(mass_kg=HANDLE_KG, injections=injections)
        self.stack = LockStep(SERVO, board, keep=False)
        port: Any = self.stack.backend._port  # type: ignore[attr-defined]
        self.axis = getattr(port, "board", port)._axis
        self.worker = SlowWorker()
        self.moments: list[Moment] = []
        self.another_gateway(policy)
        self.fly(5)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.stack.close()

    def another_gateway(self, policy: str) -> None:
        """Replace the command server by a new one with the configured `policy`."""
        self.replies: list[dict[str, Any]] = []
        folder = Path(self.stack.mailbox.folder)
        self.view = ServoView(folder, SERVO, lambda: UNIX_NS)
        journal = Journal(lambda: UNIX_NS)
        self.guard = Guard(self.view, journal, GuardParams(policy=policy), self.worker)
        self.server = CommandServer(self.view, journal, lambda cmd: {}, self.guard)
        self.look()

    @property
    def mailbox(self) -> GatewayMailbox:
        """The mailbox that the command server writes to."""
        assert self.view.mailbox is not None
        return self.view.mailbox

    @property
    def tick(self) -> int:
        """The servo's next one."""
        return self.stack.loop.tick

    # --- time -------------------------------------------------------------------------------------

    def settle(self) -> None:
        """Run as many ticks as a strict policy needs to judge."""
        self.stack.run(MOST_RECORDS)
        self.look()

    def fly(self, ticks: int, every: int = 1) -> list[Moment]:
        """Ticks, a pass of the gateway after `every` few of them; the board after each."""
        begin = len(self.moments)
        for number in range(1, ticks + 1):
            tick = self.tick
            self.stack.run(1)
            axis = self.axis
            seen = axis.force_n, axis.damping_n, axis.probe.torque_n, axis.live
            self.moments.append(Moment(tick, *seen))
            if number % every == 0:
                self.look()
        return self.moments[begin:]

    def look(self) -> None:
        """A pass of the gateway, without a tick."""
        now_ns = self.stack.clock.now_ns()
        self.view.refresh(now_ns)
        self.replies += [decoded(reply) for reply in self.server.collect(now_ns)]

    def pause(self, ms: int) -> None:
        """Stop all processes for `ms`."""
        self.stack.clock.time_ns += ms * NS_PER_MS

    # --- clients ----------------------------------------------------------------------------------

    def send(self, *requests: dict[str, Any], client: bytes = b"a", **serve: Any) -> None:
        """Requests that come together, not waited for."""
        messages = [[client, packed(**one)] for one in requests]
        found = self.server.serve(messages, self.stack.clock.now_ns(), **serve)
        self.replies += [decoded(reply) for reply in found]

    def ask(self, client: bytes = b"a", **fields: Any) -> dict[str, Any]:
        """One request and its reply."""
        self.replies = []
        self.send(fields, client=client)
        for _ in range(1200):
            if self.replies:
                return self.replies.pop(0)
            self.fly(1)
        raise AssertionError(f"no reply to {fields}")

    def done(self, client: bytes = b"a", **fields: Any) -> dict[str, Any]:
        """`ask`, with AssertionError if the request is refused."""
        reply = self.ask(client, **fields)
        assert reply["ok"], f"{fields} was refused: {reply['error']['message']}"
        return reply

    def enabled(self) -> None:
        """Enable the force, with a free environment."""
        self.done(cmd="enable")
        self.fly(RAMP_TICKS)

    def push_in_force(self) -> None:
        """An environment that pushes as soon as it is enabled."""
        self.done(cmd="set", wall=PUSH, ramp_s=0.0)

    def push(self, at_tick: int = 0, **more: Any) -> dict[str, Any]:
        """The request for a push, at once or at its tick."""
        timed = {"at_tick": at_tick} if at_tick else {}
        return {"cmd": "set", "wall": PUSH, "ramp_s": 0.0, **timed, **more}

    # --- verdicts ---------------------------------------------------------------------------------

    def judge(self, ticks: int, control: bool = False, every: int = 1) -> None:
        """AssertionError if the motor pushes in the next ticks. As a `control`: if it does not
        push, because then the attack tests nothing.
        """
        judged(self.fly(ticks, every), control)


def judged(moments: list[Moment], control: bool = False) -> None:
    """As `Stand.judge`, for recorded moments."""
    pushed = [one for one in moments if one.pushes]
    if control:
        assert pushed, "no force without the attack: it attacks nothing"
        return
    text = f"{pushed[0].force_n:.3g} N in tick {pushed[0].tick}" if pushed else ""
    assert not pushed, f"force came: {text}"
