"""Refusals and verdicts for changes that were not judged, or were judged after they were posted."""

from typing import Any

from hapticd.core.errors import CommandError
from hapticd.guard.pending import PendingChange
from hapticd.guard.status import Guard
from hapticd.protocol.journal import Explanation, Outcome, Reason, Remedy, because, explanation_of


def refused(change: PendingChange, why: Explanation) -> CommandError:
    """Return the refusal of a change without a verdict."""
    verdict = change.verdict | why.plain(Outcome.REFUSED) | {"cmd": change.cmd}
    return CommandError("guard", f"{change.cmd}: {verdict['text']}", guard=verdict)


def unknown_refused(change: PendingChange) -> CommandError:
    """Return the refusal by a strict policy, with the policy that would accept the change."""
    remedy = "`hapticd guard warn` would apply it anyway"
    if change.strict:
        remedy = "under `warn` a client that is not strict could apply it anyway"
    why = explanation_of(change.verdict)
    why = why.and_reason(Reason.POLICY, f"policy {change.policy} refuses that")
    return refused(change, why.and_remedy(Remedy.POLICY, remedy))


def verdict_beside(
    change: PendingChange, answer: dict[str, Any] | None, guard: Guard, late: str
) -> dict[str, Any]:
    """Return the verdict on a change that was posted at once. `answer` None: the worker
    was `late`.
    """
    verdict = answer.get("verdict") if answer else None
    if answer is None or not isinstance(verdict, dict):
        why = f"the guard's worker answered: {answer.get('error')}" if answer else late
        return guard.unknown(why or guard.trouble)
    if answer.get("action") == "stage" and verdict.get("safe"):
        stages = because(Reason.ONLY_IN_STAGES, "the path is passive only in stages")
        known = explanation_of(verdict)
        both = Explanation(stages.reasons + known.reasons, known.remedies)
        verdict = verdict | {"safe": False} | both.plain(Outcome.WARNING)
    return {"safe": None, "text": "", **verdict, "number": change.number, "cmd": change.cmd}
