"""A hand at a simulated rig whose parameters differ from its device file: it moves the handle and
hangs masses on it. Steps have only a client; the true parameters stay here.
"""

from dataclasses import replace
from typing import Any

from hapticd.model.step import make_plant
from hapticd.rig.result import Request
from hapticd.run.lockstep import LockStepClient
from support.boards import board_params
from support.models import device_params, servo_params

STEP_M = 2e-5  # that a hand moves in a tick: 0.02 m/s


class Hand:
    """`bench` and the actions at its handle. `pull_n` acts on it all the time."""

    def __init__(self, device: dict[str, Any] | None = None, **board: Any) -> None:
        servo = servo_params(device=device_params(**device or {}))
        self._params = board_params(**board)
        self.bench = LockStepClient(servo, self._params)
        port: Any = self.bench.stack.backend._port
        simulated = getattr(port, "board", port)
        self.axis = simulated._axis
        self.life = simulated._life
        self.pull_n = 0.0
        self.gain = 1.0  # of the motor, independent of the board's hello
        self.offset_n = 0.0  # of the motor, at a count of 0
        self.reflex_n = 0.0  # of a hand that pushes whenever the motor does
        self.held_m: float | None = None
        self.free = self.axis.plant

        def step(state: Any, force_n: float, torque_n: float, damping: float, count: int) -> Any:
            free = self.free
            if self.held_m is not None:
                return free.rest(self.held_m)
            motor_n = self.gain * force_n + self.offset_n + self.reflex_n * (force_n != 0.0)
            return free.step(state, motor_n, torque_n + self.pull_n, damping, count)

        self.axis.plant = self.free._replace(step=step)

    def __enter__(self) -> "Hand":
        return self

    def __exit__(self, *_: object) -> None:
        self.bench.close()

    @property
    def position_m(self) -> float:
        """Where the handle truly is."""
        return float(self.axis.plant.encoder(self.axis.state, 0.0, 0.0))

    def hold(self, at_m: float) -> None:
        """Move the handle to `at_m`, slowly, and hold it."""
        self.held_m = self.position_m
        while abs(at_m - self.held_m) > 1e-9:
            self.held_m += max(-STEP_M, min(STEP_M, at_m - self.held_m))
            self.bench.run(1)

    def let_go(self) -> None:
        """Release the handle; only gravity and motor act."""
        self.held_m = None

    def ask(self, request: Request) -> None:
        """Fulfil a request to fix a mass to the handle or to remove it."""
        if request.action in ("attach", "let go"):
            mass_kg = self._params.mass_kg + request.amount
            self.free = make_plant(replace(self._params, mass_kg=mass_kg))
        self.settle(2.0)

    def settle(self, seconds: float = 1.0) -> None:
        """Time passes."""
        self.bench.run(round(1000 * seconds))
