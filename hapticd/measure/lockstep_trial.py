"""One trial of a scene with the whole product: servo, wire, pyusb and simulated board on virtual time.

The stack comes up as after `hapticd run`: enabled at rest and the gain ramped to 1. Then, at one tick, the perturbation starts
and the scene's damping steps begin to count. The records begin at that tick: positions and forces as the servo knew them,
torque and velocity as the probe frames brought them. Converters of the wire quantise, whether the scene asks for it or not.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil
from pathlib import Path

import numpy as np
import numpy.typing as npt

from hapticd.analysis.arrays import Floats
from hapticd.assembly.lockstep import LockStep
from hapticd.assembly.scene import scene_params
from hapticd.errors import AnalysisError, LinkError
from hapticd.mailbox.layout import PERTURBATION_SAMPLES, TELEMETRY, Command, Flag, Result, Value
from hapticd.params import ServoParams
from hapticd.units import PROBE_RATE_HZ
from hapticd.wire import frames

READY_TICKS = 5
MOST_S = PERTURBATION_SAMPLES / PROBE_RATE_HZ
RECORD = np.dtype([tuple(field) for field in TELEMETRY])
COUNT_PLACE = 5  # of an IN frame


@dataclass(frozen=True, eq=False)
class Flown:
    """`position_m`, `force_n` (ticks,); `torque_n`, `velocity_m_per_s` (samples,) interval means at 4 kHz."""

    position_m: Floats
    force_n: Floats
    torque_n: Floats
    velocity_m_per_s: Floats


def fly(source: str | Path, torque_n: npt.ArrayLike, steps: Sequence[tuple[float, float]]) -> Flown:
    """Fly the scene `source` under `torque_n` (samples,) [N] at 4 kHz with damping steps (time s, level Ns/m).

    AnalysisError for a record of more than 131 s; LinkError if the stack did not fly it without a flaw.
    """
    force = np.asarray(torque_n, np.float64)
    if force.size > PERTURBATION_SAMPLES:
        raise AnalysisError(f"{force.size / PROBE_RATE_HZ:g} s in lock-step: the waveform holds {MOST_S:g} s; ask for less")
    servo, board = scene_params(source)
    rate_hz = servo.realtime.rate_hz
    with LockStep(servo, board, keep=False) as stack:
        stack.load_waveform(_counts(servo, force))
        stack.run(READY_TICKS)
        stack.do(Command.ENABLE)
        stack.run(ceil(servo.safety.enable_ramp_s * rate_hz) + READY_TICKS)
        begin = int(np.frombuffer(stack.run(1), RECORD)["tick"][-1]) + 1
        stack.command(Command.PERTURB_START, {Value.SAMPLES: float(force.size), Value.LOOP: 0.0})
        for at_s, level in steps:
            values = {Value.ADDED_DAMPING: level, Value.ADDED_DAMPING_ON: 1.0}
            stack.command(Command.DAMPING, values, begin + round(at_s * rate_hz))
        found = np.frombuffer(stack.run(round(force.size / PROBE_RATE_HZ * rate_hz)), RECORD)
        refused = [answer.result.name for answer in stack.gateway.answers() if answer.result > Result.SUPERSEDED]
    return _records(servo, found[found["tick"] >= begin], refused)


def _counts(servo: ServoParams, force_n: Floats) -> list[int]:
    scale = servo.device.probe_torque
    return [scale.to_count(float(value), -32768, 32767) for value in force_n]


def _records(servo: ServoParams, found: "np.ndarray[tuple[int], np.dtype[np.void]]", refused: list[str]) -> Flown:
    spoiled = int(((found["flags"] & (Flag.MISSING_IN | Flag.BAD_IN | Flag.LATE)) != 0).sum())
    if refused or spoiled or found["fault"].any():
        raise LinkError(f"lock-step: {spoiled} spoiled ticks, commands refused: {refused or 'none'}; fly it with `hapticd run`")
    frame = np.frombuffer(found["in_frame"].tobytes(), np.uint8).reshape(len(found), frames.IN_BYTES)
    pairs = frame[:, frames.IN_HEAD.size : frames.IN_HEAD.size + frames.IN_PAIRS.size].copy().view("<i2").reshape(len(found), -1, 2)
    known = np.arange(frames.PROBE_MAX) < frame[:, COUNT_PLACE, None]
    device = servo.device
    torque, velocity = (
        scale.sign * (pairs[known][:, place] - scale.offset_count) * scale.per_count
        for place, scale in enumerate((device.probe_torque, device.probe_velocity))
    )
    return Flown(found["position_m"].copy(), found["force_n"].copy(), torque, velocity)
