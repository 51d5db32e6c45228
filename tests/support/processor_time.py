"""Pytest plugin: the processor time of each test, with its child processes, in
build/test-times.tsv.

    python -m pytest -p support.processor_time tests/unit      (on one core: no --numprocesses)

This time determines the tier of a test (CONTRIBUTING.md); it depends less on the load of the
machine than the wall clock. `python -m support.processor_time`, in tests/, prints the table of
tests/durations.md from it.
"""

import os
import time
from collections import defaultdict
from collections.abc import Iterator
from typing import NamedTuple

import pytest

from support.tree import ROOT

FILE = ROOT / "build" / "test-times.tsv"
SLOWEST = 20


class Times(NamedTuple):
    """Seconds of one phase of a test."""

    processor_s: float
    wall_s: float


def _now() -> Times:
    used = os.times()
    processor_s = used.user + used.system + used.children_user + used.children_system
    return Times(processor_s, time.perf_counter())


def _measured(item: pytest.Item, phase: str) -> Iterator[None]:
    begin = _now()
    yield
    end = _now()
    FILE.parent.mkdir(exist_ok=True)
    with FILE.open("a") as table:
        seconds = [f"{after - before:.3f}" for before, after in zip(begin, end, strict=True)]
        print(item.nodeid, phase, *seconds, sep="\t", file=table)


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_setup(item: pytest.Item) -> Iterator[None]:
    yield from _measured(item, "setup")


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Iterator[None]:
    yield from _measured(item, "call")


def rows() -> dict[str, Times]:
    """Seconds of each test, set-up and call together."""
    found: dict[str, Times] = defaultdict(lambda: Times(0.0, 0.0))
    for line in FILE.read_text().splitlines():
        name, _, processor_s, wall_s = line.split("\t")
        before = found[name]
        found[name] = Times(before.processor_s + float(processor_s), before.wall_s + float(wall_s))
    return found


def main() -> None:
    """Print tests and seconds of each tier, then the slowest tests."""
    tiers: dict[str, list[Times]] = defaultdict(list)
    measured = rows()
    for name, times in measured.items():
        tiers[name.split("/")[1]].append(times)
    print("| tier | tests | processor s | wall s |\n|---|---|---|---|")
    for tier, times in sorted(tiers.items()):
        processor_s, wall_s = (sum(column) for column in zip(*times, strict=True))
        print(f"| {tier} | {len(times)} | {processor_s:.0f} | {wall_s:.0f} |")
    print("\n| processor s | wall s | test |\n|---|---|---|")
    for name, one in sorted(measured.items(), key=lambda pair: -pair[1].processor_s)[:SLOWEST]:
        print(f"| {one.processor_s:.1f} | {one.wall_s:.1f} | `{name.removeprefix('tests/')}` |")


if __name__ == "__main__":
    main()
