"""Requests in, replies out: no socket, no clock.

A request is decoded, checked by the interlocks and, if it concerns the servo, posted to the command
ring. Its reply is written once the servo has answered and the newest record shows the change in
force. The `state` in a reply is therefore never older than the command. No call waits: `serve`
takes the requests, and `collect` returns the due replies, with timeouts for commands unanswered for
1 s. STOP precedes requests that arrived with it and skips every interlock. It also presses the stop
word if other commands are ahead of it in the ring.

A change of the environment first passes the guard (`guard.request_queue`), which uses another
process; all other requests are posted at once. `guard.pending` keeps posted commands until they
are answered.

Each request has a deadline. A reply repeats only a bounded id and a few printable characters of a
request.
"""

from collections.abc import Callable, Sequence
from dataclasses import fields
from typing import Any

from hapticd.core.errors import CommandError, MailboxError
from hapticd.core.params import LeaseParams
from hapticd.gateway.lease_server import LeaseServer, Waveform
from hapticd.guard.pending import Outstanding, Pending, PendingChange, ends_force
from hapticd.guard.request_queue import GuardedQueue
from hapticd.guard.stages import ChangeReply
from hapticd.guard.status import Guard
from hapticd.mailbox.client_side import Answer
from hapticd.mailbox.daemons import press_stop
from hapticd.mailbox.layout import Command, State, values_of
from hapticd.protocol.answers import InForce
from hapticd.protocol.codec import RequestMessage, unpacked
from hapticd.protocol.commands import (
    ACCEPTED,
    Situation,
    admit,
    coupling,
    parameters,
    posting,
    receipt,
    refusal,
)
from hapticd.protocol.journal import GATEWAY_ACTOR, Actors, Journal
from hapticd.protocol.leases import ENVIRONMENT
from hapticd.protocol.limits import CommandLimits
from hapticd.protocol.schemas import (
    Change,
    Damping,
    Enable,
    GuardRequest,
    Hello,
    LeaseRequest,
    Mark,
    Perturb,
    Proxy,
    Request,
    json_schema,
)
from hapticd.protocol.view import ServoView

__all__ = ["CommandServer"]

# commands that can be withdrawn from the ring, and what ends their force once they are taken
TAKEN_BACK = {
    Command.ENABLE: Command.DISABLE,
    Command.HOME: Command.DISABLE,
    Command.PERTURB_START: Command.PERTURB_STOP,
} | dict.fromkeys((Command.SET, Command.DAMPING, Command.RESET, Command.ZERO, Command.WITHHOLD))
# must not be followed by an enable that was requested earlier
OVERTAKING = frozenset({"disable", "reset", "zero", "home"})
# still executed after their client has left
OBEYED = frozenset({"stop", "disable", "mark", "dump"})
TAKEN_PER_TICK = 2  # by the servo; a stop behind more commands also presses the stop word
PAST_TICK = 1
IN_FORCE = tuple(one.name for one in fields(InForce))  # of the newest record, in the reply to get
MOST_QUEUED = 100  # waiting requests
TOO_MANY = CommandError(
    "busy", f"{MOST_QUEUED} requests wait for the gateway already; slow down and ask again"
)
OVERTAKEN = "a stop followed it; check that it is safe, then ask again"
OUTDATED = "the gateway stalled for more than 1 s and dropped this request; repeat it"
SERVO_ENDED = CommandError(
    "servo_down", "the servo ended before it answered; after its restart it is disabled"
)

Reply = list[bytes]


class CommandServer:
    """The command side of the gateway.

    `inquire(cmd)` returns the content of the replies to hello, status and dump.
    """

    def __init__(
        self,
        view: ServoView,
        journal: Journal,
        inquire: Callable[[str], dict[str, Any]],
        guard: Guard,
        lease: LeaseParams | None = None,
    ) -> None:
        self._view = view
        self._journal = journal
        self._inquire = inquire
        self._guard = guard
        self.limits = CommandLimits.announced(view.params)
        self.schema = json_schema(self.limits)
        self.actors = Actors(view.next_actor)
        self._leasing = LeaseServer(view, self.actors, journal, lease or LeaseParams())
        self.leases = self._leasing.leases
        self.counts = {"requests": 0, "errors": 0, "timeouts": 0}
        self._waveform = Waveform(self.limits)
        self._outstanding = Outstanding(view)
        self._guarded = GuardedQueue(guard, view, self.actors, self._outstanding, self.leases)
        guard.leases = self.leases
        self._queue: list[RequestMessage] = []
        self._asked_back = (0, 0)  # servo life and revision of the last query

    @property
    def waiting(self) -> bool:
        """Whether answers are due, so that frequent polling is worthwhile."""
        return len(self._outstanding) > 0 or self._guarded.waiting

    @property
    def queued(self) -> bool:
        """Whether requests wait for their turn."""
        return len(self._queue) > 0

    def serve(
        self,
        messages: Sequence[Sequence[bytes]],
        now_ns: int,
        outdated: bool = False,
        in_time: Callable[[], bool] = lambda: True,
    ) -> list[Reply]:
        """Take requests that arrived together, stops first; return the replies that are ready at
        once.

        `outdated`: only stops count. `in_time` is called after each request and returns whether
        there is time for another; the remaining ones wait for the next call.
        """
        self.counts["requests"] += len(messages)
        self._leasing.tend(now_ns)
        for message in messages:
            self._queue.append(unpacked(message))
            in_time()
        replies = self._overtaken()
        # the sort is stable: all others keep their order of arrival
        self._queue.sort(key=lambda one: one.cmd != "stop")
        replies += [self._refused(one, TOO_MANY) for one in self._queue[MOST_QUEUED:]]
        del self._queue[MOST_QUEUED:]
        while self._queue:
            reply = self._attend(self._queue.pop(0), now_ns, outdated)
            replies += [reply] if reply is not None else []
            if not in_time():
                break
        self._withdraw_outdated()
        return replies

    def _overtaken(self) -> list[Reply]:
        """Refuse resets and scheduled changes that arrived before a stop. The stop goes first, so
        they would undo or outlive it.
        """
        last = max((at for at, one in enumerate(self._queue) if one.cmd == "stop"), default=0)
        before = self._queue[:last]
        self._queue[:last] = [one for one in before if not _outlives_a_stop(one)]
        return [
            self._refused(one, CommandError("refused", f"{one.cmd}: {OVERTAKEN}"))
            for one in before
            if _outlives_a_stop(one)
        ]

    def collect(self, now_ns: int) -> list[Reply]:
        """Read the servo's answers; return the replies that are due."""
        lost = self._outstanding.abandon(self._view.life if self._view.mailbox else 0)
        replies = [self._ended(one, SERVO_ENDED) for one in lost]
        self._ask_back()
        try:
            for answer in self._view.answers():
                self._leasing.heard(answer)
                if scheduled := self._outstanding.take(answer, self._view.life):
                    # its first answer may have arrived just before, and is the reply
                    replies += self._due(now_ns)
                    self._report(scheduled, answer, now_ns)
                self._guarded.heard(answer)
        except MailboxError as error:
            self._journal.note("answers_lost", reason=str(error))
        self._leasing.tend(now_ns)
        replies += self._due(now_ns)
        self._guard.tend(now_ns)
        self._withdraw_outdated()
        answered = self._guarded.advance(now_ns, not len(self._outstanding))
        replies += [self._tell(one) for one in answered]
        return [one for one in replies if one is not None]

    def _due(self, now_ns: int) -> list[Reply | None]:
        return [self._closed(one, now_ns) for one in self._outstanding.due(self._view.tick, now_ns)]

    def leave(self, client: bytes) -> None:
        """End the leases and drop the waiting requests of `client`, whose connection has ended."""
        actor = self.actors.leave(client)
        self._leasing.leave(actor)
        self._guarded.leave(actor)
        self._take_back(actor)
        self._queue = [one for one in self._queue if one.client != client or one.cmd in OBEYED]

    def _attend(self, message: RequestMessage, now_ns: int, outdated: bool) -> Reply | None:
        try:
            if message.error:
                raise message.error
            actor = self.actors.number(message.client)
            self.leases.heard(actor)
            if message.cmd == "stop":
                return self._stop(message, actor, now_ns)
            if outdated:
                raise CommandError("timeout", f"{message.cmd}: {OUTDATED}")
            situation = Situation(
                self.limits, self._view, not self.waiting, self._waveform.samples(self._view),
                self.leases, self.actors,
            )  # fmt: skip
            request = admit(message.plain, actor, situation)
            result = self._answered_here(request, message, actor)
            self._leasing.tend(now_ns)  # changes by a lease precede the next request
            if result is not None:
                return self._accepted(message, {"result": result})
            if isinstance(request, GuardRequest):
                request = request.damping()
            if isinstance(request, (Damping, Enable)) or request.change(0.0):
                change = self._change(message, actor, request, now_ns)
                self._guarded.take(change, now_ns, not len(self._outstanding))
                return None
            if request.cmd in OVERTAKING:
                self._guarded.take_back_enables(request.cmd)
            what = posting(request, situation.samples)
            self._outstanding.post(message, actor, what, now_ns, request=request)
            return None
        except (CommandError, MailboxError) as error:
            return self._refused(message, error)

    def _answered_here(
        self, request: Request, message: RequestMessage, actor: int
    ) -> dict[str, Any] | None:
        if isinstance(request, Hello):
            self.actors.call(message.client, request.name)
            return self._inquire("hello") | {
                "actor": actor,
                "limits": self.limits.plain(),
            }
        if isinstance(request, Perturb) and request.action == "load":
            return self._load(request, actor)
        if isinstance(request, Proxy):
            return self._proxied(request, actor)
        if isinstance(request, LeaseRequest):
            if request.action == "fail":
                self._guarded.give_up(actor)
                self._take_back(actor)
            return self._leasing.answer(request, actor)
        if isinstance(request, GuardRequest):
            self._guard.change(request)
            return None if request.mode else self.guard_summary()
        if isinstance(request, Mark):
            return self._mark(request.text, actor)
        if request.cmd == "status":
            return self._inquire("status") | {"requests": dict(self.counts)}
        if request.cmd == "dump":
            return self._inquire("dump")
        if request.cmd == "schema":
            return self.schema
        if request.cmd == "get":
            self._view.require_servo("get")
            now = {name: self._view.record[name] for name in IN_FORCE if name in self._view.record}
            return {"parameters": parameters(self._view.targets), "in_force": now}
        return None

    def _mark(self, text: str, actor: int) -> dict[str, Any]:
        self._view.require_servo("mark")
        tick = self._view.tick
        name = self.actors.name(actor)
        self._journal.note("mark", tick=tick, text=text, actor=actor, name=name)
        return {"tick": tick}

    def _load(self, request: Perturb, actor: int) -> dict[str, Any]:
        if self._outstanding.awaits("perturb") or self._view.record.get("perturbing"):
            raise CommandError("busy", "perturb load: a waveform may be playing; stop it first")
        return {"samples": self._waveform.load(request, self._view, actor)}

    def _proxied(self, request: Proxy, actor: int) -> dict[str, Any]:
        """Post the position of a proxy, which the servo does not answer; return the newest record's
        handle and proxy.
        """
        self._view.require_servo("proxy")
        mailbox = self._view.mailbox
        if mailbox is not None and not request.reads:
            if self.leases.holder(ENVIRONMENT) is None:
                raise CommandError("leased", "proxy: take the lease of `environment` first")
            if self._view.params.device.commissioning:
                reason = "the signs of the device are not verified; `hapticd rig motor` first"
                raise CommandError("refused_commissioning", f"proxy: {reason}")
            if mailbox.backlog >= TAKEN_PER_TICK:  # the newest position is soon followed by another
                raise CommandError("busy", "proxy: the servo has not taken the positions before")
            kind, at_tick, values = posting(request, 0)
            mailbox.post(kind, actor, at_tick, values)
        return coupling(self._view.record, self._view.params.realtime.rate_hz)

    def guard_summary(self) -> dict[str, Any]:
        """Return policy, worker and progress, for `status` and the command `guard`."""
        return self._guard.summary() | self._guarded.summary()

    def _change(
        self, message: RequestMessage, actor: int, request: Request, now_ns: int
    ) -> PendingChange:
        self._view.require_servo(message.cmd)
        at_tick = request.at_tick or 0 if isinstance(request, Change) else 0
        return PendingChange(message, actor, request, self._view.life, now_ns, at_tick)

    def _stop(self, message: RequestMessage, actor: int, now_ns: int) -> Reply | None:
        self._guarded.take_back_enables("stop")
        mailbox = self._view.mailbox
        behind = mailbox is None or not self._view.alive or mailbox.backlog >= TAKEN_PER_TICK
        # before the ring is tried: the stop word acts even when the ring is full
        pressed = behind and self._pressed(actor)
        try:
            self._outstanding.post(message, actor, (Command.STOP, 0, values_of({})), now_ns)
        except CommandError as error:
            if not pressed or error.code != "busy":
                raise
            return self._accepted(message, {"receipt": {"result": "pressed"}})
        return None

    def _pressed(self, actor: int) -> bool:
        """Press the stop word; return whether that succeeded."""
        try:
            press_stop(self._view.folder, actor)
        except MailboxError:
            return False
        return True

    def _ask_back(self) -> None:
        """Read the parameters after a restart of the gateway, or after the servo has changed them
        itself. A set for a tick long past is refused, and the refusal contains them.
        """
        view = self._view
        about = view.life, self._guard.in_force.revision
        own = self._guard.in_force.ahead_of_answers and not len(self._outstanding)
        if (view.unsure or own) and about != self._asked_back and view.mailbox:
            seq = view.mailbox.post(Command.SET, GATEWAY_ACTOR, PAST_TICK, values_of({}))
            self._asked_back = self._asked_back if seq is None else about

    def _report(self, scheduled: Pending, answer: Answer, now_ns: int) -> None:
        answered = scheduled.change and self._guarded.answered(
            scheduled.change, answer, now_ns, scheduled=True
        )
        if answered:
            self._tell(answered)

    def _tell(self, answered: ChangeReply) -> Reply | None:
        """Return the reply to a request that the guard handled, or note an event if it already has
        one.
        """
        change = answered.change
        verdict = {"guard": change.verdict} if change.verdict else {}
        if change.replied:
            error = answered.error
            told = {"error": error.code, "reason": str(error)} if error else {}
            self._journal.note(
                "refused" if error else answered.code,
                cmd=change.cmd,
                id=change.message.id,
                actor=change.actor,
                name=self.actors.name(change.actor),
                **(answered.receipt or {"result": "refused"}) | told | verdict,
            )
            return None
        change.replied = True
        if answered.error is not None:
            return self._refused(change.message, answered.error)
        found = answered.receipt or {}
        body = {"rev": found["revision"], "receipt": found, **verdict}
        if change.cmd == "guard":
            body["result"] = self.guard_summary()
        return self._accepted(change.message, body)

    def _ended(self, pending: Pending, error: CommandError) -> Reply | None:
        if pending.change is not None:
            return self._tell(ChangeReply(pending.change, error))
        return self._refused(pending.message, error)

    def _closed(self, pending: Pending, now_ns: int) -> Reply | None:
        message = pending.message
        answer = pending.answer
        if answer is None:
            self.counts["timeouts"] += 1
            outlook = (
                "it was withdrawn"
                if self._taken_back(pending)
                else "it may still act: check with `get` or `status`"
            )
            reason = f"{message.cmd}: no answer from the servo within 1 s; {outlook}"
            code = "timeout" if self._view.alive else "servo_down"
            return self._ended(pending, CommandError(code, reason))
        if pending.change is not None:
            answered = self._guarded.answered(pending.change, answer, now_ns)
            return self._tell(answered) if answered else None
        if answer.result not in ACCEPTED:
            return self._refused(message, refusal(answer, message.cmd, self._view, self.actors))
        return self._accepted(message, {"rev": answer.revision, "receipt": receipt(answer)})

    def _take_back(self, actor: int) -> None:
        """Withdraw the posted commands of the client `actor` that have not begun. Force that
        already acts is kept.
        """
        keeps_force = self._view.state in (State.ENABLED, State.HOMING)
        # one of each kind: the gateway's own commands have few places in the ring
        undone = [Command.DISABLE] if keeps_force else []
        for one in self._outstanding.asked_by(actor):
            self._withdrawn(one)
            undo = TAKEN_BACK.get(one.kind)
            if undo is not None and undo not in undone:
                undone.append(undo)
                one.mailbox.post(undo, GATEWAY_ACTOR, 0, values_of({}))

    def _withdraw_outdated(self) -> None:
        """Withdraw the commands that were judged by other terms, or whose parts another client has
        leased since.
        """
        for one in self._outstanding.outdated(self._guard.terms_number, self.leases):
            self._withdrawn(one)

    def _withdrawn(self, one: Pending) -> bool:
        """Withdraw `one` from the ring, unless it ends force; return whether that succeeded."""
        ends = one.change and ends_force(one.change.request, self._guard.in_force.target())
        return one.kind in TAKEN_BACK and not ends and one.mailbox.withdraw(one.seq)

    def _taken_back(self, one: Pending) -> bool:
        """Withdraw `one`, which is not answered, or end its force in its first tick; return whether
        that succeeded.
        """
        undo = TAKEN_BACK.get(one.kind)
        withdrawn = self._withdrawn(one)
        if undo is None:
            return withdrawn
        # also if it was withdrawn: a servo suspended while it took the command has a copy
        return one.mailbox.post(undo, GATEWAY_ACTOR, 0, values_of({})) is not None or withdrawn

    def _accepted(self, message: RequestMessage, body: dict[str, Any]) -> Reply:
        return message.reply(
            {"ok": True, "rev": self._view.revision, "state": self._view.state_name} | body
        )

    def _refused(self, message: RequestMessage, error: CommandError | MailboxError) -> Reply:
        self.counts["errors"] += 1
        code, detail = (
            (error.code, error.detail) if isinstance(error, CommandError) else ("servo_down", None)
        )
        content = {"code": code, "message": str(error), "detail": detail or []}
        if isinstance(error, CommandError) and error.guard:
            content["guard"] = error.guard
        return message.reply({"ok": False, "error": content})


def _outlives_a_stop(message: RequestMessage) -> bool:
    """Return whether it would undo a stop, or act after it."""
    return message.cmd == "reset" or bool(message.plain.get("at_tick"))
