"""Build the question to the guard's worker about a change.

It contains the environment in force, the change, the changes scheduled around it, and the terms of
the judgement. The worker reads it in `judge` and `policies`; docs/guard.md describes its fields.
"""

from typing import Any

from hapticd.core.environment import Environment
from hapticd.guard.pending import PendingChange
from hapticd.guard.stages import ramp_s
from hapticd.guard.status import Guard
from hapticd.protocol.schemas import Request
from hapticd.protocol.view import ServoView

Fields = dict[str, Any]  # of an environment, nested as in `set`


def former(request: Request, before: list[Fields], target: Environment) -> Fields:
    """Return the values that a bounded change restores at its end: `target`, with the changes
    scheduled `before` it; {} for a change without an end.
    """
    if not request.end_tick:
        return {}
    for fields in before:
        target = target.changed(fields)
    return target.fields(request.change(0.0))


def question(
    change: PendingChange,
    before: list[Fields],
    after: list[Fields],
    auto: bool,
    guard: Guard,
    view: ServoView,
) -> dict[str, Any]:
    """Return the question about `change`, with the changes scheduled `before` and `after` it.
    `auto`: the guard selects the level of active damping.
    """
    in_force = guard.in_force
    return {
        "ask": "change",
        "now": in_force.now().message(),
        "target": in_force.target().message(),
        "state": view.state_name,
        "gain": float(view.record["gain"]),
        "enable": change.enables,
        "change": change.request.change(in_force.level),
        "before": before,
        "after": after,
        "policy": change.policy,
        "basis": guard.terms.basis,
        "margin_ns_per_m": guard.terms.margin_ns_per_m,
        "mode": "auto" if auto else "off",  # the change contains the level of mode `level`
        "level": in_force.level,
        "delay_periods": guard.delay_periods,
        "ramp_s": ramp_s(change.request, view.params.safety.default_ramp_s),
    }
