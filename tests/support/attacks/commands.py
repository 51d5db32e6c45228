"""Invalid requests through socket, ZMTP, server and mailbox of the gateway.

Each begins as a valid request, in msgpack or JSON. Values are replaced by hostile ones; fields are
removed, added and nested. A third of the requests then loses, gains or changes bytes. A peer that
speaks ZMTP by hand sends PER_PASS of them at once. A substitute servo executes the commands at its
ticks, and every reply is read. Every message has exactly one reply, which contains `ok` or one
error with a known code. All values that reach the servo's ring are within the limits.
"""

import json
import math
import tempfile
from collections import Counter
from pathlib import Path
from random import Random
from typing import Any

import msgpack

from hapticd.gateway.peers import LONG, MORE, message
from hapticd.mailbox.layout import Command, Result, Value, value_limits
from support.attacks.rows import Losses, Outcome
from support.gateway_rig import GatewayRig
from support.raw_peer import RawPeer

PER_PASS = 18  # a pass takes 20 parts; two of these messages have two parts
TICKS = 4  # of the servo, for each pass
LONGEST_WAIT = 400  # passes for replies that are still due: 1.6 s of virtual time
LONGEST_REPLY = 65_000  # the schema of all requests and answers, in JSON; a status is shorter
CODES = {result.name.lower() for result in Result if result.name.startswith("REFUSED")} | {
    "cancelled",
    "malformed",
    "invalid",
    "unsupported_version",
    "refused",
    "stopped",
    "busy",
    "timeout",
    "servo_down",
    "leased",
    "unsafe",
}
REQUESTS: tuple[dict[str, Any], ...] = (
    {"cmd": "hello", "name": "attack"},
    {"cmd": "get"},
    {"cmd": "set", "K": 100.0, "B": 1.0, "M": 0.01, "ramp_s": 0.1},
    {"cmd": "set", "filters": {"velocity_hz": 90.0, "acceleration_zeta": 0.7}},
    {"cmd": "set", "wall": {"stiffness_n_per_m": 500.0, "position_m": 0.001, "side": 1}},
    {"cmd": "set", "K": 5.0, "active_damping": 1.5, "if_rev": 3, "at_tick": 90},
    {"cmd": "damping", "value": "on"},
    {"cmd": "damping", "value": 1.2, "at_tick": 500},
    {"cmd": "enable"},
    {"cmd": "disable"},
    {"cmd": "stop"},
    {"cmd": "reset"},
    {"cmd": "zero"},
    {"cmd": "home"},
    {"cmd": "withhold", "seconds": 0.1},
    {"cmd": "perturb", "action": "load", "samples_n": [0.1, -0.1, 0.0], "offset": 0},
    {"cmd": "perturb", "action": "start", "loop": True},
    {"cmd": "perturb", "action": "stop"},
    {"cmd": "lease", "what": "environment", "ttl_s": 1.0, "at_end": "hold"},
    {"cmd": "lease", "what": "measuring", "action": "release"},
    {"cmd": "guard", "policy": "warn", "basis": "theorem", "margin_ns_per_m": 0.1},
    {"cmd": "status"},
    {"cmd": "schema"},
)
HOSTILE: tuple[Any, ...] = (
    None,
    True,
    False,
    0,
    -1,
    2**31,
    2**63,
    2**64 - 1,
    -(2**63),
    math.nan,
    math.inf,
    -math.inf,
    1e308,
    5e-324,
    "",
    "on",
    "enable",
    "NaN",
    "\0\x1b[2J",
    "x" * 300,
    "\udcff",
    "\N{FULLWIDTH DIGIT ONE}",
    b"",
    b"\xff" * 24,
    [],
    {},
    [[[[[]]]]],
    {"cmd": "stop"},
    [math.nan] * 9,
)
FIELDS = ("id", "v", "cmd", "K", "filters", "wall", "at_tick", "if_rev", "samples_n", "ttl_s", "x")
IDS = (None, 0, 7, 2**32 - 1, "a", "x" * 60)


def mutated(random: Random) -> bytes:
    """A request that is right, or was."""
    request = {"id": random.choice(IDS)} | random.choice(REQUESTS)
    for _ in range(random.choice((0, 0, 1, 1, 2, 4))):
        request = _changed(request, random)
    encoded = _encoded(request, random.random() < 0.5)
    if random.random() < 0.35:
        encoded = _damaged(encoded, random)
    return encoded


def _changed(request: dict[str, Any], random: Random) -> dict[str, Any]:
    request = dict(request)
    way = random.random()
    if way < 0.15 and request:
        del request[random.choice(list(request))]
    elif way < 0.3:
        request[random.choice(FIELDS)] = random.choice(HOSTILE)
    elif way < 0.4:
        request |= random.choice(REQUESTS)
    elif request:
        name = random.choice(list(request))
        inner = request[name]
        nested = isinstance(inner, dict) and random.random() < 0.7
        request[name] = _changed(inner, random) if nested else random.choice(HOSTILE)
    return request


def _encoded(request: dict[str, Any], as_json: bool) -> bytes:
    if as_json:
        return json.dumps(request, default=lambda data: data.decode("latin-1")).encode()
    return bytes(msgpack.packb(request, unicode_errors="surrogatepass"))


def _damaged(encoded: bytes, random: Random) -> bytes:
    """Return `encoded` with bytes changed, cut, inserted or repeated, or noise."""
    data = bytearray(encoded)
    at = random.randrange(len(data) + 1)
    way = random.randrange(6)
    if way == 0:
        del data[at:]
    elif way == 1:
        data[at:at] = random.randbytes(random.randint(1, 8))
    elif way == 2:
        data[at:at] = data[: random.randint(1, 40)]
    elif way == 3:
        data = bytearray(random.randbytes(random.randint(0, 120)))
    elif data:
        for _ in range(way):
            data[random.randrange(len(data))] ^= 1 << random.randrange(8)
    return bytes(data)


class Attacker:
    """A peer of the gateway that counts the requests sent and the replies received."""

    def __init__(self, rig: GatewayRig, losses: Losses) -> None:
        self.rig = rig
        self.losses = losses
        self.peer = RawPeer(rig, str(rig.gateway.endpoints["command"]))
        self.received = b""
        self.replies = 0
        self.codes: Counter[str] = Counter()
        self.posted = 0
        take = rig.servo.mailbox.take

        def watched() -> Any:
            command = take()
            if command is not None:
                self._within_limits(command)
            return command

        rig.servo.mailbox.take = watched  # type: ignore[method-assign]
        rig.step()
        self._greeted()

    def send(self, payloads: list[bytes]) -> None:
        """All at once; one in nine as a REQ socket sends it."""
        data = b"".join(
            message([b"", payload] if number % 9 == 8 else [payload])
            for number, payload in enumerate(payloads)
        )
        while data:
            data = data[self.peer.send(data) :]
            self.rig.step(TICKS)
            self.read()

    def read(self) -> None:
        """Read every complete reply."""
        came = self.peer.read()
        if came is None:
            self.losses.add("the gateway ended the connection")
            self.peer = RawPeer(self.rig, str(self.rig.gateway.endpoints["command"]))
            self.rig.step()
            self._greeted()
            came = b""
        self.received += came
        place = 0
        while (end := self._frame_end(place)) is not None:
            flags, begin, stop = end
            if not flags & MORE:
                self._reply(self.received[begin:stop])
            place = stop
        self.received = self.received[place:]

    def _frame_end(self, place: int) -> tuple[int, int, int] | None:
        """Return the flags of the frame at `place`, and its start and end; None if incomplete."""
        if len(self.received) <= place:
            return None
        begin = place + (9 if self.received[place] & LONG else 2)
        if len(self.received) < begin:
            return None
        stop = begin + int.from_bytes(self.received[place + 1 : begin], "big")
        return None if len(self.received) < stop else (self.received[place], begin, stop)

    def _greeted(self) -> None:
        self.received = b""
        while len(self.received) < 64 or self._ready_end() is None:
            self.rig.step()
            self.received += self.peer.read() or b""
        self.received = self.received[self._ready_end() :]

    def _ready_end(self) -> int | None:
        end = self._frame_end(64)
        return None if end is None else end[2]

    def _reply(self, body: bytes) -> None:
        self.replies += 1
        as_json = body[:1] == b"{"
        try:
            reply = json.loads(body) if as_json else msgpack.unpackb(body)
            good = isinstance(reply["ok"], bool) and "id" in reply
            code = "" if reply["ok"] else reply["error"]["code"]
        except (ValueError, KeyError, TypeError) as error:
            self.losses.add(f"reply {body[:80]!r}: {error!r}")
            return
        self.codes[code] += 1
        if not good or (code and code not in CODES) or len(body) > LONGEST_REPLY:
            self.losses.add(f"reply {body[:200]!r}")

    def _within_limits(self, command: Any) -> None:
        self.posted += 1
        _, kind, _, _, values = command
        if kind == Command.CANCEL:  # its mask selects the client; it has no values
            return
        for place in (place for place in Value if place and int(values[Value.MASK]) >> place & 1):
            low, high, _ = LIMITS[place]
            if not low <= values[place] <= high:
                self.losses.add(f"command {kind} with {place.name} = {values[place]}")


LIMITS = value_limits(1000.0, 2.0)


def attack(times: int, seed: int) -> Outcome:
    """`times` requests."""
    random = Random(seed)
    losses = Losses()
    with tempfile.TemporaryDirectory() as folder, GatewayRig(Path(folder)) as rig:
        attacker = Attacker(rig, losses)
        sent = 0
        while sent < times:
            count = min(PER_PASS, times - sent)
            attacker.send([mutated(random) for _ in range(count)])
            sent += count
        for _ in range(LONGEST_WAIT):
            if attacker.replies >= sent:
                break
            rig.step(TICKS)
            attacker.read()
        for _ in range(abs(sent - attacker.replies)):
            losses.add(f"{sent} requests, {attacker.replies} replies, seed {seed}")
        attacker.peer.socket.close()
    per_percent = 100.0 / sent
    return losses.outcome(
        sent,
        accepted_percent=per_percent * attacker.codes[""],
        posted_percent=per_percent * attacker.posted,
    )
