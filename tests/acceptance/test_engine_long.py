"""Long and quiet trials: a day without drift, and motion that dies out below the smallest
normal numbers.
"""

import numpy as np
import pytest
from support.devices import RIGID, device
from support.engine_state import final

from hapticd.model.effects import Viscous
from hapticd.model.scene import Excitation

DAY_S = 86_400.0
PERIOD_S = 1.024


@pytest.mark.slow
def test_a_day_leaves_no_drift_in_position_filters_or_time(monkeypatch):
    """A periodic drive: after 84,375 periods every state is what it was after 100, and free
    motion has not wandered off.
    """
    model = device(*RIGID, Viscous(rotor_ns_per_m=0.4), delay=0.125)
    drive = Excitation("multisine", force_n=0.2, period_s=PERIOD_S)
    trials = [[100.0, 1.0, 0.01], [400.0, 0.2, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 0.0]]
    short, day = (
        state_after(model, trials, drive, periods * PERIOD_S, monkeypatch)
        for periods in (100, round(DAY_S / PERIOD_S))
    )
    (state, sums), (later, later_sums) = short, day
    assert (later_sums.samples == round(DAY_S * 4000)).all()
    assert later_sums.seconds == DAY_S
    bound = state[:, :2]
    assert (np.abs(later[:, :2] - bound).max(axis=1) < 1e-12 * np.abs(bound).max()).all()
    assert np.abs(later[:, 2:] - state[:, 2:]).max() < 1e-9
    power = later_sums.work_j[:2] / DAY_S
    assert np.allclose(power, sums.work_j[:2] / (100 * PERIOD_S), rtol=2e-2)
    assert np.allclose(later_sums.sigma_v_m_per_s[:2], sums.sigma_v_m_per_s[:2], rtol=2e-2)


def state_after(model, trials, drive, seconds, monkeypatch):
    """(position, velocity and law state of the trials at the end, their sums)."""
    rows, sums = final(monkeypatch, model, trials, seconds, excitation=drive)
    return (
        np.array([row for name, row in rows.items() if name[0] in "XL" and name[1:].isdigit()]),
        sums,
    )
