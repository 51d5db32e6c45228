"""cyclictest of rt-tests, the standard measure of wake-up latency for a C program on this machine.
wakes.c counts late wakes if it is missing.
"""

import re
import shutil
import subprocess
from functools import cache
from pathlib import Path

from benchmarks.worker import PRIORITY, ROOT, BenchError, servo_core

LONGEST_NS = 500_000  # later wakes count as this late
REMEDY = (
    "`make deps` installs the tool (rt-tests), and SCHED_FIFO must be allowed (root, or"
    " LimitRTPRIO)"
)


def latencies_ns(samples: int, period_us: int) -> list[int]:
    """Return wake-up latencies of `samples` periods at the servo's priority and core. BenchError
    without tool or rights.
    """
    text = _run(samples, period_us, ["-N", "-h", str(LONGEST_NS)], servo_core())
    counted = [
        line.split()
        for line in text.splitlines()
        if line[:1].isdigit() and not line.endswith(" 000000")
    ]
    found = [int(bucket) for bucket, count in counted for _ in range(int(count))]
    return found + [LONGEST_NS] * _overflows(text)


def wakes_beyond_period(samples: int, period_us: int, core: int) -> int:
    """Return how many of `samples` wakes on that core were at least a period late."""
    if shutil.which("cyclictest") is None:
        return _own_wakes(samples, period_us, core)
    return _overflows(_run(samples, period_us, ["-h", str(period_us)], core))


def prepare() -> None:
    """Compile the counter of wakes in advance, so that no compiler disturbs a measurement."""
    if shutil.which("cyclictest") is None:
        _own_program()


def _own_wakes(samples: int, period_us: int, core: int) -> int:
    words = [str(_own_program()), *map(str, (PRIORITY, core, period_us, samples))]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    if done.returncode:
        raise BenchError(f"{done.stderr.strip()}: {REMEDY}")
    return int(done.stdout)


@cache
def _own_program() -> Path:
    """Return wakes.c compiled into build. BenchError without a compiler."""
    compiler = shutil.which("cc")
    if compiler is None:
        raise BenchError(f"neither cyclictest nor a C compiler: {REMEDY}")
    program = ROOT / "build" / "wakes"
    program.parent.mkdir(exist_ok=True)
    command = [compiler, "-O2", "-o", str(program), str(Path(__file__).with_name("wakes.c"))]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise BenchError(f"wakes.c: {done.stderr.strip()}")
    return program


def _overflows(text: str) -> int:
    return sum(int(item) for item in re.findall(r"Histogram Overflows: (\d+)", text))


def _run(samples: int, period_us: int, options: list[str], core: int) -> str:
    if shutil.which("cyclictest") is None:
        raise BenchError(f"cyclictest is missing: {REMEDY}")
    command = [
        "cyclictest",
        "-m",
        "-q",
        "-t",
        "1",
        "-p",
        str(PRIORITY),
        "-a",
        str(core),
        "-i",
        str(period_us),
    ]
    done = subprocess.run(
        [*command, "-l", str(samples), *options], capture_output=True, text=True, check=False
    )
    if done.returncode or "# Total:" not in done.stdout:
        said = (done.stderr.strip().splitlines() or ["no message"])[-1]
        raise BenchError(f"cyclictest ended with code {done.returncode} ({said}): {REMEDY}")
    return done.stdout
