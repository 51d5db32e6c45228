"""Long and quiet trials: a day without drift, and motion that dies out below the smallest
normal numbers.
"""

from dataclasses import replace

import numpy as np
import pytest
from support.devices import STAR, device, rigid

from hapticd.model.scene import Excitation
from hapticd.zwidth.engine.batch import simulate


@pytest.mark.parametrize("dtype", ["f32", "f64"])
def test_motion_dies_out_through_denormal_numbers(dtype):
    model = rigid(0.5)
    result = simulate(
        model,
        [[100.0, 0.5, 0.0]],
        90.0,
        excitation=Excitation("none"),
        start=(1e-3, 0.0),
        dtype=dtype,
        keep="records",
    )
    velocity = result.velocity_m_per_s[0]
    smallest = np.finfo(velocity.dtype).tiny
    assert np.isfinite(velocity).all()
    assert ((np.abs(velocity) < smallest) & (velocity != 0.0)).any()
    assert np.abs(velocity[-1000:]).max() < smallest
    assert not result.diverged.any()


def test_lightly_damped_coupling_rings_as_its_eigenvalue_says():
    """766 Hz, exact in the 4 kHz steps: amplitude e^(-zeta w t)."""
    effects = [replace(e, damping_ns_per_m=0.05) if e.key == "coupling" else e for e in STAR]
    model = device(*effects)
    values = np.linalg.eigvals(model.a())
    mode = values[np.argmax(np.abs(values.imag))]
    blow = np.zeros(8000)
    blow[0] = 5.0
    result = simulate(model, [[0.0, 0.0, 0.0]], 0.2, excitation=blow, keep="records")
    ringing = np.diff(result.velocity_m_per_s[0])
    window = np.hanning(200) * np.exp(-1j * abs(mode.imag) * np.arange(200) / 4000)
    early, late = (abs(ringing[start : start + 200] @ window) for start in (50, 450))
    assert np.log(late / early) / 0.1 == pytest.approx(mode.real, rel=5e-3)


def test_over_compensated_circuit_grows_as_its_eigenvalue_says():
    """A winding far colder than its compensation: g dR / K^2 below -1 oscillates on its own."""
    effects = [
        replace(e, temperature_c=-40.0, compensated_c=180.0) if e.key == "winding" else e
        for e in STAR
    ]
    model = device(*effects)
    level = 4.0
    growth = np.linalg.eigvals(model.a(level)).real.max()
    assert growth > 1.0
    result = simulate(
        model,
        [[0.0, 0.0, 0.0]],
        20.0 / growth,
        active_damping=level,
        excitation=Excitation("none"),
        start=(0.0, 1e-6),
        keep="records",
    )
    velocity = np.abs(result.velocity_m_per_s[0])
    half = len(velocity) // 2
    assert np.log(velocity[-1] / velocity[half]) / (
        (len(velocity) - 1 - half) / 4000
    ) == pytest.approx(growth, rel=1e-3)
