"""Which way the motor pushes, and how hard: the sign by pushes, offset and gain by masses.

Sign (`measure_sign`). Position has its sign already (`rig encoder`, by hand). Pushes of PUSH_S,
each half as strong again as the last, go to positive x until the handle moves, then to negative x.
Both move it with the force, or both against it: the file's sign is right, or the other one is. What
moves it the same way both times is gravity or a hand, and is refused. Nothing else than these
pushes makes force, and the servo ends one that goes wrong.

Gain (`measure_gain`). A spring holds the handle while masses hang from it. A far wall draws it a
little to either side and lets it creep back, so that it comes to rest once from above and once from
below, and Coulomb friction cancels in the mean. At rest

    s F + o + a w = 0,     w = m g r / R

with the commanded F, what a commanded newton really is (s), the offset o, the side a = +-1 to which
the masses pull, and the radii r at which they hang and R of the endpoint. The line F(w) gives s and
o. Its residuals show whether the motor is linear, and give the intervals (Student's t), together
with a friction that differs from reading to reading by a share REPEATS: few masses may lie on a
line by chance.

What would break it: a friction that differs from one reading to the next (it shows as residuals).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import floor, hypot, inf, sqrt
from typing import Any, NamedTuple

import numpy as np

from hapticd.client.client import Client
from hapticd.core.arrays import Floats
from hapticd.core.errors import AnalysisError
from hapticd.core.params import COMMISSIONING_SHARE, MOST_CORRECTION
from hapticd.core.units import percent
from hapticd.rig.hand import Ask, Request
from hapticd.rig.push import LOOK_S, Pushed, push, ready, wall_of
from hapticd.rig.records import collect, identity_of
from hapticd.rig.result import (
    UPPER_END,
    Change,
    Finding,
    StepResult,
    Value,
    change_of,
    rounded,
    settled,
)
from hapticd.rig.steps.link import require_disabled, require_force, require_verified
from hapticd.settings.device import signs_hash
from hapticd.signal.verdict import student_quantile
from hapticd.usb.codec import I16_HIGHEST

__all__ = ["Masses", "measure_gain", "measure_sign"]

PUSH_S = 0.02
FIRST_SHARE = 0.05  # of the force that is allowed
STRONGER = 1.5
MOVED_M = 1e-4
STILL_M = 2e-5
STILL_S = 0.2
STILL_LOOKS = 25  # 5 s
GRAVITY_M_PER_S2 = 9.80665
SAG_M = 8e-3  # of the spring under the heaviest mass: a stiff one rings where nothing damps it
STIFFEST_N_PER_M = 500.0
DRAWN_SHARE = 0.1  # of the force limit
DRAW_S = 1.0
SETTLE_S = 0.5
READ_S = 1.0
MOST_SHARE = 0.8  # of the force limit that masses may take
REPEATS = 0.1  # share by which friction is taken to differ from reading to reading
MOST_RESIDUAL = 0.02  # of the span


@dataclass(frozen=True)
class Masses:
    """What is hung, and how it pulls at the endpoint."""

    kilograms: tuple[float, ...]  # 0 is one of them
    pulls_to: int = -1  # side of x to which they pull
    ratio: float = 1.0  # of the radius at which they hang to that of the endpoint
    tolerance: float = 1e-3  # relative, half of the 95 % interval of all of them together

    @property
    def weights_n(self) -> Floats:
        """Force at the endpoint (n,)."""
        return GRAVITY_M_PER_S2 * self.ratio * np.array(self.kilograms)


class Most(NamedTuple):
    """Forces that the device file allows, in N of its own scale."""

    limit_n: float  # limits.force_n
    home_n: float  # home.force_n


UNBOUNDED = Most(inf, inf)


def most_of(device: dict[str, Any]) -> Most:
    """What the `device` of a hello allows."""
    return Most(float(device["force_limit_n"]), float(device["home"]["force_n"]))


def measure_sign(bench: Client, ask: Ask) -> StepResult:
    """Push to both sides and see which way the handle goes. CommandError unless disabled."""
    require_disabled(bench)
    servo = bench.hello().servo
    _require_encoder(servo)
    where = "somewhere in the middle of its travel"
    ask(Request("let go", f"let go of the handle, {where}; it will be pushed gently"))
    pushes = [moving_push(bench, side * allowed_n(servo)) for side in (1.0, -1.0)]
    findings = [_pushed(one) for one in pushes]
    agree = {bool(one.moved_m * one.force_n > 0.0) for one in pushes}
    changes: list[Change] = []
    if settled(findings):
        findings.append(_sign(agree))
    if settled(findings):
        right = agree == {True}
        device = servo["device"]
        serial = str(device["serial"])
        sign = int(device["force"]["sign"]) * (1 if right else -1)
        board = identity_of(bench, pushes[-1].records)
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
    arrays = {
        f"{name}_{number}": np.asarray(one.records[name])
        for number, one in enumerate(pushes)
        for name in ("tick", "position_m", "force_n", "fault")
    }
    return StepResult("motor", (), findings, changes, arrays)


def _require_encoder(servo: Mapping[str, Any]) -> None:
    """AnalysisError while nobody has measured the encoder of this board: which way a push goes is
    seen by the sign of position.
    """
    position = servo["device"]["position"]
    own = str(servo["device"]["serial"])
    if position.get("serial", "") not in ("", own):
        raise AnalysisError(
            f"the encoder was measured at the board {position['serial']!r}, this one is {own!r};"
            " its sign decides what a push shows: first `hapticd rig encoder`, and start the daemon"
            " again"
        )


def allowed_n(servo: dict[str, Any]) -> float:
    """The strongest push: a tenth of the device's force, as in commissioning, whether the signs are
    verified or not, and whatever a motor makes of it that nobody has measured.
    """
    share = COMMISSIONING_SHARE / MOST_CORRECTION
    own_n = share * float(servo["device"]["force_limit_n"])
    return min(own_n, float(servo["safety"]["force_limit_n"]))


def moving_push(bench: Client, most_n: float) -> Pushed:
    """The first push towards `most_n` that moves the handle, or the one with `most_n`.
    AnalysisError where the handle does not stand still.
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
            _leave_fault(bench)
            return found
        share = min(1.0, STRONGER * share)


def _leave_fault(bench: Client) -> None:
    """A push that the servo ended has been seen; the next one may come."""
    if bench.status().state == "fault":
        bench.reset()


def await_rest(bench: Client) -> None:
    """Until the handle stands still. AnalysisError after 5 s."""
    for _ in range(STILL_LOOKS):
        if float(np.ptp(collect(bench, STILL_S).records["position_m"])) <= STILL_M:
            return
    raise AnalysisError(
        f"the handle moves by more than {1e6 * STILL_M:g} um for"
        f" {STILL_LOOKS * STILL_S:g} s; take your hand off, keep the table still, and repeat"
    )


def _pushed(one: Pushed) -> Finding:
    what = f"{one.force_n:+.3g} N moved the handle by {1e3 * one.moved_m:+.3g} mm"
    if abs(one.moved_m) >= MOVED_M:
        return Finding(what, "ok")
    remedy = "no authority: look at emergency stop, amplifier and motor, and let the handle free"
    return Finding(what, "refused", remedy)


def _sign(agree: set[bool]) -> Finding:
    if agree == {True}:
        return Finding("it goes with the force both ways: the sign is right", "ok")
    if agree == {False}:
        what = "it goes against the force both ways: the other sign is right"
        return Finding(what, "warning", "the device file gets it; start the daemon again")
    remedy = "something else moves it: let go of it, lay the axis level, and repeat"
    return Finding("it goes the same way whatever the force is", "refused", remedy)


def measure_gain(bench: Client, ask: Ask, masses: Masses) -> StepResult:
    """Ask for each mass and fit the line. CommandError unless disabled; AnalysisError where
    signs are not verified, masses are too few or too heavy.
    """
    require_disabled(bench)
    servo = bench.hello().servo
    _refuse(servo, masses)
    weights = masses.weights_n
    stiffness = min(STIFFEST_N_PER_M, float(weights.max()) / SAG_M)
    readings = []
    with ready(bench):
        bench.set(K=stiffness, ramp_s=1.0)
        for mass_kg in masses.kilograms:
            ask(Request("hang", f"hang {mass_kg:g} kg and let go of the handle", mass_kg))
            drawn_n = DRAWN_SHARE * limit_n(servo)
            readings.append([settled_n(bench, side * drawn_n) for side in (1.0, -1.0)])
        status = bench.status()
    ask(Request("let go", "take the masses off and let go of the handle"))
    require_force(status)
    device = servo["device"]
    return concluded(weights, np.array(readings), masses, device["force"], most_of(device))


def settled_n(bench: Client, drawn_n: float) -> float:
    """Mean commanded force [N] at rest, after `drawn_n` drew the handle aside and faded. It draws
    from where the handle is: equally far to both sides, also under a load.
    """
    at_m = float(collect(bench, LOOK_S).records["position_m"].mean())
    bench.set(wall=wall_of(drawn_n, at_m), ramp_s=DRAW_S)
    collect(bench, DRAW_S + SETTLE_S)
    bench.set(wall={"stiffness_n_per_m": 0.0}, ramp_s=DRAW_S)
    collect(bench, DRAW_S + SETTLE_S)
    return float(collect(bench, READ_S).records["force_n"].mean())


def limit_n(servo: dict[str, Any]) -> float:
    """The most that may be commanded."""
    own_n = float(servo["device"]["force_limit_n"])
    return min(own_n, float(servo["safety"]["force_limit_n"]))


def _refuse(servo: dict[str, Any], masses: Masses) -> None:
    require_verified(servo, "the gain is measured")
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


def concluded(
    weights_n: Floats,
    readings_n: Floats,
    masses: Masses,
    force: dict[str, Any],
    most: Most = UNBOUNDED,
) -> StepResult:
    """What commanded forces (n, 2) under `weights_n` (n,) say, with the file's scale `force` and
    what it allows at `most`.
    """
    means = readings_n.mean(axis=1)
    line = fitted(weights_n, means)
    scale = -masses.pulls_to / line.slope
    friction = float(np.abs(np.diff(readings_n, axis=1)).mean()) / 2.0
    unequal = REPEATS * friction
    slope_half = hypot(line.slope_half, unequal / float(np.ptp(weights_n)))
    relative = hypot(slope_half / abs(line.slope), masses.tolerance)
    full_n = I16_HIGHEST * float(force["per_count"])
    gain = Value(
        "force.full_scale_n",
        scale * full_n,
        "N",
        full_n * scale * (1 - relative),
        full_n * scale * (1 + relative),
    )
    per_n = int(force["sign"]) / float(force["per_count"])
    middle = float(force["offset_count"]) + per_n * line.intercept
    half = abs(per_n) * hypot(line.intercept_half, unequal)
    offset = Value("force.offset_count", middle, "counts", middle - half, middle + half)
    findings = [_linear(line, means), believable(scale)]
    left = _left_at_rest(abs(scale) * readings_n)
    changes = [
        *full_scale_changes(gain, full_n, most),
        Change("force", "offset_count", rounded(offset.value, offset.low, offset.high)),
    ]
    arrays = {"weights_n": weights_n, "readings_n": readings_n}
    return StepResult(
        "motor", (gain, offset, left), findings, changes if settled(findings) else (), arrays
    )


def _left_at_rest(readings_n: Floats) -> Value:
    """Half the difference between rest from above and from below (n, 2): no more than the friction,
    and less where a load came to rest beyond its place.
    """
    halves = np.abs(np.diff(readings_n, axis=1))[:, 0] / 2.0
    middle = float(halves.mean())
    quantile = student_quantile(UPPER_END, len(halves) - 1)
    half = quantile * float(halves.std(ddof=1)) / sqrt(len(halves))
    return Value("friction left at rest", middle, "N", middle - half, middle + half)


def full_scale_changes(gain: Value, full_n: float, most: Most) -> list[Change]:
    """What the full scale `gain` in place of `full_n` [N] writes into a file that allows `most`."""
    found = change_of(gain)
    return [found, *_within_reach(gain.low / full_n, most)]


def _within_reach(scale: float, most: Most) -> list[Change]:
    """The board clamps counts: with a motor that is weaker than its file says, the most that it
    makes is less, too, and no stop can be sought with more than that.
    """
    if scale >= 1.0 or most.limit_n == inf:
        return []
    reach_n = floor(scale * most.limit_n * 1e3) / 1e3
    changes = [Change("limits", "force_n", reach_n)]
    if most.home_n > reach_n:
        changes.append(Change("home", "force_n", reach_n))
    return changes


@dataclass(frozen=True)
class Line:
    """A line of least squares and the halves of its 95 % intervals."""

    slope: float
    slope_half: float
    intercept: float
    intercept_half: float
    worst: float  # residual


def fitted(x: Floats, y: Floats) -> Line:
    """The line through (n,) points, n at least 3."""
    away = x - x.mean()
    power = float(away @ away)
    slope = float(away @ y) / power
    residuals = y - y.mean() - slope * away
    freedom = len(x) - 2
    deviation = sqrt(float(residuals @ residuals) / freedom)
    quantile = student_quantile(UPPER_END, freedom)
    return Line(
        slope,
        quantile * deviation / sqrt(power),
        float(y.mean() - slope * x.mean()),
        quantile * deviation * sqrt(1.0 / len(x) + float(x.mean()) ** 2 / power),
        float(np.abs(residuals).max()),
    )


def _linear(line: Line, means: Sequence[float] | Floats) -> Finding:
    share = line.worst / float(np.ptp(means))
    what = f"the worst reading lies {percent(share)} of the span beside the line"
    if share <= MOST_RESIDUAL:
        return Finding(what, "ok")
    remedy = "is one mass typed wrong, does the lever slip, or the handle stick? Repeat the step"
    return Finding(what, "refused", remedy)


def believable(scale: float) -> Finding:
    """Whether a commanded newton may be `scale` newtons, by what the device file says."""
    what = f"a commanded newton is {scale:.4g} N"
    if 1.0 / MOST_CORRECTION <= scale <= MOST_CORRECTION:
        return Finding(what, "ok")
    remedy = "are the masses in kg, the radii and the side right? Else correct force.full_scale_n"
    return Finding(what, "refused", remedy)
