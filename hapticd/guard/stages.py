"""Apply a change of several stages; at most one such change is in progress.

The first stage is answered with a receipt, and an event reports the outcome. A stage waits for the
active damping that the board reports, and for the ramps of the stage before, never for a timer.
Each is posted with the revision of the environment for which it was judged (policies clamp, refuse,
follow). A newer request replaces the remaining stages; they are cancelled if the servo leaves the
state in which the change began. The environment in force then remains.

Each stage is posted by the newest record alone, and has a deadline.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

from hapticd.core.errors import CommandError
from hapticd.core.params import STRICT_POLICIES
from hapticd.core.units import NS_PER_S
from hapticd.guard.pending import Outstanding, PendingChange
from hapticd.guard.terms import IN_MOTION
from hapticd.mailbox.client_side import Answer
from hapticd.mailbox.layout import (
    ANY_TERMS,
    LATCHED,
    REVISION_MASK,
    Command,
    Flag,
    State,
    Value,
    values_of,
)
from hapticd.protocol.commands import Posting, change_posting, parameters
from hapticd.protocol.journal import EventCode, sentence
from hapticd.protocol.schemas import Request, Set
from hapticd.protocol.view import ServoView

__all__ = ["ChangeReply"]

PASS_THROUGH_FIELDS = (
    "ramp_s",
    "limit_cycle_faults",
    "until_tick",
)  # fields of `set` that are passed on unjudged
STAGE_NS = 2 * NS_PER_S  # in addition to the rise time of the damping


class ChangeReply(NamedTuple):
    """The reply to a change: an error, or a receipt."""

    change: PendingChange
    error: CommandError | None = None
    receipt: dict[str, Any] | None = None
    code: EventCode = "answered"  # of the event that tells a receipt


def ramp_s(request: Request, default_s: float) -> float:
    """Return the duration of the ramps of `request`, s."""
    return float(request.given.get("ramp_s", default_s))


class StagedChange:
    """The stages of one change, posted by `outstanding`; its replies go to `replies`."""

    def __init__(
        self, view: ServoView, outstanding: Outstanding, replies: list[ChangeReply]
    ) -> None:
        self.change: PendingChange | None = None  # the one whose next stage waits
        # the one whose stage was posted last; its answer may be due
        self._posted: PendingChange | None = None
        self._view = view
        self._outstanding = outstanding
        self._replies = replies
        # the wire rounds to the nearest count
        self.resolution_ns_per_m = abs(view.params.device.active_damping.per_count) / 2 + 1e-6

    def summary(self) -> dict[str, Any] | None:
        """Return the part of `status` about the change; None without one."""
        change = self.change
        if change is None:
            return None
        return {
            "cmd": change.cmd,
            "id": change.message.id,
            "actor": change.actor,
            "stage": change.place + 1,
            "stages": len(change.stages),
        }

    def start(self, change: PendingChange, now_ns: int) -> None:
        """Post the first stage of `change`, or wait until its condition is met."""
        request = change.request
        expected = request.given.get("if_rev")
        if expected is not None and expected != self._view.revision:
            text = f"{change.cmd}: the revision is {self._view.revision} by now, not {expected}"
            error = CommandError("refused_revision", f"{text}; check the change and ask again")
            self._replies.append(ChangeReply(change, error))
            return
        change.place = 0
        change.state = self._view.state
        change.seen = self._view.revision
        change.since_ns = now_ns
        if not change.at_tick and not change.enables:
            self.supersede(change)
        if self._met(change):
            self._post_stage(change, now_ns)
        else:
            self.change = change
            self._replies.append(ChangeReply(change, receipt=self._standing("staged")))

    def advance(self, now_ns: int, free: bool) -> None:
        """Post the next stage if it is due and no command is outstanding (`free`)."""
        change = self.change
        if change is None:
            return
        state = self._view.state
        ended = change.state is State.ENABLED and state is not State.ENABLED
        if state is not None and state is not change.state and (ended or state in LATCHED):
            self.cancel("state_left", state=self._view.state_name)
        elif change.enables and self._view.revision != change.seen:
            self.cancel("changed_before")
        elif now_ns - change.since_ns >= self._patience_ns(change) + STAGE_NS:
            self.cancel("stood_still")
        elif self._met(change):
            if free:
                self.change = None
                self._post_stage(change, now_ns)
        elif int(self._view.record["flags"]) & Flag.PAUSED:
            change.since_ns = now_ns
        elif now_ns - change.since_ns >= self._patience_ns(change):
            effect = float(self._view.record["active_damping_effect_ns_per_m"])
            least = change.stages[change.place].active_damping_at_least
            late: EventCode = "damping_late" if least else "ramps_late"
            self.cancel(late, reported_ns_per_m=effect, needed_ns_per_m=least)

    def take_back(
        self, concerned: Callable[[PendingChange], bool], why: EventCode, **fields: Any
    ) -> None:
        """Post no further stage of a `concerned` change, because of `why`."""
        change = self.change
        if change is not None and concerned(change):
            self.cancel(why, **fields)
        posted = self._posted
        if posted is not None and concerned(posted):
            posted.taken_back = why, fields

    def taken_back(self, change: PendingChange) -> ChangeReply:
        """Return the reply for `change`, one stage of which took effect after it was taken back.
        Force is not enabled.
        """
        self.change = None
        why, fields = change.taken_back or ("answered", {})
        if change.replied:
            return ChangeReply(change, receipt=self._standing("cancelled") | fields, code=why)
        text = f"{change.cmd}: {sentence(why, **fields)}; ask again"
        return ChangeReply(change, CommandError("refused", text))

    def supersede(self, by: PendingChange) -> None:
        """Drop the remaining stages, because `by` takes effect."""
        if self.change is by:
            self.change = None
        self.cancel("superseded", "superseded", by_cmd=by.cmd, by_actor=by.actor)

    def cancel(self, why: EventCode, result: str = "cancelled", **fields: Any) -> None:
        """Drop the remaining stages, because of `why`."""
        change = self.change
        self.change = None
        if change is not None:
            receipt = self._standing(result) | fields
            self._replies.append(ChangeReply(change, receipt=receipt, code=why))

    def applied(self, change: PendingChange, answer: Answer, now_ns: int) -> bool:
        """Note that a stage of `change` is in force; return whether there are more."""
        change.place += 1
        change.ramp_end_tick = answer.ramp_end_tick
        change.seen = answer.revision
        change.since_ns = now_ns
        self._posted = None
        if change.place >= len(change.stages):
            return False
        self.supersede(change)
        self.change = change
        return True

    def _met(self, change: PendingChange) -> bool:
        stage = change.stages[change.place]
        record = self._view.record
        moving = int(record["flags"]) & IN_MOTION
        if stage.after_ramps and (moving or self._view.tick < change.ramp_end_tick):
            return False
        least = stage.active_damping_at_least
        effect = float(record["active_damping_effect_ns_per_m"])
        return least is None or effect >= least - self.resolution_ns_per_m

    def _patience_ns(self, change: PendingChange) -> int:
        safety = self._view.params.safety
        level = self._view.params.device.active_damping_limit_ns_per_m
        rising_s = level / safety.active_damping_slew_ns_per_m_s
        return STAGE_NS + round(
            (rising_s + ramp_s(change.request, safety.default_ramp_s)) * NS_PER_S
        )

    def _standing(self, result: str) -> dict[str, Any]:
        """Return a receipt of the values in force, for a change without an answer of the servo."""
        tick = self._view.tick
        return {
            "result": result,
            "revision": self._view.revision,
            "first_tick": tick,
            "ramp_end_tick": tick,
            "effective": parameters(self._view.targets),
        }

    def _post_stage(self, change: PendingChange, now_ns: int) -> None:
        try:
            self._outstanding.post(
                change.message, change.actor, self._posting(change), now_ns, change
            )
            self._posted = change
        except CommandError as error:
            self._replies.append(ChangeReply(change, error))

    def _posting(self, change: PendingChange) -> Posting:
        """Return the command of the next stage, bound to the environment for which it
        was judged.
        """
        stage = change.stages[change.place]
        last = change.place == len(change.stages) - 1
        values: dict[Value, float] = {}
        if change.policy in STRICT_POLICIES and change.revision is not None:
            ahead = change.revision + change.ahead + change.place
            values[Value.ENVIRONMENT_REVISION] = ahead & REVISION_MASK
        if change.terms != ANY_TERMS:
            values[Value.TERMS] = change.terms
        if change.enables and last:
            return Command.ENABLE, 0, values_of(values)
        given = change.request.given if isinstance(change.request, Set) else {}
        names = PASS_THROUGH_FIELDS if change.place == 0 else PASS_THROUGH_FIELDS[:1]
        extras = {name: given[name] for name in names if name in given}
        at_tick = change.at_tick if change.place == 0 else 0
        return change_posting(extras | stage.change, at_tick, values)
