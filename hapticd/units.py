"""Constants and small conversions. SI everywhere above the wire; names carry the unit."""

NS_PER_S = 1_000_000_000
US_PER_S = 1_000_000
NS_PER_US = 1_000
NS_PER_MS = 1_000_000

ZERO_CELSIUS_K = 273.15
COPPER_PER_K = (
    0.00393  # relative resistance change of copper per kelvin (the paper prints "percent"; 0.393 %/K is meant)
)
PROBE_RATE_HZ = 4000  # the board's own sample clock for perturbation and probe


def round_half_up(value: float) -> int:
    """Count nearest to `value`, halves upwards: floor(x + 0.5), the one rounding rule of the wire."""
    return int((value + 0.5) // 1.0)
