"""Result of a step of the rig: values with intervals, findings, and changes of the device file.

A value states its 95 % interval. A finding states a problem and its remedy. A step with a finding
that is `refused` must not write anything (`settled`).
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

__all__ = ["StepResult"]

Verdict = Literal["ok", "warning", "refused", "not done"]
POSITION_HALF = 2e-3  # relative, of the encoder's scale where the file states none
FACTOR = 2.0  # ratio of a scale of the file to its measurement: a data sheet is rarely so wrong
Scalar = bool | int | float | str
Written = Scalar | tuple[Scalar, ...]  # values that a device file may contain


@dataclass(frozen=True, slots=True)
class Value:
    """A measured quantity in `unit`, and the ends of its 95 % interval.

    `name` is its key: unique in its step, and TABLE.KEY for a value of the device file. There is no
    separate label; people see the key.
    """

    name: str
    value: float
    unit: str
    low: float
    high: float

    @classmethod
    def around(cls, name: str, value: float, unit: str, half: float) -> "Value":
        """Return a quantity in the middle of its interval, whose half width is `half`."""
        return cls(name, value, unit, value - half, value + half)

    @property
    def half(self) -> float:
        """Half width of the interval."""
        return (self.high - self.low) / 2.0

    @property
    def rounded(self) -> float:
        """The value as written, with the digits that its interval allows."""
        return rounded(self.value, self.low, self.high)

    def __str__(self) -> str:
        value = f"{self.name} {self.value:.6g} {self.unit}".rstrip()
        return f"{value} (95 %: {self.low:.6g} to {self.high:.6g})"


@dataclass(frozen=True, slots=True)
class Finding:
    """A checked item in words, its verdict, and the remedy."""

    what: str
    verdict: Verdict
    remedy: str = ""


@dataclass(frozen=True, slots=True)
class Change:
    """A value of the device file and, where known, the half width of its 95 % interval. Tables that
    have the keys also record when and by which step it was measured.
    """

    table: str  # dotted if nested
    key: str
    value: Written
    half_width_95: float | None = None


@dataclass(frozen=True, slots=True)
class StepResult:
    """Result of `step`; there are no changes if a finding is refused. `arrays` are its raw data."""

    step: str
    values: Sequence[Value] = ()
    findings: Sequence[Finding] = ()
    changes: Sequence[Change] = ()
    arrays: Mapping[str, npt.NDArray[Any]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not self.settled:
            object.__setattr__(self, "changes", ())

    def __add__(self, other: "StepResult") -> "StepResult":
        """Return both together, as a result of this step."""
        return StepResult(
            self.step,
            (*self.values, *other.values),
            (*self.findings, *other.findings),
            (*self.changes, *other.changes),
            {**self.arrays, **other.arrays},
        )

    @property
    def settled(self) -> bool:
        """Whether no finding is refused."""
        return settled(self.findings)

    def plain(self) -> dict[str, Any]:
        """Return the result as JSON values, without the arrays."""
        return {
            "ok": self.settled,
            "step": self.step,
            "values": [asdict(one) for one in self.values],
            "findings": [asdict(one) for one in self.findings],
            "changes": [asdict(one) for one in self.changes],
        }


def settled(findings: Iterable[Finding]) -> bool:
    """Return whether none of the `findings` is refused."""
    return all(one.verdict != "refused" for one in findings)


def checked(what: str, good: bool, remedy: str, otherwise: Verdict = "warning") -> Finding:
    """Return a finding that is ok if `good`, and otherwise has the verdict `otherwise` and its
    `remedy`.
    """
    return Finding(what, "ok") if good else Finding(what, otherwise, remedy)


def plausible(name: str, per_count: float, scale: Mapping[str, Any], remedy: str) -> Finding:
    """Judge the signed `per_count` of channel `name`, whose scale in the hello's device is `scale`.
    `remedy` applies if the ratio is implausible: a mass in grams, another sensor.
    """
    ratio = per_count / (int(scale["sign"]) * float(scale["per_count"]))
    what = f"{name}: a count is {ratio:.4g} of the value in the device file"
    if not 1.0 / FACTOR <= abs(ratio) <= FACTOR:
        return Finding(what, "refused", remedy)
    return checked(what, ratio > 0.0, "its sign is the other one; the device file gets it")


def change_of(one: Value) -> Change:
    """Return the change of the device file for the value `one`, whose name is TABLE.KEY."""
    table, key = one.name.split(".")
    known = float(f"{one.half:.3g}") if np.isfinite(one.half) else None
    return Change(table, key, one.rounded, known)


def relative_half(scale: Mapping[str, Any], otherwise: float) -> float:
    """Return the relative half width of the 95 % interval of `scale` (of a hello's device). Return
    `otherwise` if the device file states none.
    """
    half = scale["half_width_95"]
    return otherwise if half is None else float(half) / abs(float(scale["per_count"]))


def rounded(value: float, low: float, high: float) -> float:
    """Round `value` to a hundredth of its interval; to six digits if the interval has no width."""
    width = high - low
    if not 0.0 < width < np.inf:
        return float(f"{value:.6g}")
    return round(value, 2 - int(np.floor(np.log10(width))))
