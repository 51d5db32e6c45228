"""First days on rigs with hidden truth: coverage and width of the resulting intervals.

    blind_coverage     of all values with a known truth, those whose 95 % interval contains it, in
                       percent; a value that a rig does not reach counts as missed
    blind_least        of all quantities the one that is covered on the fewest rigs, out of 20
    blind_halfwidths   worst of median half of the interval over its target: 1 % of the force's
                       gain, 3 % of the damping's, 10 % of each friction, 0.05 periods of d
    blind_refused      broken rigs that are refused at the right step, by name, out of 7
    blind_force_share  largest force of the motors until their signs were verified, gain error
                       included, in percent of the device's limit; of all rigs

    python benchmarks/blind.py                            as `make bench ONLY=blind`
    python benchmarks/blind.py --rigs 4 --first-seed 2000 --no-broken

Seeds of the tests are below 1000.

Limitations: a step tuned to its seeds; use another first seed in case of doubt.
"""

import argparse
import sys
import time
from collections import defaultdict
from collections.abc import Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from statistics import median
from typing import NamedTuple

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from support.blind_rig import REFUSED, BlindRig, first_day

from benchmarks import targets
from benchmarks.figures import Figure, compared

TARGETS = targets.of("blind")
RIGS = 20
FIRST_SEED = 1000
BROKEN_SEED = 1500
WORKERS = 2
PERIOD_US = 1000.0
ABSOLUTE = {"link delay": 0.05 * PERIOD_US, "identify lag": 0.05 * PERIOD_US}
RELATIVE = {  # targets of half-widths, of the true value
    "motor force.full_scale_n": 0.01,
    "damping damping.full_scale_ns_per_m": 0.03,
    "identify viscous friction": 0.1,
    "identify Coulomb friction": 0.1,
}


class Seen(NamedTuple):
    """A value found on a rig, and its truth."""

    quantity: str  # step and name
    value: float
    low: float
    high: float
    true: float

    @property
    def held(self) -> bool:
        """Whether the interval contains the truth."""
        return self.low <= self.true <= self.high


class Rig(NamedTuple):
    """Result of the day on one rig."""

    seed: int
    broken: str
    seen: tuple[Seen, ...]
    ended: tuple[str, str]  # step and text of a refusal; empty if there was none
    error: str
    force_share: float
    seconds: float


def spend(seed: int, broken: str = "") -> Rig:
    """Spend a first day on the rig `seed`."""
    begin = time.perf_counter()
    with BlindRig(seed, broken or None) as rig:
        day = first_day(rig)
        seen = tuple(
            Seen(f"{result.step} {one.name}", one.value, one.low, one.high, true)
            for result in day.results
            for one in result.values
            if (true := rig.true(one.name, result.step)) is not None
        )
        share = rig.worst_share
    ended = ("", "")
    if day.refused is not None:
        step, finding = day.refused
        ended = (step, f"{finding.what}; {finding.remedy}")
    return Rig(seed, broken, seen, ended, day.error, share, time.perf_counter() - begin)


def by_name(rig: Rig) -> bool:
    """Return whether a broken rig was refused at the right step, with a text that names
    the defect.
    """
    step, word = REFUSED[rig.broken]
    return rig.ended[0] == step and word in rig.ended[1]


def by_quantity(rigs: Iterable[Rig]) -> dict[str, list[Seen]]:
    """Return the values by quantity."""
    found: dict[str, list[Seen]] = defaultdict(list)
    for rig in rigs:
        for one in rig.seen:
            found[one.quantity].append(one)
    return found


def share_of_target(quantity: str, seen: list[Seen]) -> float | None:
    """Return the median half of the interval over its target; None without one."""
    halves = [(one.high - one.low) / 2.0 for one in seen]
    if quantity in ABSOLUTE:
        return median(halves) / ABSOLUTE[quantity]
    if quantity not in RELATIVE:
        return None
    sizes = [abs(one.true) for one in seen]
    return median(h / size for h, size in zip(halves, sizes, strict=True)) / RELATIVE[quantity]


def figures(good: list[Rig], broken: list[Rig]) -> Iterator[Figure]:
    """Yield the five figures; notes name the worst cases."""
    found = by_quantity(good)
    held = {name: sum(one.held for one in seen) for name, seen in found.items()}
    expected = len(good) * len(found)
    seconds = sum(rig.seconds for rig in good) / len(good)
    unfinished = sum(bool(rig.error or rig.ended[0]) for rig in good)
    note = (
        f"{len(good)} rigs, {len(found)} quantities, {unfinished} rigs ended early,"
        f" {seconds:.0f} s a rig"
    )
    yield _figure("blind_coverage", 100.0 * sum(held.values()) / expected, "%", note)
    least = min(held, key=lambda name: held[name])
    yield _figure("blind_least", held[least] * RIGS / len(good), f"of {RIGS}", least)
    shares = {
        name: share
        for name, seen in found.items()
        if (share := share_of_target(name, seen)) is not None
    }
    told = ", ".join(f"{name} {share:.2f}" for name, share in shares.items())
    missing = [name for name in (*ABSOLUTE, *RELATIVE) if name not in shares]
    worst = float("nan") if missing else max(shares.values())
    lacking = f"; not measured: {', '.join(missing)}" if missing else ""
    yield _figure("blind_halfwidths", worst, "of target", f"{told}{lacking}")
    missed = ", ".join(rig.broken for rig in broken if not by_name(rig))
    count = sum(map(by_name, broken))
    yield _figure("blind_refused", count, f"of {len(REFUSED)}", missed and f"not refused: {missed}")
    strongest = max((*good, *broken), key=lambda rig: rig.force_share)
    words = f"seed {strongest.seed} {strongest.broken}".strip()
    yield _figure("blind_force_share", 100.0 * strongest.force_share, "%", words)


def _figure(name: str, value: float, unit: str, note: str) -> Figure:
    return compared(name, TARGETS[name], value, unit, note=note)


def spent(rigs: int, first_seed: int, with_broken: bool = True) -> tuple[list[Rig], list[Rig]]:
    """Return the days on good and on broken rigs, and print each result."""
    jobs = [(first_seed + number, "") for number in range(rigs)]
    if with_broken:
        jobs += [(BROKEN_SEED + number, name) for number, name in enumerate(REFUSED)]
    found = []
    with ProcessPoolExecutor(WORKERS) as pool:
        for done in as_completed([pool.submit(spend, *job) for job in jobs]):
            found.append(done.result())
            _tell(found[-1], len(found), len(jobs))
    found.sort(key=lambda rig: rig.seed)
    return [rig for rig in found if not rig.broken], [rig for rig in found if rig.broken]


def _tell(rig: Rig, number: int, of: int) -> None:
    """Print progress on stderr: the result of a rig, and its missed intervals."""
    words = f"{number} of {of}: rig {rig.seed} {rig.broken}, {rig.seconds:.0f} s"
    missed = [
        f"  {one.quantity} {one.value:.5g} ({one.low:.5g} to {one.high:.5g}), true {one.true:.5g}"
        for one in rig.seen
        if not one.held
    ]
    ended = [f"  {rig.ended[0]}: {rig.ended[1]}"] if rig.ended[0] else []
    error = [f"  {rig.error}"] if rig.error else []
    sys.stderr.write("\n".join([words, *missed, *ended, *error]) + "\n")


def measure() -> Iterator[Figure]:
    """Measure all of it, 20 rigs and the broken ones."""
    yield from figures(*spent(RIGS, FIRST_SEED))


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description="first days at blind rigs")
    parser.add_argument("--rigs", type=int, default=RIGS)
    parser.add_argument("--first-seed", type=int, default=FIRST_SEED)
    parser.add_argument("--no-broken", action="store_true")
    asked = parser.parse_args()
    good, broken = spent(asked.rigs, asked.first_seed, not asked.no_broken)
    for name, seen in by_quantity(good).items():
        share = share_of_target(name, seen)
        of_target = "" if share is None else f", half-width {share:.2f} of its target"
        print(f"{name}: held at {sum(one.held for one in seen)} of {len(good)}{of_target}")
    for figure in figures(good, broken):
        print(figure.name, figure.value, figure.unit, figure.ok, figure.note)


if __name__ == "__main__":
    main()
