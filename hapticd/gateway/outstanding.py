"""Commands on their way: posted, then answered, then seen in force. And those that wait for a tick of their own."""

from typing import NamedTuple

from hapticd.gateway.letters import Letter
from hapticd.mailbox.client_side import Answer
from hapticd.mailbox.layout import Result

MOST_SCHEDULED = 64  # more than a servo holds; older ones have lost their second answer


class Pending(NamedTuple):
    """A posted command whose reply is still to be written."""

    letter: Letter
    actor: int
    life: int  # of the servo it was posted to
    deadline_ns: int
    answer: Answer | None = None


class Outstanding:
    """By servo life and sequence number. Everything leaves by `due` or `abandon`, scheduled ones by their second answer."""

    def __init__(self) -> None:
        self._pending: dict[tuple[int, int], Pending] = {}
        self._scheduled: dict[tuple[int, int], Pending] = {}

    def __len__(self) -> int:
        return len(self._pending)

    def add(self, seq: int, pending: Pending) -> None:
        """A command was posted as number `seq`."""
        self._pending[pending.life, seq] = pending

    def take(self, answer: Answer, life: int) -> Pending | None:
        """Note an answer of servo `life`. If it is the second one of a scheduled command: that command."""
        key = life, answer.seq
        pending = self._pending.get(key)
        if pending is None or pending.answer is not None:
            return self._scheduled.pop(key, None)
        self._pending[key] = pending._replace(answer=answer)
        if answer.result is Result.SCHEDULED:
            self._scheduled[key] = pending
            if len(self._scheduled) > MOST_SCHEDULED:
                del self._scheduled[min(self._scheduled)]
        return None

    def due(self, tick: int, now_ns: int) -> list[Pending]:
        """Remove and return what is to be replied to: refused, scheduled, in force at `tick`, or out of time."""
        ready = [key for key, pending in self._pending.items() if _is_due(pending, tick, now_ns)]
        return [self._pending.pop(key) for key in ready]

    def abandon(self, life: int) -> list[Pending]:
        """Remove and return all that another servo life than `life` was asked; its scheduled ones are forgotten."""
        lost = [pending for pending in self._pending.values() if pending.life != life]
        if lost or any(known != life for known, _ in self._scheduled):
            self._pending = {key: pending for key, pending in self._pending.items() if key[0] == life}
            self._scheduled = {key: pending for key, pending in self._scheduled.items() if key[0] == life}
        return lost


def _is_due(pending: Pending, tick: int, now_ns: int) -> bool:
    answer = pending.answer
    answered = answer is not None and (answer.result is not Result.APPLIED or tick >= answer.first_tick)
    return answered or now_ns >= pending.deadline_ns
