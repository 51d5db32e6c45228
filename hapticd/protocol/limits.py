"""The range of each parameter on this device at this rate.

Command (`CommandLimits`). It is the mailbox's table under the names that clients use, with the
ranges of K, B and M narrowed for the device.

Device (`environment_limits`). The limits of K, B and M catch mistaken units. A limit is ROOM times
the end of the passive range of the device on that axis alone, with the most active damping. Without
a model of that range it is the stated number. Both stay inside VALUE_LIMITS, which the schema, the
mailbox and the servo check separately.

Limitations: a mistaken unit with a factor below ROOM is not caught.
"""

from collections.abc import Mapping, Sequence
from math import inf, isfinite
from typing import Any, NamedTuple

from hapticd.core.environment import SLOTS, WorkspaceParams, flat
from hapticd.core.errors import ConfigError
from hapticd.core.params import EnvironmentLimits, ServoParams
from hapticd.mailbox.layout import (
    COMMISSIONING_LIMITS,
    VALUE_LIMITS,
    Value,
    ValueLimit,
    value_limits,
)

__all__ = ["AXES", "PLACES", "WIDEST", "CommandLimits", "environment_limits"]

# --- limits on K, B and M -------------------------------------------------------------------------

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


# --- limits of commands ---------------------------------------------------------------------------

PLACES: dict[str, Value] = {key: Value(slot) for key, slot in SLOTS.items()} | {
    "ramp_s": Value.RAMP_S
}
# quantities of fields whose name alone is not clear
QUANTITIES = {"value": "active damping"}
SOURCES = {
    Value.ACTIVE_DAMPING: "the device file sets it",
    Value.VELOCITY_FILTER_HZ: "it is 0.45 of the servo rate",
    Value.ACCELERATION_FILTER_HZ: "it is 0.45 of the servo rate",
}
ANYWHERE = WorkspaceParams()
BOUNDED = "of this device, against mistaken units"
G_PER_KG = 1000.0
UNVERIFIED = "the signs of this device are not verified: `hapticd rig motor`"


class CommandLimit(NamedTuple):
    """Lowest and highest value with their unit, and the source of the limit."""

    low: float
    high: float
    unit: str
    source: str

    def __str__(self) -> str:
        return f"{self.low:g}..{self.high:g} {self.unit}"


class CommandLimits:
    """The limits by dotted field name.

    `bounds` are the ranges of K, B and M for the device. Without a probe, `samples_n` is unlimited.
    `value` of the damping command is the same quantity as `active_damping` of set.
    """

    def __init__(
        self,
        rate_hz: float,
        active_damping_ns_per_m: float,
        bounds: EnvironmentLimits | None = None,
        commissioning: bool = False,
        probe_n: float = inf,
        ends: WorkspaceParams = ANYWHERE,
    ) -> None:
        table = value_limits(rate_hz, active_damping_ns_per_m, commissioning)
        sources = SOURCES | dict.fromkeys(COMMISSIONING_LIMITS if commissioning else (), UNVERIFIED)
        self.of = {
            name: CommandLimit(*table[place], sources.get(place, "it is fixed in this version"))
            for name, place in PLACES.items()
        }
        self.of["value"] = self.of["active_damping"]
        self.of["samples_n"] = CommandLimit(-probe_n, probe_n, "N", "the device file sets it")
        self.of["position_m"] = CommandLimit(ends.lower_m, ends.upper_m, "m", "the workspace")
        if bounds is not None:
            self._narrow(bounds)

    def _narrow(self, bounds: EnvironmentLimits) -> None:
        for name, low, high in zip(AXES, bounds.lowest, bounds.highest, strict=True):
            known = self.of[name]
            source = known.source if known.low >= low and known.high <= high else BOUNDED
            narrower = ValueLimit(max(known.low, low), min(known.high, high), known.unit)
            self.of[name] = CommandLimit(*narrower, source)

    @classmethod
    def announced(cls, servo: ServoParams) -> "CommandLimits":
        """Return the limits of the servo with these parameters, as in the reply to `hello`."""
        device = servo.device
        return cls(
            servo.realtime.rate_hz,
            device.active_damping_limit_ns_per_m,
            device.environment_limits,
            device.commissioning,
            device.probe_limit_n,
            servo.soft_ends,
        )

    def broken_by(self, given: dict[str, Any]) -> list[dict[str, Any]]:
        """Return {loc, msg, value, unit, low, high} for each number in `given` beyond its limit.
        `given` is nested as the request. ConfigError for a name without a limit.
        """
        numbers = [(name, value) for name, value in flat(given) if isinstance(value, (int, float))]
        if unknown := [name for name, _ in numbers if name not in self.of]:
            raise ConfigError(
                f"{unknown[0]}: no limit is known of it; there are {', '.join(self.of)}"
            )
        return [
            {"loc": name, "msg": self.complaint(name, value), **self.numbers(name, value)}
            for name, value in numbers
            if not self.allows(name, value)
        ]

    def allows(self, name: str, value: float) -> bool:
        """Return whether `value` is within the limit of field `name`."""
        return self.of[name].low <= value <= self.of[name].high

    def complaint(self, name: str, value: float, where: str = "") -> str:
        """Return the message about `value` beyond the limit of field `name`."""
        limit = self.of[name]
        return (
            f"{where or QUANTITIES.get(name, name)} = {value:g} {limit.unit}: beyond the limit"
            f" {limit} ({limit.source}); {self._instead(name, value)}"
        )

    def numbers(self, name: str, value: float) -> dict[str, Any]:
        """Return the numbers for programs: {value, unit, low, high} of `value` in field `name`. A
        non-finite value becomes None, which any encoding can express.
        """
        limit = self.of[name]
        return {
            "value": float(value) if isfinite(value) else None,
            "unit": limit.unit,
            "low": limit.low,
            "high": limit.high,
        }

    def _instead(self, name: str, value: float) -> str:
        """Return what to send in place of `value`; for a mass the same number in grams, if that
        fits.
        """
        kg = value / G_PER_KG
        if name != "M" or not self.allows("M", kg):
            return "use a value within"
        return (
            f"in kg; did you mean {kg:.3f}?"
            if kg == round(kg, 3)
            else f"in kg; did you mean {kg:g}?"
        )

    def remedy(self, name: str) -> str:
        """Return the valid range of field `name` as a remedy; empty if it has no limit."""
        return (
            f"send a number in {self.of[name]}" if name in self.of and name != "wall.side" else ""
        )

    def plain(self) -> dict[str, dict[str, Any]]:
        """Return all limits as maps {low, high, unit}, by field name."""
        return {
            name: {"low": limit.low, "high": limit.high, "unit": limit.unit}
            for name, limit in self.of.items()
        }
