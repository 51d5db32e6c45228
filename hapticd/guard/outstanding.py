"""Commands that were posted to the servo, until they are answered and in force.

Commands are identified by servo life and sequence number; scheduled ones wait for their second
answer. The command server and the guard post through this module, so it knows all outstanding
commands.
"""

from typing import NamedTuple

from hapticd.core.errors import CommandError
from hapticd.core.units import NS_PER_S
from hapticd.guard.pending import PendingChange
from hapticd.mailbox.client_side import Answer, GatewayMailbox
from hapticd.mailbox.layout import ANY_TERMS, Command, Result
from hapticd.protocol.codec import RequestMessage
from hapticd.protocol.commands import Posting
from hapticd.protocol.view import ServoView

__all__ = ["Outstanding", "Pending"]

ANSWER_TIMEOUT_NS = NS_PER_S
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

    def of_other_terms(self, number: int) -> list[Pending]:
        """Return the changes that the servo has not yet answered and that were judged by other
        terms than `number`, or by none; nothing if no policy must be enforced.
        """
        return [
            one
            for one in self._pending.values()
            if one.answer is None
            and one.change is not None
            and number not in (one.change.terms, ANY_TERMS)
        ]

    def post(
        self,
        message: RequestMessage,
        actor: int,
        what: Posting,
        now_ns: int,
        change: PendingChange | None = None,
    ) -> None:
        """Put a command into the servo's ring and keep it until it is answered.

        CommandError: no servo is running, or its ring is full.
        """
        self._view.require_servo(message.cmd)
        kind, apply_tick, values = what
        mailbox = self._view.mailbox
        seq = mailbox.post(kind, actor, apply_tick, values) if mailbox else None
        if mailbox is None or seq is None:
            raise CommandError(
                "busy",
                f"{message.cmd}: 64 commands wait for the servo already; slow down and ask again",
            )
        self._pending[self._view.life, seq] = Pending(
            message, actor, kind, mailbox, seq, now_ns + ANSWER_TIMEOUT_NS, change
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


def _is_due(pending: Pending, tick: int, now_ns: int) -> bool:
    answer = pending.answer
    # a refused command changes nothing, so it need not wait for a record
    answered = answer is not None and (
        answer.result is not Result.APPLIED or tick >= answer.first_tick
    )
    return answered or now_ns >= pending.deadline_ns
