"""What moves, what resists, and how late force comes: the device's own [model], measured.

The handle is let go. A weak spring and damper keep it in the middle while the probe shakes it with
noise, softly and then hard (`balance` tells Coulomb from viscous friction by that). Then a stiffer
spring is rendered, as stiff as friction keeps passive by far (Colgate and Schenkel's theorem with
the lag found so far), and shaken hard again: its force shows delay and smoothing.

What that says, with intervals, is in `mechanics`; each assumption that the residuals contradict is
told in words where it matters as well as being certain (`assumptions`). The written model
(`model_tables`) is what `zwidth predict`, the guard and `search` calculate with.

What would break it: a hand on the handle (its mass and damper are then the device's).
"""

from collections.abc import Mapping, Sequence
from math import nan
from typing import Any

import numpy as np

from hapticd.client.client import Client
from hapticd.core.environment import Environment, FilterParams
from hapticd.core.units import US_PER_S, percent
from hapticd.model.linearise import GAIN
from hapticd.model.theorem import required_damping
from hapticd.rig.excitation import CENTRE, loudest_n, noise
from hapticd.rig.experiment import PerturbationRun, arrays_of, begin, perturbation_run
from hapticd.rig.hand import Ask, Request
from hapticd.rig.result import Finding, StepResult, relative_half
from hapticd.rig.steps.assumptions import MATTERS, assumptions, parting, scales_agree
from hapticd.rig.steps.force_balance import NAMES, Balance, fit_rigid_mass, fit_two_masses
from hapticd.rig.steps.mechanics import (
    Facts,
    Motor,
    Scales,
    channels,
    mechanics_of,
    path_of,
    resonance_of,
)
from hapticd.rig.steps.model_tables import changes_of
from hapticd.rig.steps.motor import limit_n

__all__ = ["measure"]

QUIET_S = 6.0
LOUD_S = 7.0
RENDERED_S = 8.0
QUIET_SHARE = 0.45  # of the loud part
STIFFNESSES = (1600.0, 800.0, 400.0, 200.0, 100.0, 50.0)  # N/m
DAMPINGS = (0.4, 0.2, 0.1, 0.0)  # N s/m
SPARE = 1.5
CERTAIN = 20.0  # deviations of a resonance that is told
SHOWS = 0.015  # of the mass, that it grows by up to HIGH_HZ: a late channel feigns 1.3 % at most
WORST_RESIDUAL = 0.2  # of the torque
ALIKE = 0.03  # share by which one mass and two may differ


def measure(bench: Client, ask: Ask) -> StepResult:
    """Perturb the handle and write its model. CommandError unless disabled; AnalysisError while
    signs are not verified, where the handle leaves its travel, or where records are lost.
    """
    servo = begin(bench, "the model is measured")
    facts = facts_of(servo)
    ask(Request("let go", "let go of the handle in the middle of its travel; it will be shaken"))
    loud_n = loudest_n(bench, servo)
    parts = (noise(QUIET_S, QUIET_SHARE * loud_n, 1), noise(LOUD_S, loud_n, 2))
    free = perturbation_run(bench, np.concatenate(parts), CENTRE)
    rendered = stiffest(_solved([free]), facts, limit_n(servo))
    return analyse((free, perturbation_run(bench, noise(RENDERED_S, loud_n, 3), rendered)), facts)


def facts_of(servo: Mapping[str, Any]) -> Facts:
    """What the hello's `servo` says of the device."""
    device = servo["device"]
    names = ("force", "probe_torque", "position")
    scales = Scales(*(relative_half(device[name], nan) for name in names))
    motor = Motor(
        float(device["motor_n_per_a"]),
        float(device["winding_ohm"]),
        float(device["winding_reference_c"]),
        float(device["motor_lever_m"]),
    )
    return Facts(US_PER_S / float(servo["realtime"]["rate_hz"]), scales, filters_of(servo), motor)


def filters_of(servo: Mapping[str, Any]) -> tuple[FilterParams, FilterParams]:
    """Those of velocity and acceleration in the law of the hello's `servo`."""
    law = servo["environment"]
    return FilterParams(**law["velocity_filter"]), FilterParams(**law["acceleration_filter"])


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


def analyse(runs: Sequence[PerturbationRun], facts: Facts) -> StepResult:
    """What the `runs` say, the last of which has the stiffest spring."""
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
    changes = changes_of(found, mechanics, path, facts)
    return StepResult("identify", values, findings, changes, arrays)


def _solved(runs: Sequence[PerturbationRun]) -> Balance:
    """The balance of one rigid mass, or of two where that is contradicted, and two are told that
    together are as heavy.
    """
    rigid = fit_rigid_mass(runs)
    test = next(one for one in rigid.tests if one.name == "rigid")
    if not test.significant or test.size < SHOWS * rigid.handle.mass_kg:
        return rigid
    two = fit_two_masses(runs, rigid)
    sd = float(two.sd[NAMES.index("slider_rad_s")])
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
        what = f"the balance has not settled: its lag of {handle.lag_us:.4g} us still moves"
        return Finding(what, "refused", f"repeat the step; {remedy}")
    if handle.whole_kg > found.most_kg:
        mass_g, most_g = 1e3 * handle.whole_kg, 1e3 * found.most_kg
        what = f"moving mass {mass_g:.3g} g: all forces together move {most_g:.3g} g at most"
        return Finding(what, "refused", remedy)
    return Finding(what, "ok")
