"""Constants, units in names, small conversions, and clocks.

Units (`unit_of`). All values above the wire are in SI; names contain the unit.

Clocks (`Clock`). A clock is passed to all code that waits or takes time stamps. `MonotonicClock` is
the machine's CLOCK_MONOTONIC. `VirtualClock` advances only when it is moved, so the whole stack
runs in lock-step, faster than real time and without sleeping. Readings are integer nanoseconds
since an arbitrary origin.
"""

import time
from abc import ABC, abstractmethod

__all__ = [
    "COPPER_PER_K",
    "DEFAULT_BAND_HZ",
    "NS_PER_MS",
    "NS_PER_S",
    "NS_PER_US",
    "PROBE_RATE_HZ",
    "US_PER_S",
    "Clock",
    "MonotonicClock",
    "VirtualClock",
    "percent",
    "round_half_up",
    "unit_of",
]

NS_PER_S = 1_000_000_000
US_PER_S = 1_000_000
NS_PER_US = 1_000
NS_PER_MS = 1_000_000

# relative resistance change of copper per kelvin (the paper prints "percent", and means 0.393 %/K)
COPPER_PER_K = 0.00393
PROBE_RATE_HZ = 4000  # the board's own sample clock for perturbation and probe
DEFAULT_BAND_HZ = (2.0, 500.0)  # of a prediction and of a verdict, as in Weir 2008


def round_half_up(value: float) -> int:
    """Return the count nearest to `value`, halves upwards: floor(x + 0.5), the one rounding rule of
    the wire.
    """
    return int((value + 0.5) // 1.0)


def percent(share: float) -> str:
    """Return a share, or a relative change, as text with two digits: 100 %, and never 1e+02 %."""
    value = 100.0 * share
    return f"{value:.2g} %" if abs(value) < 99.5 else f"{value:.0f} %"


UNITS = {
    "_ohm_per_s": "ohm/s",
    "_m_per_s2": "m/s^2",
    "_nm_per_a": "N m/A",
    "_ns_per_m_s": "N s/m per s",
    "_n2_per_hz": "N^2/Hz",
    "_k_per_w": "K/W",
    "_ns_per_m": "N s/m",
    "_n_per_m3": "N/m^3",
    "_n_per_m": "N/m",
    "_n_per_a": "N/A",
    "_per_k": "1/K",
    "_m_per_s": "m/s",
    "_m_per_count": "m/count",
    "_c_per_count": "degC/count",
    "_count": "counts",
    "_days": "days",
    "_hz": "Hz",
    "_rad": "rad",
    "_periods": "periods",
    "_kg": "kg",
    "_ohm": "ohm",
    "_h": "H",
    "_ns": "ns",
    "_us": "us",
    "_ms": "ms",
    "_s": "s",
    "_j": "J",
    "_n": "N",
    "_m": "m",
    "_a": "A",
    "_v": "V",
    "_c": "degC",
}  # longest first: the first matching suffix gives the unit


def unit_of(name: str) -> str:
    """Return the unit in the suffix of a field's name; empty for a pure number or a word."""
    return next((unit for suffix, unit in UNITS.items() if f"_{name}".endswith(suffix)), "")


# --- clocks ---------------------------------------------------------------------------------------


class Clock(ABC):
    """The interface of every clock."""

    @abstractmethod
    def now_ns(self) -> int:
        """Return nanoseconds since an arbitrary origin; never decreasing."""

    @abstractmethod
    def sleep_until_ns(self, deadline_ns: int) -> None:
        """Return at or after `deadline_ns`; at once if it has passed."""


class MonotonicClock(Clock):
    """The machine's clock."""

    now_ns = staticmethod(time.monotonic_ns)  # without a Python call: the tick reads it four times

    def sleep_until_ns(self, deadline_ns: int) -> None:
        wait_ns = deadline_ns - time.monotonic_ns()
        if wait_ns > 0:
            time.sleep(wait_ns / NS_PER_S)


class VirtualClock(Clock):
    """A clock that tests and lock-step runs advance."""

    def __init__(self, start_ns: int = 0) -> None:
        self.time_ns = start_ns

    def now_ns(self) -> int:
        return self.time_ns

    def sleep_until_ns(self, deadline_ns: int) -> None:
        if deadline_ns > self.time_ns:
            self.time_ns = deadline_ns
