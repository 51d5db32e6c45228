"""What the resistance compensation leaves of the winding, live, and how much damping that allows.

The circuit makes of the back-EMF the velocity v + rho F_a: what it does not subtract of the
winding's voltage drop looks like a velocity, rho of it per newton of the motor. Without active
damping nothing depends on it, so that is how it is looked at: a hand moves the handle against a
weak spring, and

    v^ = e (v + rho F_a - tau v')        v by the encoder, F_a by the current

gives e by the velocity and rho by the force, over the last SEEN pieces of a second; of the lag tau
no more is known than that it is LAG_S +- LAG_S.

rho times a level of damping b is the loop gain there. Above 0 the winding is hotter than its
compensation: force and damping are weaker by 1 / (1 + rho b), and nothing oscillates. Below 0 too
much is compensated, and at -1 the circuit latches up. So -0.15 is warned about and -0.3 refused,
and the greatest damping that keeps -0.3 is named.

The interval holds the fit's and ALLOWED, for the lag of the amplifier.

What would break it: scales of current and position that are wrong.
"""

from collections.abc import Callable, Sequence
from math import hypot, inf
from typing import Any, NamedTuple

import numpy as np

from hapticd.client.blocks import Records
from hapticd.client.client import Client
from hapticd.rig.estimate import least_squares
from hapticd.rig.experiment import begin, undamped
from hapticd.rig.hand import Ask
from hapticd.rig.result import Finding, StepResult, Value
from hapticd.rig.steps.damping_line import REFUSE, WARN
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
from hapticd.signal.delivered import LAG_S
from hapticd.usb.frames import Capability

__all__ = ["measure"]

SECONDS = 20.0
SEEN = 4  # pieces that an estimate rests on
ALLOWED = 1e-3  # m/s per N, of what else lags
LEAST_M_PER_S = 0.005  # of the handle, rms

NO_DAC = "the board has no resistance DAC: what is compensated is set on the board itself"


class Residual(NamedTuple):
    """What is left, at one moment of the view."""

    rho: float  # m/s per N
    half: float  # of its 95 % interval
    n_per_a: float
    top_ns_per_m: float  # the limit of the active damping
    dac_count: int  # of the resistance compensation
    winding_c: float

    @property
    def loop(self) -> float:
        """Loop gain at the limit."""
        return self.rho * self.top_ns_per_m

    @property
    def greatest_ns_per_m(self) -> float:
        """The greatest damping that keeps the loop gain above REFUSE."""
        return REFUSE / self.rho if self.rho < 0.0 else inf

    def __str__(self) -> str:
        greatest = self.greatest_ns_per_m
        stable = "any damping is stable" if greatest == inf else f"allowed to {greatest:.3g} N s/m"
        return (
            f"residual back-EMF {1e3 * self.rho:+.3g} +- {1e3 * self.half:.2g} mm/s per N,"
            f" {self.rho * self.n_per_a**2:+.3g} ohm; loop gain {self.loop:+.2g} at"
            f" {self.top_ns_per_m:.3g} N s/m, {stable}; count {self.dac_count},"
            f" winding {self.winding_c:.1f} degC"
        )


def measure(
    bench: Client,
    ask: Ask,
    seconds: float = SECONDS,
    told: Callable[[str], None] = lambda line: None,
) -> StepResult:
    """Watch for `seconds` while a hand moves the handle; `told` gets a line a second. It ends when
    the loop gain at the limit is surely below -0.3. CommandError unless disabled; AnalysisError
    where signs are not verified, or force ends meanwhile.
    """
    servo = begin(bench, WAITS)
    device = servo["device"]
    if missing := _no_dac(bench) or unknown_ampere(device):
        return StepResult("trim", (), missing)
    rate_hz = float(servo["realtime"]["rate_hz"])
    means: list[Means] = []
    found: list[Residual] = []

    def seen(new: Records) -> bool:
        means.append(means_of(new, float(device["motor_n_per_a"]), rate_hz))
        latest = residual(means[-SEEN:], device, new)
        told("the handle hardly moves" if latest is None else str(latest))
        if latest is None:
            return True
        found.append(latest)
        return latest.loop + latest.half * latest.top_ns_per_m >= REFUSE

    with undamped(bench):
        pieces = moved(bench, ask, seconds, seen)
    return StepResult("trim", *_last(found), arrays=raw_of(pieces))


def _no_dac(bench: Client) -> list[Finding]:
    """That the board cannot be looked at so; nothing if it can."""
    capabilities = int(bench.status().servo.get("board", {}).get("capabilities", 0))
    if capabilities & Capability.RESISTANCE:
        return []
    remedy = "`hapticd rig damping` measures the residual resistance without it"
    return [Finding(NO_DAC, "not done", remedy)]


def residual(pieces: Sequence[Means], device: dict[str, Any], new: Records) -> Residual | None:
    """What the last `pieces` say; None where force or velocity is next to nothing."""
    means = joined(pieces)
    if means.motor_n.std() < LEAST_N or means.velocity_m_per_s.std() < LEAST_M_PER_S:
        return None
    # coefficients of force, velocity, 1 and acceleration; what is known of the last is a row
    ones = np.ones_like(means.motor_n)
    columns = [means.motor_n, means.velocity_m_per_s, ones, means.faster_m_per_s2]
    rows = np.vstack([np.column_stack(columns), [0.0, 0.0, 0.0, 1.0]])
    target = np.append(means.seen_m_per_s, -LAG_S)
    weight = np.append(ones / float(device["emf_velocity"]["per_count"]), 1.0 / LAG_S)
    fit = least_squares(rows, target, weight, least=1.0)
    per_force, share = fit.values[:2].tolist()
    if not abs(share) > 0.1:
        return None
    return Residual(
        per_force / share,
        hypot(float(fit.halves[0]) / share, ALLOWED),
        float(device["motor_n_per_a"]),
        float(device["active_damping_limit_ns_per_m"]),
        int(new["resistance_count"][-1]),
        float(new["winding_c"][-1]),
    )


def _last(found: Sequence[Residual]) -> tuple[list[Value], list[Finding]]:
    """The last estimate, and what to think of it."""
    if not found:
        remedy = "move the handle to and fro, and repeat"
        return [], [Finding("residual back-EMF: the handle hardly moved", "not done", remedy)]
    last = found[-1]
    ohm = last.n_per_a**2
    values = [
        Value.around("residual back-EMF", last.rho, "m/s per N", last.half),
        Value.around("residual resistance", ohm * last.rho, "ohm", ohm * last.half),
    ]
    return values, [_margin(last)]


def _margin(last: Residual) -> Finding:
    what = f"loop gain {last.loop:+.2g} at {last.top_ns_per_m:.3g} N s/m"
    if last.loop >= WARN:
        return Finding(what, "ok")
    remedy = (
        f"too much is compensated: the greatest allowed damping is {last.greatest_ns_per_m:.3g}"
        " N s/m; lower resistance.base_ohm, or limits.active_damping_ns_per_m to that"
    )
    return Finding(what, "refused" if last.loop < REFUSE else "warning", remedy)
