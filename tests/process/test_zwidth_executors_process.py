"""Where trials run: names and what is wrong with them, the same outcomes everywhere, errors
that come home, one core a task.
"""

import os
from typing import Any

import pytest
from support.zwidth_executors import made, refuse, same_error

from hapticd.core.errors import CommandError, HapticdError
from hapticd.zwidth.engine.batch import workers
from hapticd.zwidth.executors import executor


@pytest.fixture(scope="module")
def reference() -> dict[str, Any]:
    """All outcomes of the map, made on threads here."""
    return made(None)


@pytest.mark.process
def test_processes_give_the_same_bytes_and_errors(reference: dict[str, Any]) -> None:
    with executor("process", 2) as pool:
        assert pool is not None
        assert pool.submit(workers).result() == 1
        assert made(pool) == reference
        assert same_error(pool)
        with pytest.raises(CommandError, match="no"):
            pool.submit(refuse).result()


@pytest.mark.process
def test_dead_process_is_told() -> None:
    def campaign() -> None:
        with executor("process", 1) as pool:
            assert pool is not None
            pool.submit(os._exit, 1).result()

    with pytest.raises(HapticdError, match="a worker process died, killed or out of memory"):
        campaign()


@pytest.mark.process
def test_dask_processes_give_the_same_bytes(reference: dict[str, Any]) -> None:
    distributed = pytest.importorskip("distributed")
    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, dashboard_address=":0"
        ) as cluster,
        executor(cluster.scheduler_address.replace("tcp://", "dask://")) as pool,
    ):
        assert made(pool) == reference
