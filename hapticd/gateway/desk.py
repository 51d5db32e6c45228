"""Requests in, replies out: no socket, no clock.

A request is opened, judged by the interlocks and, if the servo is concerned, posted to its command ring; its reply is
written when the servo's answer is there and the newest record shows it in force, so `state` in a reply is never older than
the command. Nobody waits: `serve` takes what came, `collect` gives what is due, also the replies to what the servo left
unanswered for a second. STOP goes first among what came together, skips every interlock, and presses the stop page when
others are ahead of it in the ring. What would break it: a request that is forgotten (each has a deadline), or a reply that
repeats what a client sent (it holds nothing foreign but a bounded id and a few printable characters).
"""

from collections.abc import Callable, Sequence
from typing import Any

from hapticd.errors import CommandError, MailboxError
from hapticd.gateway.actors import Actors
from hapticd.gateway.commands import ACCEPTED, Posting, parameters, posting, receipt, refusal, values_of
from hapticd.gateway.events import Journal
from hapticd.gateway.explain import json_schema
from hapticd.gateway.interlocks import Scene, admit
from hapticd.gateway.letters import Letter, opened
from hapticd.gateway.limits import Limits
from hapticd.gateway.outstanding import Outstanding, Pending
from hapticd.gateway.perturbation import Waveform
from hapticd.gateway.schemas import Hello, Perturb, Request
from hapticd.gateway.view import ServoView
from hapticd.mailbox.client_side import Answer, press_stop
from hapticd.mailbox.layout import Command
from hapticd.units import NS_PER_S

ANSWER_TIMEOUT_NS = NS_PER_S
TAKEN_BACK = {"enable": Command.DISABLE, "home": Command.DISABLE, "perturb": Command.PERTURB_STOP}  # what brings force
TAKEN_PER_TICK = 2  # by the servo; a stop behind more commands than that presses the page as well
PAST_TICK, GATEWAY_ACTOR = 1, 1
IN_FORCE = (
    "tick", "gain", "stiffness_n_per_m", "damping_ns_per_m", "mass_kg", "added_damping_asked_ns_per_m", "added_damping_ns_per_m",
)  # fmt: skip
SERVO_ENDED = CommandError("servo_down", "the servo ended before it answered; when it starts anew it is disabled")

Reply = list[bytes]


class Desk:
    """The command side of the gateway. `inquire(cmd)` is the content of the replies to hello and status."""

    def __init__(self, view: ServoView, journal: Journal, inquire: Callable[[str], dict[str, Any]]) -> None:
        self._view, self._journal, self._inquire = view, journal, inquire
        self.limits = Limits(view.params)
        self.schema = json_schema(self.limits)
        self.actors = Actors()
        self.counts = {"requests": 0, "errors": 0, "timeouts": 0}
        self._waveform = Waveform(self.limits)
        self._outstanding = Outstanding()
        self._asked_life = 0

    @property
    def waiting(self) -> bool:
        """Whether answers are due, so that looking often is worth it."""
        return len(self._outstanding) > 0

    def serve(self, messages: Sequence[Sequence[bytes]], now_ns: int, outdated: bool = False) -> list[Reply]:
        """Take requests that came together, stops first; the replies that can be given at once. `outdated`: stops alone count."""
        letters = sorted(map(opened, messages), key=lambda letter: letter.cmd != "stop")
        self.counts["requests"] += len(letters)
        return [reply for letter in letters if (reply := self._attend(letter, now_ns, outdated)) is not None]

    def collect(self, now_ns: int) -> list[Reply]:
        """Read the servo's answers; the replies that are due."""
        lost = self._outstanding.abandon(self._view.life if self._view.mailbox else 0)
        self._ask_back()
        try:
            for answer in self._view.answers():
                if scheduled := self._outstanding.take(answer, self._view.life):
                    self._report(scheduled, answer)
        except MailboxError as error:
            self._journal.note("warning", text=str(error))
        due = self._outstanding.due(self._view.tick, now_ns)
        return [self._refused(one.letter, SERVO_ENDED) for one in lost] + [self._closed(one) for one in due]

    def _attend(self, letter: Letter, now_ns: int, outdated: bool) -> Reply | None:
        try:
            if letter.error:
                raise letter.error
            actor = self.actors.number(letter.client)
            if letter.cmd == "stop":
                return self._stop(letter, actor, now_ns)
            if outdated:
                reason = "the gateway stood still for more than 1 s and drops what came meanwhile; ask again"
                raise CommandError("timeout", f"{letter.cmd}: {reason}")
            scene = Scene(self.limits, self._view, not self.waiting, self._waveform.samples(self._view))
            request = admit(letter.plain, actor, scene)
            result = self._answered_here(request, letter)
            if result is not None:
                return self._accepted(letter, {"result": result})
            self._post(letter, actor, posting(request, scene.samples), now_ns)
            return None
        except (CommandError, MailboxError) as error:
            return self._refused(letter, error)

    def _answered_here(self, request: Request, letter: Letter) -> dict[str, Any] | None:
        if isinstance(request, Hello):
            self.actors.call(letter.client, request.name)
            return self._inquire("hello") | {"actor": self.actors.number(letter.client), "limits": self.limits.plain()}
        if isinstance(request, Perturb) and request.action == "load":
            return self._load(request, self.actors.number(letter.client))
        if request.cmd == "status":
            return self._inquire("status") | {"requests": dict(self.counts)}
        if request.cmd == "dump":
            return self._inquire("dump")
        if request.cmd == "schema":
            return self.schema
        if request.cmd == "get":
            self._require_servo("get")
            now = {name: self._view.record[name] for name in IN_FORCE if name in self._view.record}
            return {"parameters": parameters(self._view.targets), "in_force": now}
        return None

    def _load(self, request: Perturb, actor: int) -> dict[str, Any]:
        if self.waiting or self._view.record.get("perturbing"):
            raise CommandError("busy", "perturb load: a waveform may be playing; stop it first")
        return {"samples": self._waveform.load(request, self._view, actor)}

    def _require_servo(self, cmd: str) -> None:
        if not self._view.alive:
            raise CommandError("servo_down", f"{cmd}: no servo answers; start it with `hapticd run`, see `hapticd status`")

    def _post(self, letter: Letter, actor: int, what: Posting, now_ns: int) -> None:
        self._require_servo(letter.cmd)
        kind, apply_tick, values = what
        seq = self._view.mailbox.post(kind, actor, apply_tick, values) if self._view.mailbox else None
        if seq is None:
            raise CommandError("busy", f"{letter.cmd}: 64 commands wait for the servo already; slow down and ask again")
        self._outstanding.add(seq, Pending(letter, actor, self._view.life, now_ns + ANSWER_TIMEOUT_NS))

    def _stop(self, letter: Letter, actor: int, now_ns: int) -> Reply | None:
        mailbox = self._view.mailbox
        behind = mailbox is None or not self._view.alive or mailbox.backlog >= TAKEN_PER_TICK
        pressed = behind and self._pressed()
        try:
            self._post(letter, actor, (Command.STOP, 0, values_of({})), now_ns)
        except CommandError as error:
            if not pressed or error.code != "busy":
                raise
            return self._accepted(letter, {"receipt": {"result": "pressed"}})
        return None

    def _pressed(self) -> bool:
        """Whether the stop page could be pressed and a living servo will look at it."""
        try:
            press_stop(self._view.folder)
        except MailboxError:
            return False
        return True

    def _ask_back(self) -> None:
        """Learn the parameters after a restart of the gateway: a set for a tick long past is refused, and tells them."""
        if self._view.unsure and self._asked_life != self._view.life and self._view.mailbox:
            asked = self._view.mailbox.post(Command.SET, GATEWAY_ACTOR, PAST_TICK, values_of({}))
            self._asked_life = self._asked_life if asked is None else self._view.life

    def _report(self, scheduled: Pending, answer: Answer) -> None:
        letter, actor = scheduled.letter, scheduled.actor
        self._journal.note("answer", cmd=letter.cmd, id=letter.id, actor=actor, name=self.actors.name(actor), **receipt(answer))

    def _closed(self, pending: Pending) -> Reply:
        letter, answer = pending.letter, pending.answer
        if answer is None:
            self.counts["timeouts"] += 1
            outlook = "it is taken back" if self._taken_back(letter) else "whether it acts is open, ask with `get` or `status`"
            reason = f"{letter.cmd}: no answer from the servo within 1 s; {outlook}"
            return self._refused(letter, CommandError("timeout" if self._view.alive else "servo_down", reason))
        if answer.result not in ACCEPTED:
            return self._refused(letter, refusal(answer, letter.cmd, self._view))
        return self._accepted(letter, {"rev": answer.revision, "receipt": receipt(answer)})

    def _taken_back(self, letter: Letter) -> bool:
        """Whether a force that comes late, when nobody expects it any more, will end in the tick in which it begins."""
        kind, mailbox = TAKEN_BACK.get(letter.cmd), self._view.mailbox
        return kind is not None and mailbox is not None and mailbox.post(kind, GATEWAY_ACTOR, 0, values_of({})) is not None

    def _accepted(self, letter: Letter, body: dict[str, Any]) -> Reply:
        return letter.reply({"ok": True, "rev": self._view.revision, "state": self._view.state_name} | body)

    def _refused(self, letter: Letter, error: CommandError | MailboxError) -> Reply:
        self.counts["errors"] += 1
        code, detail = (error.code, error.detail) if isinstance(error, CommandError) else ("servo_down", None)
        return letter.reply({"ok": False, "error": {"code": code, "message": str(error), "detail": detail or []}})
