"""The delay that the guard counts on: 99 of 100 ticks of the last minute, rounded up."""

import math

import numpy as np
import pytest

from hapticd.core.units import NS_PER_S
from hapticd.guard.terms import LEAST_RECORDS, SHORTER_S, DelayHistogram
from hapticd.protocol.view import RECORD_DTYPE


def delayed_records(delay_us: "np.ndarray | list[int]", second: float = 0.0) -> np.ndarray:
    """Records of 1 kHz with these delays, from `second` on."""
    found = np.zeros(len(delay_us), RECORD_DTYPE)
    found["delay_us"] = delay_us
    found["time_ns"] = (second * NS_PER_S + 1e6 * np.arange(len(delay_us))).astype(np.int64)
    return found


@pytest.mark.parametrize(("delay_us", "periods"), [(125, 2 / 16), (126, 3 / 16), (1, 1 / 16)])
def test_delay_is_rounded_up_to_a_sixteenth_of_a_period(delay_us: int, periods: float) -> None:
    histogram = DelayHistogram(1000.0)
    histogram.add(delayed_records([delay_us] * 1000))
    assert histogram.periods == periods


def test_one_tick_in_a_hundred_may_be_later() -> None:
    histogram = DelayHistogram(1000.0)
    histogram.add(delayed_records([125] * 990 + [900] * 10))
    assert histogram.periods == 2 / 16
    histogram.add(delayed_records([900], 1.0))
    assert histogram.periods == math.ceil(0.9 * 16) / 16


def test_percentile_is_that_of_the_sorted_delays() -> None:
    delay_us = np.random.default_rng(4).integers(0, 3000, 5000)
    histogram = DelayHistogram(1000.0)
    histogram.add(delayed_records(delay_us))
    sorted_us = np.sort(delay_us)[math.ceil(0.99 * 5000) - 1]
    assert histogram.periods == math.ceil(sorted_us / 1000 * 16) / 16


def test_last_minute_counts_and_a_shorter_delay_later() -> None:
    histogram = DelayHistogram(1000.0)
    histogram.add(delayed_records([900] * 1000))
    long = math.ceil(0.9 * 16) / 16
    for second in range(1, 60 + SHORTER_S):
        histogram.add(delayed_records([125] * 1000, float(second)))
        assert histogram.periods == long, second
    histogram.add(delayed_records([125] * 1000, 60.0 + SHORTER_S))
    assert histogram.periods == 2 / 16


@pytest.mark.parametrize("pause_s", [61, 100, 119, 120, 121, 1000])
def test_what_was_before_a_long_pause_counts_no_more(pause_s: int) -> None:
    histogram = DelayHistogram(1000.0)
    histogram.add(delayed_records([900] * 1000))
    histogram.add(delayed_records([125] * 600, float(pause_s)))
    histogram.add(delayed_records([125] * 600, float(pause_s + SHORTER_S)))
    assert histogram.periods == 2 / 16


def test_longer_delay_counts_at_once() -> None:
    histogram = DelayHistogram(1000.0)
    histogram.add(delayed_records([125] * 1000))
    histogram.add(delayed_records([900] * 20, 1.0))
    assert histogram.periods == math.ceil(0.9 * 16) / 16


def test_few_or_unknown_delays_tell_nothing() -> None:
    histogram = DelayHistogram(1000.0)
    histogram.add(delayed_records([-1] * 1000))
    histogram.add(delayed_records([125] * (LEAST_RECORDS - 1)))
    assert histogram.periods is None
    histogram.add(delayed_records([125], 1.0))
    assert histogram.periods == 2 / 16
