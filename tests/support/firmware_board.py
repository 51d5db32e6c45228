"""The compiled reference firmware in place of the firmware of the simulated board.

`FirmwareBoard` has the methods of `sim.board.BoardModel`, so it works with the pyusb backend and
the injections. The simulated plant provides the port functions of the C code; the firmware alone
makes the decisions. Between two calls of the firmware its outputs are held. It is called exactly at
the times it requested.

Its clock starts a second before it wraps, so every run longer than that crosses the wrap.

Limitations: times that are not whole microseconds. At 1 kHz a sub-step of T/16 is 62.5 us; all
times are then rounded down, and two sub-steps cancel the error.
"""

import ctypes
from collections.abc import Callable
from ctypes import CFUNCTYPE, POINTER, byref, c_bool, c_int16, c_uint8, c_uint16, c_uint32, c_void_p
from dataclasses import dataclass
from math import ceil, floor
from pathlib import Path
from random import Random
from typing import Any

from hapticd.core.units import NS_PER_S, NS_PER_US
from hapticd.model.params import BoardParams
from hapticd.model.step import SUBSTEPS_PER_TICK, make_plant
from hapticd.sim.axis import EMERGENCY_STOP, READY, Amplifier, i16_count
from hapticd.sim.board import ADVANCE_MAX_NS, VENDOR_OUT, compensates, control_replies, hello
from hapticd.usb import codec, frames
from support.firmware_build import REFERENCE, load_firmware

CLOCK_START_US = 2**32 - 1_000_000
US_MASK = 0xFFFFFFFF
STALL = -1


class Sensors(ctypes.Structure):
    """struct hapticd_sensors."""

    _fields_ = (
        ("encoder", ctypes.c_int32),
        ("current", c_int16),
        ("voltage", c_int16),
        ("emf_velocity", c_int16),
        ("temperature", c_int16),
        ("index_passed", c_bool),
        ("index_count", ctypes.c_int32),
    )


class Config(ctypes.Structure):
    """struct hapticd_config."""

    _fields_ = (
        ("hello", c_uint8 * frames.HELLO_BYTES),
        ("torque_limit", c_int16),
        ("period_us", c_uint16),
        ("phase_us", c_uint16),
    )


PORT = {
    "clock_us": CFUNCTYPE(c_uint32, c_void_p),
    "inputs": CFUNCTYPE(c_uint16, c_void_p),
    "sense": CFUNCTYPE(None, c_void_p, POINTER(Sensors)),
    "measure_pair": CFUNCTYPE(None, c_void_p, POINTER(c_int16)),
    "set_torque": CFUNCTYPE(None, c_void_p, c_bool, c_int16),
    "set_perturbation": CFUNCTYPE(None, c_void_p, c_int16),
    "set_damping": CFUNCTYPE(None, c_void_p, c_uint16),
    "set_resistance": CFUNCTYPE(None, c_void_p, c_int16),
    "send": CFUNCTYPE(None, c_void_p, c_void_p),
    "event_code": CFUNCTYPE(c_uint16, c_void_p),
}


class Port(ctypes.Structure):
    """struct hapticd_port."""

    _fields_ = (("device", c_void_p), *PORT.items())


def config_of(params: BoardParams) -> Config:
    """Return the configuration that the firmware of the board `params` has in flash."""
    hello_bytes = bytearray(codec.encode_hello(hello(params)))
    hello_bytes[: len(frames.PROTOCOL_HASH)] = bytes(len(frames.PROTOCOL_HASH))
    period_us = 1e6 / params.rate_hz
    return Config(
        (c_uint8 * frames.HELLO_BYTES)(*hello_bytes),
        min(codec.I16_HIGHEST, int(params.force_limit_n / params.force_n_per_count)),
        round(period_us),
        round(period_us * params.sample_phase),
    )


@dataclass
class Outputs:
    """The outputs of the DACs."""

    authority: bool = False
    torque: int = 0
    perturbation: int = 0
    damping: int = 0
    resistance: int = 0


class FirmwareBoard:
    """The board of `params`, run by the compiled firmware of `folder`."""

    def __init__(
        self,
        params: BoardParams,
        on_slip: Callable[[int], None] | None = None,
        folder: Path = REFERENCE,
    ) -> None:
        self.params = params
        self.on_slip = on_slip
        self.sim_slip_ns = 0
        self.out_refused = 0
        self.in_replaced = 0
        self.amplifier: Amplifier | None = None
        self.active_damping_gain = 1.0  # of the circuit: damping over command
        self.firmware = load_firmware(folder)
        self.out = Outputs()
        self._plant = make_plant(params)
        self._replies = control_replies(params)
        self._substep_ns = NS_PER_S / (SUBSTEPS_PER_TICK * params.rate_hz)
        self._substep_us = self._substep_ns / NS_PER_US
        noise = params.plant and params.plant.noise
        self._noise = (
            noise.velocity_m_per_s / params.probe_velocity_m_per_s_per_count if noise else 0.0
        )
        self._gauss = Random(params.seed).gauss
        size = ctypes.c_size_t.in_dll(self.firmware, "hapticd_board_bytes").value
        self._board = ctypes.create_string_buffer(size)
        self._config = config_of(params)
        callbacks = {name: kind(getattr(self, f"_{name}")) for name, kind in PORT.items()}
        self._port = Port(None, **callbacks)
        self.state = self._plant.rest(0.0)
        self._life = 0
        self._levels = READY
        self._code = 0
        self.power_up()

    @property
    def _axis(self) -> "FirmwareBoard":
        """Where tests read `force_n` and `damping_n` of a BoardModel."""
        return self

    def power_up(self) -> None:
        self._zero_m = self._plant.encoder(self.state, 0.0, 0.0)
        self._boot(self._plant.rest(self._zero_m), self.params.board_time_us)

    def restart(self, t_ns: int, board_time_us: int) -> None:
        self._advance(t_ns)
        self._zero_m = self._plant.encoder(self.state, 0.0, 0.0)
        self._boot(self.state, board_time_us)

    def _boot(self, state: Any, board_time_us: int) -> None:
        self.state = state
        self._now = 0
        self._origin_ns: int | None = None
        self._causes = 0
        self._ready_ns: int | None = None
        self._frame = b""
        self._mark()
        self._life = self._life + 1 & 0xFF
        assert self.firmware.hapticd_board_boot(
            self._board, byref(self._config), byref(self._port), self._life
        )
        self.firmware.hapticd_begin_at(self._board, c_uint32(board_time_us))

    # --- the methods of BoardModel ----------------------------------------------------------------
    def on_out(self, data: memoryview, t_ns: int) -> None:
        if self._origin_ns is None:
            self._origin_ns = t_ns
        self._advance(t_ns)
        packet = bytes(data)
        taken = self.firmware.hapticd_board_out(self._board, packet, ctypes.c_size_t(len(packet)))
        self.out_refused += not taken

    def poll_in(self, t_ns: int) -> bytes | None:
        while (latch := self._latch_at()) is not None and t_ns >= self._to_ns(latch):
            self._run_to(latch)
        if self._ready_ns is None:
            if latch is None:
                self._advance(t_ns)
            return None
        self._ready_ns = None
        self.firmware.hapticd_board_taken(self._board)
        return self._frame

    def next_in_ns(self) -> int | None:
        if self._ready_ns is not None:
            return self._ready_ns
        latch = self._latch_at()
        return None if latch is None else self._to_ns(latch)

    def control(self, request_type: int, request: int, value: int, length: int) -> bytes | None:
        if not request_type & VENDOR_OUT:
            reply = self._replies.get((request_type, request, value))
            return None if reply is None else reply[:length]
        room = ctypes.create_string_buffer(frames.HELLO_BYTES)
        size = self.firmware.hapticd_board_control(
            self._board, request_type, request, value, 0, length, room
        )
        return None if size == STALL else room.raw[:size]

    def advance(self, t_ns: int) -> None:
        self._advance(t_ns)

    def press_stop(self, t_ns: int, pressed: bool) -> None:
        self._advance(t_ns)
        self._levels = EMERGENCY_STOP if pressed else READY
        self.firmware.hapticd_board_service(self._board)

    def set_event_code(self, t_ns: int, code: int) -> None:
        self._advance(t_ns)
        self._code = code
        self.firmware.hapticd_board_service(self._board)

    def trip(self, faults: int) -> None:
        self._causes |= faults
        self.firmware.hapticd_board_service(self._board)

    def heal(self, faults: int) -> None:
        self._causes &= ~faults

    @property
    def force_n(self) -> float:
        """The present command to the motor."""
        if not self.out.authority:
            return 0.0
        force_n = self.out.torque * self.params.force_n_per_count
        return force_n if self.amplifier is None else self.amplifier(force_n)

    @property
    def torque_n(self) -> float:
        """The perturbation at this moment."""
        return self.out.perturbation * self.params.probe_torque_n_per_count

    @property
    def damping_n(self) -> float:
        """The active damping at this moment, N s/m."""
        return (
            self.active_damping_gain
            * self.out.damping
            * self.params.active_damping_ns_per_m_per_count
        )

    # --- time -------------------------------------------------------------------------------------
    def _to_ns(self, substep: int) -> int:
        return (self._origin_ns or 0) + ceil(substep * self._substep_ns)

    def _substep_in(self, wait_us: int) -> int:
        """The first sub-step that is `wait_us` or more after the clock's reading."""
        return ceil((floor(self._now * self._substep_us) + wait_us) / self._substep_us)

    def _latch_at(self) -> int | None:
        due_us = c_uint32()
        if not self.firmware.hapticd_latch_due(self._board, byref(due_us)):
            return None
        return self._substep_in(due_us.value - self._clock_us(None) & US_MASK)

    def _advance(self, t_ns: int) -> None:
        if self._origin_ns is None:
            return
        substep = floor((t_ns - self._origin_ns) / self._substep_ns + 0.5)
        late = substep - self._now - floor(ADVANCE_MAX_NS / self._substep_ns)
        if late > 0:
            slip_ns = floor(late * self._substep_ns)
            self._origin_ns += slip_ns
            self.sim_slip_ns += slip_ns
            if self.on_slip is not None:
                self.on_slip(slip_ns)
            substep -= late
        self._run_to(substep)

    def _run_to(self, substep: int) -> None:
        while True:
            due = self._substep_in(self.firmware.hapticd_board_wait_us(self._board))
            if due > substep:
                break
            self._play(due)
            self.firmware.hapticd_board_service(self._board)
        self._play(substep)

    def _play(self, substep: int) -> None:
        if substep > self._now:
            self.state = self._plant.step(
                self.state, self.force_n, self.torque_n, self.damping_n, substep - self._now
            )
            self._now = substep

    # --- the port ---------------------------------------------------------------------------------
    def _clock_us(self, _: Any) -> int:
        return CLOCK_START_US + floor(self._now * self._substep_us) & US_MASK

    def _inputs(self, _: Any) -> int:
        return self._levels | self._causes

    def _sense(self, _: Any, sensors: Any) -> None:
        params = self.params
        plant = self._plant
        seen = (self.state, self.force_n, self.damping_n)
        velocity = plant.estimate(*seen)
        current_a = plant.motor_force(*seen) / params.torque_constant_n_per_a
        # from it and its assumed resistance the circuit computes `velocity`
        voltage_v = self._believed_ohm * current_a + params.torque_constant_n_per_a * velocity
        celsius = params.ambient_c if plant.celsius is None else plant.celsius(self.state)
        read = sensors.contents
        read.encoder = floor(
            (plant.encoder(*seen) - self._zero_m) / params.position_m_per_count + 0.5
        )
        read.current = i16_count(current_a / params.current_a_per_count)
        read.voltage = i16_count(voltage_v / params.voltage_v_per_count)
        read.emf_velocity = i16_count(velocity / params.emf_velocity_m_per_s_per_count)
        read.temperature = i16_count(celsius / params.temperature_c_per_count)

    def _mark(self) -> None:
        """Where the running interval began."""
        self._start = self._now
        self._start_m = self._plant.travel(self.state, 0.0, 0.0)
        self._start_ns = self._impulse_ns()

    def _impulse_ns(self) -> float:
        impulse = self._plant.impulse
        return impulse(self.state, 0.0, 0.0) if impulse else 0.0

    def _measure_pair(self, _: Any, pair: Any) -> None:
        params = self.params
        per_s = SUBSTEPS_PER_TICK * params.rate_hz / (self._now - self._start)
        travel_m = self._plant.travel(self.state, 0.0, 0.0) - self._start_m
        kept_n = (self._impulse_ns() - self._start_ns) * per_s
        pair[0] = i16_count(pair[0] + kept_n / params.probe_torque_n_per_count)
        velocity = travel_m * per_s / params.probe_velocity_m_per_s_per_count
        noise = self._noise * self._gauss(0.0, 1.0) if self._noise else 0.0
        pair[1] = i16_count(velocity + noise)
        self._mark()

    def _set_torque(self, _: Any, authority: bool, count: int) -> None:
        self.out.authority = authority
        self.out.torque = count

    def _set_perturbation(self, _: Any, count: int) -> None:
        self.out.perturbation = count

    def _set_damping(self, _: Any, count: int) -> None:
        self.out.damping = count

    def _set_resistance(self, _: Any, count: int) -> None:
        params = self.params
        heating = params.plant and params.plant.heating
        connected_ohm = params.trim_full_scale_ohm if compensates(params) else 0.0
        trim_ohm = count * (connected_ohm / codec.I16_HIGHEST)
        self.out.resistance = count
        self._believed_ohm = (heating.compensated_ohm if heating else params.winding_ohm) + trim_ohm
        if self._plant.compensate is not None:
            self._plant.compensate(trim_ohm)

    def _event_code(self, _: Any) -> int:
        return self._code

    def _send(self, _: Any, frame: int) -> None:
        self.in_replaced += self._ready_ns is not None
        self._frame = ctypes.string_at(frame, frames.IN_BYTES)
        self._ready_ns = self._to_ns(self._now)
