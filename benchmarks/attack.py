"""An attack on the force path: random commands, traits of the board and faults of the link.

A flight is a servo and its simulated board in lock-step for TICKS ticks. Its seed determines the
board (queue, transport, hands, stops, bounce, clock, a hello that contradicts the device file), the
servo (limits, ramps), and the faults with their times. It also determines every command: all kinds,
several in a tick, scheduled ones, invalid values, the stop word, a gateway that falls silent, a
host that pauses. The operator aims at force: a servo without force is reset, zeroed and enabled
again. Violations are judged at the simulated motor (`attack_watch`).

    python benchmarks/attack.py                      a million ticks, as `make bench`
    python benchmarks/attack.py --ticks 4000000 --first-seed 1000      others, and more
    python benchmarks/attack.py --seed 17            one flight, with its violations

A count shows how often each kind of fault and trait occurred; the attack reports counts below
LEAST. Limitations: a fault or trait of the board that is not in its table here is never tried.
"""

import argparse
import json
import os
import sys
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from math import inf, nan
from pathlib import Path
from random import Random
from typing import Any, NamedTuple

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np

from benchmarks import targets
from benchmarks.attack_watch import DTYPE, Given, Violation, Watch
from benchmarks.figures import Figure, compared
from benchmarks.stand import settings
from hapticd.core.params import HomeParams, SafetyParams, ScaleParams, ServoParams
from hapticd.mailbox.daemons import press_stop
from hapticd.mailbox.layout import Command, State, Value, values_of
from hapticd.model.params import BoardParams, HandParams, InjectionParams, TouchParams
from hapticd.run.lockstep import LockStep
from hapticd.settings.build import board_params, servo_params

TARGETS = targets.of("attack")
TICKS = 4000  # of one flight
FAULTS = 12  # of one flight
LONGEST = 24  # ticks between two actions of the operator
RUN_TICKS = 1_000_000
LEAST = 20  # minimum count of every fault and trait in a million ticks


class Kind(NamedTuple):
    """Parameters of a fault of `sim.injection`: number of consecutive ticks, and its value."""

    count: tuple[int, int] = (1, 1)
    values: tuple[float, ...] = (0.0,)
    lies: bool = False  # false readings of the encoder


KINDS = {
    "drop_out": Kind((1, 12)),
    "corrupt_out": Kind((1, 4)),
    "stall_out": Kind(),
    "io_error": Kind(),
    "unplug": Kind(values=(0.02, 0.06, 0.15)),
    "late": Kind((1, 4), (0.0002, 0.0004, 0.001)),
    "amplifier_fault": Kind(values=(0.005, 0.05)),
    "encoder_fault": Kind(values=(0.005, 0.05)),
    "over_temperature": Kind(values=(0.005, 0.05)),
    "emergency_stop": Kind(values=(0.001, 0.004, 0.007, 0.02, 0.1)),
    "amplifier_stuck": Kind((1, 30), (-3.0, 3.0)),
    "amplifier_limited": Kind((1, 60), (0.2, 1.0)),
    "amplifier_gain": Kind((1, 30), (-1.0, 0.5, 1.5)),
    "active_damping_gain": Kind((1, 30), (0.0, 0.5)),
    "event_code": Kind((1, 3), (0.0, 1.0, 65535.0)),
    "restart": Kind(values=(0.0, 40 * 60.0, 2147.48, 4294.96)),
    "hang": Kind(values=(0.003, 0.02, 0.08)),
    "hang_unwatched": Kind(values=(0.003, 0.02, 0.05)),
    "drop_in": Kind((1, 12)),
    "delay_in": Kind((1, 3), (0.0008, 0.0031, 0.007)),
    "burst_in": Kind(values=(0.0031, 0.006)),
    "duplicate_in": Kind((1, 4)),
    "zero_length_in": Kind((1, 3)),
    "corrupt_in": Kind((1, 4)),
    "stall_in": Kind((1, 2)),
    "babble": Kind((1, 2)),
    "short_in": Kind((1, 3)),
    "encoder_jump": Kind((1, 3), (40.0, 4000.0, 30_000.0, 1e6), lies=True),
    "encoder_burst": Kind((1, 12), (100.0, 10_000.0, 1e6), lies=True),
    "encoder_stuck": Kind((1, 60), lies=True),
    "sensor_extreme": Kind((1, 2)),
}
REAL_WATCHDOG_MS = 20.0
RECOVERY = (Command.RESET, Command.ZERO, Command.ENABLE)


class Flight(NamedTuple):
    """Parameters of one flight."""

    servo: ServoParams
    board: BoardParams
    traits: tuple[str, ...]


class Found(NamedTuple):
    """Result of one flight."""

    seed: int
    ticks: int
    forced: int  # OUTs after which the motor had force
    violations: list[Violation]
    came: Counter[str]  # faults and traits


def drawn(seed: int, random: Random) -> Flight:
    """Return the flight of `seed`."""
    stand = settings()
    servo = servo_params(stand, "attack")
    board = board_params(stand)
    assert board is not None
    off_counts = round(random.uniform(-0.008, 0.008) / board.position_m_per_count)
    home = HomeParams(method=random.choice(("none", "stop")), speed_m_per_s=0.05, timeout_s=0.4)
    device = replace(
        servo.device,
        position=ScaleParams(board.position_m_per_count, offset_count=off_counts),
        force_step_n=random.choice((0.25, 0.5, 1.0)),
        home=home,
    )
    safety = SafetyParams(
        force_limit_n=random.choice((1.0, 3.0, 8.0)),
        enable_ramp_s=random.choice((0.02, 0.1, 0.5)),
        energy_controller=seed % 2 == 1,
    )
    usb = replace(servo.usb, in_flight=seed % 4 < 2)
    simulated = random.random() < 0.5
    servo = replace(servo, device=device, safety=safety, usb=usb, simulated=simulated)
    traits = [name for name, (share, _) in TRAITS.items() if random.random() < share]
    traits += RARE[seed % RARE_EVERY : seed % RARE_EVERY + 1]
    board = replace(
        board,
        seed=seed,
        watchdog_ms=REAL_WATCHDOG_MS,
        lower_stop_m=-0.02,
        upper_stop_m=0.02,
        injections=_faults(random),
    )
    for name in traits:
        board = TRAITS[name][1](board, random)
    return Flight(servo, board, tuple(traits))


def _faults(random: Random) -> tuple[InjectionParams, ...]:
    names = random.choices(list(KINDS), k=FAULTS)
    return tuple(
        InjectionParams(
            name,
            tick=random.randrange(100, TICKS),
            count=random.randint(*KINDS[name].count),
            value=random.choice(KINDS[name].values),
        )
        for name in names
    )


def _hand(board: BoardParams, random: Random, kind: str, **numbers: float) -> BoardParams:
    touch = board.touch or TouchParams()
    start_s = 0.0 if kind == "hold" else random.uniform(0.2, 0.9 * TICKS / board.rate_hz)
    hand = HandParams(kind, start_s=start_s, **numbers)
    return replace(board, touch=replace(touch, hands=(*touch.hands, hand)))


def _held(board: BoardParams, random: Random) -> BoardParams:
    stiffness = random.choice((200.0, 2e3, 2e4))
    numbers = {"stiffness_n_per_m": stiffness, "damping_ns_per_m": 5.0, "tremor_m": 2e-4}
    return _hand(board, random, "hold", **numbers)


def _pushed(board: BoardParams, random: Random) -> BoardParams:
    return _hand(board, random, "push", force_n=random.uniform(-2.0, 2.0), duration_s=0.5)


def _struck(board: BoardParams, random: Random) -> BoardParams:
    return _hand(board, random, "strike", force_n=random.uniform(-20.0, 20.0), duration_s=0.005)


def _sticky(board: BoardParams, random: Random) -> BoardParams:
    touch = board.touch or TouchParams()
    stops = {"stop_stiffness_n_per_m": 1e5, "stop_damping_ns_per_m": 10.0}
    return replace(board, touch=replace(touch, coulomb_n=0.1, static_n=0.15, **stops))


def _distant(board: BoardParams, random: Random) -> BoardParams:
    pair_us = random.choice((100.0, 300.0, 800.0, 1300.0))
    return replace(board, out_transport_us=0.4 * pair_us, in_transport_us=0.6 * pair_us)


# share of the flights with the trait, and its effect on the board
TRAITS: dict[str, tuple[float, Any]] = {
    "in_queue": (0.4, lambda board, random: replace(board, in_queue_depth=random.randint(1, 4))),
    "board_time": (
        0.5,
        lambda board, random: replace(
            board, board_time_us=random.choice((2**31, 2**32)) - random.randrange(5_000_000)
        ),
    ),
    "transport": (0.1, _distant),
    "lag": (0.1, lambda board, random: replace(board, lag_periods=1)),
    "bounce": (
        0.5,
        lambda board, random: replace(board, emergency_stop_bounce_ms=random.choice((1.0, 5.0))),
    ),
    "hold": (0.7, _held),
    "push": (0.3, _pushed),
    "strike": (0.2, _struck),
    "sticky": (0.2, _sticky),
    "other_serial": (0.0, lambda board, random: replace(board, hello_serial="OTHER")),
    "other_force": (
        0.0,
        lambda board, random: replace(board, force_n_per_count=10.0 * board.force_n_per_count),
    ),
    "no_temperature": (0.0, lambda board, random: replace(board, lacks=("temperature",))),
}
RARE = ("other_serial", "other_force", "no_temperature")  # traits of one flight in RARE_EVERY
RARE_EVERY = 12
TAMPERED = (nan, inf, -inf, 1e300, -1e300, 5e-324)
MOST = {
    Value.STIFFNESS: (0.0, 50.0, 200.0, 600.0, 600.0, -20.0, 3000.0, 1e5),
    Value.VIRTUAL_DAMPING: (0.0, 1.0, 3.0, 5.0, -0.2),
    Value.MASS: (0.0, 0.005, 0.02),
    Value.WALL_STIFFNESS: (0.0, 500.0, 3000.0),
    Value.WALL_VIRTUAL_DAMPING: (0.0, 2.0),
    Value.WALL_POSITION: (-0.005, 0.0, 0.005),
    Value.WALL_SIDE: (-1.0, 0.0, 1.0),
    Value.RAMP_S: (0.0, 0.0, 0.01, 0.1, 0.5),
    Value.VELOCITY_FILTER_HZ: (50.0, 100.0, 300.0),
    Value.ACCELERATION_FILTER_HZ: (50.0, 72.0, 300.0),
}


class Operator:
    """Sends random commands, and returns to force."""

    def __init__(self, stack: LockStep, random: Random) -> None:
        self.stack = stack
        self.random = random
        self.posted: dict[int, int] = {}  # kinds by sequence number
        self.silent_ticks = 0

    def act(self, state: int) -> None:
        """Act once."""
        random = self.random
        if state != State.ENABLED and random.random() < 0.7:
            for kind in RECOVERY:
                self._post(kind)
        for _ in range(random.choice((0, 0, 0, 1, 1, 2, 5))):
            self._one()
        if random.random() < 0.001:
            press_stop(self.stack.mailbox.folder)
        if random.random() < 0.004:
            self.stack.clock.time_ns += random.choice((1, 3, 12, 40)) * 1_000_000
        if random.random() < 0.0005:
            self.silent_ticks = random.choice((300, 1200))

    def _one(self) -> None:
        random = self.random
        kind = random.choices(list(Command), WEIGHTS)[0]
        at_tick = 0
        if kind in (Command.SET, Command.DAMPING) and random.random() < 0.2:
            at_tick = max(0, self.stack.loop.tick + random.randint(-3, 60))
        self._post(kind, self._values(kind), at_tick)

    def _values(self, kind: Command) -> dict[Value, float]:
        random = self.random
        values: dict[Value, float] = {}
        if kind == Command.SET:
            for place in random.sample(list(MOST), random.randint(1, 4)):
                values[place] = random.choice(MOST[place])
        elif kind == Command.DAMPING:
            values = {
                Value.ACTIVE_DAMPING: random.choice((0.0, 1.74, 5.0)),
                Value.ACTIVE_DAMPING_ON: random.choice((0.0, 1.0)),
            }
        elif kind == Command.PERTURB_START:
            values = {
                Value.SAMPLES: random.choice((1.0, 400.0)),
                Value.LOOP: random.choice((0.0, 1.0)),
            }
        if random.random() < 0.05:
            values[random.choice(list(Value)[1:])] = random.choice(TAMPERED)
        return values

    def _post(self, kind: int, values: dict[Value, float] | None = None, at_tick: int = 0) -> None:
        seq = self.stack.gateway.post(kind, 1, at_tick, values_of(values or {}))
        if seq is not None:
            self.posted[seq] = kind

    def given(self) -> Iterator[Given]:
        """Yield the answers since the last call."""
        for one in self.stack.gateway.answers():
            yield Given(self.posted.get(one.seq, 0), one.result, one.first_tick, one.effective)


WEIGHTS = [
    {
        Command.SET: 12,
        Command.ENABLE: 3,
        Command.DISABLE: 0.4,
        Command.STOP: 0.4,
        Command.HOME: 0.5,
    }.get(kind, 1)
    for kind in Command
]


def struck(board: BoardParams, ticks: int) -> Any:
    """Return whether an encoder was wrong (row 0), or samples or commands were lost (row 1),
    shortly before each OUT. A queued or delayed one may be read some ticks later.
    """
    rows = np.zeros((2, ticks), bool)
    for one in board.injections:
        rows[0 if KINDS[one.kind].lies else 1, one.tick : one.tick + one.count + 60] = True
    return rows


def fly(seed: int) -> Found:
    """Run and judge one flight."""
    random = Random(seed)
    flight = drawn(seed, random)
    with LockStep(flight.servo, flight.board) as stack:
        watch = Watch(stack, flight.servo, flight.board)
        wave = [random.randint(-8000, 8000) for _ in range(400)]
        stack.load_waveform(wave)
        operator = Operator(stack, random)
        state = int(State.DISABLED)
        while stack.loop.tick < TICKS:
            operator.act(state)
            ticks = random.randint(1, LONGEST)
            stack.gateway_alive = operator.silent_ticks <= 0
            operator.silent_ticks -= ticks
            state = int(np.frombuffer(stack.run(ticks), DTYPE)["state"][-1])
            watch.given += operator.given()
        records = np.frombuffer(b"".join(stack.blocks), DTYPE)
    violations = watch.judge(records, struck(flight.board, len(records)))
    if set(flight.traits) & {"other_serial", "other_force"} and watch.under_force():
        violations.append(Violation("authority", 0, "force on a board that contradicts its file"))
    came = Counter(one.kind for one in flight.board.injections)
    came.update(flight.traits)
    return Found(seed, len(records), watch.under_force(), violations, came)


def campaign(ticks: int, first_seed: int = 1, processes: int | None = None) -> Iterator[Found]:
    """Yield flights of at least `ticks` ticks in total, as they end."""
    seeds = range(first_seed, first_seed + -(-ticks // TICKS))
    with ProcessPoolExecutor(processes or os.cpu_count()) as pool:
        yield from pool.map(fly, seeds, chunksize=4)


def measure() -> Iterator[Figure]:
    """Run the million ticks of `make bench`."""
    yield from figures(list(campaign(RUN_TICKS)))


def figures(found: list[Found]) -> Iterator[Figure]:
    """Yield the figures of the flights."""
    ticks = sum(one.ticks for one in found)
    wrong = [one for one in found if one.violations]
    seeds = ", ".join(str(one.seed) for one in wrong[:8])
    yield compared("attack_ticks", TARGETS["attack_ticks"], ticks, "ticks")
    yield compared(
        "attack_violations",
        TARGETS["attack_violations"],
        sum(len(one.violations) for one in found),
        "",
        note=f"seeds {seeds}" if wrong else "",
    )
    forced = sum(one.forced for one in found) / ticks
    yield compared("attack_under_force", TARGETS["attack_under_force"], 100.0 * forced, "%")
    came: Counter[str] = Counter()
    for one in found:
        came.update(one.came)
    rarest = min((*KINDS, *TRAITS), key=lambda name: came[name])
    least = came[rarest] * max(1.0, 1e6 / ticks)
    note = f"{rarest} came {came[rarest]} times"
    yield compared("attack_rarest", TARGETS["attack_rarest"], least, "a million ticks", note=note)


def main(arguments: list[str]) -> int:
    """Run the attack; return 1 for any violation."""
    parser = argparse.ArgumentParser(description="attack the force path", allow_abbrev=False)
    parser.add_argument("--ticks", type=int, default=RUN_TICKS)
    parser.add_argument("--first-seed", type=int, default=1)
    parser.add_argument("--seed", type=int, help="this flight alone")
    parser.add_argument("--processes", type=int, default=2)
    asked = parser.parse_args(arguments)
    if asked.seed is not None:
        found = [fly(asked.seed)]
    else:
        found = list(campaign(asked.ticks, asked.first_seed, asked.processes))
    for one in found:
        for violation in one.violations:
            print(f"seed {one.seed} tick {violation.tick} {violation.rule}: {violation.text}")
    print(json.dumps([figure.plain() for figure in figures(found)], indent=1))
    return int(any(one.violations for one in found))


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
