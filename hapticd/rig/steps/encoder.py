"""Encoder calibration: noise at rest, the sign by hand, m per count between two positions.

The device stays disabled: a hand moves the handle on request. Sign: the handle moves to positive x,
and counts rise or fall. Scale: it rests against position A, then against B, a stated distance
further to positive x, several times. The counts between scatter with the placing of the handle
(Student's t), and the stated distance has its own tolerance; both are added in quadrature. During
the motion each of the lowest bits has to change: a bit that never does is a broken wire.

An encoder with an index mark reports in a frame how far behind it the mark lies: each passage gives
its place.

Limitations: a handle that is moved by another person than the one asked (the signs of the
repetitions then differ, which is refused).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from math import hypot
from typing import Any

import numpy as np

from hapticd.client.client import Client
from hapticd.core.arrays import Floats, Records
from hapticd.core.errors import AnalysisError
from hapticd.core.params import MOST_CORRECTION
from hapticd.core.units import percent
from hapticd.rig.experiment import begin_step, collect
from hapticd.rig.result import (
    Action,
    Ask,
    Change,
    Finding,
    Request,
    StepResult,
    Value,
    change_of,
    checked,
    deviation,
    mean_half,
    settled,
)
from hapticd.usb import codec, frames
from hapticd.usb.frames import Capability, StatusBit

__all__ = ["Distance", "measure"]

REST_S = 2.0
MOVE_S = 5.0
MOVE_M = 5e-3  # about: any distance will do
HOLD_S = 0.5
REPEATS = 3
LEAST_COUNTS = 100.0  # minimum counts of a usable motion
QUIET_COUNTS = 4.0  # peak to peak at rest
LOW_BITS = 3
MOST_SCATTER = 0.01  # half of the interval, of the distance


@dataclass(frozen=True)
class Distance:
    """Distance between the positions A and B."""

    metres: float
    tolerance_m: float = 10e-6  # half of its 95 % interval


def measure(bench: Client, ask: Ask, distance: Distance, repeats: int = REPEATS) -> StepResult:
    """Request the motions and measure them; x = 0 is then the last position of the handle.

    CommandError unless disabled; AnalysisError for a distance beyond the travel.
    """
    servo = begin_step(bench)
    device = servo["device"]
    position = device["position"]
    _refuse(distance, servo["environment"]["workspace"])

    marks: list[float] = []

    def counts(action: Action, text: str, seconds: float, amount_m: float = 0.0) -> Floats:
        ask(Request(action, text, amount_m))
        records = collect(bench, seconds).records
        found = counts_of(records, position)
        marks.extend(passages(records, found))
        return found

    rest = counts("let go", "let go of the handle and let it come to rest", REST_S)
    moving = counts(
        "move",
        f"from now on, within {MOVE_S:g} s: move the handle slowly to positive x, and hold it",
        MOVE_S,
        MOVE_M,
    )
    steps = []
    for number in range(1, repeats + 1):
        at_a = f"{number} of {repeats}: hold the handle against position A"
        at_b = f"hold it against position B, {1e3 * distance.metres:g} mm further to positive x"
        first = counts("hold", at_a, HOLD_S)
        second = counts("hold", at_b, HOLD_S, distance.metres)
        steps.append(float(np.median(second) - np.median(first)))
    here = counts("origin", "hold the handle where x = 0 shall be", HOLD_S)
    bench.zero()
    arrays = {"rest": rest, "moving": moving, "steps": np.array(steps)}
    if Capability.INDEX & int(bench.status().servo.get("capabilities", 0)):
        arrays["marks"] = np.array(marks) - float(np.median(here))
    found = analyse(arrays, distance, float(position["per_count"]), str(device["home"]["method"]))
    if any(one.key == "sign" and one.value != position["sign"] for one in found.changes):
        # the direction of the motor's push is unknown now: the earlier verification is void
        found += StepResult("encoder", changes=[Change("commissioning", "signs_verified", False)])
    return found


def _refuse(distance: Distance, travel: Mapping[str, float]) -> None:
    room_m = travel["upper_m"] - travel["lower_m"]
    if distance.metres >= room_m:
        raise AnalysisError(
            f"{distance.metres:g} m from A to B, and the handle travels {room_m:g} m by the device"
            " file; is it in millimetres?"
        )


def counts_of(records: Records, position: Mapping[str, Any]) -> Floats:
    """Return encoder counts (n,) since the origin, by the scale `position` of the hello."""
    m_per_count = position["sign"] * position["per_count"]
    return np.asarray(np.round(records["position_m"] / m_per_count))


def passages(records: Records, counts: Floats) -> Floats:
    """Return the counts (k,) of the index mark, from the frames of `records` (n,) with `counts`."""
    passed = np.flatnonzero(records["status"] & StatusBit.INDEX)
    heads = (frames.IN_SEALED.unpack(bytes(one)) for one in records["in_frame"][passed])
    behind = np.array([head[codec.HEAD_INDEX_OFFSET] for head in heads])
    return np.asarray(counts[passed] - behind)


def analyse(
    arrays: dict[str, Floats], distance: Distance, m_per_count: float, home: str = "none"
) -> StepResult:
    """Evaluate counts at rest (n,), during the motion (m,), and of the steps from A to B (k,).
    `marks` are those of an index mark from x = 0. `m_per_count` and the method to `home` are those
    of the device file.
    """
    rest, moving, steps = (arrays[name] for name in ("rest", "moving", "steps"))
    went = float(np.median(moving[-len(moving) // 10 :]) - moving[0])
    values = [deviation("noise at rest", rest, "counts rms")]
    at_rest = checked(
        f"{np.ptp(rest):g} counts peak to peak at rest",
        bool(np.ptp(rest) <= QUIET_COUNTS),
        "let go of it and keep the table still; otherwise check shield and supply of the encoder",
    )
    findings = [at_rest, _moving(moving, went), _steps(steps, went)]
    if not settled(findings):
        return StepResult("encoder", values, findings, (), arrays)
    scale = scale_of(steps, distance)
    values.append(scale)
    findings.append(_believable(scale, m_per_count, distance))
    changes = [Change("position", "sign", 1 if went > 0.0 else -1), change_of(scale)]
    found = StepResult("encoder", values, findings, changes, arrays)
    if not found.settled or "marks" not in arrays:
        return found
    return found + _index(np.sign(went) * scale.value * arrays["marks"], scale.value, home)


def scale_of(steps: Floats, distance: Distance) -> Value:
    """Return m per count, from the counts (k,) of k times the same distance, k at least 2."""
    sizes = np.abs(steps)
    mean = float(sizes.mean())
    relative = hypot(mean_half(sizes) / mean, distance.tolerance_m / distance.metres)
    value = distance.metres / mean
    return Value.around("position.m_per_count", value, "m", relative * value)


def _index(place_m: Floats, m_per_count: float, home: str) -> StepResult:
    """Check that the passages of the index mark, at `place_m` (k,), agree; return its position."""
    if not len(place_m):
        remedy = "move the handle further, or use another way to home"
        missed = Finding("the index mark was not passed", "warning", remedy)
        return StepResult("encoder", findings=[missed])
    apart_m = float(np.ptp(place_m))
    finding = checked(
        f"{len(place_m)} passages of the index mark, {apart_m / m_per_count:.2g} counts apart",
        apart_m / m_per_count <= QUIET_COUNTS,
        "counts are lost, or there are several marks: do not home by it",
    )
    if finding.verdict != "ok":
        return StepResult("encoder", findings=[finding])
    half_m = max(apart_m, m_per_count) / 2.0
    mark = Value.around("home.position_m", float(np.median(place_m)), "m", half_m)
    changes = [Change("home", "position_m", float(f"{mark.value:.6g}"))] if home == "index" else []
    return StepResult("encoder", [mark], [finding], changes)


def _moving(moving: Floats, went: float) -> Finding:
    if not abs(went) >= LEAST_COUNTS:
        return Finding(
            f"the handle was moved, and the encoder went {went:g} counts",
            "refused",
            "encoder stuck: check its cable and supply, and whether the handle was moved",
        )
    low = moving.astype(np.int64)
    dead = [bit for bit in range(LOW_BITS) if len(np.unique(low >> bit & 1)) == 1]
    if not dead:
        return Finding(f"the lowest {LOW_BITS} bits all change", "ok")
    return Finding(
        f"bit {dead[0]} of the count never changes: {1 << dead[0]} counts are dead",
        "warning",
        "check the interpolator and the width of the counter",
    )


def _steps(steps: Floats, went: float) -> Finding:
    same = bool((np.sign(steps) == np.sign(went)).all()) and went != 0.0
    if same and (np.abs(steps) >= LEAST_COUNTS).all():
        return Finding("A to B goes the way of the motion before", "ok")
    return Finding(
        f"from A to B {', '.join(f'{step:g}' for step in steps)} counts",
        "refused",
        "B lies to positive x of A, as the motion before: repeat the step",
    )


def _believable(scale: Value, m_per_count: float, distance: Distance) -> Finding:
    ratio = scale.value / m_per_count
    if not 1.0 / MOST_CORRECTION <= ratio <= MOST_CORRECTION:
        return Finding(
            f"{scale.value:.4g} m per count is {ratio:.3g} times the value in the device file",
            "refused",
            f"is the distance {distance.metres:g} m right, in metres? If so, correct the file",
        )
    half = scale.half / scale.value
    return checked(
        f"the scale is known to {percent(half)}",
        half <= MOST_SCATTER,
        "rest the handle against something firm at A and B",
    )
