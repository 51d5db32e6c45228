"""Identify the device's own [model]: moving mass, friction, and delay of the force.

The operator lets go of the handle. A weak spring and damper keep it in the middle while the probe
shakes it with noise, softly and then hard. `force_balance` separates Coulomb from viscous friction
by the two amplitudes. Then a stiffer spring is rendered and shaken hard again; its force shows
delay and smoothing. Friction keeps it passive with a wide margin (Colgate and Schenkel's theorem
with the lag found so far).

`mechanics` computes the results with intervals. A long record makes small terms certain, so a
contradicted assumption is reported only if it is significant and larger than its value in MATTERS.
`zwidth predict`, the guard and `search` calculate with the written model. Friction is assigned to
the rotor, where it was measured. The mass has two parts if the transmission was found compliant,
and a smoothing is written separately if it could be separated from delay.

Limitations: a hand on the handle (its mass and damping then count as the device's).
"""

from collections.abc import Iterator, Mapping, Sequence
from math import hypot, isnan, nan, pi, sqrt
from typing import Any

import numpy as np

from hapticd.client.client import Client
from hapticd.core.environment import Environment, FilterParams
from hapticd.core.units import US_PER_S, percent
from hapticd.model.linearise import GAIN
from hapticd.model.theorem import required_damping
from hapticd.rig.excitation import CENTRE, loudest_n, noise
from hapticd.rig.experiment import PerturbationRun, arrays_of, begin_step, perturbation_run
from hapticd.rig.result import (
    Ask,
    Change,
    Finding,
    Request,
    StepResult,
    Value,
    checked,
    relative_half,
)
from hapticd.rig.steps.force_balance import NAMES, Balance, Test, fit_rigid_mass, fit_two_masses
from hapticd.rig.steps.mechanics import (
    UNKNOWN_SHARE,
    CommandPath,
    Facts,
    Mechanics,
    channels,
    friction_n,
    mechanics_of,
    path_of,
    resonance_of,
)
from hapticd.rig.steps.motor import limit_n

__all__ = ["measure"]

QUIET_S = 6.0
LOUD_S = 7.0
RENDERED_S = 8.0
QUIET_SHARE = 0.45  # of the loud part
STIFFNESSES = (1600.0, 800.0, 400.0, 200.0, 100.0, 50.0)  # N/m
DAMPINGS = (0.4, 0.2, 0.1, 0.0)  # N s/m
SPARE = 1.5
CERTAIN = 20.0  # deviations at which a resonance counts as found
SHOWS = 0.015  # growth of the mass up to HIGH_HZ that counts: a late channel imitates 1.3 % at most
WORST_RESIDUAL = 0.2  # of the torque
ALIKE = 0.03  # share by which the total of two masses may differ from that of one
MATTERS = {  # size from which on a contradicted assumption matters
    "rigid": 0.03,  # of the mass, at HIGH_HZ
    "linear": 0.1,  # of the friction
    "direction": 0.1,  # of the friction
    "pull": 0.1,  # of the friction
    "delay": 0.05,  # of a period
}


def measure(bench: Client, ask: Ask) -> StepResult:
    """Perturb the handle and identify its model. CommandError unless disabled; AnalysisError if the
    signs are not verified, the handle leaves its travel, or records are lost.
    """
    servo = begin_step(bench, "the model is measured")
    facts = facts_of(servo)
    ask(Request("let go", "let go of the handle in the middle of its travel; it will be shaken"))
    loud_n = loudest_n(bench, servo)
    parts = (noise(QUIET_S, QUIET_SHARE * loud_n, 1), noise(LOUD_S, loud_n, 2))
    free = perturbation_run(bench, np.concatenate(parts), CENTRE)
    rendered = stiffest(_solved([free]), facts, limit_n(servo))
    return analyse((free, perturbation_run(bench, noise(RENDERED_S, loud_n, 3), rendered)), facts)


def facts_of(servo: Mapping[str, Any]) -> Facts:
    """Return the known facts of the device, from the hello's `servo`."""
    device = servo["device"]
    tables = {"motor": "force", "probe": "probe_torque", "encoder": "position"}
    scales = {name: relative_half(device[table], nan) for name, table in tables.items()}
    period_us = US_PER_S / float(servo["realtime"]["rate_hz"])
    return Facts(period_us, scales, filters_of(servo), motor_table(device))


def filters_of(servo: Mapping[str, Any]) -> tuple[FilterParams, FilterParams]:
    """Return the filters of velocity and acceleration in the law of the hello's `servo`."""
    law = servo["environment"]
    return FilterParams(**law["velocity_filter"]), FilterParams(**law["acceleration_filter"])


def stiffest(found: Balance, facts: Facts, most_n: float) -> Environment:
    """Return the stiffest spring of STIFFNESSES, with the most damping, that stays passive. Viscous
    friction and half of the equivalent Coulomb friction must keep SPARE times as much passive, and
    its force for 1 mm must be at most half of `most_n`. Return CENTRE if there is none.
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


def analyse(runs: Sequence[PerturbationRun], facts: Facts) -> StepResult:
    """Evaluate the `runs`, the last of which has the stiffest spring."""
    found = _solved(runs)
    arrays = arrays_of(runs)
    findings = [_moved(found)]
    if findings[0].verdict == "refused":
        return StepResult("identify", (), findings, (), arrays)
    mechanics = mechanics_of(found, facts)
    path = path_of(found, runs, facts)
    findings += [*scales_agree(found, facts), parting(path, found), *assumptions(found, facts)]
    resonance = resonance_of(found, mechanics.mass)
    values = (*mechanics, *resonance, path.lag, path.delay, path.smoothing, *channels(found))
    changes = tuple(changes_of(found, mechanics, path, facts))
    return StepResult("identify", values, findings, changes, arrays)


def _solved(runs: Sequence[PerturbationRun]) -> Balance:
    """Return the balance of one rigid mass, or of two if that is contradicted, two can be
    identified, and their total mass is the same.
    """
    rigid = fit_rigid_mass(runs)
    test = next(one for one in rigid.tests if one.name == "rigid")
    if not test.significant or test.size < SHOWS * rigid.handle.mass_kg:
        return rigid
    two = fit_two_masses(runs, rigid)
    sd = float(two.fit.sd[NAMES.index("slider_rad_s")])
    told = two.settled and two.handle.slider_rad_s > CERTAIN * sd
    share = two.handle.slider_kg / two.handle.mass_kg
    heavier = two.handle.whole_kg / rigid.handle.whole_kg - 1.0
    return two if told and share > MATTERS["rigid"] and abs(heavier) < ALIKE else rigid


def _moved(found: Balance) -> Finding:
    handle = found.handle
    what = f"forces balance to {percent(found.residual)} of the torque, over {found.blocks} s"
    remedy = "is the handle free, and are both probe channels and their signs right? `rig probe`"
    if handle.coulomb_n < 0.0 or not handle.mass_kg > 0.0 or found.residual > WORST_RESIDUAL:
        return Finding(what, "refused", remedy)
    if not found.settled:
        return Finding(
            f"the balance has not settled: its lag of {handle.lag_us:.4g} us still moves",
            "refused",
            f"repeat the step; {remedy}",
        )
    if handle.whole_kg > found.most_kg:
        most = f"all forces together move {1e3 * found.most_kg:.3g} g at most"
        return Finding(f"moving mass {1e3 * handle.whole_kg:.3g} g: {most}", "refused", remedy)
    return Finding(what, "ok")


def scales_agree(found: Balance, facts: Facts) -> Iterator[Finding]:
    """Check that the scales of the device file agree with each other."""
    if unknown := [name for name, half in facts.scales.items() if isnan(half)]:
        yield Finding(
            f"no interval of {', '.join(unknown)}: {100 * UNKNOWN_SHARE:g} % is taken",
            "warning",
            "`hapticd rig` measures them first",
        )
    allowed = hypot(facts.half("motor"), facts.half("probe"), found.half("gain"))
    yield checked(
        f"a newton of the motor is {found.handle.gain:.4g} N of the probe",
        abs(found.handle.gain - 1.0) <= 1.5 * allowed,
        "repeat `rig motor` with masses, and `rig probe`: one of the two scales is wrong",
    )


def parting(path: CommandPath, found: Balance) -> Finding:
    """State how the lag is divided into delay and smoothing."""
    variances = found.covariance("lag_us", "lag_us") * found.covariance("spread_us2", "spread_us2")
    together = found.covariance("lag_us", "spread_us2") / sqrt(variances)
    parted = "smoothing and delay cannot be separated; the lag is written as delay"
    if path.smoothing.value:
        parted = f"it is smoothed by {path.smoothing.value:.4g} us"
    return Finding(
        f"lag of a command {path.lag.value:.4g} us; lag and smoothing go together by"
        f" {together:.2f}; {parted}",
        "ok",
    )


def assumptions(found: Balance, facts: Facts) -> Iterator[Finding]:
    """Yield a finding for each assumption: whether the residuals contradict it to a relevant
    degree.
    """
    per_n = 1.0 / max(friction_n(found), 1e-9)
    speed = found.speed_m_per_s
    per_unit = {
        "rigid": 1.0 / found.handle.mass_kg,
        "linear": speed * per_n,
        "direction": speed * per_n,
        "pull": per_n,
        "delay": 1.0 / facts.period_us,
    }
    handle = found.handle
    if handle.slider_kg:
        yield Finding(
            f"contradicted: one rigid mass: {1e3 * handle.slider_kg:.3g} g of it yield, by"
            f" themselves at {handle.slider_rad_s / (2.0 * pi):.4g} Hz with"
            f" {handle.slider_ratio:.2g} of critical damping",
            "ok",
            "the model has two masses and [model.coupling]",
        )
    for test in found.tests:
        if not (test.name == "rigid" and handle.slider_kg):
            yield _assumed(test, per_unit[test.name] * test.size)


_WORDS = {
    "rigid": ("one rigid mass", "the mass changes by {:.2g} % up to 200 Hz",
              "something yields between probe and encoder: clamp the probe, or see the resonance"),
    "linear": ("friction is Coulomb's and viscous", "{:.2g} % of it grows with the square of speed",
               "the model holds at the speeds of the trial alone"),
    "direction": ("friction is the same in both directions", "it differs by {:.2g} % of friction",
                  "check bearing and cable; the model uses the mean of both"),
    "pull": ("no constant force", "{:.2g} % of friction pulls, or resists one way alone",
             "level the axis, check the cable, repeat `rig motor` for the offset"),
    "delay": ("the delay is constant", "it drifts by {:.2g} % of a period",
              "quiet the host (`hapticd doctor`) and repeat; the model has the mean"),
}  # fmt: skip


def _assumed(test: Test, share: float) -> Finding:
    what, words, remedy = _WORDS[test.name]
    holds = not test.significant or abs(share) <= MATTERS[test.name]
    said = f"{what}: {words.format(100.0 * abs(share))}"
    return checked(
        f"{'' if holds else 'contradicted: '}{said} (t {test.t:.1f}, {test.critical:.1f} at 1 %)",
        holds,
        remedy,
    )


def changes_of(
    found: Balance, mechanics: Mechanics, path: CommandPath, facts: Facts
) -> Iterator[Change]:
    """Yield the changes of the device file, table by table."""
    tables: dict[str, Mapping[str, float | str]] = {
        **_masses(found, mechanics.mass),
        "motor": facts.motor,
        "viscous": {"rotor_ns_per_m": max(0.0, mechanics.viscous.rounded)},
        "coulomb": {"rotor_n": max(0.0, mechanics.coulomb.rounded)},
        "delay": {"periods": round(path.delay.value / facts.period_us, 5)},
    }
    if smoothing_us := path.smoothing.value:
        tables["smoothing"] = {"corner_hz": float(f"{US_PER_S / (2.0 * pi * smoothing_us):.6g}")}
    converters = ("encoder", "force_dac", "damping_dac", "probe_adc", "saturation")
    names = tuple(name for name in tables if name not in ("masses", "motor"))
    yield Change("model", "effects", (*names, *converters))
    for table, numbers in tables.items():
        for key, value in numbers.items():
            yield Change(f"model.{table}", key, value)


def _masses(found: Balance, mass: Value) -> dict[str, Mapping[str, float | str]]:
    """Return the tables of the masses, and of the transmission if it is compliant."""
    handle = found.handle
    if not handle.slider_kg:
        return {"masses": {"rotor_kg": mass.rounded, "slider_kg": 0.0}}
    slider = mass.value * handle.slider_kg / handle.whole_kg
    rate = handle.slider_rad_s
    return {
        "masses": {"rotor_kg": _digits(mass.value - slider), "slider_kg": _digits(slider)},
        "coupling": {
            "stiffness_n_per_m": _digits(slider * rate**2),
            "damping_ns_per_m": _digits(2.0 * handle.slider_ratio * rate * slider),
        },
    }


def _digits(value: float) -> float:
    return float(f"{value:.5g}")


def motor_table(device: Mapping[str, Any]) -> dict[str, float | str]:
    """Return [model.motor] for the hello's `device`: torque per ampere [N m/A] and its lever [m].
    Without a measurement it has placeholder numbers with a note: the table is required, but no
    prediction depends on it.
    """
    lever_m = float(device["motor_lever_m"])
    found: dict[str, float | str] = {
        "torque_constant_nm_per_a": _digits(device["motor_n_per_a"] * lever_m) or 1.0,
        "lever_m": lever_m,
        "resistance_ohm": float(device["winding_ohm"]) or 1.0,
        "reference_c": float(device["winding_reference_c"]),
    }
    if not device["motor_n_per_a"]:
        note = "not measured: `hapticd rig motor` with a current; no prediction depends on it"
        found |= {"source": "inferred", "note": note}
    return found
