"""Where trials run: names and what is wrong with them, the same outcomes everywhere, errors
that come home, one core a task.
"""

from collections.abc import Iterator
from concurrent.futures import CancelledError
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from support.measured_scenes import MOTOR, scene
from support.zwidth_executors import SHORT, made, refuse, same_error
from test_zwidth_executors import FirstOnly, limits

from hapticd.core.errors import (
    CommandError,
    HapticdError,
)
from hapticd.model.effects import Masses, ProbeMass, Viscous
from hapticd.signal import assess
from hapticd.zwidth import executors
from hapticd.zwidth.engine.batch import workers
from hapticd.zwidth.executors import executor
from hapticd.zwidth.limits import run_limits
from hapticd.zwidth.outcomes import TOGETHER, Conditions, Outcome, run_trials
from hapticd.zwidth.store import TrialStore, to_json


@pytest.fixture(scope="module")
def reference() -> dict[str, Any]:
    """All outcomes of the map, made on threads here."""
    return made(None)


@pytest.fixture(scope="module")
def scheduler() -> Iterator[str]:
    """A Dask cluster within this process: two workers of one thread; its address as an executor."""
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=False, protocol="tcp", dashboard_address=":0"
    ) as it:
        yield it.scheduler_address.replace("tcp://", "dask://")


def test_dask_gives_the_same_bytes(reference: dict[str, Any], scheduler: str) -> None:
    with executor(scheduler) as pool:
        assert made(pool) == reference


def test_error_of_a_dask_worker_comes_home(scheduler: str) -> None:
    with executor(scheduler) as pool:
        assert pool is not None
        assert same_error(pool)


def test_command_error_comes_home_from_dask(scheduler: str) -> None:
    with executor(scheduler) as pool:
        assert pool is not None
        error = pool.submit(refuse).exception()
    assert isinstance(error, CommandError)
    assert (error.code, str(error), error.detail, error.exit_code) == ("stopped", "no", 3, 5)


def test_tasks_on_dask_keep_to_one_core(scheduler: str) -> None:
    with executor(scheduler) as pool:
        assert pool is not None
        assert pool.submit(workers).result() == 1


@pytest.mark.parametrize("what", ["killed", "cancelled"])
def test_lost_dask_workers_are_told(what: str, scheduler: str) -> None:
    distributed = pytest.importorskip("distributed")
    last = SimpleNamespace(address="tcp://w:1")
    lost = distributed.KilledWorker("run_trials", last, 3) if what == "killed" else CancelledError()
    why = "Attempted to run task .*" if what == "killed" else "tasks were given up"
    told = (
        rf"lost its scheduler or too many workers \({why}\); restarted, a map continues from"
        r" its stored trials"
    )
    with pytest.raises(HapticdError, match=told), executor(scheduler):
        raise lost


def test_outcomes_do_not_depend_on_the_size_of_a_task(monkeypatch: pytest.MonkeyPatch) -> None:
    """More than a group of them are judged again by their records, flown together or not."""
    again: list[object] = []
    resolved = assess.resolved
    monkeypatch.setattr(assess, "resolved", lambda *given: again.append(given) or resolved(*given))
    bare = (Masses(rotor_kg=0.005), MOTOR, ProbeMass(mass_kg=0.003), Viscous(rotor_ns_per_m=0.3))
    given = Conditions(scene(bare, seconds=20.0), 20.0)
    points = np.zeros((TOGETHER + 6, 3))
    points[:, 0] = np.linspace(300.0, 590.0, len(points))
    together = run_trials(given, 0.0, points)
    assert len(again) > TOGETHER
    alone = [one for part in np.array_split(points, 5) for one in run_trials(given, 0.0, part)]
    assert to_json([vars(one) for one in together]) == to_json([vars(one) for one in alone])


def test_engine_begins_no_threads_in_a_task_of_a_pool(monkeypatch: pytest.MonkeyPatch) -> None:
    from hapticd.zwidth.engine import batch

    asked: list[int] = []

    class Counted(batch.ThreadPoolExecutor):
        def __init__(self, max_workers: int) -> None:
            asked.append(max_workers)
            super().__init__(max_workers=max_workers)

    monkeypatch.setattr(batch, "ThreadPoolExecutor", Counted)
    points = np.zeros((200, 3))  # several groups of lanes
    executors.alone(run_trials, SHORT, 0.0, points)
    assert asked == [1]


def test_given_up_limits_cancel_what_has_not_begun() -> None:
    pool = FirstOnly()
    heard = []

    def hear(scan: Any, conditions: Conditions, new: list[Outcome]) -> None:
        heard.append(scan)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_limits(limits(), TrialStore(None), executor=pool, on_outcomes=hear)
    assert heard == [limits().scans[0]]
    assert (
        len(pool.futures) == 6
    )  # each of the six limits its first round; outcomes are told before the next one
    assert all(future.cancelled() for future in pool.futures[1:])
