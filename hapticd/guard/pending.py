"""What waits for an answer: requests on their way past the guard, and commands at the servo.

`PendingChange` is a request that changes what is rendered or damped; `request_queue` keeps one of
each. Here are also the two translations: what a request changes of an environment, as the guard's
worker is asked, and the stages in which the worker says to do it. The worker is another process:
its answer is checked before it is used.

`Outstanding` keeps what was posted to the servo until it is answered and seen in force, by servo
life and sequence number; scheduled commands wait for their second answer. The command server and
the guard post through it, so it knows whether any command is on its way.
"""

from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

from hapticd.core.environment import JUDGED, SLOTS, Environment, flat
from hapticd.core.errors import CommandError
from hapticd.core.units import NS_PER_S
from hapticd.guard.transition_planner import Stage
from hapticd.mailbox.client_side import Answer
from hapticd.mailbox.layout import ANY_TERMS, Result, State
from hapticd.protocol.codec import RequestMessage
from hapticd.protocol.commands import Posting, forbidden
from hapticd.protocol.journal import GATEWAY_ACTOR
from hapticd.protocol.leases import ENVIRONMENT, Leases
from hapticd.protocol.limits import PLACES
from hapticd.protocol.schemas import Damping, Enable, GuardRequest, Judged, Request, Set
from hapticd.protocol.view import ServoView

__all__ = ["Outstanding", "Pending", "PendingChange", "concerns", "damping_by"]

ANSWER_TIMEOUT_NS = NS_PER_S
MOST_SCHEDULED = 64  # more than a servo holds; older ones have lost their second answer
TABLES = tuple(name for name in JUDGED if name not in SLOTS)


@dataclass(slots=True, eq=False)
class PendingChange:
    """One request and what became of it so far."""

    message: RequestMessage
    actor: int
    request: Request
    life: int  # of the servo it is for
    came_ns: int
    at_tick: int = 0
    replied: bool = False
    tries: int = 0
    # --- since it was asked
    number: int = 0  # of the question, 0: not asked
    ready_ns: int = 0  # since when it could be asked, 0: not yet
    terms_changes: int = 0  # by then
    terms: int = ANY_TERMS  # number of the terms it was judged by
    policy: str = "off"
    revision: int | None = None  # of the environment it was judged for
    answer: dict[str, Any] | None = None
    ahead: int = 0  # scheduled changes that come into force first
    verdict: dict[str, Any] = field(default_factory=dict)
    stages: tuple[Stage, ...] = ()
    place: int = 0  # of the next stage
    state: State | None = None  # in which it began
    ramp_end_tick: int = 0
    seen: int = 0  # revision of the servo when it began to wait, or when its last stage acted
    since_ns: int = 0  # the last stage was posted, or something moved
    taken_back: str = ""  # why no further stage shall come, while one is with the servo
    former: dict[str, Any] = field(default_factory=dict)  # what a bounded change brings back
    held: Answer | None = None  # of the servo, while the verdict on what was posted is awaited

    @property
    def cmd(self) -> str:
        """The command that was asked."""
        return self.message.cmd

    @property
    def own(self) -> bool:
        """Whether the guard does it by itself: mode auto."""
        return self.actor == GATEWAY_ACTOR

    @property
    def strict(self) -> bool:
        """Whether its client has it judged as under `refuse`, the strictest of the policies."""
        return isinstance(self.request, Judged) and self.request.strict


def change_of(request: Request, level: float) -> dict[str, Any]:
    """What `request` changes of an environment; active damping as a number, `on` being `level`."""
    if isinstance(request, Damping):
        if request.value == "auto":
            return {}
        named = {"on": level, "off": 0.0}
        value = request.value
        return {"active_damping": named[value] if isinstance(value, str) else float(value)}
    if isinstance(request, Set):
        given = request.given
        return {name: given[name] for name in JUDGED if given.get(name, {}) != {}}
    return {}


def until_tick(request: Request) -> int:
    """The tick at which a bounded change ends; 0 for one without an end."""
    return request.until_tick if isinstance(request, Set) and "until_tick" in request.given else 0


def forbidden_by(leases: Leases, change: PendingChange) -> CommandError | None:
    """Why the client of `change` may not change what it asks any more, or what its stages do."""
    if change.own:
        return None
    error = forbidden(change.request, change.actor, leases)
    beyond_damping = any(stage.change.keys() - {"active_damping"} for stage in change.stages)
    if error is None and beyond_damping:
        error = leases.may(change.actor, ENVIRONMENT)
        return error and CommandError(error.code, f"{change.cmd}: {error}", error.detail)
    return error


def ends_force(request: Request, target: Environment) -> bool:
    """Whether nothing is rendered after `request`, and active damping stays: the set of passive
    environments is convex and holds 0, so every ramp there is passive where its begin is.
    """
    if not isinstance(request, Set) or request.at_tick or "active_damping" in request.given:
        return False
    return target.changed(change_of(request, 0.0)).empty


def concerns(request: Request) -> bool:
    """Whether a verdict is asked for it."""
    if isinstance(request, Set):
        return bool(change_of(request, 0.0))
    return isinstance(request, (Damping, Enable))


def auto_of(request: Request) -> bool | None:
    """Whether `request` leaves the level of damping to the guard; None: as before."""
    if isinstance(request, Damping):
        return request.value == "auto"
    return False if isinstance(request, Set) and "active_damping" in request.given else None


def damping_by(asked: GuardRequest) -> Damping:
    """The damping command that the mode in `asked` comes to."""
    values: dict[str, Literal["on", "off", "auto"]] = {"level": "on", "off": "off", "auto": "auto"}
    return Damping(cmd="damping", value=values[asked.mode], strict=asked.strict)


def stages_of(answer: dict[str, Any]) -> tuple[Stage, ...]:
    """The stages of an answer that says to do something. ValueError: they are not understood."""
    stages = answer.get("stages")
    if not isinstance(stages, list) or not stages:
        raise ValueError("nothing to be done")
    return tuple(map(_stage, stages))


def _stage(plain: Any) -> Stage:
    change = plain.get("change") if isinstance(plain, dict) else None
    if not isinstance(change, dict):
        raise ValueError("a stage without a change")
    if any(isinstance(value, dict) != (name in TABLES) for name, value in change.items()):
        raise ValueError("a stage whose fields are not nested as in `set`")
    for name, value in flat(change):
        if name not in PLACES or isinstance(value, bool) or not isinstance(value, (int, float)):
            raise ValueError(f"a stage that changes {name[:20]!r}")
    least = plain.get("active_damping_at_least")
    if least is not None and not isinstance(least, (int, float)):
        raise ValueError("a stage that waits for no number")
    return Stage(change, least, bool(plain.get("after_ramps")))


class Pending(NamedTuple):
    """A posted command whose reply is still to be written."""

    message: RequestMessage
    actor: int
    life: int  # of the servo it was posted to
    deadline_ns: int
    change: PendingChange | None = None  # of one that went past the guard
    answer: Answer | None = None


class Outstanding:
    """By servo life and sequence number.

    Everything leaves by `due` or `abandon`, scheduled ones by their second answer.
    """

    def __init__(self, view: ServoView) -> None:
        self._view = view
        self._pending: dict[tuple[int, int], Pending] = {}
        self._scheduled: dict[tuple[int, int], Pending] = {}

    def __len__(self) -> int:
        return len(self._pending)

    def awaits(self, cmd: str) -> bool:
        """Whether a command of that name has no reply yet."""
        return any(one.message.cmd == cmd for one in self._pending.values())

    def asked_by(self, actor: int) -> list[RequestMessage]:
        """What `actor` asked and has no reply to yet."""
        return [one.message for one in self._pending.values() if one.actor == actor]

    def post(
        self,
        message: RequestMessage,
        actor: int,
        what: Posting,
        now_ns: int,
        change: PendingChange | None = None,
    ) -> None:
        """Put a command into the servo's ring and keep it until it is answered.

        CommandError: no servo is there, or its ring is full.
        """
        view = self._view
        view.require_servo(message.cmd)
        kind, apply_tick, values = what
        seq = view.mailbox.post(kind, actor, apply_tick, values) if view.mailbox else None
        if seq is None:
            raise CommandError(
                "busy",
                f"{message.cmd}: 64 commands wait for the servo already; slow down and ask again",
            )
        deadline_ns = now_ns + ANSWER_TIMEOUT_NS
        self._pending[view.life, seq] = Pending(message, actor, view.life, deadline_ns, change)

    def take(self, answer: Answer, life: int) -> Pending | None:
        """Note an answer of servo `life`.

        If it is the second one of a scheduled command: that command.
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
        """Remove and return what is to be replied to.

        That is what was refused or scheduled, is in force at `tick`, or is out of time.
        """
        ready = [key for key, pending in self._pending.items() if _is_due(pending, tick, now_ns)]
        return [self._pending.pop(key) for key in ready]

    def abandon(self, life: int) -> list[Pending]:
        """Remove and return all that another servo life than `life` was asked.

        Scheduled commands of other lives are forgotten.
        """
        lost = [pending for pending in self._pending.values() if pending.life != life]
        for known in (self._pending, self._scheduled):
            for key in [key for key in known if key[0] != life]:
                del known[key]
        return lost


def _is_due(pending: Pending, tick: int, now_ns: int) -> bool:
    answer = pending.answer
    # what was refused changes nothing, so it need not wait for a record
    answered = answer is not None and (
        answer.result is not Result.APPLIED or tick >= answer.first_tick
    )
    return answered or now_ns >= pending.deadline_ns
