"""Execution of many trials: on threads of this process, in processes of this machine, or on a Dask
cluster.

    auto                processes for a map of thousands of trials, otherwise threads
    thread              the engine's own threads; its kernels release the interpreter lock
    process             a new process for each core; for verdicts, which hold the lock
    dask://HOST:PORT    the workers of a running scheduler (`dask scheduler`, `dask worker`)

A task is a function and its arguments, a few kB; its result is about 2.5 kB per trial. Kernels are
compiled where the task runs and cached on disk there. In a pool every task uses one core: there are
as many running tasks as cores, so the engine's own threads would only compete. Errors of this
package are raised again as they are.

Outcomes do not depend on the place of execution, to the last bit, if hapticd, numpy and numba are
the same: a worker with other versions is refused. Limitations: a cluster of different processors,
for which numba compiles different code.
"""

import re
import signal
from collections.abc import Callable, Iterator
from concurrent.futures import (
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    ProcessPoolExecutor,
    ThreadPoolExecutor,
)
from contextlib import AbstractContextManager, contextmanager, nullcontext
from functools import partial
from multiprocessing import get_context
from socket import create_connection
from typing import Any, ParamSpec, TypeVar
from urllib.parse import urlsplit

from hapticd.core.errors import ConfigError, HapticdError
from hapticd.core.extras import need
from hapticd.zwidth.engine.batch import at_most, workers

__all__ = ["checked", "executor", "pool_of"]

PATIENCE_S = 5.0  # timeout for a scheduler's answer and for a first worker
GREETING_MOST = 1 << 20  # bytes
SAME = ("hapticd", "numpy", "numba")  # packages that determine the last bit of an outcome
SPECS = "auto, thread, process or dask://HOST:PORT"
# trials of 90 s: above it waiting for the lock costs threads more than starting processes
MANY = 4000
DASK = re.compile(r"dask://(?P<host>[^/@:?#\s]+|\[[0-9A-Fa-f:.]+\]):(?P<port>[0-9]{1,5})")

P = ParamSpec("P")
T = TypeVar("T")


@contextmanager
def executor(spec: str, processes: int | None = None, trials: int = 0) -> Iterator[Executor | None]:
    """Yield the executor of that name and close it afterwards, cancelling tasks that have not
    started. None stands for the threads of this process.

    `processes` of a pool, by default one per core; `trials` is the expected number, for "auto".
    ConfigError for another name, a missing library, or a scheduler that does not answer, has no
    workers or has workers of other versions; HapticdError when workers die.
    """
    few = trials < MANY or workers() == 1
    if spec == "thread" or (spec == "auto" and few):
        yield None
    elif spec in ("process", "auto"):
        with _processes(processes or workers()) as pool:
            yield pool
    else:
        with _cluster(_address(spec)) as pool:
            yield pool


def checked(spec: str) -> None:
    """Raise ConfigError unless an executor of that name is possible."""
    if spec not in ("auto", "thread", "process"):
        _address(spec)


def alone(task: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
    """Run the task on one core."""
    with at_most(1):
        return task(*args, **kwargs)


class SingleThreaded(Executor):
    """Another executor, each of whose tasks uses one core."""

    def __init__(self, inner: Executor) -> None:
        self._inner = inner

    def submit(self, task: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        """Submit `task` as to any executor; `alone` runs it."""
        return self._inner.submit(partial(alone, task, *args, **kwargs))


@contextmanager
def one_core_a_task(pool: Executor) -> Iterator[Executor]:
    """Yield `pool`, each task on one core; close it afterwards without the tasks that have not
    started.
    """
    try:
        yield SingleThreaded(pool)
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def pool_of(executor: Executor | None) -> AbstractContextManager[Executor]:
    """Return `executor`, which stays open, or a thread here for each core: the kernels release the
    interpreter lock.
    """
    if executor is not None:
        return nullcontext(executor)
    return one_core_a_task(ThreadPoolExecutor(workers()))


@contextmanager
def _processes(count: int) -> Iterator[Executor]:
    # Ctrl-C reaches every process of a terminal; the parent process ends the pool
    ignored = (signal.SIGINT, signal.SIG_IGN)
    pool = ProcessPoolExecutor(count, get_context("spawn"), signal.signal, ignored)
    try:
        with one_core_a_task(pool) as tasks:
            yield tasks
    except BrokenExecutor as error:
        raise HapticdError(
            f"a worker process died, killed or out of memory ({error}); restarted, a map"
            " continues from its stored trials"
        ) from error


@contextmanager
def _cluster(address: str) -> Iterator[Executor]:
    distributed = need("distributed", "executor dask://")
    try:
        _greeted(address)
        client = distributed.Client(address, timeout=PATIENCE_S, set_as_default=False)
    except OSError as error:
        raise ConfigError(
            f"no Dask scheduler answers at {address} within {PATIENCE_S:g} s ({error}): start `dask"
            " scheduler` there, or name the address that it printed, which is not that of its"
            " dashboard"
        ) from error
    with client:
        _look_at_workers(client, address)
        try:
            yield SingleThreaded(client.get_executor(pure=False))
        except (distributed.KilledWorker, CancelledError) as error:
            raise HapticdError(
                f"the Dask cluster at {address} lost its scheduler or too many workers"
                f" ({str(error) or 'tasks were given up'}); restarted, a map continues from"
                " its stored trials"
            ) from error


def _greeted(address: str) -> None:
    """Raise OSError unless the peer sends first, as a scheduler does: with any other a client would
    wait forever.
    """
    place = urlsplit(address)
    with create_connection((str(place.hostname), place.port or 0), timeout=PATIENCE_S) as link:
        length = link.recv(8)  # of the message, little-endian
    if len(length) < 8 or int.from_bytes(length, "little") > GREETING_MOST:
        raise OSError("the program at that address is not a Dask scheduler")


def _address(spec: str) -> str:
    found = DASK.fullmatch(spec)
    if found is None or not 0 < int(found["port"]) < 1 << 16:
        raise ConfigError(f"executor {spec!r}: use {SPECS}")
    return f"tcp://{found['host']}:{found['port']}"


def _look_at_workers(client: Any, address: str) -> None:
    """Raise ConfigError unless there are workers, all with our versions."""
    try:
        client.wait_for_workers(1, timeout=PATIENCE_S)
    except TimeoutError as error:
        raise ConfigError(
            f"the Dask scheduler at {address} has no worker after {PATIENCE_S:g} s: start `dask"
            f" worker {address}`"
        ) from error
    found = client.get_versions(packages=SAME)
    here = _versions(found["client"])
    for name, worker in found["workers"].items():
        unlike = [
            f"{what} {there}, here {here[what]}"
            for what, there in _versions(worker).items()
            if there != here[what]
        ]
        if unlike:
            raise ConfigError(
                f"Dask worker {name} has {'; '.join(unlike)}: outcomes would depend on the"
                " machine; install the same versions there and restart the worker"
            )


def _versions(found: dict[str, Any]) -> dict[str, str]:
    packages = found["packages"]
    python = ".".join(packages["python"].split(".")[:2])
    return {"python": python, **{name: packages[name] or "missing" for name in SAME}}
