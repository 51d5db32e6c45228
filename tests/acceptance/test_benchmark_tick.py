"""The yardstick of a tick in C does the servo's work: same numbers, same OUT frame. A benchmark
compares nothing without that.
"""

from pathlib import Path

import pytest

from benchmarks import stand, tick_c
from benchmarks.bench_servo import read_parameters
from benchmarks.tick_worker import TickBench

pytestmark = [pytest.mark.process, pytest.mark.timeout(120)]


def test_yardstick_in_c_computes_what_the_servo_computes(tmp_path: Path) -> None:
    library = tick_c.compile_library(tmp_path)
    with stand.parameter_file() as parameters:
        bench = TickBench(*read_parameters(parameters), library)
    bench.servo.enable()
    for _ in range(3):
        assert len(bench.hot(500)["c"]) == 499  # BenchError names the first difference
