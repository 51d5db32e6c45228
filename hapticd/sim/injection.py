"""Seeded faults between the board and the cable, in one table.

An Injector has the board's own methods and sits between it and the backend. Ticks count the OUT
transfers that the host tries, from 0 (none while unplugged). A fault of an IN affects the reply to
that OUT. An InjectionParams acts at its `tick`, or at any tick with its `probability` (1: always),
and then for `count` consecutive ticks. The same seed and the same transfers give the same faults.
Permanent properties of a board are fields of BoardParams instead.

A fault must not need results of the board (it would belong to the board). A packet must not
overtake earlier waiting ones.
"""

import errno
from collections import deque
from collections.abc import Callable
from random import Random
from typing import Generic, NamedTuple, TypeVar

from hapticd.core.errors import ConfigError
from hapticd.core.units import NS_PER_MS, NS_PER_S, NS_PER_US, US_PER_S
from hapticd.model.params import BoardParams
from hapticd.sim.board import BoardModel
from hapticd.usb import codec
from hapticd.usb.frames import StatusBit

__all__ = ["KINDS", "with_injections"]


class TransferFault(Exception):
    """A transfer fails with errno `number`; the device is then away for `away_s`, if given."""

    def __init__(self, number: int, away_s: float | None = None) -> None:
        super().__init__(number)
        self.number = number
        self.away_s = away_s


BOUNCE_NS = (50 * NS_PER_US, 500 * NS_PER_US)  # between two edges of a bouncing contact


class Contact(NamedTuple):
    """An edge of the emergency stop's contact."""

    at_ns: int
    pressed: bool


class Injector:
    """The board of `params` with its injections. ConfigError for an unknown kind."""

    def __init__(self, board: BoardModel, params: BoardParams) -> None:
        for item in params.injections:
            check_kind(item.kind, "the simulated board")
        self.board = board
        self.random = Random(params.seed)
        self.tick = 0  # of the next OUT
        self.postpone_ns = 0  # of the IN that the current OUT will latch
        self.healing: list[tuple[int, int]] = []  # (when, status bits)
        self._injections = params.injections
        self._until = [0] * len(params.injections)
        self._in_faults: list[tuple[InFault, float]] = []
        self.waiting: deque[tuple[int, bytes]] = deque()  # (due, IN packet), oldest first
        self.piling_until_ns = 0  # IN packets until then wait, and arrive together
        self.hung_until_ns = 0  # the firmware answers nothing; its outputs stay constant
        self._stuck_tick = -1  # newest tick at which the encoder was stuck
        self._stuck_encoder = 0
        self._bounce_ns = round(params.emergency_stop_bounce_ms * NS_PER_MS)
        self._contacts: list[Contact] = []  # coming edges of the emergency stop, in order

    def power_up(self) -> None:
        self.forget()
        self._in_faults.clear()
        self.healing.clear()
        self.board.power_up()

    def forget(self) -> None:
        """Drop packets in transit."""
        self.waiting.clear()
        self.piling_until_ns = 0
        self.hung_until_ns = 0

    def on_out(self, data: memoryview, t_ns: int) -> None:
        self._heal(t_ns)
        if self.piling_until_ns:
            self._pile_up(t_ns)
        packet = self._struck(data, t_ns)
        if self._contacts:
            self._switch(t_ns)
        if t_ns < self.hung_until_ns:
            raise TransferFault(errno.ETIMEDOUT)
        if packet is None:
            return
        self.board.on_out(packet, t_ns)
        if self.postpone_ns:
            self.board.postpone_in(self.postpone_ns)
            self.postpone_ns = 0

    def poll_in(self, t_ns: int) -> bytes | None:
        if self.piling_until_ns:
            self._pile_up(t_ns)
        if self._contacts:
            self._switch(t_ns)
        if self.waiting:
            return self.waiting.popleft()[1] if self.waiting[0][0] <= t_ns else None
        latched_ns = self.board.next_in_ns()
        frame = self.board.poll_in(t_ns)
        if frame is not None and self._in_faults:
            faults = sorted(self._in_faults, key=lambda item: item[0] not in SENSED)
            self._in_faults = []
            for fault, value in faults:
                if frame is not None:
                    frame = fault(self, frame, value, latched_ns or t_ns)
        return frame

    def next_in_ns(self) -> int | None:
        return self.waiting[0][0] if self.waiting else self.board.next_in_ns()

    def advance(self, t_ns: int) -> None:
        """Play the board up to `t_ns` without a transfer."""
        self._heal(t_ns)
        if self.piling_until_ns:
            self._pile_up(t_ns)
        if self._contacts:
            self._switch(t_ns)
        self.board.advance(t_ns)

    def control(self, request_type: int, request: int, value: int, length: int) -> bytes | None:
        return self.board.control(request_type, request, value, length)

    def press(self, t_ns: int, until_ns: int) -> None:
        """Press the emergency stop at `t_ns` and release it at `until_ns`."""
        edges = (*self._bouncing(t_ns, True), *self._bouncing(until_ns, False))
        self._contacts = sorted((*self._contacts, *edges))

    def _bouncing(self, t_ns: int, pressed: bool) -> list[Contact]:
        """Return the edges of a contact that ends as `pressed` after bouncing."""
        until_ns = t_ns + self._bounce_ns
        edges: list[Contact] = []
        while t_ns < until_ns:
            edges.append(Contact(t_ns, pressed if not len(edges) % 2 else not pressed))
            t_ns += self.random.randrange(*BOUNCE_NS)
        return [*edges, Contact(until_ns, pressed)]

    def _switch(self, t_ns: int) -> None:
        while self._contacts and self._contacts[0].at_ns <= t_ns:
            self.board.press_stop(*self._contacts.pop(0))

    def stuck_at(self, encoder: int) -> int:
        """Return the reading of a stuck encoder: its count at the first tick of the fault."""
        if self._stuck_tick != self.tick - 1:
            self._stuck_encoder = encoder
        self._stuck_tick = self.tick
        return self._stuck_encoder

    def _pile_up(self, t_ns: int) -> None:
        until_ns = self.piling_until_ns
        latest_ns = min(t_ns, until_ns)
        while (latched_ns := self.board.next_in_ns()) is not None and latched_ns <= latest_ns:
            if (packet := self.board.poll_in(latched_ns)) is not None:
                self.waiting.append((until_ns, packet))
        if t_ns >= until_ns:
            self.piling_until_ns = 0

    def _struck(self, data: memoryview, t_ns: int) -> memoryview | None:
        tick = self.tick
        packet: memoryview | None = data
        self.tick += 1
        self._in_faults.clear()
        self.board.amplifier = None
        self.board.active_damping_gain = 1.0
        for number, item in enumerate(self._injections):
            if tick == item.tick or (item.probability and self.random.random() < item.probability):
                self._until[number] = tick + item.count
            if tick >= self._until[number]:
                continue
            if item.kind in IN_FAULTS:
                self._in_faults.append((IN_FAULTS[item.kind].act, item.value))
            elif packet is not None:
                packet = OUT_FAULTS[item.kind].act(self, packet, item.value, t_ns)
        return packet

    def _heal(self, t_ns: int) -> None:
        for when_ns, status in self.healing:
            if t_ns >= when_ns:
                self.board.heal(status)
        self.healing = [item for item in self.healing if t_ns < item[0]]


# the other end of the cable
Port = BoardModel | Injector


def check_kind(kind: str, where: str) -> None:
    """Return if the board knows injections of this `kind`; otherwise raise ConfigError with
    `where`.
    """
    if kind not in KINDS:
        known = ", ".join(KINDS)
        raise ConfigError(f"{where}: injection kind {kind!r} is unknown; use one of {known}")


def with_injections(board: BoardModel, params: BoardParams) -> Port:
    """Return `board` itself if there is nothing to inject."""
    return Injector(board, params) if params.injections else board


OutFault = Callable[[Injector, memoryview, float, int], memoryview | None]  # OUT packet, value, now
# IN packet, value, latch time
InFault = Callable[[Injector, bytes, float, int], bytes | None]


Act = TypeVar("Act", OutFault, InFault)


class Kind(NamedTuple, Generic[Act]):
    """A fault of an OUT, of the board at that moment, or of the IN that answers an OUT."""

    act: Act
    what: str  # effect
    value: str = ""  # meaning and unit of the value


def _flipped(data: bytes | memoryview, random: Random) -> bytes:
    damaged = bytearray(data)
    damaged[random.randrange(len(damaged))] ^= 1 << random.randrange(8)
    return bytes(damaged)


def _stalled(injector: Injector, packet: bytes | memoryview, value: float, t_ns: int) -> None:
    raise TransferFault(errno.EPIPE)


def _disturbed(injector: Injector, packet: memoryview, value: float, t_ns: int) -> None:
    raise TransferFault(errno.EIO)


def _unplugged(injector: Injector, packet: memoryview, value: float, t_ns: int) -> None:
    raise TransferFault(errno.EIO, away_s=value)


def _corrupted_out(injector: Injector, packet: memoryview, value: float, t_ns: int) -> memoryview:
    return memoryview(_flipped(packet, injector.random))


def _latched_late(injector: Injector, packet: memoryview, value: float, t_ns: int) -> memoryview:
    injector.postpone_ns = round(value * NS_PER_S)
    return packet


def _board_fault(status: StatusBit) -> OutFault:
    def trip(injector: Injector, packet: memoryview, value: float, t_ns: int) -> memoryview:
        injector.board.trip(status.value)
        injector.healing.append((t_ns + round(value * NS_PER_S), status.value))
        return packet

    return trip


def _restarted(injector: Injector, packet: memoryview, value: float, t_ns: int) -> memoryview:
    injector.forget()
    injector.board.restart(t_ns, round(value * US_PER_S))
    return packet


def _hung(injector: Injector, packet: memoryview, value: float, t_ns: int) -> None:
    injector.hung_until_ns = t_ns + round(value * NS_PER_S)


def _hung_unwatched(injector: Injector, packet: memoryview, value: float, t_ns: int) -> None:
    injector.hung_until_ns = t_ns + round(value * NS_PER_S)
    injector.board.stop_watchdog()


def _pressed(injector: Injector, packet: memoryview, value: float, t_ns: int) -> memoryview:
    injector.press(t_ns, t_ns + round(value * NS_PER_S))
    return packet


def _event(injector: Injector, packet: memoryview, value: float, t_ns: int) -> memoryview:
    injector.board.set_event_code(t_ns, round(value) & codec.U16_HIGHEST)
    return packet


def _amplifier(act: Callable[[float, float], float]) -> OutFault:
    """Return a fault with `act(force_n, value)`: the amplifier's output for a commanded force."""

    def strike(injector: Injector, packet: memoryview, value: float, t_ns: int) -> memoryview:
        injector.board.amplifier = lambda force_n: act(force_n, value)
        return packet

    return strike


def _damped(injector: Injector, packet: memoryview, value: float, t_ns: int) -> memoryview:
    injector.board.active_damping_gain = value
    return packet


def _delayed(injector: Injector, packet: bytes, value: float, t_ns: int) -> None:
    injector.waiting.append((t_ns + round(value * NS_PER_S), packet))


def _piled(injector: Injector, packet: bytes, value: float, t_ns: int) -> None:
    due_ns = t_ns + round(value * NS_PER_S)
    injector.waiting.append((due_ns, packet))
    injector.piling_until_ns = due_ns


def _duplicated(injector: Injector, packet: bytes, value: float, t_ns: int) -> bytes:
    injector.waiting.append((t_ns, packet))
    return packet


def _with_nothing_behind(injector: Injector, packet: bytes, value: float, t_ns: int) -> bytes:
    injector.waiting.append((t_ns, b""))
    return packet


def _corrupted_in(injector: Injector, packet: bytes, value: float, t_ns: int) -> bytes:
    return _flipped(packet, injector.random)


def _lengthened(injector: Injector, packet: bytes, value: float, t_ns: int) -> bytes:
    return packet + bytes(round(value) or 1)


def _shortened(injector: Injector, packet: bytes, value: float, t_ns: int) -> bytes:
    return packet[: round(value) or 31]


def _encoder(act: Callable[[Injector, int, float], int]) -> InFault:
    """Return a fault with `act(injector, encoder, value)`: the reading in place of `encoder`."""

    def strike(injector: Injector, packet: bytes, value: float, t_ns: int) -> bytes:
        frame = codec.decode_in(packet)
        encoder = act(injector, frame.encoder, value)
        return codec.encode_in(frame._replace(encoder=(encoder + 2**31) % 2**32 - 2**31))

    return strike


def _scattered(injector: Injector, encoder: int, value: float) -> int:
    most = round(value) or MANY_COUNTS
    return encoder + injector.random.randint(-most, most)


def _saturated(injector: Injector, packet: bytes, value: float, t_ns: int) -> bytes:
    count = round(value) or codec.I16_HIGHEST
    frame = codec.decode_in(packet)
    return codec.encode_in(
        frame._replace(current=count, voltage=count, emf_velocity=count, temperature=count)
    )


MANY_COUNTS = 1_000_000
CAUSE = "how long the cause lasts [s]; the fault stays until CLEAR_FAULT"
HANGS = "the board hangs: outputs stay as they are, OUT is not accepted"
OUT_FAULTS: dict[str, Kind[OutFault]] = {
    "drop_out": Kind(
        lambda injector, packet, value, t_ns: None, "OUT is lost; for the host it was sent"
    ),
    "corrupt_out": Kind(_corrupted_out, "one random bit of OUT flips: the board refuses it"),
    "stall_out": Kind(_stalled, "the OUT endpoint halts until clear_halt"),
    "io_error": Kind(_disturbed, "EIO once, as under electrical interference"),
    "unplug": Kind(_unplugged, "EIO, then ENODEV, then plugged in again", "time away [s]"),
    "late": Kind(_latched_late, "the board latches its reply late", "by how much [s]"),
    "amplifier_fault": Kind(
        _board_fault(StatusBit.AMPLIFIER_FAULT), "the board reports an amplifier fault", CAUSE
    ),
    "encoder_fault": Kind(
        _board_fault(StatusBit.ENCODER_FAULT), "the board reports an encoder fault", CAUSE
    ),
    "over_temperature": Kind(
        _board_fault(StatusBit.OVER_TEMPERATURE), "the board reports a hot winding", CAUSE
    ),
    "emergency_stop": Kind(
        _pressed, "the hard-wired emergency stop is pressed and released", "for how long [s]"
    ),
    "amplifier_stuck": Kind(
        _amplifier(lambda force_n, value: value),
        "the amplifier puts out one force, whatever is commanded, as long as it has authority",
        "that force [N]",
    ),
    "amplifier_limited": Kind(
        _amplifier(lambda force_n, value: max(-value, min(value, force_n))),
        "the amplifier gives less than is commanded",
        "the most that it gives [N]",
    ),
    "amplifier_gain": Kind(
        _amplifier(lambda force_n, value: force_n * value),
        "the amplifier has another gain, or the other polarity",
        "force over commanded force",
    ),
    "active_damping_gain": Kind(
        _damped,
        "the damping circuit damps less, or more, than is commanded",
        "damping over commanded damping",
    ),
    "event_code": Kind(
        _event,
        "the code at the event pins changes, and stays; no fault",
        "the code (0 to 65535)",
    ),
    "restart": Kind(
        _restarted,
        "the firmware restarts without leaving the bus; the device moves on",
        "board time at which it restarts [s]",
    ),
    "hang": Kind(_hung, f"{HANGS}; its watchdog works", "for how long [s]"),
    "hang_unwatched": Kind(
        _hung_unwatched, f"{HANGS}; its watchdog does not work", "for how long [s]"
    ),
}

IN_FAULTS: dict[str, Kind[InFault]] = {
    "drop_in": Kind(
        lambda injector, packet, value, t_ns: None, "IN is lost; for the board it was read"
    ),
    "delay_in": Kind(_delayed, "IN is delivered late", "after its latch [s]"),
    "burst_in": Kind(
        _piled,
        "this IN and those after it pile up on the way, then come all together",
        "for how long [s]",
    ),
    "duplicate_in": Kind(_duplicated, "IN is delivered twice"),
    "zero_length_in": Kind(_with_nothing_behind, "a packet of zero length comes behind IN"),
    "corrupt_in": Kind(_corrupted_in, "one random bit of IN flips"),
    "stall_in": Kind(_stalled, "the IN endpoint halts until clear_halt"),
    "babble": Kind(_lengthened, "IN is longer than a packet", "bytes too many (1)"),
    "short_in": Kind(_shortened, "IN is cut short", "bytes that are left (31)"),
    "encoder_jump": Kind(
        _encoder(lambda injector, encoder, value: encoder + (round(value) or MANY_COUNTS)),
        "the encoder is off",
        "counts (1,000,000)",
    ),
    "encoder_burst": Kind(
        _encoder(_scattered), "the encoder is off by random counts", "most counts (1,000,000)"
    ),
    "encoder_stuck": Kind(
        _encoder(lambda injector, encoder, value: injector.stuck_at(encoder)),
        "the encoder reads the count of the first of these ticks",
    ),
    "sensor_extreme": Kind(
        _saturated, "current, voltage, velocity and temperature are extreme", "counts (32767)"
    ),
}
KINDS = tuple(sorted((*OUT_FAULTS, *IN_FAULTS)))
# wrong readings of the board come before faults of its packet in transit
SENSED = tuple(
    IN_FAULTS[kind].act
    for kind in ("encoder_jump", "encoder_burst", "encoder_stuck", "sensor_extreme")
)
