"""Colgate and Schenkel: closed forms, delays, and the lifted theorem for a composed device."""

import numpy as np
import pytest
from support.analysis_devices import display

from hapticd.model.loop import (
    PAPER_FILTERS,
    derivatives,
    held_force_model,
    pulse_transfer,
    responses,
)
from hapticd.model.theorem import (
    lifted_margin,
    lifted_system,
)


def least_eigenvalue(model, point, images):
    """The theorem by brute force: invert the admittance between all harmonics, take the least
    eigenvalue of its Hermitian part.
    """
    least = np.inf
    for theta in np.geomspace(2e-3, np.pi, 240):
        f = (theta / (2 * np.pi) + np.arange(-images, images + 1)) * model.rate_hz
        p = responses(model, f)
        turn = np.array([np.exp(1j * theta)])
        law = np.array(point) @ np.stack(
            (np.ones(1), *derivatives(turn, model.rate_hz, PAPER_FILTERS))
        )
        loop = law / (1 + pulse_transfer(model, turn) * law)
        out = p.velocity[0, 0] * held_force_model(f, model.rate_hz, model.delay_periods)
        z = np.linalg.inv(np.diag(p.velocity[0, 1]) - loop * np.outer(out, p.encoder[1]))
        least = min(least, np.linalg.eigvalsh(0.5 * (z + z.conj().T))[0])
    return least


@pytest.mark.parametrize("point", [(50.0, 0.0, 0.0), (100.0, 1.0, 0.01), (0.0, 0.0, -0.004)])
def test_flexible_device_agrees_with_brute_force(point):
    found = lifted_margin(lifted_system(display()), [point])[0]
    assert found == pytest.approx(least_eigenvalue(display(), point, 12), abs=2e-3)
