"""Result of a step of the rig, the statistics of its values, and requests to a person at the rig.

Result (`StepResult`). It has values, findings, and changes of the device file. A value states its
95 % interval. A finding states a problem and its remedy. A step with a finding that is `refused`
must not write anything (`settled`).

Estimates (`Fit`). `least_squares` fits independent rows: the residuals give the variance, and
Student's t the interval. `separable` fits a few additional unknowns in which the columns are
nonlinear (Gauss-Newton).

Records (`jackknife`). A record is cut into blocks, each of which is left out once (Tukey 1958).
This gives deviations and correlations without assuming that residuals are white or of equal size.
An equation that holds at every sample also holds for the Fourier lines of each block (`lines`).

Limitations: residuals that are correlated over more than a block give intervals that are too
narrow.

Requests (`Request`). A step asks a person in text, and as an action with its amount. A terminal
shows the text. A program (a positioning stage, a scripted hand on a simulated rig) performs the
action. Both answer when the action is complete, or when it begins if it continues while the step
measures. Positions of a hand are metres in the direction of positive x from A, the place that the
person chooses first.

The program listens on a Unix socket (`asked_at`). Each request is one connection with one line of
JSON, {"action", "amount", "text"}; the answer is one line, {"done": true} or {"error": "why not"}.

All actions are defined here, so that all steps use the same set. A program must not answer before
the action is complete.
"""

import json
import socket
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from math import hypot, sqrt
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from hapticd.core.arrays import Floats
from hapticd.core.errors import AnalysisError, DaemonDown
from hapticd.signal.verdict import student_quantile

__all__ = ["Ask", "Request", "StepResult", "asked_at"]

# --- requests to a person -------------------------------------------------------------------------
PATIENCE_S = 120.0
Action = Literal[
    "let go",  # of the handle, and remove all attached parts
    "move",  # by about `amount` m, slowly, and hold: from now on, within a few seconds
    "hold",  # the handle `amount` m from A in the direction of positive x
    "origin",  # hold the handle where x = 0 is to be
    "hang",  # masses of `amount` kg from the handle, and let go of it
    "attach",  # `amount` kg firmly to the handle, so that they move with it, and let go of it
    "spring",  # of `amount` N/m between handle and frame, and let go
    "draw",  # the handle aside by `amount` m, and let go at once: it moves freely
    "shake",  # the handle back and forth by a few mm, for `amount` s from now on
    "warm",  # the winding to `amount` degC, and hold it there
    "one signal",  # into both probe channels, for `amount` s from now on
]


class Request(NamedTuple):
    """A requested action, and the same as text."""

    action: Action
    text: str
    amount: float = 0.0  # in the unit of the action


Ask = Callable[[Request], None]


def asked_at(path: Path) -> Ask:
    """Return a function that sends requests to the program at the socket `path`. DaemonDown if no
    program listens there, AnalysisError if it cannot perform the action.
    """

    def ask(request: Request) -> None:
        with socket.socket(socket.AF_UNIX) as line:
            line.settimeout(PATIENCE_S)
            try:
                line.connect(str(path))
                line.sendall(json.dumps(request._asdict()).encode() + b"\n")
                answer = json.loads(line.makefile("rb").readline())
            except (OSError, ValueError) as error:
                raise DaemonDown(
                    f"no hand answers at {path}: {error}; start its program, or unset HAPTICD_HAND"
                ) from error
        if not answer.get("done"):
            raise AnalysisError(f"the hand cannot {request.action}: {answer.get('error')}")

    return ask


# --- results --------------------------------------------------------------------------------------
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


# --- estimates and intervals ----------------------------------------------------------------------
UPPER_END = 0.975  # share of a distribution below the upper end of its 95 % interval
NORMAL = 1.96  # standard deviations to that end, of a normal distribution
NEXT_TO_NOTHING = 1e-12  # of the largest singular value


class Fit(NamedTuple):
    """Coefficients (p,) with their covariance (p, p) and its degrees of freedom."""

    values: Floats
    covariance: Floats
    freedom: float
    residuals: Floats  # weighted

    @property
    def sd(self) -> Floats:
        """Standard deviations (p,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def halves(self) -> Floats:
        """Halves (p,) of the 95 % intervals."""
        return quantile(self.freedom) * self.sd

    def value(self, place: int, name: str, unit: str, relative: float = 0.0) -> Value:
        """Return the coefficient at `place` as the value `name`; `relative` widens its interval."""
        size = float(self.values[place])
        return Value.around(name, size, unit, hypot(float(self.halves[place]), relative * size))

    def half(self, of: Floats) -> float:
        """Return half of the 95 % interval of the sum of `of` (p,) times the coefficients."""
        return quantile(self.freedom) * sqrt(max(0.0, float(of @ self.covariance @ of)))


def quantile(freedom: float) -> float:
    """Return the deviations to the upper end of a 95 % interval with `freedom` degrees."""
    return student_quantile(UPPER_END, freedom)


def least_squares(
    columns: Floats,
    target: Floats,
    weight: Floats | None = None,
    least: float = 0.0,
    inflate: float = 1.0,
) -> Fit:
    """Fit `columns` (n, p) to `target` (n,), each row times `weight` (n,), 1 / its standard
    deviation. The variance is that of the residuals times `inflate`, and at least `least`.
    """
    weight = np.ones(len(target)) if weight is None else weight
    rows = columns * weight[:, None]
    norm = np.linalg.norm(rows, axis=0)
    size = np.where(norm > 0.0, norm, 1.0)
    rows = rows / size
    values = np.linalg.lstsq(rows, target * weight, rcond=NEXT_TO_NOTHING)[0]
    residuals = target * weight - rows @ values
    freedom = max(len(target) - columns.shape[1], 1)
    variance = max(least, inflate * float(residuals @ residuals) / freedom)
    covariance = variance * np.linalg.pinv(rows.T @ rows) / np.outer(size, size)
    return Fit(values / size, covariance, freedom, residuals)


def separable(
    columns_of: Callable[[Floats], Floats],
    target: Floats,
    begin: Floats,
    step: float,
    rounds: int,
    weight: Floats | None = None,
) -> Fit:
    """Fit `columns_of(x)` (n, p) to `target` (n,), with nonlinear unknowns x (q,) starting at
    `begin`. Derivatives are taken over `step`. In the result, the coefficients of the columns come
    before x.
    """
    at = begin
    for _ in range(rounds):
        columns = columns_of(at)
        linear = least_squares(columns, target, weight).values
        slopes = [
            (columns_of(at + one) - columns_of(at - one)) @ linear / (2.0 * step)
            for one in step * np.eye(len(at))
        ]
        left = target - columns @ linear
        fit = least_squares(np.column_stack([columns, *slopes]), left, weight, least=1.0)
        at = at + fit.values[len(linear) :]
    return fit._replace(values=np.append(linear, at))


def line(x: Floats, y: Floats) -> Fit:
    """Fit the line y(x) to (n,) points, n at least 3: its slope, then its intercept."""
    return least_squares(np.column_stack([x, np.ones_like(x)]), y)


def mean_half(values: Floats) -> float:
    """Return half of the 95 % interval of the mean of independent `values` (n,), n at least 2."""
    return quantile(len(values) - 1) * float(values.std(ddof=1)) / sqrt(len(values))


def deviation(name: str, values: Floats, unit: str) -> Value:
    """Return the standard deviation of independent `values` (n,), as the value `name`."""
    found = float(values.std())
    return Value.around(name, found, unit, NORMAL * found / sqrt(2.0 * len(values)))


def jackknife(columns: Floats, target: Floats) -> Fit:
    """Fit `columns` (blocks, rows, p) to `target` (blocks, rows). AnalysisError if a column is all
    zero.
    """
    scale = np.sqrt((columns**2).sum(axis=(0, 1)))
    if not (scale > 0.0).all():
        raise AnalysisError(
            "nothing moved: is the perturbation connected, and stronger than friction?"
        )
    even = columns / scale
    normal = np.einsum("bri,brj->bij", even, even)
    right = np.einsum("bri,br->bi", even, target)
    whole = np.linalg.solve(normal.sum(axis=0), right.sum(axis=0))
    left = np.linalg.solve(normal.sum(axis=0) - normal, (right.sum(axis=0) - right)[..., None])
    away = left[..., 0] - left[..., 0].mean(axis=0)
    blocks = len(target)
    covariance = (blocks - 1) / blocks * (away.T @ away) / np.outer(scale, scale)
    return Fit(whole / scale, covariance, blocks - 1, target - even @ whole)


def in_blocks(values: Floats, blocks: int) -> Floats:
    """Return `values` (n, ..) as (blocks, rows, ..); a row of zeros pads a block that is a row
    shorter.
    """
    count = len(values)
    block = np.arange(count) * blocks // count
    row = np.arange(count) - np.searchsorted(block, block)
    found = np.zeros((blocks, row.max() + 1, *values.shape[1:]))
    found[block, row] = values
    return found


def lines(values: Floats, block: int, rate_hz: float, band_hz: tuple[float, float]) -> Floats:
    """Return real and imaginary parts (blocks, 2 l) of `values` (n,) at l Fourier lines of each
    block.
    """
    count = values.size // block
    parts = values[: count * block].reshape(count, block)
    window = np.hanning(block)
    f = np.fft.rfftfreq(block, 1.0 / rate_hz)
    found = np.fft.rfft((parts - parts.mean(axis=1, keepdims=True)) * window, axis=1)
    kept = found[:, (f >= band_hz[0]) & (f <= band_hz[1])]
    return np.concatenate((kept.real, kept.imag), axis=1)
