"""What moves, what resists, and how late force comes: the device's own [model], measured.

The handle is let go. A weak spring and damper keep it in the middle while the probe shakes it with
noise, softly and then hard (`balance` tells Coulomb from viscous friction by that). Then a stiffer
spring is rendered, as stiff as friction keeps passive by far (Colgate and Schenkel's theorem with
the lag found so far), and shaken hard again: its force shows delay and smoothing.

    mass, friction      from the balance of forces; in newtons that are the mean of two scales, the
                        probe's and the motor's, each weighed by its interval; motion by the encoder
    delay, smoothing    the lag of a command is their sum and is known at once. How it is parted is
                        told by the curvature of the command's path, by the board's clock (the delay
                        is at least what that says), and by neither to the last: both say their
                        intervals, and how they go together. What decides stability is the sum: a
                        smoothing that cannot be told from delay is written as delay
    intervals           of blocks of a second (jackknife), with the scales' own and the balance's

The written model is what `zwidth predict`, the guard and `search` calculate with. Each assumption
that the residuals contradict is told, in words, where it matters as well as being certain.

What would break it: a hand on the handle (its mass and damper are then the device's).
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import hypot, pi, sqrt
from typing import Any, NamedTuple

import numpy as np

from hapticd.analysis.arrays import Floats
from hapticd.analysis.linearise import GAIN
from hapticd.analysis.theorem import required_damping
from hapticd.analysis.verdict import student_quantile
from hapticd.client.client import Client
from hapticd.errors import AnalysisError
from hapticd.params import FilterParams
from hapticd.rig.balance import LOW_HZ, NAMES, Balance, Test, balanced
from hapticd.rig.hand import Ask, Request
from hapticd.rig.link import require_disabled
from hapticd.rig.motor import limit_n
from hapticd.rig.played import Environment, Played, play
from hapticd.rig.result import UPPER_END, Change, Finding, StepResult, Value, Verdict, rounded
from hapticd.units import PROBE_RATE_HZ, US_PER_S

CENTRE = Environment(20.0, 0.3)
TRY_S = 2.0
QUIET_S = 6.0
LOUD_S = 7.0
RENDERED_S = 8.0
FADE_S = 0.1
CORNER_HZ = 60.0  # the noise falls off above, so that the handle moves rather than trembles
MOST_HZ = 1500.0
TRY_SHARE = 0.3  # of the probe's force
MOST_SHARE = 0.8
QUIET_SHARE = 0.45  # of the loud part
TRAVEL_SHARE = 0.3  # of the half travel that the loud part may take
STIFFNESSES = (1600.0, 800.0, 400.0, 200.0, 100.0, 50.0)  # N/m
DAMPINGS = (0.4, 0.2, 0.1, 0.0)  # N s/m
SPARE = 1.5

MASS_SHARE = 1e-3  # what the balance itself may be wrong by
FRICTION_SHARE = 5e-3
LAG_US = 2.0
TOLD_US = 1.0  # by the board's clock: its resolution
UNKNOWN_SHARE = 0.02  # half of the interval of a scale that says none
LEAST_SMOOTHING = 0.05  # of a period: less is written as delay

MATTERS = {  # from which size on a contradicted assumption matters
    "rigid": 0.03,  # of the mass, at HIGH_HZ
    "linear": 0.1,  # of the friction
    "direction": 0.1,  # of the friction
    "pull": 0.1,  # of the friction
    "delay": 0.05,  # of a period
}
_INTERVAL = r"{name} [-+.\deE]+ [^(]*\(95 %: ([-+.\deE]+) to ([-+.\deE]+)\)"


@dataclass(frozen=True)
class Scales:
    """Relative halves of the 95 % intervals of the device file's scales; nan where it says none."""

    motor: float
    probe: float
    encoder: float


@dataclass(frozen=True)
class Facts:
    """What is known of the device before."""

    period_us: float
    scales: Scales
    filters: tuple[FilterParams, FilterParams]
    motor: Mapping[str, float]  # n_per_a, ohm, reference_c; n_per_a of 0: unknown


def measure(bench: Client, ask: Ask) -> StepResult:
    """Perturb the handle and write its model. CommandError unless disabled; AnalysisError while
    signs are not verified, where the handle leaves its travel, or where records are lost.
    """
    require_disabled(bench)
    servo = bench.hello()["servo"]
    if servo["device"]["commissioning"]:
        raise AnalysisError(
            "the model is measured once the signs are verified: `hapticd rig motor` without"
            " masses, then start the daemon again"
        )
    facts = facts_of(servo)
    ask(Request("let go", "let go of the handle in the middle of its travel; it will be shaken"))
    loud_n = _loud_n(bench, servo)
    parts = (noise(QUIET_S, QUIET_SHARE * loud_n, 1), noise(LOUD_S, loud_n, 2))
    free = play(bench, np.concatenate(parts), CENTRE)
    rendered = stiffest(balanced([free]), facts, limit_n(servo))
    return concluded((free, play(bench, noise(RENDERED_S, loud_n, 3), rendered)), facts)


def facts_of(servo: Mapping[str, Any]) -> Facts:
    """What the hello's `servo` says of the device."""
    device = servo["device"]
    environment = servo["environment"]
    scales = Scales(
        relative_half(device["force"]["source"], "force.full_scale_n"),
        relative_half(device["probe_torque"]["source"], "probe_torque.full_scale_n"),
        relative_half(device["position"]["source"], "position.m_per_count"),
    )
    motor = {
        "n_per_a": float(device["motor_n_per_a"]),
        "ohm": float(device["winding_ohm"]),
        "reference_c": float(device["winding_reference_c"]),
    }
    filters = (
        FilterParams(**environment["velocity_filter"]),
        FilterParams(**environment["acceleration_filter"]),
    )
    return Facts(US_PER_S / float(servo["realtime"]["rate_hz"]), scales, filters, motor)


def relative_half(source: str, name: str) -> float:
    """Half of the interval that a `source` states of the value `name`, of its middle; nan if it
    states none.
    """
    found = re.search(_INTERVAL.format(name=re.escape(name)), source)
    if found is None:
        return float("nan")
    low, high = (float(one) for one in found.groups())
    return abs(high - low) / abs(high + low)


def noise(seconds: float, most_n: float, number: int) -> Floats:
    """Force [N at 4 kHz] (n,) up to `most_n`, from LOW_HZ up, falling off above CORNER_HZ; another
    one for each `number`.
    """
    samples = round(PROBE_RATE_HZ * seconds)
    f = np.fft.rfftfreq(samples, 1.0 / PROBE_RATE_HZ)
    random = np.random.Generator(np.random.Philox(key=number))
    real, imaginary = random.standard_normal((2, f.size))
    shape = ((f >= LOW_HZ) & (f <= MOST_HZ)) / (1.0 + f / CORNER_HZ)
    force = np.fft.irfft(shape * (real + 1j * imaginary), samples)
    place = np.arange(samples)
    fade = np.minimum(place, samples - 1 - place) / (FADE_S * PROBE_RATE_HZ)
    force *= np.minimum(1.0, fade)
    return np.asarray(force * (most_n / np.abs(force).max()))


def _loud_n(bench: Client, servo: Mapping[str, Any]) -> float:
    """Greatest force of the loud part, for which the handle keeps well inside its travel."""
    probe_n = float(servo["device"]["probe_limit_n"])
    tried = play(bench, noise(TRY_S, TRY_SHARE * probe_n, 0), CENTRE)
    ends = servo["environment"]["workspace"]
    room_m = 0.5 * (float(ends["upper_m"]) - float(ends["lower_m"]))
    went_m = 0.5 * float(np.ptp(tried.position_m))
    most = MOST_SHARE / TRY_SHARE
    stronger = min(most, TRAVEL_SHARE * room_m / went_m) if went_m > 0.0 else most
    return TRY_SHARE * probe_n * stronger


# --- what may be rendered -------------------------------------------------------------------------


def stiffest(found: Balance, facts: Facts, most_n: float) -> Environment:
    """The stiffest spring of STIFFNESSES, with the most damping, of which viscous friction and half
    of what Coulomb friction is worth keep SPARE times as much passive, and whose force for 1 mm is
    at most half of `most_n`; CENTRE where there is none.
    """
    handle = found.handle
    delay = max(0.0, handle.lag_us) / facts.period_us
    spare = handle.viscous_ns_per_m + 0.5 * GAIN * handle.coulomb_n / found.speed_m_per_s
    for stiffness in STIFFNESSES:
        for damping in DAMPINGS:
            asked = SPARE * np.array([[stiffness, damping, 0.0], [stiffness, 0.0, 0.0]])
            needed, _ = required_damping(asked, US_PER_S / facts.period_us, delay, facts.filters)
            if needed.max() <= spare and 1e-3 * stiffness <= 0.5 * most_n:
                return Environment(stiffness, damping)
    return CENTRE


# --- what it says ---------------------------------------------------------------------------------


class Path(NamedTuple):
    """The way of a command: each with its 95 % interval, in us."""

    lag: Value
    delay: Value
    smoothing: Value
    parted: bool  # whether there is a smoothing that is written


def concluded(runs: Sequence[Played], facts: Facts) -> StepResult:
    """What the `runs` say, the last of which has the stiffest spring."""
    found = balanced(runs)
    arrays = {
        name: values
        for number, run in enumerate(runs)
        for name, values in run.arrays(number).items()
    }
    findings = [_moved(found)]
    if findings[0].verdict == "refused":
        return StepResult("identify", (), findings, (), arrays)
    mechanics = _mechanics(found, facts)
    path = _path(found, runs, facts)
    findings += [*_scales(found, facts), _parting(path, found), *_assumptions(found, facts)]
    values = (*mechanics, path.lag, path.delay, path.smoothing, *_channels(found))
    settled = all(one.verdict != "refused" for one in findings)
    changes = _changes(mechanics, path, facts) if settled else ()
    return StepResult("identify", values, findings, changes, arrays)


def _moved(found: Balance) -> Finding:
    share = 100.0 * found.residual
    what = f"forces balance to {share:.2g} % of the torque, over {found.blocks} s"
    if found.handle.coulomb_n < 0.0 or not found.handle.mass_kg > 0.0 or share > 20.0:
        remedy = (
            "is the handle free, and are both probe channels and their signs right? `rig probe`"
        )
        return Finding(what, "refused", remedy)
    return Finding(what, "ok")


def _half(found: Balance, name: str) -> float:
    """Half of the 95 % interval of a quantity of the balance, by its blocks."""
    return student_quantile(UPPER_END, found.blocks - 1) * float(found.sd[NAMES.index(name)])


def _mechanics(found: Balance, facts: Facts) -> tuple[Value, Value, Value]:
    """Mass, viscous and Coulomb friction."""
    handle = found.handle
    scale, scale_half = _newton(found, facts)
    motion = _motion(found)
    motion_half = _known(facts.scales.encoder)

    # what one of the two frictions has too much the other one lacks
    shared_n = FRICTION_SHARE * _friction_n(found)
    shared = shared_n / found.speed_m_per_s

    def value(name: str, unit: str, field: str, doubt: float, moves: bool) -> Value:
        size = getattr(handle, field) * scale / (motion if moves else 1.0)
        own = hypot(_half(found, field), doubt) * scale
        wide = hypot(own, abs(size) * hypot(scale_half, motion_half if moves else 0.0))
        return Value(name, size, unit, size - wide, size + wide)

    return (
        value("moving mass", "kg", "mass_kg", MASS_SHARE * handle.mass_kg, True),
        value("viscous friction", "N s/m", "viscous_ns_per_m", shared, True),
        value("Coulomb friction", "N", "coulomb_n", shared_n, False),
    )


def _friction_n(found: Balance) -> float:
    """Typical friction, at the rms speed."""
    handle = found.handle
    return handle.coulomb_n + abs(handle.viscous_ns_per_m) * found.speed_m_per_s


def _known(half: float) -> float:
    return UNKNOWN_SHARE if np.isnan(half) else half


def _newton(found: Balance, facts: Facts) -> tuple[float, float]:
    """What a newton of the probe's scale is taken to be, and the half of its interval: two scales,
    each weighed by its interval.
    """
    probe = _known(facts.scales.probe)
    motor = _known(facts.scales.motor)
    both = hypot(probe, motor)
    if both == 0.0:
        return 1.0, 0.0
    return float(found.handle.gain ** -((probe / both) ** 2)), probe * motor / both


def _motion(found: Balance) -> float:
    """Encoder's motion by that of the velocity channel."""
    return float(np.mean([clock.gain for clock in found.clocks]))


def _path(found: Balance, runs: Sequence[Played], facts: Facts) -> Path:
    """Delay and smoothing, as far as the lag can be parted."""
    handle = found.handle
    lag_half = hypot(_half(found, "lag_us"), LAG_US)
    stiffness = _stiffness(runs[-1])
    doubt = 2.0 * MASS_SHARE * handle.mass_kg / stiffness * US_PER_S**2
    spread_half = hypot(_half(found, "spread_us2"), doubt)
    least_us = _told_us(runs)
    most_s = max(0.0, handle.lag_us + lag_half - least_us)
    spread = max(0.0, handle.spread_us2)
    low, middle, high = (
        min(most_s, sqrt(max(0.0, spread + side * spread_half))) for side in (-1, 0, 1)
    )
    parted = low > 0.0 and middle > LEAST_SMOOTHING * facts.period_us
    if not parted:
        low = middle = 0.0
    lag = Value("lag", handle.lag_us, "us", handle.lag_us - lag_half, handle.lag_us + lag_half)
    least_us = max(least_us - TOLD_US, lag.low - high)
    return Path(
        lag,
        Value("delay", handle.lag_us - middle, "us", min(least_us, lag.value), lag.high - low),
        Value("smoothing", middle, "us", low, high),
        parted,
    )


def _stiffness(run: Played) -> float:
    """What was rendered, by the slope of the command over the position [N/m], at least 1."""
    x = run.position_m - run.position_m.mean()
    return max(1.0, -float(x @ run.force_n) / float(x @ x))


def _told_us(runs: Sequence[Played]) -> float:
    """The delay by the board's clock; 0 where it says nothing."""
    known = np.concatenate([run.delay_us[run.delay_us >= 0.0] for run in runs])
    return float(np.median(known)) if known.size else 0.0


def _channels(found: Balance) -> tuple[Value, ...]:
    gain = found.handle.gain
    gain_half = _half(found, "gain")
    skew = found.handle.skew_us
    skew_half = _half(found, "skew_us")
    return (
        Value("motor by probe", gain, "N/N", gain - gain_half, gain + gain_half),
        Value("probe skew", skew, "us", skew - skew_half - LAG_US, skew + skew_half + LAG_US),
    )


def _scales(found: Balance, facts: Facts) -> list[Finding]:
    """Whether the scales of the device file agree with each other."""
    scales = facts.scales
    findings = []
    unknown = [name for name, half in vars(scales).items() if np.isnan(half)]
    if unknown:
        what = f"no interval of {', '.join(unknown)}: {100 * UNKNOWN_SHARE:g} % is taken"
        findings.append(Finding(what, "warning", "`hapticd rig` measures them first"))
    off = found.handle.gain - 1.0
    allowed = hypot(_known(scales.motor), _known(scales.probe), _half(found, "gain"))
    what = f"a newton of the motor is {found.handle.gain:.4g} N of the probe"
    bad = abs(off) > 1.5 * allowed
    remedy = "repeat `rig motor` with masses, and `rig probe`: one of the two scales is wrong"
    findings.append(Finding(what, "warning" if bad else "ok", remedy if bad else ""))
    return findings


def _parting(path: Path, found: Balance) -> Finding:
    lag = NAMES.index("lag_us")
    spread = NAMES.index("spread_us2")
    together = float(found.correlation[lag, spread])
    what = (
        f"lag of a command {path.lag.value:.4g} us; lag and smoothing go together by {together:.2f}"
    )
    if path.parted:
        return Finding(f"{what}; it is smoothed by {path.smoothing.value:.4g} us", "ok")
    return Finding(f"{what}; no smoothing is told from delay, the lag is written as delay", "ok")


def _assumptions(found: Balance, facts: Facts) -> list[Finding]:
    """Each assumption, and whether the residuals contradict it where it matters."""
    per_n = 1.0 / max(_friction_n(found), 1e-9)
    speed = found.speed_m_per_s
    per_unit = {
        "rigid": 1.0 / found.handle.mass_kg,
        "linear": speed * per_n,
        "direction": speed * per_n,
        "pull": per_n,
        "delay": 1.0 / facts.period_us,
    }
    return [_assumed(test, per_unit[test.name] * test.size) for test in found.tests]


_WORDS = {
    "rigid": ("one rigid mass", "the mass changes by {:.2g} % up to 200 Hz",
              "something yields between probe and encoder: clamp the probe, or see the resonance"),
    "linear": ("friction is Coulomb's and viscous", "{:.2g} % of it grows with the square of speed",
               "the model holds at the speeds of the trial alone"),
    "direction": ("friction is the same in both directions", "it differs by {:.2g} % of friction",
                  "look at bearing and cable; the model has the mean of both"),
    "pull": ("nothing pulls all the time", "{:.2g} % of friction pulls, or resists one way alone",
             "lay the axis level, look at the cable, repeat `rig motor` for the offset"),
    "delay": ("the delay is constant", "it drifts by {:.2g} % of a period",
              "quiet the host (`hapticd doctor`) and repeat; the model has the mean"),
}  # fmt: skip


def _assumed(test: Test, share: float) -> Finding:
    what, words, remedy = _WORDS[test.name]
    said = (
        f"{what}: {words.format(100.0 * abs(share))} (t {test.t:.1f}, {test.critical:.1f} at 1 %)"
    )
    if test.significant and abs(share) > MATTERS[test.name]:
        return Finding(f"contradicted: {said}", "warning", remedy)
    verdict: Verdict = "ok"
    return Finding(said, verdict)


# --- what is written ------------------------------------------------------------------------------


def _changes(mechanics: Sequence[Value], path: Path, facts: Facts) -> list[Change]:
    """The tables of [model]."""
    mass, viscous, coulomb = mechanics
    names = ["viscous", "coulomb", "delay", *(("smoothing",) if path.parted else ())]
    tables: dict[str, dict[str, float]] = {
        "masses": {"rotor_kg": _rounded(mass)},
        "motor": _motor(facts),
        "viscous": {"rotor_ns_per_m": max(0.0, _rounded(viscous))},
        "coulomb": {"rotor_n": max(0.0, _rounded(coulomb))},
        "delay": {"periods": round(path.delay.value / facts.period_us, 5)},
    }
    if path.parted:
        corner_hz = US_PER_S / (2.0 * pi * path.smoothing.value)
        tables["smoothing"] = {"corner_hz": float(f"{corner_hz:.6g}")}
    converters = ("encoder", "force_dac", "damping_dac", "probe_adc", "saturation")
    changes = [Change("model", "effects", (*names, *converters))]
    for table, numbers in tables.items():
        changes += [Change(f"model.{table}", key, value) for key, value in numbers.items()]
    return changes


def _rounded(value: Value) -> float:
    return rounded(value.value, value.low, value.high)


def _motor(facts: Facts) -> dict[str, float]:
    """Force per ampere at a lever of 1 m; prediction needs none of it."""
    known = facts.motor
    return {
        "torque_constant_nm_per_a": known["n_per_a"] or 1.0,
        "lever_m": 1.0,
        "resistance_ohm": known["ohm"] or 1.0,
        "reference_c": known["reference_c"],
    }
