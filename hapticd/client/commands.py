"""The commands of the synchronous client and of that for asyncio, each written once.

A command is an `Exchange`: a generator that yields due actions (`Ask` for a request, `Pause`) and
receives the reply, or the error of the request. The clients carry it out. The result type of a
command, a value or an awaitable, depends on the client: `Commands[Receipt, Hello, ...]` or
`Commands[Awaitable[Receipt], Awaitable[Hello], ...]`.

An exchange must not itself read a socket or sleep.
"""

import time
from collections.abc import Generator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, Literal, NamedTuple, TypeVar

from hapticd.client.formatting import GuardWarnings
from hapticd.client.telemetry import not_reached, receipt_of
from hapticd.core.errors import DaemonDown, HapticdError, SequenceError
from hapticd.mailbox.daemons import daemon_folder
from hapticd.mailbox.files import DEFAULT_INSTANCE
from hapticd.protocol.answers import (
    Coupling,
    Event,
    Get,
    GuardStatus,
    GuardVerdict,
    Hello,
    Receipt,
    Status,
    answer_of,
)

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from hapticd.client.law import Law
    from hapticd.client.sequence import AtRefusal, Step, StepReceipt
    from hapticd.core.params import BasisName, DampingMode, Policy

__all__ = ["Ask"]


# result types, immediate or awaitable
R = TypeVar("R")  # of a change: a Receipt
H = TypeVar("H")  # a Hello
P = TypeVar("P")  # a Get
S = TypeVar("S")  # a Status
G = TypeVar("G")  # a GuardStatus
D = TypeVar("D")  # of other questions: a map
C = TypeVar("C")  # a Coupling

POLL_S = 0.02  # between two polls of the state
JUDGED = frozenset({"set", "damping", "enable", "guard"})  # commands that the guard may refuse
T = TypeVar("T")
Answer = dict[str, Any]


class Ask(NamedTuple):
    """A request to carry out; the exchange receives its reply, or its error."""

    cmd: str
    fields: Mapping[str, Any] = {}


class Pause(NamedTuple):
    """Time to wait."""

    seconds: float


Exchange = Generator[Ask | Pause, Any, T]  # due actions, answers, result


def reply_or_raise(answer: Any) -> Any:
    """Return the reply in `answer`, or raise the error of its request."""
    if isinstance(answer, HapticdError):
        raise answer
    return answer


class Commands(Generic[R, H, P, S, G, D, C]):
    """Questions and changes. CommandError if the daemon refuses, DaemonDown without an answer in
    time.
    """

    def __init__(
        self,
        instance: str = DEFAULT_INSTANCE,
        timeout_s: float = 2.0,
        name: str = "script",
        folder: Path | None = None,
        strict: bool = False,
    ) -> None:
        self._folder = folder or daemon_folder(instance)
        self._timeout_s = timeout_s
        self._name = name
        self._strict = strict
        self._warnings = GuardWarnings()
        self._connect()

    def _connect(self) -> None:
        """Connect to the daemon."""
        raise NotImplementedError

    def _as_asked(self, cmd: str, fields: dict[str, Any]) -> dict[str, Any]:
        """Return the fields of a request, with that of a strict client."""
        return {**fields, "strict": True} if self._strict and cmd in JUDGED else fields

    def _carried_out(self, exchange: Exchange[Any]) -> Any:
        """Carry out `exchange` and return its result."""
        raise NotImplementedError

    def _question(self, kind: type[Any], cmd: str, fields: Answer) -> Exchange[Any]:
        """Return the answer to a question, as a dataclass `kind` of `protocol.answers`
        or as a map.
        """
        reply = reply_or_raise((yield Ask(cmd, fields)))
        if "receipt" in reply:  # a mode of the guard changes the damping
            self._warnings.tell(receipt_of(reply))
        return reply["result"] if kind is dict else answer_of(kind, reply["result"])

    def _changing(self, cmd: str, fields: Answer) -> Exchange[Receipt]:
        receipt = receipt_of(reply_or_raise((yield Ask(cmd, fields))))
        self._warnings.tell(receipt)
        return receipt

    def _answer(self, kind: type[Any], cmd: str, **fields: Any) -> Any:
        return self._carried_out(self._question(kind, cmd, fields))

    def _result(self, cmd: str, **fields: Any) -> D:
        result: D = self._answer(dict, cmd, **fields)
        return result

    def _change(self, cmd: str, **fields: Any) -> R:
        receipt: R = self._carried_out(self._changing(cmd, fields))
        return receipt

    def _sequence(
        self, steps: "Sequence[Step]", at_refusal: "AtRefusal", lead_s: float | None
    ) -> "Exchange[tuple[StepReceipt, ...]]":
        """Run a sequence, and emit each `GuardWarning` at its end."""
        from hapticd.client.sequence import exchange

        try:
            done = yield from exchange(steps, at_refusal, self._name, lead_s)
        except SequenceError as error:
            self._warnings.tell_beside(error.receipts)
            raise
        self._warnings.tell(*done)
        return done

    # --- asking -----------------------------------------------------------------------------------

    def hello(self) -> H:
        """Return versions, limits, endpoints and topics of the daemon; each limit has its unit.

        >>> device.hello().limits["active_damping"]
        Limit(low=0.0, high=10.0, unit='N s/m')
        """
        hello: H = self._answer(Hello, "hello", name=self._name)
        return hello

    def get(self) -> P:
        """Return the requested values, with ramps at their ends, and the values in force at this
        tick.

        >>> device.get().in_force.stiffness_n_per_m
        0.0
        """
        found: P = self._answer(Get, "get")
        return found

    def status(self) -> S:
        """Return state, fault, counters, stage times, granted rights and the last events of the
        servo.

        >>> status = device.status()
        >>> status.state, status.rate_hz, status.fault
        ('disabled', 1000.0, 'none')
        """
        status: S = self._answer(Status, "status")
        return status

    def schema(self) -> D:
        """Return the protocol as JSON schema, with units and the limits of this device.

        >>> sorted(device.schema())[:2]
        ['$defs', 'discriminator']
        """
        return self._result("schema")

    # --- changing ---------------------------------------------------------------------------------

    def set(
        self,
        *,
        K: float | None = None,
        B: float | None = None,
        M: float | None = None,
        filters: dict[str, float] | None = None,
        wall: dict[str, float] | None = None,
        active_damping: float | None = None,
        ramp_s: float | None = None,
        at_tick: int | None = None,
        until_tick: int | None = None,
        if_rev: int | None = None,
        limit_cycle_faults: bool | None = None,
        **further: float,
    ) -> R:
        """Change the rendered environment; omitted values keep their value.

        `K` virtual stiffness [N/m], `B` virtual damping [N s/m], `M` virtual mass [kg],
        `active_damping` [N s/m]; `filters` and `wall` have the keys of `hapticd set`. `ramp_s` is
        the length of the ramp [s], `at_tick` the first servo tick of the change. From `until_tick`
        on the same fields have their earlier values again. With `if_rev` the change is refused
        unless the revision is still that one. `limit_cycle_faults`: whether force_at_limit and
        energy end a limit cycle; they are re-enabled when force is switched off. `further`:
        parameters added to the environment (`hapticd.core.environment`), by their keys.

        >>> receipt = device.set(K=100, B=1, ramp_s=0.2)
        >>> receipt.effective["K"], receipt.ramp_end_tick - receipt.first_tick
        (100.0, 200)
        >>> receipt.guard.safe
        True
        """
        return self._change(
            "set",
            K=K,
            B=B,
            M=M,
            filters=filters,
            wall=wall,
            active_damping=active_damping,
            ramp_s=ramp_s,
            at_tick=at_tick,
            until_tick=until_tick,
            if_rev=if_rev,
            limit_cycle_faults=limit_cycle_faults,
            **further,
        )

    def damping(self, value: Literal["on", "off", "auto"] | float) -> R:
        """Switch the active damping, set its level [N s/m] and switch it on, or let the guard
        choose the minimum sufficient level.

        >>> device.damping(0.5).effective["active_damping"]
        0.500...
        """
        return self._change("damping", value=value)

    def guard(
        self,
        policy: "Policy | None" = None,
        *,
        basis: "BasisName | None" = None,
        margin_ns_per_m: float | None = None,
        mode: "DampingMode | None" = None,
    ) -> G:
        """Change the guard's response to environments that are not known to be passive, or only
        query it. `margin_ns_per_m` is the required margin of damping [N s/m], `mode` the mode of
        the active damping.

        `margin_ns_per_m` is the damping that has to be left [N s/m], `mode` that of the active
        damping.

        >>> device.guard("refuse", margin_ns_per_m=0.1).policy
        'refuse'
        """
        fields = {"policy": policy, "basis": basis, "margin_ns_per_m": margin_ns_per_m}
        guard: G = self._answer(GuardStatus, "guard", **fields, mode=mode)
        return guard

    def enable(self) -> R:
        """Switch force on, with a gain ramp (`enable_ramp_s` of the configuration).

        CommandError `stopped` after a stop or a fault, until `reset`.

        >>> device.enable().state
        'enabled'
        """
        return self._change("enable")

    def disable(self) -> R:
        """Switch force off. The active damping keeps its setting.

        >>> device.disable().state
        'disabled'
        """
        return self._change("disable")

    def reset(self) -> R:
        """Go from `stopped` or `fault` to `disabled`. CommandError while a cause persists.

        >>> receipt = device.stop()
        >>> device.reset().state
        'disabled'
        """
        return self._change("reset")

    def zero(self) -> R:
        """Set the present position as x = 0; only in `disabled`.

        >>> receipt = device.zero()
        >>> device.record(0.01)[0]["position_m"][-1]
        np.float64(0.0)
        """
        return self._change("zero")

    def home(self) -> R:
        """Start to search for the origin; only in `disabled`, to which it returns afterwards.

        CommandError if the device file has no homing method.

        >>> device.home()
        Traceback (most recent call last):
        CommandError: home: the device file names no way to home; set `method` in its table [home]
        """
        return self._change("home")

    def withhold(self, seconds: float) -> R:
        """Send no frames to the board for `seconds`, at most 1 s, so that its watchdog trips; only
        in `disabled`.

        >>> device.withhold(0.1).result
        'applied'
        """
        return self._change("withhold", seconds=seconds)

    def perturb_start(self, loop: bool = False) -> R:
        """Play the loaded waveform, once or until stopped.

        CommandError without a loaded waveform, or if the servo is not enabled.

        >>> device.perturb_load([0.1, -0.1] * 200)
        400
        >>> device.enable().state, device.perturb_start(loop=True).result
        ('enabled', 'applied')
        """
        return self._change("perturb", action="start", loop=loop)

    def perturb_stop(self) -> R:
        """Stop the waveform.

        >>> device.perturb_stop().result
        'applied'
        """
        return self._change("perturb", action="stop")

    def proxy(self, position_m: float | None = None) -> C:
        """Move the anchor of the virtual spring to `position_m` [m]; return handle and proxy.

        It moves at limited speed, range and energy, while the lease of the environment is held in
        state `enabled`, and stays when no new position follows. Without a position: only read.

        >>> device.proxy().proxy_m
        0.0
        """
        found: C = self._answer(Coupling, "proxy", position_m=position_m)
        return found

    def follow_law(self, law: "Law", rate_hz: float = 500.0, duration_s: float | None = None) -> C:
        """Let `law` move the proxy, `rate_hz` times a second; return the last `Coupling`.

        `law` gets a `Coupling` and returns the next position of the proxy [m], or None to end. It
        ends after `duration_s` on the servo's clock, or never. CommandError `invalid` for a rate
        that is not above 0, and CommandError if the lease or the force ends. After its lease the
        proxy stays where it is.

        >>> with device.lease("environment"):
        ...     device.follow_law(lambda felt: 0.0, duration_s=0.1).proxy_m
        Traceback (most recent call last):
        CommandError: proxy in state disabled: possible only in enabled
        """
        from hapticd.client.law import followed

        found: C = self._carried_out(followed(law, rate_hz, duration_s, self._now_s))
        return found

    def _now_s(self) -> float:
        """Return the time of the clock by which pauses pass."""
        return time.monotonic()

    def dump(self) -> D:
        """Write the flight recording and return {path, records, reason}.

        The file appears, complete, soon after this returns.

        >>> device.dump()["reason"]
        'asked'
        """
        return self._result("dump")

    def mark(self, text: str) -> D:
        """Record `text`, at most 96 characters, with the newest tick: an event `mark`, which
        recordings keep. Return {tick}.

        >>> device.mark("participant 7 ready")
        {'tick': ...}
        """
        return self._result("mark", text=text)


def hand_event(verdict: GuardVerdict, timeout_s: float) -> Exchange[Event | None]:
    """Return the event `guard` that describes the hand for which the change of `verdict` is
    unstable; None if `timeout_s` passes first.
    """
    deadline = time.monotonic() + timeout_s
    while time.monotonic() < deadline:
        status = answer_of(Status, reply_or_raise((yield Ask("status")))["result"])
        for event in reversed(status.events):
            if event.kind == "guard" and event.number == verdict.number:
                return event
        yield Pause(POLL_S)
    return None


def loaded(samples_n: "ArrayLike") -> Exchange[int]:
    """Load a waveform and return the number of samples in the daemon."""
    from hapticd.client.blocks import chunks

    count: int = 0
    for chunk in chunks(samples_n):
        count = reply_or_raise((yield Ask("perturb", chunk)))["result"]["samples"]
    return count


def reached(state: str, timeout_s: float) -> Exchange[None]:
    """Wait until the servo is in `state`. CommandError `timeout` or DaemonDown after
    `timeout_s`.
    """
    deadline = time.monotonic() + timeout_s
    while True:
        answer = yield Ask("get")
        late = time.monotonic() >= deadline
        # a daemon that is starting does not answer yet
        down = isinstance(answer, DaemonDown) and not late
        found = "down" if down else reply_or_raise(answer)["state"]
        if found == state:
            return
        if late:
            raise not_reached(state, found, timeout_s)
        yield Pause(POLL_S)
