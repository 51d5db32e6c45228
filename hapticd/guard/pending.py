"""A request on its way past the guard, and the stages into which the worker divides it.

`request_queue` keeps one `PendingChange` of each request. The worker is another process: its answer
is checked before it is used.
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
from hapticd.protocol.journal import GATEWAY_ACTOR
from hapticd.protocol.leases import ENVIRONMENT, Leases
from hapticd.protocol.schemas import Enable, Judged, Request, Set

__all__ = ["PendingChange", "ends_force"]


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
    def enables(self) -> bool:
        """Whether force comes with it."""
        return isinstance(self.request, Enable)

    @property
    def strict(self) -> bool:
        """Whether its client has it judged as under `refuse`, the strictest of the policies."""
        return isinstance(self.request, Judged) and self.request.strict


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
    if not isinstance(request, Set) or request.at_tick or request.auto is not None:
        return False
    return target.changed(request.change(0.0)).empty


def stages_of(answer: dict[str, Any]) -> tuple[Stage, ...]:
    """The stages of an answer that says to do something. ValueError: they are not understood."""
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
