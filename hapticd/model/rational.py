"""The condition of the theorem at all angles at once: a rational function and its zeros.

The condition of `theorem` is f(wT) = |1 + C g|^2 - R^2 |C|^2 >= 0. Its sums over the harmonics w_k
are sums of a rational function F over s + 2 pi j k / T, and those are rational in z = e^(jwT):

    sum_k 1 / (s_k - p) = (T/2) coth((s - p) T / 2) = (T/2) (z + e^(pT)) / (z - e^(pT))

so f is real and rational in z and 1/z, which makes it rational in c = cos wT. Its poles are known:

    cosh pT     p: a zero of r(s) - x, r = (Z_o(s) + Z_o(-s)) / 2 with Z_o = 1/P_vt, x the required
                margin; r depends on s^2 alone
    cosh pT     p: a pole of the device with its probe held still; those of the free device cancel
    (z + 1/z)/2     z: a pole of a filter of the law

Each is simple. In R^2 - |g|^2 = (a b - |p|^2) / 4 + .. the double poles at zeros of r - x cancel,
because there one harmonic dominates and a b = |p|^2; so does that at s = 0. With N poles, and a law
and a delay of k whole ticks that reach back k + 3 ticks, f is a polynomial of degree N + k + 3 over
prod (c - c_i): its values at n = N + k + 4 angles determine it.

The angles (`_angles_of`) are those of Chebyshev for rational functions with these poles: psi = (n -
N) wT + sum (wT + 2 arg(1 - z_i e^(-jwT))), |z_i| < 1, grows from 0 to n pi, and cos psi is rational
in c with the same poles. At its zeros the barycentric formula

    f(c) = sum u_m / (c - c_m) / sum w_m / (c - c_m),   w_m = (-1)^m sin(w_m T) / psi'(w_m T),
    u_m = w_m f_m

is exact between them and loses no digits (Berrut and Trefethen 2004). A narrow mode has nodes of
its own, however narrow it is. The zeros of f are those of sum u_m / (c - c_m), which is zero where
diag(t) - 1 (u t^2)' / sum(u t) has an eigenvalue, t = 1 / (s - c) for any s outside of -1..1.

If the command does not move the encoder of the held device, e = 0 and |g|^2 <= R^2 (Cauchy and
Schwarz), so f is concave in (K, B, M): environments that meet the condition are a convex set.

`positive_everywhere` accepts f as positive if it is positive at the nodes, and at the real part of
every zero exceeds its rounding error. A dip below zero has two real zeros about it, or, after
rounding, a conjugate pair at its bottom. An undecided f is not positive. r > x needs no grid
either: r - x has no zero with s^2 < 0.

The list must have all poles. The formula is therefore compared with the sums themselves between the
nodes; if they differ the device is not positive anywhere.
"""

from dataclasses import dataclass

import numpy as np

from hapticd.core.arrays import Complexes, Flags, Floats
from hapticd.model.angles import held_poles
from hapticd.model.loop import Filters, biquad_of, port_states
from hapticd.model.model import Model
from hapticd.model.theorem import NOWHERE, Circles, circles, lifted_system, open_loop, terms_of

_IMAGES = 100  # harmonics on each side
_AT_REST = 1e-5  # |pT|: less is a free position, which is not a pole of f
_FARTHEST = 1e-10  # |z|: poles closer to 0 have no effect
_ON_AXIS = 1e-9  # of |s^2|: within this of s^2 < 0 counts as on it
_FINER = 16  # angles per node of the first evaluation
_ROUNDS = 60  # of bisection, to the last bit of an angle
_ROUNDING = 1e-8  # of the sum of the magnitudes: rounding error of f
_AGREES = 1e-5  # of the same: tolerance against the sums between the nodes
_BEYOND = (1.5, -1.5)  # s above
_TINY = 1e-300  # instead of 0 where it divides


@dataclass(frozen=True, eq=False)
class _Nodes:
    """The n nodes of a device with its filters, common to all its functions."""

    cosine: Floats  # (n,)
    weight: Floats  # (n,) of the barycentric formula

    def at(self, cosine: Floats, values: Floats) -> tuple[Floats, Floats]:
        """Return the functions with `values` (.., 1, n) at the nodes, at `cosine` (.., m), and the
        sum of the magnitudes of their terms.
        """
        away = cosine[..., None] - self.cosine
        shares = self.weight / np.where(away == 0.0, _TINY, away)
        shares /= shares.sum(axis=-1)[..., None]
        parts = shares * values
        return np.asarray(parts.sum(axis=-1)), np.asarray(np.abs(parts).sum(axis=-1))


@dataclass(frozen=True, eq=False)
class Rational:
    """The condition as a rational function of cos wT, given by its values at n nodes."""

    nodes: _Nodes
    form: Floats  # (10, n) as in `theorem.Circles`
    circles: Circles  # at more angles, evenly in psi
    convex: bool  # whether the set of environments that meet it is convex


def rational(
    model: Model, active_damping_ns_per_m: float, filters: Filters, spare_ns_per_m: float
) -> Rational | None:
    """Return the condition for that damping margin; None if no environment is sure to meet it."""
    poles = _poles(model, active_damping_ns_per_m, filters, spare_ns_per_m)
    if poles is None:
        return None
    more = int(model.delay_periods) + 4
    angles = _angles_of(poles, more, 1)
    between = 0.5 * (angles[1:] + angles[:-1])
    seen = open_loop(model, active_damping_ns_per_m, np.concatenate((angles, between)), _IMAGES)
    sums = circles(lifted_system(model, active_damping_ns_per_m, filters, seen), spare_ns_per_m)
    if sums is NOWHERE:
        return None
    form, checks = np.split(sums.form, [angles.size], axis=1)
    nodes = _Nodes(np.cos(angles), _weights(angles, poles, more))
    values, sizes = nodes.at(np.cos(between), form[:, None])
    # in proportion to its weight for an environment near the edge
    near = terms_of(1.0 / np.abs(form[1:4]).max(axis=1)[None]).T
    if not (near * np.abs(values - checks) <= _AGREES * (1.0 + near * sizes)).all():
        return None
    finer = _angles_of(poles, more, _FINER)
    more_of_it = Circles(finer, nodes.at(np.cos(finer), form[:, None])[0])
    return Rational(nodes, form, more_of_it, not _moves_held(model, active_damping_ns_per_m))


def positive_everywhere(found: Rational | None, kbm: Floats) -> Flags:
    """Return whether the condition holds at all angles for the environments `kbm` (N, 3), (N,)."""
    if found is None:
        return np.zeros(len(kbm), np.bool_)
    values = terms_of(kbm) @ found.form
    positive = np.asarray(values.min(axis=1) > 0.0)
    if positive.any():
        positive[positive] = _no_zero(found.nodes, values[positive])
    return positive


def _no_zero(nodes: _Nodes, values: Floats) -> Flags:
    """Return whether functions with positive `values` (N, n) at the nodes stay above 0 between them
    (N,).
    """
    zeros = _zeros(nodes.cosine, nodes.weight * values)
    inside = np.abs(zeros.real) <= 1.0
    least, sizes = nodes.at(np.clip(zeros.real, -1.0, 1.0), values[:, None])
    fine = (least > _ROUNDING * sizes) & (zeros.imag != 0.0)
    return np.asarray((fine | ~inside).all(axis=1))


def _zeros(cosine: Floats, u: Floats) -> Complexes:
    """Zeros (N, n) of sum u_m / (c - c_m), u (N, n)."""
    beyond = np.array(_BEYOND)
    t = 1.0 / (beyond[:, None] - cosine)
    sums = u @ t.T
    best = np.argmax(np.abs(sums) / (np.abs(u) @ np.abs(t.T)), axis=1)
    rows = np.arange(len(u))
    at = t[best]
    root = np.sqrt(np.abs(u))
    matrices = -root[:, :, None] * (np.sign(u) * root * at * at / sums[rows, best, None])[:, None]
    every = np.arange(cosine.size)
    matrices[:, every, every] += at
    values = np.linalg.eigvals(matrices).astype(np.complex128)
    # one eigenvalue is 0, and is not a zero
    return np.asarray(beyond[best, None] - 1.0 / np.where(values == 0.0, _TINY, values))


def _poles(model: Model, level: float, filters: Filters, spare: float) -> Complexes | None:
    """Return the poles (N,) of f inside the unit circle of z; None if the device itself has a
    smaller margin.
    """
    squares = _resistance_zeros(model, level, spare)
    if squares is None or ((squares.real < 0.0) & _real(squares)).any():
        return None
    held = held_poles(model, level) / model.rate_hz
    found = [np.exp(-np.sqrt(squares))]
    moving = held[np.abs(held) > _AT_REST]
    found.append(np.exp(np.where(moving.real > 0.0, -moving, moving)))
    biquads = [biquad_of(one, model.rate_hz) for one in filters if one is not None]
    found.extend(np.roots([1.0, a1, a2]) for *_, a1, a2 in biquads)
    poles = np.concatenate(found)
    return np.asarray(poles[np.abs(poles) > _FARTHEST], np.complex128)


def _real(values: Complexes) -> Flags:
    return np.asarray(np.abs(values.imag) <= _ON_AXIS * np.abs(values))


def _resistance_zeros(model: Model, level: float, spare: float) -> Complexes | None:
    """Return (sT)^2 (m,) at which the resistance is `spare`; None if it is less at high
    frequencies.

    With A of the held device the resistance is d + c A (s^2 - A^2)^-1 b.
    """
    rotor = port_states(model)[0]
    period = 1.0 / model.rate_hz
    a = model.a(level)
    mass = 1.0 / model.b(level)[rotor, model.inputs.torque]
    inner = period * np.delete(np.delete(a, rotor, 0), rotor, 1)
    into = np.delete(a[:, rotor], rotor)
    out = -mass * period * np.delete(a[rotor], rotor)
    at_infinity = -mass * a[rotor, rotor] - spare
    if at_infinity <= 0.0:
        return None
    squares = np.linalg.eigvals(inner @ inner - np.outer(into, out @ inner) / at_infinity)
    return np.asarray(squares[np.abs(squares) > _AT_REST**2], np.complex128)


def _moves_held(model: Model, level: float) -> bool:
    """Return whether a command moves the encoder while the probe is held still."""
    rotor = port_states(model)[0]
    held = np.delete(np.delete(model.a(level), rotor, 0), rotor, 1)
    state = np.delete(model.b(level)[:, model.inputs.command], rotor)
    encoder = np.delete(model.outputs.encoder.row(level), rotor)
    for _ in range(len(held)):
        if encoder @ state != 0.0:
            return True
        state = held @ state
    return False


def _angles_of(poles: Complexes, more: int, finer: int) -> Floats:
    """Return angles (n finer,), ascending, evenly in psi; those of the nodes for `finer` = 1."""
    count = (poles.size + more) * finer
    wanted = np.pi * (np.arange(count) + 0.5) / finer
    low, high = np.zeros(count), np.full(count, np.pi)
    for _ in range(_ROUNDS):
        middle = 0.5 * (low + high)
        above = _phase(middle, poles, more) > wanted
        low, high = np.where(above, low, middle), np.where(above, middle, high)
    return np.asarray(0.5 * (low + high))


def _phase(angles: Floats, poles: Complexes, more: int) -> Floats:
    """Return psi (n,)."""
    turned = np.angle(1.0 - poles * np.exp(-1j * angles)[:, None])
    return np.asarray((more + poles.size) * angles + 2.0 * turned.sum(axis=1))


def _weights(angles: Floats, poles: Complexes, more: int) -> Floats:
    """Return the weights of the barycentric formula (n,), at the nodes."""
    away = np.abs(np.exp(1j * angles)[:, None] - poles) ** 2
    slope = more + ((1.0 - np.abs(poles) ** 2) / away).sum(axis=1)
    weights = np.sin(angles) / slope
    weights[1::2] *= -1.0
    return np.asarray(weights)
