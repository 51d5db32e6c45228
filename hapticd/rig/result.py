"""What a step of the rig found: values with their intervals, a verdict for each thing it looked at,
and what is to be written into the device file.

A value says the 95 % interval in which it lies. A finding says what is wrong and what to do about
it; a step with a finding that is `refused` writes nothing.

A step must not write if one of its findings is refused (`settled`).
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

__all__ = ["StepResult"]

Verdict = Literal["ok", "warning", "refused", "not done"]
POSITION_HALF = 2e-3  # relative, of the encoder's scale where the file states none
FACTOR = 2.0  # between a scale of the file and its measurement: a data sheet is rarely so wrong
Scalar = bool | int | float | str
Written = Scalar | tuple[Scalar, ...]  # what may stand in a device file


@dataclass(frozen=True, slots=True)
class Value:
    """A measured quantity in `unit`, and the ends of its 95 % interval.

    `name` is its key, unique in its step and TABLE.KEY for a value of the device file. It has no
    label beside that: people are shown the key.
    """

    name: str
    value: float
    unit: str
    low: float
    high: float

    @classmethod
    def around(cls, name: str, value: float, unit: str, half: float) -> "Value":
        """A quantity in the middle of its interval, of which `half` is half."""
        return cls(name, value, unit, value - half, value + half)

    @property
    def half(self) -> float:
        """Half of the interval."""
        return (self.high - self.low) / 2.0

    @property
    def rounded(self) -> float:
        """As it is written: with the digits that its interval allows."""
        return rounded(self.value, self.low, self.high)

    def __str__(self) -> str:
        value = f"{self.name} {self.value:.6g} {self.unit}".rstrip()
        return f"{value} (95 %: {self.low:.6g} to {self.high:.6g})"


@dataclass(frozen=True, slots=True)
class Finding:
    """What was looked at, in words, what is to be thought of it, and what to do."""

    what: str
    verdict: Verdict
    remedy: str = ""


@dataclass(frozen=True, slots=True)
class Change:
    """A value of the device file, and where known half of its 95 % interval; tables that have the
    keys say beside it when and by what it was measured.
    """

    table: str  # dotted, where it is a table of another
    key: str
    value: Written
    half_width_95: float | None = None


@dataclass(frozen=True, slots=True)
class StepResult:
    """What the step `step` found; there are no changes where something was refused. `arrays` are
    what it was found from.
    """

    step: str
    values: Sequence[Value] = ()
    findings: Sequence[Finding] = ()
    changes: Sequence[Change] = ()
    arrays: Mapping[str, npt.NDArray[Any]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not self.settled:
            object.__setattr__(self, "changes", ())

    def __add__(self, other: "StepResult") -> "StepResult":
        """Both together, as a result of this step."""
        return StepResult(
            self.step,
            (*self.values, *other.values),
            (*self.findings, *other.findings),
            (*self.changes, *other.changes),
            {**self.arrays, **other.arrays},
        )

    @property
    def settled(self) -> bool:
        """Whether nothing was refused."""
        return settled(self.findings)

    def plain(self) -> dict[str, Any]:
        """As JSON values, without the arrays."""
        return {
            "ok": self.settled,
            "step": self.step,
            "values": [asdict(one) for one in self.values],
            "findings": [asdict(one) for one in self.findings],
            "changes": [asdict(one) for one in self.changes],
        }


def settled(findings: Iterable[Finding]) -> bool:
    """Whether none of the `findings` is refused."""
    return all(one.verdict != "refused" for one in findings)


def checked(what: str, good: bool, remedy: str, otherwise: Verdict = "warning") -> Finding:
    """A finding that is ok where it is `good`, else `otherwise` with its `remedy`."""
    return Finding(what, "ok") if good else Finding(what, otherwise, remedy)


def plausible(name: str, per_count: float, scale: Mapping[str, Any], remedy: str) -> Finding:
    """What is to be thought of `per_count`, with its sign, of the channel `name` whose scale in a
    hello's device is `scale`; `remedy` where that cannot be meant: a mass in grams, another sensor.
    """
    ratio = per_count / (int(scale["sign"]) * float(scale["per_count"]))
    what = f"{name}: a count is {ratio:.4g} of the value in the device file"
    if not 1.0 / FACTOR <= abs(ratio) <= FACTOR:
        return Finding(what, "refused", remedy)
    return checked(what, ratio > 0.0, "its sign is the other one; the device file gets it")


def change_of(one: Value) -> Change:
    """The value `one`, whose name is TABLE.KEY, into the device file."""
    table, key = one.name.split(".")
    known = float(f"{one.half:.3g}") if np.isfinite(one.half) else None
    return Change(table, key, one.rounded, known)


def relative_half(scale: Mapping[str, Any], otherwise: float) -> float:
    """Half of the 95 % interval of the `scale` of a hello's device, relative; `otherwise` where the
    device file states none.
    """
    half = scale["half_width_95"]
    return otherwise if half is None else float(half) / abs(float(scale["per_count"]))


def rounded(value: float, low: float, high: float) -> float:
    """`value` with digits down to a hundredth of its interval; six digits if that has no width."""
    width = high - low
    if not 0.0 < width < np.inf:
        return float(f"{value:.6g}")
    return round(value, 2 - int(np.floor(np.log10(width))))
