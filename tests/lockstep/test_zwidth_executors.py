"""Where trials run: names and what is wrong with them, the same outcomes everywhere, errors
that come home, one core a task.
"""

import os
import pickle
import socket
import sys
import threading
from collections.abc import Iterator
from concurrent.futures import Executor, Future
from contextlib import closing
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from support.stand_in import StandIn
from support.zwidth_executors import SHORT

from hapticd.core import errors
from hapticd.core.errors import (
    CommandError,
    ConfigError,
    HapticdError,
    MissingLibrary,
    SequenceError,
)
from hapticd.zwidth import executors, outcomes
from hapticd.zwidth.engine.batch import at_most, workers
from hapticd.zwidth.executors import executor, pool_of
from hapticd.zwidth.limits import LimitsParams, LimitsPlan, plan_limits, run_limits
from hapticd.zwidth.outcomes import TOGETHER, Conditions, Outcome, TrialBatch
from hapticd.zwidth.store import TrialStore


@cache  # not when it is imported: each worker collects all tests
def limits() -> LimitsPlan:
    """What the limits of a few trials take."""
    return plan_limits(LimitsParams(SHORT))


@pytest.fixture(scope="module")
def scheduler() -> Iterator[str]:
    """A Dask cluster within this process: two workers of one thread; its address as an executor."""
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=False, protocol="tcp", dashboard_address=":0"
    ) as it:
        yield it.scheduler_address.replace("tcp://", "dask://")


def every(kind: type[HapticdError]) -> list[type[HapticdError]]:
    return [kind, *(below for child in kind.__subclasses__() for below in every(child))]


@pytest.mark.parametrize(
    "spec",
    [
        "",
        "ray",
        "threads",
        "dask",
        "dask://",
        "dask://here",
        "dask://here:",
        "dask://here:p",
        "dask://here:99999",
        "dask://me@here:1",
        "dask://here:1/x",
        "tcp://here:1",
    ],
)
def test_unknown_name_says_what_there_is(spec: str) -> None:
    with (
        pytest.raises(
            ConfigError, match=f"executor {spec!r}: use auto, thread, process or dask://HOST:PORT"
        ),
        executor(spec),
    ):
        pass


def test_missing_library_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(MissingLibrary) as missing, executor("dask://127.0.0.1:8786"):
        pass
    assert missing.value.requirement.startswith("distributed>=")


def test_silent_scheduler_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed")
    monkeypatch.setattr(executors, "PATIENCE_S", 0.2)
    with closing(socket.socket()) as taken:
        taken.bind(("127.0.0.1", 0))  # and nobody listens there
        port = taken.getsockname()[1]
        said = (
            rf"no Dask scheduler answers at tcp://127\.0\.0\.1:{port} within 0\.2 s .*: start `dask"
            r" scheduler` there"
        )
        with pytest.raises(ConfigError, match=said), executor(f"dask://127.0.0.1:{port}"):
            pass


@pytest.mark.parametrize(
    ("greeting", "reason"),
    [
        (b"", "timed out"),
        (b"SSH-2.0-", "the program at that address is not a Dask scheduler"),
    ],
)
def test_other_server_is_no_scheduler(
    greeting: bytes, reason: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Such as the scheduler's own dashboard, which waits to be asked."""
    pytest.importorskip("distributed")
    monkeypatch.setattr(executors, "PATIENCE_S", 0.2)
    with socket.create_server(("127.0.0.1", 0)) as server:

        def greet() -> None:
            link, _ = server.accept()
            with link:
                link.sendall(greeting)
                link.recv(1)  # until the other side has gone

        port = server.getsockname()[1]
        other = threading.Thread(target=greet)
        other.start()
        said = (
            rf"no Dask scheduler answers at tcp://127\.0\.0\.1:{port} within 0\.2 s \({reason}\):"
            r" .* not that of its dashboard"
        )
        with pytest.raises(ConfigError, match=said), executor(f"dask://127.0.0.1:{port}"):
            pass
        other.join()


def test_cluster_without_workers_says_what_to_start(monkeypatch: pytest.MonkeyPatch) -> None:
    distributed = pytest.importorskip("distributed")
    monkeypatch.setattr(executors, "PATIENCE_S", 0.2)
    with distributed.LocalCluster(
        n_workers=0, processes=False, protocol="tcp", dashboard_address=":0"
    ) as empty:
        address = empty.scheduler_address
        said = f"scheduler at {address} has no worker after 0.2 s: start `dask worker {address}`"
        with pytest.raises(ConfigError, match=said), executor(address.replace("tcp", "dask")):
            pass


@pytest.mark.parametrize(
    ("there", "said"),
    [
        ({"hapticd": "0.0.1"}, "has hapticd 0.0.1, here 1.0:"),
        ({"numba": None}, "has numba missing, here 0.61:"),
        (
            {"python": "3.10.2.final.0", "numpy": "1.9"},
            "has python 3.10, here 3.11; numpy 1.9, here 2.1:",
        ),
    ],
)
def test_worker_of_other_versions_is_refused(there: dict[str, Any], said: str) -> None:
    here = {"python": "3.11.7.final.0", "hapticd": "1.0", "numpy": "2.1", "numba": "0.61"}
    found = {
        "client": {"packages": here},
        "workers": {"tcp://w:1": {"packages": here}, "tcp://w:2": {"packages": here | there}},
    }
    client = SimpleNamespace(
        wait_for_workers=lambda count, timeout: None, get_versions=lambda packages: found
    )
    with pytest.raises(
        ConfigError,
        match=(f"Dask worker tcp://w:2 {said} outcomes would depend on the machine; install"),
    ):
        executors._look_at_workers(client, "tcp://w:0")


def test_other_patch_of_python_is_the_same() -> None:
    here = {"python": "3.11.7.final.0", "hapticd": "1.0", "numpy": "2.1", "numba": "0.61"}
    found = {
        "client": {"packages": here},
        "workers": {"a": {"packages": here | {"python": "3.11.9.final.0"}}},
    }
    client = SimpleNamespace(
        wait_for_workers=lambda count, timeout: None, get_versions=lambda packages: found
    )
    executors._look_at_workers(client, "tcp://w:0")


@pytest.mark.parametrize("kind", every(HapticdError))
def test_every_error_travels(kind: type[HapticdError]) -> None:
    """As pools do it; what cannot be unpickled would end the pool instead."""
    if kind is SequenceError:
        raised: HapticdError = SequenceError("code", "what", ("a receipt",), "disabled")
    elif issubclass(kind, CommandError):
        raised = kind("code", "what", {"limit": 8.0})
    else:
        raised = kind("what")
    back = pickle.loads(pickle.dumps(raised))
    assert type(back) is kind
    assert str(back) == "what"
    assert back.exit_code == raised.exit_code
    assert vars(back) == vars(raised)


def test_all_errors_are_in_one_tree() -> None:
    own = [
        one for one in vars(errors).values() if getattr(one, "__module__", "") == errors.__name__
    ]
    assert len(own) > 10
    assert set(own) <= {*every(HapticdError), errors.GuardWarning}


def test_tasks_of_a_pool_keep_to_one_core() -> None:
    whole = workers()
    assert whole == len(os.sched_getaffinity(0))
    with pool_of(None) as pool:
        assert [pool.submit(workers).result() for _ in range(4)] == [1, 1, 1, 1]
    assert executors.alone(workers) == 1
    with at_most(10_000):
        assert workers() == whole
    assert workers() == whole


@pytest.mark.parametrize(("points", "size"), [(40, 40), (600, 64), (1100, 128), (5000, 256)])
def test_tasks_grow_with_their_lot_but_for_the_last(points: int, size: int) -> None:
    lot = TrialBatch(SHORT, 0.0, tuple((float(k), 0.0, 0.0) for k in range(points)))
    tasks = lot.tasks(TrialStore(None))
    sizes = [len(task) for task in tasks]
    assert max(sizes) == size
    assert sizes == sorted(sizes, reverse=True)
    assert sum(size <= TOGETHER for size in sizes) >= min(8, len(sizes))
    assert np.array_equal(np.concatenate(tasks), np.array(lot.points))


@pytest.mark.parametrize(("spec", "trials"), [("thread", 10**6), ("auto", 3999), ("auto", 0)])
def test_threads_are_this_process(spec: str, trials: int) -> None:
    with executor(spec, trials=trials) as pool:
        assert pool is None


def test_thousands_of_trials_have_processes() -> None:
    with executor("auto", trials=4000) as pool:
        assert pool is not None
        assert pool.submit(os.getpid).result() != os.getpid()


def test_given_up_campaign_cancels_what_has_not_begun() -> None:
    release = threading.Event()
    waiting = list[Future[int]]()

    def campaign() -> None:
        with pool_of(None) as pool:
            for _ in range(workers()):
                pool.submit(release.wait)
            waiting.extend(pool.submit(int) for _ in range(5))
            waiting[-1].add_done_callback(
                lambda future: release.set()
            )  # what is under way is waited for
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        campaign()
    assert all(future.cancelled() for future in waiting)


class FirstOnly(Executor):
    """Does the first task at once and never begins another."""

    def __init__(self) -> None:
        self.futures: list[Future[Any]] = []

    def submit(self, fn: Any, /, *args: Any, **kwargs: Any) -> Future[Any]:
        self.futures.append(Future())
        if len(self.futures) == 1:
            self.futures[0].set_result(stand_in(*args))
        return self.futures[-1]


def stand_in(conditions: Conditions, level: float, points: Any) -> list[Outcome]:
    """A display whose limits are half of what is predicted."""
    found = []
    for point in points:
        good = abs(point).max() < 0.01 if point[2] else point.max() < (100.0 if point[0] else 1.5)
        answer = "passive" if good else "not_passive"
        nothing = np.empty(0)
        found.append(
            Outcome(
                tuple(point.tolist()),
                level,
                answer,
                bool(good),
                0.1,
                0.0,
                0.2,
                1.0,
                9.0,
                0.02,
                0.1,
                nothing,
                nothing,
            )
        )
    return found


def test_limits_do_not_depend_on_who_else_is_under_way(monkeypatch: pytest.MonkeyPatch) -> None:
    heard: list[tuple[str, int]] = []
    one_by_one = run_limits(limits(), TrialStore(None), executor=StandIn(stand_in))
    monkeypatch.setattr(outcomes, "run_trials", stand_in)
    side_by_side = run_limits(
        limits(),
        TrialStore(None),
        on_outcomes=lambda scan, given, new: heard.append(("KBM"[scan.axis], len(new))),
    )
    assert repr(one_by_one.limits) == repr(side_by_side.limits)
    assert sum(count for _, count in heard) == sum(limit.trials for limit in side_by_side.limits)
    assert {name for name, _ in heard} == {"K", "B", "M"}
