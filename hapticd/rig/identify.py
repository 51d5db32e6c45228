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

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import hypot, isnan, nan, pi, sqrt
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
from hapticd.rig.result import (
    UPPER_END,
    Change,
    Finding,
    StepResult,
    Value,
    Verdict,
    relative_half,
    rounded,
)
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
SPLIT_SHARE = 0.04  # rotor against slider: friction of the slider is the rotor's here
LAG_US = 2.0
SKEW_SHARE = 0.05  # a channel that is late may smooth instead
YIELDING_SKEW_US = 10.0  # friction of the slider looks like some of it
TOLD_US = 1.0  # by the board's clock: its resolution
UNKNOWN_SHARE = 0.02  # half of the interval of a scale that says none
CERTAIN = 20.0  # deviations of a resonance that is told
LEAST_SMOOTHING = 0.05  # of a period: less is written as delay

MATTERS = {  # from which size on a contradicted assumption matters
    "rigid": 0.03,  # of the mass, at HIGH_HZ
    "linear": 0.1,  # of the friction
    "direction": 0.1,  # of the friction
    "pull": 0.1,  # of the friction
    "delay": 0.05,  # of a period
}


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
    loud_n = loudest_n(bench, servo)
    parts = (noise(QUIET_S, QUIET_SHARE * loud_n, 1), noise(LOUD_S, loud_n, 2))
    free = play(bench, np.concatenate(parts), CENTRE)
    rendered = stiffest(_solved([free]), facts, limit_n(servo))
    return concluded((free, play(bench, noise(RENDERED_S, loud_n, 3), rendered)), facts)


def facts_of(servo: Mapping[str, Any]) -> Facts:
    """What the hello's `servo` says of the device."""
    device = servo["device"]
    environment = servo["environment"]
    scales = Scales(
        relative_half(device["force"]["source"], "force.full_scale_n", nan),
        relative_half(device["probe_torque"]["source"], "probe_torque.full_scale_n", nan),
        relative_half(device["position"]["source"], "position.m_per_count", nan),
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


def loudest_n(bench: Client, servo: Mapping[str, Any]) -> float:
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
    found = _solved(runs)
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
    resonance = _resonance(found, mechanics[0])
    values = (*mechanics, *resonance, path.lag, path.delay, path.smoothing, *_channels(found))
    settled = all(one.verdict != "refused" for one in findings)
    changes = _changes(found, mechanics, path, facts) if settled else ()
    return StepResult("identify", values, findings, changes, arrays)


def _solved(runs: Sequence[Played]) -> Balance:
    """The balance of one rigid mass, or of two where that is contradicted and two are told."""
    rigid = balanced(runs)
    test = next(one for one in rigid.tests if one.name == "rigid")
    if not test.significant or test.size < MATTERS["rigid"] * rigid.handle.mass_kg:
        return rigid
    two = balanced(runs, coupled=True)
    sd = float(two.sd[NAMES.index("slider_rad_s")])
    told = two.handle.slider_rad_s > CERTAIN * sd
    share = two.handle.slider_kg / two.handle.mass_kg
    return two if told and share > MATTERS["rigid"] else rigid


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

    total_kg = handle.mass_kg + handle.slider_kg

    def value(name: str, unit: str, fitted: float, own: float, moves: bool) -> Value:
        size = fitted * scale / (motion if moves else 1.0)
        wide = hypot(own * scale, size * scale_half, size * motion_half if moves else 0.0)
        return Value(name, size, unit, size - wide, size + wide)

    mass_half = hypot(_total_half(found), MASS_SHARE * total_kg)
    viscous_half = hypot(_half(found, "viscous_ns_per_m"), shared)
    coulomb_half = hypot(_half(found, "coulomb_n"), shared_n)
    return (
        value("moving mass", "kg", total_kg, mass_half, True),
        value("viscous friction", "N s/m", handle.viscous_ns_per_m, viscous_half, True),
        value("Coulomb friction", "N", handle.coulomb_n, coulomb_half, False),
    )


def _total_half(found: Balance) -> float:
    """Half of the 95 % interval of all that moves, by its blocks."""
    if not found.handle.slider_kg:
        return _half(found, "mass_kg")
    own = NAMES.index("mass_kg")
    slider = NAMES.index("slider_kg")
    twice = 2.0 * found.correlation[own, slider] * found.sd[own] * found.sd[slider]
    variance = float(found.sd[own] ** 2 + found.sd[slider] ** 2 + twice)
    return student_quantile(UPPER_END, found.blocks - 1) * sqrt(max(0.0, variance))


def _resonance(found: Balance, mass: Value) -> list[Value]:
    """What slides on the transmission, and the resonance of the two; nothing where all is rigid."""
    handle = found.handle
    if not handle.slider_kg:
        return []
    scale = mass.value / (handle.mass_kg + handle.slider_kg)
    slider = scale * handle.slider_kg
    wide = hypot(SPLIT_SHARE * slider, scale * _half(found, "slider_kg"))
    own_hz = handle.slider_rad_s / (2.0 * pi)
    hz = own_hz * sqrt(1.0 + handle.slider_kg / handle.mass_kg)
    hz_half = hz * hypot(0.5 * SPLIT_SHARE, _half(found, "slider_rad_s") / handle.slider_rad_s)
    return [
        Value("sliding mass", slider, "kg", slider - wide, slider + wide),
        Value("first resonance", hz, "Hz", hz - hz_half, hz + hz_half),
    ]


def _friction_n(found: Balance) -> float:
    """Typical friction, at the rms speed."""
    handle = found.handle
    return handle.coulomb_n + abs(handle.viscous_ns_per_m) * found.speed_m_per_s


def _known(half: float) -> float:
    return UNKNOWN_SHARE if isnan(half) else half


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
    stiffness = _stiffness(runs[-1])
    doubt = 2.0 * MASS_SHARE * (handle.mass_kg + handle.slider_kg) / stiffness * US_PER_S**2
    lag_half = hypot(_half(found, "lag_us"), LAG_US, _lag_by_spread(found) * doubt)
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


def _lag_by_spread(found: Balance) -> float:
    """How much the lag changes with a spread that is wrong [1/us]."""
    lag = NAMES.index("lag_us")
    spread = NAMES.index("spread_us2")
    return float(found.correlation[lag, spread] * found.sd[lag] / found.sd[spread])


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
    gain_half = hypot(_half(found, "gain"), MASS_SHARE)
    skew = -found.handle.skew_us  # of the velocity's sampling, as `rig probe` has it
    doubt_us = YIELDING_SKEW_US if found.handle.slider_kg else LAG_US
    skew_half = hypot(_half(found, "skew_us"), doubt_us, SKEW_SHARE * skew)
    return (
        Value("motor by probe", gain, "N/N", gain - gain_half, gain + gain_half),
        Value("probe skew", skew, "us", skew - skew_half, skew + skew_half),
    )


def _scales(found: Balance, facts: Facts) -> list[Finding]:
    """Whether the scales of the device file agree with each other."""
    scales = facts.scales
    findings = []
    unknown = [name for name, half in vars(scales).items() if isnan(half)]
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
    asked = [test for test in found.tests if not (test.name == "rigid" and found.handle.slider_kg)]
    return [
        *_yielding(found),
        *(_assumed(test, per_unit[test.name] * test.size) for test in asked),
    ]


def _yielding(found: Balance) -> list[Finding]:
    """That there are two masses, where there are."""
    handle = found.handle
    if not handle.slider_kg:
        return []
    own_hz = handle.slider_rad_s / (2.0 * pi)
    what = (
        f"contradicted: one rigid mass: {1e3 * handle.slider_kg:.3g} g of it yield, by themselves"
        f" at {own_hz:.4g} Hz with {handle.slider_ratio:.2g} of critical damping"
    )
    return [Finding(what, "ok", "the model has two masses and [model.coupling]")]


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


def _changes(found: Balance, mechanics: Sequence[Value], path: Path, facts: Facts) -> list[Change]:
    """The tables of [model]."""
    mass, viscous, coulomb = mechanics
    tables: dict[str, dict[str, float | str]] = {
        **_masses(found, mass),
        "motor": _motor(facts),
        "viscous": {"rotor_ns_per_m": max(0.0, _rounded(viscous))},
        "coulomb": {"rotor_n": max(0.0, _rounded(coulomb))},
        "delay": {"periods": round(path.delay.value / facts.period_us, 5)},
    }
    if path.parted:
        corner_hz = US_PER_S / (2.0 * pi * path.smoothing.value)
        tables["smoothing"] = {"corner_hz": float(f"{corner_hz:.6g}")}
    converters = ("encoder", "force_dac", "damping_dac", "probe_adc", "saturation")
    names = tuple(name for name in tables if name not in ("masses", "motor"))
    changes = [Change("model", "effects", (*names, *converters))]
    for table, numbers in tables.items():
        changes += [Change(f"model.{table}", key, value) for key, value in numbers.items()]
    return changes


def _masses(found: Balance, mass: Value) -> dict[str, dict[str, float | str]]:
    """Tables of what moves, with the transmission where it yields."""
    handle = found.handle
    if not handle.slider_kg:
        return {"masses": {"rotor_kg": _rounded(mass), "slider_kg": 0.0}}
    slider = mass.value * handle.slider_kg / (handle.mass_kg + handle.slider_kg)
    rate = handle.slider_rad_s
    damping = 2.0 * handle.slider_ratio * rate * slider
    return {
        "masses": {"rotor_kg": _digits(mass.value - slider), "slider_kg": _digits(slider)},
        "coupling": {
            "stiffness_n_per_m": _digits(slider * rate**2),
            "damping_ns_per_m": _digits(damping),
        },
    }


def _digits(value: float) -> float:
    return float(f"{value:.5g}")


def _rounded(value: Value) -> float:
    return rounded(value.value, value.low, value.high)


def _motor(facts: Facts) -> dict[str, float | str]:
    """Force per ampere at a lever of 1 m. Where nobody measured it, numbers that say so: the table
    has to stand, and nothing of it is predicted with.
    """
    known = facts.motor
    found: dict[str, float | str] = {
        "torque_constant_nm_per_a": known["n_per_a"] or 1.0,
        "lever_m": 1.0,
        "resistance_ohm": known["ohm"] or 1.0,
        "reference_c": known["reference_c"],
    }
    if not known["n_per_a"]:
        note = "not measured: `hapticd rig motor` with a current; no prediction depends on it"
        found |= {"source": "inferred", "note": note}
    return found
