"""Requests and replies: both are bytes, time is passed in, a time-out is a value.

Each request has a number that comes back in its reply, so a reply that arrives after its time-out
is recognised and dropped, and never taken for the answer to a later request. The client that waits
(`client`) and the one of asyncio (`aio`) are two ways of carrying these bytes.

Each socket must have one tracker, since every tracker counts from 1.
"""

from pathlib import Path
from typing import Any, NamedTuple

import msgpack
import zmq

from hapticd.core.errors import CommandError, ConfigError, DaemonDown, MailboxError
from hapticd.core.units import NS_PER_S
from hapticd.mailbox.daemons import down, instance_of
from hapticd.mailbox.files import COMMAND_SOCKET
from hapticd.mailbox.stop_word import press_stop
from hapticd.protocol.answers import Event, Receipt, answer_of, verdict_of
from hapticd.protocol.codec import MAX_MESSAGE_BYTES

__all__ = ["accepted", "receipt_of"]

PROTOCOL_VERSION = 1
STOP_TIMEOUT_S = 0.04  # then the stop word is pressed: force off may not wait for a gateway


class TimedOut(NamedTuple):
    """No reply came within the time allowed. Whether the command acts is open."""

    cmd: str  # name of the command
    waited_s: float


Context = zmq.Context[Any]
Outcome = dict[str, Any] | TimedOut | None  # a reply, no reply in time, or not yet


class _Asked(NamedTuple):
    """A request whose reply is still to come.

    Times are those of the clock that the caller reads.
    """

    cmd: str
    asked_ns: int
    deadline_ns: int


class RequestTracker:
    """Numbers requests and matches replies."""

    def __init__(self) -> None:
        self._last = 0
        self._asked: dict[int, _Asked] = {}
        self._replies: dict[int, dict[str, Any]] = {}

    def ask(
        self, cmd: str, fields: dict[str, Any], now_ns: int, timeout_ns: int
    ) -> tuple[int, bytes]:
        """The number and the bytes of a new request; fields that are None are left out.

        CommandError: more bytes than a request may have.
        """
        given = {name: value for name, value in fields.items() if value is not None}
        request = {"cmd": cmd, "v": PROTOCOL_VERSION, "id": self._last + 1, **given}
        payload = bytes(msgpack.packb(request, default=_python_number))
        if len(payload) > MAX_MESSAGE_BYTES:
            limit = f"a request has at most {MAX_MESSAGE_BYTES}; send less at once"
            raise CommandError("malformed", f"{cmd}: {len(payload)} bytes, {limit}")
        self._last += 1
        self._asked[self._last] = _Asked(cmd, now_ns, now_ns + timeout_ns)
        return self._last, payload

    def introduction(self, name: str) -> bytes:
        """The bytes of a hello; nobody waits for its reply, so `receive` drops it."""
        number, payload = self.ask("hello", {"name": name}, 0, 0)
        self.forget(number)
        return payload

    def receive(self, payload: bytes) -> None:
        """Take a reply; what nobody waits for, and what is no reply, is dropped."""
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
        return (
            reply
            if reply is not None
            else TimedOut(asked.cmd, (now_ns - asked.asked_ns) / NS_PER_S)
        )

    def forget(self, number: int) -> None:
        """Nobody waits for the reply to `number` any more."""
        self._asked.pop(number, None)
        self._replies.pop(number, None)


def _python_number(value: Any) -> Any:
    """A numpy number as a Python number, so that values may come out of arrays.

    msgpack calls this for what it cannot pack: CommandError for an int beyond 64 bits, TypeError
    for what is no number at all.
    """
    if isinstance(value, int):
        bits = value.bit_length()
        reason = f"an integer of {bits} bits cannot be sent, limit 64; no parameter is so large"
        raise CommandError("malformed", reason)
    if not hasattr(value, "item"):
        raise TypeError(f"{value!r} cannot be sent; use numbers, text, lists and maps")
    return value.item()


def accepted(reply: dict[str, Any]) -> dict[str, Any]:
    """`reply` if it says ok.

    DaemonDown: the gateway has no servo; CommandError: any other refusal.
    """
    if reply.get("ok"):
        return reply
    error = reply.get("error", {})
    code = error.get("code", "unknown")
    if code == "servo_down":
        raise DaemonDown(error.get("message", "the servo does not run"))
    reason = error.get("message", "no reason given")
    raise CommandError(code, reason, error.get("detail"), verdict_of(error.get("guard")))


def receipt_of(reply: dict[str, Any]) -> Receipt:
    """The receipt in an accepted reply."""
    content = {"state": reply["state"], "guard": reply.get("guard") or None}
    return answer_of(Receipt, {**reply["receipt"], **content})


def silence(outcome: TimedOut, folder: Path) -> DaemonDown:
    """The error for a request to the daemon in `folder` that nobody answered."""
    waited = f"no reply from {folder} within {outcome.waited_s:.2g} s"
    return DaemonDown(f"{outcome.cmd}: {waited}; is `hapticd run` running there?")


def quiet(topic: str, folder: Path, timeout_s: float) -> DaemonDown:
    """The error for `topic` of the daemon in `folder`, which was silent for `timeout_s`."""
    return DaemonDown(f"{topic}: nothing from {folder} for {timeout_s} s; see `hapticd status`")


def not_reached(wanted: str, found: str, timeout_s: float) -> CommandError:
    """The error for a servo that is `found`, and not `wanted`, after `timeout_s`."""
    reason = f"state is {found!r}, not {wanted!r}, after {timeout_s} s"
    return CommandError("timeout", f"{reason}; see `hapticd status`")


def check_topic(topic: str) -> None:
    """ConfigError: no daemon publishes `topic`."""
    from hapticd.protocol.telemetry import NAMES  # numpy, which a verb at the shell does without

    if topic not in NAMES:
        raise ConfigError(f"topic {topic!r} is unknown; topics are {', '.join(sorted(NAMES))}")


def message_of(topic: str, payload: bytes) -> Any:
    """A message of `topic`: an `Event`, or a map."""
    plain = msgpack.unpackb(payload)
    return answer_of(Event, plain) if topic == "event" else plain


def heard_with(topic: str) -> set[str]:
    """The topics to subscribe to for `topic`: events may be rare, and the state, which comes every
    second, shows that the gateway lives.
    """
    return {topic, "state"} if topic == "event" else {topic}


def pressed(folder: Path) -> Receipt:
    """Press the stop word of the daemon in `folder`. DaemonDown if there is no servo either."""
    try:
        press_stop(folder)
    except MailboxError as error:
        raise DaemonDown(str(error)) from error
    return Receipt("pressed")


def command_socket(context: Context, folder: Path) -> tuple[Any, Any]:
    """The command socket of the daemon in `folder`, and one with a message for each connection that
    it makes. DaemonDown if there is none.

    Requests are given only to a gateway that is connected (IMMEDIATE): one that starts later finds
    no old commands.
    """
    path = socket_file(folder, COMMAND_SOCKET)
    socket = context.socket(zmq.DEALER)
    socket.setsockopt(zmq.LINGER, 0)
    socket.setsockopt(zmq.IMMEDIATE, 1)
    made = socket.get_monitor_socket(zmq.EVENT_CONNECTED)
    socket.connect(f"ipc://{path}")
    return socket, made


def socket_file(folder: Path, name: str) -> Path:
    """The socket `name` of the daemon in `folder`. DaemonDown if there is none."""
    path = folder / name
    if not path.exists():
        raise down(f"{path}: ", instance_of(folder))
    return path
