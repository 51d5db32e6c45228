"""Where a trial's record comes from: the batch engine, a daemon's probe stream, or a file. All give a `Recorded`.

A daemon may be the real one (`hapticd.client.Client`) or the same stack on virtual time (`lockstep_bench`): what is used of
it is the `Bench` below. The trial begins disabled, and ends disabled whatever happens; nobody's session is taken over.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from math import nan
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from hapticd.analysis.arrays import Floats
from hapticd.errors import AnalysisError, DaemonDown
from hapticd.measure.progress import Progress, silent
from hapticd.measure.recorded import Recorded
from hapticd.measure.scenes import free_of_walls
from hapticd.measure.sentinel import Sentinel, Watch
from hapticd.plant.compose import compose
from hapticd.plant.scene import Excitation, Scene
from hapticd.sim.engine import simulate
from hapticd.sim.engine.torque import torque_record
from hapticd.units import PROBE_RATE_HZ

WAVEFORM_S = 120.0  # a longer trial repeats it
SETTLE_S = 1.0  # of perturbed motion before the record begins
STATUS_S = 1.0  # between looks at the daemon's state
LEAST_KEPT_S = 8.0
NOISE = Excitation("noise")


@dataclass(frozen=True, slots=True)
class Trial:
    """What a source is asked for: K [N/m], B [Ns/m], M [kg], electrical damping [Ns/m], length, perturbation with its seed."""

    environment: tuple[float, float, float] = (0.0, 0.0, 0.0)
    damping_ns_per_m: float = 0.0
    seconds: float = 90.0
    excitation: Excitation = NOISE
    watch: Watch = field(default_factory=Watch)
    waveform_n: Floats | None = field(default=None, compare=False)  # at 4 kHz, repeated; in place of the excitation


Source = Callable[[Trial, Progress], Recorded]


class Bench(Protocol):
    """What is used of a daemon; see `hapticd.client.Client`."""

    def status(self) -> dict[str, Any]: ...
    def set(self, *, K: float, B: float, M: float, damping: float) -> Any: ...
    def enable(self) -> Any: ...
    def disable(self) -> Any: ...
    def damping(self, value: Any) -> Any: ...
    def wait_for(self, state: str, timeout_s: float = 10.0) -> None: ...
    def perturb_load(self, samples_n: npt.ArrayLike) -> int: ...
    def perturb_start(self, loop: bool = False) -> Any: ...
    def perturb_stop(self) -> Any: ...
    def stream(self, topic: str, seconds: float | None = None) -> Iterator[Any]: ...


def engine_source(scene: Scene, substeps: int = 4) -> Source:
    """Trials of `scene`'s device by the batch engine."""

    def record(trial: Trial, tell: Progress = silent) -> Recorded:
        tell("simulating", 0, 1)
        found = simulate(
            scene, [trial.environment], trial.seconds, trial.excitation.seed, damping=trial.damping_ns_per_m,
            environment=free_of_walls(scene), start=(0.0, 0.0), substeps=substeps, keep="records",
            excitation=trial.excitation if trial.waveform_n is None else trial.waveform_n,
        )  # fmt: skip
        force, velocity = (np.asarray(channel, np.float64) for channel in found.record(0))
        winding = nan if found.winding_c is None else float(found.winding_c[0])
        kept, reason = _watched(trial, force, velocity, winding)
        diverged = f"escape: diverged after {found.diverged_at_s[0]:.3g} s" if found.diverged[0] else ""
        tell("simulated", 1, 1)
        return Recorded(
            force[:kept], velocity[:kept], found.rate_hz, f"engine, scene {scene.name}", True, reason or diverged,
            float(found.max_force_n[0]), compose(scene).force_limit_n,
        )  # fmt: skip

    return record


def file_source(recorded: Recorded) -> Source:
    """The record of a file, whatever is asked; environment and damping are then what the user says they were."""

    def record(trial: Trial, tell: Progress = silent) -> Recorded:
        kept, reason = _watched(trial, recorded.force_n, recorded.velocity_m_per_s, nan, recorded.rate_hz)
        return replace(recorded, force_n=recorded.force_n[:kept], velocity_m_per_s=recorded.velocity_m_per_s[:kept], ended=reason)

    return record


def bench_source(bench: Bench, origin: str = "daemon") -> Source:
    """A trial on the device of a daemon: enable, set, perturb, record at 4 kHz; AnalysisError unless it is `disabled`."""

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
            bench.perturb_start(loop=True)
            return _streamed(bench, trial, origin, tell)
        finally:
            _leave(bench)

    return record


def _waveform(trial: Trial) -> Floats:
    if trial.waveform_n is not None:
        return trial.waveform_n
    return torque_record(trial.excitation, round(PROBE_RATE_HZ * min(WAVEFORM_S, trial.seconds + 10.0)), trial.excitation.seed)


def _streamed(bench: Bench, trial: Trial, origin: str, tell: Progress) -> Recorded:
    sentinel, blocks, next_look_s = Sentinel(trial.watch, PROBE_RATE_HZ), [], STATUS_S
    ended, lost, status, winding_c = "", 0, {}, nan
    for block in _until_silent(bench, trial.seconds + SETTLE_S):
        force, velocity = (_scaled(block, name) for name in ("torque", "velocity"))
        lost += block.gap
        blocks.append((force, velocity))
        taken_s = sum(part[0].size for part in blocks) / PROBE_RATE_HZ
        if taken_s >= next_look_s:
            next_look_s, status = taken_s + STATUS_S, bench.status()
            winding_c = float(status.get("winding_c", nan))
            ended = _gone(status)
        tell(_said(sentinel), round(taken_s), round(trial.seconds + SETTLE_S))
        if taken_s > SETTLE_S:
            ended = ended or sentinel.see(force, velocity, winding_c)
        if ended:
            break
    if not blocks:
        raise AnalysisError("the probe stream is empty: this board has no probe inputs; record with another system and import it")
    ended = ended or _gone(bench.status())
    settle = round(SETTLE_S * PROBE_RATE_HZ)
    force, velocity = (np.concatenate(channel)[settle:] for channel in zip(*blocks, strict=True))
    more = {"lost_samples": lost, "winding_c": winding_c, "config_hash": status.get("config_hash", "")}
    return Recorded(force, velocity, PROBE_RATE_HZ, origin, bool(status.get("simulated", True)), ended, more=more)


def _until_silent(bench: Bench, seconds: float) -> Iterator[Any]:
    """The probe stream; a board that stopped has no more to say, and the state tells why. DaemonDown if the daemon is gone."""
    try:
        yield from bench.stream("probe", seconds=seconds)
    except DaemonDown:
        if not _gone(bench.status()):
            raise


def _gone(status: Mapping[str, Any]) -> str:
    """Why the servo is no longer enabled; "" if it is."""
    return "" if status["state"] == "enabled" else f"{status['state']}: {status.get('cause') or 'somebody ended it'}"


def _scaled(block: Any, name: str) -> Floats:
    scale = block.header["scale"][name]
    return np.asarray(scale["sign"] * (block.records[name].astype(np.float64) - scale["offset_count"]) * scale["per_count"])


def _said(sentinel: Sentinel) -> str:
    needed = sentinel.seconds_needed
    return "recording" if np.isnan(needed) else f"recording; a verdict needs about {needed:.0f} s"


def _leave(bench: Bench) -> None:
    """Force off whatever happened; a stop or a fault has done so already."""
    bench.perturb_stop()
    if bench.status()["state"] == "enabled":
        bench.disable()


def _watched(trial: Trial, force: Floats, velocity: Floats, winding_c: float, rate_hz: float = PROBE_RATE_HZ) -> tuple[int, str]:
    """Samples up to where the sentinel would have ended it, and why."""
    sentinel = Sentinel(trial.watch, rate_hz)
    reason = sentinel.see(force, velocity, winding_c)
    least = round(LEAST_KEPT_S * rate_hz)  # what is recorded already may as well be judged
    return (max(least, round(sentinel.seconds * rate_hz)) if reason else force.size), reason
