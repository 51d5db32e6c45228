"""A batch: the same bytes however it is spread, records that agree with sums, divergence with
its time, refusals.
"""

import pickle
from concurrent.futures import Executor, Future

import numpy as np
import pytest
from support.engine_batch import PARAMS, SUMS, WEIR, same_bytes

from hapticd.zwidth.engine import batch
from hapticd.zwidth.engine.batch import simulate


class Inline(Executor):
    """Runs each task at once, as a process would get it: pickled."""

    def submit(self, task, /, *args, **kwargs):
        done = Future()
        done.set_result(
            pickle.loads(pickle.dumps(task))(*pickle.loads(pickle.dumps(args)), **kwargs)
        )
        return done


@pytest.fixture(scope="module")
def reference():
    return simulate(WEIR, PARAMS, 0.5, 7, active_damping=1.74, keep="records")


@pytest.mark.parametrize("chunk", [1, 7, 64])
@pytest.mark.parametrize("threads", [1, 2])
def test_bytes_do_not_depend_on_chunks_or_threads(reference, chunk, threads, monkeypatch):
    monkeypatch.setattr(batch, "workers", lambda: threads)
    again = simulate(WEIR, PARAMS, 0.5, 7, active_damping=1.74, keep="records", chunk=chunk)
    assert same_bytes(reference, again)


@pytest.mark.parametrize("dtype", ["f32", "f64"])
def test_sums_do_not_depend_on_what_is_kept(dtype):
    moving = (0.0, 0.5)  # gives energy back at first
    kept = {
        keep: simulate(WEIR, PARAMS, 12.0, 7, start=moving, dtype=dtype, keep=keep, substeps=4)
        for keep in ("summary", "spectra", "records")
    }
    for name in SUMS:
        sums = [getattr(found, name) for found in kept.values()]
        assert sums[0].any()
        assert np.array_equal(sums[1], sums[0])
        # in narrower groups, for which a compiler may choose other instructions
        assert np.allclose(sums[2], sums[0], rtol={"f32": 1e-3, "f64": 1e-9}[dtype])


def test_any_executor_gives_the_same_bytes(reference):
    assert same_bytes(
        reference,
        simulate(WEIR, PARAMS, 0.5, 7, active_damping=1.74, keep="records", executor=Inline()),
    )


def test_sums_are_those_of_the_records(reference):
    force = reference.torque_n
    velocity = reference.velocity_m_per_s
    work = np.cumsum(force * velocity, axis=1) / 4000
    assert np.allclose(reference.sigma_v_m_per_s, np.sqrt((velocity**2).mean(axis=1)), rtol=1e-12)
    assert np.allclose(reference.work_j, work[:, -1], rtol=1e-12)
    assert np.allclose(
        reference.min_energy_j, np.minimum(work[:, 3::4].min(axis=1), 0.0), rtol=1e-9, atol=1e-18
    )
    assert set(reference.samples) == {2000}
    assert not reference.diverged.any()


@pytest.mark.parametrize("dtype", ["f64", "f32"])
def test_summary_keeps_the_same_sums_and_no_record(reference, dtype):
    summary = simulate(WEIR, PARAMS, 0.5, 7, active_damping=1.74, dtype=dtype)
    assert summary.velocity_m_per_s is None
    assert summary.torque_n is None
    for name in SUMS:
        assert np.allclose(
            getattr(summary, name),
            getattr(reference, name),
            rtol=1e-12 if dtype == "f64" else 5e-3,
            atol=1e-12,
        )
    with pytest.raises(ValueError, match="keep='records'"):
        summary.record(0)
