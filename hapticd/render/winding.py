"""The range of the winding's temperature, and the part of its resistance that a board may
compensate. Standard library only.

The damping circuit (Weir 2008, section 5) derives the back-EMF from the motor's voltage by
subtracting R_hat i. Copper's resistance grows by 0.393 %/K; R_hat does not follow by itself:

    R(T)  = R_ref (1 + a (T - T_ref))        R_hat = base + trim        dR = R(T) - R_hat
    alpha = 1 / (1 + g dR / K^2)             K: endpoint force per ampere, g: active damping

alpha scales damping AND force. A winding hotter than the circuit assumes is safe but weak. A colder
one (dR < 0) makes both stronger, and the circuit oscillates at g dR / K^2 = -1. The trim therefore
follows R(T) from below,

    trim = R(T_c) - base - tolerance,   limited to 0 .. full scale

with T_c the sensor's temperature, but at most the hot end of the winding's range. Without a sensor
T_c is the cold end. Both ends come from a winding that the motor's current heats,

    dT/dt = (T_ambient + R_th R(T) i^2 - T) / tau

with every uncertain value (ambient, R_th, tau) at its hot end for the one and at its cold end for
the other. In between, the solution for a held current is exact. An unknown current is taken as 0:
both ends cool down, and the compensation is too small. For any sensor reading, the loop gain with
the coldest possible winding stays above -0.3 at the highest active damping of the device.

Limitations: a current that reads too high without a sensor, a winding below the coldest ambient of
the device file, a second time constant (a housing that warms up) outside `model_error`.
"""

from math import expm1, inf, isfinite
from typing import Final, NamedTuple, Self

from hapticd.core.params import ResistanceParams

__all__ = [
    "LEAST_LOOP_GAIN",
    "Winding",
    "least_residual_ohm",
    "loop_gain",
    "ohm",
]

LEAST_LOOP_GAIN: Final = (
    -0.3
)  # g dR / K^2; the circuit latches up at -1, at -0.9 its gain is tenfold
COLD: Final = -1.0
HOT: Final = 1.0


class Winding(NamedTuple):
    """The known range of the winding, and the trim in effect."""

    tick: int = 0  # of the last update
    due_tick: int = 0  # of the next one
    low_c: float = 0.0  # cold end of its range
    high_c: float = 0.0  # hot end of its range
    trim_ohm: float = 0.0
    dac_count: int = 0  # for that

    @classmethod
    def unheated(cls, params: ResistanceParams) -> Self:
        """Return a winding with the range of its surroundings only, not compensated beyond count 0.

        One that is already hotter, because the host restarted, is compensated too little until it
        has cooled down to the model's temperature.
        """
        return cls(low_c=params.ambient_low_c, high_c=params.ambient_high_c)

    def heated(
        self, params: ResistanceParams, ampere2: float, elapsed_s: float, limit_c: float
    ) -> Self:
        """Return the winding after `elapsed_s` with the square of its current at `ampere2` [A^2].
        Neither end exceeds `limit_c`, because a hotter winding ends the force.
        """
        low_c = _warmed(params, self.low_c, params.ambient_low_c, ampere2, elapsed_s, COLD)
        high_c = _warmed(params, self.high_c, params.ambient_high_c, ampere2, elapsed_s, HOT)
        return self._replace(low_c=min(low_c, limit_c), high_c=min(high_c, limit_c))

    def target_ohm(
        self,
        params: ResistanceParams,
        sensor_c: float | None,
        active_damping_ns_per_m: float,
    ) -> float:
        """Return its trim [ohm]; `sensor_c` None or not finite: no sensor.
        `active_damping_ns_per_m`: the highest level that the device allows.
        """
        celsius = self.low_c
        if sensor_c is not None and isfinite(sensor_c):
            celsius = min(sensor_c, self.high_c)
        wanted = ohm(params, celsius) - params.base_ohm - params.tolerance_ohm
        furthest = ohm(params, self.low_c) - params.base_ohm
        furthest += over_compensation_ohm(params, active_damping_ns_per_m)
        return max(0.0, min(wanted, furthest, params.full_scale_ohm))


def ohm(params: ResistanceParams, celsius: float) -> float:
    """R(T) [ohm]."""
    return params.winding_ohm * (1.0 + params.per_k * (celsius - params.reference_c))


def _warmed(
    params: ResistanceParams,
    celsius: float,
    ambient_c: float,
    ampere2: float,
    elapsed_s: float,
    end: float,
) -> float:
    error = end * params.model_error
    power_w = ohm(params, celsius) * ampere2
    rise_c = ambient_c + (1.0 + error) * params.thermal_resistance_k_per_w * power_w - celsius
    # the hot end rises faster and falls slower than the winding can, the cold one the other way
    slower = 1.0 - error if rise_c > 0.0 else 1.0 + error
    return celsius - rise_c * expm1(-elapsed_s / (slower * params.time_constant_s))


def over_compensation_ohm(params: ResistanceParams, active_damping_ns_per_m: float) -> float:
    """Return how many ohm beyond the winding's resistance may be compensated at that damping."""
    if active_damping_ns_per_m <= 0.0:
        return inf
    return -LEAST_LOOP_GAIN * params.force_n_per_a**2 / active_damping_ns_per_m


def loop_gain(
    params: ResistanceParams, residual_ohm: float, active_damping_ns_per_m: float
) -> float:
    """Return g dR / K^2."""
    return active_damping_ns_per_m * residual_ohm / params.force_n_per_a**2


def least_residual_ohm(params: ResistanceParams, limit_c: float) -> float:
    """Return the minimum dR [ohm] that a sensor can cause by reading too high, after a long
    current: T_c is the hot end of the model, at most `limit_c`, the winding at its cold one.

    Both ends at the same current: T_low = ambient_low + share R(T_low) / R(limit), linear in T_low.
    """
    rise_c = max(0.0, limit_c - params.ambient_high_c)
    share_c = rise_c * (1.0 - params.model_error) / (1.0 + params.model_error)
    hot_ohm = ohm(params, limit_c)
    slope = share_c * params.winding_ohm * params.per_k / hot_ohm
    coldest_c = (params.ambient_low_c + share_c * ohm(params, 0.0) / hot_ohm) / (1.0 - slope)
    return ohm(params, coldest_c) - hot_ohm + params.tolerance_ohm
