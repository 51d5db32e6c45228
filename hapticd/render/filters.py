"""Second-order low-pass filters for the differentiated position.

Continuous prototype H(s) = w^2 / (s^2 + 2 zeta w s + w^2); zeta = 1/sqrt(2) is Butterworth. The
paper (Weir, Colgate and Peshkin 2008, section 2) states "100 Hertz second order digital filter" for
velocity and 72 Hz for acceleration. It states neither damping ratio nor mapping, so both are
parameters. A filter is five numbers (b0, b1, b2, a1, a2) of y = b0 u + z1; z1' = b1 u - a1 y + z2;
z2' = b2 u - a2 y (transposed direct form II), gain 1 at DC.

A corner must be below half the rate (refused otherwise), and the rate must be the tick's.
Coefficients must not be swapped under force: the force would jump now or swell for seconds.
"""

import math

from hapticd.core.errors import ConfigError

__all__ = ["Biquad", "design", "scaled", "steady"]

Biquad = tuple[float, float, float, float, float]
MAPPINGS = ("prewarped", "bilinear", "matched")


def design(frequency_hz: float, damping_ratio: float, mapping: str, rate_hz: float) -> Biquad:
    """Return the coefficients of a second-order low-pass.

    `mapping`: "prewarped" bilinear (-3 dB point kept), plain "bilinear", or "matched" poles without
    zeros. ConfigError if the corner is not inside 0..rate/2, the damping ratio not positive, or the
    mapping unknown.
    """
    if not 0.0 < frequency_hz < 0.5 * rate_hz:
        raise ConfigError(
            f"filter corner {frequency_hz} Hz: must lie between 0 and {0.5 * rate_hz} Hz, half the"
            " servo rate"
        )
    if not 0.0 < damping_ratio < 100.0:
        raise ConfigError(
            f"filter damping ratio {damping_ratio}: must lie between 0 and 100; 0.7071 is"
            " Butterworth"
        )
    if mapping == "matched":
        return _matched(2.0 * math.pi * frequency_hz / rate_hz, damping_ratio)
    if mapping not in MAPPINGS:
        raise ConfigError(f"filter mapping {mapping!r}: use one of {', '.join(MAPPINGS)}")
    angle = math.pi * frequency_hz / rate_hz
    return _bilinear(math.tan(angle) if mapping == "prewarped" else angle, damping_ratio)


def _bilinear(k: float, zeta: float) -> Biquad:
    scale = 1.0 / (1.0 + 2.0 * zeta * k + k * k)
    b0 = k * k * scale
    return b0, 2.0 * b0, b0, 2.0 * (k * k - 1.0) * scale, (1.0 - 2.0 * zeta * k + k * k) * scale


def _matched(angle: float, zeta: float) -> Biquad:
    radius = math.exp(-zeta * angle)
    spread = angle * math.sqrt(abs(1.0 - zeta * zeta))
    a1 = -2.0 * radius * (math.cos(spread) if zeta <= 1.0 else math.cosh(spread))
    a2 = radius * radius
    return 1.0 + a1 + a2, 0.0, 0.0, a1, a2


def scaled(biquad: Biquad, gain: float) -> Biquad:
    """Return the filter with DC gain `gain`; with the rate as gain, it gives derivatives."""
    b0, b1, b2, a1, a2 = biquad
    return gain * b0, gain * b1, gain * b2, a1, a2


def steady(biquad: Biquad, y: float) -> tuple[float, float]:
    """Return the steady state of a filter with constant output `y`."""
    b0, b1, b2, a1, a2 = biquad
    u = y * (1.0 + a1 + a2) / (b0 + b1 + b2)
    return y - b0 * u, b2 * u - a2 * y
