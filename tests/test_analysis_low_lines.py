"""A limit cycle or a hum between 2 and 12 Hz is named, and nothing else is: not the device's own
resonance, however narrow, not friction, counts or noise of the probe.
"""

from functools import cache

import numpy as np
import pytest
from support import analysis_devices
from support.measured_scenes import MOTOR, scene

from hapticd.analysis.arrays import Floats
from hapticd.analysis.findings import Finding
from hapticd.analysis.low_lines import hinted, low_line
from hapticd.analysis.spectra import spa
from hapticd.engine import simulate
from hapticd.plant.effects import Coulomb, Encoder, Masses, ProbeMass, SensorNoise, Viscous
from hapticd.plant.model import Model
from hapticd.plant.scene import Excitation, Scene
from hapticd.zwidth.outcomes import Conditions, run_trials
from hapticd.zwidth.sources import Trial
from hapticd.zwidth.store import TrialRecord
from hapticd.zwidth.trial import TrialParams, TrialResult, judged, plan_trial

RATE_HZ = 4000.0
NOISE = Excitation("noise")


def display(viscous: float, *effects, mass_kg: float = 0.008) -> Scene:
    parts = (
        Masses(rotor_kg=mass_kg - 0.003),
        MOTOR,
        ProbeMass(mass_kg=0.003),
        Viscous(rotor_ns_per_m=viscous),
    )
    return scene((*parts, *effects), seconds=90.0)


HEAVY = display(0.12, mass_kg=0.023)
DRY = display(0.3, Coulomb(rotor_n=0.03), mass_kg=0.023)


@cache
def trial_records(device: Scene | Model, stiffness: float, seeds: int, seconds: float = 90.0):
    """Forces and velocities of trials with noise of their own."""
    found = simulate(
        device, [[stiffness, 0.0, 0.0]] * seeds, seconds, 1, excitation=NOISE, start=(0.0, 0.0),
        own_torque=True, keep="records",
    )  # fmt: skip
    return [tuple(np.asarray(one, np.float64) for one in found.record(k)) for k in range(seeds)]


def named(force: Floats, velocity: Floats) -> tuple[Finding, ...]:
    return low_line(force, velocity, spa(force, velocity))


def with_line(velocity: Floats, line_hz: float, share: float, width_hz: float = 0.0) -> Floats:
    """A line of which `share` of the power is; its phase wanders if it has a width."""
    steps = np.random.default_rng(1).standard_normal(velocity.size)
    phase = np.cumsum(steps) * np.sqrt(2.0 * np.pi * width_hz / RATE_HZ)
    line = np.sin(2.0 * np.pi * line_hz * np.arange(velocity.size) / RATE_HZ + phase)
    return velocity + velocity.std() * np.sqrt(2.0 * share / (1.0 - share)) * line


@pytest.mark.parametrize("line_hz", [3.0, 5.0, 8.0, 11.3])
@pytest.mark.parametrize("share", [0.05, 0.1, 0.5, 0.95])
@pytest.mark.parametrize(
    ("device", "stiffness"),
    [(HEAVY, 20.0), (HEAVY, 100.0), (DRY, 20.0), (analysis_devices.display(), 0.0)],
)
def test_a_line_is_named_with_its_frequency(device, stiffness, share, line_hz):
    """The heavy device has a resonance of its own, 0.8 Hz wide, at 4.7 and 10.5 Hz."""
    for force, velocity in trial_records(device, stiffness, 2):
        (found,) = named(force, with_line(velocity, line_hz, share))
        assert found.code == ("line" if share < 0.3 else "oscillation")
        assert found.unstable == (share > 0.3)
        assert float(found.message.split(" at ")[1].split()[0]) == pytest.approx(line_hz, abs=0.06)


@pytest.mark.parametrize("line_hz", [3.0, 5.0, 8.0])
def test_a_line_that_wanders_is_named(line_hz):
    for force, velocity in trial_records(HEAVY, 100.0, 2):
        (found,) = named(force, with_line(velocity, line_hz, 0.1, width_hz=0.1))
        assert found.code == "line"


QUIET = [
    *((display(b, mass_kg=0.023), k) for b in (0.12, 0.3, 1.0) for k in (20.0, 50.0, 100.0)),
    *((display(0.3, mass_kg=0.023), k) for k in (300.0, 600.0)),
    (display(0.12), 0.0),
    *((DRY, k) for k in (0.0, 20.0, 100.0)),
    (display(0.3, Coulomb(rotor_n=0.01), mass_kg=0.023), 100.0),
    (display(0.5, Coulomb(rotor_n=0.03), mass_kg=0.2), 50.0),
    (display(0.1, mass_kg=0.2), 200.0),
    (display(0.3, SensorNoise(velocity_m_per_s=2e-3), mass_kg=0.023), 50.0),
    (display(0.3, Encoder(quantum_m=5e-5), mass_kg=0.023), 50.0),
    (analysis_devices.display(), 0.0),
    (analysis_devices.display(coulomb=0.1), 20.0),
]


@pytest.mark.parametrize(("device", "stiffness"), QUIET)
def test_what_the_perturbation_or_friction_moves_is_no_line(device, stiffness, monkeypatch):
    """Nor where the window's spectra do not hint at one, and the record is never looked at."""
    monkeypatch.setattr("hapticd.analysis.low_lines.hinted", lambda trial: True)
    for force, velocity in trial_records(device, stiffness, 4):
        assert named(force, velocity) == ()


def test_a_broad_motion_that_nothing_explains_is_no_line(monkeypatch):
    """Half of the velocity's power is noise from 1 to 14 Hz, 4 % of it in each half hertz."""
    monkeypatch.setattr("hapticd.analysis.low_lines.hinted", lambda trial: True)
    random = np.random.default_rng(3)
    for force, velocity in trial_records(DRY, 100.0, 4):
        spectrum = np.fft.rfft(random.standard_normal(velocity.size))
        f = np.fft.rfftfreq(velocity.size, 1.0 / RATE_HZ)
        noise = np.fft.irfft(spectrum * ((f > 1.0) & (f < 14.0)), velocity.size)
        assert named(force, velocity + noise * velocity.std() / noise.std()) == ()


@pytest.mark.parametrize("seconds", [5.0, 10.0, 20.0])
@pytest.mark.parametrize(("device", "stiffness"), [(HEAVY, 50.0), (DRY, 20.0), (DRY, 0.0)])
def test_a_short_record_has_lines_only_where_they_are(device, stiffness, seconds):
    for force, velocity in trial_records(device, stiffness, 8, seconds):
        assert named(force, velocity) == ()
        if seconds > 5.0:
            (found,) = named(force, with_line(velocity, 5.0, 0.25))
            assert found.code == "line"


def test_only_what_hints_at_a_line_costs_a_look_at_the_record():
    dry = analysis_devices.display()
    ((force, velocity),) = trial_records(dry, 0.0, 1)
    assert not hinted(spa(force, velocity))
    assert hinted(spa(force, with_line(velocity, 5.0, 0.05)))


def of_trial(velocity: Floats, force: Floats) -> TrialResult:
    plan = plan_trial(TrialParams(Trial((20.0, 0.0, 0.0), seconds=90.0), DRY))
    return judged(plan, TrialRecord(force, velocity, RATE_HZ, "test", True))


def test_a_verdict_names_it_and_calls_a_strong_one_unstable():
    ((force, velocity),) = trial_records(DRY, 20.0, 1)
    assert of_trial(velocity, force).verdict.stability == "stable"
    weak = of_trial(with_line(velocity, 5.0, 0.1), force).verdict
    assert "line at 5" in str(weak)
    assert weak.stability == "stable"
    strong = of_trial(with_line(velocity, 5.0, 0.6), force).verdict
    assert "oscillation at 5" in str(strong)
    assert strong.answer == "not_passive"


def test_a_batch_looks_at_its_records_where_they_hint(monkeypatch):
    """As a trial alone does, on the record of the same trial."""
    looked = []
    cycle = Finding("oscillation", "a limit cycle", unstable=True)

    def kept(force, velocity, spectra):
        looked.append(force.size)
        return (cycle,) if hinted(spectra) else ()

    monkeypatch.setattr("hapticd.zwidth.outcomes.low_line", kept)
    points = np.array([[50.0, 0.0, 0.0], [400.0, 0.0, 0.0]])
    given = Conditions(display(0.3, mass_kg=0.023), 90.0, NOISE)
    slow, fast = run_trials(given, 0.0, points)
    assert set(looked) == {360_000}
    assert slow.answer == "not_passive"
    assert fast.answer == "passive"
