"""Motor calibration: the sign by pushes, offset and gain by masses or by a known spring.

Sign (`measure_sign`). Position already has its sign (`rig encoder`, by hand). Pushes of PUSH_S,
each half as strong again as the last, go to positive x until the handle moves, then to negative x.
If both move it with the force, the file's sign is right; if both move it against the force, the
other one is. A motion in the same direction both times is gravity or a hand, and is refused. Only
these pushes make force, and the servo ends one that goes wrong.

Gain (`measure_gain`). A spring holds the handle while masses hang from it. A far wall draws it a
little to either side and lets it creep back. It comes to rest once from above and once from below,
and Coulomb friction cancels in the mean. At rest

    s F + o + a w = 0,     w = m g r / R

with the commanded F, newtons per commanded newton s and the offset o. The masses hang at the radius
r; R is that of the endpoint. They pull to the side a = +-1. The line F(w) gives s and o. Its
residuals show whether the motor is linear. They give the intervals (Student's t), together with a
friction that differs from reading to reading by a share REPEATS: a few masses may fit a line by
chance.

Limitations: a friction that differs from one reading to the next (it appears in the residuals).

Spring (`measure_spring`). It gives the gain where no masses can hang from the handle. The spring of
k [N/m] holds the handle, and a far wall pulls at it to either side. The force goes up in LEVELS
steps and down again in the same ones. At rest

    s F + o = k (x - x0) +- f

with F, s and o as above, the place x0 where the spring is slack, and the friction f. Friction has
opposite signs on the way up and on the way down, so it cancels in the mean of the two. The line
x(F) has the slope s / k. o cannot be separated from x0; it is measured without a spring
(`measure_offset`). Forces of both signs are on the line, so its residuals show a nonlinear motor, a
nonlinear spring, or a lever that slips.

Limitations: a spring that buckles or is stretched to its end (residuals), and a wrong scale of
position (`rig encoder` comes first).
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from math import floor, hypot
from typing import Any

import numpy as np

from hapticd.client.client import Client
from hapticd.core.arrays import Floats
from hapticd.core.errors import AnalysisError
from hapticd.core.params import COMMISSIONING_SHARE, MOST_CORRECTION
from hapticd.core.units import percent
from hapticd.rig.experiment import (
    LOOK_S,
    Push,
    begin_step,
    collect,
    identity_of,
    pull,
    push,
    ready,
    release,
    under_force,
)
from hapticd.rig.result import (
    Ask,
    Change,
    Finding,
    Fit,
    Request,
    StepResult,
    Value,
    change_of,
    checked,
    line,
    mean_half,
    settled,
)
from hapticd.settings.device import signs_hash
from hapticd.usb.codec import I16_HIGHEST

__all__ = ["Masses", "Spring", "measure_gain", "measure_offset", "measure_sign", "measure_spring"]

PUSH_S = 0.02
FIRST_SHARE = 0.05  # of the permitted force
STRONGER = 1.5
MOVED_M = 1e-4
STILL_M = 2e-5
STILL_S = 0.2
STILL_LOOKS = 25  # 5 s
GRAVITY_M_PER_S2 = 9.80665
SAG_M = 8e-3  # of the spring under the heaviest mass: an undamped stiff one rings
STIFFEST_N_PER_M = 500.0
DRAWN_SHARE = 0.1  # of the force limit
DRAW_S = 1.0
SETTLE_S = 0.5
READ_S = 1.0
MOST_SHARE = 0.8  # of the force limit that masses may use
REPEATS = 0.1  # assumed relative variation of friction between readings
MOST_RESIDUAL = 0.02  # of the span


@dataclass(frozen=True)
class Masses:
    """Hanging masses, and their force at the endpoint."""

    kilograms: tuple[float, ...]  # 0 is one of them
    pulls_to: int = -1  # side of x to which they pull
    ratio: float = 1.0  # of the radius at which they hang to that of the endpoint
    tolerance: float = 1e-3  # relative, half of the 95 % interval of all of them together

    @property
    def weights_n(self) -> Floats:
        """Force at the endpoint (n,)."""
        return GRAVITY_M_PER_S2 * self.ratio * np.array(self.kilograms)


def measure_sign(bench: Client, ask: Ask) -> StepResult:
    """Push to both sides and compare the directions of motion. CommandError unless disabled."""
    servo = begin_step(bench)
    _require_encoder(servo)
    text = "let go of the handle, somewhere in the middle of its travel; it will be pushed gently"
    ask(Request("let go", text))
    pushes = [moving_push(bench, side * allowed_n(servo)) for side in (1.0, -1.0)]
    agree = {bool(one.moved_m * one.force_n > 0.0) for one in pushes}
    findings = [_pushed(one) for one in pushes]
    if settled(findings):
        findings.append(_sign(agree))
    changes = _verified(bench, servo["device"], pushes[-1], agree == {True})
    arrays = {
        f"{name}_{number}": np.asarray(one.records[name])
        for number, one in enumerate(pushes)
        for name in ("tick", "position_m", "force_n", "fault")
    }
    return StepResult("motor", (), findings, changes, arrays)


def _verified(bench: Client, device: Mapping[str, Any], last: Push, right: bool) -> list[Change]:
    """Return the verified sign of the force and its provenance: board and life. `right`: the file's
    sign is correct.
    """
    sign = int(device["force"]["sign"]) * (1 if right else -1)
    serial = str(device["serial"])
    board = identity_of(bench, last.records)
    seen = signs_hash(serial, board.firmware, sign, int(device["position"]["sign"]))
    changes = [
        Change("force", "sign", sign),
        Change("commissioning", "signs_verified", True),
        Change("commissioning", "serial", serial),
        Change("commissioning", "firmware", board.firmware),
        Change("commissioning", "signs", seen),
    ]
    if board.life is not None:
        changes.append(Change("commissioning", "life", board.life))
    return changes


def _require_encoder(servo: Mapping[str, Any]) -> None:
    """Raise AnalysisError while the encoder of this board is not measured: the sign of position
    decides the direction of a push.
    """
    position = servo["device"]["position"]
    own = str(servo["device"]["serial"])
    if position.get("serial", "") not in ("", own):
        raise AnalysisError(
            f"the encoder was measured at the board {position['serial']!r}, this one is {own!r};"
            " its sign decides what a push shows: first `hapticd rig encoder`, and start the daemon"
            " again"
        )


def allowed_n(servo: Mapping[str, Any]) -> float:
    """Return the strongest push: a tenth of the device's force, as in commissioning, whether or not
    the signs are verified, reduced for a motor that is not yet calibrated.
    """
    return limit_n(servo, COMMISSIONING_SHARE / MOST_CORRECTION)


def limit_n(servo: Mapping[str, Any], share: float = 1.0) -> float:
    """Return the maximum command: at most `share` of the device's own force."""
    own_n = share * float(servo["device"]["force_limit_n"])
    return min(own_n, float(servo["safety"]["force_limit_n"]))


def moving_push(bench: Client, most_n: float) -> Push:
    """Return the first push towards `most_n` that moves the handle, or the one with `most_n`.
    AnalysisError if the handle does not stand still.
    """
    share = FIRST_SHARE
    while True:
        await_rest(bench)
        if bench.status().state in ("fault", "stopped"):
            bench.reset()
        with ready(bench):
            found = push(bench, share * most_n, PUSH_S)
        if bench.status().state == "fault" and not abs(found.moved_m) >= MOVED_M:
            raise AnalysisError(f"the push ended: {bench.status().cause}; repeat the step")
        if abs(found.moved_m) >= MOVED_M or share >= 1.0:
            if bench.status().state == "fault":
                bench.reset()  # a push that the servo ended was seen; the next one may follow
            return found
        share = min(1.0, STRONGER * share)


def await_rest(bench: Client) -> None:
    """Wait until the handle stands still. AnalysisError after 5 s."""
    for _ in range(STILL_LOOKS):
        if float(np.ptp(collect(bench, STILL_S).records["position_m"])) <= STILL_M:
            return
    raise AnalysisError(
        f"the handle moves by more than {1e6 * STILL_M:g} um for"
        f" {STILL_LOOKS * STILL_S:g} s; take your hand off, keep the table still, and repeat"
    )


def _pushed(one: Push) -> Finding:
    return checked(
        f"{one.force_n:+.3g} N moved the handle by {1e3 * one.moved_m:+.3g} mm",
        abs(one.moved_m) >= MOVED_M,
        "no authority: check emergency stop, amplifier and motor, and release the handle",
        "refused",
    )


def _sign(agree: set[bool]) -> Finding:
    if agree == {True}:
        return Finding("it goes with the force both ways: the sign is right", "ok")
    if agree == {False}:
        return Finding(
            "it goes against the force both ways: the other sign is right",
            "warning",
            "the device file gets it; start the daemon again",
        )
    return Finding(
        "it goes the same way whatever the force is",
        "refused",
        "another force moves it: let go of it, level the axis, and repeat",
    )


def measure_gain(bench: Client, ask: Ask, masses: Masses) -> StepResult:
    """Request each mass and fit the line. CommandError unless disabled; AnalysisError if the signs
    are not verified, or masses are too few or too heavy.
    """
    servo = begin_step(bench, "the gain is measured")
    _refuse(servo, masses)
    weights = masses.weights_n
    stiffness = min(STIFFEST_N_PER_M, float(weights.max()) / SAG_M)
    drawn_n = DRAWN_SHARE * limit_n(servo)
    readings = []
    with under_force(bench):
        bench.set(K=stiffness, ramp_s=1.0)
        for mass_kg in masses.kilograms:
            ask(Request("hang", f"hang {mass_kg:g} kg and let go of the handle", mass_kg))
            readings.append(rests_n(bench, drawn_n))
    ask(Request("let go", "take the masses off and let go of the handle"))
    return analyse(weights, np.array(readings), masses, servo["device"])


def rests_n(bench: Client, drawn_n: float) -> list[float]:
    """Return mean commanded forces [N] at rest, after `drawn_n` drew the handle to either side and
    was released. It draws from the present position: equally far to both sides, also under a load.
    """
    found = []
    for force_n in (drawn_n, -drawn_n):
        at_m = float(collect(bench, LOOK_S).records["position_m"].mean())
        pull(bench, force_n, at_m, DRAW_S, SETTLE_S)
        release(bench, DRAW_S, SETTLE_S)
        found.append(float(collect(bench, READ_S).records["force_n"].mean()))
    return found


def _refuse(servo: dict[str, Any], masses: Masses) -> None:
    if len(set(masses.kilograms)) < 3 or min(masses.kilograms) < 0.0:
        raise AnalysisError(
            "a line with residuals takes three masses at least; name 0 and two more"
        )
    heaviest_n = float(masses.weights_n.max())
    if heaviest_n > MOST_SHARE * limit_n(servo):
        raise AnalysisError(
            f"{max(masses.kilograms):g} kg pulls with {heaviest_n:.3g} N, more than"
            f" {MOST_SHARE:g} of the {limit_n(servo):g} N that may be commanded; hang less, or is"
            " it in grams?"
        )


def analyse(
    weights_n: Floats, readings_n: Floats, masses: Masses, device: Mapping[str, Any]
) -> StepResult:
    """Fit commanded forces (n, 2) under `weights_n` (n,), with scale and limits of the hello's
    `device`.
    """
    means = readings_n.mean(axis=1)
    found = line(weights_n, means)
    slope, intercept = found.values.tolist()
    slope_half, intercept_half = found.halves.tolist()
    scale = -masses.pulls_to / slope
    unequal = REPEATS * friction_of(readings_n)
    relative = hypot(slope_half, unequal / float(np.ptp(weights_n))) / abs(slope)
    gain = full_scale(scale, device, hypot(relative, masses.tolerance))
    offset = offset_of(intercept, hypot(intercept_half, unequal), device)
    # half the difference between rest from above and from below: at most the friction, and less
    # where a load came to rest beyond its place
    halves = abs(scale) * np.abs(np.diff(readings_n, axis=1))[:, 0] / 2.0
    left = Value.around("friction left at rest", float(halves.mean()), "N", mean_half(halves))
    remedy = "is one mass typed wrong, does the lever slip, or the handle stick? Repeat the step"
    return StepResult(
        "motor",
        (gain, offset, left),
        (straight(found, means, "span", remedy), believable(scale)),
        (*full_scale_changes(gain, scale, device), zero_change(offset)),
        {"weights_n": weights_n, "readings_n": readings_n},
    )


def straight(found: Fit, readings: Floats, of: str, remedy: str) -> Finding:
    """Check that the `readings` (n,) lie on the line `found`; `of` names their span."""
    share = float(np.abs(found.residuals).max() / np.ptp(readings))
    what = f"the largest residual is {percent(share)} of the {of}"
    return checked(what, share <= MOST_RESIDUAL, remedy, "refused")


def friction_of(readings_n: Floats) -> float:
    """Return half the mean difference of forces (n, 2) at rest from above and from below."""
    return float(np.abs(np.diff(readings_n, axis=1)).mean()) / 2.0


def full_scale(scale: float, device: Mapping[str, Any], relative: float) -> Value:
    """Return the full scale of the force; one newton by the hello's `device` is `scale` N."""
    full_n = scale * I16_HIGHEST * float(device["force"]["per_count"])
    return Value.around("force.full_scale_n", full_n, "N", relative * abs(full_n))


def offset_of(force_n: float, half_n: float, device: Mapping[str, Any]) -> Value:
    """Return the count of zero force, for the command `force_n` by the scale of `device`."""
    force = device["force"]
    per_n = int(force["sign"]) / float(force["per_count"])
    count = float(force["offset_count"]) + per_n * force_n
    return Value.around("force.offset_count", count, "counts", abs(per_n) * half_n)


def zero_change(offset: Value) -> Change:
    """Return the change for the count of zero force; the device file states no interval for it."""
    return Change("force", "offset_count", offset.rounded)


def full_scale_changes(gain: Value, scale: float, device: Mapping[str, Any]) -> Iterator[Change]:
    """Yield the changes for the full scale `gain`, `scale` times that of the hello's `device`. The
    board clamps counts: a motor weaker than its file states also has a lower maximum force, and
    homing cannot use more than that.
    """
    yield change_of(gain)
    least = scale * gain.low / gain.value
    if least < 1.0:
        reach_n = floor(least * device["force_limit_n"] * 1e3) / 1e3
        yield Change("limits", "force_n", reach_n)
        if device["home"]["force_n"] > reach_n:
            yield Change("home", "force_n", reach_n)


def believable(scale: float) -> Finding:
    """Check `scale`, the newtons per commanded newton, against the device file."""
    return checked(
        f"a commanded newton is {scale:.4g} N",
        1.0 / MOST_CORRECTION <= scale <= MOST_CORRECTION,
        "check masses (kg), radii and side; if they are correct, correct force.full_scale_n",
        "refused",
    )


# --- a known spring -------------------------------------------------------------------------------
LEVELS = 3
OVERSHOOT = 1.3  # beyond the last level, so that the way down begins above it
MOST_M = 4e-3  # of stretch
SHARE = 0.4  # of the force limit, at most
RAMP_S = 0.5
SPRING_SETTLE_S = 0.8
SPRING_READ_S = 0.5
OFFSET_REPEATS = 3
HELD_N_PER_M = 200.0  # rendered while the offset is measured
Rest = tuple[float, float]  # means at rest: commanded force [N] and position [m]


@dataclass(frozen=True)
class Spring:
    """A spring between handle and frame."""

    n_per_m: float
    tolerance: float = 0.01  # relative, half of the 95 % interval


def measure_spring(bench: Client, ask: Ask, spring: Spring) -> StepResult:
    """Request the spring, pull at it and fit the line. CommandError unless disabled; AnalysisError
    if the signs are not verified.
    """
    servo = begin_step(bench, "the gain is measured")
    most_n = min(SHARE * limit_n(servo), MOST_M * spring.n_per_m) / OVERSHOOT
    text = f"put the spring of {spring.n_per_m:g} N/m between handle and frame, and let go"
    ask(Request("spring", text, spring.n_per_m))
    with under_force(bench):
        start_m = float(collect(bench, SPRING_READ_S).records["position_m"].mean())
        loops = [_loop(bench, side * most_n, start_m) for side in (1.0, -1.0)]
    ask(Request("let go", "take the spring off and let go"))
    return analyse_spring(np.array(loops).reshape(-1, 2, 2), spring, servo["device"])


def _loop(bench: Client, most_n: float, start_m: float) -> list[list[Rest]]:
    """Return rests at each level, once on the way up and once on the way down: (LEVELS, 2)."""
    levels = [most_n * step / LEVELS for step in range(1, LEVELS + 1)]
    up = [_rest(bench, level, start_m) for level in levels]
    _rest(bench, most_n * OVERSHOOT, start_m)
    down = [_rest(bench, level, start_m) for level in reversed(levels)]
    release(bench, RAMP_S, SPRING_SETTLE_S)
    return [[first, second] for first, second in zip(up, reversed(down), strict=True)]


def _rest(bench: Client, force_n: float, start_m: float) -> Rest:
    pull(bench, force_n, start_m, RAMP_S, SPRING_SETTLE_S)
    found = collect(bench, SPRING_READ_S).records
    return float(found["force_n"].mean()), float(found["position_m"].mean())


def analyse_spring(rests: Floats, spring: Spring, device: Mapping[str, Any]) -> StepResult:
    """Fit `rests` (n, 2, 2), of levels, way up and down, [N] and [m], with scale and limits of the
    hello's `device`.
    """
    forces, places = rests.mean(axis=1).T
    found = line(forces, places)
    slope = float(found.values[0])
    scale = spring.n_per_m * slope
    ways = np.diff(rests, axis=1)[:, 0]
    friction_m = float(np.abs(ways[:, 1] - slope * ways[:, 0]).mean()) / 2.0
    slope_half = hypot(float(found.halves[0]), REPEATS * friction_m / float(np.ptp(forces)))
    gain = full_scale(scale, device, hypot(slope_half / abs(slope), spring.tolerance))
    friction = spring.n_per_m * friction_m
    seen = Value.around("friction seen", friction, "N", friction)
    remedy = "does the spring buckle or end, the lever slip, or the handle stick? Repeat the step"
    return StepResult(
        "motor",
        (gain, seen),
        (straight(found, places, "stretch", remedy), believable(scale)),
        tuple(full_scale_changes(gain, scale, device)),
        {"rests": rests},
    )


def measure_offset(bench: Client, ask: Ask, repeats: int = OFFSET_REPEATS) -> StepResult:
    """Measure the count of zero force: a rendered spring holds the free handle, which comes to rest
    from either side. CommandError unless disabled; AnalysisError if the signs are not verified.
    """
    servo = begin_step(bench, "the offset is measured")
    ask(Request("let go", "release the handle, with no mass attached"))
    drawn_n = DRAWN_SHARE * limit_n(servo)
    with under_force(bench):
        bench.set(K=HELD_N_PER_M, ramp_s=1.0)
        readings = np.array([rests_n(bench, drawn_n) for _ in range(repeats)])
    means = readings.mean(axis=1)
    half_n = hypot(mean_half(means), REPEATS * friction_of(readings))
    offset = offset_of(float(means.mean()), half_n, servo["device"])
    finding = Finding(f"{offset.value:.3g} counts make no force", "ok")
    return StepResult(
        "motor", (offset,), [finding], [zero_change(offset)], {"readings_n": readings}
    )
