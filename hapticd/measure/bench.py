"""A trial on the device of a daemon: enable, set, perturb, record at 4 kHz, force off.

The daemon may be the real one (`hapticd.client.Client`) or the same stack on virtual time (`lockstep_bench`): what is used of
it is the `Bench` below; what is heard meanwhile is in `heard`, what is lost in `losses`. The trial begins disabled, and ends
disabled whatever happens; nobody's session is taken over. Whoever changes anything meanwhile ends it.

What would break it: a board without probe inputs (refused), or a host so busy that slots are lost (named, then undecided).
"""

from collections.abc import Iterator
from typing import Any, Protocol

import numpy.typing as npt

from hapticd.analysis.arrays import Floats
from hapticd.errors import AnalysisError
from hapticd.measure.heard import Hearing
from hapticd.measure.progress import Progress, silent
from hapticd.measure.recorded import Recorded
from hapticd.measure.sources import Source, Trial
from hapticd.sim.engine.torque import torque_record
from hapticd.units import PROBE_RATE_HZ

WAVEFORM_S = 120.0  # a longer trial repeats it
SPARE_S = 10.0  # of waveform beyond the trial: settling, and what is heard late


class Bench(Protocol):
    """What is used of a daemon; see `hapticd.client.Client`."""

    def hello(self) -> dict[str, Any]: ...
    def status(self) -> dict[str, Any]: ...
    def set(self, *, K: float, B: float, M: float, damping: float) -> Any: ...
    def enable(self) -> Any: ...
    def disable(self) -> Any: ...
    def damping(self, value: Any) -> Any: ...
    def wait_for(self, state: str, timeout_s: float = 10.0) -> None: ...
    def perturb_load(self, samples_n: npt.ArrayLike) -> int: ...
    def perturb_start(self, loop: bool = False) -> Any: ...
    def perturb_stop(self) -> Any: ...
    def messages(self, topics: Any, look_s: float = 0.05) -> Iterator[tuple[str, bytes] | None]: ...


def bench_source(bench: Bench, origin: str = "daemon") -> Source:
    """Trials on the device of a daemon; AnalysisError unless it is `disabled`."""

    def record(trial: Trial, tell: Progress = silent) -> Recorded:
        state = bench.status()["state"]
        if state != "disabled":
            raise AnalysisError(f"the servo is {state}, a trial begins from disabled; end the session with `hapticd disable`")
        stiffness, damping, mass = trial.environment
        waveform = _waveform(trial)
        try:
            bench.set(K=stiffness, B=damping, M=mass, damping=trial.damping_ns_per_m)
            bench.damping("on" if trial.damping_ns_per_m else "off")
            bench.perturb_load(waveform)
            bench.enable()
            bench.wait_for("enabled")
            bench.perturb_start(loop=waveform.size < PROBE_RATE_HZ * (trial.seconds + SPARE_S))  # if we are killed, it ends
            return Hearing(bench, trial).recorded(origin, tell)
        finally:
            _leave(bench)

    return record


def _waveform(trial: Trial) -> Floats:
    if trial.waveform_n is not None:
        return trial.waveform_n
    return torque_record(trial.excitation, round(PROBE_RATE_HZ * min(WAVEFORM_S, trial.seconds + SPARE_S)), trial.excitation.seed)


def _leave(bench: Bench) -> None:
    """Force off whatever happened; a stop or a fault has done so already."""
    try:
        bench.perturb_stop()
    finally:
        if bench.status()["state"] == "enabled":
            bench.disable()
