"""The gateway counts late ticks by cause, and keeps the latest of each."""

import numpy as np

from hapticd.gateway.tick_times import TickTimes
from hapticd.mailbox.layout import TELEMETRY, LateCause

DTYPE = np.dtype([tuple(field) for field in TELEMETRY])  # type: ignore[arg-type]
MS_NS = 1_000_000
START_NS = 5 * MS_NS


def records(*late: tuple[int, int]) -> np.ndarray:
    """A record a millisecond, each with (cause, late_ns)."""
    found = np.zeros(len(late), DTYPE)
    found["time_ns"] = START_NS + MS_NS * np.arange(len(late))
    found["late_cause"], found["late_ns"] = zip(*late, strict=True)
    return found


def counts(late: TickTimes) -> dict[str, tuple[int, float]]:
    """Those that occurred."""
    rows = late.late().items()
    return {name: (one["count"], one["latest_us"]) for name, one in rows if one["count"]}


def test_each_cause_is_counted_and_has_its_latest() -> None:
    late = TickTimes(0.0, 1000.0)
    wake, bus = int(LateCause.WAKE), int(LateCause.BUS)
    late.add(records((0, 0), (wake, 2000), (wake, 7000), (bus, 3000)))
    late.add(records((0, 0), (wake, 5000)))
    assert counts(late) == {"wake": (3, 7.0), "bus": (1, 3.0)}
    assert list(late.late()) == [one.name.lower() for one in LateCause if one]


def test_grace_and_lives_before_are_left_out() -> None:
    late = TickTimes(2e-3, 1000.0)
    late.begin(START_NS)
    late.add(records(*[(int(LateCause.STEP), 1000)] * 5))
    assert counts(late) == {"step": (3, 1.0)}
    late.begin(START_NS)
    assert counts(late) == {}


def test_number_that_is_no_cause_is_left_out() -> None:
    late = TickTimes(0.0, 1000.0)
    late.add(records((77, 1000)))
    assert counts(late) == {}
