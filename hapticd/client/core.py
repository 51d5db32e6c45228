"""The conversation with the gateway without any I/O: requests and replies are bytes, time is passed in, a time-out is a value.

Each request has a number that comes back in its reply, so a reply that arrives after its time-out is recognised and
dropped, and never taken for the answer to a later request.
"""

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import msgpack

from hapticd.errors import CommandError, DaemonDown
from hapticd.units import NS_PER_S

PROTOCOL_VERSION = 1


@dataclass(frozen=True, slots=True)
class Receipt:
    """What became of an accepted change. Ticks count from the start of the servo; `effective` has the shape of a `set`.

    result: "applied" from `first_tick` on, ramps end at `ramp_end_tick`; "scheduled" for `first_tick`, `effective` is what
    is in force until then; "pressed": a stop that took the way of the stop page, which gives no receipt.
    """

    result: str
    state: str = ""
    revision: int = 0
    first_tick: int = 0
    ramp_end_tick: int = 0
    effective: dict[str, Any] = field(default_factory=dict)


class TimedOut(NamedTuple):
    """No reply came within the time allowed. Whether the command acts is open."""

    cmd: str
    waited_s: float


Outcome = dict[str, Any] | TimedOut | None  # a reply, no reply in time, or not yet


class _Asked(NamedTuple):
    cmd: str
    asked_ns: int
    deadline_ns: int


class Conversation:
    """Numbers requests and matches replies."""

    def __init__(self) -> None:
        self._last = 0
        self._asked: dict[int, _Asked] = {}
        self._replies: dict[int, dict[str, Any]] = {}

    def ask(self, cmd: str, fields: dict[str, Any], now_ns: int, timeout_ns: int) -> tuple[int, bytes]:
        """The number and the bytes of a new request; fields that are None are left out."""
        self._last += 1
        self._asked[self._last] = _Asked(cmd, now_ns, now_ns + timeout_ns)
        given = {name: value for name, value in fields.items() if value is not None}
        request = {"cmd": cmd, "v": PROTOCOL_VERSION, "id": self._last, **given}
        return self._last, bytes(msgpack.packb(request, default=_plain))

    def hear(self, payload: bytes) -> None:
        """Take a reply; one that nobody waits for, or that is none, is dropped."""
        try:
            content = msgpack.unpackb(payload)
        except (ValueError, msgpack.UnpackException):
            return
        if isinstance(content, dict) and content.get("id") in self._asked:
            self._replies[content["id"]] = content

    def outcome(self, number: int, now_ns: int) -> Outcome:
        """The reply to request `number`, a TimedOut, or None while there is still time."""
        asked = self._asked[number]
        reply = self._replies.pop(number, None)
        if reply is None and now_ns < asked.deadline_ns:
            return None
        del self._asked[number]
        return reply if reply is not None else TimedOut(asked.cmd, (now_ns - asked.asked_ns) / NS_PER_S)

    def forget(self, number: int) -> None:
        """Nobody waits for the reply to `number` any more."""
        self._asked.pop(number, None)
        self._replies.pop(number, None)


def _plain(value: Any) -> Any:
    """A numpy number as a Python number, so that values may come out of arrays. CommandError: an int beyond 64 bits."""
    if isinstance(value, int):
        raise CommandError(
            "malformed", f"an integer of {value.bit_length()} bits cannot be sent, limit 64; no parameter is so large"
        )
    if not hasattr(value, "item"):
        raise TypeError(f"{value!r} cannot be sent; use numbers, text, lists and maps")
    return value.item()


def accepted(reply: dict[str, Any]) -> dict[str, Any]:
    """`reply` if it says ok. Raises DaemonDown when the gateway has no servo, CommandError for every other refusal."""
    if reply.get("ok"):
        return reply
    error = reply.get("error", {})
    if error.get("code") == "servo_down":
        raise DaemonDown(error.get("message", "the servo does not run"))
    raise CommandError(error.get("code", "unknown"), error.get("message", "no reason given"), error.get("detail"))


def receipt_of(reply: dict[str, Any]) -> Receipt:
    """The receipt in an accepted reply."""
    return Receipt(**reply["receipt"], state=reply["state"])
