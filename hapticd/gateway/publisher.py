"""The telemetry side of the gateway: records in, [topic, payload] out. No socket, no clock.

Every record is examined once, for histograms and events; a topic is encoded only while it has a
subscriber. The topic `state` describes the servo's state in words; `Transitions` finds every change
of state or fault in a block of records, however short it was.
"""

import time
from collections.abc import Callable
from dataclasses import asdict
from typing import Any

import msgpack
import numpy as np

from hapticd.core.arrays import Records
from hapticd.core.faults import BY_CODE, BY_NUMBER, FAULTS, Fault
from hapticd.core.params import GatewaySetup
from hapticd.core.units import NS_PER_MS, NS_PER_S
from hapticd.gateway.tick_times import ENOUGH, TickTimes, compensation
from hapticd.guard.delivered import Delivered
from hapticd.guard.status import Guard
from hapticd.mailbox.layout import Command, Flag, State, Value, Watched, values_of
from hapticd.protocol.answers import LimitCycleFault
from hapticd.protocol.codec import finite
from hapticd.protocol.flight import FlightRecorder, flights_folder
from hapticd.protocol.journal import GATEWAY_ACTOR, Actors, EventCode, Journal
from hapticd.protocol.leases import Leases
from hapticd.protocol.ledger import Ledger
from hapticd.protocol.telemetry import Feed, Origin, ProbeDecoder, RingBlock, Subscriptions
from hapticd.protocol.view import STATES, ServoView

__all__ = ["state_map"]

RECORD_FIELDS_SHOWN = (
    "tick",
    "slot",
    "homed",
    "perturbing",
    "gain",
    "stiffness_n_per_m",
    "virtual_damping_ns_per_m",
    "mass_kg",
    "active_damping_asked_ns_per_m",
    "active_damping_ns_per_m",
    "position_m",
    "proxy_m",
    "force_n",
    "delay_spread_us",
    "winding_c",
    "actor",
)
NEWS = (
    "state",
    "fault",
    "revision",
    "actor",
    "homed",
    "perturbing",
)  # a change of one of these is published at once


DELAY_TICKS = 256  # for the delay in `state`; `delay_spread_us` covers as many
LAMPS = ("state", "fault", "active_damping_effect_ns_per_m")  # users wait for these changes
EARLY_NS = 20 * NS_PER_MS  # between two blocks that are sent before they are complete
CALM_NS = NS_PER_S  # without a held proxy, before the start of a law is noted


def state_map(view: ServoView, actors: Actors, leases: Leases, unix_ns: int) -> dict[str, Any]:
    """Return the content of the topic `state`, without guard and delivered damping."""
    mailbox = view.mailbox
    record = view.record
    fault = view.fault
    header = mailbox.header if mailbox else None
    return {
        "timestamp": unix_ns / NS_PER_S,
        "servo_alive": view.alive,
        "state": view.state_name,
        "simulated": header.simulated if header else view.params.simulated,
        "rate_hz": header.rate_hz if header else view.params.realtime.rate_hz,
        "revision": view.revision,
        "fault": fault.code,
        **described(fault),
        "waiting_for": view.report().get("waiting_for", ""),  # why there is no board
        "instance": view.params.instance,
        "epoch": header.start_ns if header else 0,
        "config_hash": header.config_hash if header else view.params.config_hash,
        **{name: record[name] for name in RECORD_FIELDS_SHOWN if view.alive and name in record},
        "proxy_held": view.alive and bool(record.get("flags", 0) & Flag.PROXY_HELD),
        **(usual_delays(view.newest(DELAY_TICKS)) if view.alive else {}),
        "limit_cycle_faults": limit_cycle_faults(view, leases),
        "commissioning": commissioning(view),
        "compensation": compensation(record if view.alive else {}, view.params.device),
        "actor_name": actors.name(int(record.get("actor", 0))),
        "actors": actors.names(),
        "leases": leases.shown(),
        "counters": mailbox.counters() if mailbox else {},
    }


def usual_delays(records: Records) -> dict[str, int]:
    """Return the 99th percentile of delay and frame age of `records`, us; -1 if unknown.

    While frames are lost, the delay of a single tick may differ or be unknown.
    """
    found = {}
    for name in ("delay_us", "frame_age_us"):
        known = np.sort(records[name][records[name] >= 0])
        found[name] = int(known[99 * known.size // 100]) if known.size else -1
    return found


def limit_cycle_faults(view: ServoView, leases: Leases) -> dict[str, LimitCycleFault]:
    """Return "on" for each fault that ends a limit cycle, or the reason why it is off."""
    device = view.params.device
    on = int(view.record.get("watches", 0))
    off: dict[Watched, LimitCycleFault] = dict.fromkeys(
        Watched, "measuring" if leases.measuring else "off"
    )
    if device.overspeed_m_per_s is None:
        off[Watched.OVERSPEED] = "no_overspeed"
    if device.physical_damping_ns_per_m is None:
        off[Watched.ENERGY] = "no_physical_damping"
    return {bit.name.lower(): "on" if on & bit else off[bit] for bit in Watched}


def commissioning(view: ServoView) -> dict[str, Any] | None:
    """Return the restrictions until the signs of the device are verified; None once they are."""
    if not view.params.device.commissioning:
        return None
    return {
        "force_limit_n": view.params.force_limit_n,
        "remedy": "the signs of force and position are not verified; `hapticd rig motor`",
    }


def described(fault: Fault) -> dict[str, str]:
    """Return cause, action and remedy of a fault."""
    return {"cause": fault.cause, "action": fault.action, "remedy": fault.remedy}


def news(view: ServoView) -> tuple[Any, ...]:
    """Return the values whose change is published at once."""
    return view.alive, view.life, *(view.record.get(name) for name in NEWS)


class Transitions:
    """Follow states and faults from block to block, and note every change with its tick."""

    def __init__(self, view: ServoView, actors: Actors, journal: Journal) -> None:
        self._view = view
        self._actors = actors
        self._journal = journal
        self._life = 0
        self._last = (0, 0)
        self._changes = 0  # of the environment, as last seen
        self._law = 0  # actor whose law moves the proxy
        self._stayed_ns = -CALM_NS  # time of the last record in which the proxy stays

    def follow(self, block: RingBlock) -> None:
        """Note the changes in `block`, and the gap before it."""
        if self._life != block.life:
            self._life = block.life
            # every servo life begins disabled and without a fault
            self._last = (0, 0)
            self._changes = 0
            self._law = 0
        if block.lost:
            self._journal.note("gap", seq=block.seq, lost=block.lost)
        states = block.records["state"]
        faults = block.records["fault"]
        before_states = np.concatenate(([self._last[0]], states[:-1]))
        before_faults = np.concatenate(([self._last[1]], faults[:-1]))
        for place in np.flatnonzero((states != before_states) | (faults != before_faults)).tolist():
            self._note(block.records[place], int(before_states[place]))
        # a block may contain only a number of lost records
        if len(states):
            self._last = int(states[-1]), int(faults[-1])
            self._control(block.records)
            self._follow_proxy(block.records)

    def _control(self, records: Records) -> None:
        """Note changes by the energy controller: they have actor 0 and its flag is set."""
        changes = records["environment_revision"]
        before = np.concatenate(([self._changes], changes[:-1]))
        own = (changes != before) & (records["actor"] == 0)
        for record in records[own & (records["flags"] & Flag.CONTROLLED != 0)]:
            self._journal.note(
                "controlled",
                unix_ns=int(record["time_ns"]) + self._view.unix_offset_ns,
                tick=int(record["tick"]),
                excess_j=float(record["excess_j"]),
            )
        self._changes = int(changes[-1])

    def _follow_proxy(self, records: Records) -> None:
        """Note the start and the end of a law that moves the proxy.

        No start is noted within CALM_NS after a held proxy, so that a law at its limit does not
        fill the journal.
        """
        stays = records[(records["flags"] & Flag.PROXY_HELD) != 0]
        at = stays[0] if len(stays) else records[-1]
        calm = at["time_ns"] - self._stayed_ns > CALM_NS
        if len(stays):
            self._stayed_ns = int(stays[-1]["time_ns"])
        begins = calm and at["state"] == State.ENABLED and (at["proxy_m"] or len(stays))
        law = self._law or (int(at["lease_control"]) if begins else 0)
        end = _end_of_law(at, law)
        if law and (end or not self._law):
            self._journal.note(
                end or "proxy_taken",
                unix_ns=int(at["time_ns"]) + self._view.unix_offset_ns,
                tick=int(at["tick"]),
                actor=law,
                name=self._actors.name(law),
                position_m=float(at["proxy_m"]),
            )
        self._law = 0 if end else law

    def _note(self, record: np.void, before: int) -> None:
        fault = BY_NUMBER.get(int(record["fault"]), FAULTS[0])
        actor = int(record["actor"])
        self._journal.note(
            "fault" if record["state"] == State.FAULT else "state",
            unix_ns=int(record["time_ns"]) + self._view.unix_offset_ns,
            tick=int(record["tick"]),
            before=_name(before),
            state=_name(int(record["state"])),
            fault=fault.code,
            **described(fault),
            actor=actor,
            name=self._actors.name(actor),
        )


def _end_of_law(at: np.void, law: int) -> EventCode | None:
    """Return why that actor's law does not move the proxy in the record `at`; None if it does."""
    if at["state"] != State.ENABLED:
        return "proxy_stopped"
    if at["lease_control"] != law:
        return "proxy_lease"
    return "proxy_held" if at["flags"] & Flag.PROXY_HELD else None


def _name(number: int) -> str:
    return STATES[number].name.lower() if number in STATES else f"unknown ({number})"


STATE_PERIOD_NS = NS_PER_S
NOT_DELIVERED = values_of({Value.FAULT_NUMBER: BY_CODE["damping_not_delivered"].number})

Message = tuple[str, bytes]  # topic, payload


class Publisher:
    """Turn the servo's records into messages.

    `messages` must be called at least every few milliseconds.
    """

    def __init__(
        self,
        view: ServoView,
        actors: Actors,
        journal: Journal,
        setup: GatewaySetup,
        guard: Guard,
        unix_ns: Callable[[], int] = time.time_ns,
        leases: Leases | None = None,
    ) -> None:
        self._view = view
        self._guard = guard
        self._actors = actors
        self._journal = journal
        self._leases = leases or Leases()
        self._batch = setup.gateway.batch
        self.feed = Feed(view, setup.gateway.batch)
        realtime = setup.servo.realtime
        self.times = TickTimes(realtime.grace_s, realtime.rate_hz)
        self._judged = False  # whether the room of a tick was judged
        self._fault_due = False  # requested, but not yet in the command ring
        self.flight = FlightRecorder(
            view, journal, setup, flights_folder(setup.servo.instance), unix_ns, self._leases
        )
        self._audience: dict[bytes, Subscriptions] = {}
        self._transitions = Transitions(view, actors, journal)
        self._probe = ProbeDecoder(setup.servo.device)
        self._ledger = Ledger(setup.servo)
        self._delivered = Delivered(setup.servo, guard.relied_on_ns_per_m)
        self._origin = Origin(0, 0, setup.servo.simulated)
        self._life = 0
        self._alive = False
        self._news: tuple[Any, ...] = ()
        self._lamps: tuple[Any, ...] = ()
        self._early_ns = -EARLY_NS
        # the first one is due at once
        self._state_ns = -STATE_PERIOD_NS

    def subscribe(self, listener: bytes, message: bytes, unix_ns: int) -> list[Message]:
        """Note a subscription of `listener` or its end; return the messages to send at once.

        A new subscriber of `state` gets it at once, one of `flight` gets a checkpoint soon.
        """
        topics = self._audience.setdefault(listener, Subscriptions()).take(message)
        if "flight" in topics:
            self.flight.ask()
        return [self._state(unix_ns)] if "state" in topics else []

    def leave(self, listener: bytes) -> None:
        """Forget `listener`, whose connection has ended."""
        self._audience.pop(listener, None)

    def listeners(self, topic: str) -> list[bytes]:
        """Return the subscribers of `topic`."""
        return [name for name, asked in self._audience.items() if topic in asked.wanted]

    @property
    def _wanted(self) -> frozenset[str]:
        return frozenset().union(*(asked.wanted for asked in self._audience.values()))

    def urgent(self, now_ns: int) -> bool:
        """Return whether a lamp has changed, so that `messages` should not wait for a
        whole batch.
        """
        may = bool(self._lamps) and now_ns - self._early_ns >= EARLY_NS
        return may and self._view.alive and self._shown() != self._lamps

    def _shown(self) -> tuple[Any, ...]:
        values = map(self._view.record.get, LAMPS)
        return tuple(value if value == value else None for value in values)  # unknown stays so

    def messages(self, now_ns: int, unix_ns: int, ended: bool = False) -> list[Message]:
        """Return all messages that are due; for a servo that has `ended`, everything it left."""
        self._notice_servo()
        early = ended or self.urgent(now_ns)
        self._early_ns = now_ns if early else self._early_ns
        self._lamps = self._shown()
        wanted = self._wanted
        found: list[Message] = []
        noted = self.flight.follow(now_ns)
        if noted and "flight" in wanted:
            found.append(("flight", bytes(msgpack.packb(noted))))  # every number as it is
        for block in self.feed.take(now_ns, early):
            # statistics and events use every record, with or without subscribers
            self.times.add(block.records)
            self._guard.count(block.records, block.life)
            self._transitions.follow(block)
            self.flight.add(block, now_ns)
            if block.lost:
                self._ledger.forget()
                self._delivered.forget()
            self._follow_damping(block)
            found += self._ticks(block, wanted)
        self._post_fault()
        self._judge_room()
        self.flight.dump_if_due(now_ns)
        found += [
            ("guard", _packed(message))
            for message in self._guard.messages(now_ns, unix_ns, "guard" in wanted)
        ]
        found += self._state_if_due(now_ns, unix_ns)
        found += [("event", _packed(event)) for event in self._journal.drain() if "event" in wanted]
        return found

    def _notice_servo(self) -> None:
        view = self._view
        if view.mailbox and view.life != self._life:
            self._life = view.life
            self._origin = Origin(
                view.mailbox.epoch, view.unix_offset_ns, view.mailbox.header.simulated
            )
            self._lamps = ()
            self.times.begin(self._origin.epoch)
            self._judged = False
            self._fault_due = False
            self.flight.begin(self._origin)
            self._probe.forget()
            self._ledger.begin()
            self._delivered.begin()
        if view.alive != self._alive:
            self._alive = view.alive
            self._journal.note(
                "servo_up" if view.alive else "servo_down",
                epoch=self._origin.epoch,
                reason=view.trouble,
            )

    def _judge_room(self) -> None:
        if self._judged or self.times.count < ENOUGH:
            return
        self._judged = True
        room = self.times.room
        if room.short:
            percent = 100.0 * room.tick_us / room.period_us
            self._journal.note("tick_too_long", percent=percent, **asdict(room))

    def _follow_damping(self, block: RingBlock) -> None:
        """Warn if too little active damping is delivered, and request the fault if it is needed."""
        for low in self._delivered.take(block.records):
            if low.warn:
                percent = 100.0 * (low.estimate.ratio or 0.0)
                found = low.estimate._asdict()
                self._journal.note("damping_low", percent=percent, delivered=found)
            self._fault_due = self._fault_due or low.fault

    def _post_fault(self) -> None:
        """Request the fault, again in each pass while the command ring is full."""
        if self._fault_due and self._view.mailbox:
            seq = self._view.mailbox.post(Command.FAULT, GATEWAY_ACTOR, 0, NOT_DELIVERED)
            self._fault_due = seq is None

    def _ticks(self, block: RingBlock, wanted: frozenset[str]) -> list[Message]:
        found: list[Message] = []
        if "servo" in wanted:
            energies = self._ledger.take(block.records)
            payloads = block.batches(energies, self._origin, self._batch)
            found += [("servo", payload) for payload in payloads]
        else:
            self._ledger.defer(block.records)
        if "servo.raw" in wanted:
            found.append(("servo.raw", block.message(self._origin)))
        if "probe" in wanted:
            found += [("probe", payload) for payload in self._probe.messages(block, self._origin)]
        else:
            # a pause without subscribers is not a gap
            self._probe.forget()
        return found

    def _state_if_due(self, now_ns: int, unix_ns: int) -> list[Message]:
        latest = (*news(self._view), *self._leases.holders)
        if latest == self._news and now_ns - self._state_ns < STATE_PERIOD_NS:
            return []
        self._news = latest
        self._state_ns = now_ns
        return [self._state(unix_ns)] if "state" in self._wanted else []

    def _state(self, unix_ns: int) -> Message:
        return "state", _packed(self.state(unix_ns))

    def state(self, unix_ns: int) -> dict[str, Any]:
        """Return the topic `state`."""
        return self.without_guard(unix_ns) | {"guard": self._guard.summary()}

    def without_guard(self, unix_ns: int) -> dict[str, Any]:
        """Return the topic `state` without the summary of the guard."""
        found = state_map(self._view, self._actors, self._leases, unix_ns)
        return found | {"delivered_active_damping": self._delivered.estimate._asdict()}


def _packed(content: dict[str, Any]) -> bytes:
    return bytes(msgpack.packb(finite(content)))
