"""The attack on the guard, on a few sequences: it finds faults in defective guards and none in the
product's. Then single attempts to bypass the guard.
"""

from typing import Any

FEW = [0, 2, 3, 6, 7, 8, 10, 11]  # on the shipped display, its delay known


def answering(action: str, request: dict[str, Any]) -> dict[str, Any]:
    stage = {"change": request["change"], "active_damping_at_least": None, "after_ramps": False}
    stages = [stage] if action == "apply" else []
    return {"action": action, "stages": stages, "verdict": {"clamped": False, "text": "blind"}}
