"""Sources of a trial's record: the batch engine (`simulated`), a file, or a daemon (`live`). All
return a `TrialRecord`.

An existing record is passed to the monitor second by second, as a daemon would send it, and cut
where the monitor would have ended the trial.

One rule for all sources selects the rendered environment from the typed values, the scene and the
record. Omitted values of K, B and M are those of an explicitly named scene, otherwise 0: K = 500
N/m alone does not imply the B and M of a scene that was not named. If all three are omitted, the
environment is that of the record, otherwise of the scene, otherwise 0. The active damping is a
property of the device's drive: unless typed, it is the record's, otherwise the scene's.

A typed environment must be that of the file's record; only this package's own files contain theirs.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from math import nan

import numpy as np

from hapticd.core.arrays import Floats
from hapticd.core.environment import Environment
from hapticd.core.errors import AnalysisError
from hapticd.model.scene import Excitation, Scene
from hapticd.zwidth import scenes
from hapticd.zwidth.store import Progress, TrialRecord
from hapticd.zwidth.watch import TrialMonitor, Watch

__all__ = ["Source", "Trial", "file_source", "given"]

LEAST_KEPT_S = 8.0
NAMES = (("K", "N/m"), ("B", "N s/m"), ("M", "kg"))
Typed = tuple[float | None, float | None, float | None]  # K [N/m], B [N s/m], M [kg]
SAME = 1e-6  # relative


@dataclass(frozen=True, slots=True)
class Trial:
    """The request to a source: K [N/m], B [Ns/m], M [kg], active damping [Ns/m], length,
    perturbation with its seed.
    """

    environment: tuple[float, float, float] = (0.0, 0.0, 0.0)
    active_damping_ns_per_m: float = 0.0
    seconds: float = 90.0
    excitation: Excitation = scenes.NOISE
    watch: Watch = field(default_factory=Watch)
    waveform_n: Floats | None = field(
        default=None, compare=False
    )  # at 4 kHz, repeated; in place of the excitation
    mark: bool = False  # the perturbation begins with one (`excitation.marked`), before the record


Source = Callable[[Trial, Progress], TrialRecord]


def file_source(recorded: TrialRecord) -> Source:
    """Return the record of a file for any request; environment and damping are then those that the
    user gives.
    """
    return lambda trial, tell: watched(recorded, trial.watch)


def watched(
    whole: TrialRecord, watch: Watch, winding_c: float = nan, command_n: Floats | None = None
) -> TrialRecord:
    """Return `whole` up to where the monitor would have ended it. `command_n` (ticks,): magnitudes
    of the commands.
    """
    monitor = TrialMonitor(watch, whole.rate_hz)
    second = round(whole.rate_hz)
    total = whole.force_n.size
    for start in range(0, total, second):
        part = slice(start, start + second)
        ticks = (
            np.zeros(1)
            if command_n is None
            else command_n[start * len(command_n) // total : part.stop * len(command_n) // total]
        )
        if monitor.see(
            whole.force_n[part],
            whole.velocity_m_per_s[part],
            winding_c,
            float(ticks.max(initial=0.0)),
        ):
            break
    if not monitor.ended:
        return whole
    kept = max(
        round(LEAST_KEPT_S * whole.rate_hz), round(monitor.seconds * whole.rate_hz)
    )  # judge at least this much of an existing record
    return replace(
        whole,
        force_n=whole.force_n[:kept],
        velocity_m_per_s=whole.velocity_m_per_s[:kept],
        ended=monitor.ended,
    )


def given(
    typed: Typed,
    active_damping_ns_per_m: float | None,
    scene: Scene | None,
    named: bool,
    recorded: TrialRecord | None = None,
) -> Environment:
    """Return the rendered environment; `named`: the user named `scene`. AnalysisError if a record
    was made in another environment than the typed one.
    """
    stated = recorded.rendered if recorded else None
    if stated is not None:
        _agrees(recorded.origin if recorded else "", typed, active_damping_ns_per_m, stated)
        return stated
    others = Environment().free
    if scene and (named or typed == (None, None, None)):
        others = scene.environment.free
    free = [other if own is None else own for own, other in zip(typed, others, strict=True)]
    level = active_damping_ns_per_m
    if level is None:
        level = scenes.level(scene) if scene else 0.0
    return Environment(active_damping_ns_per_m=level).with_free(free)


def _agrees(
    origin: str, typed: Typed, active_damping_ns_per_m: float | None, stated: Environment
) -> None:
    every = zip(
        (*NAMES, ("active damping", "N s/m")),
        (*typed, active_damping_ns_per_m),
        (*stated.free, stated.active_damping_ns_per_m),
        strict=True,
    )
    for (name, unit), said, known in every:
        if said is not None and abs(said - known) > SAME * abs(known):
            raise AnalysisError(
                f"{origin}: recorded in {name} = {known:g} {unit}, not {said:g} {unit}: leave"
                " that out"
            )
