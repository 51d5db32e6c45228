"""A limit cycle or a hum between 2 and 12 Hz is named, and nothing else is: not the device's own
resonance, however narrow, not friction, counts or noise of the probe.
"""

import numpy as np
import pytest
from support import analysis_devices
from support.analysis_low_lines import (
    DRY,
    HEAVY,
    NOISE,
    RATE_HZ,
    display,
    named,
    trial_records,
    with_line,
)

from hapticd.model.effects import Coulomb, Encoder, SensorNoise
from hapticd.signal.findings import Finding
from hapticd.signal.resolved import hinted
from hapticd.signal.spectra import spa
from hapticd.zwidth.outcomes import Conditions, run_trials


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
    monkeypatch.setattr("hapticd.signal.resolved.hinted", lambda trial: True)
    for force, velocity in trial_records(device, stiffness, 4):
        assert named(force, velocity) == ()


def test_a_batch_looks_at_its_records_where_they_hint(monkeypatch):
    """As a trial alone does, on the record of the same trial."""
    looked = []
    cycle = Finding("oscillation", "a limit cycle", unstable=True)

    def kept(force, velocity, spectra):
        looked.append(force.size)
        return (cycle,) if hinted(spectra) else ()

    monkeypatch.setattr("hapticd.signal.assess.low_line", kept)
    points = np.array([[50.0, 0.0, 0.0], [400.0, 0.0, 0.0]])
    given = Conditions(display(0.3, mass_kg=0.023), 90.0, NOISE)
    slow, fast = run_trials(given, 0.0, points)
    assert set(looked) == {360_000}
    assert slow.answer == "not_passive"
    assert fast.answer == "passive"


def test_a_broad_motion_that_nothing_explains_is_no_line(monkeypatch):
    """Half of the velocity's power is noise from 1 to 14 Hz, 4 % of it in each half hertz."""
    monkeypatch.setattr("hapticd.signal.resolved.hinted", lambda trial: True)
    random = np.random.default_rng(3)
    for force, velocity in trial_records(DRY, 100.0, 4):
        spectrum = np.fft.rfft(random.standard_normal(velocity.size))
        f = np.fft.rfftfreq(velocity.size, 1.0 / RATE_HZ)
        noise = np.fft.irfft(spectrum * ((f > 1.0) & (f < 14.0)), velocity.size)
        assert named(force, velocity + noise * velocity.std() / noise.std()) == ()


def test_only_what_hints_at_a_line_costs_a_look_at_the_record():
    dry = analysis_devices.display()
    ((force, velocity),) = trial_records(dry, 0.0, 1)
    assert not hinted(spa(force, velocity))
    assert hinted(spa(force, with_line(velocity, 5.0, 0.05)))
