"""A motor, a handle and a hand, integrated exactly, with the balance of energies at the motor, for
tests of leaking energy.

One rigid body of `mass_kg` with the device's damping, the active damping in effect, and a hand that
holds it by a spring and a damper and pushes. The force of a tick takes effect `delay` periods after
its sample (in eighths), through a first-order lag if the device has one.
"""

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from scipy.linalg import expm

from hapticd.mailbox.layout import Command, Flag, Result, Value
from hapticd.servo.plan import SETTLED
from hapticd.servo.safety import State
from support.flight import Flight
from support.models import COUNT_M, COUNT_NS_PER_M

T = 1e-3
PARTS = 8  # of a period
DEVICE_NS_PER_M = 0.36  # true damping of the device; CREDITED of it is known for certain
CREDITED_NS_PER_M = 0.25
LIMIT_N = 8.0


@dataclass(frozen=True)
class Hand:
    """The mass that moves with the handle, and the grip that holds it at `position_m`."""

    mass_kg: float = 0.008  # the handle included
    stiffness_n_per_m: float = 0.0
    damping_ns_per_m: float = 0.0
    push_n: float = 0.0  # steady
    wander_n: float = 0.0  # rms of a push at random, below 3 Hz


@cache
def part_of_a_period(hand: Hand, active_count: int, lag_hz: float) -> Any:
    """State (x, v, f) after an eighth of a period, by (x, v, f, command, push)."""
    damping = DEVICE_NS_PER_M + hand.damping_ns_per_m + COUNT_NS_PER_M * active_count
    corner = 2.0 * np.pi * lag_hz
    rates = np.zeros((5, 5))
    rates[0, 1] = 1.0
    rates[1, :3] = np.array([-hand.stiffness_n_per_m, -damping, 1.0]) / hand.mass_kg
    rates[1, 4] = 1.0 / hand.mass_kg
    if lag_hz:
        rates[2, 2:4] = -corner, corner
    return [row.tolist() for row in expm(rates * T / PARTS)[:3]]


def wander(hand: Hand, ticks: int, seed: int) -> list[float]:
    """Push [N] at random, by tick."""
    random = np.random.default_rng(seed)
    shape = np.zeros(ticks // 2 + 1)
    shape[1 : max(2, round(3.0 * ticks * T))] = 1.0
    phases = np.exp(2j * np.pi * random.random(shape.size))
    wave = np.fft.irfft(shape * phases, ticks)
    return (hand.push_n + hand.wander_n * wave / (wave.std() or 1.0)).tolist()


class LeakFlight(Flight):
    """A flight with a simulated handle; all sums are those of the simulated motor."""

    def __init__(
        self,
        params: Any,
        hand: Hand,
        delay: float = 0.125,
        lag_hz: float = 0.0,
        damps: bool = True,  # the board has active damping and reports it
    ) -> None:
        self.hand = hand
        self.delay = delay
        self.lag_hz = lag_hz
        self.damps = damps
        self.motion = (0.0, 0.0, 0.0)  # x, v, f
        self.push_n = 0.0
        self.work_j = 0.0  # done by the motor's force
        self.damped_j = 0.0  # by the credited damping
        self.changed_j = 0.0  # energy that changes of parameters added, minus the removed energy
        self.stored_j = 0.0
        self.leaks: list[float] = []  # J, by tick
        self.positions: list[float] = []
        self.flags: list[int] = []
        self.states: list[int] = []
        self.commands: list[tuple[float, int]] = []  # force, damping count; by tick
        super().__init__(params)

    def _one(self, commands: Any, **sample: Any) -> Any:
        x, *_ = self.motion
        damping = self._in_effect(len(self.commands) * PARTS)[1]
        given = {"encoder": round(x / COUNT_M), "delay": self.delay, "damping": damping}
        before = elastic(self.state[SETTLED].environment, x)
        out = super()._one(commands, **{**given, **sample})
        after = elastic(self.state[SETTLED].environment, x)
        self.changed_j += after - before
        self.stored_j = after
        self._book(out)
        count = self.state[SETTLED].damping_count if self.damps else 0
        self.commands.append((out[8], count))
        self._move()
        return out

    def _book(self, out: Any) -> None:
        leak = self.work_j + self.stored_j - self.changed_j - self.damped_j
        self.leaks.append(leak)
        self.positions.append(self.motion[0])
        self.flags.append(out[9])
        self.states.append(int(self.plan.state))

    def _in_effect(self, part: int) -> tuple[float, int]:
        tick = (part - round(self.delay * PARTS)) // PARTS
        return self.commands[tick] if 0 <= tick < len(self.commands) else (0.0, 0)

    def _move(self) -> None:
        first = (len(self.commands) - 1) * PARTS
        for part in range(first, first + PARTS):
            force, count = self._in_effect(part)
            self._part(force, count)

    def _part(self, command_n: float, count: int) -> None:
        x, v, f = self.motion
        if not self.lag_hz:
            f = command_n
        rows = part_of_a_period(self.hand, count, self.lag_hz)
        given = (x, v, f, command_n, self.push_n)
        self.motion = tuple(sum(a * b for a, b in zip(row, given, strict=True)) for row in rows)
        x_next, v_next, f_next = self.motion
        self.work_j += 0.5 * (f + f_next) * (x_next - x)
        square = (v * v + v * v_next + v_next * v_next) / 3.0
        self.damped_j += (CREDITED_NS_PER_M + COUNT_NS_PER_M * count) * square * T / PARTS

    def pushed(self, pushes: list[float]) -> None:
        """Fly with the hand's pushes [N], one a tick."""
        for push in pushes:
            self.push_n = push
            self.fly()

    def begun(self, settings: dict[Value, float]) -> None:
        """Enabled with `settings`; the sums begin here."""
        assert self.do(Command.SET, {Value.RAMP_S: 0.0, **settings}) is Result.APPLIED
        assert self.do(Command.ENABLE) is Result.APPLIED
        self.fly(501)
        assert self.plan.state is State.ENABLED
        self.work_j = self.damped_j = self.changed_j = 0.0
        self.leaks.clear()
        self.positions.clear()
        self.flags.clear()

    @property
    def acted(self) -> bool:
        return any(flags & Flag.CONTROLLED for flags in self.flags)


def elastic(environment: Any, x: float) -> float:
    """Energy [J] of spring and wall at `x`, each clamped."""
    stiffness, _, _, _, limit, wall_k, _, wall_x, side, *_ = environment
    total = 0.0
    for k, bent in ((stiffness, x), (wall_k, max(0.0, (x - wall_x) * side))):
        within = min(abs(bent), limit / k) if k > 0.0 else abs(bent)
        total += 0.5 * k * within**2 + limit * (abs(bent) - within)
    return total
