"""The client: one connection to a running daemon; synchronous, one thread, never waiting for ever.

Three layers, each above the other. `Conversation` holds the requests and replies without any I/O:
both are bytes, time is passed in, a time-out is a value. Each request has a number that comes back
in its reply, so a reply that arrives after its time-out is recognised and dropped, and never taken
for the answer to a later request. `GatewayLine` holds the sockets: a DEALER for the conversation, a
SUB per subscription. Requests are given only to a gateway that is connected (IMMEDIATE), so one
that starts later finds no old commands in its queue; nothing lingers when the line is closed.
`Client` gives every command a method.

Every call ends within its time-out, with a reply, a CommandError (the daemon refused: `code` and
`detail` say why) or DaemonDown (nobody answers, or the gateway has no servo).

What would break it: use from several threads, since a ZeroMQ socket belongs to one; and waiting for
a reply without a deadline, since a gateway may die between request and reply.
"""

import time
from collections.abc import Generator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, NamedTuple, Self

import msgpack
import numpy as np
import zmq
from numpy.typing import ArrayLike

from hapticd.client.blocks import Block, BlockDecoder, Records
from hapticd.client.lease import ClientLease
from hapticd.errors import CommandError, ConfigError, DaemonDown, MailboxError
from hapticd.gateway.codec import MAX_MESSAGE_BYTES
from hapticd.mailbox.daemons import daemon_folder
from hapticd.mailbox.files import COMMAND_SOCKET, DEFAULT_INSTANCE, TELEMETRY_SOCKET
from hapticd.mailbox.stop_word import press_stop
from hapticd.params import AtEnd, BasisName, DampingMode, Leased, Policy
from hapticd.units import NS_PER_S

PROTOCOL_VERSION = 1
INTRODUCTION_MS = 40  # how long a new socket may take to connect before its hello is given up
MESSAGES_QUEUED = 10_000  # per subscription, before ZeroMQ drops the newest
STOP_TIMEOUT_S = 0.04  # then the stop word is pressed: force off may not wait for a gateway
# 32 kB as float32, half of what a message may hold
CHUNK_SAMPLES = 8192  # of a waveform, in one message
POLL_S = 0.02  # between two looks at the state
STREAMED = ("servo.raw", "probe")  # topics whose messages are blocks of records


@dataclass(frozen=True, slots=True)
class Receipt:
    """What became of an accepted change, as the servo answered.

    Ticks count from the servo's start.
    """

    # "applied": in force from `first_tick` on; "scheduled": will be, and `effective` holds until
    # then; "staged": it has begun, and an event tells the end; "pressed": a stop by way of the
    # stop word, which gives no receipt
    result: str
    state: str = ""  # of the servo: disabled, enabled, homing, stopped, fault
    revision: int = 0  # number of accepted changes in this life of the servo
    first_tick: int = 0  # from which the change acts
    ramp_end_tick: int = 0  # at which the last ramp ends
    effective: dict[str, Any] = field(default_factory=dict)  # parameters in the shape of a `set`
    guard: dict[str, Any] | None = None  # the guard's verdict on it, where one was asked for


class TimedOut(NamedTuple):
    """No reply came within the time allowed. Whether the command acts is open."""

    cmd: str  # name of the command
    waited_s: float


Outcome = dict[str, Any] | TimedOut | None  # a reply, no reply in time, or not yet


class _Asked(NamedTuple):
    """A request whose reply is still to come.

    Times are those of the clock that the caller reads.
    """

    cmd: str
    asked_ns: int
    deadline_ns: int


class Conversation:
    """Numbers requests and matches replies."""

    def __init__(self) -> None:
        self._last = 0
        self._asked: dict[int, _Asked] = {}
        self._replies: dict[int, dict[str, Any]] = {}

    def ask(
        self, cmd: str, fields: dict[str, Any], now_ns: int, timeout_ns: int
    ) -> tuple[int, bytes]:
        """The number and the bytes of a new request; fields that are None are left out."""
        self._last += 1
        self._asked[self._last] = _Asked(cmd, now_ns, now_ns + timeout_ns)
        given = {name: value for name, value in fields.items() if value is not None}
        request = {"cmd": cmd, "v": PROTOCOL_VERSION, "id": self._last, **given}
        return self._last, bytes(msgpack.packb(request, default=_python_number))

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
    raise CommandError(code, reason, error.get("detail"), error.get("guard"))


def receipt_of(reply: dict[str, Any]) -> Receipt:
    """The receipt in an accepted reply."""
    return Receipt(**reply["receipt"], state=reply["state"], guard=reply.get("guard"))


class GatewayLine:
    """Sockets to the gateway of a runtime folder; made when they are first needed."""

    def __init__(self, folder: Path, name: str) -> None:
        self._folder = folder
        self._name = name
        self._conversation = Conversation()
        self._context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        self._socket: zmq.Socket[bytes] | None = None

    def close(self) -> None:
        """Close all sockets; may be called twice."""
        self._context.destroy(linger=0)

    def exchange(self, cmd: str, fields: dict[str, Any], timeout_s: float) -> dict[str, Any]:
        """Send a request; its reply, accepted or not.

        DaemonDown: none in time; CommandError: too long.
        """
        socket = self._connected()
        timeout_ns = round(timeout_s * NS_PER_S)
        number, payload = self._conversation.ask(cmd, fields, time.monotonic_ns(), timeout_ns)
        if len(payload) > MAX_MESSAGE_BYTES:
            limit = f"a request has at most {MAX_MESSAGE_BYTES}; send less at once"
            raise CommandError("malformed", f"{cmd}: {len(payload)} bytes, {limit}")
        unsent: list[bytes] = [payload]
        deadline = time.monotonic() + timeout_s
        while (outcome := self._conversation.outcome(number, time.monotonic_ns())) is None:
            # a negative wait would be one for ever
            wait_ms = max(0, round(1000 * (deadline - time.monotonic())))
            if unsent:
                # with IMMEDIATE it can be written to only when it is connected
                if socket.poll(wait_ms, zmq.POLLOUT):
                    socket.send(unsent.pop())
            elif socket.poll(wait_ms):
                self._conversation.receive(socket.recv())
        if isinstance(outcome, TimedOut):
            silence = f"no reply from {self._folder} within {outcome.waited_s:.2g} s"
            raise DaemonDown(f"{cmd}: {silence}; is `hapticd run` running there?")
        return outcome

    def _connected(self) -> "zmq.Socket[bytes]":
        """The command socket; made, and the client introduced, when it is first needed."""
        path = self._folder / COMMAND_SOCKET
        if not path.exists():
            raise DaemonDown(f"{path}: no daemon runs there; start it with `hapticd run`")
        if self._socket is None:
            self._socket = self._context.socket(zmq.DEALER)
            self._socket.setsockopt(zmq.LINGER, 0)
            self._socket.setsockopt(zmq.IMMEDIATE, 1)
            self._socket.connect(f"ipc://{path}")
            self._introduce(self._socket)
        return self._socket

    def _introduce(self, socket: "zmq.Socket[bytes]") -> None:
        number, payload = self._conversation.ask("hello", {"name": self._name}, 0, 0)
        # nobody waits for this reply: `receive` drops it
        self._conversation.forget(number)
        if socket.poll(INTRODUCTION_MS, zmq.POLLOUT):
            socket.send(payload)

    def listen(self, topic: str, timeout_s: float) -> Generator[bytes, None, None]:
        """Payloads of exactly `topic`. DaemonDown after silence for `timeout_s`."""
        # events may be rare: there the state, which comes every second, shows that the gateway
        # lives
        with self._subscribed({topic, "state"} if topic == "event" else {topic}) as socket:
            while socket.poll(round(1000 * timeout_s)):
                name, payload = socket.recv_multipart()
                if (
                    name == topic.encode()
                ):  # ZeroMQ matches prefixes: `servo` brings `servo.raw` too
                    yield payload
        raise DaemonDown(
            f"{topic}: nothing from {self._folder} for {timeout_s} s; see `hapticd status`"
        )

    def listen_all(
        self, topics: Sequence[str], look_s: float
    ) -> Generator[tuple[str, bytes] | None, None, None]:
        """(topic, payload) of several topics as they come, None after each look; it never ends.

        It looks every `look_s` and sleeps in between: being woken by every message would cost more
        than taking them.
        """
        with self._subscribed(set(topics)) as socket:
            while True:
                time.sleep(look_s)
                while socket.poll(0):
                    name, payload = socket.recv_multipart()
                    if name.decode() in topics:
                        yield name.decode(), payload
                yield None

    def _subscribed(self, topics: set[str]) -> "zmq.Socket[bytes]":
        path = self._folder / TELEMETRY_SOCKET
        if not path.exists():
            raise DaemonDown(f"{path}: no daemon runs there; start it with `hapticd run`")
        socket = self._context.socket(zmq.SUB)
        socket.setsockopt(zmq.LINGER, 0)
        socket.setsockopt(zmq.RCVHWM, MESSAGES_QUEUED)
        for topic in topics:
            socket.setsockopt_string(zmq.SUBSCRIBE, topic)
        socket.connect(f"ipc://{path}")
        return socket


class Client:
    """One connection to the daemon `instance`, best used as a context manager.

    `timeout_s` bounds every call; `name` is shown beside what this client changes; `folder` is the
    runtime folder where it is not that of the instance.
    """

    def __init__(
        self,
        instance: str = DEFAULT_INSTANCE,
        timeout_s: float = 2.0,
        name: str = "script",
        folder: Path | None = None,
    ) -> None:
        self._folder = folder or daemon_folder(instance)
        self._timeout_s = timeout_s
        self._name = name
        self._line = GatewayLine(self._folder, name)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Give up the connection; may be called twice."""
        self._line.close()

    # --- asking -----------------------------------------------------------------------------------

    def call(self, cmd: str, **fields: Any) -> dict[str, Any]:
        """Send any command; its whole reply {ok, id, rev, state, result or receipt}.

        CommandError where the daemon refuses, DaemonDown where none answers in time.
        """
        return accepted(self._line.exchange(cmd, fields, self._timeout_s))

    def hello(self) -> dict[str, Any]:
        """Versions, limits, endpoints and topics of the daemon."""
        return self._result("hello", name=self._name)

    def get(self) -> dict[str, Any]:
        """{parameters: what was asked, ramps at their ends; in_force: what acts at this tick}."""
        return self._result("get")

    def status(self) -> dict[str, Any]:
        """State, fault, counters, stage times, what the servo was granted, the last events."""
        return self._result("status")

    def schema(self) -> dict[str, Any]:
        """The protocol as JSON schema, with units and the limits of this device."""
        return self._result("schema")

    # --- changing ---------------------------------------------------------------------------------

    def set(
        self,
        *,
        K: float | None = None,
        B: float | None = None,
        M: float | None = None,
        filters: dict[str, float] | None = None,
        wall: dict[str, float] | None = None,
        damping: float | None = None,
        ramp_s: float | None = None,
        at_tick: int | None = None,
        if_rev: int | None = None,
        limit_cycle_faults: bool | None = None,
    ) -> Receipt:
        """Change what is rendered; what is not given stays.

        `K` virtual stiffness [N/m], `B` virtual damping [N s/m], `M` virtual mass [kg], `damping`
        active damping [N s/m]; `filters` and `wall` by the names of `hapticd set`. `ramp_s` is the
        length of the ramp [s], `at_tick` the servo tick from which it acts, and with `if_rev` it
        acts only if the revision is still that one. `limit_cycle_faults`: whether force_at_limit
        and energy end a limit cycle; on again as soon as force is off.
        """
        return self._change(
            "set",
            K=K,
            B=B,
            M=M,
            filters=filters,
            wall=wall,
            damping=damping,
            ramp_s=ramp_s,
            at_tick=at_tick,
            if_rev=if_rev,
            limit_cycle_faults=limit_cycle_faults,
        )

    def damping(self, value: Literal["on", "off", "auto"] | float) -> Receipt:
        """Switch the active damping, set its level [N s/m] and switch it on, or have the guard
        choose the least level that will do.
        """
        return self._change("damping", value=value)

    def guard(
        self,
        policy: Policy | None = None,
        *,
        basis: BasisName | None = None,
        margin_ns_per_m: float | None = None,
        mode: DampingMode | None = None,
    ) -> dict[str, Any]:
        """Change what is done with environments that are not known to be passive, or only ask.

        `margin_ns_per_m` is the damping that has to be left [N s/m], `mode` that of the active
        damping. {policy, basis, margin_ns_per_m, mode, worker, delay_periods, verdict, ..}.
        """
        return self._result(
            "guard", policy=policy, basis=basis, margin_ns_per_m=margin_ns_per_m, mode=mode
        )

    def hand(self, verdict: dict[str, Any], timeout_s: float = 1.0) -> dict[str, Any] | None:
        """The hand that would shake what `verdict` is about: the event `guard` with `text`.

        None if `timeout_s` passes first.
        """
        deadline = time.monotonic() + timeout_s
        while time.monotonic() < deadline:
            for event in reversed(self.status()["events"]):
                if event["kind"] == "guard" and event["number"] == verdict.get("number"):
                    return dict(event)
            time.sleep(POLL_S)
        return None

    def enable(self) -> Receipt:
        """Force on, with a gain ramp."""
        return self._change("enable")

    def disable(self) -> Receipt:
        """Force off."""
        return self._change("disable")

    def reset(self) -> Receipt:
        """From `stopped` or `fault` to `disabled`."""
        return self._change("reset")

    def zero(self) -> Receipt:
        """Here is x = 0; only in `disabled`."""
        return self._change("zero")

    def home(self) -> Receipt:
        """Begin to look for the origin; only in `disabled`, to which it returns afterwards."""
        return self._change("home")

    def stop(self) -> Receipt:
        """Latched stop.

        Without a reply within 40 ms the stop word is pressed, which the servo reads.

        DaemonDown if there is no servo either.
        """
        try:
            return receipt_of(accepted(self._line.exchange("stop", {}, STOP_TIMEOUT_S)))
        except (DaemonDown, CommandError):
            try:
                press_stop(self._folder)
            except MailboxError as error:
                raise DaemonDown(str(error)) from error
            return Receipt("pressed")

    def lease(
        self,
        what: Leased,
        *,
        ttl_s: float | None = None,
        at_end: AtEnd | None = None,
        take_over: bool = False,
    ) -> ClientLease:
        """Be the only one who changes `what`, as a context: see ClientLease.

        It ends when this client asks nothing for `ttl_s`, and at once when it dies; the environment
        then goes as `at_end` says, damping stays. `take_over`: end another's.
        """
        return ClientLease(self.call, what, ttl_s=ttl_s, at_end=at_end, take_over=take_over or None)

    def perturb_load(self, samples_n: ArrayLike) -> int:
        """Load a waveform: force [N] at 4 kHz, shape (n,). The number of samples the daemon has."""
        samples = np.asarray(samples_n, "<f4").ravel()
        loaded: int = 0
        for start in range(0, max(len(samples), 1), CHUNK_SAMPLES):
            chunk = samples[start : start + CHUNK_SAMPLES].tobytes()
            loaded = self._result("perturb", action="load", samples_n=chunk, offset=start)[
                "samples"
            ]
        return loaded

    def perturb_start(self, loop: bool = False) -> Receipt:
        """Play the loaded waveform, once or until stopped."""
        return self._change("perturb", action="start", loop=loop)

    def perturb_stop(self) -> Receipt:
        """Stop playing."""
        return self._change("perturb", action="stop")

    def dump(self) -> dict[str, Any]:
        """Write the flight recording; {path, records, reason}.

        The file appears soon after this returns, and is whole when it does.
        """
        return self._result("dump")

    # --- watching ---------------------------------------------------------------------------------

    def wait_for(self, state: str, timeout_s: float = 10.0) -> None:
        """Return when the servo is in `state`.

        CommandError `timeout` or DaemonDown after `timeout_s`.
        """
        deadline = time.monotonic() + timeout_s
        while True:
            try:
                found = self.call("get")["state"]
            except DaemonDown:
                if time.monotonic() >= deadline:
                    raise
                # a daemon that is being started does not answer yet
                found = "down"
            if found == state:
                return
            if time.monotonic() >= deadline:
                reason = f"state is {found!r}, not {state!r}, after {timeout_s} s"
                raise CommandError("timeout", f"{reason}; see `hapticd status`")
            time.sleep(POLL_S)

    def stream(
        self, topic: str = "servo.raw", seconds: float | None = None, count: int | None = None
    ) -> Generator[Block, None, None]:
        """Blocks of `servo.raw` (one record a tick) or `probe` (4 kHz) as they come: see Block.

        `seconds` of recorded time or `count` records, the last block cut to fit; without either,
        until you stop. DaemonDown when nothing comes for the client's time-out; ConfigError for a
        topic without blocks (see `listen`).
        """
        if topic not in STREAMED:
            known = f"stream takes {' or '.join(STREAMED)}, listen takes every topic"
            raise ConfigError(f"topic {topic!r} has no blocks: {known}")
        decoder = BlockDecoder()
        taken = 0
        end_ns = None
        for payload in self._line.listen(topic, self._timeout_s):
            block = decoder.decode(payload)
            records = block.records
            if seconds is not None and len(records):
                end_ns = end_ns or int(records["time_ns"][0]) + round(seconds * NS_PER_S)
                records = records[records["time_ns"] < end_ns]
            if count is not None:
                records = records[: count - taken]
            taken += len(records)
            if len(records):
                yield Block(records, block.gap, block.restarted, block.header)
            if len(records) < len(block.records) or taken == count:
                return

    def record(self, seconds: float, topic: str = "servo.raw") -> tuple[Records, int]:
        """All records of the next `seconds` in one structured array (n,), and how many it lacks."""
        blocks = list(self.stream(topic, seconds=seconds))
        records = np.concatenate([block.records for block in blocks])
        return records, sum(block.gap for block in blocks)

    def listen(self, topic: str) -> Generator[Any, None, None]:
        """Decoded messages of `state`, `event` or `servo` as they come.

        DaemonDown when the daemon is silent for the client's time-out.
        """
        for payload in self._line.listen(topic, self._timeout_s):
            yield msgpack.unpackb(payload)

    def messages(
        self, topics: Sequence[str], look_s: float = 0.05
    ) -> Generator[tuple[str, bytes] | None, None, None]:
        """Raw (topic, payload) of several topics, endlessly; None after each look.

        A look every `look_s` takes all that came meanwhile.
        """
        yield from self._line.listen_all(topics, look_s)

    def _result(self, cmd: str, **fields: Any) -> dict[str, Any]:
        result: dict[str, Any] = self.call(cmd, **fields)["result"]
        return result

    def _change(self, cmd: str, **fields: Any) -> Receipt:
        return receipt_of(self.call(cmd, **fields))
