"""The tick law, from a position to a force: filters, ramps, the law itself, and the energy ledger.

Filters (`design`). They are second-order low-pass filters for the differentiated position.
Continuous prototype H(s) = w^2 / (s^2 + 2 zeta w s + w^2); zeta = 1/sqrt(2) is Butterworth. The
paper (Weir, Colgate and Peshkin 2008, section 2) states "100 Hertz second order digital filter" for
velocity and 72 Hz for acceleration. It states neither damping ratio nor mapping, so both are
parameters. A filter is five numbers (b0, b1, b2, a1, a2) of y = b0 u + z1; z1' = b1 u - a1 y + z2;
z2' = b2 u - a2 y (transposed direct form II), gain 1 at DC.

A corner must be below half the rate (refused otherwise), and the rate must be the tick's.
Coefficients must not be swapped under force: the force would jump now or swell for seconds.

Ramps (`Ramp`). A parameter moves from one value to the next. Each ramp carries its own start tick,
so several may overlap.

Law (`render`). It is implemented once.

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

Energy ledger (`book`). The servo's own ledger has its work, and the excess energy that it
delivered. Work done on the device is positive. The force of the sample before last, or of an
earlier one, is replaced by the newer force d periods after the newer sample. The interval between
two samples, in which the device moves by dx, therefore contains both:

    dW = dx (f_1 + d (f_2 - f_1))       0 <= d < 1; one sample earlier for every whole period

Motion between samples is taken as straight; sums by cause are computed from the records instead
(`protocol.ledger`). A display with ideal elements would have no excess: its work would equal the
energy that its springs, walls and virtual mass lose, or that its physical damping dissipates. The
excess is

    E <- max(0, k E + dW - (F_e + F_e')/2 dx + M (v^2 - v'^2) / 2 - c dx^2 / T)

with F_e the unclamped part of the force of springs and walls, so that -F_e dx is the energy that
they store. Energy that a ramp or a moving wall adds cancels in it. c is the damping that is
certainly present: at least the device's own, and the active damping that the board reports. The sum
leaks with k, slowly compared with any oscillation, and is reset to 0 when the device absorbed more
than it received. Steady motion under a passive environment absorbs more than it receives at every
frequency (Colgate and Schenkel 1997, with c as the physical damping). E therefore keeps only the
part that varies within a swing. A limit cycle grows beyond any bound. Limitations: forces outside
the law that store energy (they count as work). Every clamp must be reported.
"""

import math
from typing import Final, NamedTuple

from hapticd.core.environment import FilterParams
from hapticd.core.errors import ConfigError

__all__ = [
    "BIAS",
    "EMPTY",
    "EXCESS",
    "FORCE",
    "LIMIT",
    "MASS",
    "STIFFNESS",
    "Biquad",
    "Coefficients",
    "LawInputs",
    "LawState",
    "Ledger",
    "Ramp",
    "approach",
    "at_rest",
    "book",
    "clamp",
    "constant",
    "design",
    "design_coefficients",
    "end_force",
    "ledger_at_rest",
    "render",
    "scaled",
    "split",
    "steady",
    "wall_force",
]

# --- filters --------------------------------------------------------------------------------------

Biquad = tuple[float, float, float, float, float]
MAPPINGS = ("prewarped", "bilinear", "matched")


def design(frequency_hz: float, damping_ratio: float, mapping: str, rate_hz: float) -> Biquad:
    """Return the coefficients of a second-order low-pass.

    `mapping`: "prewarped" bilinear (-3 dB point kept), plain "bilinear", or "matched" poles without
    zeros. ConfigError if the corner is not inside 0..rate/2, the damping ratio not positive, or the
    mapping unknown.
    """
    if not 0.0 < frequency_hz < 0.5 * rate_hz:
        raise ConfigError(
            f"filter corner {frequency_hz} Hz: must lie between 0 and {0.5 * rate_hz} Hz, half the"
            " servo rate"
        )
    if not 0.0 < damping_ratio < 100.0:
        raise ConfigError(
            f"filter damping ratio {damping_ratio}: must lie between 0 and 100; 0.7071 is"
            " Butterworth"
        )
    if mapping == "matched":
        return _matched(2.0 * math.pi * frequency_hz / rate_hz, damping_ratio)
    if mapping not in MAPPINGS:
        raise ConfigError(f"filter mapping {mapping!r}: use one of {', '.join(MAPPINGS)}")
    angle = math.pi * frequency_hz / rate_hz
    return _bilinear(math.tan(angle) if mapping == "prewarped" else angle, damping_ratio)


def _bilinear(k: float, zeta: float) -> Biquad:
    scale = 1.0 / (1.0 + 2.0 * zeta * k + k * k)
    b0 = k * k * scale
    return b0, 2.0 * b0, b0, 2.0 * (k * k - 1.0) * scale, (1.0 - 2.0 * zeta * k + k * k) * scale


def _matched(angle: float, zeta: float) -> Biquad:
    radius = math.exp(-zeta * angle)
    spread = angle * math.sqrt(abs(1.0 - zeta * zeta))
    a1 = -2.0 * radius * (math.cos(spread) if zeta <= 1.0 else math.cosh(spread))
    a2 = radius * radius
    return 1.0 + a1 + a2, 0.0, 0.0, a1, a2


def scaled(biquad: Biquad, gain: float) -> Biquad:
    """Return the filter with DC gain `gain`; with the rate as gain, it gives derivatives."""
    b0, b1, b2, a1, a2 = biquad
    return gain * b0, gain * b1, gain * b2, a1, a2


def steady(biquad: Biquad, y: float) -> tuple[float, float]:
    """Return the steady state of a filter with constant output `y`."""
    b0, b1, b2, a1, a2 = biquad
    u = y * (1.0 + a1 + a2) / (b0 + b1 + b2)
    return y - b0 * u, b2 * u - a2 * y


# --- ramps ----------------------------------------------------------------------------------------


class Ramp(NamedTuple):
    """From `start` at `start_tick` to `end` at `start_tick + ticks`; `ticks` = 0 steps at once."""

    start: float
    end: float
    start_tick: int
    ticks: int

    def value(self, tick: int) -> float:
        """Value at `tick`: exactly `end` from the end tick on."""
        done = tick - self.start_tick
        if done >= self.ticks:
            return self.end
        if done <= 0:
            return self.start
        return self.start + (self.end - self.start) * (done / self.ticks)

    def running(self, tick: int) -> bool:
        """Whether a later tick gives another value."""
        return tick < self.start_tick + self.ticks and self.start != self.end

    def towards(self, end: float, tick: int, ticks: int) -> "Ramp":
        """Return a ramp that starts now from the present value."""
        return Ramp(self.value(tick), end, tick, ticks)


def constant(value: float) -> Ramp:
    """Return a finished ramp."""
    return Ramp(value, value, 0, 0)


def approach(value: float, target: float, step: float) -> float:
    """Return `value` moved towards `target` by at most `step` >= 0."""
    if target > value + step:
        return value + step
    if target < value - step:
        return value - step
    return target


# --- law ------------------------------------------------------------------------------------------

LawState = tuple[float, float, float, float, float, float]
# The inputs of one tick, as `render` names them, then environment.FURTHER. An Environment does not
# fit: these include the gain, every ramp's value at this tick, bias, limit and ends of the travel.
# Creating an Environment in every tick would cost the hot path an allocation, and numba compiles no
# attribute access here.
LawInputs = tuple[float, ...]
# indices into the inputs
STIFFNESS: Final = 0
MASS: Final = 2
BIAS: Final = 3
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


# --- energy ledger --------------------------------------------------------------------------------

# work [J], E [J], forces of the last three samples [N], F_e [N], v [m/s]
Ledger = tuple[float, float, float, float, float, float, float]
# indices into a Ledger
EXCESS: Final = 1
FORCE: Final = 2  # of the last sample
EMPTY: Ledger = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def book(
    ledger: Ledger,
    displacement: float,
    force: float,
    delay: float,
    elastic: float,
    mass: float,
    velocity: float,
    resistance: float,
    kept: float,
) -> Ledger:
    """Return the ledger after a sample `displacement` [m] from the last, for which `force` [N] is
    sent.

    `delay`: periods from its sample to the force now in effect, >= 0; `elastic`: share of springs
    and walls in `force` [N]; `mass`: virtual mass [kg]; `velocity`: that of the law [m/s];
    `resistance`: credited damping / period [N/m]; `kept`: factor of E per tick.
    """
    work, excess, newer, older, oldest, elastic_before, velocity_before = ledger
    if delay < 1.0:
        done = displacement * (newer + delay * (older - newer))
    else:
        done = displacement * (older + min(delay - 1.0, 1.0) * (oldest - older))
    stored = 0.5 * mass * (
        velocity * velocity - velocity_before * velocity_before
    ) - 0.5 * displacement * (elastic + elastic_before)
    excess = kept * excess + done + stored - resistance * displacement * displacement
    if excess < 0.0:
        excess = 0.0
    return work + done, excess, force, newer, older, elastic, velocity


def ledger_at_rest(ledger: Ledger) -> Ledger:
    """Return `ledger` after an unknown motion: its sums stay."""
    work, excess, *_ = ledger
    if excess != excess:  # NaN would persist
        excess = 0.0
    return work, excess, 0.0, 0.0, 0.0, 0.0, 0.0
