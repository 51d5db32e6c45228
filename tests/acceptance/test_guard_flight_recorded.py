"""K = 500 N/m, B = 2 N s/m in the hand that shakes them, active damping toggled twenty times: the
command server of the gateway, the guard's judge, the servo, the board and the plant, on virtual
time.
"""

import numpy as np
import pytest
from support.guard_flight import HELD, NEAR, flight, passive_m, verdict
from support.whole_tick import SETTLED, Display, Point, gripping, radius

from benchmarks.guard_flight import (
    SLACK_J,
)
from hapticd.core.faults import BY_NUMBER
from hapticd.mailbox.layout import State

SHIPPED = Display(rotor_kg=0.008, rotor_ns_per_m=0.36, delay_periods=0.125)
HAND = gripping(0.3, 3200.0)


def environments(found: np.ndarray) -> list[Point]:
    """What the records say was in force, each once."""
    live = found[found["state"] == State.ENABLED]
    columns = (
        "stiffness_n_per_m",
        "virtual_damping_ns_per_m",
        "mass_kg",
        "active_damping_effect_ns_per_m",
    )
    scaled = [live["gain"] * live[name] for name in columns[:3]]
    rows = np.stack((*scaled, live[columns[3]]), axis=1)
    return [Point(*row) for row in np.unique(rows.round(6), axis=0).tolist()]


@pytest.mark.parametrize("policy", HELD)
def test_recording_holds_nothing_that_the_hand_would_shake(policy: str) -> None:
    points = environments(flight(policy).records)
    assert len(points) > 20  # the ramps are in it
    assert radius(SHIPPED, points).max() <= SETTLED
    assert radius(SHIPPED, points, HAND).max() <= SETTLED


def test_warn_names_the_frequency_at_which_it_rings_before_energy_ends_it() -> None:
    found = flight("warn")
    first = next(reply for word, reply, _ in found.replies if word == "off")
    assert first["ok"]
    assert verdict(first)["safe"] is False
    assert "warning" in verdict(first)["text"]
    assert found.balance.worst_j > 10 * SLACK_J
    assert found.balance.furthest_m > 2 * NEAR * passive_m()
    ended = int(np.flatnonzero(found.records["state"] == State.FAULT)[0])
    assert BY_NUMBER[int(found.records["fault"][ended])].code == "energy"
    ringing = found.records["position_m"][ended - 60 : ended]
    crossings = np.flatnonzero(np.diff(np.sign(ringing - ringing.mean())))
    hz = 500.0 * (len(crossings) - 1) / (crossings[-1] - crossings[0])
    assert hz == pytest.approx(verdict(first)["worst_hz"], rel=0.06)
