"""The explanation of a verdict: an outcome, typed reasons and remedies, and the sentence made of
them.

Programs read the codes. The texts are for users: reasons follow each other, remedies are
alternatives and are joined by "or".
"""

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import Any

__all__ = ["Explanation", "Outcome", "Reason", "Remedy", "because", "explanation_of"]


class Outcome(StrEnum):
    """The outcome of a change, or the judgement of an environment."""

    SAFE = "safe"
    UNSAFE = "unsafe"
    SAFER = "safer"  # not safe, but safer than the environment in force
    WARNING = "warning"  # not safe, but applied
    CLAMPED = "clamped"
    FOLLOWED = "followed"
    REFUSED = "refused"
    UNKNOWN = "unknown"
    NOT_JUDGED = "not_judged"


class Reason(StrEnum):
    """Codes of reasons."""

    SPARE = "spare"
    SHORT = "short"
    UNSTABLE = "unstable"
    NEGATIVE_STIFFNESS = "negative_stiffness"
    INSIDE = "inside"
    OUTSIDE = "outside"
    TOO_MANY_POINTS = "too_many_points"
    ONLY_IN_STAGES = "only_in_stages"
    SAFER = "safer"
    GIVEN = "given"
    NOT_CLAMPED = "not_clamped"
    NOT_FOLLOWED = "not_followed"
    POLICY = "policy"
    UNKNOWN = "unknown"


class Remedy(StrEnum):
    """Codes of remedies."""

    LESS = "less"
    MORE_DAMPING = "more_damping"
    POSITIVE_STIFFNESS = "positive_stiffness"
    POINT_INSIDE = "point_inside"
    WAIT = "wait"
    CONFIGURE = "configure"
    POLICY = "policy"


@dataclass(frozen=True, slots=True)
class Entry:
    """A reason or a remedy: the code of a `Reason` or `Remedy`, and its text for users."""

    code: str
    text: str


@dataclass(frozen=True, slots=True)
class Explanation:
    """Reasons, and alternative remedies."""

    reasons: tuple[Entry, ...]
    remedies: tuple[Entry, ...] = ()

    def and_reason(self, code: Reason, text: str) -> "Explanation":
        """Return it with one more reason."""
        return Explanation((*self.reasons, Entry(code, text)), self.remedies)

    def and_remedy(self, code: Remedy, text: str) -> "Explanation":
        """Return it with one more remedy."""
        return Explanation(self.reasons, (*self.remedies, Entry(code, text)))

    def lines(self, outcome: str, between: Iterable[str] = ()) -> list[str]:
        """Return one statement a line: the first reason, then the lines `between`, then
        the rest.
        """
        reasons = [one.text for one in self.reasons] or ["the guard gave no reason"]
        prefix = f"{outcome}: " if outcome in _NAMED else ""
        remedy = ", or ".join(one.text for one in self.remedies)
        return [f"{prefix}{reasons[0]}", *between, *reasons[1:], *([remedy] if remedy else [])]

    def plain(self, outcome: Outcome) -> dict[str, Any]:
        """Return the fields of a verdict for it."""
        return {
            "outcome": outcome.value,
            "reasons": [asdict(one) for one in self.reasons],
            "remedies": [asdict(one) for one in self.remedies],
            "text": "; ".join(self.lines(outcome)),
        }


_NAMED = (Outcome.WARNING, Outcome.CLAMPED, Outcome.FOLLOWED, Outcome.REFUSED)  # in the sentence


def because(code: Reason, text: str) -> Explanation:
    """Return the explanation with one reason."""
    return Explanation((Entry(code, text),))


def explanation_of(verdict: Mapping[str, Any]) -> Explanation:
    """Return the explanation in the map of a verdict."""
    reasons, remedies = (
        tuple(Entry(one["code"], one["text"]) for one in verdict.get(name, ()))
        for name in ("reasons", "remedies")
    )
    return Explanation(reasons, remedies)
