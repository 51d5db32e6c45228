"""The yardstick in Python: a simple tick with precompiled structs, and nothing more.

Unpack, difference, two biquads, K-B-M, limit, pack, one 128-byte record. No CRC, no sequence, no
checks, no commands, no ramps, no state but the filters'. It runs on the same frames at the same
pace as the servo's tick.
"""

import struct

from hapticd.core.environment import Environment, FilterParams
from hapticd.render.law import design
from hapticd.usb.frames import IN_SEALED, OUT

RECORD = struct.Struct(
    "<QqIihH4h10dIQ"
)  # number, times, encoder, torque, status, sensors, the law's numbers, flags, number
SLOTS = 8192
assert RECORD.size == 128

Coefficients = tuple[float, float, float, float, float]


class Biquad:
    """Transposed direct form II."""

    def __init__(self, coefficients: Coefficients) -> None:
        self.b0, self.b1, self.b2, self.a1, self.a2 = coefficients
        self.z1 = self.z2 = 0.0

    def step(self, u: float) -> float:
        y = self.b0 * u + self.z1
        self.z1 = self.b1 * u - self.a1 * y + self.z2
        self.z2 = self.b2 * u - self.a2 * y
        return y


class ReferenceTick:
    """A call with a frame and the time returns the OUT frame; `rate_hz` is in the
    filters' input.
    """

    def __init__(
        self,
        kbm: tuple[float, float, float],
        filters: tuple[Coefficients, Coefficients],
        rate_hz: float,
    ) -> None:
        self.stiffness, self.damping, self.mass = kbm
        self.velocity_filter, self.acceleration_filter = (Biquad(one) for one in filters)
        self.rate_hz = rate_hz
        self.m_per_count = 0.5e-6
        self.n_per_count = 8.0 / 32767
        self.limit_n = 8.0
        self.x1 = self.v1 = self.energy_j = 0.0
        self.number = 0
        self.ring = bytearray(SLOTS * RECORD.size)

    def __call__(self, frame: bytes, now_ns: int) -> bytes:
        (
            _,
            _,
            _,
            _,
            status,
            board_us,
            encoder,
            current,
            voltage,
            emf,
            celsius,
            _,
            _,
            _,
            _,
            _,
            _,
            _,
            _,
            _,
            _,
            _,
        ) = IN_SEALED.unpack_from(frame)
        x = encoder * self.m_per_count
        v_raw = (x - self.x1) * self.rate_hz
        a_raw = (v_raw - self.v1) * self.rate_hz
        v = self.velocity_filter.step(v_raw)
        a = self.acceleration_filter.step(a_raw)
        spring = -self.stiffness * x
        damper = -self.damping * v
        inertia = -self.mass * a
        force = max(-self.limit_n, min(self.limit_n, spring + damper + inertia))
        torque = round(force / self.n_per_count)
        self.energy_j += force * (x - self.x1)
        self.x1 = x
        self.v1 = v_raw
        out = OUT.pack(self.number & 0xFFFF, 0, 1, torque, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, b"", 0)
        RECORD.pack_into(
            self.ring,
            self.number % SLOTS * RECORD.size,
            self.number,
            now_ns,
            board_us,
            encoder,
            torque,
            status,
            current,
            voltage,
            emf,
            celsius,
            x,
            v,
            a,
            v_raw,
            a_raw,
            spring,
            damper,
            inertia,
            force,
            self.energy_j,
            0,
            self.number,
        )
        self.number += 1
        return out


def yardstick(environment: Environment, rate_hz: float) -> ReferenceTick:
    """Return the tick with the servo's environment."""
    kbm = (environment.stiffness_n_per_m, environment.virtual_damping_ns_per_m, environment.mass_kg)
    filters = (
        _coefficients(environment.velocity_filter, rate_hz),
        _coefficients(environment.acceleration_filter, rate_hz),
    )
    return ReferenceTick(kbm, filters, rate_hz)


def _coefficients(one: FilterParams, rate_hz: float) -> Coefficients:
    return design(one.frequency_hz, one.damping_ratio, one.mapping, rate_hz)
