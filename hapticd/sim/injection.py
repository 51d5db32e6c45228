"""Seeded faults between the board and the cable: one table of what can go wrong.

An Injector has the board's own methods and stands between it and the backend. Ticks count the OUT
transfers that the host tries, from 0 (while unplugged there are none); a fault of an IN strikes the
reply to that OUT. An InjectionParams strikes at its `tick`, or at any tick with its `probability`,
and then for `count` ticks on end. The same seed and the same transfers give the same faults.

What would break it: a fault that must know what the board computes (it would belong to the board).
"""

import errno
from collections.abc import Callable
from random import Random

from hapticd.errors import ConfigError
from hapticd.params import BoardParams
from hapticd.sim.board import BoardModel
from hapticd.units import NS_PER_S
from hapticd.wire import codec
from hapticd.wire.frames import StatusBit


class TransferFault(Exception):
    """A transfer fails with errno `number`; the device is away for `away_s` afterwards, if
    given.
    """

    def __init__(self, number: int, away_s: float | None = None) -> None:
        super().__init__(number)
        self.number = number
        self.away_s = away_s


class Injector:
    """The board of `params` with its injections. Raises ConfigError on an unknown kind."""

    def __init__(self, board: BoardModel, params: BoardParams) -> None:
        for item in params.injections:
            if item.kind not in OUT_FAULTS and item.kind not in IN_FAULTS:
                known = ", ".join(sorted((*OUT_FAULTS, *IN_FAULTS)))
                raise ConfigError(f"injection kind {item.kind!r} is unknown; use one of {known}")
        self.board = board
        self.random = Random(params.seed)
        self.tick = 0  # of the next OUT
        self.postpone_ns = 0  # of the IN that the OUT in hand will latch
        self.healing: list[tuple[int, int]] = []  # (when, status bits)
        self._injections = params.injections
        self._until = [0] * len(params.injections)
        self._in_faults: list[tuple[InFault, float]] = []
        self._held: tuple[int, bytes] | None = None

    def power_up(self) -> None:
        self._held = None
        self._in_faults.clear()
        self.healing.clear()
        self.board.power_up()

    def on_out(self, data: memoryview, t_ns: int) -> None:
        self._heal(t_ns)
        packet = self._struck(data, t_ns)
        if packet is None:
            return
        self.board.on_out(packet, t_ns)
        if self.postpone_ns:
            self.board.postpone_in(self.postpone_ns)
            self.postpone_ns = 0

    def poll_in(self, t_ns: int) -> bytes | None:
        if self._held is not None:
            due_ns, packet = self._held
            if t_ns < due_ns:
                return None
            self._held = None
            return packet
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
        return self._held[0] if self._held is not None else self.board.next_in_ns()

    def control(self, request_type: int, request: int, value: int, length: int) -> bytes | None:
        return self.board.control(request_type, request, value, length)

    def hold(self, due_ns: int, packet: bytes) -> None:
        """The next IN packet is this one, from `due_ns` on."""
        self._held = due_ns, packet

    def _struck(self, data: memoryview, t_ns: int) -> memoryview | None:
        tick = self.tick
        packet: memoryview | None = data
        self.tick += 1
        self._in_faults.clear()
        for number, item in enumerate(self._injections):
            if tick == item.tick or (item.probability and self.random.random() < item.probability):
                self._until[number] = tick + item.count
            if tick >= self._until[number]:
                continue
            if item.kind in IN_FAULTS:
                self._in_faults.append((IN_FAULTS[item.kind], item.value))
            elif packet is not None:
                packet = OUT_FAULTS[item.kind](self, packet, item.value, t_ns)
        return packet

    def _heal(self, t_ns: int) -> None:
        for when_ns, status in self.healing:
            if t_ns >= when_ns:
                self.board.heal(status)
        self.healing = [item for item in self.healing if t_ns < item[0]]


def with_injections(board: BoardModel, params: BoardParams) -> BoardModel | Injector:
    """`board` itself when there is nothing to inject."""
    return Injector(board, params) if params.injections else board


OutFault = Callable[[Injector, memoryview, float, int], memoryview | None]  # OUT packet, value, now
# IN packet, value, when it was latched
InFault = Callable[[Injector, bytes, float, int], bytes | None]


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


def _delayed(injector: Injector, packet: bytes, value: float, t_ns: int) -> None:
    injector.hold(t_ns + round(value * NS_PER_S), packet)


def _duplicated(injector: Injector, packet: bytes, value: float, t_ns: int) -> bytes:
    injector.hold(t_ns, packet)
    return packet


def _corrupted_in(injector: Injector, packet: bytes, value: float, t_ns: int) -> bytes:
    return _flipped(packet, injector.random)


def _lengthened(injector: Injector, packet: bytes, value: float, t_ns: int) -> bytes:
    return packet + bytes(round(value) or 1)


def _shortened(injector: Injector, packet: bytes, value: float, t_ns: int) -> bytes:
    return packet[: round(value) or 31]


def _jumped(injector: Injector, packet: bytes, value: float, t_ns: int) -> bytes:
    frame = codec.decode_in(packet)
    encoder = frame.encoder + (round(value) or 1_000_000)
    return codec.encode_in(frame._replace(encoder=(encoder + 2**31) % 2**32 - 2**31))


def _saturated(injector: Injector, packet: bytes, value: float, t_ns: int) -> bytes:
    count = round(value) or codec.I16_HIGHEST
    frame = codec.decode_in(packet)
    return codec.encode_in(
        frame._replace(current=count, voltage=count, emf_velocity=count, temperature=count)
    )


OUT_FAULTS: dict[str, OutFault] = {
    "drop_out": lambda injector, packet, value, t_ns: None,  # lost; the host believes it was sent
    "corrupt_out": _corrupted_out,  # one random bit flipped: the board refuses it
    "stall_out": _stalled,  # the OUT endpoint halts until clear_halt
    "io_error": _disturbed,  # EIO once, as under electrical interference
    "unplug": _unplugged,  # EIO, then ENODEV; plugged in again after `value` s
    "late": _latched_late,  # the board latches the reply `value` s late
    # the cause lasts `value` s, the fault until CLEAR_FAULT
    "amplifier_fault": _board_fault(StatusBit.AMPLIFIER_FAULT),
    "encoder_fault": _board_fault(StatusBit.ENCODER_FAULT),
    "over_temperature": _board_fault(StatusBit.OVER_TEMPERATURE),
}

IN_FAULTS: dict[str, InFault] = {
    "drop_in": lambda injector, packet, value, t_ns: None,  # lost; the board believes it was read
    "delay_in": _delayed,  # delivered `value` s after it was latched
    "duplicate_in": _duplicated,  # delivered twice
    "corrupt_in": _corrupted_in,  # one random bit flipped
    "stall_in": _stalled,  # the IN endpoint halts until clear_halt
    "babble": _lengthened,  # longer than a packet, by `value` bytes (1)
    "short_in": _shortened,  # only the first `value` bytes (31)
    "encoder_jump": _jumped,  # the encoder is off by `value` counts (1,000,000)
    # current, voltage, velocity and temperature read `value` counts (32767)
    "sensor_extreme": _saturated,
}
# what the board reads wrongly comes before what happens to its packet on the way
SENSED = (_jumped, _saturated)
