"""Late ticks at 1, 2, 4 and 8 kHz, the board's simulation included, beside the wakes that cyclictest gets too late."""

from collections.abc import Iterator

from benchmarks import cyclictest
from benchmarks.figures import Figure, compared
from benchmarks.stand import parameter_file
from benchmarks.worker import Worker
from hapticd.units import US_PER_S

RATES_HZ = (1000, 2000, 4000, 8000)
BLOCKS, BLOCK_S = 6, 4
OF_CYCLICTEST, EVENTS, OF_TICKS = 1.5, 2, 0.0002
RULE = f"<= {OF_CYCLICTEST} of cyclictest's + {EVENTS} + {OF_TICKS * 100:g} % of the ticks"
TARGETS = {f"late_{rate_hz // 1000}khz": RULE for rate_hz in RATES_HZ}


def measure() -> Iterator[Figure]:
    """One count for each rate; the reference is what is allowed."""
    for name, rate_hz in zip(TARGETS, RATES_HZ, strict=True):
        ticks, ours, theirs = BLOCK_S * rate_hz, 0, 0
        with parameter_file(rate_hz) as parameters, Worker("late_worker", [parameters]) as worker:
            for _ in range(BLOCKS):
                theirs += cyclictest.wakes_beyond_period(ticks, US_PER_S // rate_hz)
                ours += worker.ask(ticks=ticks)
            refusals = worker.note
        allowed = OF_CYCLICTEST * theirs + EVENTS + OF_TICKS * BLOCKS * ticks
        note = "; ".join(filter(None, (f"{theirs} late wakes of cyclictest in {BLOCKS * ticks}", refusals)))
        yield compared(name, f"<= {allowed:.1f}", ours, "ticks", allowed, note)
