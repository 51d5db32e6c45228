"""An independent test of stability: one tick of display, hand and law as one matrix, and its
radius.

Written from the physics, without the package's own analysis, so that the guard is judged
independently:

    rotor      m_r v_r' = F_a - b_r v_r - c (v_r - v_s) - k (x_r - x_s) + hand
    slider     m_s v_s' = c (v_r - v_s) + k (x_r - x_s) - b_s v_s        the encoder is here
    smoothing  F_r' = w_r (F_cmd - F_r)
    amplifier  F_a' = w_a (F_r - g e - F_a)            g: level of active damping, gain included
    estimate   e'   = w_e (v_r + rho F_a - e)          rho: resistance that is not compensated
    hand       masses, springs and dampers between nodes; node 0 is the rotor

Parts that a display does not have are omitted: one mass alone has two states. In a tick the command
is the one from `whole` + 1 ticks ago until `part` T, and then the one from `whole` ticks ago (delay
= whole + part). Both intervals are solved exactly, by the matrix exponential of Higham (2005), for
many levels of damping at a time. The law is written as the difference equations of its text, with
histories of positions, filtered velocities and filtered accelerations (direct form I; the package
keeps another state).

Limitations: the law must render the whole force (no limit, and no wall that the handle leaves).
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import matrix_balance

BUTTERWORTH = 0.5**0.5
SETTLED = 1.0 + 1e-8  # rounding of modes that neither grow nor decay
POSITIONS = 4  # past positions that the filter of the second difference uses


class Point(NamedTuple):
    """The rendered environment and the damping, SI."""

    stiffness: float
    damping: float
    mass: float
    level: float = 0.0  # of active damping
    velocity_hz: float = 100.0
    velocity_zeta: float = BUTTERWORTH
    acceleration_hz: float = 72.0
    acceleration_zeta: float = BUTTERWORTH

    def scaled(self, share: float) -> "Point":
        """K, B and M times `share`."""
        return self._replace(
            stiffness=share * self.stiffness, damping=share * self.damping, mass=share * self.mass
        )


class PlainHand(NamedTuple):
    """Masses (n,), dampers (n, n) and springs (n, n) of a hand; node 0 is the rotor."""

    mass_kg: np.ndarray
    damping_ns_per_m: np.ndarray
    stiffness_n_per_m: np.ndarray


def held_mass(mass_kg: float, spring_n_per_m: float = 0.0, damper_ns_per_m: float = 0.0):
    """A mass on the rotor, and a spring and damper from it to the wall."""
    one = np.ones((1, 1))
    return PlainHand(np.array([mass_kg]), damper_ns_per_m * one, spring_n_per_m * one)


def gripping(mass_kg: float, grip_n_per_m: float, grip_ns_per_m: float = 0.0):
    """Return a mass coupled to the rotor by a spring and a damper."""
    across = np.array([[1.0, -1.0], [-1.0, 1.0]])
    return PlainHand(np.array([0.0, mass_kg]), grip_ns_per_m * across, grip_n_per_m * across)


NOBODY = held_mass(0.0)


@dataclass(frozen=True)
class Display:
    """Numbers of a device; 0 or infinite leaves a part out."""

    rotor_kg: float
    rotor_ns_per_m: float
    delay_periods: float
    rate_hz: float = 1000.0
    slider_kg: float = 0.0  # 0: one rigid body
    slider_ns_per_m: float = 0.0
    coupling_n_per_m: float = 0.0
    coupling_ns_per_m: float = 0.0
    smoothing_hz: float = np.inf
    amplifier_hz: float = np.inf
    estimate_hz: float = np.inf
    level_gain: float = 1.0
    residual_m_per_s_n: float = 0.0  # dR / (K_m / r)^2, in the estimate
    mapping: str = "prewarped"


def equations(display: Display, hand, levels: np.ndarray) -> tuple[np.ndarray, np.ndarray, int]:
    """(A (L, n, n), column of the command (n,), place of the encoder's position)."""
    n_hand = len(hand.mass_kg)
    heavy = [i for i in range(1, n_hand) if hand.mass_kg[i] > 0.0]
    names = ["x", "v"]
    names += ["xs", "vs"] if display.slider_kg else []
    names += [f"hx{i}" for i in range(1, n_hand)] + [f"hv{i}" for i in heavy]
    names += ["Fr"] if np.isfinite(display.smoothing_hz) else []
    names += ["Fa"] if np.isfinite(display.amplifier_hz) else []
    names += ["e"] if np.isfinite(display.estimate_hz) else []
    at = {name: place for place, name in enumerate(names)}
    unit = np.eye(len(names))
    rates = np.zeros((len(levels), len(names), len(names)))
    command = np.zeros(len(names))
    gain = display.level_gain * np.asarray(levels)[:, None]

    # force of the motor: rows over the states, and the share of the command itself
    estimate = unit[at["e"]] if "e" in at else unit[at["v"]]
    smoothed = unit[at["Fr"]] if "Fr" in at else np.zeros(len(names))
    direct = 0.0 if "Fr" in at else 1.0
    wanted = smoothed - gain * estimate
    motor = np.broadcast_to(unit[at["Fa"]], wanted.shape) if "Fa" in at else wanted
    if "Fr" in at:
        corner = 2.0 * np.pi * display.smoothing_hz
        rates[:, at["Fr"]] = -corner * unit[at["Fr"]]
        command[at["Fr"]] = corner
    if "Fa" in at:
        corner = 2.0 * np.pi * display.amplifier_hz
        rates[:, at["Fa"]] = corner * (wanted - unit[at["Fa"]])
        command[at["Fa"]] = corner * direct
    if "e" in at:
        corner = 2.0 * np.pi * display.estimate_hz
        seen = unit[at["v"]] + display.residual_m_per_s_n * motor
        rates[:, at["e"]] = corner * (seen - unit[at["e"]])

    # the hand: a node without mass moves to the balance of its dampers
    positions = np.array([unit[at["x"]]] + [unit[at[f"hx{i}"]] for i in range(1, n_hand)])
    velocities = np.zeros((n_hand, len(names)))
    velocities[0] = unit[at["v"]]
    for i in heavy:
        velocities[i] = unit[at[f"hv{i}"]]
    loose = [i for i in range(1, n_hand) if i not in heavy]
    if loose:
        known = hand.damping_ns_per_m @ velocities + hand.stiffness_n_per_m @ positions
        own = hand.damping_ns_per_m[np.ix_(loose, loose)]
        velocities[loose] = np.linalg.solve(own, -known[loose])
    resisting = hand.damping_ns_per_m @ velocities + hand.stiffness_n_per_m @ positions
    for i in range(1, n_hand):
        rates[:, at[f"hx{i}"]] = velocities[i]
    for i in heavy:
        rates[:, at[f"hv{i}"]] = -resisting[i] / hand.mass_kg[i]

    force = motor - display.rotor_ns_per_m * unit[at["v"]] - resisting[0]
    if "xs" in at:
        transmitted = display.coupling_n_per_m * (unit[at["x"]] - unit[at["xs"]])
        transmitted = transmitted + display.coupling_ns_per_m * (unit[at["v"]] - unit[at["vs"]])
        force = force - transmitted
        rates[:, at["xs"]] = unit[at["vs"]]
        braked = transmitted - display.slider_ns_per_m * unit[at["vs"]]
        rates[:, at["vs"]] = braked / display.slider_kg
    moved_kg = display.rotor_kg + hand.mass_kg[0]
    rates[:, at["x"]] = unit[at["v"]]
    rates[:, at["v"]] = force / moved_kg
    if "Fa" not in at:
        command[at["v"]] = direct / moved_kg
    return rates, command, at.get("xs", at["x"])


# of the diagonal Pade approximant of e^x of degree 13, from x^0 on
PADE = (
    64764752532480000.0, 32382376266240000.0, 7771770303897600.0, 1187353796428800.0,
    129060195264000.0, 10559470521600.0, 670442572800.0, 33522128640.0, 1323241920.0,
    40840800.0, 960960.0, 16380.0, 182.0, 1.0,
)  # fmt: skip
PADE_NORM = 5.37  # up to which it is complete


def exponential(matrices: np.ndarray) -> np.ndarray:
    """Return e^A of each of `matrices` (L, n, n) of similar size: Pade and squarings (Higham 2005,
    "The scaling and squaring method for the matrix exponential revisited"). Metres and newtons are
    first scaled to one size.
    """
    _, (scale, _) = matrix_balance(matrices[0], permute=False, separate=True)
    balanced = matrices / scale[:, None] * scale
    norm = float(np.abs(balanced).sum(axis=1).max())
    squarings = max(0, int(np.ceil(np.log2(max(norm, 1e-300) / PADE_NORM))))
    a = balanced / 2.0**squarings
    power = np.broadcast_to(np.eye(a.shape[-1]), a.shape)
    even = np.zeros_like(a)
    odd = np.zeros_like(a)
    for place, share in enumerate(PADE):
        if place % 2:
            odd = odd + share * power
        else:
            even = even + share * power
        power = power @ a
    result = np.linalg.solve(even - odd, even + odd)
    for _ in range(squarings):
        result = result @ result
    return result * scale[:, None] / scale


class Held(NamedTuple):
    """One tick of display and hand: states, command from then, command from now."""

    states: np.ndarray  # (L, n, n)
    earlier: np.ndarray  # (L, n)
    later: np.ndarray  # (L, n)
    whole: int  # ticks of delay
    encoder: int  # place of its position


def held(display: Display, hand, levels: np.ndarray) -> Held:
    """The exact map over a tick at each of `levels` (L,)."""
    rates, command, encoder = equations(display, hand, levels)
    whole = int(np.floor(display.delay_periods + 1e-9))
    part = max(0.0, display.delay_periods - whole)
    period_s = 1.0 / display.rate_hz
    n = len(command)
    driven = np.zeros((len(levels), n + 1, n + 1))
    driven[:, :n, :n] = rates
    driven[:, :n, n] = command
    second = exponential(driven * ((1.0 - part) * period_s))
    first = exponential(driven * (part * period_s))
    rest = second[:, :n, :n]
    return Held(
        rest @ first[:, :n, :n],
        (rest @ first[:, :n, n:])[:, :, 0],
        second[:, :n, n],
        whole,
        encoder,
    )


def low_pass(hz: float, zeta: float, rate_hz: float, mapping: str) -> tuple[float, ...]:
    """(b0, b1, b2, a1, a2) of w^2 / (s^2 + 2 zeta w s + w^2) with s = c (z - 1) / (z + 1)."""
    w = 2.0 * np.pi * hz
    if mapping == "matched":
        poles = np.exp(np.roots([1.0, 2.0 * zeta * w, w * w]) / rate_hz)
        _, a1, a2 = np.poly(poles).real
        return 1.0 + a1 + a2, 0.0, 0.0, a1, a2
    c = 2.0 * rate_hz if mapping == "bilinear" else w / np.tan(0.5 * w / rate_hz)
    a0 = c * c + 2.0 * zeta * w * c + w * w
    a1 = 2.0 * (w * w - c * c)
    a2 = c * c - 2.0 * zeta * w * c + w * w
    return w * w / a0, 2.0 * w * w / a0, w * w / a0, a1 / a0, a2 / a0


NO_FILTER = (1.0, 0.0, 0.0, 0.0, 0.0)


def closed(display: Display, tick: Held, points: list[Point], filtered: bool = True) -> np.ndarray:
    """Return the whole tick under each of `points` (P,) as a matrix (P, N, N); `tick` belongs to
    the points' levels, one each.
    """
    n = tick.states.shape[1]
    x_past = n  # x of 1, 2, 3, 4 ticks ago
    v_past = x_past + POSITIONS  # filtered velocity of 1 and 2 ticks ago
    a_past = v_past + 2
    u_past = a_past + 2  # commands of 1 .. whole + 1 ticks ago
    size = u_past + tick.whole + 1
    unit = np.eye(size)
    count = len(points)
    whole = np.zeros((count, size, size))
    x = np.vstack((unit[tick.encoder], unit[x_past : x_past + POSITIONS]))
    slope = (x[:-1] - x[1:]) * display.rate_hz  # now, 1, 2, 3 ticks ago
    bend = (slope[:-1] - slope[1:]) * display.rate_hz  # now, 1, 2 ticks ago
    velocity = np.empty((count, size))
    acceleration = np.empty((count, size))
    for row, point in enumerate(points):
        pairs = (
            (velocity, slope, v_past, point.velocity_hz, point.velocity_zeta),
            (acceleration, bend, a_past, point.acceleration_hz, point.acceleration_zeta),
        )
        for out, source, past, hz, zeta in pairs:
            b0, b1, b2, a1, a2 = (
                low_pass(hz, zeta, display.rate_hz, display.mapping) if filtered else NO_FILTER
            )
            out[row] = b0 * source[0] + b1 * source[1] + b2 * source[2]
            out[row] -= a1 * unit[past] + a2 * unit[past + 1]
    gains = np.array([point[:3] for point in points])
    command = -(gains[:, :1] * x[0] + gains[:, 1:2] * velocity + gains[:, 2:3] * acceleration)
    history = [command] + [
        np.broadcast_to(unit[u_past + i], command.shape) for i in range(tick.whole + 1)
    ]
    whole[:, :n, :n] = tick.states
    whole[:, :n] += tick.later[:, :, None] * history[tick.whole][:, None, :]
    whole[:, :n] += tick.earlier[:, :, None] * history[tick.whole + 1][:, None, :]
    whole[:, x_past : x_past + POSITIONS] = x[:-1]
    whole[:, v_past] = velocity
    whole[:, v_past + 1] = unit[v_past]
    whole[:, a_past] = acceleration
    whole[:, a_past + 1] = unit[a_past]
    whole[:, u_past] = command
    for i in range(1, tick.whole + 1):
        whole[:, u_past + i] = unit[u_past + i - 1]
    return whole


def eigenvalues(display: Display, points: list[Point], hand=NOBODY, filtered: bool = True):
    """Eigenvalues (P, N) of one tick under each of `points` in `hand`."""
    levels, place = np.unique([point.level for point in points], return_inverse=True)
    tick = held(display, hand, levels)
    each = tick._replace(
        states=tick.states[place], earlier=tick.earlier[place], later=tick.later[place]
    )
    return np.linalg.eigvals(closed(display, each, points, filtered))


def radius(display: Display, points: list[Point], hand=NOBODY, filtered: bool = True) -> np.ndarray:
    """Return the spectral radius (P,) of one tick under each of `points` in `hand`; 1
    for a drift.
    """
    return np.abs(eigenvalues(display, points, hand, filtered)).max(axis=1)


def rings(display: Display, points: list[Point], hand=NOBODY) -> np.ndarray:
    """Whether motion grows (P,)."""
    return radius(display, points, hand) > SETTLED
