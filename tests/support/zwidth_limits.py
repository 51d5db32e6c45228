"""Axis limits and their store: an interrupted search continues, with the same result."""

from typing import Any

from hapticd.settings.scene import load_scene
from hapticd.zwidth.limits import LimitsParams, plan_limits
from hapticd.zwidth.outcomes import Conditions, Outcome, run_trials
from hapticd.zwidth.store import TrialStore

THEORY = load_scene("theory")
PLAN = plan_limits(LimitsParams(Conditions(THEORY, 20.0, THEORY.noise), levels=(0.0,)))
Key = tuple[float, float, float]


class Flown:
    """The engine, with a record of the requested environments."""

    def __init__(self) -> None:
        self.points: list[Key] = []

    def __call__(self, conditions: Conditions, level: float, points: Any) -> list[Outcome]:
        self.points += map(tuple, points.tolist())
        return run_trials(conditions, level, points)


def environments(store: TrialStore) -> set[Key]:
    return {tuple(outcome["environment"]) for outcome in store.known.values()}
