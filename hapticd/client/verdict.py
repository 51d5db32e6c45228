"""The warning about an unsafe environment.

`GuardWarnings` emits one `GuardWarning` for each environment that is or will be in force although
its verdict is not safe.

Limitations: with a filter that turns warnings into errors, the change has acted before the error is
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
from hapticd.protocol.journal import Explanation

if TYPE_CHECKING:
    from hapticd.client.sequence import StepReceipt

DONE = ("applied", "scheduled", "staged")  # results of a change that acts, or will
FALLBACK = "ask for less of K, B and M"  # if the verdict has no sufficient value


class GuardWarnings:
    """Warns of unsafe changes that act, once for each environment."""

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
        """Warn while another error is raised, without replacing it."""
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
    """Return the `stacklevel` for the calling function, so that a warning refers to the line of the
    script.
    """
    level = 1
    frame = sys._getframe(1)
    while frame.f_back is not None and frame.f_globals["__name__"].startswith("hapticd.client"):
        frame = frame.f_back
        level += 1
    return level
