"""What a hand can do to a display: which environments no passive hand brings to oscillate, and the
hand that does.

A hand adds Z_h(jw_k), anything with Re Z_h >= 0, to the device's 1/P_vt at each harmonic w_k = w +
2 pi k / T. The inverse of their sum lies in a circle over the diameter 0..1/r_k, r_k = Re 1/P_vt.
So does, harmonic by harmonic, what the law sees: with the terms of `lifted` the pulse transfer of
device and hand together is

    G_h(wT) = e + sum h_k q_k / (1/P_vt + Z_h),    |G_h - g| <= R,
    g = e + sum h q / (2 r),   R = sum |h q| / (2 r)

and the loop closes as 1 + C G_h. A hand can be let in slowly, s Z_h with s from 0 to 1: all of
these are passive. If -1/C is outside the circle at every wT, no eigenvalue ever meets |z| = 1 on
the way; what was stable alone is stable in every hand (zero exclusion). Inside it, masses and
springs that reach the rim exist (`shaking_hand`): for hands that do not change with time this is
necessary as well as sufficient. The lifted requirement has sqrt(sum |h|^2/r sum |q|^2/r) in place
of sum |hq|/r, the same for a rigid device and up to 4-15 % more for the calibrated ones, because it
also holds for hands that mix harmonics, a grip that changes. What it passes, this does.

Friction, as a damper on the rotor, adds to r and to nothing else; it counts only for motions as
small as those at which it was linearised. What would break it: an environment that is unstable with
no hand at all, see `closed`; a hand that holds the device elsewhere than at the probe, where
another impedance is met.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hapticd.analysis.arrays import Complexes, Flags, Floats
from hapticd.analysis.closed import spectral_radius
from hapticd.analysis.hands import GROUND, Hand, Network, held_by
from hapticd.analysis.lifted import ANGLES, Lift, lift
from hapticd.analysis.loop import PAPER_FILTERS, Filters, held, responses
from hapticd.analysis.predict import environments
from hapticd.plant.model import Model

_IMAGES = np.array([0.0, -1.0, 1.0, -2.0, 2.0, -3.0, 3.0, -4.0, 4.0])  # for which a hand is tuned
_DETUNED = (1e-3, 1e-4, 1e-5)  # resonances beside the frequencies that they serve
_ENDLESS = 1e200  # times 0 is 0
_LAST = 0.98 * np.pi  # nearer to half the servo's rate a frequency and its image are one


@dataclass(frozen=True, eq=False)
class Reach:
    """The circle, `centre` (A,) and `radius` (A,), that holds the pulse transfer in every
    passive hand, at `lifted.ANGLES`.
    """

    centre: Complexes
    radius: Floats


def reach(lifted: Lift, friction_ns_per_m: float = 0.0) -> Reach:
    """Of a device, with that damper on its rotor. Without any damping of its own there is no
    end to it.
    """
    resistance = lifted.resistance + friction_ns_per_m
    if resistance.min() <= 0.0:
        return Reach(lifted.inner, np.full(lifted.inner.size, _ENDLESS))
    return Reach(
        lifted.inner + 0.5 * (lifted.both / resistance).sum(axis=1),
        0.5 * (np.sqrt(lifted.out * lifted.back) / resistance).sum(axis=1),
    )


def withstands(
    lifted: Lift, points: npt.ArrayLike, friction_ns_per_m: npt.ArrayLike = 0.0
) -> Flags:
    """Whether no passive hand brings environments (N, 3) to oscillate that are stable without a
    hand: (N,).

    `friction_ns_per_m` (N,) or one for all: of the rotor.
    """
    kbm = environments(points)
    levels = np.broadcast_to(np.asarray(friction_ns_per_m, np.float64), len(kbm))
    return np.array(
        [np.all(_outside(lifted, *each) >= 0.0) for each in zip(kbm, levels, strict=True)], np.bool_
    )


def shaking_hand(
    model: Model,
    point: npt.ArrayLike,
    damping_ns_per_m: float = 0.0,
    filters: Filters = PAPER_FILTERS,
    friction_ns_per_m: float = 0.0,
) -> tuple[Hand, float] | None:
    """A hand in which (K, B, M) oscillates, and about where [Hz]: where it grows fastest; None if
    no hand can do it.

    Without loss: a mass, or a spring to the wall, that reaches the rim of the circle there, and a
    small tuned mass for each of eight images. Above a quarter of the servo's rate, where more of
    them weigh, it may miss by some percent of damping; above 0.98 of half the rate none is sought.
    """
    lifted = lift(model, damping_ns_per_m, filters)
    kbm = environments(np.atleast_2d(np.asarray(point, np.float64)))[0]
    short = -_outside(lifted, kbm, friction_ns_per_m)
    at = int(np.argmax(short * ANGLES * (ANGLES < _LAST)))
    if short[at] <= 0.0:
        return None
    w = (ANGLES[at] + 2.0 * np.pi * _IMAGES) * model.rate_hz
    p = responses(model, w / (2.0 * np.pi), damping_ns_per_m)
    own = 1.0 / p.velocity[0, 1]
    product = (
        p.velocity[0, 0]
        * held(w / (2.0 * np.pi), model.rate_hz, model.delay_periods)
        * p.encoder[1]
        * own**2
    )
    target = -1.0 / (kbm @ lifted.law[:, at]) - reach(lifted, friction_ns_per_m).centre[at]
    reactance = (
        -(own.real + friction_ns_per_m) * np.tan(0.5 * np.angle(target / product)) - own.imag
    )
    return _tuned(np.abs(w), reactance * np.sign(w)), float(w[0] / (2.0 * np.pi))


def _tuned(w: Floats, reactance: Floats) -> Hand:
    """The hand without loss whose Z_h(jw) is j `reactance` (n,) [N s/m] at `w` (n,) [rad/s]."""
    heavy = reactance[0] > 0.0
    plain = w if heavy else -1.0 / w
    above = reactance > plain * reactance[0] / plain[0]
    for detuned in _DETUNED:
        peak = w * np.where(above, 1.0 + detuned, 1.0 - detuned)
        share = w[:, None] * peak**2 / (peak**2 - w[:, None] ** 2)
        share[:, 0] = plain
        size = np.linalg.solve(share, reactance)
        if size.min() >= 0.0:
            break
    network = Network(float(size[0]) if heavy else 0.0)
    network.join(0, GROUND, 0.0 if heavy else float(size[0]))
    for mass, rate in zip(size[1:], peak[1:], strict=True):
        network.join(0, network.node(float(mass)), float(mass * rate**2))
    return network.hand()


def coupled_radius(
    model: Model,
    points: npt.ArrayLike,
    hands: list[Hand],
    damping_ns_per_m: float = 0.0,
    filters: Filters = PAPER_FILTERS,
) -> Floats:
    """Spectral radius (hands, N) of the sampled loop under `points` (N, 3) in each hand: exact,
    some 40 us for each pair.

    1 within 1e-9 is a mode of the hand without loss, or in which display and hand drift together.
    """
    return np.array(
        [
            spectral_radius(held_by(model, hand), environments(points), damping_ns_per_m, filters)
            for hand in hands
        ]
    )


def _outside(lifted: Lift, point: Floats, friction_ns_per_m: float) -> Floats:
    """How far -1/C is outside the circle, in radii (A,); inf where there is no law. Goes to 0
    with the frequency squared.
    """
    found = reach(lifted, friction_ns_per_m)
    law = point @ lifted.law
    size = found.radius * np.abs(law)
    near = np.abs(1.0 + law * found.centre)
    return np.asarray(np.divide(near, size, out=np.full(size.size, np.inf), where=size > 0.0) - 1.0)
