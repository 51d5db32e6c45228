"""The engine against the same model in long double, step by step: exact for what is linear, and
for what is not.
"""

import numpy as np
import pytest
from support.devices import (
    COUNTS,
    DRY,
    LIMIT,
    STAR,
    WEAK,
    device,
)
from support.engine_exact import TRIALS, largest_error
from support.straight import Straight

from hapticd.model.effects import Coulomb, Delay, ForceDac, Multiplier
from hapticd.model.excitation import Stream
from hapticd.model.model import Noise
from hapticd.zwidth.engine.batch import simulate
from hapticd.zwidth.engine.job import held_noise


@pytest.mark.parametrize(
    ("extra", "substeps"),
    [
        ((DRY, COUNTS, LIMIT), 4),
        ((Coulomb(rotor_n=0.02, slider_n=0.015),), 1),
        ((Coulomb(rotor_n=0.05, slider_n=0.05),), 4),
        ((ForceDac(quantum_n=0.01), COUNTS), 1),
        ((WEAK, Delay(periods=0.3)), 1),
        ((WEAK, DRY, COUNTS, LIMIT, Delay(periods=0.3)), 4),
    ],
    ids=["rotor", "both bodies", "both stick", "rounding", "limits", "limits and friction"],
)
def test_friction_rounding_and_limits_are_solved_as_defined(extra, substeps):
    assert largest_error(device(*STAR, *extra), level=1.74, substeps=substeps) < 1e-11


def test_multiplier_offset_and_estimate_noise_push():
    model = device(*STAR, Multiplier(velocity_offset_m_per_s=0.01), noise=Noise(estimate_psd=1e-9))
    silent = np.zeros(400)
    result = simulate(
        model, TRIALS, 0.1, seed=5, excitation=silent, active_damping=1.74, keep="records"
    )
    noise = held_noise(400, 1e-9, 5, Stream.ESTIMATE)
    expected, _, _ = Straight(model, TRIALS[0], level=1.74).play(silent, noise)
    assert abs(expected).max() > 1e-3
    assert abs(result.velocity_m_per_s[0] - expected).max() < 1e-12 * abs(expected).max()
