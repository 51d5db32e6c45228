"""What a verdict promises, counted over many trials: false alarms, coverage of intervals, power.

Trials of 90 s are scaled down where only N / M matters: the sample rate with the window, or both
with the frequencies.
"""

import numpy as np
import pytest
from support.analysis_verdict_coverage import answers
from support.spectral_trials import with_phase_margin

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("noise_m_per_s", [5e-3, 5e-2])
def test_lossless_device_is_rarely_called_active(noise_m_per_s):
    """The hardest case: Re Z = 0 at every frequency, so every one of them may raise the alarm.
    5 % + 3 standard errors.
    """
    shares, plain = answers(with_phase_margin(0.0), noise_m_per_s, 700)
    assert shares["not_passive"] <= 0.05 + 3.0 * np.sqrt(0.05 * 0.95 / 700)
    assert shares["passive"] == 0.0
    assert plain == 0.0
