"""One rigid mass with viscous damping under a held force: the exact response, for any damping down to none.

    m dv/dt = f - c v,   dx/dt = v,   f held for a time h,   a = c h / m

    v(h) = v e^-a          + (h / m)   phi1(a) f         phi1(a) = (1 - e^-a) / a
    x(h) = x + h phi1(a) v + (h^2 / m) phi2(a) f         phi2(a) = (1 - phi1(a)) / a

Written with phi1 and phi2 nothing is divided by c, so c -> 0 is no special case: phi1 comes from expm1, phi2 (which
would cancel) from its series below |a| = 1. At the servo's sub-steps a is about 0.003.

What would break it: a force that changes within h (hold it, as the amplifier does) or a spring (not in this model).
"""

from math import exp, expm1, factorial

Response = tuple[float, float, float, float]

_PHI2_SERIES = tuple((-1) ** k / factorial(k + 2) for k in reversed(range(18)))  # last term < 1e-17 at |a| = 1


def phi1(a: float) -> float:
    """(1 - e^-a) / a, 1 at a = 0."""
    return -expm1(-a) / a if a else 1.0


def phi2(a: float) -> float:
    """(a - 1 + e^-a) / a^2, 1/2 at a = 0."""
    if abs(a) >= 1.0:
        return (1.0 - phi1(a)) / a
    total = 0.0
    for coefficient in _PHI2_SERIES:
        total = total * a + coefficient
    return total


def held_force_response(mass_kg: float, damping_ns_per_m: float, duration_s: float) -> Response:
    """Coefficients (decay, velocity_per_n, position_per_velocity, position_per_n) of a mass under a held force f:

    v' = decay v + velocity_per_n f;  x' = x + position_per_velocity v + position_per_n f.  Units: 1, m/s/N, s, m/N.
    """
    a = damping_ns_per_m * duration_s / mass_kg
    reach_s = duration_s * phi1(a)
    return exp(-a), reach_s / mass_kg, reach_s, duration_s * duration_s / mass_kg * phi2(a)
