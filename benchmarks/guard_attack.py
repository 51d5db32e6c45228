"""The guard attacked: random requests under refuse, clamp and follow, judged independently.

    guard_unsafe          distinct environments in force that are unstable without a hand, in a few
                          dozen hands, or in the hand that destabilises the point 5 % further out
    guard_flown           of 200 sequences through gateway, servo and board, in a hand that would
                          destabilise the point 5 % further out and with a person who moves, those
                          with an instability, an energy gain or a fault
    guard_false_refusals  of the requests whose 5 %-further point no hand destabilises, the refused
                          share, in percent

    python benchmarks/guard_attack.py                     as `make bench`
    python benchmarks/guard_attack.py --sequences 100 --first-seed 5000

Two devices: the shipped simulated display, and the calibrated one of Weir et al. 2008 with its
smoothing and lags, without friction. The delay passed to the guard is the true one, or for every
fourth sequence a larger one, like a p99 of a busy host.

Limitations: a device whose numbers here differ from those of its file (a test compares them).
"""

import argparse
import json
import os
import sys
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from support.whole_tick import Display, Point

from benchmarks import targets
from benchmarks.figures import Figure, compared
from benchmarks.guard_flown import Flight, flown
from benchmarks.guard_requests import Answering, Asked, fly
from benchmarks.guard_verdict import FURTHER, Bench, grows
from hapticd.core.params import ServoParams, from_plain
from hapticd.guard.judge import Judge
from hapticd.mailbox import files
from hapticd.model.bases import model_of
from hapticd.model.params import GuardSetup
from hapticd.run.supervisor import resolve
from hapticd.settings.build import servo_params
from hapticd.settings.load import Override, load
from hapticd.settings.toml import shipped

TARGETS = targets.of("guard_attack")
SEQUENCES = 2000
FLIGHTS = 200
CHUNK = 40  # sequences judged together
LARGER_PERIODS = 1.0  # delay passed to the guard in every fourth sequence
WEIR_EVERY = 5  # one sequence in WEIR_EVERY is on the calibrated display
WEIR_JUDGED = 10  # one point in WEIR_JUDGED is judged there: it costs ten times as much
SHIPPED = Display(rotor_kg=0.008, rotor_ns_per_m=0.36, delay_periods=0.125)
WEIR = Display(
    rotor_kg=0.0055,
    rotor_ns_per_m=0.2191,
    delay_periods=0.125,
    slider_kg=0.0025,
    slider_ns_per_m=0.1461,
    coupling_n_per_m=4.0e4,
    coupling_ns_per_m=2.0,
    smoothing_hz=31.6,
    amplifier_hz=5000.0,
    estimate_hz=1000.0,
    level_gain=1.05820105820105820,
    residual_m_per_s_n=1.6 * 0.00393 * (33.67318885086722 - 20.0) / 1.6492422502470644**2,
)


class Device(NamedTuple):
    """A device under attack."""

    params: ServoParams
    judge: Judge
    bench: Bench


class Found(NamedTuple):
    """Result of several sequences."""

    points: int  # judged points
    unsafe: list[tuple[int, Point]]  # with the seed
    safe_further: int  # requests whose 5 %-further point no hand destabilises
    refused: list[Asked]  # the refused ones of them
    actions: Counter[str]


@lru_cache(maxsize=2)
def device(name: str = "simulated") -> Device:
    """Return the shipped device of that name, and its guard."""
    asked = Override(("device",), name, "benchmark")
    stand = load(shipped("config") / "hapticd.toml", (asked,))
    setup = from_plain(GuardSetup, resolve(stand, "guard")[files.GUARD_JSON])
    assert setup.model is not None
    known = WEIR if name == "weir2008" else SHIPPED
    return Device(servo_params(stand, "guard"), Judge(setup), Bench(known, model_of(setup.model)))


def shipped_judge() -> Judge:
    """Return the judge of the shipped simulated display."""
    return device().judge


def attack(seeds: Sequence[int], judge: Answering | None = None) -> Found:
    """Fly the sequences of `seeds`, all on one device, under its guard, or `judge`, and judge them
    together.
    """
    weir = _on_weir(seeds[0])
    where = device("weir2008" if weir else "simulated")
    guard = judge or where.judge.answer
    flown = [(seed, fly(seed, guard, where.params, _told(seed))) for seed in seeds]
    thinned = WEIR_JUDGED if weir else 1
    came = {point: seed for seed, one in flown for point in one.points[::thinned]}
    ends = {point: seed for seed, one in flown for point in one.ends}
    unsafe = where.bench.unsafe(list(came), list(ends))
    seen = came | ends
    # a refusal for the larger delay is not a false one
    true = [each for seed, each in flown if _told(seed) is None]
    asked = [one for each in true for one in each.asked if not one.enable]
    shaken = _shaken(where.bench, asked)
    safe = [one for one, rings in zip(asked, shaken, strict=True) if not rings]
    return Found(
        len(seen),
        sorted((seen[point], point) for point in set(unsafe)),
        len(safe),
        [one for one in safe if one.action == "refuse"],
        Counter(f"{one.policy} {one.action}" for _, each in flown for one in each.asked),
    )


def fly_one(seed: int) -> Flight:
    """Return the flight of `seed` on the shipped display."""
    where = device()
    return flown(seed, where.judge.answer, where.bench)


def _on_weir(seed: int) -> bool:
    return seed % WEIR_EVERY == WEIR_EVERY - 1


def _told(seed: int) -> float | None:
    """Return the delay passed to the guard, in periods; None: that of its model."""
    return LARGER_PERIODS if seed % 4 == 1 else None


def chunks(sequences: int, first: int) -> list[list[int]]:
    """Return seeds in groups on one device each."""
    seeds = range(first, first + sequences)
    kinds = ([seed for seed in seeds if _on_weir(seed) is weir] for weir in (False, True))
    return [kind[place : place + CHUNK] for kind in kinds for place in range(0, len(kind), CHUNK)]


def _shaken(bench: Bench, asked: list[Asked]) -> list[bool]:
    """Return whether some hand destabilises each request 5 % further out, free or in its wall."""
    further = [
        [point.scaled(FURTHER) for point in (one.point, one.contact) if point is not None]
        for one in asked
    ]
    flat = [point for points in further for point in points]
    worst = bench.worst(flat) if flat else ()
    quick = {point: grows(point, found) for point, found in zip(flat, worst, strict=True)}
    return [
        any(quick[point] or (one.action == "refuse" and bench.shaken(point)) for point in points)
        for one, points in zip(asked, further, strict=True)
    ]


def measure(sequences: int = SEQUENCES, first: int = 0, flights: int = FLIGHTS) -> Iterator[Figure]:
    """Yield all figures."""
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        found = list(pool.map(attack, chunks(sequences, first)))
    unsafe = [one for each in found for one in each.unsafe]
    actions: Counter[str] = sum((one.actions for one in found), Counter())
    counts = ", ".join(f"{count} {name}" for name, count in sorted(actions.items()))
    where = "".join(f"; seed {seed}: {point}" for seed, point in unsafe[:5])
    yield compared(
        "guard_unsafe",
        TARGETS["guard_unsafe"],
        float(len(unsafe)),
        "",
        note=f"of {sum(one.points for one in found)} environments in force ({counts}){where}",
    )
    yield _flown(flights, first)
    safe = sum(one.safe_further for one in found)
    refused = [one for each in found for one in each.refused]
    where = "; ".join(f"seed {one.seed}: {one.text}" for one in refused[:3])
    yield compared(
        "guard_false_refusals",
        TARGETS["guard_false_refusals"],
        100.0 * len(refused) / max(1, safe),
        "%",
        note=f"{len(refused)} of {safe} requests; {where}",
    )


def _flown(flights: int, first: int) -> Figure:
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        found = list(pool.map(fly_one, range(first, first + flights)))
    wrong = [one for one in found if one.wrong]
    where = "".join(f"; seed {one.seed}: {', '.join(one.wrong)}" for one in wrong[:5])
    points = sum(one.points for one in found)
    return compared(
        "guard_flown",
        TARGETS["guard_flown"],
        float(len(wrong)),
        "",
        note=f"of {len(found)} flights with {points} environments in force{where}",
    )


def main() -> None:
    """Run the attack alone."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--sequences", type=int, default=SEQUENCES)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--flights", type=int, default=FLIGHTS)
    asked = parser.parse_args()
    started_s = time.monotonic()
    for figure in measure(asked.sequences, asked.first_seed, asked.flights):
        print(json.dumps(figure.plain(), indent=1))
    print(f"{time.monotonic() - started_s:.0f} s")


if __name__ == "__main__":
    main()
