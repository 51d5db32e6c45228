"""A request that changes what is rendered or damped, on its way past the guard, and its parts.

`request_queue` keeps a `PendingChange` of each request. Here are also the two translations: what a
request changes of an environment, as the guard's worker is asked, and the stages in which the
worker says to do it. The worker is another process: its answer is checked before it is used.
"""

from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

from hapticd.core.environment import JUDGED, SLOTS, Environment, flat
from hapticd.core.errors import CommandError
from hapticd.mailbox.client_side import Answer
from hapticd.mailbox.layout import ANY_TERMS, State
from hapticd.protocol.codec import RequestMessage
from hapticd.protocol.commands import forbidden
from hapticd.protocol.leases import ENVIRONMENT, Leases
from hapticd.protocol.limits import PLACES
from hapticd.protocol.schemas import Damping, Enable, GuardRequest, Judged, Request, Set

__all__ = ["PendingChange", "concerns", "damping_by"]

TABLES = tuple(name for name in JUDGED if name not in SLOTS)


class Stage(NamedTuple):
    """A part of a change that may be in force by itself."""

    change: dict[str, Any]  # fields as in `set`, absolute values
    active_damping_at_least: float | None  # N s/m that the board reports before it is posted
    after_ramps: bool  # those of the stage before have ended


@dataclass(slots=True, eq=False)
class PendingChange:
    """One request and what became of it so far."""

    cmd: str
    id: int | str | None
    actor: int
    request: Request
    message: RequestMessage | None  # None: of what the guard does by itself
    life: int  # of the servo it is for
    came_ns: int
    at_tick: int = 0
    replied: bool = False
    tries: int = 0
    # --- since it was asked
    number: int = 0  # of the question, 0: not asked
    ready_ns: int = 0  # since when it could be asked, 0: not yet
    changes: int = 0  # of the policy by then
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


def changes_environment(stages: tuple[Stage, ...]) -> bool:
    """Whether `stages` change more than the active damping."""
    return any(stage.change.keys() - {"active_damping"} for stage in stages)


def forbidden_by(leases: Leases, case: PendingChange) -> CommandError | None:
    """Why the client of `case` may not change what it asks any more, or what its stages do."""
    error = forbidden(case.request, case.actor, leases)
    if error is None and changes_environment(case.stages):
        error = leases.may(case.actor, ENVIRONMENT)
        return error and CommandError(error.code, f"{case.cmd}: {error}", error.detail)
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
