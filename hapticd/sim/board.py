"""The simulated firmware: bytes in, bytes out. Its only time is `t_ns`, a host's integer
nanoseconds.

Every call first plays the plant up to its `t_ns` (to the nearest T/16). An OUT takes effect on
receipt. Its IN is latched `sample_phase` of a tick later, so that the OUT of the next tick acts d =
(1 - sample_phase) T after the encoder was read. One accepted OUT latches one IN. The next IN
replaces an unread one: it is counted, and its event bits and pairs move to the next. A refused OUT
changes nothing, latches nothing and feeds no watchdog. The first OUT starts board time. Replies of
endpoint 0, the hello and the string descriptors, are one table of bytes (`control_replies`).

A paused host must not harm a simulation: one call plays at most 20 ms. The rest is skipped on the
board (board time, watchdog and probe stand still), counted in `sim_slip_ns` and reported to
`on_slip`.

The second state of a plant must be a velocity (otherwise a runaway is not detected), and t_ns must
not be far in the past.
"""

import struct
from binascii import crc_hqx
from collections import deque
from collections.abc import Callable
from dataclasses import fields, replace
from math import ceil, floor, inf

from hapticd.core.errors import ConfigError
from hapticd.core.units import NS_PER_MS, NS_PER_S, NS_PER_US
from hapticd.model.params import BoardParams
from hapticd.model.step import SUBSTEPS_PER_TICK
from hapticd.sim.axis import (
    CLAMPED,
    ENABLE,
    FIFO_CLEAR,
    NEVER,
    PERTURB,
    WATCHDOG,
    Amplifier,
    Axis,
    i16_count,
)
from hapticd.sim.events import EventPins, PinEvent
from hapticd.usb import codec, frames
from hapticd.usb.codec import ENGLISH_US, VENDOR_IN, VENDOR_OUT
from hapticd.usb.frames import Capability, HelloFrame, Request, StatusBit

__all__ = ["make_board"]

ADVANCE_MAX_NS = 20 * NS_PER_MS
RATES_HZ = (250.0, 32_000.0)
LATCHES_MAX = 16
SERIAL_MAX = 16  # of the hello reply
# suffixes of the names of numbers that divide or limit
POSITIVE = ("_per_count", "_per_a", "force_limit_n", "winding_ohm")

UNKNOWN_FLAGS = 0xFF & ~(ENABLE | FIFO_CLEAR | PERTURB)
BAD_FRAME = StatusBit.BAD_FRAME.value
SEQ_GAP = StatusBit.SEQ_GAP.value
SIMULATED = StatusBit.SIMULATED.value
RESERVED = bytes(6)
OUT_BODY = frames.OUT_BYTES - frames.CRC.size
IN_BODY = frames.IN_BYTES - frames.CRC.size
IN_LAYOUTS = tuple(  # by the number of pairs; zeros behind them, and up to the CRC
    struct.Struct(
        f"{frames.IN_HEAD.format}{2 * pairs}h{frames.IN_PAIRS.size - 4 * pairs}x"
        f"{frames.IN_TAIL.format[1:]}"
    )
    for pairs in range(frames.PAIR_MAX + 1)
)


class BoardModel:
    """One simulated board with its plant. ConfigError if `params` are invalid."""

    __slots__ = (
        "_axis",
        "_body",
        "_celsius",
        "_echo",
        "_events",
        "_frame",
        "_has_pins",
        "_in_seq",
        "_latch_at",
        "_latches",
        "_life",
        "_most_numbers",
        "_next_seq",
        "_origin_ns",
        "_pairs_end",
        "_params",
        "_phase",
        "_pins",
        "_ready_events",
        "_ready_ns",
        "_replies",
        "_shown",
        "_substep_ns",
        "_substeps_max",
        "_temperature",
        "_time_us",
        "in_replaced",
        "on_slip",
        "out_refused",
        "sim_slip_ns",
    )

    def __init__(self, params: BoardParams, on_slip: Callable[[int], None] | None = None) -> None:
        _check(params)
        self._params = params
        connected = params if compensates(params) else replace(params, trim_full_scale_ohm=0.0)
        self._axis = Axis(connected)
        self._replies = control_replies(params)
        self._substep_ns = NS_PER_S / (SUBSTEPS_PER_TICK * params.rate_hz)
        self._substeps_max = floor(ADVANCE_MAX_NS / self._substep_ns)
        feels_heat = "temperature" not in params.lacks
        self._celsius = self._axis.plant.celsius if feels_heat else None
        self._temperature = (
            i16_count(params.ambient_c / params.temperature_c_per_count) if feels_heat else 0
        )
        self._most_numbers = 0 if "probe" in params.lacks else 2 * frames.PAIR_MAX
        self._frame = bytearray(frames.IN_BYTES)
        self._body = memoryview(self._frame)[:IN_BODY]
        self.on_slip = on_slip  # called with the ns that the plant missed
        self.sim_slip_ns = 0
        self.in_replaced = 0
        self.out_refused = 0
        self._life = 0
        self._has_pins = "event" not in params.lacks
        self._pins = EventPins()
        self.power_up()

    def power_up(self) -> None:
        """Power up (or replug): every register is zero, and the encoder counts from here."""
        self._axis.power_up()
        self._pins.power_up()
        self._life = self._life + 1 & 0xFF
        self._phase = round(self._params.sample_phase * SUBSTEPS_PER_TICK)
        self._origin_ns: int | None = None
        self._next_seq: int | None = None
        self._in_seq = 0
        self._echo = 0
        self._events = 0
        self._ready_events = 0
        self._pairs_end = 0
        self._shown = 0  # number of the event in the newest frame
        self._latches: deque[int] = deque(maxlen=LATCHES_MAX)
        self._latch_at = NEVER
        self._ready_ns: int | None = None
        self._time_us = self._params.board_time_us

    def restart(self, t_ns: int, board_time_us: int) -> None:
        """Restart the firmware at that board time; the device keeps its motion."""
        self._advance(t_ns)
        state = self._axis.state
        self.power_up()
        self._axis.move_on(state)
        self._time_us = board_time_us

    def on_out(self, data: memoryview, t_ns: int) -> None:
        """Receive an OUT packet at `t_ns`. A protocol violation is refused: it only
        sets BAD_FRAME.
        """
        if self._origin_ns is None:
            self._origin_ns = t_ns
        self._advance(t_ns)
        if len(data) != frames.OUT_BYTES:
            return self._refuse()
        seq, axis, flags, torque, damping, resistance, count, reserved, *samples, tail, crc = (
            frames.OUT.unpack(data)
        )
        if (
            crc != crc_hqx(data[:OUT_BODY], frames.CRC_INITIAL)
            or axis
            or flags & UNKNOWN_FLAGS
            or count > frames.PROBE_MAX
            or reserved
            or tail != RESERVED
        ):
            return self._refuse()
        if seq != self._next_seq and self._next_seq is not None:
            self._events |= SEQ_GAP
        self._echo = seq
        self._next_seq = (seq + 1) & 0xFFFF
        # in the order of their OUTs, also after a postponed one
        behind = self._latches[-1] if self._latches else 0
        self._latches.append(max(self._axis.now + self._phase, behind))
        self._latch_at = self._latches[0]
        tripped = self._axis.status & WATCHDOG
        self._axis.obey(flags, torque, damping, samples[:count], seq, resistance)
        if tripped and not self._axis.status & WATCHDOG:
            self._pins.forget()
        return None

    def poll_in(self, t_ns: int) -> bytes | None:
        """Return the IN frame, once, if one was latched by `t_ns`; otherwise None."""
        while self._latches and t_ns >= self._to_ns(self._latch_at):
            self._run_to(self._latch_at)
        if self._ready_ns is None:
            if not self._latches:
                self._advance(t_ns)
            return None
        self._ready_ns = None
        self._axis.probe.forget(self._pairs_end)
        self._pins.taken(self._shown)
        return bytes(self._frame)

    def next_in_ns(self) -> int | None:
        """Return the latch time of the next or the waiting IN; None if no OUT is unanswered."""
        if self._ready_ns is not None:
            return self._ready_ns
        return self._to_ns(self._latch_at) if self._latches else None

    def advance(self, t_ns: int) -> None:
        """Play the plant up to `t_ns` without a packet from the host: its watchdog runs."""
        self._advance(t_ns)

    def control(self, request_type: int, request: int, value: int, length: int) -> bytes | None:
        """Perform a control transfer: the bytes of an IN, b"" after an OUT, None for a stall."""
        if (request_type, request, value) == (VENDOR_OUT, Request.CLEAR_FAULT.value, 0):
            self._axis.clear_faults()
            return b""
        if (request_type, request) == (VENDOR_OUT, Request.SAMPLE_PHASE.value):
            return None if "sample_phase" in self._params.lacks else self._set_phase(value)
        reply = self._replies.get((request_type, request, value))
        return None if reply is None else reply[:length]

    def _set_phase(self, phase_us: int) -> bytes | None:
        """Latch each IN `phase_us` after its OUT from now on; refuse more than the period."""
        substeps = phase_us * NS_PER_US / self._substep_ns
        if substeps > SUBSTEPS_PER_TICK:
            return None
        self._phase = floor(substeps + 0.5)
        return b""

    def trip(self, faults: int) -> None:
        """Raise the cause of AMPLIFIER_FAULT, ENCODER_FAULT or OVER_TEMPERATURE (Status bits); the
        torque is removed.
        """
        self._axis.trip(faults)

    def heal(self, faults: int) -> None:
        """Remove that cause; the fault stays latched until CLEAR_FAULT."""
        self._axis.heal(faults)

    def press_stop(self, t_ns: int, pressed: bool) -> None:
        """Open or close the contact of the hard-wired emergency stop at `t_ns`."""
        self._advance(t_ns)
        self._axis.press_stop(pressed)

    def set_event_code(self, t_ns: int, code: int) -> None:
        """Set the event pins to `code` (0 to 65535) from `t_ns` on."""
        self._advance(t_ns)
        self._pins.change(code, self._axis.now)

    @property
    def amplifier(self) -> Amplifier | None:
        """Function applied to a commanded force [N]; None: none."""
        return self._axis.amplifier

    @amplifier.setter
    def amplifier(self, amplifier: Amplifier | None) -> None:
        self._axis.amplifier = amplifier

    @property
    def active_damping_gain(self) -> float:
        """Gain of the damping circuit from the next OUT on: damping over its command."""
        return self._axis.active_damping_gain

    @active_damping_gain.setter
    def active_damping_gain(self, gain: float) -> None:
        self._axis.active_damping_gain = gain

    def stop_watchdog(self) -> None:
        """Disable the watchdog until the next OUT is obeyed."""
        self._axis.stop_watchdog()

    def postpone_in(self, delay_ns: int) -> None:
        """Latch the newest IN `delay_ns` later than normal."""
        if self._latches:
            self._latches[-1] += floor(delay_ns / self._substep_ns + 0.5)
            self._latch_at = self._latches[0]

    def _age_us(self, substeps: int) -> int:
        return min(round(substeps * self._substep_ns) // NS_PER_US, codec.U16_HIGHEST)

    def _refuse(self) -> None:
        self._events |= BAD_FRAME
        self.out_refused += 1

    def _to_ns(self, substep: int) -> int:
        return (self._origin_ns or 0) + ceil(substep * self._substep_ns)

    def _advance(self, t_ns: int) -> None:
        if self._origin_ns is None:
            return
        substep = floor((t_ns - self._origin_ns) / self._substep_ns + 0.5)
        late = substep - self._axis.now - self._substeps_max
        if late > 0:
            self._slip(floor(late * self._substep_ns))
            substep -= late
        self._run_to(substep)

    def _slip(self, slip_ns: int) -> None:
        self._origin_ns = (self._origin_ns or 0) + slip_ns
        self.sim_slip_ns += slip_ns
        if self.on_slip is not None:
            self.on_slip(slip_ns)

    def _run_to(self, substep: int) -> None:
        while self._latch_at <= substep:
            self._axis.run_to(self._latch_at)
            self._latch()
        self._axis.run_to(substep)

    def _latch(self) -> None:
        axis = self._axis
        params = self._params
        probe = self._axis.probe
        events = self._events
        latched_at = self._latches.popleft()
        if self._ready_ns is not None:
            self.in_replaced += 1
            events |= self._ready_events
        events |= probe.events | (CLAMPED if axis.clamped else 0)
        self._events = 0
        probe.events = 0
        axis.clamped = False
        plant = axis.plant
        seen = (axis.state, axis.force_n, axis.damping_n)
        velocity_m_per_s = plant.estimate(*seen)
        current_a = plant.motor_force(*seen) / params.torque_constant_n_per_a
        # inverse of the estimate (V - R_hat i) / K: valid at any temperature
        voltage_v = (
            axis.believed_ohm * current_a + params.torque_constant_n_per_a * velocity_m_per_s
        )
        encoder = floor((plant.encoder(*seen) - axis.zero_m) / params.position_m_per_count + 0.5)
        if self._celsius is not None:
            self._temperature = i16_count(
                self._celsius(axis.state) / params.temperature_c_per_count
            )
        # without event pins the fields are 0, including the age
        event = self._pins.shown() if self._has_pins else PinEvent(0, 0, latched_at)
        pairs = probe.pairs[: self._most_numbers]
        count = len(pairs) // 2
        IN_LAYOUTS[count].pack_into(
            self._frame,
            0,
            self._in_seq,
            self._echo,
            0,
            count,
            events | axis.status | axis.levels | SIMULATED,
            ceil(latched_at * self._substep_ns) // NS_PER_US + self._time_us & 0xFFFFFFFF,
            (encoder + 0x80000000 & 0xFFFFFFFF) - 0x80000000,
            i16_count(current_a / params.current_a_per_count),
            i16_count(voltage_v / params.voltage_v_per_count),
            i16_count(velocity_m_per_s / params.emf_velocity_m_per_s_per_count),
            self._temperature,
            len(probe.fifo),
            self._life,
            0,
            probe.first_index & 0xFFFFFFFF,
            *pairs,
            event.code,
            self._age_us(latched_at - event.substep),
            self._age_us(latched_at - axis.torque_since),
            axis.damping_count,
            axis.torque_seq & 0xFF,
            event.number,
        )
        frames.CRC.pack_into(self._frame, IN_BODY, crc_hqx(self._body, frames.CRC_INITIAL))
        self._in_seq = self._in_seq + 1 & 0xFFFF
        self._ready_ns = self._to_ns(latched_at)
        self._ready_events = events
        self._shown = event.number
        self._pairs_end = probe.first_index + count if self._most_numbers else probe.index
        self._latch_at = self._latches[0] if self._latches else NEVER


def _check(params: BoardParams) -> None:
    low_hz, high_hz = RATES_HZ
    if not low_hz <= params.rate_hz <= high_hz:
        raise ConfigError(
            f"the simulated board runs at {low_hz:g}..{high_hz:g} Hz, not at {params.rate_hz:g} Hz;"
            " set rate_hz"
        )
    if not 0.0 <= params.sample_phase <= 1.0 or params.sample_phase * SUBSTEPS_PER_TICK % 1.0:
        raise ConfigError(
            f"sample_phase {params.sample_phase:g} must be a multiple of 1/{SUBSTEPS_PER_TICK} in"
            " 0..1"
        )
    if not 1.0 <= params.watchdog_ms <= 65535.0:
        raise ConfigError(
            f"watchdog_ms {params.watchdog_ms:g} ms is outside 1..65535 ms; 250 ms suits a"
            " simulated board"
        )
    if not params.serial.isascii() or not 1 <= len(params.serial) <= SERIAL_MAX:
        raise ConfigError(
            f"serial {params.serial!r} must be 1..{SERIAL_MAX} ASCII characters; correct the device"
            " file"
        )
    for name in (field.name for field in fields(params)):
        if name.endswith(POSITIVE) and not 0.0 < getattr(params, name) < inf:
            raise ConfigError(
                f"{name} {getattr(params, name)} must be positive; correct the device file"
            )


STANDARD_IN = 0x80
GET_DESCRIPTOR = 0x06
STRING = 0x03
# string indices
MANUFACTURER = 1
PRODUCT = 2
SERIAL = 3
FIRMWARE_VERSION = 0x0100
CAPABILITIES = (
    Capability.PROBE
    | Capability.INTERVAL_MEAN
    | Capability.TEMPERATURE
    | Capability.EMERGENCY_STOP
    | Capability.AMPLIFIER_READY
    | Capability.SAMPLE_PHASE
    | Capability.EVENT
    | Capability.SIMULATED
)

Replies = dict[tuple[int, int, int], bytes]  # by bmRequestType, bRequest, wValue


def hello(params: BoardParams) -> HelloFrame:
    """Return the board's self-description: nominal full scales are value per count times full
    count.
    """
    capabilities = CAPABILITIES
    if compensates(params):
        capabilities |= Capability.RESISTANCE
    for name in params.lacks:
        capabilities &= ~Capability[name.upper()]
    return HelloFrame(
        protocol_hash=frames.PROTOCOL_HASH,
        firmware_version=FIRMWARE_VERSION,
        axis_count=1,
        capabilities=capabilities.value,
        watchdog_ms=round(params.watchdog_ms),
        serial=params.hello_serial or params.serial,
        force_full_scale_n=params.force_n_per_count * codec.I16_HIGHEST,
        damping_full_scale_ns_per_m=params.active_damping_ns_per_m_per_count * codec.U16_HIGHEST,
        probe_torque_full_scale_n=params.probe_torque_n_per_count * codec.I16_HIGHEST,
        probe_velocity_full_scale_m_s=params.probe_velocity_m_per_s_per_count * codec.I16_HIGHEST,
        current_full_scale_a=params.current_a_per_count * codec.I16_HIGHEST,
        voltage_full_scale_v=params.voltage_v_per_count * codec.I16_HIGHEST,
        position_m_per_count=params.position_m_per_count,
        force_limit_n=params.force_limit_n,
    )


def compensates(params: BoardParams) -> bool:
    """Return whether the resistance DAC is connected, to the circuit of a winding that heats up."""
    winding = params.plant is not None and params.plant.heating is not None
    return winding and params.trim_full_scale_ohm != 0.0 and "resistance" not in params.lacks


def string_descriptor(text: str) -> bytes:
    """Return a USB string descriptor: length, type, UTF-16-LE."""
    body = text.encode("utf-16-le")
    return bytes((2 + len(body), STRING)) + body


def control_replies(params: BoardParams) -> Replies:
    """Return all readable contents of endpoint 0; other requests stall."""
    strings = {MANUFACTURER: "hapticd", PRODUCT: "analog board (simulated)", SERIAL: params.serial}
    replies = {
        (STANDARD_IN, GET_DESCRIPTOR, STRING << 8 | i): string_descriptor(text)
        for i, text in strings.items()
    }
    replies[STANDARD_IN, GET_DESCRIPTOR, STRING << 8] = bytes((4, STRING)) + ENGLISH_US.to_bytes(
        2, "little"
    )
    replies[VENDOR_IN, Request.HELLO.value, 0] = codec.encode_hello(hello(params))
    return replies


class QueueingBoard(BoardModel):
    """A board whose endpoint holds `in_queue_depth` IN packets; only further ones wait in the
    firmware, where the next one replaces them.
    """

    __slots__ = ("_depth", "_queue")

    def __init__(self, params: BoardParams, on_slip: Callable[[int], None] | None = None) -> None:
        self._depth = params.in_queue_depth
        super().__init__(params, on_slip)

    def power_up(self) -> None:
        self._queue: deque[tuple[int, bytes]] = deque()  # (latched, packet), oldest first
        super().power_up()

    def on_out(self, data: memoryview, t_ns: int) -> None:
        self._fill(t_ns)
        super().on_out(data, t_ns)

    def poll_in(self, t_ns: int) -> bytes | None:
        self._fill(t_ns)
        return self._queue.popleft()[1] if self._queue else super().poll_in(t_ns)

    def next_in_ns(self) -> int | None:
        return self._queue[0][0] if self._queue else super().next_in_ns()

    def advance(self, t_ns: int) -> None:
        self._fill(t_ns)

    def _fill(self, t_ns: int) -> None:
        """Pass packets to the endpoint, each when it is latched, as long as there is room."""
        while True:
            if len(self._queue) == self._depth:
                return self._advance(t_ns)
            latched_ns = super().next_in_ns()
            if latched_ns is None or latched_ns > t_ns:
                return None
            if (packet := super().poll_in(latched_ns)) is not None:
                self._queue.append((latched_ns, packet))


def make_board(params: BoardParams, on_slip: Callable[[int], None] | None = None) -> BoardModel:
    """Return the board of `params`. ConfigError if they are invalid."""
    return (QueueingBoard if params.in_queue_depth else BoardModel)(params, on_slip)
