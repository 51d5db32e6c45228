"""The tick law: from a position to a force, implemented once.

    v = LP_velocity[(x_n - x_{n-1}) / T]            second-order low-pass, 100 Hz
    a = LP_acceleration[(x_n - 2 x_{n-1} + x_{n-2}) / T^2]   second-order low-pass, 72 Hz
    F = clamp(bias - K x - B v - M a + field)       K on raw position (Weir, Colgate and Peshkin
                                                    2008, section 2)

The field is a unilateral wall and the springs at the ends of the workspace. The servo runs `render`
in CPython; the batch engine compiles the same functions with numba. The code therefore has floats
and tuples of floats as arguments and results, and no attribute access, defaults or keyword
arguments. Coefficients are designed outside, and helpers are called only in the rare case. Both
filters always run, so that B and M may be switched on without a jump. The rate is folded into the
filter coefficients: they act on differences. Positive force pushes to positive x.

A compiler must use neither fastmath nor contraction (bits would differ from CPython), and
coefficients must be for the rate. A limit must test that the force is not inside it, not that the
force is outside: only the first is also true of NaN, which `clamp` then turns into 0.
"""

from typing import Final

from hapticd.core.environment import FilterParams
from hapticd.render.filters import Biquad, design, scaled

__all__ = [
    "LIMIT",
    "MASS",
    "Coefficients",
    "LawInputs",
    "LawState",
    "at_rest",
    "clamp",
    "design_coefficients",
    "end_force",
    "render",
    "split",
    "wall_force",
]

LawState = tuple[float, float, float, float, float, float]
# The inputs of one tick, as `render` names them, then environment.FURTHER. An Environment does not
# fit: these include the gain, every ramp's value at this tick, bias, limit and ends of the travel.
# Creating an Environment in every tick would cost the hot path an allocation, and numba compiles no
# attribute access here.
LawInputs = tuple[float, ...]
# indices into the inputs
MASS: Final = 2
LIMIT: Final = 4
Coefficients = tuple[float, float, float, float, float, float, float, float, float, float]
Rendered = tuple[float, float, float, float, float, float, float, float, LawState]


def render(
    x: float, state: LawState, environment: LawInputs, coefficients: Coefficients
) -> Rendered:
    """One tick of the law at position `x` [m].

    `state` = (x_{n-1}, x_{n-1} - x_{n-2}, filter states); `environment` = (K, B, M, bias, limit,
    wall stiffness, damping, position, side, lower end, upper end, end stiffness) in SI;
    `coefficients` as `design_coefficients` makes them. Returns (force, sum before the clamp, v, a,
    K part, B part, M part, field part, new state) in N, m/s, m/s^2.
    """
    x1, d1, vz1, vz2, az1, az2 = state
    (
        stiffness,
        damping,
        mass,
        bias,
        limit,
        wall_k,
        wall_b,
        wall_x,
        wall_side,
        lower,
        upper,
        end_k,
    ) = environment
    vb0, vb1, vb2, va1, va2, ab0, ab1, ab2, aa1, aa2 = coefficients
    d = x - x1
    dd = d - d1
    v = vb0 * d + vz1
    a = ab0 * dd + az1
    after = (
        x,
        d,
        vb1 * d - va1 * v + vz2,
        vb2 * d - va2 * v,
        ab1 * dd - aa1 * a + az2,
        ab2 * dd - aa2 * a,
    )
    spring = -stiffness * x
    damper = -damping * v
    inertia = -mass * a
    field = 0.0
    if wall_side != 0.0:
        field = wall_force(x, v, wall_k, wall_b, wall_x, wall_side)
    # no chained comparison: CPython compares two floats faster alone; NaN does not pass
    if not (x >= lower and x <= upper):
        field += end_force(x, lower, upper, end_k)
    total = bias + spring + damper + inertia + field
    force = total
    if not (force <= limit and force >= -limit):
        force = clamp(force, limit)
    return force, total, v, a, spring, damper, inertia, field, after


def design_coefficients(
    velocity: FilterParams, acceleration: FilterParams, rate_hz: float
) -> Coefficients:
    """Return the coefficients for differences at `rate_hz`: the first filter gives m/s, the second
    m/s^2. ConfigError as `design`.
    """
    first = design(velocity.frequency_hz, velocity.damping_ratio, velocity.mapping, rate_hz)
    second = design(
        acceleration.frequency_hz, acceleration.damping_ratio, acceleration.mapping, rate_hz
    )
    return scaled(first, rate_hz) + scaled(second, rate_hz * rate_hz)


def at_rest(x: float) -> LawState:
    """Return the steady state of a device at rest at `x`."""
    return x, 0.0, 0.0, 0.0, 0.0, 0.0


def split(coefficients: Coefficients) -> tuple[Biquad, Biquad]:
    """Velocity and acceleration filter of `coefficients`."""
    return coefficients[:5], coefficients[5:]


def wall_force(
    x: float, v: float, stiffness: float, damping: float, position: float, side: float
) -> float:
    """Return the force [N] of a wall that is solid where (x - position) * side > 0: spring and
    damper, never pulling (Colgate 1994).
    """
    depth = (x - position) * side
    if depth > 0.0:
        push = stiffness * depth + damping * v * side
        if push > 0.0:
            return -push * side
    return 0.0


def end_force(x: float, lower: float, upper: float, stiffness: float) -> float:
    """Return the force [N] of the springs at the ends of the workspace; 0 between them."""
    if x > upper:
        return -stiffness * (x - upper)
    if x < lower:
        return -stiffness * (x - lower)
    return 0.0


def clamp(force: float, limit: float) -> float:
    """Return `force` [N] limited to +-limit; NaN becomes 0."""
    if force > limit:
        return limit
    if force < -limit:
        return -limit
    if force != force:
        return 0.0
    return force
