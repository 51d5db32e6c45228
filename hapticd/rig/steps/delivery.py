"""Delivered force and damping, and the residual of compensation, while a hand moves the handle.

With a weak spring the commanded force follows the position, and the velocity leads it by a quarter
of a cycle. So the parts proportional to either can be separated. There is no active force: a handle
that is let go comes to rest. The signals are means over WINDOW periods, by Simpson's rule; that of
the velocity is exact, as the encoder's difference (`guard.delivered_estimate`). At the few hertz of
a hand, delays and lags of a millisecond rotate the phase of a force by a hundredth. Both steps need
the force per ampere, which `rig motor --winding` measures.

`measure_delivery` compares delivered with commanded values. Damping is that of `guard.delivered`,
which `hapticd status` shows continuously. It is the slope of the motor's force on the encoder's
velocity at equal commanded force, over the last four seconds. Force is the slope of the motor's
force, from its current, on the commanded force at equal velocity.

`measure_residual` shows the residual of the resistance compensation, live. The circuit derives from
the back-EMF the velocity v + rho F_a. The part of the winding's voltage drop that it does not
subtract appears as a velocity, rho per newton of the motor. Without active damping nothing depends
on it, so

    v^ = e (v + rho F_a - tau v')        v by the encoder, F_a by the current

gives e from the velocity and rho from the force, over the last SEEN pieces of a second. The lag tau
is only known to be LAG_S +- LAG_S. The interval contains that of the fit, and ALLOWED for the lag
of the amplifier.

rho times a level of damping b is the loop gain there. Above 0 the winding is hotter than its
compensation assumes: force and damping are weaker by 1 / (1 + rho b), and nothing oscillates. Below
0 it is overcompensated, and at -1 the circuit latches up. So -0.15 gives a warning, -0.3 is
refused, and the finding states the maximum damping that keeps -0.3.

Limitations: a hand that does not move (nothing can be estimated), wrong scales of current and
position, a board that is not passive with the spring SPRING.
"""

from collections.abc import Callable, Mapping, Sequence
from math import hypot
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from hapticd.client.client import Client
from hapticd.core.arrays import Floats, Records
from hapticd.core.environment import Environment
from hapticd.core.params import ServoParams, from_plain
from hapticd.guard.delivered import Delivered
from hapticd.guard.delivered_estimate import CALIBRATION, LAG_S, SIMPSON, WINDOW, Estimate
from hapticd.rig.experiment import begin_step, collect, rendering, require_force, undamped
from hapticd.rig.result import Ask, Finding, Request, StepResult, Value, checked, least_squares
from hapticd.rig.steps.coast_down import REFUSE, margin
from hapticd.usb.frames import Capability

__all__ = ["measure_delivery", "measure_residual"]

SPRING = Environment(100.0, 0.5)
RAMP_S = 1.0
PIECE_S = 1.0
LEAST_N = 0.02  # rms, of a force: a smaller one is unusable
WAITS = "a hand moves against a spring"  # before that, it looks like a wrong sign
RAW = (
    "tick",
    "position_m",
    "force_n",
    "current_a",
    "emf_velocity_m_per_s",
    "active_damping_ns_per_m",
    "active_damping_effect_ns_per_m",
    "resistance_count",
    "winding_c",
)
AUDIT_S = 6.0
LOW = 0.8  # of the command
HIGH = 1.2
SETTLED = 1  # pieces until hand and damping have settled
TRIM_S = 20.0
SEEN = 4  # pieces that an estimate is based on
ALLOWED = 1e-3  # m/s per N, for other lags
LEAST_M_PER_S = 0.005  # of the handle, rms


class Means(NamedTuple):
    """Means over windows of a piece, (n,) each."""

    force_n: Floats  # commanded
    motor_n: Floats  # from the current
    seen_m_per_s: Floats  # velocity from the back-EMF
    velocity_m_per_s: Floats  # from the encoder
    faster_m_per_s2: Floats  # acceleration, from the encoder


def means_of(records: Records, n_per_a: float, rate_hz: float) -> Means:
    """Return the means of consecutive `records`, with the force per ampere."""
    places = np.arange(0, len(records) - WINDOW, WINDOW)[:, None] + np.arange(WINDOW + 1)
    x = records["position_m"].astype(np.float64)[places]

    def mean(name: str) -> Floats:
        return np.asarray(records[name].astype(np.float64)[places] @ SIMPSON)

    faster_m = (x[:, -1] - x[:, -2]) - (x[:, 1] - x[:, 0])
    return Means(
        mean("force_n"),
        n_per_a * mean("current_a"),
        mean("emf_velocity_m_per_s"),
        (x[:, -1] - x[:, 0]) * rate_hz / WINDOW,
        faster_m * rate_hz**2 / (WINDOW - 1),
    )


def joined(pieces: Sequence[Means]) -> Means:
    """All windows of `pieces`."""
    return Means(*map(np.concatenate, zip(*pieces, strict=True)))


def _unknown_ampere(device: Mapping[str, Any]) -> Finding | None:
    """Return a finding if the force per ampere is missing in `device` of a hello."""
    if device["motor_n_per_a"]:
        return None
    return Finding(
        "the device file has no force per ampere",
        "not done",
        "`hapticd rig motor --winding` measures it where the board reports its current",
    )


def record_hand_motion(
    bench: Client, ask: Ask, seconds: float, seen: Callable[[Records], bool] = lambda new: True
) -> list[Records]:
    """Record pieces of PIECE_S while a hand moves the handle for `seconds` against the spring. Stop
    early when `seen`, which gets each piece, returns False. AnalysisError if force ends.
    """
    pieces: list[Records] = []
    with rendering(bench, SPRING, RAMP_S):
        words = f"move the handle back and forth, a few mm at a few Hz, for {seconds:g} s"
        ask(Request("shake", f"from now on: {words}", seconds))
        for _ in range(round(seconds / PIECE_S)):
            pieces.append(collect(bench, PIECE_S).records)
            require_force(bench.status())
            if not seen(pieces[-1]):
                break
    return pieces


def raw_of(pieces: Sequence[Records]) -> dict[str, npt.NDArray[Any]]:
    """Return the raw record."""
    return {name: np.concatenate([one[name] for one in pieces]) for name in RAW}


def measure_delivery(
    bench: Client, ask: Ask, level: float | None = None, seconds: float = AUDIT_S
) -> StepResult:
    """Ask a hand to move the handle for `seconds` with the active damping `level` [N s/m]. The
    default is half of the device's limit. CommandError unless disabled; AnalysisError if the signs
    are not verified, or force ends.
    """
    servo = begin_step(bench, WAITS)
    if missing := _unknown_ampere(servo["device"]):
        return StepResult("audit", (), [missing])
    wanted = 0.5 * servo["device"]["active_damping_limit_ns_per_m"] if level is None else level
    with undamped(bench):
        bench.damping(wanted)
        pieces = record_hand_motion(bench, ask, seconds)[SETTLED:]
    params = from_plain(ServoParams, servo)
    follows = Delivered(params, lambda: None)
    for piece in pieces:
        follows.take(piece)
    rate_hz = params.realtime.rate_hz
    means = joined([means_of(one, params.device.motor_n_per_a, rate_hz) for one in pieces])
    recorded = StepResult("audit", arrays=raw_of(pieces))
    return recorded + _damping(follows.estimate) + _force(means, params)


def _unseen(what: str) -> StepResult:
    return StepResult("audit", (), [Finding(what, "not done", "move the handle more, and repeat")])


def _damping(found: Estimate) -> StepResult:
    """Compare delivered with commanded damping."""
    if found.estimate_ns_per_m is None or found.low is None or found.high is None:
        return _unseen(f"active damping of {found.commanded:.3g} N s/m: {found.basis}")
    value = Value("delivered damping", found.estimate_ns_per_m, "N s/m", found.low, found.high)
    said = f"active damping: {found.estimate_ns_per_m:.3g} of {found.commanded:.3g} N s/m"
    return _delivered(f"{said}, by {found.basis}", value, found.commanded)


def _force(means: Means, servo: ServoParams) -> StepResult:
    """Slope of the motor's force on the commanded one."""
    if float(means.force_n.std()) < LEAST_N:
        return _unseen("force: next to none was commanded")
    ones = np.ones_like(means.force_n)
    columns = np.column_stack([means.force_n, means.velocity_m_per_s, ones])
    counted_n = servo.device.motor_n_per_a * servo.device.current.per_count
    found = least_squares(columns, means.motor_n, ones / counted_n, least=1.0)
    share = float(found.values[0])
    half = hypot(float(found.halves[0]), CALIBRATION * share)
    value = Value.around("delivered force", share, "of the commanded value", half)
    return _delivered(f"force: {share:.3g} of the command, by the current", value)


def _delivered(what: str, value: Value, commanded: float = 1.0) -> StepResult:
    """Judge `value` by its interval relative to the commanded value."""
    enough = value.high / commanded >= LOW
    remedy = "too high: check the scales of current and force, and the compensation"
    if not enough:
        remedy = "too low: check amplifier, supply and resistance compensation"
    finding = checked(what, enough and value.low / commanded <= HIGH, remedy)
    return StepResult("audit", [value], [finding])


def measure_residual(
    bench: Client,
    ask: Ask,
    seconds: float = TRIM_S,
    told: Callable[[str], None] = lambda line: None,
) -> StepResult:
    """Estimate the residual for `seconds` while a hand moves the handle; `told` gets a line a
    second. Stop when the loop gain at the limit is certainly below -0.3. CommandError unless
    disabled; AnalysisError if the signs are not verified, or force ends.
    """
    servo = begin_step(bench, WAITS)
    device = servo["device"]
    top_ns_per_m = float(device["active_damping_limit_ns_per_m"])
    if missing := _no_dac(bench) or _unknown_ampere(device):
        return StepResult("trim", (), [missing])
    rate_hz = float(servo["realtime"]["rate_hz"])
    means: list[Means] = []
    found: list[Value] = []

    def seen(new: Records) -> bool:
        means.append(means_of(new, float(device["motor_n_per_a"]), rate_hz))
        latest = residual(means[-SEEN:], device)
        if latest is None:
            told("the handle hardly moves")
            return True
        told(_shown(latest, device, new))
        found.append(latest)
        return latest.high * top_ns_per_m >= REFUSE

    with undamped(bench):
        pieces = record_hand_motion(bench, ask, seconds, seen)
    recorded = StepResult("trim", arrays=raw_of(pieces))
    if not found:
        what = "residual back-EMF: the handle hardly moved"
        remedy = "move the handle back and forth, and repeat"
        return recorded + StepResult("trim", findings=[Finding(what, "not done", remedy)])
    return recorded + _last(found[-1], float(device["motor_n_per_a"]) ** 2, top_ns_per_m)


def _no_dac(bench: Client) -> Finding | None:
    """Return a finding if the board has no resistance DAC."""
    if Capability.RESISTANCE & int(bench.status().servo.get("board", {}).get("capabilities", 0)):
        return None
    return Finding(
        "the board has no resistance DAC: the compensation is set on the board itself",
        "not done",
        "`hapticd rig damping` measures the residual resistance without it",
    )


def _shown(found: Value, device: Mapping[str, Any], new: Records) -> str:
    """Return a line of the live view, after the ticks `new`."""
    rho = found.value
    top_ns_per_m = device["active_damping_limit_ns_per_m"]
    stable = f"allowed to {REFUSE / rho:.3g} N s/m" if rho < 0.0 else "any damping is stable"
    return (
        f"residual back-EMF {1e3 * rho:+.3g} +- {1e3 * found.half:.2g} mm/s per N,"
        f" {rho * device['motor_n_per_a'] ** 2:+.3g} ohm; loop gain {rho * top_ns_per_m:+.2g} at"
        f" {top_ns_per_m:.3g} N s/m, {stable}; count {new['resistance_count'][-1]},"
        f" winding {new['winding_c'][-1]:.1f} degC"
    )


def residual(pieces: Sequence[Means], device: Mapping[str, Any]) -> Value | None:
    """Return the residual back-EMF from `pieces`; None if force or velocity is too small."""
    means = joined(pieces)
    if means.motor_n.std() < LEAST_N or means.velocity_m_per_s.std() < LEAST_M_PER_S:
        return None
    # coefficients of force, velocity, 1 and acceleration; prior knowledge of the last is a row
    ones = np.ones_like(means.motor_n)
    columns = [means.motor_n, means.velocity_m_per_s, ones, means.faster_m_per_s2]
    rows = np.vstack([np.column_stack(columns), [0.0, 0.0, 0.0, 1.0]])
    target = np.append(means.seen_m_per_s, -LAG_S)
    weight = np.append(ones / float(device["emf_velocity"]["per_count"]), 1.0 / LAG_S)
    fit = least_squares(rows, target, weight, least=1.0)
    per_force, share = fit.values[:2].tolist()
    if not abs(share) > 0.1:
        return None
    half = hypot(float(fit.halves[0]) / share, ALLOWED)
    return Value.around("residual back-EMF", per_force / share, "m/s per N", half)


def _last(rho: Value, ohm: float, top_ns_per_m: float) -> StepResult:
    """Return the last estimate and its finding; `ohm` is the resistance for 1 m/s per N."""
    resistance = Value.around("residual resistance", ohm * rho.value, "ohm", ohm * rho.half)
    remedy = (
        "the greatest allowed damping is {:.3g} N s/m; lower resistance.base_ohm, or"
        " limits.active_damping_ns_per_m to that"
    )
    finding = margin(rho.value * top_ns_per_m, top_ns_per_m, remedy)
    return StepResult("trim", [rho, resistance], [finding])
