"""Trials that are made up: an executor that answers for the engine."""

from collections.abc import Callable
from concurrent.futures import Executor, Future
from typing import Any

from hapticd.zwidth.outcomes import Conditions, Outcome, run_trials


class StandIn(Executor):
    """Gets the outcomes of trials from `flying` at once; runs all other tasks directly."""

    def __init__(self, flying: Callable[[Conditions, float, Any], list[Outcome]]) -> None:
        self._flying = flying

    def submit(self, task: Any, /, *args: Any, **kwargs: Any) -> Future[Any]:
        done: Future[Any] = Future()
        done.set_result(self._flying(*args) if task is run_trials else task(*args, **kwargs))
        return done
