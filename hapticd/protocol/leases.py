"""Rights of clients: access to the gateway by address, and leases of parts of the display.

Access (`needs_keys`, `in_the_clear`). Commands are accepted only on a socket file in the runtime
folder, with the permissions of the file system. Telemetry is offered there and on the loopback. On
other addresses it needs CURVE keys (`keys`) and the relay (`gateway.relay`), or `allow_insecure` in
the configuration, with a warning.

Leases (`Leases`). A lease is the exclusive right of a client to change a part of the display, as
long as it is alive. There are four. `environment` covers the rendered environment and the force
switch, `active_damping` the damping and its mode, `perturbation` the waveform, and `measuring` all
three. While `measuring` is held, nothing is judged and the energy faults are off. Any client may
change a part without a holder. A holder is a connection, not a name: two clients of one name are
two holders.

    taken        by any client while no other holds any of it; otherwise only with `take_over`
    renewed      by every request of its holder, for `ttl` from then on
    taken over   its former holder is refused from then on
    silent       no request for `ttl`: it ends
    gone         the connection ended because the client died or left: it ends at once
    released     by its holder

A client that lost a lease is refused the parts it covered, even without a new holder, until it
takes or releases the lease itself: its knowledge of the display is outdated. Stop, disable and
reset need no lease.

The module is pure: the time is an argument. Only time during which the gateway received requests
counts. A late pass or a jump of the clock postpones all ends by as much. The actor number of a
connection must not change (`journal.Actors` keeps it). A caller must check `may` before any change.
"""

import ipaddress
from collections import OrderedDict
from typing import Any, NamedTuple

from hapticd.core.errors import CommandError, ConfigError
from hapticd.core.params import GatewayParams
from hapticd.core.units import NS_PER_S, round_half_up
from hapticd.protocol.journal import EventCode, sentence

__all__ = [
    "DAMPING",
    "ENVIRONMENT",
    "LEAVE_NEEDED",
    "MEASURING",
    "PARTS",
    "PERTURBATION",
    "Ended",
    "Lease",
    "Leases",
    "in_the_clear",
    "needs_keys",
    "without_leave",
]

# --- access ---------------------------------------------------------------------------------------


def is_loopback(host: str) -> bool:
    """Return whether `host` is an address of this machine alone.

    Of names, only localhost counts.
    """
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


LEAVE_NEEDED = (
    "beyond this machine telemetry needs keys; set gateway.curve_keys, or gateway.allow_insecure ="
    " true if everyone on that network may listen, or use 127.0.0.1"
)


def without_leave(params: GatewayParams) -> bool:
    """Return whether telemetry would leave the machine unencrypted without permission."""
    return not (
        is_loopback(params.tcp_host) or params.curve_keys is not None or params.allow_insecure
    )


def in_the_clear(params: GatewayParams) -> bool:
    """Return whether telemetry leaves the machine without keys or encryption.

    ConfigError if that is not permitted.
    """
    if without_leave(params):
        raise ConfigError(f"gateway.tcp_host = {params.tcp_host!r}: {LEAVE_NEEDED}")
    return not is_loopback(params.tcp_host) and params.curve_keys is None


def needs_keys(params: GatewayParams) -> bool:
    """Return whether TCP requires a key."""
    return params.curve_keys is not None and not is_loopback(params.tcp_host)


# --- leases ---------------------------------------------------------------------------------------

ENVIRONMENT = "environment"
DAMPING = "active_damping"
PERTURBATION = "perturbation"
MEASURING = "measuring"
PARTS = {
    ENVIRONMENT: frozenset({ENVIRONMENT}),
    DAMPING: frozenset({DAMPING}),
    PERTURBATION: frozenset({PERTURBATION}),
    MEASURING: frozenset({ENVIRONMENT, DAMPING, PERTURBATION}),
}
LATE_NS = NS_PER_S // 2  # after a longer pause between passes, no request was received meanwhile
MOST_LOST = 1024  # remembered losses


class Lease(NamedTuple):
    """One lease: its subject, its holder, and its end unless it is renewed."""

    what: str
    actor: int
    name: str  # chosen by the client
    ttl_ns: int
    at_end: str  # "hold" | "zero" | "disable": the action at the display if its holder fails
    deadline_ns: int

    @property
    def holder(self) -> str:
        """The holder, for users."""
        return f"{self.name} (actor {self.actor})"


class Ended(NamedTuple):
    """An ended lease, and the kind of its end."""

    lease: Lease
    how: EventCode
    by: str = ""  # who took it over

    @property
    def fields(self) -> dict[str, Any]:
        """Of its event."""
        lease = self.lease
        about = {"what": lease.what, "actor": lease.actor, "name": lease.name}
        return about | {"by": self.by, "ttl_s": lease.ttl_ns / NS_PER_S}

    @property
    def text(self) -> str:
        """What happened to it, in words."""
        return sentence(self.how, **self.fields)


class Leases:
    """All leases of one gateway. `advance` must be called in every pass, before any
    other method.
    """

    def __init__(self) -> None:
        self._held: dict[str, Lease] = {}
        self._lost: OrderedDict[tuple[int, str], Ended] = OrderedDict()  # by actor and part
        self._now_ns = 0

    @property
    def measuring(self) -> bool:
        """Whether a client measures: then nothing is judged, and the energy faults are off."""
        return MEASURING in self._held

    @property
    def holders(self) -> tuple[tuple[str, int], ...]:
        """(what, actor) of all held leases."""
        return tuple((what, lease.actor) for what, lease in self._held.items())

    def holder(self, part: str) -> Lease | None:
        """Return the lease that covers `part` of the display; None if any client may change it."""
        return next((lease for lease in self._held.values() if part in PARTS[lease.what]), None)

    def may(self, actor: int, what: str) -> CommandError | None:
        """Return why `actor` may not change `what` now; None if it may."""
        for part in sorted(PARTS[what]):
            lease = self.holder(part)
            if lease is not None and lease.actor == actor:
                continue
            if (actor, part) in self._lost:
                return self._gone(self._lost[actor, part])
            if lease is not None:
                return self._refusal(lease)
        return None

    def take(
        self, what: str, actor: int, name: str, ttl_s: float, at_end: str, take_over: bool = False
    ) -> list[Ended]:
        """Give the lease of `what` to `actor`; return the leases that this ended.

        A holder renews its lease with the new values. CommandError: another client holds a part,
        and `take_over` is false; nothing changed.
        """
        others = [
            lease
            for lease in self._held.values()
            if lease.actor != actor and PARTS[lease.what] & PARTS[what]
        ]
        if others and not take_over:
            raise self._refusal(others[0])
        ended = [
            self._end(lease, "lease_taken_over", f"{name} (actor {actor})") for lease in others
        ]
        ttl_ns = round_half_up(ttl_s * NS_PER_S)
        self._held[what] = Lease(what, actor, name, ttl_ns, at_end, self._now_ns + ttl_ns)
        self._acknowledge(actor, what)
        return ended

    def renew(self, what: str, actor: int) -> None:
        """Renew the lease of `what`. CommandError: `actor` does not hold it, or no longer."""
        lease = self._held.get(what)
        if lease is None or lease.actor != actor:
            raise self.may(actor, what) or CommandError(
                "refused", f"no client holds the lease of {what}; take it first"
            )
        self.heard(actor)

    def release(self, what: str, actor: int, how: EventCode = "lease_released") -> Ended:
        """End the lease of `what`, or acknowledge its loss; return how it ended, then or before.

        `how` is `lease_failed` if the holder gives up because of its own error. CommandError:
        another client holds it, or none does; nothing changed.
        """
        lease = self._held.get(what)
        if lease is not None and lease.actor == actor:
            return self._end(lease, how)
        found = [self._lost[actor, part] for part in PARTS[what] if (actor, part) in self._lost]
        if found:
            self._acknowledge(actor, what)
            return found[0]
        raise self.may(actor, what) or CommandError(
            "refused", f"no client holds the lease of {what}: there is nothing to release"
        )

    def heard(self, actor: int) -> None:
        """Renew all leases of `actor`, which has sent a request."""
        for lease in list(self._held.values()):
            if lease.actor == actor:
                self._held[lease.what] = lease._replace(deadline_ns=self._now_ns + lease.ttl_ns)

    def advance(self, now_ns: int) -> list[Ended]:
        """Set the time to `now_ns`; return the leases that ended because their holders
        were silent.
        """
        step_ns = now_ns - self._now_ns
        self._now_ns = now_ns
        if not 0 <= step_ns <= LATE_NS:
            self._put_off(step_ns)
        late = [lease for lease in self._held.values() if lease.deadline_ns <= now_ns]
        return [self._end(lease, "lease_silent") for lease in late]

    def leave(self, actor: int) -> list[Ended]:
        """Return the leases that end with the connection of `actor`."""
        mine = [lease for lease in self._held.values() if lease.actor == actor]
        return [self._end(lease, "lease_gone") for lease in mine]

    def shown(self) -> dict[str, dict[str, Any]]:
        """Return the held leases: {what: {name, actor, left_s, ttl_s, at_end}}, for users and
        messages.
        """
        return {
            what: {
                "name": lease.name,
                "actor": lease.actor,
                "left_s": self._left_s(lease),
                "ttl_s": lease.ttl_ns / NS_PER_S,
                "at_end": lease.at_end,
            }
            for what, lease in self._held.items()
        }

    def named(self) -> dict[str, str]:
        """Return the holders: {what: "name (actor number)"}, for recordings."""
        return {what: lease.holder for what, lease in self._held.items()}

    def _put_off(self, step_ns: int) -> None:
        for lease in list(self._held.values()):
            self._held[lease.what] = lease._replace(deadline_ns=lease.deadline_ns + step_ns)

    def _end(self, lease: Lease, how: EventCode, by: str = "") -> Ended:
        del self._held[lease.what]
        ended = Ended(lease, how, by)
        if how not in ("lease_released", "lease_failed"):
            for part in PARTS[lease.what]:
                self._lost[lease.actor, part] = ended
        while len(self._lost) > MOST_LOST:
            self._lost.popitem(last=False)
        return ended

    def _acknowledge(self, actor: int, what: str) -> None:
        for part in PARTS[what]:
            self._lost.pop((actor, part), None)

    def _left_s(self, lease: Lease) -> float:
        return round((lease.deadline_ns - self._now_ns) / NS_PER_S, 3)

    def _refusal(self, lease: Lease) -> CommandError:
        return CommandError(
            "leased",
            f"{lease.holder} holds the lease of {lease.what}, for {self._left_s(lease):.1f} s more"
            " unless it is renewed; wait until it ends, or take it over with `hapticd lease"
            f" release {lease.what}`",
        )

    def _gone(self, ended: Ended) -> CommandError:
        return CommandError(
            "leased",
            f"{ended.text}; check the change, then take it again, or release it to go on without",
        )
