"""Ticks from the physical cause of each fault to zero force at the simulated motor.

A servo holds a handle 1 to 8 mm off with K = 200 to 600 N/m. The fault is caused, and the motor is
observed in every piece that the plant plays. The figure is the worst of SEEDS seeds, which vary
stiffness, place, phase of the stop ramp and the other free parameters of the fault. Its yardstick
is the fault's page: the ticks within which it is noticed, and RAMP_TICKS for the ramp and the path
to the motor. Virtual time: the figure is the same on every machine.

    page      docs/faults/CODE.md: "Noticed within N ticks"
    cause     the moment of the affected OUT attempt, of the command, of the pause of the host, of
              the last heartbeat, of the overspeed, or of the first clamped force

Not here: `not_finite`, which no setting within its limits can cause. `energy`, whose cause is a sum
without a moment. Homing's own faults, which are verdicts on a search with its time-out.

Limitations: a fault that leads to another code (the figure reports it).
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from math import ceil, inf
from pathlib import Path
from random import Random
from re import search
from typing import Any, NamedTuple

from benchmarks import targets
from benchmarks.figures import Figure, compared
from benchmarks.stand import settings
from benchmarks.worker import BenchError
from hapticd.core.faults import BY_CODE, BY_NUMBER
from hapticd.core.params import ScaleParams, ServoParams
from hapticd.core.units import NS_PER_MS
from hapticd.mailbox.daemons import press_stop
from hapticd.mailbox.layout import Command, Value
from hapticd.model.composed import VELOCITY
from hapticd.model.params import BoardParams, HandParams, InjectionParams, TouchParams
from hapticd.run.lockstep import LockStep
from hapticd.servo.plan import SETTLED
from hapticd.settings.build import board_params, servo_params
from hapticd.sim.injection import Injector

TARGETS = targets.of("fault_ticks")
PAGES = Path(__file__).resolve().parents[1] / "docs" / "faults"
SEEDS = 50
RAMP_TICKS = 22  # 20 of the ramp, and two to the motor
ENABLE_S = 0.02
HELD_TICKS = 60  # until the force is steady
WATCHDOG_MS = 20.0  # of a usual board
FASTEST_M_PER_S = 20.0
OVERSPEED_M_PER_S = 14.0
ENOUGH_TICKS = 200  # beyond the ticks of the page


class Rig:
    """A servo under force, and the last moment of force at its motor."""

    def __init__(self, stack: LockStep, random: Random) -> None:
        self.stack = stack
        self.random = random
        self.port: Any = stack.backend._port
        self.board: Any = self.port.board if isinstance(self.port, Injector) else self.port
        self.axis = self.board._axis
        self.cause_ns = 0
        self.forced_until_ns = 0
        self.limit_n = stack.loop.params.safety.force_limit_n
        self.watch = Watch()
        self._watch_plant()

    def _watch_plant(self) -> None:
        step = self.axis.plant.step

        def watched(state: Any, force_n: float, torque_n: float, level: float, n: int) -> Any:
            if force_n:
                self.forced_until_ns = self.board._to_ns(self.axis.now + n)
            if not self.cause_ns and self.watch.seen(force_n, state[VELOCITY]):
                self.cause_ns = self.board._to_ns(self.axis.now)
            return step(state, force_n, torque_n, level, n)

        self.axis.plant = self.axis.plant._replace(step=watched)

    def hold(self, stiffness: float) -> None:
        """Enable, and wait until the force is steady."""
        stack = self.stack
        stack.run(5)
        stack.do(Command.SET, {Value.STIFFNESS: stiffness, Value.RAMP_S: 0.0})
        stack.do(Command.ENABLE)
        stack.run(HELD_TICKS + self.random.randint(0, 10))

    def go_on(self) -> None:
        """Advance the board without a transfer: otherwise it would stand still."""
        self.board._advance(self.stack.clock.now_ns())

    def run(self, ticks: int) -> None:
        for _ in range(ticks):
            self.stack.run(1)
            self.go_on()

    def caused_now(self) -> None:
        """Set the cause to this moment, a random part of a tick before the next."""
        self.cause_ns = self.stack.clock.now_ns()

    @property
    def code(self) -> str:
        """The latched fault."""
        return BY_NUMBER[self.stack.loop.state[SETTLED].plan.fault].code


class Watch(NamedTuple):
    """A cause observed at the plant: the force at its limit, the handle faster than allowed."""

    force_n: float = inf
    speed_m_per_s: float = inf

    def seen(self, force_n: float, speed_m_per_s: float) -> bool:
        return abs(force_n) >= self.force_n or abs(speed_m_per_s) > self.speed_m_per_s


class Scenario(NamedTuple):
    """The cause of a fault: `board(params, random)` before, `strike(rig)` while the force acts."""

    code: str
    board: Callable[[BoardParams, Random], BoardParams] = lambda board, random: board
    strike: Callable[[Rig], None] = lambda rig: None
    hardware: bool = False  # lost slots of a host count only with real hardware


def struck(kind: str, values: tuple[float, ...] = (0.0,), count: int = 1) -> Any:
    """Return a board with that injection once the force is steady."""

    def board(params: BoardParams, random: Random) -> BoardParams:
        tick = 120 + random.randint(0, 10)
        one = InjectionParams(kind, tick=tick, count=count, value=random.choice(values))
        return replace(params, injections=(one,))

    return board


def next_strike(rig: Rig) -> None:
    """Continue to the affected OUT; its attempt is the cause."""
    number = rig.port._injections[0].tick
    deliver = rig.stack.backend.deliver

    def noted(data: memoryview, t_ns: int) -> None:
        if rig.port.tick == number:
            rig.caused_now()
        deliver(data, t_ns)

    rig.stack.backend.deliver = noted


def pause(low_ms: float, high_ms: float, rig: Rig) -> None:
    """Pause the host."""
    rig.caused_now()
    until_ns = rig.cause_ns + round(rig.random.uniform(low_ms, high_ms) * NS_PER_MS)
    while rig.stack.clock.time_ns < until_ns:
        rig.stack.clock.time_ns = min(until_ns, rig.stack.clock.time_ns + NS_PER_MS)
        rig.go_on()


def stopped(rig: Rig) -> None:
    """Stop by a command, or by the stop word alone."""
    rig.caused_now()
    if rig.random.random() < 0.5:
        rig.stack.command(Command.STOP)
    else:
        press_stop(rig.stack.mailbox.folder)


def silent(rig: Rig) -> None:
    """Send the gateway's last heartbeat now."""
    rig.stack.run(1)
    rig.caused_now()
    rig.stack.gateway.beat(rig.stack.clock.now_ns())
    rig.stack.gateway_alive = False


def pushed(params: BoardParams, random: Random) -> BoardParams:
    """Return a board with a hand that throws the handle faster than the device allows."""
    held, *_ = params.touch.hands if params.touch else ()
    hand = HandParams("push", start_s=0.13, force_n=random.uniform(19.0, 21.0))
    touch = TouchParams(hands=(replace(held, duration_s=0.13), hand))
    return replace(params, touch=touch, lower_stop_m=-inf, upper_stop_m=inf)


def thrown(rig: Rig) -> None:
    limit = rig.stack.loop.params.device.overspeed_m_per_s
    assert limit is not None
    rig.watch = Watch(speed_m_per_s=limit)


def free(params: BoardParams, random: Random) -> BoardParams:
    """Return a board with a light handle and no hand."""
    return replace(params, touch=None, viscous_ns_per_m=0.1)


def unstable(rig: Rig) -> None:
    """Set K = 800 N/m without damping; the first force at its limit is the cause."""
    rig.watch = Watch(force_n=rig.limit_n * 0.999)
    rig.stack.do(Command.SET, {Value.STIFFNESS: 800.0, Value.RAMP_S: 0.0})


SCENARIOS = (
    Scenario("stop", strike=stopped),
    Scenario("gateway_lost", strike=silent),
    Scenario("usb_lost", struck("io_error"), next_strike),
    Scenario("frames_lost", struck("drop_in", count=300), next_strike),
    Scenario("lost_slots", strike=partial(pause, 12.5, 18.0), hardware=True),
    Scenario("board_watchdog", strike=partial(pause, 22.0, 40.0)),
    Scenario("board_fault", struck("amplifier_fault", (0.3,)), next_strike),
    Scenario("sensor_range", struck("encoder_jump", (1e6, 3e5, -2e5)), next_strike),
    Scenario("sensor_glitch", struck("encoder_burst", (4000.0, 8000.0), 80), next_strike),
    Scenario("sensor_glitch", struck("encoder_burst", (8000.0, 15_000.0), count=300), next_strike),
    Scenario("over_temperature", struck("sensor_extreme"), next_strike),
    Scenario("no_authority", struck("emergency_stop", (0.3,)), next_strike),
    Scenario("force_at_limit", free, unstable),
    Scenario("overspeed", pushed, thrown),
    Scenario("board_restarted", struck("restart", (0.0, 2400.0, 4290.0)), next_strike),
)
CASES = {scenario.code: scenario for scenario in SCENARIOS}


def stated_ticks(code: str) -> int:
    """Return the ticks within which the fault is noticed, from its page. BenchError
    without them.
    """
    found = search(r"Noticed within (\d+) ticks?\b", (PAGES / f"{code}.md").read_text())
    if found is None:
        raise BenchError(f"docs/faults/{code}.md gives no number of ticks")
    return int(found[1])


def parameters(scenario: Scenario, random: Random) -> tuple[ServoParams, BoardParams]:
    """Return servo and board of one seed."""
    stand = settings()
    servo = servo_params(stand, "fault")
    board = board_params(stand)
    assert board is not None
    sign = random.choice((-1, 1))
    off = ScaleParams(
        board.position_m_per_count,
        offset_count=round(sign * random.uniform(0.001, 0.008) / board.position_m_per_count),
    )
    # this trial is of one fault: the energy of a throw or a limit cycle is another
    device = replace(servo.device, position=off, physical_damping_ns_per_m=None)
    # both are reached before the encoder steps faster than any hand
    fastest = {"overspeed": OVERSPEED_M_PER_S}.get(scenario.code)
    device = replace(device, overspeed_m_per_s=fastest, speed_limit_m_per_s=FASTEST_M_PER_S)
    if scenario.code in ("force_at_limit", "overspeed"):  # their motion bends like a glitch
        device = replace(device, acceleration_limit_m_per_s2=inf)
    safety = replace(servo.safety, enable_ramp_s=ENABLE_S)
    held = TouchParams(hands=(HandParams("hold", stiffness_n_per_m=2e4, damping_ns_per_m=20.0),))
    board = replace(board, touch=held, watchdog_ms=WATCHDOG_MS, seed=random.randrange(1000))
    calm = replace(
        servo.environment, stiffness_n_per_m=0.0, virtual_damping_ns_per_m=0.0, mass_kg=0.0
    )
    if scenario.hardware:
        servo = replace(servo, realtime=replace(servo.realtime, grace_s=0.0))
    servo = replace(
        servo, device=device, safety=safety, environment=calm, simulated=not scenario.hardware
    )
    return servo, scenario.board(board, random)


def ticks_of(scenario: Scenario, seed: int) -> float:
    """Return the ticks from the cause to the last moment with force at the motor.

    BenchError for another fault, or none.
    """
    random = Random(f"{scenario.code} {seed}")
    servo, board = parameters(scenario, random)
    with LockStep(servo, board) as stack:
        rig = Rig(stack, random)
        rig.hold(random.uniform(200.0, 600.0))
        if not rig.axis.force_n:
            raise BenchError(f"{scenario.code}, seed {seed}: there was no force to end")
        scenario.strike(rig)
        rig.run(stated_ticks(scenario.code) + RAMP_TICKS + ENOUGH_TICKS)
        code = rig.code
        left_ns = rig.forced_until_ns - rig.cause_ns
    if code != scenario.code or rig.axis.force_n or not rig.cause_ns:
        raise BenchError(f"{scenario.code}, seed {seed}: the fault is {code!r}")
    return max(0.0, left_ns * 1e-9 * servo.realtime.rate_hz)


def measure() -> Iterator[Figure]:
    """Yield the worst of all seeds, for each fault."""
    assert set(CASES) <= set(BY_CODE)
    for code, scenario in CASES.items():
        worst, seed = max((ticks_of(scenario, seed), seed) for seed in range(SEEDS))
        name = f"fault_ticks_{code}"
        allowed = stated_ticks(code) + RAMP_TICKS
        note = f"worst of {SEEDS} seeds: {seed}"
        yield compared(name, TARGETS[name], ceil(worst - 1e-6), "ticks", allowed, note)
