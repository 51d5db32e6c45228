"""Late ticks at 1, 2, 4 and 8 kHz, including the board's simulation, compared with late wakes of
cyclictest.

    python benchmarks/late.py                        four minutes; a row for each rate
    python benchmarks/late.py --python PATH          the same by two interpreters in turns: this one
                                                     and another of the same X.Y; nine minutes
    python benchmarks/late.py --share 0.1            a tenth of the periods

Both run at the same time and priority on two cores that they exchange after each block, so that a
pause of the machine affects both alike. On one core they take turns. A tick is late if it ends
beyond the next deadline, a wake if it comes a whole period late. The test decides whether the
servo's rate may equal cyclictest's: Fisher's exact test (Fisher 1935), one-sided. Each late tick
has its cause (`LateCause`; LAST: the last one of a piece, whose cause is in no record). The targets
above 2 kHz are those of an interpreter with profile-guided optimisation.

Limitations: a block so short that one pause of the machine decides it.
"""

import argparse
import os
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks import cyclictest, targets
from benchmarks.figures import Figure, compared
from benchmarks.stand import parameter_file
from benchmarks.worker import BenchError, Worker
from hapticd.core.units import US_PER_S

RATES_HZ = (1000, 2000, 4000, 8000)
UNOPTIMISED_HZ = 2000  # highest rate with a target for every build
# of each, in total
PERIODS = 120_000
BLOCKS = 6
TARGETS = targets.of("late")


@dataclass
class Count:
    """Result of one interpreter at one rate, and of cyclictest."""

    rate_hz: int
    build: str = ""
    optimised: bool = True
    periods: int = 0
    late: Counter[str] = field(default_factory=Counter)
    late_wakes: int = 0
    refusals: str = ""

    @property
    def p(self) -> float:
        """Probability of at least as many late ticks at cyclictest's rate."""
        return fisher_p(self.late.total(), self.periods, self.late_wakes, self.periods)

    @property
    def causes(self) -> str:
        """The late ticks by cause."""
        return ", ".join(f"{cause} {count}" for cause, count in self.late.most_common()) or "none"


def measure() -> Iterator[Figure]:
    """Yield one count for each rate; the reference is cyclictest's in as many periods. Then yield
    the highest rate that passed.
    """
    free_hz = 0
    side = "on two cores in turns" if len(_cores()) > 1 else "one after the other"
    for name, rate_hz in zip(TARGETS, RATES_HZ, strict=False):
        (count,) = counted(rate_hz, [sys.executable])
        held = count.optimised or rate_hz <= UNOPTIMISED_HZ
        said = (f"in {count.periods} periods each, {side}", f"late: {count.causes}", count.refusals)
        note = "; ".join(filter(None, said))
        target = TARGETS[name] if held else ""
        yield compared(name, target, count.late.total(), "ticks", count.late_wakes, note, p=count.p)
        free_hz = rate_hz if count.p >= 0.01 else free_hz
    yield compared("late_free_hz", TARGETS["late_free_hz"], free_hz, "Hz", note=count.build)


def counted(rate_hz: int, pythons: Sequence[str], share: float = 1.0) -> list[Count]:
    """Return the count of each interpreter at `rate_hz`, in turns, over that share of PERIODS."""
    cores = _cores()
    cyclictest.prepare()
    ticks = round(share * PERIODS / BLOCKS)
    counts = [Count(rate_hz) for _ in pythons]
    with ExitStack() as stack:
        workers = [[_worker(stack, rate_hz, core, one) for core in cores] for one in pythons]
        for turn in range(BLOCKS):
            for count, mine in zip(counts, workers, strict=True):
                _block(count, mine[turn % len(cores)], cores[turn % len(cores) - 1], ticks)
    return counts


def fisher_p(ours: int, ours_of: int, theirs: int, theirs_of: int) -> float:
    """Return the probability of `ours` events or more in `ours_of` if both have one rate and
    `theirs` occurred in `theirs_of` (Fisher 1935).

    BenchError without scipy.
    """
    try:
        from scipy.stats import fisher_exact
    except ImportError as error:
        raise BenchError(f"{error}: `make bench` installs it") from error
    table = [[ours, ours_of - ours], [theirs, theirs_of - theirs]]
    return float(fisher_exact(table, alternative="greater").pvalue)


def _cores() -> list[int]:
    return sorted(os.sched_getaffinity(0))[-2:]


def _worker(stack: ExitStack, rate_hz: int, core: int, python: str) -> Worker:
    parameters = stack.enter_context(parameter_file(rate_hz, core))
    return stack.enter_context(Worker("late_worker", [parameters], python))


def _block(count: Count, worker: Worker, other_core: int, ticks: int) -> None:
    """Add late ticks and late wakes of `ticks` periods each."""
    with ThreadPoolExecutor(1) as other:
        period_us = US_PER_S // count.rate_hz
        wakes = other.submit(cyclictest.wakes_beyond_period, ticks, period_us, other_core)
        if len(_cores()) == 1:
            wakes.result()
        answer = worker.ask(ticks=ticks)
        count.late_wakes += wakes.result()
    count.late.update(answer["late"])
    count.build, count.optimised = answer["build"]
    count.periods += ticks
    count.refusals = worker.note


def main(arguments: list[str]) -> int:
    """Print a row for each rate and interpreter."""
    parser = argparse.ArgumentParser(description="late ticks compared with cyclictest")
    parser.add_argument("--python", help="another interpreter, which takes turns with this one")
    parser.add_argument("--share", type=float, default=1.0, help="of the periods")
    asked = parser.parse_args(arguments)
    pythons = [sys.executable, *filter(None, [asked.python])]
    for rate_hz in RATES_HZ:
        for count in counted(rate_hz, pythons, asked.share):
            print(
                f"{rate_hz} Hz, {count.build}: {count.late.total()} of {count.periods} ticks late"
                f" ({count.causes}), {count.late_wakes} wakes; p = {count.p:.3g}",
                count.refusals,
                flush=True,
            )
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
