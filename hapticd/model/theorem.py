"""The physical damping that an environment needs: the theorem of Colgate and Schenkel (1997),
lifted to every delay and device.

A rigid device (`required_damping`). A sampled law answers motion at w also at all w + 2 pi k / T.
In these coordinates the impedance is a diagonal b + j w_k m plus one product: the held force h_k =
c e^(-j w_k d T) / (j w_k), c = H (1 - e^(-jwT)) / T, times the sampled position 1 / (j w_l).
Positive realness of that sum needs

    b >= ( sqrt(|c|^2 S0^2 - Im(c S)^2) + Re(c S) ) / 2,   S0 = sum 1/w_k^2 = (T / (2 sin(wT/2)))^2

at every wT in 0..pi, with S = sum e^(-j w_k d T) / w_k^2. S is linear in d within a tick: S = S0
((1 - d) + d e^(-jwT)), and a whole tick is a factor e^(-jwT). With d = 0 or whole, S is in phase
with S0 and this is Colgate and Schenkel's

    b > T / 2  1 / (1 - cos wT)  Re{ (1 - e^(-jwT)) H }

White noise sees k = 0 alone, which needs less (`baseband`): 0.405 times as much at Nyquist, 5 %
less for a filtered B.

A composed device (`lifted_system`): flexible, smoothed, damped by a circuit, encoder not on the
motor. At each wT the impedance at the probe between the harmonics w_k = w + 2 pi k / T is a
diagonal and one product

    Z = diag(1 / P_vt) + C / (1 + C (G - E)) h q,
    h_k = P_vF H0 / P_vt,  q_l = P_xt / P_vt,  E = sum h_k P_xt(w_k)

(Sherman and Morrison on the admittance of `loop`, all harmonics kept; for a rigid device E = G).
With r_k = Re 1/P_vt the Hermitian part of Z - x is positive exactly where

    1 + ( Re(c p) - sqrt(|c|^2 a b - Im(c p)^2) ) / 2 >= 0,
    a = sum |h|^2/(r - x), b = sum |q|^2/(r - x), p = sum q h/(r - x)

and the largest such x < min r is the damping margin of the device, on which safety decides. It
contains no friction and holds for every input, including a multisine that drives f and 1/T - f
together. Harmonics beyond `_IMAGES` fall at least as 1/w_k^2; their sum in closed form, scaled to
the last one, replaces them.

The loop must be stable, as both conditions assume (`loop.spectral_radius`). Limitations: r_k < 0 of
the device itself, which then has no margin.
"""

from dataclasses import dataclass
from math import ceil, log2
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hapticd.core.arrays import Complexes, Flags, Floats, Integers
from hapticd.model.angles import angles_of, least_between, vertices
from hapticd.model.discrete import edge
from hapticd.model.loop import (
    PAPER_FILTERS,
    Filters,
    derivatives,
    held_force_model,
    pulse_transfer,
    responses,
)
from hapticd.model.model import Model
from hapticd.model.predict import environments

__all__ = [
    "NOWHERE",
    "LiftedSystem",
    "OpenLoop",
    "lifted_margin",
    "lifted_passive",
    "lifted_system",
    "lifted_worst",
    "open_loop",
    "outside_circles",
    "required_damping",
]

_ANGLES = np.concatenate((np.geomspace(1e-3, 0.05, 40)[:-1], np.linspace(0.05, np.pi, 984)))  # wT
_IMAGES = 24  # harmonics on each side
_HALVINGS = 32  # of the interval that contains the damping margin
_NEAR = 1e-8  # of that interval, between the angles: a parabola is an estimate
_FOURFOLD = 9  # steps from its top towards its end, each four times the one before
_CLOSEST = 1e-9  # N s/m to the limit that the device's own damping sets


def required_damping(
    points: npt.ArrayLike,
    rate_hz: float = 1000.0,
    delay_periods: float = 0.0,
    filters: Filters = PAPER_FILTERS,
    baseband: bool = False,
) -> tuple[Floats, Floats]:
    """Return the damping [N s/m] that a rigid device needs under `points` (N, 3), K, B, M in SI,
    and the frequency [Hz] that requires it.

    `filters` are those of velocity and acceleration, None for none. `baseband` gives the
    requirement for white noise instead of all inputs. Both results are (N,) float64; 0 if no
    damping is needed.
    """
    kbm = environments(points)
    half = 0.5 * _ANGLES
    turn = np.exp(1j * _ANGLES)
    law = kbm @ np.stack((np.ones_like(turn), *derivatives(turn, rate_hz, filters)))
    c = law * (2j * np.sin(half) * np.exp(-1j * half)) * rate_hz
    if baseband:
        needed = (c * np.exp(-1j * _ANGLES * delay_periods)).real / (_ANGLES * rate_hz) ** 2
    else:
        whole, part = divmod(delay_periods, 1.0)
        total = (0.5 / (rate_hz * np.sin(half))) ** 2
        late = c * total * turn ** (-whole) * ((1.0 - part) + part / turn)
        needed = 0.5 * (np.sqrt(np.maximum(np.abs(c * total) ** 2 - late.imag**2, 0.0)) + late.real)
    worst = np.argmax(needed, axis=1)
    most = needed[np.arange(len(kbm)), worst]
    return np.maximum(most, 0.0), _ANGLES[worst] * rate_hz / (2.0 * np.pi)


@dataclass(frozen=True, eq=False)
class LiftedSystem:
    """A device at A angles and H harmonics."""

    angles: Floats  # (A,) wT
    law: Complexes  # (3, A) response of the law to K, B, M
    inner: Complexes  # (A,) G - E, m/N
    resistance: Floats  # (A, H) r_k, N s/m
    out: Floats  # (A, H) weights |h|^2
    back: Floats  # (A, H) weights |q|^2
    both: Complexes  # (A, H) weights q h


@dataclass(frozen=True, eq=False)
class OpenLoop:
    """A device without a law at A angles and H harmonics: the part of a lift that is independent of
    delay and filters.
    """

    angles: Floats  # (A,) wT
    frequency_hz: Floats  # (A, H)
    impedance: Complexes  # (A, H) 1 / P_vt, N s/m
    forward: Complexes  # (A, H) P_vF / P_vt, without hold and delay
    back: Complexes  # (A, H) P_xt, m/N


def open_loop(
    model: Model,
    active_damping_ns_per_m: float = 0.0,
    angles: Floats | None = None,  # (A,) wT
    images: int = _IMAGES,  # on each side
) -> OpenLoop:
    """Evaluate `model` at that level of active damping: nine tenths of the work of a lift.

    At `angles`, by default those of its modes (`angles_of`).
    """
    angles = angles_of(model, active_damping_ns_per_m) if angles is None else angles
    harmonics = np.arange(-images, images + 1)
    f = (angles[:, None] / (2.0 * np.pi) + harmonics) * model.rate_hz
    p = responses(model, f.ravel(), active_damping_ns_per_m)
    own = p.velocity[0, 1].reshape(f.shape)
    return OpenLoop(
        angles,
        f,
        1.0 / own,
        p.velocity[0, 0].reshape(f.shape) / own,
        p.encoder[1].reshape(f.shape),
    )


def lifted_system(
    model: Model,
    active_damping_ns_per_m: float = 0.0,
    filters: Filters = PAPER_FILTERS,
    seen: OpenLoop | None = None,
) -> LiftedSystem:
    """Lift `model` at that level of active damping, without Coulomb friction, with filters of
    velocity and acceleration. `seen` is the result of `open_loop` for it, at any delay.
    """
    rate_hz = model.rate_hz
    device = open_loop(model, active_damping_ns_per_m) if seen is None else seen
    f = device.frequency_hz
    turn = np.exp(1j * device.angles)
    out = device.forward * held_force_model(f.ravel(), rate_hz, model.delay_periods).reshape(
        f.shape
    )
    inner = pulse_transfer(model, turn, active_damping_ns_per_m) - (out * device.back).sum(axis=1)
    back = device.back * device.impedance  # q from here on: E needs P_xt itself
    sizes = [np.abs(out) ** 2, np.abs(back) ** 2]
    rest, rest_late = _beyond(device.angles, 2.0 * np.pi * f / rate_hz, model.delay_periods)
    tails = [_last(size, f, rate_hz) * rest for size in sizes]
    late = np.exp(2j * np.pi * f / rate_hz * model.delay_periods)
    tail_both = _last(out * back * late, f, rate_hz) * rest_late
    resistance = device.impedance.real
    return LiftedSystem(
        device.angles,
        np.stack((np.ones_like(turn), *derivatives(turn, rate_hz, filters))),
        inner,
        np.column_stack((resistance, resistance[:, -1])),
        np.column_stack((sizes[0], tails[0])),
        np.column_stack((sizes[1], tails[1])),
        np.column_stack((out * back, tail_both)),
    )


class Margin(NamedTuple):
    """The damping margin of one environment, and its frequency."""

    margin_ns_per_m: float  # negative if damping is missing
    worst_hz: float  # between 0 and half the servo's rate


def lifted_worst(lifted: LiftedSystem, point: npt.ArrayLike, rate_hz: float) -> Margin:
    """Return the margin of one environment (3,) as `lifted_margin`, and the frequency [Hz] that
    sets it, at servo rate `rate_hz`.
    """
    margin, angle = _spare(lifted, (environments(np.atleast_2d(np.asarray(point))) @ lifted.law)[0])
    return Margin(margin, float(lifted.angles[angle]) * rate_hz / (2.0 * np.pi))


def lifted_margin(lifted: LiftedSystem, points: npt.ArrayLike) -> Floats:
    """Return the damping margin (N,) [N s/m] of the device at the probe under `points` (N, 3);
    negative if damping is missing.

    For a rigid device it is its damping minus `required_damping`.
    """
    return np.array([_spare(lifted, law)[0] for law in environments(points) @ lifted.law])


def lifted_passive(lifted: LiftedSystem, points: npt.ArrayLike) -> Flags:
    """Return whether the damping margin is not negative (N,), for maps.

    It needs one evaluation per environment instead of dozens, and estimates between the angles
    (`rational` does not). The loop must be stable. False for K < 0, which is active below all
    evaluated angles.
    """
    kbm = environments(points)
    return outside_circles(circles(lifted), kbm) & (kbm[:, 0] >= 0.0)


@dataclass(frozen=True, eq=False)
class Circles:
    """Circles at A angles that -1/C must not be in, for a damping margin: |1 + C g| >= R |C|.

    Both sides squared are a quadratic form in (1, K, B, M) with the coefficients `form`: a yes or
    no costs ten products per angle, whatever the device.
    """

    angles: Floats  # (A,) wT
    form: Floats  # (10, A) of 1, K, B, M, K K, K B, K M, B B, B M, M M


_PAIRS = np.triu_indices(3)
NOWHERE = Circles(np.full(1, np.pi), -1.0 * (np.arange(10.0) == 0.0)[:, None])  # holds for none


def circles(lifted: LiftedSystem, spare_ns_per_m: float = 0.0) -> Circles:
    """Return the circles for that damping margin. With c = C / (1 + C (G - E)) the module's
    condition is this one with g = G - E + p / 2 and R = sqrt(a b) / 2.

    A device with less damping than the margin is never passive: its forms are negative.
    """
    resistance = lifted.resistance - spare_ns_per_m
    if resistance.min() <= 0.0:
        return NOWHERE
    centre, excess = _circle(lifted, spare_ns_per_m, np.arange(lifted.angles.size))
    law = lifted.law
    one, other = _PAIRS
    twice = np.where(one == other, 1.0, 2.0)[:, None]
    squares = twice * (law[one] * law[other].conj()).real * excess
    form = np.vstack((np.ones(len(centre)), 2.0 * (law * centre).real, squares))
    return Circles(lifted.angles, form)


def terms_of(kbm: Floats) -> Floats:
    """Return the terms of a form (N, 10): 1, K, B, M and their products, `kbm` (N, 3)."""
    one, other = _PAIRS
    return np.column_stack((np.ones(len(kbm)), kbm, kbm[:, one] * kbm[:, other]))


def outside_circles(allowed: Circles, kbm: Floats) -> Flags:
    """Return True (N,) where -1/C of the environments `kbm` (N, 3) is outside all circles,
    estimated also between the angles: passive, if stable.
    """
    values = terms_of(kbm) @ allowed.form
    outside = np.asarray(values.min(axis=1) >= 0.0)
    if values.shape[1] > 2:
        outside[outside] = least_between(allowed.angles, values[outside]) >= 0.0
    return outside


def _share(lifted: LiftedSystem, spare: float, angles: Integers) -> Floats:
    """1 / (r - x) (n, H) at some `angles`."""
    return np.asarray(1.0 / np.maximum(lifted.resistance[angles] - spare, _CLOSEST))


def _sums(
    lifted: LiftedSystem, share: Floats, angles: Integers
) -> tuple[Floats, Floats, Complexes]:
    """Return a, b and p of the module docstring at some `angles`, weighted by `share` (n, H)."""
    out, back, both = (
        np.einsum("ah,ah->a", weights[angles], share)
        for weights in (lifted.out, lifted.back, lifted.both)
    )
    return out, back, both


def _circle(lifted: LiftedSystem, spare: float, angles: Integers) -> tuple[Complexes, Floats]:
    """Return g and |g|^2 - R^2 of the circles at some `angles`.

    For the harmonic next to 0 Hz alone a b = |p|^2, at low frequencies a million times the
    remainder.
    """
    share = _share(lifted, spare, angles)
    first = share.shape[1] // 2 - 1
    a, b, p = (
        weights[angles, first] * share[:, first]
        for weights in (lifted.out, lifted.back, lifted.both)
    )
    share[:, first] = 0.0
    out, back, both = _sums(lifted, share, angles)
    gap = a * back + b * out + out * back - 2.0 * (p.conj() * both).real - np.abs(both) ** 2
    inner = lifted.inner[angles]
    excess = np.abs(inner) ** 2 + (inner.conj() * (p + both)).real - 0.25 * gap
    return inner + 0.5 * (p + both), excess


def _positive(lifted: LiftedSystem, gain: Complexes, spare: float, angles: Integers) -> Flags:
    out, back, both = _sums(lifted, _share(lifted, spare, angles), angles)
    c = gain[angles]
    cp = c * both
    form = 2.0 + cp.real - np.sqrt(np.maximum(np.abs(c) ** 2 * out * back - cp.imag**2, 0.0))
    return np.asarray(form >= 0.0)


def _spare(lifted: LiftedSystem, law: Complexes) -> tuple[float, int]:
    """Return the damping margin, and the index of the angle that sets it. A condition that holds
    for a larger margin holds for a smaller one. Only failed angles are therefore evaluated again,
    downwards in steps that grow fourfold, then by bisection.
    """
    gain = law / (1.0 + law * lifted.inner)  # c of the module docstring
    high = float(lifted.resistance.min())
    sizes = lifted.out.sum(axis=1) * lifted.back.sum(axis=1)
    span = float(np.max(np.abs(gain) * np.sqrt(sizes))) + 1e-9
    low = high - span
    down = span * 4.0**-_FOURFOLD
    angles = np.arange(gain.size)
    worst = int(np.argmin(lifted.resistance.min(axis=1)))
    falling = True
    for _ in range(_FOURFOLD + _HALVINGS):
        if high - low <= span * 2.0**-_HALVINGS:
            break
        middle = high - down if falling else 0.5 * (low + high)
        down *= 4.0
        positive = _positive(lifted, gain, middle, angles)
        if positive.all():
            low = middle
            falling = False
        else:
            high = middle
            angles = angles[~positive]
            worst = int(angles[0])
            falling = falling and high - down > low
    return _spare_between(lifted, law, low, span), worst


def _spare_between(lifted: LiftedSystem, law: Complexes, spare: float, span: float) -> float:
    """Return the damping margin of an environment with that margin at the angles themselves: less
    if the condition has a vertex below 0 between two of them.
    """
    every = np.arange(law.size)
    _, place, least = vertices(lifted.angles, _outside(lifted, law, spare, every)[None])
    three = place[least < 0.0, None] + np.array([-1, 0, 1])
    if not three.size:
        return spare

    def holds(level: float) -> bool:
        values = _outside(lifted, law, level, three.ravel()).reshape(three.shape)
        found = [
            vertices(*one)[2] for one in zip(lifted.angles[three], values[:, None], strict=True)
        ]
        return all((one >= 0.0).all() for one in found)

    share = 4.0**-_FOURFOLD
    while share < 1.0 and not holds(spare - share * span):
        share *= 4.0
    return edge(holds, spare - share * span, spare, ceil(log2(share / _NEAR)))


def _outside(lifted: LiftedSystem, law: Complexes, spare: float, angles: Integers) -> Floats:
    """Return how far -1/C is outside the circles of `circles`, |1 + C g|^2 - R^2 |C|^2 (n,)."""
    centre, excess = _circle(lifted, spare, angles)
    c = law[angles]
    return np.asarray(1.0 + 2.0 * (c * centre).real + (c.real**2 + c.imag**2) * excess)


def _beyond(angles: Floats, harmonics: Floats, delay_periods: float) -> tuple[Floats, Complexes]:
    """Return the sums of 1/(w_k T)^2 and e^(-j w_k d T)/(w_k T)^2 at `angles` (A,) over the
    harmonics beyond `harmonics` (A, H) = w_k T.
    """
    whole, part = divmod(delay_periods, 1.0)
    total = (0.5 / np.sin(0.5 * angles)) ** 2
    turn: Complexes = np.exp(-1j * angles)
    late: Complexes = total * turn**whole * ((1.0 - part) + part * turn)
    return total - (1.0 / harmonics**2).sum(axis=1), late - (
        np.exp(-1j * harmonics * delay_periods) / harmonics**2
    ).sum(axis=1)


def _last(weights: npt.NDArray[np.inexact], f: Floats, rate_hz: float) -> "npt.NDArray[np.inexact]":
    """Return the weights times (w_k T)^2 at the outermost harmonics, mean of both ends (A,)."""
    angles = 2.0 * np.pi * f / rate_hz
    return 0.5 * (weights[:, 0] * angles[:, 0] ** 2 + weights[:, -1] * angles[:, -1] ** 2)
