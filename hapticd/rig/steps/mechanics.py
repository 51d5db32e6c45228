"""Mechanical parameters from the balance of forces, with intervals that include its own limits.

Newtons are the mean of two scales, the probe's and the motor's, each weighted by its interval;
motion is that of the encoder. The intervals from the blocks (`result.jackknife`) are combined
with those of the scales, and with the possible errors of the balance itself.

The lag of a command, delay plus smoothing, is known directly. Its division follows from the
curvature of the command's path and from the board's clock (the lower bound of the delay). Neither
determines it exactly, so both have intervals. A smoothing that cannot be separated from delay
counts as delay, since their sum decides stability.

Limitations: two scales with the same error (nothing here contradicts them).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import hypot, isnan, pi, sqrt
from typing import NamedTuple

import numpy as np

from hapticd.core.environment import FilterParams
from hapticd.core.units import US_PER_S
from hapticd.rig.experiment import PerturbationRun
from hapticd.rig.result import Value
from hapticd.rig.steps.force_balance import NAMES, Balance

MASS_SHARE = 1e-3  # possible error of the balance itself
FRICTION_SHARE = 5e-3
SPLIT_SHARE = 0.06  # rotor against slider: friction within a sample is not resolved
LAG_US = 2.0
SKEW_SHARE = 0.05  # a late channel may smooth instead
YIELDING_SKEW_US = 10.0  # friction of the slider resembles a part of it
TOLD_US = 1.0  # resolution of the board's clock
UNKNOWN_SHARE = 0.02  # half of the interval of a scale that states none
LEAST_SMOOTHING = 0.05  # of a period: a shorter one is written as delay


@dataclass(frozen=True)
class Facts:
    """Prior knowledge of the device. `scales` are relative halves of the 95 % intervals of motor,
    probe and encoder from the device file; nan if it states none.
    """

    period_us: float
    scales: Mapping[str, float]
    filters: tuple[FilterParams, FilterParams]
    motor: Mapping[str, float | str]  # [model.motor] of the device file

    def half(self, scale: str) -> float:
        """Return the relative half width of a scale, or a default if it is unknown."""
        return UNKNOWN_SHARE if isnan(self.scales[scale]) else self.scales[scale]


class Mechanics(NamedTuple):
    """Moving mass and friction, each with its 95 % interval."""

    mass: Value  # kg
    viscous: Value  # N s/m
    coulomb: Value  # N


class CommandPath(NamedTuple):
    """Timing of a command: each in us, with its 95 % interval."""

    lag: Value
    delay: Value
    smoothing: Value  # 0: it cannot be separated from delay


def mechanics_of(found: Balance, facts: Facts) -> Mechanics:
    """Return mass and friction, in newtons of both scales and metres of the encoder."""
    handle = found.handle
    scale, scale_half = _newton(found, facts)
    motion = float(np.mean([clock.gain for clock in found.clocks]))  # encoder by velocity channel
    motion_half = facts.half("encoder")

    # the two frictions have opposite errors
    shared_n = FRICTION_SHARE * friction_n(found)
    shared = shared_n / found.speed_m_per_s

    def value(name: str, unit: str, fitted: float, own: float, moves: bool) -> Value:
        size = fitted * scale / (motion if moves else 1.0)
        half = hypot(own * scale, size * scale_half, size * motion_half if moves else 0.0)
        return Value.around(name, size, unit, half)

    total = {"mass_kg": 1.0, "slider_kg": float(handle.slider_kg > 0.0)}
    mass_half = hypot(_together(found, total), MASS_SHARE * handle.whole_kg)
    viscous_half = hypot(found.half("viscous_ns_per_m"), shared)
    coulomb_half = hypot(found.half("coulomb_n"), shared_n)
    return Mechanics(
        value("moving mass", "kg", handle.whole_kg, mass_half, True),
        value("viscous friction", "N s/m", handle.viscous_ns_per_m, viscous_half, True),
        value("Coulomb friction", "N", handle.coulomb_n, coulomb_half, False),
    )


def _together(found: Balance, slopes: Mapping[str, float]) -> float:
    """Return half of the 95 % interval of a result, from its derivatives `slopes`."""
    names = NAMES[: len(found.fit.values)]
    return found.fit.half(np.array([slopes.get(name, 0.0) for name in names]))


def resonance_of(found: Balance, mass: Value) -> list[Value]:
    """Return the slider's mass and the resonance; an empty list if all is rigid."""
    handle = found.handle
    if not handle.slider_kg:
        return []
    scale = mass.value / handle.whole_kg
    slider = scale * handle.slider_kg
    slider_half = hypot(SPLIT_SHARE * slider, scale * found.half("slider_kg"))
    hz = handle.slider_rad_s / (2.0 * pi) * sqrt(handle.whole_kg / handle.mass_kg)
    relative = {  # derivatives of its logarithm
        "mass_kg": 0.5 / handle.whole_kg - 0.5 / handle.mass_kg,
        "slider_kg": 0.5 / handle.whole_kg,
        "slider_rad_s": 1.0 / handle.slider_rad_s,
    }
    hz_half = hz * hypot(0.5 * SPLIT_SHARE, _together(found, relative))
    return [
        Value.around("sliding mass", slider, "kg", slider_half),
        Value.around("first resonance", hz, "Hz", hz_half),
    ]


def friction_n(found: Balance) -> float:
    """Return the typical friction, at the rms speed."""
    handle = found.handle
    return handle.coulomb_n + abs(handle.viscous_ns_per_m) * found.speed_m_per_s


def _newton(found: Balance, facts: Facts) -> tuple[float, float]:
    """Return the newton in units of the probe's scale, and half of its interval: the mean of two
    scales, each weighted by its interval.
    """
    probe = facts.half("probe")
    motor = facts.half("motor")
    both = hypot(probe, motor)
    if both == 0.0:
        return 1.0, 0.0
    return float(found.handle.gain ** -((probe / both) ** 2)), probe * motor / both


def path_of(found: Balance, runs: Sequence[PerturbationRun], facts: Facts) -> CommandPath:
    """Return delay and smoothing, as far as the lag can be divided."""
    handle = found.handle
    doubt = 2.0 * MASS_SHARE * handle.whole_kg / _stiffness(runs[-1]) * US_PER_S**2
    # change of the lag per error of the spread [1/us]
    lag_by_spread = found.covariance("lag_us", "spread_us2") / found.covariance(
        "spread_us2", "spread_us2"
    )
    lag_half = hypot(found.half("lag_us"), LAG_US, lag_by_spread * doubt)
    spread_half = hypot(found.half("spread_us2"), doubt)
    known = np.concatenate([run.delays_us for run in runs])
    least_us = float(np.median(known)) if known.size else 0.0  # by the board's clock
    most_us = max(0.0, handle.lag_us + lag_half - least_us)
    spread = max(0.0, handle.spread_us2)
    low, middle, high = (
        min(most_us, sqrt(max(0.0, spread + side * spread_half))) for side in (-1, 0, 1)
    )
    if low == 0.0 or middle <= LEAST_SMOOTHING * facts.period_us:
        low = middle = 0.0
    lag = Value.around("lag", handle.lag_us, "us", lag_half)
    least_us = max(least_us - TOLD_US, lag.low - high)
    return CommandPath(
        lag,
        Value("delay", handle.lag_us - middle, "us", min(least_us, lag.value), lag.high - low),
        Value("smoothing", middle, "us", low, high),
    )


def _stiffness(run: PerturbationRun) -> float:
    """Return the rendered stiffness from the slope of the command over the position [N/m], at least
    1.
    """
    x = run.position_m - run.position_m.mean()
    return max(1.0, -float(x @ run.force_n) / float(x @ x))


def channels(found: Balance) -> tuple[Value, ...]:
    gain_half = hypot(found.half("gain"), MASS_SHARE)
    skew = -found.handle.skew_us  # of the velocity's sampling, as `rig probe` has it
    doubt_us = YIELDING_SKEW_US if found.handle.slider_kg else LAG_US
    skew_half = hypot(found.half("skew_us"), doubt_us, SKEW_SHARE * skew)
    return (
        Value.around("motor by probe", found.handle.gain, "N/N", gain_half),
        Value.around("probe skew", skew, "us", skew_half),
    )
