"""Stability of an environment in passive hands, and its forecast before a trial.

Hands (`Hand`) are passive one-ports at the probe, networks of masses, dampers and springs:

    M x'' + D x' + K x = f,   node 0 is the probe,
    Z_h = S(s) / s with S the stiffness seen at node 0, the others free

M, D and K have no negative eigenvalue (masses are on the nodes; a damper or spring adds a square of
one difference). This alone makes Re Z_h(s) >= 0 for every s with Re s > 0, so all of them are
positive real: passive by construction (Brune 1931), from a fingertip to a tree of resonators
without loss. A node may be without a mass if a damper holds it, as in a Maxwell arm. `held_by`
attaches the hand to the rotor of a composed device exactly, so that the eigenvalues of its sampled
loop can be computed. `at_port` also records the port between the two. The work of a trial is then
the energy that flows from the hand into the display.

Stability (`coupled_stable`). A hand adds Z_h(jw_k), anything with Re Z_h >= 0, to the device's
1/P_vt at each harmonic w_k = w + 2 pi k / T. The inverse of their sum lies in a circle over the
diameter 0..1/r_k, r_k = Re 1/P_vt. So does, harmonic by harmonic, the loop's pulse transfer. With
the terms of `theorem` that of device and hand together is

    G_h(wT) = e + sum h_k q_k / (1/P_vt + Z_h),    |G_h - g| <= R,
    g = e + sum h q / (2 r),   R = sum |h q| / (2 r)

and the loop closes as 1 + C G_h. A hand can be introduced gradually, s Z_h with s from 0 to 1: all
of these are passive. If -1/C is outside the circle at every wT, no eigenvalue ever meets |z| = 1 on
the way. A loop that is stable alone is then stable in every hand (zero exclusion). If it is inside,
masses and springs that reach the rim exist (`destabilising_hand`): for hands that do not change
with time the condition is necessary as well as sufficient. The theorem has sqrt(sum |h|^2/r sum
|q|^2/r) in place of sum |hq|/r. That is equal for a rigid device and up to 4-15 % more for the
calibrated ones. The reason: the theorem also holds for hands that mix harmonics, such as a grip
that changes. An environment that passes the theorem passes this condition.

Friction, as a damper on the rotor, adds to r alone. It counts only for motions as small as those at
which it was linearised.

Limitations: an environment that is unstable by itself (`loop.spectral_radius`); a hand that
holds the device elsewhere than at the probe, where the impedance differs; a node that only dampers
hold, which stays where it is pushed, an eigenvalue 1 that is not an oscillation.

Forecast (`forecast`). It contains everything known about one environment before a trial:

    radius       of the exact tick without friction: at 1 and above the display moves by itself
    theorem      damping margin at every image, for every input, without friction (`theorem`)
    prediction   minimum Re Z at a given perturbation, Coulomb friction linearised there (`predict`)
    hand         without friction, a passive hand in which the loop grows, checked by its tick

The theorem covers all inputs and large motions; the prediction covers a trial of that amplitude.
They differ where friction stabilises a display, or where noise does not show images.

Limitations: K < 0. It is active below every judged band, so Re Z >= 0 proves nothing. The loop may
be unstable with Re Z > 0 over the whole band. It is refused whatever the numbers.
"""

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from hapticd.core.arrays import Complexes, Flags, Floats
from hapticd.core.errors import AnalysisError
from hapticd.model.angles import least_between
from hapticd.model.blueprint import StateVariable
from hapticd.model.linearise import Perturbation
from hapticd.model.loop import PAPER_FILTERS, Filters, held_force_model, responses, spectral_radius
from hapticd.model.model import Model, Output, Outputs
from hapticd.model.predict import Prediction, environments, predict
from hapticd.model.rational import positive_everywhere, rational
from hapticd.model.theorem import LiftedSystem, lifted_margin, lifted_system

__all__ = ["Forecast", "Hand", "at_port", "forecast", "shaking_hand"]

# --- hands ----------------------------------------------------------------------------------------

GROWS = 1.0 + 1e-9  # radius in a hand; 1 within rounding is a mode of the hand without loss
_ROUNDING = 1e-9  # of the largest entry: an eigenvalue less negative than that is 0
_IMAGES = np.array([0.0, -1.0, 1.0, -2.0, 2.0, -3.0, 3.0, -4.0, 4.0])  # for which a hand is tuned
_DETUNED = (1e-3, 1e-4, 1e-5)  # offsets of the resonances from their frequencies
_ENDLESS = 1e100  # times 0 is 0
_LAST = 0.98 * np.pi  # closer to half the servo's rate a frequency and its image coincide


@dataclass(frozen=True, eq=False)
class Hand:
    """A passive hand: masses, dampers and springs between nodes; node 0 is the probe.

    AnalysisError unless the matrices are symmetric without a negative eigenvalue, and every node
    but the probe has a mass or a damper.
    """

    mass_kg: Floats  # (n,) of each node
    damping_ns_per_m: Floats  # (n, n)
    stiffness_n_per_m: Floats  # (n, n)

    def __post_init__(self) -> None:
        """Refuse matrices that are not passive."""
        for name, matrix in (
            ("mass", np.diag(self.mass_kg)),
            ("damping", self.damping_ns_per_m),
            ("stiffness", self.stiffness_n_per_m),
        ):
            least = float(np.linalg.eigvalsh(matrix)[0])
            size = float(np.abs(matrix).max())
            if not np.allclose(matrix, matrix.T) or least < -_ROUNDING * size:
                raise AnalysisError(
                    f"a hand whose {name} matrix has the eigenvalue {least:.3g} is not passive; it"
                    " takes symmetric, >= 0"
                )
        if np.any(self.loose & (np.diag(self.damping_ns_per_m) <= 0.0)):
            raise AnalysisError(
                "a node of a hand without mass and without damper; give it one of them, or leave"
                " it out"
            )

    @property
    def loose(self) -> Flags:
        """Nodes (n,) without a mass, other than the probe."""
        return np.asarray((self.mass_kg == 0.0) & (np.arange(self.mass_kg.size) > 0))

    def impedance(self, s: Complexes) -> Complexes:
        """Return the impedance Z_h(s) (F,) [N s/m] at complex frequencies s (F,) [rad/s] other than
        its poles.
        """
        x = s[:, None, None]
        all_nodes = (
            x * x * np.diag(self.mass_kg) + x * self.damping_ns_per_m + self.stiffness_n_per_m
        )
        inner = np.linalg.solve(all_nodes[:, 1:, 1:], all_nodes[:, 1:, :1])
        return np.asarray((all_nodes[:, 0, 0] - (all_nodes[:, :1, 1:] @ inner)[:, 0, 0]) / s)


def held_by(model: Model, hand: Hand) -> Model:
    """Return `model` with `hand` on its rotor, where the probe is. The temperature of its winding
    is fixed.
    """
    rotor = int(np.argmax(model.outputs.velocity.c0))
    place = int(np.argmax(model.outputs.position.c0))
    n = len(model.states)
    inner = np.arange(1, hand.mass_kg.size)
    heavy = np.flatnonzero(hand.mass_kg[1:]) + 1
    size = n + inner.size + heavy.size
    unit = np.eye(size)
    position = np.vstack((unit[place], unit[n : n + inner.size]))
    velocity = np.zeros((hand.mass_kg.size, size))
    velocity[0] = unit[rotor]
    velocity[heavy] = unit[n + inner.size :]
    loose = hand.loose
    push = hand.damping_ns_per_m @ velocity + hand.stiffness_n_per_m @ position
    # a node without a mass has no velocity of its own: forces on it balance
    velocity[loose] = -np.linalg.solve(hand.damping_ns_per_m[np.ix_(loose, loose)], push[loose])
    force = hand.damping_ns_per_m @ velocity + hand.stiffness_n_per_m @ position
    ease = float(model.b0[rotor, model.inputs.torque])  # 1/kg
    # the hand's mass on the probe adds to that of the rotor
    share = 1.0 / (1.0 + ease * hand.mass_kg[0])
    a0 = _wider(model.a0, size, size, rotor, share)
    a0[rotor] -= share * ease * force[0]
    a0[n:] = np.vstack((velocity[1:], -force[heavy] / hand.mass_kg[heavy, None]))
    width = model.inputs.width
    return replace(
        model,
        states=(
            *model.states,
            *(StateVariable(f"hand_{node}_position", "m", "hand") for node in inner),
            *(StateVariable(f"hand_{node}_velocity", "m/s", "hand") for node in heavy),
        ),
        a0=a0,
        a1=_wider(model.a1, size, size, rotor, share),
        b0=_wider(model.b0, size, width, rotor, share),
        b1=_wider(model.b1, size, width, rotor, share),
        outputs=_seen(model.outputs, size),
        winding=None,
    )


def at_port(model: Model, hand: Hand) -> Model:
    """`held_by`, with a record of the port: the true velocity of the probe, and all force on the
    display, that of the hand and what pushes hand and display there.

    The hand's force is what its momentum does not gain and the ground does not take: the record
    holds its integral, - sum (m v + d x + k (integral of x)), with d and k what holds each node to
    the ground. The integral of the springs to the ground is a state of its own.
    """
    held = held_by(model, hand)
    size = len(held.states)
    nodes = hand.mass_kg.size
    heavy = np.flatnonzero(hand.mass_kg[1:]) + 1
    first = len(model.states)
    positions = [int(np.argmax(held.outputs.position.c0)), *range(first, first + nodes - 1)]
    velocities = [int(np.argmax(held.outputs.velocity.c0)), *range(first + nodes - 1, size)]
    a0 = np.pad(held.a0, (0, 1))
    a0[size, positions] = hand.stiffness_n_per_m.sum(axis=0)
    impulse = np.zeros(size + 1)
    impulse[size] = -1.0
    impulse[positions] -= hand.damping_ns_per_m.sum(axis=0)
    impulse[velocities] -= hand.mass_kg[[0, *heavy]]
    outputs = _seen(held.outputs, size + 1)
    none = np.zeros(held.inputs.width)
    return replace(
        held,
        states=(*held.states, StateVariable("hand_ground_impulse", "N s", "hand")),
        a0=a0,
        a1=np.pad(held.a1, (0, 1)),
        b0=np.pad(held.b0, ((0, 1), (0, 0))),
        b1=np.pad(held.b1, ((0, 1), (0, 0))),
        outputs=replace(
            outputs,
            recorded_travel=outputs.position,
            recorded_velocity=outputs.velocity,
            recorded_impulse=Output(impulse, np.zeros(size + 1), none, none),
        ),
    )


def _wider(matrix: Floats, rows: int, columns: int, rotor: int, share: float) -> Floats:
    """Return `matrix` of the device padded with zeros for the hand, its rotor heavier."""
    found = np.zeros((rows, columns))
    found[: len(matrix), : matrix.shape[1]] = matrix
    found[rotor] *= share
    return found


def _seen(outputs: Outputs, size: int) -> Outputs:
    def wider(one: Output | None) -> Output | None:
        return one and replace(
            one,
            c0=np.pad(one.c0, (0, size - one.c0.size)),
            c1=np.pad(one.c1, (0, size - one.c1.size)),
        )

    changed: dict[str, Any] = {
        part.name: wider(getattr(outputs, part.name)) for part in fields(outputs)
    }
    return replace(outputs, **changed)


# --- stability ------------------------------------------------------------------------------------


def reach(lifted: LiftedSystem, friction_ns_per_m: float = 0.0) -> tuple[Complexes, Floats]:
    """Return the circle that contains the pulse transfer of a device, with that damper on its
    rotor, in every passive hand: centre and radius (A,) [m/N] at the angles of its lift. Without
    damping of its own the circle is unbounded.
    """
    resistance = lifted.resistance + friction_ns_per_m
    if resistance.min() <= 0.0:
        return lifted.inner, np.full(lifted.inner.size, _ENDLESS)
    centre = lifted.inner + 0.5 * (lifted.both / resistance).sum(axis=1)
    return centre, 0.5 * (np.sqrt(lifted.out * lifted.back) / resistance).sum(axis=1)


def coupled_stable(
    lifted: LiftedSystem, points: npt.ArrayLike, friction_ns_per_m: npt.ArrayLike = 0.0
) -> Flags:
    """Return whether no passive hand makes environments (N, 3) oscillate that are stable without a
    hand: (N,).

    `friction_ns_per_m`: linearised friction of the rotor, (N,) or one value for all.
    """
    kbm = environments(points)
    levels = np.broadcast_to(np.asarray(friction_ns_per_m, np.float64), len(kbm))
    values = np.zeros((len(kbm), lifted.angles.size))
    for row, level in enumerate(levels.tolist()):
        centre, radius = reach(lifted, level)
        law = kbm[row] @ lifted.law
        values[row] = np.abs(1.0 + law * centre) ** 2 - np.abs(law * radius) ** 2
    return np.asarray(least_between(lifted.angles, values) >= 0.0)


def destabilising_hand(
    model: Model,
    point: npt.ArrayLike,
    active_damping_ns_per_m: float = 0.0,
    filters: Filters = PAPER_FILTERS,
    friction_ns_per_m: float = 0.0,
    at_hz: float | None = None,
) -> tuple[Hand, float] | None:
    """Return a hand in which (K, B, M) oscillates, and the approximate frequency [Hz]: near
    `at_hz`, or where the lack of damping should let the motion grow fastest; None if no hand is
    possible there.

    The hand has no loss: a mass, or a spring to the wall, that reaches the rim of the circle there,
    and a small tuned mass for each of eight images. Above a quarter of the servo's rate, where more
    images count, it may miss by a few percent of damping. Above 0.98 of half the rate there is no
    search.
    """
    lifted = lifted_system(model, active_damping_ns_per_m, filters)
    kbm = environments(np.atleast_2d(np.asarray(point, np.float64)))[0]
    angles = lifted.angles
    short = -_outside(lifted, kbm, friction_ns_per_m)
    # for a given margin in radii the motion grows faster at higher frequency
    wanted = short * angles
    if at_hz is not None:
        wanted = -np.abs(angles - 2.0 * np.pi * at_hz / model.rate_hz)
    at = int(np.argmax(np.where(angles < _LAST, wanted, -np.inf)))
    if short[at] <= 0.0:
        return None
    w = (angles[at] + 2.0 * np.pi * _IMAGES) * model.rate_hz
    p = responses(model, w / (2.0 * np.pi), active_damping_ns_per_m)
    own = 1.0 / p.velocity[0, 1]
    product = (
        p.velocity[0, 0]
        * held_force_model(w / (2.0 * np.pi), model.rate_hz, model.delay_periods)
        * p.encoder[1]
        * own**2
    )
    # on the rim each image's term lies on its own circle, at the angle of the target on the whole
    centre, _ = reach(lifted, friction_ns_per_m)
    target = -1.0 / (kbm @ lifted.law[:, at]) - centre[at]
    reactance = (
        -(own.real + friction_ns_per_m) * np.tan(0.5 * np.angle(target / product)) - own.imag
    )
    return _tuned(np.abs(w), reactance * np.sign(w)), float(w[0] / (2.0 * np.pi))


def _tuned(w: Floats, reactance: Floats) -> Hand:
    """Return the lossless hand whose Z_h(jw) is j `reactance` (n,) [N s/m] at `w` (n,) [rad/s]."""
    heavy = reactance[0] > 0.0  # a mass on the probe, otherwise a spring to the wall
    plain = w if heavy else -1.0 / w
    above = reactance > plain * reactance[0] / plain[0]
    # closer resonances need smaller tuned masses; take the first set without a negative one
    for detuned in _DETUNED:
        peak = w * np.where(above, 1.0 + detuned, 1.0 - detuned)
        share = w[:, None] * peak**2 / (peak**2 - w[:, None] ** 2)
        share[:, 0] = plain
        size = np.linalg.solve(share, reactance)
        if size.min() >= 0.0:
            break
    springs = [float(mass * rate**2) for mass, rate in zip(size[1:], peak[1:], strict=True)]
    to_the_wall = 0.0 if heavy else float(size[0])
    stiffness = np.diag([sum(springs, to_the_wall), *springs])
    stiffness[0, 1:] = stiffness[1:, 0] = -np.array(springs)
    masses = np.array([size[0] if heavy else 0.0, *size[1:]])
    return Hand(masses, np.zeros_like(stiffness), stiffness)


def coupled_radius(
    model: Model,
    points: npt.ArrayLike,
    hands: list[Hand],
    active_damping_ns_per_m: float = 0.0,
    filters: Filters = PAPER_FILTERS,
) -> Floats:
    """Return the spectral radius (hands, N) of the sampled loop under `points` (N, 3) in each hand;
    exact, about 40 us per pair.

    A radius of 1 within 1e-9 is a mode of a lossless hand, or a common drift of display and hand.
    """
    return np.array(
        [
            spectral_radius(
                held_by(model, hand), environments(points), active_damping_ns_per_m, filters
            )
            for hand in hands
        ]
    )


@dataclass(frozen=True, eq=False)
class DestabilisingHand:
    """A passive hand in which the display oscillates."""

    hand: Hand
    hz: float  # approximate frequency
    radius: float  # spectral radius of a tick with the hand


def shaking_hand(
    model: Model,
    point: Floats,
    active_damping_ns_per_m: float,
    filters: Filters,
    at_hz: float | None = None,
) -> DestabilisingHand | None:
    """Return the hand of `destabilising_hand` if the motion grows in it, by its exact tick;
    otherwise None.
    """
    found = destabilising_hand(model, point, active_damping_ns_per_m, filters, at_hz=at_hz)
    if found is None:
        return None
    hand, hz = found
    radii = coupled_radius(model, point[None], [hand], active_damping_ns_per_m, filters)
    radius = float(radii[0, 0])
    return DestabilisingHand(hand, hz, radius) if radius > GROWS else None


def _outside(lifted: LiftedSystem, point: Floats, friction_ns_per_m: float) -> Floats:
    """Return the distance of -1/C outside the circle, in radii (A,); inf where there is no law. It
    falls to 0 with the square of the frequency.
    """
    centre, radius = reach(lifted, friction_ns_per_m)
    law = point @ lifted.law
    size = radius * np.abs(law)
    near = np.abs(1.0 + law * centre)
    return np.asarray(np.divide(near, size, out=np.full(size.size, np.inf), where=size > 0.0) - 1.0)


# --- forecast -------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Forecast:
    """Everything known about one environment before a trial."""

    period_s: float  # of a tick
    radius: float  # spectral radius of a tick without friction
    theorem_margin: float  # damping margin, N s/m
    theorem_passive: bool  # includes stability, which the theorem assumes
    withstands: bool  # whether no passive hand makes it oscillate
    # None if it withstands, is unstable by itself, or no hand was found
    shaker: DestabilisingHand | None
    true: Prediction  # of Z itself, K < 0 allowed
    recorded: Prediction  # of Z as the probe's channels record it, K < 0 allowed

    @property
    def stable(self) -> bool:
        """Whether the sampled loop is stable without friction and hand."""
        return self.radius < 1.0

    @property
    def refused(self) -> bool:
        """Whether it is refused whatever the numbers: K < 0."""
        return bool(self.true.points[0, 0] < 0.0)

    @property
    def passive(self) -> bool:
        """Whether it is predicted passive at the given perturbation."""
        return bool(self.true.passive[0]) and not self.refused


def forecast(
    model: Model,
    point: npt.ArrayLike,
    active_damping_ns_per_m: float,
    filters: Filters,
    perturbation: Perturbation,
    band_hz: tuple[float, float],
) -> Forecast:
    """Judge `point` (K [N/m], B [N s/m], M [kg]) on `model` before any trial. AnalysisError unless
    these are finite.
    """
    kbm = environments(np.atleast_2d(np.asarray(point, np.float64)))
    lifted = lifted_system(model, active_damping_ns_per_m, filters)
    radius = float(spectral_radius(model, kbm, active_damping_ns_per_m, filters)[0])
    safe = radius < 1.0 and bool(kbm[0, 0] >= 0.0 and coupled_stable(lifted, kbm)[0])
    sought = radius < 1.0 and not safe and kbm[0, 0] >= 0.0
    proven = positive_everywhere(rational(model, active_damping_ns_per_m, filters, 0.0), kbm)
    true, recorded = (
        predict(model, kbm, active_damping_ns_per_m, filters, perturbation, band_hz, True, seen)
        for seen in (False, True)
    )  # fmt: skip
    return Forecast(
        period_s=1.0 / model.rate_hz,
        radius=radius,
        theorem_margin=float(lifted_margin(lifted, kbm)[0]),
        theorem_passive=radius < 1.0 and bool(kbm[0, 0] >= 0.0 and proven[0]),
        withstands=safe,
        shaker=shaking_hand(model, kbm[0], active_damping_ns_per_m, filters) if sought else None,
        true=true,
        recorded=recorded,
    )
