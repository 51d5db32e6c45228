"""Constants and small conversions. All values above the wire are in SI; names contain the unit."""

__all__ = [
    "COPPER_PER_K",
    "MS_PER_S",
    "NS_PER_MS",
    "NS_PER_S",
    "NS_PER_US",
    "PROBE_RATE_HZ",
    "US_PER_S",
    "percent",
    "round_half_up",
    "unit_of",
]

NS_PER_S = 1_000_000_000
MS_PER_S = 1000
US_PER_S = 1_000_000
NS_PER_US = 1_000
NS_PER_MS = 1_000_000

# relative resistance change of copper per kelvin (the paper prints "percent", and means 0.393 %/K)
COPPER_PER_K = 0.00393
PROBE_RATE_HZ = 4000  # the board's own sample clock for perturbation and probe


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
