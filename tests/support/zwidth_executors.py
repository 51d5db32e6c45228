"""Executors of trials: names and their errors, equal outcomes everywhere, propagated errors, one
core per task.
"""

from concurrent.futures import Executor
from functools import cache
from typing import Any

import numpy as np
import pytest

from hapticd.core.errors import AnalysisError, CommandError
from hapticd.settings.scene import load_scene
from hapticd.zwidth import executors
from hapticd.zwidth.map import MapParams, MapPlan, plan_map, run_map
from hapticd.zwidth.outcomes import Conditions, run_trials
from hapticd.zwidth.store import TrialStore, to_json

SCENE = load_scene("fig7")  # with friction, which affects the last bit
SHORT = Conditions(SCENE, 20.0, SCENE.noise)
AXES = (np.linspace(0.0, 600.0, 5), np.linspace(0.0, 6.0, 4), np.linspace(-0.01, 0.01, 4))


@cache  # not when it is imported: each worker collects all tests
def plan() -> MapPlan:
    """160 trials."""
    return plan_map(MapParams(SHORT, AXES, (0.0, 1.74), everywhere=True))


def made(pool: Executor | None) -> dict[str, Any]:
    """Every number of every trial as the store has it: floats in full, nan as null."""
    store = TrialStore(None)
    assert run_map(plan(), store, executor=pool).made == len(store.known) == plan().trials == 160
    return dict(to_json(store.known))


def same_error(pool: Executor) -> bool:
    """Whether a trial that is too short is refused there as it is here."""
    task = (run_trials, Conditions(SCENE, 1.0), 0.0, np.zeros((1, 3)))
    with pytest.raises(AnalysisError, match="too short for a verdict") as here:
        executors.alone(*task)
    there = pool.submit(*task).exception()
    return type(there) is AnalysisError and str(there) == str(here.value)


def refuse() -> None:
    """As a daemon that was stopped."""
    raise CommandError("stopped", "no", 3)
