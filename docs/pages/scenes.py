"""Scene files, key by key, and the available effects, with their cost in time."""

import json
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any

from hapticd.core.units import unit_of
from hapticd.model.effects import ALWAYS, KINDS, PROVENANCE, Effect
from pages.markdown import table
from pages.settings import settings_page

COSTS = Path(__file__).parents[1] / "figures" / "effect-costs.json"
EFFECTS = """# Effects

A simulated device consists of effects. A scene names those that count, and a device file gives each its numbers in the table
`[model.KEY]`. Other effects are not simulated, except `{always}`, which are always present. The order below applies whatever the order in the file.

Costs are shares of the scene `fig7`. For a simulated second it takes {engine_us:.0f} us of one core in the batch engine (one of 32
trials together), and {lockstep_ms:.0f} ms as the whole product in lock-step. `python docs/effect_costs.py` measured them on one machine. Shares below about
3 % are noise. `crowbar` replaces amplifier and damping circuit. `hapticd sim explain SCENE` times a scene on your computer; `hapticd sim effects SCENE --for limits` lists the effects that its question needs.

| effect | costs in the engine | in lock-step | not linear |
| --- | --- | --- | --- |
"""


def scene_page() -> str:
    """Return every key of a scene file, and the place of its effects' numbers."""
    return settings_page("scene", "Scene file")


def effects_page() -> str:
    """Return every effect: its reason, its parameters, its cost."""
    costs = json.loads(COSTS.read_text())
    shares = {row["key"]: row for row in costs["effects"]}
    head = EFFECTS.format(
        always="` and `".join(ALWAYS),
        engine_us=1e6 * costs["engine_s"],
        lockstep_ms=1e3 * costs["lockstep_s"],
    )
    rows = [
        f"| [`{kind.key}`](#{kind.key.replace('_', '-')}) | {_share(shares, kind.key, 'engine_s')}"
        f" | {_share(shares, kind.key, 'lockstep_s')} | {kind.nonlinearity} |\n"
        for kind in KINDS
    ]
    return "\n".join((f"{head}{''.join(rows)}", *(_effect(kind) for kind in KINDS)))


def _share(shares: dict[str, Any], key: str, way: str) -> str:
    row = shares.get(key, {})
    return f"{100.0 * row[way]:+.0f} %" if way in row else "-"


def _effect(kind: type[Effect]) -> str:
    """Return the reason of an effect, and its numbers."""
    rows = [
        (f"`{item.name}`", unit_of(item.name), _range(item.metadata), _default(item.default))
        for item in fields(kind)
        if item.name not in PROVENANCE
    ]
    doc = " ".join((kind.__doc__ or "").split())
    return (
        f"({kind.key.replace('_', '-')})=\n\n## `{kind.key}`\n\n{doc}\n\nWhy: {kind.why}.\n\n"
        f"{table(('key', 'unit', 'takes', 'default'), rows)}"
    )


def _range(limits: Any) -> str:
    signs = {"gt": ">", "ge": ">=", "lt": "<", "le": "<="}
    return ", ".join(f"{signs[name]} {limit:g}" for name, limit in limits.items())


def _default(value: Any) -> str:
    return "required" if value is MISSING else f"`{value!r}`"
