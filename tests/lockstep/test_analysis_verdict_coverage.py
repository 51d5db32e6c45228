"""What a verdict promises, counted over many trials: false alarms, coverage of intervals, power.

Trials of 90 s are scaled down where only N / M matters: the sample rate with the window, or both
with the frequencies.
"""

import pytest
from support.spectral_trials import mass_damper, record

from hapticd.signal.findings import coherence_findings, examine
from hapticd.signal.spectra import spa

pytestmark = pytest.mark.slow


def test_noise_alone_raises_no_finding():
    for seed in range(25):
        force, velocity = record(mass_damper(0.008, 1.0, 50.0), seed, 90_000, rate_hz=1000.0)
        assert examine(force, velocity, 1000.0).findings == ()
        assert coherence_findings(spa(force, velocity, 1000.0, 512), (2.0, 300.0)) == ()
