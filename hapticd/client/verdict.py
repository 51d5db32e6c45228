"""The warning about a display that is not safe.

`GuardWarnings` emits one `GuardWarning` for each environment that came into force, or will, though
its verdict says that it is not safe.

Limitations: a filter that makes warnings errors; the change has then acted before the error is
raised. With `Client(strict=True)` no unsafe change acts.
"""

import json
import sys
import warnings
from collections.abc import Iterable
from contextlib import suppress
from typing import TYPE_CHECKING

from hapticd.client.formatting import verdict_lines
from hapticd.core.errors import GuardWarning
from hapticd.protocol.answers import GuardVerdict, Receipt
from hapticd.protocol.explanation import Explanation

if TYPE_CHECKING:
    from hapticd.client.sequence import StepReceipt

DONE = ("applied", "scheduled", "staged")  # results of what acts, or will
FALLBACK = "ask for less of K, B and M"  # where the verdict names no number that would do


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
