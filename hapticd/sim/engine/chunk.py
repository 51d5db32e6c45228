"""One task of a batch: some trials from start to end, group by group. Runs on any thread or in
any process.
"""

import numpy as np

from hapticd.plant.model import Array
from hapticd.sim.engine.group import Group
from hapticd.sim.engine.heating import Heating
from hapticd.sim.engine.inputs import Inputs, level_at
from hapticd.sim.engine.job import Job, Prepared, prepared
from hapticd.sim.engine.records import Records
from hapticd.sim.engine.result import BatchResult, joined
from hapticd.sim.engine.spectral import Sums, spectral
from hapticd.units import PROBE_RATE_HZ


def run_chunk(job: Job, params: Array, first: int) -> BatchResult:
    """Trials `first`... of the batch with these K, B, M, (n, 3)."""
    made = prepared(job)
    starts = range(0, len(params), made.shape.lanes)
    return joined(
        [
            _run_group(job, made, params[start : start + made.shape.lanes], first + start)
            for start in starts
        ]
    )


def _run_group(job: Job, made: Prepared, params: Array, first: int) -> BatchResult:
    group = Group(job, made, params)
    inputs = Inputs(job, made, group.count, first)
    records = (spectral if job.keep == "spectra" else Records)(job, made, group.count, first)
    heating = None if made.model.winding is None else Heating(group, made.model.winding)
    level = None
    for start, end in inputs.legs():
        if (wanted := level_at(job, start)) != level:
            level = wanted
            (heating or group).damp(level)
        group.play(
            inputs.torque(start, end),
            inputs.noise(start, end),
            records.room(start),
            end - start,
            records.kept,
        )
        records.store(start, end, group.rows["ALIVE"])
        if heating is not None:
            heating.warm((end - start) / job.model.rate_hz, (end - start) * made.shape.samples)
        if not group.rows["ALIVE"][: group.count].any():
            break
    return _result(job, params, group, heating, records, inputs)


def _result(
    job: Job,
    params: Array,
    group: Group,
    heating: Heating | None,
    records: Records | Sums,
    inputs: Inputs,
) -> BatchResult:
    n = group.count
    samples = group.samples[:n].astype(np.int64)
    return BatchResult(
        params=params,
        sigma_v_m_per_s=np.sqrt(group.v2[:n] / np.maximum(samples, 1)),
        max_force_n=group.rows["FORCE"][:n].astype(np.float64),
        work_j=group.work[:n] / PROBE_RATE_HZ,
        min_energy_j=group.lowest[:n] / PROBE_RATE_HZ,
        samples=samples,
        rate_hz=float(PROBE_RATE_HZ),
        seconds=job.ticks / job.model.rate_hz,
        winding_c=None if heating is None else heating.temperature_c[:n],
        **records.finished(samples, inputs),
    )
