"""An interval by the frequencies of the record holds what its fit may be wrong by."""

import numpy as np
import pytest
from support.analysis_resolved import T, display
from support.spectral_trials import beside_mode, mass_damper, record

from hapticd.model.compose import compose
from hapticd.model.predict import predicted_impedance
from hapticd.model.scene import Excitation
from hapticd.signal.impedance import impedance
from hapticd.signal.resolved import Resolved, resolved, unresolved
from hapticd.signal.spectra import spa
from hapticd.signal.verdict import judge
from hapticd.zwidth.engine.batch import simulate

BAND = (2.0, 500.0)


def fitted(force, velocity, servo_rate_hz=None) -> Resolved:
    """The whole band by the record's own frequencies."""
    raw = spa(force, velocity)
    found = resolved(force, velocity, raw, unresolved(raw, BAND, linear=True), BAND, servo_rate_hz)
    assert isinstance(found, Resolved)
    return found


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_interval_at_the_lower_edge_holds_the_value_that_filters_bend(seed):
    """A parabola that ends with the record's frequencies is wrong by some 1e-5 of |Z| there."""
    device = display(0.3)
    point = (300.0, 0.1, 0.001)
    found = simulate(
        device, [point], 90.0, seed, excitation=Excitation("noise"), start=(0.0, 0.0),
        keep="records",
    )  # fmt: skip
    spectra = fitted(*(np.asarray(one, np.float64) for one in found.record(0)), 1.0 / T)
    edge = spectra.part(spectra.frequency_hz == BAND[0])
    z = impedance(edge)
    true = predicted_impedance(compose(device), point, np.array([BAND[0]])).real[0]
    error = abs(z.impedance_ns_per_m.real[0] - true)
    chance = 3.0 * z.sd_ns_per_m[0] / np.sqrt(2.0)
    assert error > chance
    assert error < chance + abs((edge.bias * z.impedance_ns_per_m).real[0])


@pytest.mark.parametrize("seed", range(1, 5))
@pytest.mark.parametrize("frequency_hz", [3.0, 5.0])
def test_mode_at_the_edge_of_the_band_is_not_called_active(frequency_hz, seed):
    """Re Z is 0.012 N s/m and more; the fit alone reads -0.11 at 2 Hz, and is sure of it."""
    z = beside_mode(mass_damper(0.008, 0.012, 200.0), 0.004, frequency_hz, 10.0)
    least = z(np.arange(2.0, 500.01, 0.02)).real.min()
    found = judge(fitted(*record(z, seed, noise_m_per_s=0.0)), None, BAND, channels=False)
    assert found.answer != "not_passive"
    assert found.margin_ns_per_m.lower <= least <= found.margin_ns_per_m.upper * (1.0 + 1e-5)


def test_record_that_the_fit_cannot_decide_is_not_asked_to_be_longer():
    """What is not chance does not shrink."""
    z = beside_mode(mass_damper(0.008, 0.012, 200.0), 0.004, 5.0, 10.0)
    found = judge(fitted(*record(z, 1, noise_m_per_s=0.0)), None, BAND, channels=False)
    assert (found.answer, found.seconds_needed) == ("undecided", np.inf)
