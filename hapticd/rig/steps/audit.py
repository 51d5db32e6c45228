"""What is commanded against what is delivered: active damping and force, while a hand moves.

Damping is that of `guard.delivered`, which `hapticd status` shows all the time: what the motor
does at equal force by the velocity of the encoder, over the last four seconds. Force is the slope
of what the motor makes by its current on what is commanded, at equal velocity. Both need the force
of an ampere, which `rig motor --winding` measures.

What would break it: scales of current and position that are wrong (it is wrong by as much).
"""

from collections.abc import Mapping, Sequence
from math import hypot
from typing import Any

import numpy as np

from hapticd.client.blocks import Records
from hapticd.client.client import Client
from hapticd.core.params import ServoParams, from_plain
from hapticd.guard.delivered import Delivered
from hapticd.rig.estimate import least_squares
from hapticd.rig.experiment import begin, undamped
from hapticd.rig.hand import Ask
from hapticd.rig.result import Finding, StepResult, Value, checked
from hapticd.rig.steps.hand_motion import (
    LEAST_N,
    WAITS,
    Means,
    joined,
    means_of,
    moved,
    raw_of,
    unknown_ampere,
)
from hapticd.signal.delivered import CALIBRATION, Estimate

__all__ = ["measure"]

SECONDS = 6.0
LOW = 0.8  # of what is commanded
HIGH = 1.2
SETTLED = 1  # pieces until hand and damping have settled


def measure(
    bench: Client, ask: Ask, level: float | None = None, seconds: float = SECONDS
) -> StepResult:
    """Ask a hand to move the handle for `seconds` with the active damping `level` [N s/m], half of
    the device's limit by default. CommandError unless disabled; AnalysisError where signs are not
    verified, or force ends meanwhile.
    """
    servo = begin(bench, WAITS)
    if missing := unknown_ampere(servo["device"]):
        return StepResult("audit", (), missing)
    wanted = 0.5 * servo["device"]["active_damping_limit_ns_per_m"] if level is None else level
    with undamped(bench):
        bench.damping(wanted)
        pieces = moved(bench, ask, seconds)
    return analyse(pieces[SETTLED:], servo)


def analyse(pieces: Sequence[Records], servo: Mapping[str, Any]) -> StepResult:
    """What consecutive records, in `pieces`, say on the `servo` of a hello."""
    params = from_plain(ServoParams, dict(servo))
    follows = Delivered(params, lambda: None)
    for piece in pieces:
        follows.take(piece)
    rate_hz = params.realtime.rate_hz
    means = joined([means_of(one, params.device.motor_n_per_a, rate_hz) for one in pieces])
    values, findings = _damping(follows.estimate)
    more_values, more_findings = _force(means, params)
    arrays = raw_of(pieces)
    return StepResult("audit", values + more_values, findings + more_findings, arrays=arrays)


def _damping(found: Estimate) -> tuple[list[Value], list[Finding]]:
    """Delivered of commanded damping."""
    if found.estimate_ns_per_m is None or found.low is None or found.high is None:
        what = f"active damping of {found.commanded:.3g} N s/m: {found.basis}"
        return [], [Finding(what, "not done", "move the handle more, and repeat")]
    value = Value("delivered damping", found.estimate_ns_per_m, "N s/m", found.low, found.high)
    said = f"active damping: {found.estimate_ns_per_m:.3g} of {found.commanded:.3g} N s/m"
    return [value], [_delivered(f"{said}, by {found.basis}", value, found.commanded)]


def _force(means: Means, servo: ServoParams) -> tuple[list[Value], list[Finding]]:
    """Slope of the motor's force on the commanded one."""
    if float(means.force_n.std()) < LEAST_N:
        remedy = "move the handle more, and repeat"
        return [], [Finding("force: next to none was commanded", "not done", remedy)]
    ones = np.ones_like(means.force_n)
    columns = np.column_stack([means.force_n, means.velocity_m_per_s, ones])
    counted_n = servo.device.motor_n_per_a * servo.device.current.per_count
    found = least_squares(columns, means.motor_n, ones / counted_n, least=1.0)
    share = float(found.values[0])
    half = hypot(float(found.halves[0]), CALIBRATION * share)
    value = Value.around("delivered force", share, "of what is commanded", half)
    return [value], [_delivered(f"force: {share:.3g} of what is commanded, by the current", value)]


def _delivered(what: str, value: Value, commanded: float = 1.0) -> Finding:
    """A finding for the interval of what is delivered over what is `commanded`."""
    if value.high / commanded < LOW:
        remedy = "too little: look at amplifier, supply and resistance compensation"
        return Finding(what, "warning", remedy)
    remedy = "too much: look at the scales of current and force, and at the compensation"
    return checked(what, value.low / commanded <= HIGH, remedy)
