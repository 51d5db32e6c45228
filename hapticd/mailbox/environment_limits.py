"""Limits on the K, B and M that a client may request of a device: they catch mistaken units.

A limit is ROOM times the end of the passive range of the device on that axis alone, with the most
active damping. Without a model of that range it is the stated number. Both stay inside
VALUE_LIMITS, which the schema, the mailbox and the servo check separately.

Limitations: a mistaken unit with a factor below ROOM is not caught.
"""

from collections.abc import Mapping, Sequence

from hapticd.core.params import EnvironmentLimits
from hapticd.mailbox.layout import VALUE_LIMITS, Value, ValueLimit

__all__ = ["AXES", "UNKNOWN", "WIDEST", "environment_limits"]

ROOM = 10.0
AXES = {"K": Value.STIFFNESS, "B": Value.VIRTUAL_DAMPING, "M": Value.MASS}
# for an unknown or empty passive range: at least three times the passive range of any shipped
# device
STATED: dict[str, ValueLimit] = {
    "K": ValueLimit(-1e3, 5e4, "N/m"),
    "B": ValueLimit(-5e1, 2e2, "N s/m"),
    "M": ValueLimit(-0.5, 1.0, "kg"),
}
WIDEST = EnvironmentLimits(
    tuple(VALUE_LIMITS[place].low for place in AXES.values()),
    tuple(VALUE_LIMITS[place].high for place in AXES.values()),
)
UNKNOWN: Mapping[str, Sequence[float] | None] = {}


def environment_limits(passive: Mapping[str, Sequence[float] | None]) -> EnvironmentLimits:
    """Return the limits of a device whose passive range on each axis is `passive` [SI], from and
    to. The range of an axis that is missing or None is unknown.
    """
    ends = [_ends(axis, passive.get(axis) or (0.0, 0.0)) for axis in AXES]
    return EnvironmentLimits(tuple(low for low, _ in ends), tuple(high for _, high in ends))


def _ends(axis: str, passive: Sequence[float]) -> tuple[float, float]:
    stated = STATED[axis]
    widest = VALUE_LIMITS[AXES[axis]]
    low = ROOM * passive[0] if passive[0] < 0.0 else stated.low
    high = ROOM * passive[1] if passive[1] > 0.0 else stated.high
    return max(_shown(low), widest.low), min(_shown(high), widest.high)


def _shown(limit: float) -> float:
    """Round to the digits of messages, so that the displayed limit is the enforced one."""
    return float(f"{limit:.3g}")
