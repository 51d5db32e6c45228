"""Queue the requests that change the environment or the damping, until the guard has judged them.

    waiting -> asked -> posted, a stage at a time -> in force
       |         |         +-> refused: judged for another environment -> waiting, twice at most
       |         +-> refused, with the verdict
       +-> timed out, or its servo, client or lease has ended

Under `warn`, where a verdict is information, a change that needs no stages is posted at once if no
other request waits. It is judged in parallel, and its reply waits for answer and verdict.

Requests are handled one after the other. Each is judged while no command is outstanding, so that
the newest record and the last answer belong to the same environment. It is posted with the revision
of that environment, and the servo refuses it if the revision has changed (policies clamp, refuse,
follow). All other requests bypass the queue. A stop, a disable and any other change of state first
cancels each waiting enable, because an enable must not follow a later request.

A client may have its own requests judged as under `refuse`, under any policy (`strict`).

A change of several stages continues on its own (`stages`) while the next ones are judged. Under a
strict policy, stages and scheduled changes that were judged by other terms (policy, basis, margin)
are cancelled.

Each request has a deadline. A verdict counts only while policy and environment are the same.
"""

from collections import deque
from dataclasses import replace
from typing import Any

from hapticd.core.errors import CommandError
from hapticd.core.params import STRICT_POLICIES
from hapticd.core.units import NS_PER_MS, NS_PER_S
from hapticd.guard.pending import (
    Outstanding,
    PendingChange,
    ScheduledChanges,
    ends_force,
    forbidden_by,
    former,
    stages_of,
)
from hapticd.guard.stages import ChangeReply, StagedChange
from hapticd.guard.status import VERDICT_NS, Guard
from hapticd.guard.transition_planner import Stage
from hapticd.mailbox.client_side import Answer
from hapticd.mailbox.layout import ANY_TERMS, LATCHED, Command, Result, Value, values_of
from hapticd.protocol.codec import INTERNAL_REQUEST
from hapticd.protocol.commands import changed_parts, posting, receipt, refusal
from hapticd.protocol.journal import GATEWAY_ACTOR, Actors, Explanation, Reason, sentence
from hapticd.protocol.leases import Leases
from hapticd.protocol.schemas import Change, Damping
from hapticd.protocol.view import ServoView

__all__ = ["GuardedQueue"]

MOST_WAITING = 64
WAITING_NS = NS_PER_S  # until it is judged; its sender gives up after 2 s
# until its verdict takes effect: its turn, the verdict, and the answer to the command before it
JUDGING_NS = 2 * NS_PER_S + VERDICT_NS
TRIES = 2  # further ones, if another change took effect meanwhile
JUDGED_OTHERWISE = frozenset({Result.REFUSED_REVISION, Result.REFUSED_TERMS})
CHOICE_NS = 5 * NS_PER_S  # between choices of the level in mode auto while nothing changes
LEAST_CHOICE_NS = NS_PER_S
SETTLING_NS = WAITING_NS - 100 * NS_PER_MS  # maximum wait of a request for a known delay
UNSETTLED = "the delay of the loop is not measured yet; ask again"
NOT_KNOWN = (
    "the environment in force is not known: ramps from before the start of this gateway may be in"
    " progress; ask again"
)
SERVO_GONE = "the servo ended before the change was in force; after its restart it is disabled"


class GuardedQueue:
    """The queue of requests to be judged, and the multi-stage change in progress.

    Commands go into the servo's ring by `Outstanding`; their answers return by `answered`. Every
    pass checks `leases`: a request ends with the lease of its client.
    """

    def __init__(
        self,
        guard: Guard,
        view: ServoView,
        actors: Actors,
        outstanding: Outstanding,
        leases: Leases,
    ) -> None:
        self._guard = guard
        self._view = view
        self._actors = actors
        self._outstanding = outstanding
        self._leases = leases
        self._queue: deque[PendingChange] = deque()
        self._asked: PendingChange | None = None
        self._beside: PendingChange | None = None  # posted at once, judged meanwhile
        self._replies: list[ChangeReply] = []
        self._under_way = StagedChange(view, outstanding, self._replies)
        self._scheduled = ScheduledChanges()  # of the present servo life
        self._life = 0
        self._latched = False  # state of the servo at the last pass
        self._terms_sent = (0, ANY_TERMS)  # servo life, number of the terms that it knows
        self._chosen_ns = -CHOICE_NS  # time of the last choice in mode auto
        self._chosen_for: tuple[Any, ...] = ()

    @property
    def waiting(self) -> bool:
        """Whether a verdict is due, or a request has not yet been judged."""
        return bool(self._asked or self._beside or self._queue)

    def summary(self) -> dict[str, Any]:
        """Return the part of `status` about the queue."""
        waiting = len(self._queue) + (self._asked is not None)
        return {"waiting": waiting, "under_way": self._under_way.summary()}

    # --- in ---------------------------------------------------------------------------------------

    def take(self, change: PendingChange, now_ns: int, idle: bool) -> None:
        """Take a request; `idle`: no command is outstanding.

        CommandError: the request is refused at once, and nothing happens.
        """
        if not self.waiting and not self._asks(change):
            self._unjudged(change, now_ns)
            return
        if idle and self._goes_at_once(change):
            self._judge_beside(change, now_ns)
            return
        if len(self._queue) >= MOST_WAITING:
            reason = f"{MOST_WAITING} requests wait for the guard already; slow down and ask again"
            raise CommandError("busy", f"{change.cmd}: {reason}")
        self._queue.append(change)

    def _goes_at_once(self, change: PendingChange) -> bool:
        """Return whether it can be applied at once, in one stage and under any verdict."""
        guard = self._guard
        whole = len(changed_parts(change.request)) == 1
        plain = whole and not change.at_tick and not self._guard.chooses_level(change)
        plain = plain and not change.request.end_tick
        # a look, or the search for a hand, delays only the reply
        ready = guard.worker == "up" and guard.in_force.known and not guard.owes_verdict
        free = not self.waiting and self._under_way.change is None
        return self._policy(change) == "warn" and plain and ready and free

    def _judge_beside(self, change: PendingChange, now_ns: int) -> None:
        self._ask(change, now_ns)
        self._asked = None
        try:
            self._post(change, now_ns)
        except CommandError:
            self._guard.forget(change.number)
            raise
        self._beside = change

    def _post(self, change: PendingChange, now_ns: int) -> None:
        what = posting(change.request, 0)
        self._outstanding.post(change.message, change.actor, what, now_ns, change)

    def _hear_beside(self, change: PendingChange, now_ns: int) -> None:
        """Reply to a change that is already in force, once its verdict has arrived or is late."""
        guard = self._guard
        answer = guard.answer(change.number)
        late = guard.worker != "up" or now_ns - change.ready_ns >= VERDICT_NS
        if answer is None and not late:
            return
        self._beside = None
        guard.forget(change.number)
        change.verdict = change.verdict_beside(answer, guard.unknown, self._late() or guard.trouble)
        if change.verdict["safe"] is False:
            self._want_hand(change)
        if change.held is not None and (reply := self.answered(change, change.held, now_ns)):
            self._replies.append(reply)

    def take_back_enables(self, why: str) -> None:
        """Refuse the waiting enables, because the command `why` was sent later."""
        for change in self._waits():
            if change.enables:
                self._end(change, "refused", f"{why} was asked before it was judged; ask again")
        self._under_way.take_back(lambda change: change.enables, "asked_meanwhile", by_cmd=why)

    def leave(self, actor: int) -> None:
        """Drop the requests of `actor`, whose connection has ended. A change in progress continues,
        unless it enables force.
        """
        for change in self._waits_of(actor):
            self._drop(change)
        self._under_way.take_back(
            lambda change: change.actor == actor and (change.enables or not change.replied),
            "client_gone",
        )

    def heard(self, answer: Answer) -> None:
        """Take an answer: of a last one, forget the scheduled change, with its end if the change
        was not applied.
        """
        self._guard.in_force.hear(answer)
        if answer.result is not Result.SCHEDULED:
            self._scheduled.close(answer.seq, answer.result is Result.APPLIED)

    def give_up(self, actor: int) -> None:
        """Refuse the remaining requests of the client `actor`, which has failed."""
        for change in self._waits_of(actor):
            self._end(change, "refused", sentence("client_failed"))
        self._under_way.take_back(lambda change: change.actor == actor, "client_failed")

    def _waits(self) -> list[PendingChange]:
        """Return the requests without a verdict, in order of arrival."""
        return [*self._queue] if self._asked is None else [self._asked, *self._queue]

    def _waits_of(self, actor: int) -> list[PendingChange]:
        return [one for one in self._waits() if one.actor == actor]

    def _drop(self, change: PendingChange) -> None:
        if change is self._asked:
            self._guard.forget(change.number)
            self._asked = None
        else:
            self._queue.remove(change)

    # --- onwards ----------------------------------------------------------------------------------

    def advance(self, now_ns: int, idle: bool) -> list[ChangeReply]:
        """Advance as far as possible; return the replies. `idle`: no command is outstanding."""
        self._forget_other_lives()
        self._forget_who_may_not()
        self._forget_scheduled_at_a_stop()
        self._forget_other_terms()
        self._expire(now_ns)
        if self._beside is not None:
            self._hear_beside(self._beside, now_ns)
        if self._asked is not None:
            self._hear(self._asked, now_ns, idle)
        elif self._queue and idle:
            self._begin(now_ns)
        elif self._under_way.change is None and idle:
            self._choose_level(now_ns)
        self._under_way.advance(now_ns, idle and self._asked is None)
        replies = list(self._replies)
        self._replies.clear()
        return replies

    def _forget_other_lives(self) -> None:
        life = self._view.life if self._view.mailbox else 0
        if life == self._life:
            return
        self._life = life
        self._scheduled.clear()
        if self._beside is not None and self._beside.held is not None:
            text = f"{self._beside.cmd}: {SERVO_GONE}"
            self._replies.append(ChangeReply(self._beside, CommandError("servo_down", text)))
        self._beside = None  # without an answer, the command server has reported its end
        for change in filter(None, (*self._queue, self._asked, self._under_way.change)):
            if change.life != life:
                self._end(change, "servo_down", SERVO_GONE)

    def _forget_who_may_not(self) -> None:
        for change in filter(None, (*self._queue, self._asked, self._under_way.change)):
            if error := forbidden_by(self._leases, change):
                self._give_back(change, error)

    def _forget_scheduled_at_a_stop(self) -> None:
        """Cancel waiting scheduled changes at a stop or fault, as the servo cancels its own."""
        latched = self._view.state in LATCHED
        if latched and not self._latched:
            for change in self._waits():
                if isinstance(change.request, Change) and change.request.at_tick:
                    self._end(change, "refused", f"the servo is {self._view.state_name}; ask again")
        self._latched = latched

    def _forget_other_terms(self) -> None:
        """Under a strict policy, cancel changes that were judged by other terms, or scheduled
        through an earlier gateway.
        """
        number = self._guard.terms_number
        change = self._under_way.change
        if number != ANY_TERMS and change is not None and change.terms != number:
            self._under_way.cancel("other_terms")
        mailbox = self._view.mailbox
        if mailbox is None or not self._view.record or self._terms_sent == (self._life, number):
            return
        values = values_of({Value.TERMS: number})
        if number == ANY_TERMS or mailbox.post(Command.TERMS, GATEWAY_ACTOR, 0, values):
            self._terms_sent = self._life, number

    def _expire(self, now_ns: int) -> None:
        for change in [one for one in self._queue if now_ns - one.came_ns >= WAITING_NS]:
            why = "others were before it"
            if self._waits_for_stages(change) and (staged := self._under_way.summary()):
                why = f"stage {staged['stage']} of {staged['stages']} of a change is still to come"
            text = f"it was not judged within 1 s, {why}; nothing happened, ask again"
            self._end(change, "timeout", text)
        asked = self._asked
        if asked is not None and now_ns - asked.came_ns >= JUDGING_NS:
            text = "its verdict came too late; nothing happened, ask again"
            self._end(asked, "timeout", text)

    def _end(self, change: PendingChange, code: str, text: str) -> None:
        self._give_back(change, CommandError(code, f"{change.cmd}: {text}"))

    def _give_back(self, change: PendingChange, error: CommandError) -> None:
        if change is self._under_way.change:
            self._under_way.change = None
        else:
            self._drop(change)
        self._replies.append(ChangeReply(change, error))

    def _policy(self, change: PendingChange) -> str:
        """Return the policy for `change`: the one in force, or `refuse` if its client requests
        that.
        """
        return "refuse" if change.strict else self._guard.policy

    def _must(self, change: PendingChange) -> bool:
        """Return whether `change` is refused unless it is known to be safe."""
        return self._policy(change) in STRICT_POLICIES

    def _asks(self, change: PendingChange) -> bool:
        """Return whether the policy needs a verdict and a worker is available."""
        wanted = self._policy(change) != "off" or self._guard.chooses_level(change)
        return wanted and self._guard.worker in ("up", "starting")

    def _begin(self, now_ns: int) -> None:
        change = self._queue[0]
        if self._waits_for_stages(change):
            return
        if self._must(change) and not self._guard.settled and self._asks(change):
            if now_ns - change.came_ns >= SETTLING_NS:
                self._try_unjudged(self._queue.popleft(), now_ns, UNSETTLED)
            return
        change.ready_ns = change.ready_ns or now_ns
        if not self._asks(change):
            self._try_unjudged(self._queue.popleft(), now_ns)
        elif self._guard.worker == "up" and self._guard.in_force.known and not self._guard.busy:
            self._ask(self._queue.popleft(), now_ns)
        elif now_ns - change.ready_ns >= VERDICT_NS:
            self._try_unjudged(self._queue.popleft(), now_ns, self._late())

    def _waits_for_stages(self, change: PendingChange) -> bool:
        """Return whether `change` is judged after the stages in progress. An enable is, with the
        environment that is in force by then. So is a scheduled change if an enable is in progress,
        with the force that it brings.
        """
        under_way = self._under_way.change
        if under_way is None:
            return False
        return change.enables or (bool(change.at_tick) and under_way.enables)

    def _late(self) -> str:
        if not self._guard.in_force.known:
            return NOT_KNOWN
        late = f"the guard's worker gave no verdict within {VERDICT_NS / NS_PER_S:g} s:"
        late += " the computer is busy; ask again"
        return late if self._guard.worker == "up" else ""

    def _choose_level(self, now_ns: int) -> None:
        """In mode auto, judge the environment in force again: after a change of the delay, and
        every CHOICE_NS. After an action of the energy controller, wait for the next change.
        """
        guard = self._guard
        about = self._life, guard.in_force.revision, guard.delay_periods
        due = about != self._chosen_for or now_ns - self._chosen_ns >= CHOICE_NS
        ready = guard.mode == "auto" and guard.worker == "up" and guard.in_force.known
        ready = ready and (guard.settled or not guard.must) and not guard.in_force.controlled
        if not (ready and due) or now_ns - self._chosen_ns < LEAST_CHOICE_NS:
            return
        self._chosen_for = about
        self._chosen_ns = now_ns
        request = Damping(cmd="damping", value="auto")
        own = PendingChange(
            INTERNAL_REQUEST, GATEWAY_ACTOR, request, self._life, now_ns, replied=True
        )
        self._ask(own, now_ns)

    def _ask(self, change: PendingChange, now_ns: int) -> None:
        guard = self._guard
        before, after = self._scheduled.around(change.at_tick, self._view.tick)
        change.answer = None
        change.ready_ns = change.ready_ns or now_ns
        change.terms_changes = guard.terms_changes
        change.terms = guard.terms_number
        change.policy = self._policy(change)
        change.ahead = len(before)
        change.revision = guard.in_force.revision
        ends = self._scheduled.ends(change.at_tick, change.request.end_tick)
        change.former = former(change.request, [*before, *ends], guard.in_force.target())
        after = [*filter(None, [change.former]), *after]
        change.number = guard.ask(change, before, after, now_ns)
        self._asked = change

    def _hear(self, change: PendingChange, now_ns: int, idle: bool) -> None:
        """Act on the verdict for `change` once it has arrived and no command is outstanding."""
        change.answer = change.answer or self._guard.answer(change.number)
        if change.answer is not None:
            if idle and self._guard.in_force.known:
                self._asked = None
                self._take_verdict(change, change.answer, now_ns)
        elif self._guard.worker != "up" or now_ns - change.ready_ns >= VERDICT_NS:
            self._asked = None
            self._guard.forget(change.number)
            self._try_unjudged(change, now_ns, self._late())

    def _take_verdict(self, change: PendingChange, answer: dict[str, Any], now_ns: int) -> None:
        """Act on `answer`, or ask again if its terms or environment are outdated."""
        guard = self._guard
        if change.terms_changes != guard.terms_changes or change.policy != self._policy(change):
            change.ready_ns = 0
            self._queue.appendleft(change)
        elif change.revision != guard.in_force.revision and change.tries < TRIES:
            self._again(change, now_ns)
        else:
            self._judged(change, answer, now_ns)

    def _judged(self, change: PendingChange, answer: dict[str, Any], now_ns: int) -> None:
        verdict = answer.get("verdict")
        action = answer.get("action")
        try:
            if not isinstance(verdict, dict) or action not in ("apply", "stage", "refuse"):
                raise ValueError(str(answer.get("error", "an answer that is none"))[:200])
            change.stages = self._stages(change, answer) if action != "refuse" else ()
        except ValueError as error:
            self._try_unjudged(change, now_ns, f"the guard's worker answered: {error}")
            return
        about = {"number": change.number, "stages": len(change.stages), "cmd": change.cmd}
        change.verdict = {**verdict, **about}
        if change.own and (action == "refuse" or not self._changes(change)):
            return  # the level of mode auto stays
        if verdict.get("safe") is False:
            self._want_hand(change)
        if leased := forbidden_by(self._leases, change):
            self._replies.append(ChangeReply(change, leased))
        elif action == "refuse" and ends_force(change.request, self._guard.in_force.target()):
            self._try_unjudged(change, now_ns, "it ends force, which is never refused")
        elif action == "refuse":
            why = verdict.get("text", "the guard gave no reason")
            self._replies.append(
                ChangeReply(
                    change, CommandError("guard", f"{change.cmd}: {why}", guard=change.verdict)
                )
            )
        else:
            self._start(change, now_ns)

    def _start(self, change: PendingChange, now_ns: int) -> None:
        if change.request.end_tick and len(change.stages) > 1:
            text = (
                f"{change.cmd}: with an end it needs one stage, and would take {len(change.stages)}"
            )
            remedy = "bring in the active damping first, then ask again"
            self._replies.append(ChangeReply(change, CommandError("guard", f"{text}; {remedy}")))
            return
        self._under_way.start(change, now_ns)

    def _changes(self, change: PendingChange) -> bool:
        """Return whether the stages of `change` lead to another target than the ramps in
        progress.
        """
        before = self._guard.in_force.target()
        after = before
        for stage in change.stages:
            after = after.changed(stage.change)
        here, there = before.active_damping_ns_per_m, after.active_damping_ns_per_m
        moved = abs(there - here) > self._under_way.resolution_ns_per_m
        return moved or replace(after, active_damping_ns_per_m=here) != before

    def _stages(self, change: PendingChange, answer: dict[str, Any]) -> tuple[Stage, ...]:
        found = stages_of(answer)
        if change.enables and found[-1].change:
            return (*found, Stage({}, None, False))  # enable force last
        return found

    def _want_hand(self, change: PendingChange) -> None:
        asked = change.request.change(self._guard.in_force.level)
        wanted = self._guard.in_force.target().changed(asked)
        self._guard.want_hand(
            wanted,
            number=change.number,
            cmd=change.cmd,
            id=change.message.id,
            actor=change.actor,
        )

    # --- without a verdict ------------------------------------------------------------------------

    def _try_unjudged(self, change: PendingChange, now_ns: int, why: str = "") -> None:
        try:
            self._unjudged(change, now_ns, why)
        except CommandError as error:
            self._replies.append(ChangeReply(change, error))

    def _unjudged(self, change: PendingChange, now_ns: int, why: str = "") -> None:
        """Post the change as requested, or refuse it, according to the policy."""
        guard = self._guard
        change.policy = self._policy(change)
        change.terms_changes = guard.terms_changes
        off = change.policy == "off"
        reason = "policy off judges nothing" if off else why or guard.trouble
        change.verdict = guard.unknown(reason, change.policy)
        if self._must(change) and not ends_force(change.request, guard.in_force.target()):
            raise change.unknown_refused()
        if change.request.auto:
            text = "the guard chooses no level of active damping while it judges nothing"
            raise change.refused(Explanation.because(Reason.UNKNOWN, f"{text}: {guard.trouble}"))
        change.revision = None
        change.stages = ()
        if not change.at_tick and not change.enables:
            self._under_way.supersede(change)
        self._post(change, now_ns)
        # posted without terms: those until now have judged the schedule without it
        self._guard.terms_changes += 1

    # --- answers ----------------------------------------------------------------------------------

    def answered(
        self, change: PendingChange, answer: Answer, now_ns: int, scheduled: bool = False
    ) -> ChangeReply | None:
        """Return the reply to the servo's `answer` to the last stage of `change`; None: more is to
        come.

        `scheduled`: this is the second answer, to a scheduled change.
        """
        result = answer.result
        if change is self._beside and result is Result.APPLIED:
            change.held = answer
            # in force under any verdict: mode auto must not choose again meanwhile
            self._guard.set_auto(self._guard.chooses_level(change))
            return None
        if change.former and result in (Result.SCHEDULED, Result.APPLIED):
            self._scheduled.add(change.request.end_tick, -answer.seq, change.former)
        if result is Result.SCHEDULED:
            fields = change.request.change(self._guard.in_force.level)
            self._scheduled.add(change.at_tick, answer.seq, fields)
            return ChangeReply(change, receipt=receipt(answer))
        if result is Result.APPLIED:
            return self._applied(change, answer, now_ns)
        if result in JUDGED_OTHERWISE and change.tries < TRIES and not change.taken_back:
            self._again(change, now_ns)
            return None
        if scheduled:
            return ChangeReply(change, receipt=receipt(answer))
        error = refusal(answer, change.cmd, self._view, self._actors)
        error.guard = change.verdict
        return ChangeReply(change, error)

    def _applied(self, change: PendingChange, answer: Answer, now_ns: int) -> ChangeReply | None:
        self._guard.set_auto(self._guard.chooses_level(change))
        if self._under_way.applied(change, answer, now_ns):
            if change.taken_back:
                return self._under_way.taken_back(change)
            staged = receipt(answer) | {"result": "staged"}
            return None if change.replied else ChangeReply(change, receipt=staged)
        if len(change.stages) <= 1 and not change.ahead:
            self._guard.take_verdict(change.verdict)
        return ChangeReply(change, receipt=receipt(answer))

    def _again(self, change: PendingChange, now_ns: int) -> None:
        """Queue `change` to be judged again, ahead of later ones, because another change took
        effect first.
        """
        change.tries += 1
        change.came_ns = now_ns
        change.number = change.place = change.ready_ns = 0
        if change.at_tick <= self._view.tick and not change.request.end_tick:
            change.at_tick = 0  # a late bounded change is refused: its duration would be wrong
        self._queue.appendleft(change)
