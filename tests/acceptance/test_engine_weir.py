"""The shipped device at the operating point of Weir 2008, Fig. 7, over a whole trial: what damping
does to the impedance.

The numbers are those of the calibration of `weir2008` (mean of seeds); one seed scatters by some
percent and degrees.
"""

import numpy as np

from hapticd.settings.scene import load_scene
from hapticd.signal.spectra import spa
from hapticd.zwidth.engine.batch import simulate

FREQUENCY_HZ = np.array([5.0, 29.0, 49.0, 69.0, 99.0, 147.0, 199.0, 305.0])
RATIO = np.array([1.60, 2.68, 2.06, 1.32, 1.13, 1.05, 1.02, 0.99])
UNDAMPED_DEG = np.array([-32.0, -5.0, 67.0, 81.0, 81.0, 81.0, 83.0, 85.0])
DAMPED_DEG = np.array([-18.0, -1.0, 26.0, 46.0, 57.0, 64.0, 70.0, 77.0])


def test_figure_7_has_its_impedance_and_its_phase_advantage():
    scene = load_scene("fig7")
    impedance = []
    for level in (0.0, 1.74):
        result = simulate(
            scene, [[50.0, 2.0, 0.0]], 90.0, 1, active_damping=level, substeps=4, keep="records"
        )
        spectra = spa(*result.record(0), frequency_hz=FREQUENCY_HZ)
        impedance.append(spectra.cross / spectra.velocity)
    undamped, damped = impedance
    assert np.allclose(abs(damped / undamped), RATIO, rtol=0.08)
    assert np.allclose(np.degrees(np.angle(undamped)), UNDAMPED_DEG, atol=4.0)
    assert np.allclose(np.degrees(np.angle(damped)), DAMPED_DEG, atol=2.5)
    assert (np.abs(np.degrees(np.angle(impedance))) < 90.0).all()
