"""The tick without USB: time of the servo's own work, compared with the minimum in
Python and in C.
"""

import tempfile
from collections.abc import Iterator
from pathlib import Path

from benchmarks import targets
from benchmarks.blocks import median_quantile
from benchmarks.figures import Figure, compared, refused
from benchmarks.stand import parameter_file
from benchmarks.tick_c import compile_library
from benchmarks.worker import BenchError, Worker
from hapticd.core.units import NS_PER_US

TARGETS = targets.of("tick")
ROUNDS = 17
PACED = 600
HOT = 500
PAIRS = 200


def measure() -> Iterator[Figure]:
    """Yield all figures; quantiles of each block, medians over blocks."""
    with (
        tempfile.TemporaryDirectory(prefix="hapticd-bench-") as folder,
        parameter_file() as parameters,
    ):
        library, missing = _library(Path(folder))
        with Worker("tick_worker", [parameters, library]) as worker:
            rounds = [_round(worker) for _ in range(ROUNDS)]
            note = worker.note

    def us(name: str, fraction: float) -> float:
        return median_quantile([one[name] for one in rounds], fraction) / NS_PER_US

    for quantile, fraction in (("p50", 0.5), ("p99", 0.99)):
        name = f"tick_{quantile}_ratio"
        yield compared(
            name, TARGETS[name], us("servo", fraction), "us", us("reference", fraction), note
        )
    yield compared(
        "usb_pair_ratio", TARGETS["usb_pair_ratio"], us("pair", 0.5), "us", us("empty", 0.5), note
    )
    if missing:
        yield refused("tick_c_ratio", TARGETS["tick_c_ratio"], missing)
    else:
        yield compared(
            "tick_c_ratio",
            TARGETS["tick_c_ratio"],
            us("hot servo", 0.5),
            "us",
            us("hot c", 0.5),
            note,
        )


def _library(folder: Path) -> tuple[str, str]:
    """Return the path of the C yardstick, or the reason why there is none."""
    try:
        return compile_library(folder), ""
    except BenchError as error:
        return "", str(error)


def _round(worker: Worker) -> dict[str, list[int]]:
    """Measure one block of everything, times in ns."""
    paced = worker.ask(what="paced", ticks=PACED)
    hot = worker.ask(what="hot", ticks=HOT)
    return {
        **paced,
        **{f"hot {name}": taken for name, taken in hot.items()},
        **worker.ask(what="pairs", ticks=PAIRS),
    }
