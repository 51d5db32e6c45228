"""A trial of a scene by the whole product on virtual time.

The stack starts as with `hapticd run`: enabled at rest and the gain ramped to 1. Then, at one tick,
the perturbation starts and the scene's damping steps begin to count. The records begin at that
tick: positions and forces in the servo, torque and velocity from the probe frames. Converters of
the wire quantise, whatever the scene's effects.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from hapticd.client.blocks import BlockDecoder
from hapticd.core.arrays import Floats
from hapticd.core.errors import AnalysisError, LinkError
from hapticd.core.params import ServoParams
from hapticd.core.units import PROBE_RATE_HZ
from hapticd.mailbox.layout import PERTURBATION_SAMPLES, Command, Flag, Result, Value
from hapticd.protocol.telemetry import Origin, ProbeDecoder, RingBlock
from hapticd.protocol.view import Records, as_records
from hapticd.run.lockstep import LockStepClient, scene_params
from hapticd.zwidth.live import signals

__all__ = ["LockStepTrial", "run_lockstep"]

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
