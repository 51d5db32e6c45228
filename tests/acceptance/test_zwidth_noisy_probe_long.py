"""What the probe's amplifier adds is that of the trial, wherever and with whatever it is made.

The device is linear and narrow: some verdicts need the record, which is then made once more.
"""

from concurrent.futures import Executor, ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from support.zwidth_noisy_probe import GIVEN, POINTS
from test_zwidth_noisy_probe import recorded

from hapticd.core.arrays import Floats
from hapticd.zwidth.executors import executor
from hapticd.zwidth.map import MapParams, plan_map, run_map
from hapticd.zwidth.outcomes import Outcome, run_trials
from hapticd.zwidth.store import TrialStore, to_json


def told(found: list[Outcome]) -> list[str]:
    """Every number of every outcome."""
    return [str(to_json(vars(one))) for one in found]


@pytest.mark.parametrize("spec", ["thread", "process"])
def test_an_outcome_is_the_same_alone_and_among_others(spec: str) -> None:
    """Alone, in a task of 8 and in tasks of 3, in this process and in others."""
    whole = told(run_trials(GIVEN, 0.0, POINTS))
    alone = [told(run_trials(GIVEN, 0.0, point[None]))[0] for point in POINTS]
    parts = np.array_split(POINTS, 3)
    with executor(spec) as pool:
        cut = spread(pool, parts)
    assert alone == whole
    assert cut == whole


def spread(pool: Executor | None, parts: list[Floats]) -> list[str]:
    """Outcomes of tasks that are cut as `parts`."""
    if pool is None:
        with ThreadPoolExecutor(2) as threads:
            return spread(threads, parts)
    tasks = [pool.submit(run_trials, GIVEN, 0.0, part) for part in parts]
    return told([one for task in tasks for one in task.result()])


def test_a_map_that_goes_on_is_the_map_that_was_not_interrupted(tmp_path: Path) -> None:
    axes = (np.linspace(0.0, 900.0, 4), np.linspace(0.0, 0.6, 3), np.linspace(0.0, 0.002, 2))
    plan = plan_map(MapParams(GIVEN, axes, (0.0,), everywhere=True))
    whole = TrialStore(None)
    run_map(plan, whole)
    path = tmp_path / "trials.jsonl"
    TrialStore(path).add(list(to_json(whole.known).items())[::3])
    made = run_map(plan, TrialStore(path)).made
    assert 0 < made < plan.trials
    known = to_json(whole.known)
    assert to_json(TrialStore(path).known) == {key: known[key] for key in TrialStore(path).known}
    assert len(TrialStore(path).known) == plan.trials


@pytest.mark.parametrize("dtype", ["f32", "f64"])
def test_a_record_is_the_same_alone_and_in_any_lane(dtype: str) -> None:
    whole = recorded(POINTS, dtype).velocity_m_per_s
    turned = recorded(POINTS[::-1], dtype).velocity_m_per_s
    assert whole is not None
    assert turned is not None
    assert np.array_equal(turned[::-1], whole)
    for place, point in enumerate(POINTS):
        alone = recorded(point[None], dtype).velocity_m_per_s
        assert alone is not None
        assert np.array_equal(alone[0], whole[place])
