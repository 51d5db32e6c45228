"""Several changes in one call: checked as a whole, performed in order, with a receipt for each.

    with Client() as device:
        done = device.sequence([
            step("set", K=200, B=1),
            step("enable"),
            step("damping", value="on", after_s=1.0),
            step("set", K=400, ramp_s=0.2, after_s=0.5),
            step("disable", after_s=1.0),
        ])
        print([(one.tick, one.revision) for one in done])

A step acts at its tick, or `after_s` after the tick at which the previous step acted, or, without
either, as soon as that one has acted. `set` and `damping` are scheduled in the servo (`at_tick` of
the protocol), so they act exactly then, independent of this program and its computer. Each is sent
`lead_s` before its tick, so a script that dies leaves little behind. If the guard needs longer than
that, the step is refused, not performed late. The protocol times no other commands: `enable`,
`perturb` and the others are sent once their tick has come, about 10 ms late. Time is counted in the
servo's slots: after lost slots a step comes on time and its tick is correspondingly lower, as its
receipt shows.

All steps are checked before any is sent: fields, limits of this device, ticks in the past, and
states of the servo that forbid a step. A later refusal or cancellation by the servo, a state
changed by another client, or a silent daemon ends the sequence. SequenceError reports which steps
acted, which did not and why, and in which state the display was left.

Its requests are an `Exchange` of `commands`, which both clients carry out.

Sequences by clients of one name must not run at the same time: scheduled changes are identified by
name and number of their request. Take the lease of the environment.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Any, Literal

from hapticd.client.commands import POLL_S, Ask, Exchange, Pause, reply_or_raise
from hapticd.client.telemetry import receipt_of
from hapticd.core.errors import CommandError, DaemonDown, HapticdError, SequenceError
from hapticd.protocol.answers import GuardVerdict, Hello, Receipt, Status, answer_of

AtRefusal = Literal["disable", "stop", "hold"]

STEPS = ("set", "damping", "enable", "disable", "stop", "reset", "zero", "perturb")
TIMED = ("set", "damping")  # commands that the protocol schedules
LEAD_S = 0.5  # a step is sent this long before its tick, and judged by the guard
LONGEST_LEAD_S = 10.0
LOOK_S = 0.1  # between two polls of the servo while nothing is due
OPEN = ("scheduled", "staged")  # results of a step that is not complete
MOST_AHEAD = 8  # scheduled at once: half of a servo's capacity
OVERDUE_S = 10.0  # after its tick, until the result of a step counts as unknown
UNTOLD = "sent, and what became of it is not known; see `hapticd status`"
WHY = {  # reasons why a scheduled step did not act
    "cancelled": "a stop, a fault or the lease of another client came first",
    "superseded": "a later change for the same tick took its place",
}


@dataclass(frozen=True, slots=True)
class Step:
    """A command of the protocol with its fields, at a servo tick or a time after the
    previous step.
    """

    cmd: str
    fields: Mapping[str, Any]
    at_tick: int | None = None
    after_s: float | None = None

    def __str__(self) -> str:
        return " ".join((self.cmd, *(f"{name}={value}" for name, value in self.fields.items())))


def step(
    cmd: str, *, at_tick: int | None = None, after_s: float | None = None, **fields: Any
) -> Step:
    """Return a step of a sequence: `cmd` is one of STEPS, `fields` are those of the protocol, like
    `K`, `ramp_s`, `value` (damping) or `action` (perturb).

    It acts at `at_tick` of the servo, or `after_s` [s] after the previous step acted.
    """
    return Step(cmd, fields, at_tick, after_s)


@dataclass(frozen=True, slots=True)
class StepReceipt:
    """Result of a step."""

    step: Step
    #: "applied"; "pressed": a stop without a receipt; "refused", "cancelled", "superseded";
    #: "scheduled" or "staged" until complete; "unknown": no answer; "not sent"
    result: str = "not sent"
    tick: int = 0  #: first servo tick of the change; 0 if it did not act
    revision: int = 0  #: resulting revision, by which telemetry is joined
    text: str = ""  #: reason why it did not act
    guard: GuardVerdict | None = None  #: verdict on it

    @property
    def acted(self) -> bool:
        """Whether the servo performed it."""
        return self.result in ("applied", "pressed")


Part = Exchange[Any]


class _EndedError(Exception):
    """The sequence ends: `cause` is the reason, `number` the step."""

    def __init__(self, cause: HapticdError, number: int) -> None:
        super().__init__(str(cause))
        self.cause = cause
        self.number = number


def exchange(
    steps: Sequence[Step], at_refusal: AtRefusal, name: str, lead_s: float | None = None
) -> Exchange[tuple[StepReceipt, ...]]:
    """Yield the requests and pauses of a sequence, for the client `name`; return a receipt for each
    step.

    CommandError if a step is impossible (nothing is sent); SequenceError if it ended early.
    """
    if lead_s is None:
        lead_s = LEAD_S
    if not 0.0 < lead_s <= LONGEST_LEAD_S:  # neither is nan
        limit = f"outside 0..{LONGEST_LEAD_S:g} s; leave it out for {LEAD_S:g} s"
        raise CommandError("invalid", f"lead_s = {lead_s}: {limit}")
    hello = answer_of(Hello, reply_or_raise((yield Ask("hello", {"name": name})))["result"])
    status = answer_of(Status, reply_or_raise((yield Ask("status")))["result"])
    if not status.servo_alive:
        raise DaemonDown("no servo answers; start it with `hapticd run`, see `hapticd status`")
    _check(steps, hello, status)
    return (yield from _Run(steps, at_refusal, name, status, lead_s).whole())


class _Run:
    """A running sequence."""

    def __init__(
        self,
        steps: Sequence[Step],
        at_refusal: AtRefusal,
        name: str,
        status: Status,
        lead_s: float,
    ) -> None:
        self._steps = steps
        self._at_refusal = at_refusal
        self._name = name
        self._lead_s = lead_s
        self._status = status
        self._rate_hz = status.rate_hz
        self._state = status.state  # state of the servo after the steps so far
        self._receipts = [StepReceipt(one) for one in steps]
        self._open: dict[
            int | str | None, int
        ] = {}  # steps that were scheduled, by number of their request
        self._left = ""  # final action on the display, in words

    def whole(self) -> Exchange[tuple[StepReceipt, ...]]:
        """Perform all steps; SequenceError as soon as one fails."""
        try:
            last_slot = self._status.slot
            for number, one in enumerate(self._steps):
                last_slot = yield from self._step(number, one, last_slot)
            yield from self._settled(len(self._steps) - 1)
        except _EndedError as ended:
            yield from self._leave(ended)
            raise self._error(ended) from ended.cause
        return tuple(self._receipts)

    def _step(self, number: int, one: Step, last_slot: int) -> Part:
        """Perform one step; return the slot from which it acts or will act."""
        due = one.at_tick + self._lost if one.at_tick else 0
        if one.after_s:
            due = last_slot + _ticks(one, self._rate_hz)
        fields = dict(one.fields)
        if due and one.cmd in TIMED:
            yield from self._until(due - round(self._lead_s * self._rate_hz), number)
            fields["at_tick"] = due - self._lost
        else:
            yield from self._settled(number)
            yield from self._until(due, number)
        answer = yield Ask(one.cmd, fields)
        self._take(number, answer)
        if self._receipts[number].result == "staged":
            yield from self._settled(number)
        if number in self._open.values():
            return due
        return (self._receipts[number].tick or self._status.tick) + self._lost

    def _take(self, number: int, answer: Any) -> None:
        """Record the reply to step `number`, or its error."""
        if isinstance(answer, HapticdError):
            known = isinstance(answer, CommandError) and answer.code != "timeout"
            guard = answer.guard if isinstance(answer, CommandError) else None
            result, text = ("refused", str(answer)) if known else ("unknown", UNTOLD)
            self._note(number, result, text=text, guard=guard)
            raise _EndedError(answer, number)
        receipt = answer if isinstance(answer, Receipt) else receipt_of(answer)
        self._note_done(number, receipt)
        if receipt.result in OPEN:
            self._open[answer["id"]] = number
        elif receipt.state:
            self._state = receipt.state

    def _note(self, number: int, result: str, **more: Any) -> None:
        """Record the result of step `number`."""
        self._receipts[number] = StepReceipt(self._steps[number], result, **more)

    def _note_done(self, number: int, receipt: Receipt) -> None:
        place = {"tick": receipt.first_tick, "revision": receipt.revision}
        self._note(number, receipt.result, **place, guard=receipt.guard)

    @property
    def _lost(self) -> int:
        """Slots that the servo lost so far: slot - tick."""
        return self._status.slot - self._status.tick

    def _until(self, slot: int, number: int) -> Part:
        """Wait until the servo is at `slot` and accepts another scheduled change."""
        while True:
            yield from self._look(number)
            full = len(self._open) >= MOST_AHEAD
            free = min(self._receipts[one].tick for one in self._open.values()) if full else 0
            left = max(slot, free + self._lost) - self._status.slot
            if left <= 0 and not full:
                return
            yield Pause(min(LOOK_S, max(POLL_S, left / self._rate_hz)))

    def _settled(self, number: int) -> Part:
        """Wait until the result of every step so far is known."""
        began = self._status.tick
        while self._open:
            yield from self._look(number)
            last = max([began, *(self._receipts[one].tick for one in self._open.values())])
            left_s = (last - self._status.tick) / self._rate_hz
            if self._open and left_s < -OVERDUE_S:
                raise _EndedError(CommandError("timeout", UNTOLD), min(self._open.values()))
            if self._open:
                yield Pause(min(LOOK_S, max(POLL_S, left_s)))

    def _look(self, number: int) -> Part:
        """Update the state of the servo and the results of scheduled steps."""
        answer = yield Ask("status")
        if isinstance(answer, HapticdError):
            raise _EndedError(answer, number)
        before = self._status
        self._status = answer_of(Status, answer["result"])
        led_to = {_after(self._steps[one], self._state) for one in self._open.values()}
        self._hear()
        found = self._status.state
        if not self._status.servo_alive or self._status.epoch != before.epoch:
            raise _EndedError(DaemonDown("the servo ended, or was restarted"), number)
        if found not in {self._state, *led_to}:
            why = self._status.cause or "see `hapticd status`"
            reason = f"the servo is {found!r} and not {self._state!r}: {why}"
            raise _EndedError(CommandError("stopped", reason), number)
        self._state = found
        for at, one in enumerate(self._receipts):
            if one.result not in (*OPEN, "applied", "pressed", "not sent"):
                raise _EndedError(CommandError("refused", one.text), at)

    def _hear(self) -> None:
        """Read later answers to open steps from the events kept by the gateway."""
        for event in self._status.events:
            mine = event.kind == "answer" and event.name == self._name
            number = self._open.get(event.id) if mine else None
            if number is None or event.cmd != self._steps[number].cmd:
                continue
            result = event.result
            if result not in OPEN:  # otherwise it waited for the guard, and is now scheduled
                del self._open[event.id]
            if result in (*OPEN, "applied"):
                self._note_done(number, event)
            else:
                self._note(number, result, text=event.text or WHY.get(result, result))

    def _leave(self, ended: _EndedError) -> Part:
        """Leave the display as requested, and update the results of scheduled steps."""
        way = "stop" if isinstance(ended.cause, DaemonDown) else self._at_refusal
        self._left = "the display was not changed"
        if self._at_refusal != "hold":
            answer = yield Ask(way)
            failed = isinstance(answer, HapticdError)
            self._left = f"{way} failed ({answer})" if failed else f"{way} was asked for"
        for _ in range(round((self._lead_s + LOOK_S) / LOOK_S) + 1):
            answer = yield Ask("status")
            if isinstance(answer, HapticdError):
                self._state = "unknown"
                return
            self._status = answer_of(Status, answer["result"])
            self._state = self._status.state
            self._hear()
            if not self._open:
                return
            yield Pause(LOOK_S)

    def _error(self, ended: _EndedError) -> SequenceError:
        for number in self._open.values():
            self._note(number, "unknown", text=UNTOLD)
        acted = [at + 1 for at, one in enumerate(self._receipts) if one.acted]
        unknown = [at + 1 for at, one in enumerate(self._receipts) if one.result == "unknown"]
        others = sorted({*range(1, len(self._steps) + 1)} - {*acted} - {*unknown})
        parts = (("acted", acted), ("did not act", others), ("open", unknown))
        summary = ", ".join(
            f"{words}: {', '.join(map(str, some))}" for words, some in parts if some
        )
        where = f"step {ended.number + 1} of {len(self._steps)} ({self._steps[ended.number]})"
        code = ended.cause.code if isinstance(ended.cause, CommandError) else "servo_down"
        return SequenceError(
            code,
            f"{where}: {ended.cause}; steps that {summary}; {self._left}, the servo is"
            f" {self._state!r}",
            tuple(self._receipts),
            self._state,
        )


def _check(steps: Sequence[Step], hello: Hello, status: Status) -> None:
    """Raise CommandError `invalid` with a line for each impossible step, before
    anything is sent.
    """
    from hapticd.protocol.limits import CommandLimits

    limits = CommandLimits.announced(hello.servo)
    state = status.state
    tick = status.tick
    rate_hz = status.rate_hz
    detail = []
    for number, one in enumerate(steps, start=1):
        faults = [_unlike(one, limits), _mistimed(one, tick), _barred(one, state)]
        detail += [{"loc": f"step {number}", "msg": text} for text in faults if text]
        state = _after(one, state)
        tick = max(tick, one.at_tick or 0) + (0 if any(faults) else _ticks(one, rate_hz))
    if detail:
        lines = "; ".join(f"{item['loc']}: {item['msg']}" for item in detail)
        raise CommandError("invalid", f"nothing was sent: {lines}", detail)


def _ticks(one: Step, rate_hz: float) -> int:
    """Return the delay after the previous step, in ticks."""
    return round((one.after_s or 0.0) * rate_hz)


def _unlike(one: Step, limits: Any) -> str:
    """Return the error in its command and fields."""
    from hapticd.protocol.schemas import parse

    if one.cmd not in STEPS:
        return f"{one.cmd!r} is not a step of a sequence; the steps are: {', '.join(STEPS)}"
    if one.cmd == "perturb" and one.fields.get("action") == "load":
        return "a waveform is loaded before the sequence, with `perturb_load`"
    try:
        parse({"cmd": one.cmd, **one.fields}, limits)
    except CommandError as error:
        return str(error)
    return ""


def _mistimed(one: Step, tick: int) -> str:
    """Return the error in its time, with the previous steps complete by `tick`."""
    if one.at_tick is not None and one.after_s is not None:
        return "at_tick and after_s: a step has one time; leave one of them out"
    if one.at_tick is not None and one.at_tick <= tick:
        return (
            f"at_tick = {one.at_tick}: that tick, or the step before it, comes at {tick} or later"
        )
    if one.after_s is not None and not (isfinite(one.after_s) and one.after_s >= 0.0):
        return f"after_s = {one.after_s}: a time in seconds, 0 or more"
    return ""


def _barred(one: Step, state: str) -> str:
    """Return the reason why a servo in that state would refuse it."""
    from hapticd.protocol.commands import ALLOWED

    allowed = [each.name.lower() for each in ALLOWED.get(one.cmd, ())]
    if not allowed or state in allowed or one.fields.get("action") == "stop":
        return ""
    return f"{one} needs {' or '.join(allowed)}, and by then the servo is {state}"


def _after(one: Step, state: str) -> str:
    """Return the state that follows it in a servo in `state`."""
    latched = state in ("stopped", "fault")
    after = {"enable": "enabled", "reset": "disabled"}
    if one.cmd == "stop":
        return "fault" if state == "fault" else "stopped"
    return "disabled" if one.cmd == "disable" and not latched else after.get(one.cmd, state)
