"""The guard's verdict as clients have it, and the warning about a display that is not safe.

On the wire a verdict is a map; `verdict_of` makes a `GuardVerdict` of it (docs/guard.md).
`GuardWarnings` emits one `GuardWarning` for each environment that came into force, or will, though
its verdict says that it is not safe.

What would break it: a filter that makes warnings errors; the change has then acted before the
error is raised. Whoever wants nothing unsafe to act asks for that (`Client(strict=True)`).
"""

import json
import sys
import warnings
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any

from hapticd.client.words import verdict_lines
from hapticd.errors import GuardWarning
from hapticd.explanation import Entry, Explanation, explanation_of

if TYPE_CHECKING:
    from hapticd.client.conversation import Receipt
    from hapticd.client.sequence import StepReceipt

DONE = ("applied", "scheduled", "staged")  # results of what acts, or will
FALLBACK = "ask for less of K, B and M"  # where the verdict names no number that would do


@dataclass(frozen=True, slots=True)
class GuardReading:
    """How far a display is from the edge; None where the basis does not say."""

    margin_ns_per_m: float | None = None  #: damping to spare, N s/m; negative: so much is lacking
    worst_hz: float | None = None  #: the frequency at which it is least
    radius: float | None = None  #: spectral radius of a tick; 1 or more: unstable by itself


@dataclass(frozen=True, slots=True)
class GuardVerdict:
    """What the guard says of a change."""

    safe: bool | None = None  #: of what was asked, every hand and the whole way; None: unknown
    policy: str = ""  #: by which it was judged: off, warn, clamp, refuse, follow
    basis: str = "unknown"  #: theorem, predicted, or the measurement
    margin_ns_per_m: float | None = None  #: as in GuardReading, in free space
    worst_hz: float | None = None
    radius: float | None = None
    contact: GuardReading | None = None  #: the same in the wall; None without a wall
    delay_periods: float | None = None  #: of the loop, on which it counts
    #: ends of each of K [N/m], B [N s/m] and M [kg], with the others as asked; None: nothing would
    #: do
    allowed: dict[str, list[float] | None] = field(default_factory=dict)
    least_active_damping_ns_per_m: float | None = None  #: of active damping that would do
    clamped: bool = False  #: `given` is less than what was asked
    given: dict[str, Any] = field(default_factory=dict)  #: where it leads, in the shape of a `set`
    path_points: int = 0  #: that were judged on the way
    not_covered: tuple[str, ...] = ()  #: what no verdict promises
    outcome: str = ""  #: an `explanation.Outcome`
    reasons: tuple[Entry, ...] = ()  #: what is wrong, or known
    remedies: tuple[Entry, ...] = ()  #: of which one would do
    text: str = ""  #: one sentence made of these
    cmd: str = ""  #: what was asked: set, damping, enable ...
    number: int = 0  #: by which the event with the hand refers to it
    stages: int = 0  #: in which it is done
    hand: dict[str, Any] | None = None  #: that would shake it, where it was waited for

    @property
    def worse(self) -> GuardReading:
        """The reading with less to spare: that in free space, or that in the wall."""
        free = GuardReading(self.margin_ns_per_m, self.worst_hz, self.radius)
        wall = self.contact
        if wall is None or wall.margin_ns_per_m is None or free.margin_ns_per_m is None:
            return free
        return wall if wall.margin_ns_per_m < free.margin_ns_per_m else free


_NAMES = frozenset(one.name for one in fields(GuardVerdict))


def verdict_of(plain: Mapping[str, Any] | None) -> GuardVerdict | None:
    """The verdict in the map `plain` of a reply or an event; None where there is none. Fields that
    this release does not know are left out.
    """
    if not plain:
        return None
    known = {name: value for name, value in plain.items() if name in _NAMES}
    if contact := known.get("contact"):
        known["contact"] = GuardReading(**contact)
    known["not_covered"] = tuple(known.get("not_covered", ()))
    why = explanation_of(plain)
    known |= {"reasons": why.reasons, "remedies": why.remedies}
    return GuardVerdict(**known)


class GuardWarnings:
    """Warns of what acts without being safe, once for each environment."""

    def __init__(self) -> None:
        self._warned: set[str] = set()

    def tell(self, *receipts: "Receipt | StepReceipt") -> None:
        """Emit a GuardWarning for each of `receipts` that has not had one."""
        for receipt in receipts:
            verdict = receipt.guard
            if verdict is None or verdict.safe is not False or receipt.result not in DONE:
                continue
            environment = json.dumps(verdict.given, sort_keys=True)
            if environment not in self._warned:
                self._warned.add(environment)
                warnings.warn(_warning(verdict, receipt), stacklevel=_levels_to_caller())

    def tell_beside(self, receipts: "Iterable[StepReceipt]") -> None:
        """The same where another error is raised, whose place no warning may take."""
        for receipt in receipts:
            with suppress(GuardWarning):
                self.tell(receipt)


def _warning(verdict: GuardVerdict, receipt: "Receipt | StepReceipt") -> GuardWarning:
    margin = verdict.worse.margin_ns_per_m
    lines = verdict_lines(verdict)
    spare = [] if margin is None else [f"margin {margin:.3g} N s/m"]
    why = Explanation(verdict.reasons, verdict.remedies)
    parts = why.lines("", [*spare, *lines])
    text = f"{receipt.result}, and not safe: {'; '.join(parts)}"
    return GuardWarning(text, margin, "; ".join(lines) or FALLBACK, receipt)


def _levels_to_caller() -> int:
    """`stacklevel` for the function that calls this, so that a warning names the line of the
    script.
    """
    level = 1
    frame = sys._getframe(1)
    while frame.f_back is not None and frame.f_globals["__name__"].startswith("hapticd.client"):
        frame = frame.f_back
        level += 1
    return level
