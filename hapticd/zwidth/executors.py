"""Where many trials run: on threads of this process, in processes of this machine, or on a Dask
cluster.

    auto                processes for a map of thousands of trials, else threads
    thread              the engine's own threads; its kernels release the interpreter lock
    process             a process for each core, started anew; for verdicts, which hold the lock
    dask://HOST:PORT    the workers of a running scheduler (`dask scheduler`, `dask worker`)

A task is a function and its arguments, a few kB; what comes back is some 2.5 kB a trial. Kernels
are made where the task runs and kept on disk there. In a pool every task keeps to one core: there
are as many tasks under way as cores, and the engine's own threads would only get in each other's
way. Errors of ours come back as they were raised.

Outcomes do not depend on where they were made, to the last bit, as long as hapticd, numpy and numba
are the same: a worker with others is refused. What would break that: a cluster of unlike
processors, for which numba compiles unlike code.
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

PATIENCE_S = 5.0  # for a scheduler to answer and for a first worker to be there
GREETING_MOST = 1 << 20  # bytes
SAME = ("hapticd", "numpy", "numba")  # what the last bit of an outcome depends on
SPECS = "auto, thread, process or dask://HOST:PORT"
# trials of 90 s: from here on threads wait longer for the lock than processes take to start
MANY = 4000
DASK = re.compile(r"dask://(?P<host>[^/@:?#\s]+|\[[0-9A-Fa-f:.]+\]):(?P<port>[0-9]{1,5})")

P = ParamSpec("P")
T = TypeVar("T")


@contextmanager
def executor(spec: str, processes: int | None = None, trials: int = 0) -> Iterator[Executor | None]:
    """The executor of that name, closed afterwards: what has not begun by then is given up. None
    for the threads here.

    `processes` of a pool, by default one a core; `trials` that are expected, for "auto".
    ConfigError for another name, a scheduler that does not answer, without workers or with workers
    of other versions, without the library; HapticdError when workers die.
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
    """ConfigError unless there may be an executor of that name."""
    if spec not in ("auto", "thread", "process"):
        _address(spec)


def alone(task: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
    """The task on one core."""
    with at_most(1):
        return task(*args, **kwargs)


class SingleThreaded(Executor):
    """Another executor whose tasks each keep to one core."""

    def __init__(self, inner: Executor) -> None:
        self._inner = inner

    def submit(self, task: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        """Submit `task` as to any executor; it is run by `alone`."""
        return self._inner.submit(partial(alone, task, *args, **kwargs))


@contextmanager
def one_core_a_task(pool: Executor) -> Iterator[Executor]:
    """`pool`, each task of it on one core; closed afterwards, without what has not begun."""
    try:
        yield SingleThreaded(pool)
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def pool_of(executor: Executor | None) -> AbstractContextManager[Executor]:
    """`executor`, which stays open, or a thread here for each core: the kernels release the
    interpreter lock.
    """
    if executor is not None:
        return nullcontext(executor)
    return one_core_a_task(ThreadPoolExecutor(workers()))


@contextmanager
def _processes(count: int) -> Iterator[Executor]:
    # Ctrl-C reaches every process of a terminal; the one that began this ends it
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
    """OSError unless someone there speaks first, as a scheduler does: for anyone else a client
    would wait for ever.
    """
    place = urlsplit(address)
    with create_connection((str(place.hostname), place.port or 0), timeout=PATIENCE_S) as link:
        length = link.recv(8)  # of what follows, little-endian
    if len(length) < 8 or int.from_bytes(length, "little") > GREETING_MOST:
        raise OSError("the program at that address is not a Dask scheduler")


def _address(spec: str) -> str:
    found = DASK.fullmatch(spec)
    if found is None or not 0 < int(found["port"]) < 1 << 16:
        raise ConfigError(f"executor {spec!r}: use {SPECS}")
    return f"tcp://{found['host']}:{found['port']}"


def _look_at_workers(client: Any, address: str) -> None:
    """ConfigError unless there are workers, all with our versions."""
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
