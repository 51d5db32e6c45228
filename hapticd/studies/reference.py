"""What a study compares with: a scene without some effects, the impedance of several trials
together, and the whole product in lock-step.

Whole product (`run_lockstep`). The stack starts as with `hapticd run`: enabled at rest and the gain
ramped to 1. Then, at one tick, the perturbation starts and the scene's damping steps begin to
count. The records begin at that tick: positions and forces in the servo, torque and velocity from
the probe frames. Converters of the wire quantise, whatever the scene's effects.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from hapticd.client.blocks import BlockDecoder
from hapticd.core.arrays import Complexes, Floats
from hapticd.core.errors import AnalysisError, LinkError
from hapticd.core.params import ServoParams
from hapticd.core.units import PROBE_RATE_HZ
from hapticd.mailbox.layout import PERTURBATION_SAMPLES, Command, Flag, Result, Value
from hapticd.model.effects import ALWAYS
from hapticd.model.scene import Scene
from hapticd.protocol.telemetry import Origin, ProbeDecoder, RingBlock
from hapticd.protocol.view import Records, as_records
from hapticd.run.lockstep import LockStepClient, scene_params
from hapticd.signal.spectra import DEFAULT_LAG, Spectra, spa
from hapticd.zwidth.engine.batch import BatchResult
from hapticd.zwidth.live import signals
from hapticd.zwidth.sources import SATURATED


def candidates(scene: Scene) -> tuple[str, ...]:
    """Return the effects that can be left out."""
    return tuple(effect.key for effect in scene.effects if effect.key not in ALWAYS)


def without(scene: Scene, *keys: str) -> Scene:
    """The scene without these effects."""
    return replace(
        scene, effects=tuple(effect for effect in scene.effects if effect.key not in keys)
    )


def is_linear(scene: Scene) -> bool:
    """Whether the scene is linear, so that its impedance is known exactly."""
    return (
        not any(effect.nonlinearity for effect in scene.effects)
        and scene.environment.wall.side == 0
    )


def spectra_on(
    torque_n: npt.ArrayLike,
    velocity_m_per_s: npt.ArrayLike,
    frequency_hz: Floats,
    lag: int = DEFAULT_LAG,
) -> Spectra:
    """Return spectra of a record at `frequency_hz` (F,), from the whole grid of its window if that
    contains them.
    """
    if lag % DEFAULT_LAG:
        return spa(torque_n, velocity_m_per_s, lag=lag, frequency_hz=frequency_hz)
    at = np.rint(frequency_hz * (2 * lag / PROBE_RATE_HZ)).astype(int)
    return spa(torque_n, velocity_m_per_s, lag=lag).part(at)


def spectra_of(
    found: BatchResult,
    frequency_hz: Floats,
    force_limit_n: float,
    lag: int = DEFAULT_LAG,
) -> list[Spectra]:
    """Return spectra at `frequency_hz` (F,) of every trial that ran to its end without reaching the
    force limit; the others ran away and have no impedance.
    """
    calm = ~found.diverged & (found.max_force_n < SATURATED * force_limit_n)
    return [spectra_on(*found.record(int(one)), frequency_hz, lag) for one in np.flatnonzero(calm)]


def pooled(trials: list[Spectra]) -> Complexes:
    """Return Z (F,) of several trials together, from summed spectra. AnalysisError without
    trials.
    """
    if not trials:
        raise AnalysisError("not stable: no trial ran to its end, so there is no impedance")
    return np.asarray(
        sum(trial.cross for trial in trials) / sum(trial.velocity for trial in trials)
    )


MOST_S = PERTURBATION_SAMPLES / PROBE_RATE_HZ


@dataclass(frozen=True, eq=False)
class LockStepTrial:
    """`position_m`, `force_n` (ticks,); `torque_n`, `velocity_m_per_s` (samples,) interval
    means at 4 kHz.
    """

    position_m: Floats
    force_n: Floats
    torque_n: Floats
    velocity_m_per_s: Floats


def run_lockstep(
    source: str | Path, torque_n: npt.ArrayLike, steps: Sequence[tuple[float, float]]
) -> LockStepTrial:
    """Run the scene `source` under `torque_n` (samples,) [N] at 4 kHz with damping steps (time s,
    level Ns/m).

    AnalysisError for a record of more than 131 s; LinkError if the stack did not run it without
    errors.
    """
    force = np.asarray(torque_n, np.float64)
    if force.size > PERTURBATION_SAMPLES:
        raise AnalysisError(
            f"{force.size / PROBE_RATE_HZ:g} s in lock-step: the waveform holds {MOST_S:g} s; ask"
            " for less"
        )
    servo, board = scene_params(source)
    rate_hz = servo.realtime.rate_hz
    with LockStepClient(servo, board) as bench:
        bench.perturb_load(force)
        bench.enable()
        begin = int(bench.newest["tick"]) + 1
        bench.stack.command(
            Command.PERTURB_START, {Value.SAMPLES: float(force.size), Value.LOOP: 0.0}
        )
        for at_s, level in steps:
            values = {Value.ACTIVE_DAMPING: level, Value.ACTIVE_DAMPING_ON: 1.0}
            bench.stack.command(Command.DAMPING, values, begin + round(at_s * rate_hz))
        found = as_records(bench.run(round(force.size / PROBE_RATE_HZ * rate_hz)))
        refused = [
            answer.result.name
            for answer in bench.stack.gateway.answers()
            if answer.result > Result.SUPERSEDED
        ]
    return _records(servo, found, refused)


def _records(servo: ServoParams, found: Records, refused: list[str]) -> LockStepTrial:
    spoiled = int(((found["flags"] & (Flag.MISSING_IN | Flag.BAD_IN | Flag.LATE)) != 0).sum())
    if refused or spoiled or found["fault"].any():
        raise LinkError(
            f"lock-step: {spoiled} late or damaged ticks, commands refused: {refused or 'none'};"
            " run it with `hapticd run`"
        )
    block = RingBlock(1, 0, 0, found.tobytes(), found)
    (probe,) = ProbeDecoder(servo.device).messages(block, Origin(0, 0, servo.simulated))
    torque, velocity = signals(BlockDecoder().decode(probe))
    return LockStepTrial(found["position_m"].copy(), found["force_n"].copy(), torque, velocity)
