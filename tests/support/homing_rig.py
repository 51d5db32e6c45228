"""A servo that homes on a plant, tick by tick, without the wire: the input of `servo.step` and the
effect of its force. Quick, for many seeds.
"""

from collections.abc import Callable
from dataclasses import replace
from math import floor, inf
from random import Random
from typing import Any, NamedTuple

from hapticd.core.params import DeviceParams, HomeParams
from hapticd.mailbox.layout import Command
from hapticd.model.params import HandParams, TouchParams
from hapticd.model.step import SUBSTEPS_PER_TICK, make_plant
from hapticd.servo.plan import SETTLED
from hapticd.servo.safety import State
from hapticd.servo.step import initial_state, make_step
from hapticd.usb.device import SEED
from hapticd.usb.frames import OutFlag, StatusBit
from support.boards import board_params
from support.flight import AMBIENT_COUNT, HEALTHY, masked
from support.models import COUNT_M, device_params, servo_params

LATCH = 14  # sub-steps after the command: sample_phase 0.875
GRANTED = int(StatusBit.ENABLED)


class Homed(NamedTuple):
    """How a homing ended."""

    state: State
    fault: int
    homed: bool
    error_m: float  # of the servo's position, without the compression of a stop
    worst_n: float
    fastest_m_per_s: float
    ticks: int
    where_m: float  # at the end


class Rig:
    """One device. `granted(tick)`: the board grants torque; `gain`: of the amplifier."""

    def __init__(
        self,
        home: HomeParams,
        touch: TouchParams | None = None,
        granted: Callable[[int], bool] = lambda tick: True,
        gain: float = 1.0,
        mark_m: float | None = None,
        device: DeviceParams | None = None,
        **board: Any,
    ) -> None:
        self.params = servo_params(device=device or device_params(home=home))
        self.step = make_step(self.params)
        self.state = initial_state(self.params)
        ready = board_params(**{"lower_stop_m": -inf, "upper_stop_m": inf} | board)
        self.plant = make_plant(replace(ready, touch=touch))
        self.granted = granted
        self.gain = gain
        self.mark_m = mark_m
        self.body = self.plant.rest(0.0)
        self.encoder = 0
        self.tick = 0
        self.force_n = 0.0
        self.live = False
        self.forces: list[float] = []
        self.speeds: list[float] = []

    @property
    def plan(self) -> Any:
        return self.state[SETTLED].plan

    def fly(self, kind: int | None = None) -> Any:
        """One tick, with a command."""
        commands = () if kind is None else ((1, int(kind), 9, 0, masked({})),)
        arrival = 0 if self.tick else SEED
        before = self.encoder
        self.body = self.plant.step(self.body, self.applied(), 0.0, 0.0, LATCH)
        self.encoder = floor(self.body[0] / COUNT_M + 0.5)
        live = self.live and self.granted(self.tick)
        status = (GRANTED if live else 0) | self.marked(before)
        current = round(self.applied() / 1.65 / (10.0 / 32767))
        index = 0 if self.mark_m is None else self.encoder - floor(self.mark_m / COUNT_M + 0.5)
        sample = (self.encoder, status, AMBIENT_COUNT, arrival, HEALTHY, index, 0.125, current, 0)
        self.body = self.plant.step(self.body, self.applied(), 0.0, 0.0, SUBSTEPS_PER_TICK - LATCH)
        self.state, out = self.step(self.state, commands, sample, self.tick)
        self.force_n = out[8]
        self.live = bool(self.state[SETTLED].out_flags & OutFlag.ENABLE)
        self.tick += 1
        self.forces.append(self.force_n)
        self.speeds.append(self.body[1])
        return out

    def applied(self) -> float:
        live = self.live and self.granted(self.tick)
        return self.gain * self.force_n if live else 0.0

    def marked(self, before: int) -> int:
        if self.mark_m is None:
            return 0
        mark = floor(self.mark_m / COUNT_M + 0.5)
        passed = min(before, self.encoder) < mark <= max(before, self.encoder)
        return int(StatusBit.INDEX) if passed else 0

    def home(self, true_m: float, ticks: int = 20_000) -> Homed:
        """Home to the end; `true_m` is the position of the stop or the mark."""
        self.fly()
        self.fly(Command.HOME)
        while self.plan.state is State.HOMING and self.tick < ticks:
            self.fly()
        plan = self.plan
        believed_m = COUNT_M * (true_m / COUNT_M - plan.origin)
        return Homed(
            plan.state,
            plan.fault,
            plan.homed,
            believed_m - self.params.device.home.position_m,
            max(map(abs, self.forces)),
            max(map(abs, self.speeds)),
            self.tick,
            self.body[0],
        )


HOME = HomeParams(method="stop", direction=-1, speed_m_per_s=0.01, force_n=0.5, position_m=-0.022)


class Case(NamedTuple):
    """One seeded homing."""

    touch: TouchParams
    stop_m: float
    mass_kg: float
    what: str


def seeded(seed: int) -> Case:
    """Friction, stiffness and a hand by `seed`; a tenth starts at the stop."""
    random = Random(seed)
    mass_kg = random.uniform(0.005, 0.008)
    stiffness = 10.0 ** random.uniform(4.0, 6.3)
    ratio = random.uniform(0.02, 0.3)
    coulomb_n = random.choice((0.0, 0.0293, random.uniform(0.0, 0.3)))
    static_n = coulomb_n * random.uniform(1.0, 1.8)
    hands, what = _hands(random)
    touch = TouchParams(
        stop_stiffness_n_per_m=stiffness,
        stop_damping_ns_per_m=2.0 * ratio * (stiffness * mass_kg) ** 0.5,
        coulomb_n=coulomb_n,
        static_n=static_n,
        hands=hands,
    )
    stop_m = 0.0 if random.random() < 0.1 else -random.uniform(0.0, 0.022)
    said = f"k {stiffness:.2g} Fc {coulomb_n:.3f} Fs {static_n:.3f} stop {stop_m * 1e3:.1f} {what}"
    return Case(touch, stop_m, mass_kg, said)


def _hands(random: Random) -> tuple[tuple[HandParams, ...], str]:
    kind = random.choice(("none", "none", "hold", "grasp", "let go", "push", "lean", "strike"))
    start_s = random.uniform(0.0, 5.0)
    stiffness = 10.0 ** random.uniform(1.5, 4.0)
    grip = {
        "stiffness_n_per_m": stiffness,
        "damping_ns_per_m": random.uniform(0.5, 10.0),
        "tremor_m": random.choice((0.0, 3e-5, 3e-4)),
    }
    force_n = random.uniform(-1.5, 1.5)
    hands = {
        "none": (),
        "hold": (HandParams("hold", **grip),),
        "grasp": (HandParams("hold", start_s, **grip),),
        "let go": (HandParams("hold", 0.0, start_s, **grip),),
        "push": (HandParams("push", start_s, random.uniform(0.05, 2.0), force_n),),
        "lean": (HandParams("push", force_n=force_n),),
        "strike": tuple(
            HandParams("strike", start_s + n * 0.7, 0.01, 4.0 * force_n) for n in range(3)
        ),
    }[kind]
    return hands, f"{kind} {start_s:.2f} s {stiffness:.0f} N/m {force_n:.2f} N"
