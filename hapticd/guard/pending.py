"""A request that the guard handles, and the stages into which the worker divides it.

`request_queue` keeps one `PendingChange` for each request. The worker is another process, so its
answer is checked before it is used.
"""

from dataclasses import dataclass, field
from typing import Any

from hapticd.core.environment import Environment
from hapticd.core.errors import CommandError
from hapticd.guard.transition_planner import Stage
from hapticd.mailbox.client_side import Answer
from hapticd.mailbox.layout import ANY_TERMS, State
from hapticd.protocol.codec import RequestMessage
from hapticd.protocol.commands import forbidden
from hapticd.protocol.journal import GATEWAY_ACTOR, EventCode
from hapticd.protocol.leases import ENVIRONMENT, Leases
from hapticd.protocol.schemas import Enable, Judged, Request, Set

__all__ = ["PendingChange", "ends_force"]


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
