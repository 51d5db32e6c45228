"""The telemetry side of the gateway: records in, [topic, payload] out. No socket, no clock.

Every record is looked at once, for histograms and events; a topic is encoded only while someone subscribes to it.
"""

import time
from collections.abc import Callable
from typing import Any

import msgpack

from hapticd.gateway.actors import Actors
from hapticd.gateway.codec import finite
from hapticd.gateway.encode import Origin, raw_message, servo_messages
from hapticd.gateway.events import Journal
from hapticd.gateway.feed import Block, Feed
from hapticd.gateway.flight import FlightRecorder, flights_folder
from hapticd.gateway.histogram import StageHistograms
from hapticd.gateway.probe import ProbeDecoder
from hapticd.gateway.state import Transitions, news, state_map
from hapticd.gateway.topics import BY_NAME, Subscriptions
from hapticd.gateway.view import ServoView
from hapticd.params import GatewaySetup
from hapticd.units import NS_PER_S

STATE_PERIOD_NS = NS_PER_S

Message = tuple[str, bytes]  # topic, payload


class Publisher:
    """Turns what the servo writes into messages. `messages` is called at least every few milliseconds."""

    def __init__(
        self, view: ServoView, actors: Actors, journal: Journal, setup: GatewaySetup, unix_ns: Callable[[], int] = time.time_ns
    ) -> None:
        self._view, self._actors, self._journal, self._batch = view, actors, journal, setup.gateway.batch
        self.feed = Feed(view, setup.gateway.batch)
        self.stages = StageHistograms(setup.servo.realtime.grace_s)
        self.flight = FlightRecorder(view, journal, setup, flights_folder(setup.servo.instance), unix_ns)
        self._subscriptions = Subscriptions()
        self._transitions = Transitions(view, actors, journal)
        self._probe = ProbeDecoder(setup.servo.device)
        self._origin = Origin(0, 0, setup.servo.simulated)
        self._life, self._alive = 0, False
        self._news: tuple[Any, ...] = ()
        self._state_ns = -STATE_PERIOD_NS

    def subscribe(self, message: bytes, unix_ns: int) -> list[Message]:
        """Note a subscription or its end; whoever newly asks for `state` gets it at once, for `flight` a checkpoint soon."""
        topics = self._subscriptions.take(message)
        if "flight" in topics:
            self.flight.ask()
        return [self._state(unix_ns)] if "state" in topics else []

    def messages(self, now_ns: int, unix_ns: int) -> list[Message]:
        """Everything that is due."""
        self._notice_servo()
        wanted = self._subscriptions.wanted
        found: list[Message] = []
        noted = self.flight.follow(now_ns)
        if noted and "flight" in wanted:
            found.append(("flight", bytes(msgpack.packb(noted))))  # every number as it is
        for block in self.feed.take(now_ns):
            self.stages.add(block.records, self._origin.epoch)
            self._transitions.follow(block)
            self.flight.add(block, now_ns)
            found += self._ticks(block, wanted)
        self.flight.dump_if_due(now_ns)
        found += self._state_if_due(now_ns, unix_ns)
        found += [("event", _packed(event)) for event in self._journal.drain() if "event" in wanted]
        return found

    def _notice_servo(self) -> None:
        view = self._view
        if view.mailbox and view.life != self._life:
            self._life = view.life
            self._origin = Origin(view.mailbox.epoch, view.unix_offset_ns, view.mailbox.header.simulated)
            self.stages.clear()
            self.flight.begin(self._origin)
            self._probe.forget()
        if view.alive != self._alive:
            self._alive = view.alive
            self._journal.note("servo_up" if view.alive else "servo_down", epoch=self._origin.epoch, text=view.trouble)

    def _ticks(self, block: Block, wanted: frozenset[str]) -> list[Message]:
        found: list[Message] = []
        if "servo" in wanted:
            decimation = BY_NAME["servo"].decimation
            found += [("servo", payload) for payload in servo_messages(block, self._origin, self._batch, decimation)]
        if "servo.raw" in wanted:
            found.append(("servo.raw", raw_message(block, self._origin)))
        if "probe" in wanted:
            found += [("probe", payload) for payload in self._probe.messages(block, self._origin)]
        else:
            self._probe.forget()
        return found

    def _state_if_due(self, now_ns: int, unix_ns: int) -> list[Message]:
        latest = news(self._view)
        if latest == self._news and now_ns - self._state_ns < STATE_PERIOD_NS:
            return []
        self._news, self._state_ns = latest, now_ns
        return [self._state(unix_ns)] if "state" in self._subscriptions.wanted else []

    def _state(self, unix_ns: int) -> Message:
        return "state", _packed(state_map(self._view, self._actors, unix_ns))


def _packed(content: dict[str, Any]) -> bytes:
    return bytes(msgpack.packb(finite(content)))
