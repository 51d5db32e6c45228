"""Events, their actors, and explanations of verdicts: codes, and the text made of them.

Events (`Journal`). They are maps, kept for `status`, and queued for the topic `event`. Each has a
`kind`, a `code` and the fields of `answers.Event` that belong to it. Programs use these. The `text`
is for people, whatever the language and version of the client. Only this module makes it, from the
code and the fields.

Actors (`Actors`). An actor is a small number for each client, which every tick record contains, and
the name that the client has chosen. Both exist as long as the connection, and are remembered for
the clients that left last. Numbers are never reused in a servo life, even by another gateway.

Explanation (`Explanation`). It consists of an outcome, typed reasons and remedies, and the sentence
made of them. Programs read the codes. The texts are for users: reasons follow each other, remedies
are alternatives and are joined by "or".
"""

from collections import OrderedDict, deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass
from enum import StrEnum
from string import Formatter
from typing import Any, Final, Literal, Self

from hapticd.core.params import LEAST_IDLE_SHARE
from hapticd.core.units import NS_PER_S
from hapticd.mailbox.daemons import ACTOR_STOP_WORD

__all__ = [
    "EVENTS",
    "GATEWAY_ACTOR",
    "Actors",
    "EventCode",
    "Explanation",
    "Journal",
    "Outcome",
    "Reason",
    "Remedy",
    "sentence",
]

# --- events ---------------------------------------------------------------------------------------

KEPT = 32
QUEUED = 256
STAYS = "; the environment in force stays"
LEASE = "the lease of {what} by {name} (actor {actor}) "
PROXY = "the proxy of {name} (actor {actor}) stays at {position_m:.4g} m: "

EventCode = Literal[
    "state", "fault", "servo_up", "servo_down", "gap", "flight", "mark", "controlled",
    "answered", "refused", "superseded", "asked_meanwhile", "changed_before", "state_left",
    "stood_still", "damping_late", "ramps_late", "other_terms", "client_gone", "client_failed",
    "hand", "no_hand",
    "lease_taken", "lease_released", "lease_taken_over", "lease_silent", "lease_gone",
    "lease_failed",
    "proxy_taken", "proxy_held", "proxy_lease", "proxy_stopped",
    "tick_too_long", "damping_low", "not_passive", "terms_not_kept", "terms_after_restart",
    "answers_lost", "flight_not_written", "telemetry_open", "port_taken", "listener_refused",
    "key_unreadable", "relay_ended",
]  # fmt: skip
# of every event its kind and its sentence, whose later parts may be left out (`sentence`)
EVENTS: Final[dict[EventCode, tuple[str, ...]]] = {
    "state": ("state", "{before} -> {state}", " (by {name})"),
    "fault": ("state", "{before} -> {state}", " (by {name})", ": {fault}: {cause}; {remedy}"),
    "servo_up": ("servo_up", "the servo runs"),
    "servo_down": ("servo_down", "the servo has ended, or no longer answers"),
    "gap": ("gap", "{lost} ticks were overwritten before telemetry had read them"),
    "flight": ("flight", "flight recording of {reason}: {path}"),
    "mark": ("mark", "{text}"),
    "controlled": (
        "controlled",
        "the display gave out unexplained energy: the servo raised the active damping"
        " or halved K, B, M and those of the wall; set smaller values next",
    ),
    # the result of a change that was scheduled or is applied in stages
    "answered": ("answer", ""),
    "refused": ("answer", "{reason}"),
    "superseded": ("answer", "a newer {by_cmd} of actor {by_actor} came" + STAYS),
    "asked_meanwhile": ("answer", "{by_cmd} was asked meanwhile" + STAYS),
    "changed_before": ("answer", "something else was changed before it" + STAYS),
    "state_left": ("answer", "the servo is {state}" + STAYS),
    "stood_still": ("answer", "the gateway stalled meanwhile" + STAYS),
    "damping_late": (
        "answer",
        "the next stage waited too long: the board reports {reported_ns_per_m:.3g} of"
        " {needed_ns_per_m:.3g} N s/m" + STAYS,
    ),
    "ramps_late": ("answer", "the next stage waited too long: ramps are still under way" + STAYS),
    "other_terms": ("answer", "the terms of the guard have changed since it was judged" + STAYS),
    "client_gone": ("answer", "the connection of its client is gone" + STAYS),
    "client_failed": ("answer", "its client has failed" + STAYS),
    # whether a hand would shake what was asked
    "hand": ("guard", "a hand that would shake the device: {hand[text]}; {hand[growth]}"),
    "no_hand": ("guard", "no single mass or spring was found that would shake the device"),
    "lease_taken": ("lease", "{name} (actor {actor}) took the lease of {what}"),
    "lease_released": ("lease", LEASE + "was released"),
    "lease_taken_over": ("lease", LEASE + "was taken over by {by}"),
    "lease_silent": ("lease", LEASE + "ended: its holder was silent for {ttl_s:g} s"),
    "lease_gone": ("lease", LEASE + "ended with the connection of its holder"),
    "lease_failed": ("lease", LEASE + "ended: its holder failed"),
    "proxy_taken": ("proxy", "{name} (actor {actor}) moves the proxy"),
    "proxy_held": ("proxy", PROXY + "its law is late or silent, or has used its energy"),
    "proxy_lease": ("proxy", PROXY + "its client no longer holds the lease of the environment"),
    "proxy_stopped": (
        "proxy",
        "{name} (actor {actor}) no longer moves the proxy: the force is off",
    ),
    "tick_too_long": (
        "warning",
        "a tick takes {tick_us:.0f} us of its {period_us:.0f} us ({percent:.0f} %, at most"
        f" {100.0 * (1.0 - LEAST_IDLE_SHARE):.0f} % is safe): ticks will be late; set"
        " realtime.rate_hz to {highest_rate_hz:g} or less, or see `hapticd doctor`",
    ),
    "damping_low": (
        "warning",
        "active damping: {delivered[estimate_ns_per_m]:.3g} N s/m ({delivered[low]:.3g} to"
        " {delivered[high]:.3g}) delivered of {delivered[commanded]:.3g} N s/m commanded,"
        " {percent:.0f} %, by {delivered[basis]}; look at the amplifier, its supply and the"
        " resistance compensation",
    ),
    "not_passive": (
        "warning",
        "the environment in force is no longer known to be passive: {reason}",
    ),
    "terms_not_kept": ("warning", "the terms of the guard could not be kept: {reason}"),
    "terms_after_restart": (
        "warning",
        "the gateway has restarted; the guard was asked for {asked[policy]} by {asked[basis]},"
        " margin {asked[margin_ns_per_m]:g} N s/m, damping {asked[mode]}; the configuration is"
        " {configured[policy]} by {configured[basis]}, margin {configured[margin_ns_per_m]:g}"
        " N s/m, damping {configured[mode]}; from now on the guard judges under {terms[policy]} by"
        " {terms[basis]}, margin {terms[margin_ns_per_m]:g} N s/m, damping {terms[mode]}",
    ),
    "answers_lost": ("warning", "{reason}"),
    "flight_not_written": (
        "warning",
        "{path}: the flight recording could not be written: {reason}; free some space or correct"
        " its permissions",
    ),
    "telemetry_open": (
        "warning",
        "INSECURE: telemetry is offered on {address} to everyone, without keys or encryption; set"
        " gateway.curve_keys",
    ),
    "port_taken": ("warning", "port {port} is taken, telemetry is at {address} instead"),
    "listener_refused": (
        "warning",
        "telemetry refused",
        " to {address}",
        ": {reason}",
        ", {times} times",
        "; add a client with `hapticd keys client`",
    ),
    "key_unreadable": ("warning", "{path} cannot be used: {reason}"),
    "relay_ended": ("warning", "no telemetry for other computers: {reason}"),
}


def sentence(code: EventCode, **fields: Any) -> str:
    """The event for people; without later parts of which a field is missing, None or empty."""
    _, first, *later = EVENTS[code]
    given = {name for name, value in fields.items() if value not in (None, "")}
    told = [part for part in later if given.issuperset(_fields_of(part))]
    return "".join([first, *told]).format(**fields)


def _fields_of(part: str) -> set[str]:
    return {name.partition("[")[0] for _, name, _, _ in Formatter().parse(part) if name}


class Journal:
    """The last events, and those not yet published; both bounded."""

    def __init__(self, unix_ns: Callable[[], int]) -> None:
        self._unix_ns = unix_ns
        self.recent: deque[dict[str, Any]] = deque(maxlen=KEPT)
        self._queue: deque[dict[str, Any]] = deque(maxlen=QUEUED)

    def note(self, code: EventCode, unix_ns: int | None = None, **fields: Any) -> None:
        """Note an event with `fields`; it happened now unless `unix_ns` says when."""
        event = {
            "timestamp": (unix_ns or self._unix_ns()) / NS_PER_S,
            "kind": EVENTS[code][0],
            "code": code,
            **fields,
            "text": sentence(code, **fields),
        }
        self.recent.append(event)
        self._queue.append(event)

    def drain(self) -> list[dict[str, Any]]:
        """Return the events since the last call."""
        events = list(self._queue)
        self._queue.clear()
        return events


# --- actors ---------------------------------------------------------------------------------------

MOST = 64  # clients that have left
GATEWAY_ACTOR = 1
RESERVED = {GATEWAY_ACTOR: "gateway", ACTOR_STOP_WORD: "stop word"}  # 0 is the servo itself


class Actors:
    """Client numbers, from `next_number`, by identity; a client that left is forgotten after MOST
    others.
    """

    def __init__(self, next_number: Callable[[], int]) -> None:
        self._next_number = next_number
        self._present: dict[bytes, tuple[int, str]] = {}
        self._left: OrderedDict[bytes, tuple[int, str]] = OrderedDict()

    def number(self, identity: bytes) -> int:
        """Return the number of the client; a new one for an unknown client."""
        known = self._present.get(identity) or self._left.get(identity)
        if known is None:
            known = self._present[identity] = self._next_number(), "client"
        return known[0]

    def call(self, identity: bytes, name: str) -> None:
        """Set the client's name."""
        self._present[identity] = self.number(identity), name

    def leave(self, identity: bytes) -> int:
        """Note the end of the client's connection; return its number, 0 if it never sent a request.

        Its waiting requests keep the number.
        """
        # a client that left may have returned with the same identity
        known = self._present.pop(identity, None) or self._left.get(identity)
        if known is None:
            return 0
        self._left[identity] = known
        if len(self._left) > MOST:
            self._left.popitem(last=False)
        return known[0]

    def names(self) -> dict[str, str]:
        """Return the names by number (as text, for JSON)."""
        known = (*self._left.values(), *self._present.values())
        return {str(number): name for number, name in known}

    def name(self, number: int) -> str:
        """Return the name of actor `number`; empty for the servo itself and for
        forgotten clients.
        """
        return RESERVED.get(number) or self.names().get(str(number), "")


# --- explanation ----------------------------------------------------------------------------------


class Outcome(StrEnum):
    """The outcome of a change, or the judgement of an environment."""

    SAFE = "safe"
    UNSAFE = "unsafe"
    SAFER = "safer"  # not safe, but safer than the environment in force
    WARNING = "warning"  # not safe, but applied
    CLAMPED = "clamped"
    FOLLOWED = "followed"
    REFUSED = "refused"
    UNKNOWN = "unknown"
    NOT_JUDGED = "not_judged"


class Reason(StrEnum):
    """Codes of reasons."""

    SPARE = "spare"
    SHORT = "short"
    UNSTABLE = "unstable"
    NEGATIVE_STIFFNESS = "negative_stiffness"
    INSIDE = "inside"
    OUTSIDE = "outside"
    TOO_MANY_POINTS = "too_many_points"
    ONLY_IN_STAGES = "only_in_stages"
    SAFER = "safer"
    GIVEN = "given"
    NOT_CLAMPED = "not_clamped"
    NOT_FOLLOWED = "not_followed"
    POLICY = "policy"
    UNKNOWN = "unknown"


class Remedy(StrEnum):
    """Codes of remedies."""

    LESS = "less"
    MORE_DAMPING = "more_damping"
    POSITIVE_STIFFNESS = "positive_stiffness"
    POINT_INSIDE = "point_inside"
    WAIT = "wait"
    CONFIGURE = "configure"
    POLICY = "policy"


@dataclass(frozen=True, slots=True)
class Entry:
    """A reason or a remedy: the code of a `Reason` or `Remedy`, and its text for users."""

    code: str
    text: str


@dataclass(frozen=True, slots=True)
class Explanation:
    """Reasons, and alternative remedies."""

    reasons: tuple[Entry, ...]
    remedies: tuple[Entry, ...] = ()

    @classmethod
    def because(cls, code: Reason, text: str) -> Self:
        """Return the explanation with one reason."""
        return cls((Entry(code, text),))

    @classmethod
    def of(cls, verdict: Mapping[str, Any]) -> Self:
        """Return the explanation in the map of a verdict."""
        reasons, remedies = (
            tuple(Entry(one["code"], one["text"]) for one in verdict.get(name, ()))
            for name in ("reasons", "remedies")
        )
        return cls(reasons, remedies)

    def and_reason(self, code: Reason, text: str) -> "Explanation":
        """Return it with one more reason."""
        return Explanation((*self.reasons, Entry(code, text)), self.remedies)

    def and_remedy(self, code: Remedy, text: str) -> "Explanation":
        """Return it with one more remedy."""
        return Explanation(self.reasons, (*self.remedies, Entry(code, text)))

    def lines(self, outcome: str, between: Iterable[str] = ()) -> list[str]:
        """Return one statement a line: the first reason, then the lines `between`, then
        the rest.
        """
        reasons = [one.text for one in self.reasons] or ["the guard gave no reason"]
        prefix = f"{outcome}: " if outcome in _NAMED else ""
        remedy = ", or ".join(one.text for one in self.remedies)
        return [f"{prefix}{reasons[0]}", *between, *reasons[1:], *([remedy] if remedy else [])]

    def plain(self, outcome: Outcome) -> dict[str, Any]:
        """Return the fields of a verdict for it."""
        return {
            "outcome": outcome.value,
            "reasons": [asdict(one) for one in self.reasons],
            "remedies": [asdict(one) for one in self.remedies],
            "text": "; ".join(self.lines(outcome)),
        }


_NAMED = (Outcome.WARNING, Outcome.CLAMPED, Outcome.FOLLOWED, Outcome.REFUSED)  # in the sentence
