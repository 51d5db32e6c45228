"""Impacts of the display on a stiff wall, its active damping at full scale and its amplifier with
limits, by the batch engine.
"""

import numpy as np

from hapticd.core.environment import Environment, WallParams
from hapticd.model.compose import compose_device
from hapticd.model.effects import AmplifierLimits
from hapticd.zwidth.engine.batch import BatchResult, simulate
from support.devices import LIMIT, STAR

FULL_NS_PER_M = 9.9
LIMITS = AmplifierLimits(max_current_a=6.0, max_voltage_v=15.8, series_ohm=0.4, inductance_h=1e-4)
SPEEDS = (3.0, 10.0, 50.0)  # m/s; at the last the back-EMF is five times the supply
WALL = WallParams(2e4, 10.0, position_m=0.0, side=1)


def impact(
    speed_m_per_s: float, substeps: int, dtype: str = "f64", rate_hz: float = 1000.0
) -> BatchResult:
    """Half a second from 0.5 mm before the wall."""
    still = np.zeros(4000)
    wall = Environment(wall=WALL)
    model = compose_device("display", (*STAR, LIMIT, LIMITS), rate_hz)
    return simulate(
        model, [[0.0, 0.0, 0.0]], 0.5, excitation=still, environment=wall,
        active_damping=FULL_NS_PER_M, start=(-0.0005, speed_m_per_s), substeps=substeps,
        dtype=dtype, keep="ticks",
    )  # fmt: skip


def stays_bounded(found: BatchResult, speed_m_per_s: float) -> None:
    """Assert that no lane diverges or exceeds its initial speed, except for two amounts. 10 N give
    8 g 0.6 m/s in 0.5 ms; the error of one step of 250 us at 50 m/s is 5 %.
    """
    velocity = found.velocity_m_per_s
    assert velocity is not None
    assert found.limited is not None
    assert not found.diverged[0]
    assert np.isfinite(velocity).all()
    assert abs(velocity).max() < 1.05 * speed_m_per_s + 1.0
    assert found.limited[0] > 0.0
    assert abs(velocity[0, -400:]).max() < 5.0
