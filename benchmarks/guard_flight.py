"""Guarded displays in motion: a lossless hand, a person who moves, and the energy at the motor.

A flight is the servo and the simulated board in lock-step. The hand is part of the composed plant
(an effect, passive by its numbers). The person is a force on the rotor, so that the input work is
known: strikes, pushes, a grip whose place wanders. All is judged where the plant is played, in
pieces of at most T / 4, not from the servo's own ledger:

    W + dE <= integral c v^2 dt + 5 mJ + booked        W work of the virtual force on the device,
                                                       E = K x^2 / 2 + M v^2 / 2 of the display
    (m + M) v^2 / 2 + (K + arm) x^2 / 2                bound of the motion with a passive display,
        <= person + 5 mJ + booked                      and so of |v| and |x|; M where it is < 0

m includes the mass that the hand adds to the rotor, arm is its spring to the wall; c is the
physical damping plus the level in effect. `booked` is the energy of rising K and M: dK x^2 / 2 and
dM v^2 / 2 of every upward step.

Limitations: a force stored by the display outside E (no wall is flown), or a piece so long that the
trapezoid of v^2 is no longer the integral.
"""

from collections.abc import Callable
from dataclasses import replace
from math import pi, sin, tau
from random import Random
from typing import Any, NamedTuple

import numpy as np

from benchmarks.stand import settings
from hapticd.core.params import ServoParams
from hapticd.mailbox import layout
from hapticd.model.compose import board_fields, compose_device
from hapticd.model.effects import Delay, Effect, Load, Masses, Motor, PassiveHand, Viscous
from hapticd.model.params import BoardParams
from hapticd.run.lockstep import LockStep
from hapticd.servo.plan import SETTLED
from hapticd.settings.build import board_params, servo_params

DTYPE = np.dtype([tuple(field) for field in layout.TELEMETRY])
SLACK_J = 0.005  # 5 mJ, exchanged within a swing
HIGHEST_NS_PER_M = 10.0
# makes K = 500 N/m, B = 2 N s/m unstable below 0.957 N s/m of active damping; 4.7 % a tick without
# any
GRIPPING = PassiveHand(
    mass_kg=0.3,
    damping_ns_per_m=2.0,
    stiffness_n_per_m=60.0,
    grip_stiffness_n_per_m=3200.0,
    grip_damping_ns_per_m=0.0,
)


def rigid_board(hand: Effect | None, **changes: Any) -> BoardParams:
    """Return the shipped simulated board, its rotor in `hand`."""
    shipped = board_params(settings())
    assert shipped is not None
    effects: list[Effect] = [
        Masses(rotor_kg=shipped.mass_kg),
        Motor(torque_constant_nm_per_a=0.0165, lever_m=0.01, resistance_ohm=1.6),
        Viscous(rotor_ns_per_m=shipped.viscous_ns_per_m),
        Delay(periods=1.0 - shipped.sample_phase),
    ]
    model = compose_device("held", [*effects, hand] if hand else effects, shipped.rate_hz)
    levels = tuple(np.linspace(0.25, HIGHEST_NS_PER_M, 40))
    return replace(shipped, **board_fields(model, levels, HIGHEST_NS_PER_M), **changes)


def heavy(mass_kg: float, arm_n_per_m: float = 0.0) -> Effect:
    """Return a hand that is a mass on the rotor, or a spring to the wall, or both."""
    return Load(mass_kg=mass_kg, stiffness_n_per_m=arm_n_per_m)


def plain_servo(enable_ramp_s: float = 0.1) -> ServoParams:
    """Return the shipped servo with an empty environment at the start."""
    params = servo_params(settings(), "guard")
    start = type(params.environment)(workspace=params.environment.workspace)
    safety = replace(params.safety, enable_ramp_s=enable_ramp_s)
    return replace(params, environment=start, safety=safety)


class Person(NamedTuple):
    """Force [N] of a person on the rotor at (time, position, velocity)."""

    force: Callable[[float, float, float], float]


def striking(times_s: tuple[float, ...], force_n: float = 2.0, length_s: float = 0.005) -> Person:
    """Return half sines of force from either side in turn."""

    def force(now_s: float, position_m: float, velocity_m_per_s: float) -> float:
        for place, start_s in enumerate(times_s):
            if start_s <= now_s < start_s + length_s:
                return (-1.0) ** place * force_n * sin(pi * (now_s - start_s) / length_s)
        return 0.0

    return Person(force)


def moving(seed: int, until_s: float) -> Person:
    """Return pushes back and forth, strikes, and a soft grip with tremor; it lets go at
    `until_s`.
    """
    random = Random(f"person {seed}")
    strikes = sorted(random.uniform(0.1, until_s) for _ in range(8))
    hits = striking(tuple(strikes), random.uniform(0.5, 4.0))
    swing_n = random.uniform(0.0, 1.0)
    swing_hz = random.uniform(0.3, 4.0)
    grip_n_per_m = random.uniform(50.0, 400.0)
    tremor_m = random.uniform(0.0, 1e-3)
    beats = [(random.uniform(6.0, 14.0), random.uniform(0.0, tau)) for _ in range(3)]

    def force(now_s: float, position_m: float, velocity_m_per_s: float) -> float:
        if now_s >= until_s:
            return 0.0
        place_m = tremor_m * sum(sin(tau * hz * now_s + at) for hz, at in beats)
        held = grip_n_per_m * (place_m - position_m) - 0.5 * velocity_m_per_s
        pushed = swing_n * sin(tau * swing_hz * now_s)
        return held + pushed + hits.force(now_s, position_m, velocity_m_per_s)

    return Person(force)


class Balance:
    """Energies at the simulated motor of a stack, from now on."""

    def __init__(self, stack: LockStep, person: Person, arm_n_per_m: float = 0.0) -> None:
        axis: Any = stack.backend._port._axis  # type: ignore[attr-defined]
        board = axis._params
        self._stack = stack
        self._step = axis.plant.step
        self._person = person.force
        self._mass_kg = board.mass_kg
        self._arm_n_per_m = arm_n_per_m
        self._physical = board.viscous_ns_per_m
        self._substep_s = 1.0 / (16 * board.rate_hz)
        self._substeps = 0
        self._before = (0.0, 0.0)  # K and M
        self.work_j = 0.0
        self.taken_j = 0.0
        self.booked_j = 0.0
        self.person_j = 0.0
        self.most_person_j = 0.0
        self.furthest_m = 0.0
        self.fastest_m_per_s = 0.0
        self.worst_j = -np.inf  # of W + dE - taken - booked
        self.worst_motion_j = -np.inf  # of motion and springs - person - booked
        axis.plant = axis.plant._replace(step=self._watched)

    def _watched(self, state: Any, force_n: float, torque_n: float, level: float, n: int) -> Any:
        while n:
            piece = min(n, 4)
            n -= piece
            state = self._piece(state, force_n, torque_n, level, piece)
        return state

    def _piece(self, state: Any, force_n: float, torque_n: float, level: float, n: int) -> Any:
        length_s = n * self._substep_s
        now_s = (self._substeps + 0.5 * n) * self._substep_s
        pushed_n = self._person(now_s, state[0], state[1])
        after = self._step(state, force_n, torque_n + pushed_n, level, n)
        moved_m = after[0] - state[0]
        self._substeps += n
        self.work_j += force_n * moved_m
        self.person_j += pushed_n * moved_m
        square = (state[1] ** 2 + state[1] * after[1] + after[1] ** 2) / 3.0
        self.taken_j += (self._physical + level) * square * length_s
        self._judge(after[0], after[1])
        return after

    def _judge(self, x: float, v: float) -> None:
        settled = self._stack.loop.state[SETTLED]
        stiffness, _, mass, *_ = settled.environment
        k_before, m_before = self._before
        self._before = (stiffness, mass)
        self.booked_j += 0.5 * max(0.0, stiffness - k_before) * x * x
        self.booked_j += 0.5 * max(0.0, mass - m_before) * v * v
        stored_j = 0.5 * stiffness * x * x + 0.5 * mass * v * v
        lost_j = self.work_j + stored_j - self.taken_j - self.booked_j
        springs = stiffness + self._arm_n_per_m
        moving_j = 0.5 * (self._mass_kg + min(0.0, mass)) * v * v + 0.5 * springs * x * x
        self.worst_j = max(self.worst_j, lost_j)
        self.worst_motion_j = max(self.worst_motion_j, moving_j - self.person_j - self.booked_j)
        self.most_person_j = max(self.most_person_j, self.person_j)
        self.furthest_m = max(self.furthest_m, abs(x))
        self.fastest_m_per_s = max(self.fastest_m_per_s, abs(v))


def records(stack: LockStep) -> np.ndarray:
    """Return all records of `stack`."""
    return np.frombuffer(b"".join(stack.blocks), DTYPE)
