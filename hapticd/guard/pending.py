"""Changes on their way: requests that the guard handles, posted commands, scheduled changes.

Requests (`PendingChange`). `request_queue` keeps one for each request, with the stages into which
the worker divides it. The worker is another process, so its answer is checked before it is used.

Posted commands (`Outstanding`). They are kept until they are answered and in force, and identified
by servo life and sequence number; scheduled ones wait for their second answer. The command server
and the guard post through this class, so it knows all outstanding commands.

Scheduled changes (`ScheduledChanges`). The servo holds them for later ticks; a new change is judged
together with them. A bounded change counts as two: the requested values, and their restoration at
its end. The end has the negative number of the command. A change must not be kept after its servo
has ended: every later verdict would count it.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from hapticd.core.environment import Environment
from hapticd.core.errors import CommandError
from hapticd.core.units import NS_PER_S
from hapticd.guard.transition_planner import Stage
from hapticd.mailbox.client_side import Answer, GatewayMailbox
from hapticd.mailbox.layout import ANY_TERMS, RING_SLOTS, Command, Result, State
from hapticd.protocol.codec import RequestMessage
from hapticd.protocol.commands import Posting, forbidden
from hapticd.protocol.journal import GATEWAY_ACTOR, EventCode, Explanation, Outcome, Reason, Remedy
from hapticd.protocol.leases import ENVIRONMENT, Leases
from hapticd.protocol.schemas import Enable, Judged, Request, Set
from hapticd.protocol.view import ServoView

__all__ = ["Outstanding", "Pending", "PendingChange", "ends_force"]

# --- requests -------------------------------------------------------------------------------------


@dataclass(slots=True, eq=False)
class PendingChange:
    """One request and its progress."""

    message: RequestMessage
    actor: int
    request: Request
    life: int  # of the servo it is for
    came_ns: int
    at_tick: int = 0
    replied: bool = False
    tries: int = 0
    # --- since the question was asked
    number: int = 0  # of the question, 0: not asked
    ready_ns: int = 0  # time from which it could be asked, 0: not yet
    terms_changes: int = 0  # at that time
    terms: int = ANY_TERMS  # number of the terms of the judgement
    policy: str = "off"
    revision: int | None = None  # of the judged environment
    answer: dict[str, Any] | None = None
    ahead: int = 0  # scheduled changes that take effect first
    verdict: dict[str, Any] = field(default_factory=dict)
    stages: tuple[Stage, ...] = ()
    place: int = 0  # of the next stage
    state: State | None = None  # at its start
    ramp_end_tick: int = 0
    seen: int = 0  # revision of the servo when the wait began, or when the last stage acted
    since_ns: int = 0  # time at which the last stage was posted, or something moved
    # why no further stage follows the one that the servo has, and the fields of that event
    taken_back: tuple[EventCode, dict[str, Any]] | None = None
    former: dict[str, Any] = field(default_factory=dict)  # values restored by a bounded change
    held: Answer | None = None  # of the servo, kept until the verdict arrives

    @property
    def cmd(self) -> str:
        """The requested command."""
        return self.message.cmd

    @property
    def own(self) -> bool:
        """Whether the guard itself made the request: mode auto."""
        return self.actor == GATEWAY_ACTOR

    @property
    def enables(self) -> bool:
        """Whether the request enables force."""
        return isinstance(self.request, Enable)

    @property
    def strict(self) -> bool:
        """Whether its client requests judgement under `refuse`, the strictest policy."""
        return isinstance(self.request, Judged) and self.request.strict

    def refused(self, why: Explanation) -> CommandError:
        """Return its refusal without a verdict."""
        verdict = self.verdict | why.plain(Outcome.REFUSED) | {"cmd": self.cmd}
        return CommandError("guard", f"{self.cmd}: {verdict['text']}", guard=verdict)

    def unknown_refused(self) -> CommandError:
        """Return its refusal by a strict policy, with the policy that would accept it."""
        remedy = "`hapticd guard warn` would apply it anyway"
        if self.strict:
            remedy = "under `warn` a client that is not strict could apply it anyway"
        why = Explanation.of(self.verdict)
        why = why.and_reason(Reason.POLICY, f"policy {self.policy} refuses that")
        return self.refused(why.and_remedy(Remedy.POLICY, remedy))

    def verdict_beside(
        self, answer: dict[str, Any] | None, unknown: Callable[[str], dict[str, Any]], late: str
    ) -> dict[str, Any]:
        """Return the verdict on a change that was posted at once. `answer` None: the worker was
        `late`. `unknown` makes the verdict without a judgement, from its reason.
        """
        verdict = answer.get("verdict") if answer else None
        if answer is None or not isinstance(verdict, dict):
            return unknown(
                f"the guard's worker answered: {answer.get('error')}" if answer else late
            )
        if answer.get("action") == "stage" and verdict.get("safe"):
            stages = Explanation.because(
                Reason.ONLY_IN_STAGES, "the path is passive only in stages"
            )
            known = Explanation.of(verdict)
            both = Explanation(stages.reasons + known.reasons, known.remedies)
            verdict = verdict | {"safe": False} | both.plain(Outcome.WARNING)
        return {"safe": None, "text": "", **verdict, "number": self.number, "cmd": self.cmd}


def forbidden_by(leases: Leases, change: PendingChange) -> CommandError | None:
    """Return the error if the client of `change` may no longer make this change or its stages."""
    if change.own:
        return None
    error = forbidden(change.request, change.actor, leases)
    beyond_damping = any(stage.change.keys() - {"active_damping"} for stage in change.stages)
    if error is None and beyond_damping:
        error = leases.may(change.actor, ENVIRONMENT)
        return error and CommandError(error.code, f"{change.cmd}: {error}", error.detail)
    return error


def ends_force(request: Request, target: Environment) -> bool:
    """Return whether nothing is rendered after `request`, with the active damping unchanged.

    The set of passive environments is convex and contains 0, so every ramp to 0 is passive if its
    start is.
    """
    if not isinstance(request, Set) or request.at_tick or request.auto is not None:
        return False
    return target.changed(request.change(0.0)).empty


def former(request: Request, before: list[dict[str, Any]], target: Environment) -> dict[str, Any]:
    """Return the values that a bounded change restores at its end: `target`, with the changes
    scheduled `before` it; {} for one without an end.
    """
    if not request.end_tick:
        return {}
    for fields in before:
        target = target.changed(fields)
    return target.fields(request.change(0.0))


def stages_of(answer: dict[str, Any]) -> tuple[Stage, ...]:
    """Return the stages of an answer that requires action. ValueError: the stages are invalid."""
    stages = answer.get("stages")
    if not isinstance(stages, list) or not stages:
        raise ValueError("nothing to be done")
    return tuple(map(_stage, stages))


def _stage(plain: Any) -> Stage:
    try:
        change = plain["change"]
        sound = change == {} or Set.model_validate({"cmd": "set", **change}).change(0.0) == change
    except (KeyError, TypeError, ValueError):
        sound = False
    if not sound:
        raise ValueError("a stage that is no change of an environment")
    least = plain.get("active_damping_at_least")
    if least is not None and not isinstance(least, (int, float)):
        raise ValueError("a stage that waits for no number")
    return Stage(change, least, bool(plain.get("after_ramps")))


# --- posted commands ------------------------------------------------------------------------------

ANSWER_TIMEOUT_NS = NS_PER_S
CLIENT_SLOTS = RING_SLOTS - 8  # of the servo's ring; the others are for the gateway itself
MOST_SCHEDULED = 64  # more than a servo holds; older ones have lost their second answer


class Pending(NamedTuple):
    """A posted command that awaits its reply."""

    message: RequestMessage
    actor: int
    kind: Command
    mailbox: GatewayMailbox  # of the servo it was posted to
    seq: int
    deadline_ns: int
    change: PendingChange | None = None  # of a command that the guard handled
    request: Request | None = None  # of any other command, except stop
    answer: Answer | None = None


class Outstanding:
    """Outstanding commands, by servo life and sequence number.

    Every entry leaves by `due` or `abandon`, scheduled ones by their second answer.
    """

    def __init__(self, view: ServoView) -> None:
        self._view = view
        self._pending: dict[tuple[int, int], Pending] = {}
        self._scheduled: dict[tuple[int, int], Pending] = {}

    def __len__(self) -> int:
        return len(self._pending)

    def awaits(self, cmd: str) -> bool:
        """Return whether a command of that name has no reply yet."""
        return any(one.message.cmd == cmd for one in self._pending.values())

    def asked_by(self, actor: int) -> list[Pending]:
        """Return the requests of `actor` that the servo has not yet answered, except stages of a
        change with a reply.
        """
        return [
            one
            for one in self._pending.values()
            if one.actor == actor
            and one.answer is None
            and (one.change is None or one.change.enables or not one.change.replied)
        ]

    def outdated(self, number: int, leases: Leases) -> list[Pending]:
        """Return the requests without an answer that their client may no longer make.

        If a policy must be enforced, include changes that were judged by other terms than
        `number`, or by none.
        """
        return [
            one
            for one in self._pending.values()
            if one.answer is None and _outdated(one, number, leases)
        ]

    def post(
        self,
        message: RequestMessage,
        actor: int,
        what: Posting,
        now_ns: int,
        change: PendingChange | None = None,
        request: Request | None = None,
    ) -> None:
        """Put a command into the servo's ring and keep it until it is answered.

        CommandError: no servo is running, or its ring has no room for a client: terms of the
        guard, ends of leases and faults must not wait for clients.
        """
        self._view.require_servo(message.cmd)
        kind, apply_tick, values = what
        mailbox = self._view.mailbox
        room = mailbox and (mailbox.backlog < CLIENT_SLOTS or kind is Command.STOP)
        seq = mailbox.post(kind, actor, apply_tick, values) if mailbox and room else None
        if mailbox is None or seq is None:
            text = f"{CLIENT_SLOTS} commands wait for the servo already; slow down and ask again"
            raise CommandError("busy", f"{message.cmd}: {text}")
        self._pending[self._view.life, seq] = Pending(
            message, actor, kind, mailbox, seq, now_ns + ANSWER_TIMEOUT_NS, change, request
        )

    def take(self, answer: Answer, life: int) -> Pending | None:
        """Note an answer of servo `life`.

        Return the command if this is the second answer of a scheduled one.
        """
        key = life, answer.seq
        pending = self._pending.get(key)
        if pending is None or pending.answer is not None:
            return self._scheduled.pop(key, None)
        self._pending[key] = pending._replace(answer=answer)
        if answer.result is Result.SCHEDULED:
            self._scheduled[key] = pending
            if len(self._scheduled) > MOST_SCHEDULED:
                # keys are (life, number): the smallest is the oldest
                del self._scheduled[min(self._scheduled)]
        return None

    def due(self, tick: int, now_ns: int) -> list[Pending]:
        """Remove and return the commands that are due for a reply.

        These were refused or scheduled, are in force at `tick`, or have timed out.
        """
        ready = [key for key, pending in self._pending.items() if _is_due(pending, tick, now_ns)]
        return [self._pending.pop(key) for key in ready]

    def abandon(self, life: int) -> list[Pending]:
        """Remove and return all commands of other servo lives than `life`.

        Scheduled commands of other lives are forgotten.
        """
        lost = [pending for key, pending in self._pending.items() if key[0] != life]
        for known in (self._pending, self._scheduled):
            for key in [key for key in known if key[0] != life]:
                del known[key]
        return lost


def _outdated(one: Pending, number: int, leases: Leases) -> bool:
    if one.change is None:
        return forbidden(one.request, one.actor, leases) is not None
    judged = number in (one.change.terms, ANY_TERMS)
    return not judged or forbidden_by(leases, one.change) is not None


def _is_due(pending: Pending, tick: int, now_ns: int) -> bool:
    answer = pending.answer
    # a refused command changes nothing, so it need not wait for a record
    answered = answer is not None and (
        answer.result is not Result.APPLIED or tick >= answer.first_tick
    )
    return answered or now_ns >= pending.deadline_ns


# --- scheduled changes ----------------------------------------------------------------------------

Fields = dict[str, Any]  # of an environment, nested as in `set`


class ScheduledChange(NamedTuple):
    """A scheduled change."""

    tick: int
    seq: int
    fields: Fields


class ScheduledChanges:
    """The scheduled changes of one servo life, by the sequence number of their command."""

    def __init__(self) -> None:
        self._changes: dict[int, ScheduledChange] = {}

    def clear(self) -> None:
        """Forget all changes: a new servo holds none."""
        self._changes.clear()

    def add(self, tick: int, seq: int, fields: Fields) -> None:
        """Note that command `seq` changes `fields` at `tick`."""
        self._changes[seq] = ScheduledChange(tick, seq, fields)

    def close(self, seq: int, applied: bool) -> None:
        """Remove command `seq` after its second answer; if it was not `applied`, remove its end
        too.
        """
        self._changes.pop(seq, None)
        if not applied:
            self._changes.pop(-seq, None)

    def ends(self, at_tick: int, until_tick: int) -> list[Fields]:
        """Return the values that ends of changes in force at `at_tick` restore up to
        `until_tick`.
        """
        waiting = {one.seq for one in self._changes.values() if one.tick > at_tick}
        return [
            one.fields
            for one in self._in_order()
            if one.seq < 0 and -one.seq not in waiting and at_tick < one.tick <= until_tick
        ]

    def around(self, at_tick: int, tick: int) -> tuple[list[Fields], list[Fields]]:
        """Return the changes due up to `at_tick`, and those after it. Changes due at the present
        `tick` or earlier are forgotten.
        """
        self._changes = {seq: one for seq, one in self._changes.items() if one.tick > tick}
        booked = self._in_order()
        before = [one.fields for one in booked if one.tick <= at_tick]
        return before, [one.fields for one in booked[len(before) :]]

    def _in_order(self) -> list[ScheduledChange]:
        return sorted(self._changes.values(), key=lambda one: (one.tick, abs(one.seq)))
