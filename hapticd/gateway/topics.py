"""Every topic in one table, and who wants which.

A telemetry message is always two frames, [topic, payload], and every payload is one msgpack value: a map or an array of maps.

The prefix trap. ZeroMQ matches subscriptions by prefix, at the publisher and again at the subscriber, so whoever asks for
`servo` is also sent `servo.raw` while somebody else has asked for that. No order of frames avoids it as long as the
frame is the topic's plain name, and it has to be: PlotJuggler subscribes to what its user types. So
- here, a subscription wants the topic of exactly that name; only a prefix that is no topic (`""`, `s`, `servo.`) wants all
  topics it begins. `servo` alone therefore never causes a `servo.raw` to be encoded;
- at the subscriber, hapticd's client compares the first frame with the topic; a foreign one that does not do so decodes
  a msgpack map of a few numbers and one binary, which PlotJuggler and generic decoders skip.
"""

from typing import NamedTuple


class Topic(NamedTuple):
    """One row: what is in a payload, how often it comes, and how many ticks share one sample of it."""

    name: str
    content: str
    rate: str
    decimation: int  # servo ticks per sample; 0: not tied to ticks


TOPICS: tuple[Topic, ...] = (
    Topic("servo", "array of maps of numbers, `timestamp` in Unix seconds, `seq` +1 per tick", "`batch` ticks a message", 1),
    Topic("servo.raw", "map: header and `d`, little-endian records of dtype `descr`, lossless", "`batch` ticks or more", 1),
    Topic("probe", "map: header and `d`, 4 kHz torque and velocity in counts, index and host time", "as `servo.raw`", 1),
    Topic("state", "map: state, fault, revision, parameters, counters", "on change, at 1 Hz, on subscription", 0),
    Topic("event", "map with `kind`: state, answer, gap, servo_up, servo_down, flight, warning", "when it happens", 0),
    Topic("flight", "map: requests that the servo obeyed, checkpoints of its state; for flying records again", "when there are", 0),
)  # fmt: skip
NAMES = frozenset(topic.name for topic in TOPICS)
BY_NAME = {topic.name: topic for topic in TOPICS}


def wanted_by(prefix: bytes) -> frozenset[str]:
    """Topics that a subscription to `prefix` wants."""
    text = prefix.decode("ascii", errors="replace")
    return frozenset({text}) if text in NAMES else frozenset(name for name in NAMES if name.startswith(text))


class Subscriptions:
    """The set of live subscriptions, as XPUB reports them: each first one and, with XPUB_VERBOSE, each repeated one."""

    def __init__(self) -> None:
        self._prefixes: set[bytes] = set()
        self.wanted: frozenset[str] = frozenset()

    def take(self, message: bytes) -> frozenset[str]:
        """Note one message of the XPUB socket; topics that it newly asks for. Prefixes of no topic are not kept."""
        kind, prefix = message[:1], message[1:]
        topics = wanted_by(prefix)
        if not topics or kind not in (b"\0", b"\1"):
            return frozenset()
        (self._prefixes.add if kind == b"\1" else self._prefixes.discard)(prefix)
        self.wanted = frozenset().union(*map(wanted_by, self._prefixes))
        return topics if kind == b"\1" else frozenset()
