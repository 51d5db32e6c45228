"""The open device in time: exact discretisation of its equations, and stability at a damping level.

Discretisation (`discretise`). Inputs are held over a step of any length:

    x(h) = Phi x + Gamma u,   [Phi Gamma; 0 I] = exp([A B; 0 0] h)

Late command (`late_command`). A command that takes effect the fraction p of a step late splits its
column: the old value acts for p h, the new one for (1 - p) h, Gamma_new = integral over (1 - p) h,
Gamma_old = Gamma - Gamma_new. That is exact; it needs no sub-steps.

Exponential (`expm`). It is computed by scaling, Taylor series and squaring, in extended precision:

    e^X = (e^(X / 2^s))^(2^s),   s such that the 1-norm of X / 2^s is at most 1/2

At norm 1/2 the series of 25 terms is complete to 1e-33. Only rounding remains, and the squarings
amplify it by 2^s at worst. numpy's long double has 64 bits of mantissa on x86 and 113 on ARM Linux.
The result is therefore correct to the last bits of a double. A Pade approximant would save a few
products but need a solver, which long double does not have. The matrix is balanced first by powers
of two (exact), because states in metres and in newtons differ by many orders. Reference: Moler and
Van Loan 2003, "Nineteen dubious ways to compute the exponential of a matrix", method 3.

Precision (`computable`). It reports devices whose numbers double precision cannot handle: a value
of a device file may have the right sign and unit, and still be 1e-308 kg. Computations of the
composed model must be inside it. Limitations: a platform whose long double is a double (the last
three digits are lost).

Stability (`stability`). The eigenvalues without virtual environment decide. A device that nothing
holds in place drifts: translation of all bodies together is an eigenvector with eigenvalue 0, and
without damping a double one. It is divided out first (A t = 0 makes A block triangular in the basis
t, t-perp). So the rest decides, and rounding of a double zero is not mistaken for growth. A
position must be a state named ..._position (its translation would otherwise not be divided out).

Only the damping circuit can make it unstable: resistance over-compensated beyond g dR / K^2 = -1,
an inductance error, or more damping than its bandwidth allows (the ceiling). `explain` lists
states, modes, nonlinearities, and the purpose of each effect.
"""

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from math import ceil, exp, floor, inf, log2, tau

import numpy as np

from hapticd.core.arrays import Floats
from hapticd.core.errors import ConfigError
from hapticd.model.blueprint import Note, StateVariable
from hapticd.model.model import DriveLimits, Map, Model, frozen

__all__ = [
    "AtLevel",
    "Explanation",
    "discretise",
    "drive_response_s",
    "edge",
    "explain",
    "expm",
    "modes",
    "stability",
]

# --- exponential ----------------------------------------------------------------------------------

TERMS = 25
LARGEST_NORM = 0.5
BALANCE_SWEEPS = 8
# of the amplifier's own response to its limits: minimum response of the motor force in a step
LEAST_SHARE = 0.25


@contextmanager
def computable(name: str, what: str) -> Iterator[None]:
    """Raise ConfigError if `what` of `name` divides by zero, overflows or lacks eigenvalues."""
    try:
        with np.errstate(divide="raise", over="raise", invalid="raise"):
            yield
    except (ArithmeticError, np.linalg.LinAlgError) as error:
        raise beyond(name, what, str(error)) from error


def require_finite(name: str, what: str, *arrays: Floats) -> None:
    """Raise ConfigError if `what` of model `name` is not finite: Python's product may overflow to
    infinity.
    """
    if not all(np.isfinite(array).all() for array in arrays):
        raise beyond(name, what, "not finite")


def beyond(name: str, what: str, why: str) -> ConfigError:
    """Return the error for numbers out of range."""
    return ConfigError(
        f"{name!r}: {what} cannot be computed ({why}): a number of the device or scene is beyond"
        " what double precision reaches (some 1e-308 to 1e308); correct the one that is far from"
        " the others"
    )


def expm(matrix: Floats) -> Floats:
    """Return e^matrix for a finite square float64 matrix (n, n). ValueError if it is not finite."""
    if not np.isfinite(matrix).all():
        raise ValueError("the exponential of a matrix that is not finite")
    scale = _balance(matrix)
    balanced = (matrix / scale[:, None] * scale).astype(np.longdouble)
    norm = float(abs(balanced).sum(axis=0).max())
    squarings = max(0, ceil(log2(norm / LARGEST_NORM))) if norm > 0.0 else 0
    result = _series(balanced / np.longdouble(2.0) ** squarings)
    for _ in range(squarings):
        result = result @ result
    return np.asarray(result * scale[:, None] / scale, dtype=np.float64)


def _series(
    small: "np.ndarray[tuple[int, ...], np.dtype[np.longdouble]]",
) -> "np.ndarray[tuple[int, ...], np.dtype[np.longdouble]]":
    identity = np.eye(len(small), dtype=np.longdouble)
    total = identity.copy()
    for k in range(TERMS, 0, -1):
        total = identity + small @ total / k
    return total


def _balance(matrix: Floats) -> Floats:
    """Powers of two d such that rows and columns of diag(d)^-1 M diag(d) are of like size."""
    size = len(matrix)
    scale = np.ones(size)
    off = abs(matrix) * (1.0 - np.eye(size))
    for _ in range(BALANCE_SWEEPS):
        before = scale.copy()
        scaled = off / scale[:, None] * scale
        for i in range(size):
            row = scaled[i].sum()
            column = scaled[:, i].sum()
            if row > 0.0 and column > 0.0:
                factor = 2.0 ** round(0.5 * log2(row / column))
                scale[i] *= factor
                scaled[i] /= factor
                scaled[:, i] *= factor
        if (scale == before).all():  # no later sweep changes it: powers of two are exact
            break
    return scale


# --- discretisation -------------------------------------------------------------------------------

SNAP = 1e-9  # of a step: a delay this close to a whole step is one


def discretise(model: Model, duration_s: float, active_damping_ns_per_m: float = 0.0) -> Map:
    """Return the exact map of `model` over `duration_s` at that damping level, inputs held.
    ConfigError if its numbers are out of range.
    """
    n, m = model.b0.shape
    whole = np.zeros((n + m, n + m))
    what = f"the map over {duration_s:g} s at {active_damping_ns_per_m:g} N s/m"
    with computable(model.name, what):
        whole[:n, :n] = model.a(active_damping_ns_per_m)
        whole[:n, n:] = model.b(active_damping_ns_per_m)
        response = expm(whole * duration_s)
    require_finite(model.name, what, response)
    return Map(
        duration_s, active_damping_ns_per_m, frozen(response[:n, :n]), frozen(response[:n, n:])
    )


def late_command(model: Model, whole: Map, fraction: float) -> tuple[Floats, Floats]:
    """Return columns (old, new), each (n,), of a command that changes within the step `whole`,
    `fraction` (0..1) of the step after its start.
    """
    column = model.inputs.command
    rest = discretise(model, (1.0 - fraction) * whole.duration_s, whole.active_damping_ns_per_m)
    return whole.b[:, column] - rest.b[:, column], rest.b[:, column]


def drive_response_s(limits: DriveLimits, column: int | None, whole: Map) -> float:
    """Return the motion of the motor force per input `column`, by which `limits` act, in the step
    of `whole`, N per N/s. ConfigError if that is too small to end the step inside the limits.
    """
    found = float(whole.b[limits.motor_force, column])
    alone_s = (1.0 - exp(-limits.amplifier_rad_s * whole.duration_s)) / limits.amplifier_rad_s
    if found < LEAST_SHARE * alone_s:
        raise ConfigError(
            f"active damping of {whole.active_damping_ns_per_m:g} N s/m moves the motor force"
            f" within a step of {1e6 * whole.duration_s:g} us more than the amplifier does, so"
            " 'amplifier_limits' cannot hold it; use more sub-steps, or a lower level"
        )
    return found


def delay_steps(delay_periods: float) -> tuple[int, float]:
    """Return (whole periods, fraction of one) from the sample to the effect of the command."""
    count = floor(delay_periods + SNAP)
    fraction = delay_periods - count
    return count, fraction if fraction > SNAP else 0.0


# --- stability ------------------------------------------------------------------------------------

GROWTH_PER_S = 1e-6  # below this is rounding: e-fold in 11 days
HALVINGS = 80  # of an interval, until its ends are neighbours
NEARLY_ZERO_PER_S = 1e-9  # an eigenvalue below this is drift: no time constant, no damping ratio
NEAR_LOOP_GAIN = -0.95  # of -1, where the circuit oscillates
NEAR = "resistance over-compensated almost to the limit; lower the damping or the compensation"


@dataclass(frozen=True, slots=True)
class Stability:
    """Whether the open device is stable at a damping level, by how much, and why."""

    stable: bool
    growth_per_s: float  # largest real part of an eigenvalue
    loop_gain: float  # g dR / K^2; the circuit oscillates at -1
    reason: str  # why it is unstable or nearly so; otherwise empty


def stability(model: Model, active_damping_ns_per_m: float = 0.0) -> Stability:
    """Return the stability of the device alone at that damping level. ConfigError: out of range."""
    growth = float(modes(model, active_damping_ns_per_m).real.max())
    asked = model.level_gain * active_damping_ns_per_m + model.level_offset_ns_per_m
    with computable(model.name, "the gain of the damping circuit"):
        loop = asked * model.residual_ohm / model.torque_constant_n_per_a**2
    stable = growth <= GROWTH_PER_S
    if not stable:
        return Stability(stable, growth, loop, _reason(loop, growth))
    return Stability(stable, growth, loop, NEAR if loop < NEAR_LOOP_GAIN else "")


def modes(
    model: Model, active_damping_ns_per_m: float = 0.0
) -> "np.ndarray[tuple[int], np.dtype[np.complex128]]":
    """Return eigenvalues [1/s] of the device without free translation. ConfigError: out of
    range.
    """
    with computable(model.name, f"the modes at {active_damping_ns_per_m:g} N s/m"):
        a = model.a(active_damping_ns_per_m)
        if model.drifts(active_damping_ns_per_m):
            a = _quotient(a, model.translation())
        return np.asarray(np.linalg.eigvals(a), dtype=np.complex128)


def edge(
    holds: Callable[[float], bool], inside: float, outside: float, halvings: int = HALVINGS
) -> float:
    """Return the last value for which `holds` is true, between `inside` (true) and `outside`."""
    for _ in range(halvings):
        middle = 0.5 * (inside + outside)
        inside, outside = (middle, outside) if holds(middle) else (inside, middle)
    return inside


def _quotient(a: Floats, shift: Floats) -> Floats:
    """Return A after translation of all bodies together is divided out."""
    others = np.eye(len(a))[:, np.argsort(-shift, kind="stable")[1:]]  # all axes but one position
    basis, _ = np.linalg.qr(np.column_stack([shift, others]))
    rest = basis[:, 1:]
    return np.asarray(rest.T @ a @ rest)


def _reason(loop: float, growth: float) -> str:
    if loop <= -1.0:
        return (
            f"resistance over-compensated, g dR / K^2 = {loop:.3g} (limit -1), growth {growth:.3g}"
            " 1/s; lower the damping or the compensation"
        )
    return (
        f"the damping circuit oscillates, growth {growth:.3g} 1/s; lower the damping or widen its"
        " bandwidth"
    )


@dataclass(frozen=True, slots=True)
class Mode:
    """An eigenvalue of the open device; a conjugate pair is one mode."""

    time_constant_s: float  # of its envelope; infinite if it neither decays nor grows
    frequency_hz: float  # 0 for a real eigenvalue
    damping_ratio: float  # 1 for a real eigenvalue that decays, -1 for one that grows


@dataclass(frozen=True, slots=True)
class AtLevel:
    """The open device at one damping level."""

    active_damping_ns_per_m: float  # active damping
    stability: Stability
    alpha: float  # factor on damping and force at DC
    modes: tuple[Mode, ...]  # from slow to fast


@dataclass(frozen=True, slots=True)
class Explanation:
    """The parts of a composed model, and its behaviour at some damping levels."""

    states: tuple[StateVariable, ...]
    nonlinearities: tuple[tuple[str, str], ...]  # effect, description
    notes: tuple[Note, ...]  # purpose of each effect
    levels: tuple[AtLevel, ...]
    delay_s: float  # from the encoder sample to its command
    fastest_s: float  # shortest time constant of all


def explain(model: Model, levels_ns_per_m: Iterable[float] = (0.0,)) -> Explanation:
    """Describe `model`, with its modes at these damping levels."""
    found = tuple(at_level(model, level) for level in levels_ns_per_m)
    highest = max(level.active_damping_ns_per_m for level in found)
    return Explanation(
        states=model.states,
        nonlinearities=tuple(
            (note.effect, note.nonlinearity) for note in model.notes if note.nonlinearity
        ),
        notes=model.notes,
        levels=found,
        delay_s=model.delay_periods / model.rate_hz,
        fastest_s=min((1.0 / abs(value) for value in modes(model, highest) if value), default=inf),
    )


def at_level(model: Model, active_damping_ns_per_m: float) -> AtLevel:
    """Return stability and modes of the open device at that damping level."""
    verdict = stability(model, active_damping_ns_per_m)
    upper = [complex(value) for value in modes(model, active_damping_ns_per_m) if value.imag >= 0.0]
    return AtLevel(
        active_damping_ns_per_m,
        verdict,
        1.0 / (1.0 + verdict.loop_gain),
        tuple(_mode(value) for value in sorted(upper, key=abs)),
    )


def _mode(value: complex) -> Mode:
    size = abs(value)
    decay = -value.real
    time_constant_s = 1.0 / decay if abs(decay) > NEARLY_ZERO_PER_S else inf
    return Mode(
        time_constant_s, abs(value.imag) / tau, decay / size if size > NEARLY_ZERO_PER_S else 0.0
    )
