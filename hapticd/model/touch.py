"""Contacts of the moving part of a simulated device: compliant stops, a bearing with stiction, a
hand that holds, pushes or strikes. Standard library alone.

All of them form one force f on the rotor, held over a sub-step h like the motor's and chosen such
that the laws of the contacts hold at the END of the sub-step:

    x' = x_free + Wx f,   v' = v_free + Wv f          the device, exact for a held f
    f  = p - k x' - b v' + r                          springs, dampers and pushes, all linear
    r in [-F, F] so that v' = 0, else r = -F sgn(v')  friction, set-valued (see `friction`)

Two linear equations and a clamp are solved directly, without iteration and for any stiffness. For a
bare mass with u = k h^2 / m the map over a sub-step has determinant 1 / (1 + u/2) < 1 and trace (2
- u/2) / (1 + u/2), so both eigenvalues lie inside the unit circle for every k. An explicit spring
of 2e6 N/m on 5 g (u = 1.6) would gain energy; this one only loses some. A stop is a spring and a
damper that push and never pull: the step is first computed without it, and again with it if the
position would end beyond it and its force pushes back. A mass at rest is held up to the static
level, a moving one is braked by the Coulomb level, so a slow push moves it in jerks.

    hold      a spring to the handle's position at the grasp, which wanders by `tremor_m` rms (first
              order, 10 Hz; seeded) if requested, and a damper to ground
    push      a constant force
    strike    half a sine of force with peak `force_n`

Time is counted in sub-steps since the device was made, so a hand is independent of restarts of the
board. While only friction acts and the motion keeps its direction, a whole piece is one step.
Friction that the device itself has at the rotor moves to this contact (by `step.make_plant`),
because two set-valued forces on one body are one.

The response (Wx, Wv) must be of the step's level of damping. Limitations: a device whose rotor
reverses within a piece and moves the same way at both its ends.
"""

from collections.abc import Callable
from functools import lru_cache
from math import exp, isfinite, pi, sin, tau
from random import Random
from typing import NamedTuple

from hapticd.core.errors import ConfigError
from hapticd.model.composed import POSITION, VELOCITY, Response, State, Step
from hapticd.model.params import HandParams, TouchParams

TREMOR_HZ = 10.0  # physiological tremor of a hand: 8 to 12 Hz
HAND_KINDS = ("hold", "push", "strike")


class Linear(NamedTuple):
    """The force p - k x - b v."""

    push_n: float = 0.0
    stiffness_n_per_m: float = 0.0
    damping_ns_per_m: float = 0.0


class Solved(NamedTuple):
    """The force of all contacts, and whether friction holds the rotor still."""

    force_n: float
    sticks: bool


def solve(x_free: float, v_free: float, w: Response, linear: Linear, friction_n: float) -> Solved:
    """Return the force for which the laws hold at the end of the sub-step. `x_free` [m] and
    `v_free` [m/s] are reached without it.
    """
    wx, wv = w
    push, stiffness, damping = linear
    yielding = 1.0 + stiffness * wx + damping * wv
    pull = push - stiffness * x_free - damping * v_free
    holding = -(v_free * yielding / wv + pull)
    if -friction_n <= holding <= friction_n:
        return Solved((pull + holding) / yielding, friction_n > 0.0)
    friction = friction_n if holding > 0.0 else -friction_n
    return Solved((pull + friction) / yielding, False)


class Hand:
    """One hand while it acts. `linear` advances it by one sub-step."""

    __slots__ = ("_gauss", "_keep", "_params", "_point_m", "_step_s", "_wander_m")

    def __init__(self, params: HandParams, step_s: float, random: Random) -> None:
        self._params = params
        self._step_s = step_s
        self._gauss = random.gauss
        self._keep = exp(-tau * TREMOR_HZ * step_s)
        self._wander_m = 0.0
        self._point_m: float | None = None  # where it grasped

    def acts(self, now_s: float) -> bool:
        """Whether it touches the handle at `now_s`."""
        params = self._params
        return params.start_s <= now_s < params.start_s + params.duration_s

    def linear(self, now_s: float, position_m: float) -> Linear:
        """Return its force over the sub-step that begins at `now_s`."""
        params = self._params
        if params.kind == "push":
            return Linear(params.force_n)
        if params.kind == "strike":
            part = (now_s + 0.5 * self._step_s - params.start_s) / params.duration_s
            return Linear(params.force_n * sin(pi * part))
        return self._hold(position_m)

    def _hold(self, position_m: float) -> Linear:
        params = self._params
        if self._point_m is None:
            self._point_m = position_m
        if params.tremor_m:
            fresh = params.tremor_m * (1.0 - self._keep * self._keep) ** 0.5
            self._wander_m = self._keep * self._wander_m + fresh * self._gauss(0.0, 1.0)
        point = self._point_m + self._wander_m
        return Linear(
            params.stiffness_n_per_m * point, params.stiffness_n_per_m, params.damping_ns_per_m
        )


def touched_step(
    step: Step,
    response: Callable[[float], Response],
    params: TouchParams,
    stops_m: tuple[float, float],
    substep_s: float,
    seed: int,
) -> Step:
    """Return `step` of a device without stops and friction at its rotor, with the contacts of
    `params`.

    `response(active_damping_ns_per_m)` is that of one sub-step; `stops_m` is where stops begin to
    yield, infinite without stops. ConfigError if the numbers do not describe a contact.
    """
    _check(params)
    lower, upper = stops_m
    stiffness = params.stop_stiffness_n_per_m
    damping = params.stop_damping_ns_per_m
    coulomb = params.coulomb_n
    static = params.static_n
    random = Random(f"touch {seed}")
    hands = [Hand(one, substep_s, random) for one in params.hands]
    responds = lru_cache(maxsize=1)(response)  # of the present level
    count = 0  # sub-steps since the device was made

    def all_hands(now_s: float, position_m: float) -> Linear:
        acting = [hand.linear(now_s, position_m) for hand in hands if hand.acts(now_s)]
        return Linear(*map(sum, zip(*acting, strict=True))) if acting else Linear()

    def contact(x_free: float, v_free: float, w: Response, linear: Linear, grip: float) -> Solved:
        found = solve(x_free, v_free, w, linear, grip)
        end = x_free + w.position_m_per_n * found.force_n
        if lower <= end <= upper:
            return found
        edge = lower if end < lower else upper
        stopped = Linear(
            linear.push_n + stiffness * edge,
            linear.stiffness_n_per_m + stiffness,
            linear.damping_ns_per_m + damping,
        )
        tried = solve(x_free, v_free, w, stopped, grip)
        beyond = x_free + w.position_m_per_n * tried.force_n - edge
        speed = v_free + w.velocity_m_per_s_per_n * tried.force_n
        outwards = -stiffness * beyond - damping * speed
        return tried if (outwards > 0.0) == (edge == lower) else found

    def substep(state: State, force_n: float, torque_n: float, level: float) -> State:
        x = state[POSITION]
        v = state[VELOCITY]
        free = step(state, force_n, torque_n, level, 1)
        contact_n, sticks = contact(
            free[POSITION],
            free[VELOCITY],
            responds(level),
            all_hands(count * substep_s, x),
            coulomb if v else static,
        )
        after = step(state, force_n, torque_n + contact_n, level, 1)
        if not sticks:
            return after
        # remove rounding errors from a zero velocity and displacement
        return (after[POSITION] if v else x, 0.0, *after[VELOCITY + 1 :])

    def slid(state: State, force_n: float, torque_n: float, level: float, n: int) -> State | None:
        """A whole piece under sliding friction alone; None if more has to be decided."""
        v = state[VELOCITY]
        if not v or any(
            hand.acts(count * substep_s) or hand.acts((count + n - 1) * substep_s) for hand in hands
        ):
            return None
        drag = -coulomb if v > 0.0 else coulomb
        after = step(state, force_n, torque_n + drag, level, n)
        on = after[VELOCITY] * v > 0.0
        inside = lower <= state[POSITION] <= upper and lower <= after[POSITION] <= upper
        return after if on and inside else None

    def touched(
        state: State,
        force_n: float,
        torque_n: float,
        active_damping_ns_per_m: float,
        n_substeps: int,
    ) -> State:
        nonlocal count
        after = slid(state, force_n, torque_n, active_damping_ns_per_m, n_substeps)
        if after is not None:
            count += n_substeps
            return after
        for _ in range(n_substeps):
            state = substep(state, force_n, torque_n, active_damping_ns_per_m)
            count += 1
        return state

    return touched


def _check(params: TouchParams) -> None:
    if not 0.0 <= params.coulomb_n <= params.static_n < float("inf"):
        raise ConfigError(
            f"touch: static_n {params.static_n} N must be at least coulomb_n"
            f" {params.coulomb_n} N, and both 0 or more"
        )
    for name, unit in (("stop_stiffness_n_per_m", "N/m"), ("stop_damping_ns_per_m", "N s/m")):
        value = getattr(params, name)
        if not (isfinite(value) and value >= 0.0):
            raise ConfigError(f"touch: {name} {value} {unit} must be 0 {unit} or more, and finite")
    for hand in params.hands:
        _check_hand(hand)


def _check_hand(hand: HandParams) -> None:
    if hand.kind not in HAND_KINDS:
        raise ConfigError(f"touch: a hand does not {hand.kind!r}; use {', '.join(HAND_KINDS)}")
    numbers = (hand.start_s, hand.force_n, hand.stiffness_n_per_m, hand.damping_ns_per_m)
    if not all(isfinite(one) for one in numbers) or not hand.duration_s > 0.0:
        raise ConfigError(
            f"touch: the hand at {hand.start_s} s needs finite numbers, and more than 0 s"
        )
    if min(hand.stiffness_n_per_m, hand.damping_ns_per_m, hand.tremor_m) < 0.0:
        raise ConfigError(f"touch: the hand at {hand.start_s} s must be passive: no number below 0")
