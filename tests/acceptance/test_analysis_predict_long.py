"""The prediction: stability and margin together, a simulation of the true law, what is refused."""

import numpy as np
import pytest
from support.analysis_devices import display, law_on_device

from hapticd.model.predict import predicted_impedance
from hapticd.signal.impedance import impedance
from hapticd.signal.spectra import spa


@pytest.mark.parametrize("point", [(100.0, 1.0, 0.01), (0.0, 2.0, -0.004)])
def test_prediction_is_what_the_true_law_shows(point):
    """25 s of the servo's own law on the exact device, measured as a trial is, against the
    formula.
    """
    model = display(coulomb=0.0, viscous=1.5, delay=0.25)
    torque = 0.22 * np.random.default_rng(1).standard_normal(100_000)
    found = impedance(spa(torque, law_on_device(model, point, torque)), "h_force")
    inside = (found.frequency_hz > 5.0) & (found.frequency_hz < 450.0)
    expected = predicted_impedance(model, point, found.frequency_hz[inside])
    error = np.log(found.impedance_ns_per_m[inside] / expected)
    assert np.median(np.abs(error)) < 0.01
    assert np.abs(np.mean(error)) < 0.003
    assert np.mean(np.abs(error.imag) < 3.0 * found.relative_sd[inside] + 0.01) > 0.97
