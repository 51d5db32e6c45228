"""A simulated person at a blind rig who fulfils requests: places the handle with some um of
scatter, hangs masses with an error, moves, shakes and releases. It acts on the handle by forces
only.
"""

from collections.abc import Callable
from math import copysign, pi, sin, sqrt
from random import Random
from typing import Any

from hapticd.model.composed import POSITION, VELOCITY
from hapticd.rig.result import Request

GRAVITY_M_PER_S2 = 9.80665
GRIP_N_PER_M = 5e3
GRIP_RATIO = 1.0  # of critical damping
SPEED_M_PER_S = 0.02
SCATTER_M = 5e-6  # rms, of a handle that is held against something firm
PRESSED = 2  # times that a hand corrects for friction
SHAKEN_M = 3e-3
SHAKEN_HZ = 3.0
SETTLED_S = 2.0  # wait before "it is done"
PULLS_TO = -1
Path = Callable[[float], tuple[float, float]]  # position [m], velocity [m/s] at a time [s]


class Person:
    """The force on the handle (`pull_n`), and the answers to requests (`ask`).

    `pass_time(seconds)` lets the rig run; `attach(kg)` fixes a mass to the handle.
    """

    def __init__(
        self,
        seed: int,
        moving_kg: float,
        pass_time: Callable[[float], None],
        attach: Callable[[float], None],
    ) -> None:
        self._random = Random(f"person {seed}")
        self._grip_ns_per_m = GRIP_RATIO * 2.0 * sqrt(GRIP_N_PER_M * moving_kg)
        self._pass_time = pass_time
        self._attach = attach
        self.mass_error = 0.0
        self.distance_error_m = 0.0
        self.typed_wrong = False  # for one of the masses
        self.weight_n = 0.0
        self._spring_n_per_m = 0.0
        self._spring_m = 0.0
        self._path: Path | None = None
        self._now_s = 0.0
        self._at_m = 0.0  # where the handle is
        self._a_m: float | None = None
        self._hung = 0
        self.one_signal: Callable[[float], None] = lambda _seconds: None

    def pull_n(self, state: Any, seconds: float) -> float:
        """Force on the handle over the next `seconds`; springs as they are in the middle."""
        x = state[POSITION]
        self._at_m = x
        if self._path is None and not self._spring_n_per_m:
            self._now_s += seconds
            return self.weight_n
        v = state[VELOCITY]
        middle = x + 0.5 * seconds * v
        force = self.weight_n - self._spring_n_per_m * (middle - self._spring_m)
        if self._path is not None:
            at, speed = self._path(self._now_s + 0.5 * seconds)
            force += GRIP_N_PER_M * (at - middle) + self._grip_ns_per_m * (speed - v)
        self._now_s += seconds
        return force

    def ask(self, request: Request) -> None:
        """Fulfil a request."""
        actions: dict[str, Callable[[float], None]] = {
            "let go": self._let_go,
            "move": self._move,
            "hold": self._hold,
            "origin": lambda _amount: self._go(self._at_m),
            "hang": self._hang,
            "attach": self._fix,
            "spring": self._spring,
            "draw": self._draw,
            "shake": self._shake,
            "warm": lambda _celsius: None,
            "one signal": lambda seconds: self.one_signal(seconds),
        }
        actions[request.action](request.amount)

    def _let_go(self, _amount: float) -> None:
        self._path = None
        self.weight_n = 0.0
        self._spring_n_per_m = 0.0
        self._attach(0.0)
        self._pass_time(SETTLED_S)

    def _go(self, to_m: float) -> None:
        """Move the handle to `to_m` and hold it."""
        self._path = way(self._now_s, self._at_m, to_m)
        self._pass_time(abs(to_m - self._at_m) / SPEED_M_PER_S + 0.5)

    def _move(self, amount: float) -> None:
        """Begins a second later; the step measures meanwhile."""
        self._path = way(self._now_s + 1.0, self._at_m, self._at_m + amount)

    def _hold(self, amount: float) -> None:
        if self._a_m is None:
            self._a_m = self._at_m - 2e-3
        error_m = self.distance_error_m if amount else 0.0
        to_m = self._a_m + amount + error_m + self._random.gauss(0.0, SCATTER_M)
        self._go(to_m)
        aim_m = to_m
        for _ in range(PRESSED):  # against something firm: friction does not keep it away
            aim_m += to_m - self._at_m
            self._path = way(self._now_s, aim_m, aim_m)
            self._pass_time(0.5)

    def _hang(self, kilograms: float) -> None:
        self._hung += kilograms > 0.0
        wrong = self.typed_wrong and kilograms > 0.0 and self._hung == 2
        real_kg = kilograms * (1.0 + self.mass_error) * (0.1 if wrong else 1.0)
        self.weight_n = PULLS_TO * GRAVITY_M_PER_S2 * real_kg
        self._path = None
        self._attach(real_kg)
        self._pass_time(SETTLED_S)

    def _fix(self, kilograms: float) -> None:
        self._path = None
        self._attach(kilograms * (1.0 + self.mass_error))
        self._pass_time(SETTLED_S)

    def _spring(self, n_per_m: float) -> None:
        self._path = None
        self._spring_n_per_m = n_per_m
        self._spring_m = self._at_m
        self._pass_time(SETTLED_S)

    def _draw(self, amount: float) -> None:
        self._go(self._at_m + amount)
        self._path = None

    def _shake(self, seconds: float) -> None:
        middle = self._at_m
        begin = self._now_s

        def path(now_s: float) -> tuple[float, float]:
            rate = 2.0 * pi * SHAKEN_HZ
            since = min(now_s - begin, seconds)
            at = middle + SHAKEN_M * sin(rate * since)
            return at, SHAKEN_M * rate * sin(rate * since + pi / 2) * (now_s - begin < seconds)

        self._path = path


def way(begin_s: float, from_m: float, to_m: float) -> Path:
    """Return a path from one position to another at SPEED_M_PER_S, then at rest."""
    lasts_s = abs(to_m - from_m) / SPEED_M_PER_S
    speed = copysign(SPEED_M_PER_S, to_m - from_m)

    def path(now_s: float) -> tuple[float, float]:
        since = now_s - begin_s
        if since <= 0.0:
            return from_m, 0.0
        return (from_m + speed * since, speed) if since < lasts_s else (to_m, 0.0)

    return path
