"""Late ticks at 1, 2, 4 and 8 kHz, the board's simulation included, beside the wakes that
cyclictest gets too late.

Both run at the same time and priority on two cores that they change after each block, so that a
pause of the machine meets both alike; on one core they take turns. Late is a tick that ends beyond
the next deadline, and a wake that comes a whole period late. Judged is whether the servo's rate may
be cyclictest's: Fisher's exact test (Fisher 1935), one-sided. What would break it: a block so short
that one pause of the machine decides it.
"""

import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack

from benchmarks import cyclictest, targets
from benchmarks.figures import Figure, compared
from benchmarks.stand import parameter_file
from benchmarks.worker import BenchError, Worker
from hapticd.core.units import US_PER_S

RATES_HZ = (1000, 2000, 4000, 8000)
# of each, in all
PERIODS = 120_000
BLOCKS = 6
TARGETS = targets.of("late")


def measure() -> Iterator[Figure]:
    """One count for each rate; the reference is cyclictest's in as many periods."""
    cores = sorted(os.sched_getaffinity(0))[-2:]
    for name, rate_hz in zip(TARGETS, RATES_HZ, strict=True):
        with ExitStack() as stack:
            workers = [_worker(stack, rate_hz, core) for core in cores]
            counts = [_block(workers, cores, turn, rate_hz) for turn in range(BLOCKS)]
            refusals = workers[0].note
        ours, theirs = (sum(column) for column in zip(*counts, strict=True))
        side = "on two cores in turns" if len(cores) > 1 else "one after the other"
        note = "; ".join(filter(None, (f"in {PERIODS} periods each, {side}", refusals)))
        p = fisher_p(ours, PERIODS, theirs, PERIODS)
        yield compared(name, TARGETS[name], ours, "ticks", theirs, note, p=p)


def fisher_p(ours: int, ours_of: int, theirs: int, theirs_of: int) -> float:
    """Probability of `ours` events or more in `ours_of` if both have one rate and `theirs` came in
    `theirs_of` (Fisher 1935).

    BenchError without scipy.
    """
    try:
        from scipy.stats import fisher_exact
    except ImportError as error:
        raise BenchError(f"{error}: `make bench` installs it") from error
    table = [[ours, ours_of - ours], [theirs, theirs_of - theirs]]
    return float(fisher_exact(table, alternative="greater").pvalue)


def _worker(stack: ExitStack, rate_hz: int, core: int) -> Worker:
    return stack.enter_context(
        Worker("late_worker", [stack.enter_context(parameter_file(rate_hz, core))])
    )


def _block(workers: list[Worker], cores: list[int], turn: int, rate_hz: int) -> tuple[int, int]:
    """Late ticks and late wakes in PERIODS / BLOCKS periods each."""
    ticks = PERIODS // BLOCKS
    place = turn % len(cores)
    with ThreadPoolExecutor(1) as other:
        wakes = other.submit(
            cyclictest.wakes_beyond_period, ticks, US_PER_S // rate_hz, cores[place - 1]
        )
        if len(cores) == 1:
            wakes.result()
        return workers[place].ask(ticks=ticks), wakes.result()
