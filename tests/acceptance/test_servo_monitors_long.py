"""A limit cycle ends, and nothing that a hand does under a passive environment ends with it."""

import numpy as np
import pytest
from support.models import COUNT_M
from test_servo_monitors import CREDIT, ENERGY_LIMIT_J, WATCHED, T, first, shaken, watched

from hapticd.core.environment import FilterParams
from hapticd.core.faults import BY_NUMBER
from hapticd.mailbox.layout import Flag, State, Value
from hapticd.model.theorem import required_damping
from hapticd.render.law import EMPTY, EXCESS, at_rest, book, design_coefficients, render
from hapticd.servo.safety import bounds


def axis_limit(axis, sign, credited, delay):
    """How far the theorem lets one of K, B, M go on a rigid device with `credited` damping."""
    low = 0.0
    high = (1e5, 1e3, 10.0)[axis]
    for _ in range(50):
        point = np.zeros(3)
        point[axis] = sign * 0.5 * (low + high)
        inside = required_damping([point], 1.0 / T, delay)[0][0] <= credited
        low, high = (0.5 * (low + high), high) if inside else (low, 0.5 * (low + high))
    return sign * low


def hand_motion(seconds, seed):
    """Positions [m] of a hand: 0.45 m/s rms below 4 Hz, 1.6 m/s at most, and a tremor at 10 Hz."""
    random = np.random.default_rng(seed)
    count = round(seconds / T)
    f = np.fft.rfftfreq(count, T)
    velocity = np.zeros(count)
    for shape, rms in (
        ((f > 0.1) / (1.0 + (f / 3.0) ** 2) ** 2, 0.45),
        (np.exp(-((f - 10.0) ** 2)), 0.01),
    ):
        wave = np.fft.irfft(shape * np.exp(2j * np.pi * random.random(f.size)), count)
        velocity += wave * rms / wave.std()
    return np.round(np.cumsum(velocity) * T / COUNT_M) * COUNT_M


@pytest.fixture(scope="module")
def ten_minutes():
    return hand_motion(600.0, 5).tolist()


@pytest.mark.parametrize(
    ("axis", "sign", "delay"),
    [(0, 1, 0.125), (0, 1, 1.5), (1, 1, 0.125), (1, -1, 0.125), (2, 1, 0.5), (2, -1, 0.125)],
)
def test_hand_motion_inside_the_theorem_never_trips(axis, sign, delay, ten_minutes):
    """Ten minutes at 95 % of each limit with the damping that is credited, 1.74 N s/m of it
    active: at most a tenth of the bound.
    """
    credited = CREDIT + 1.74
    values = [0.0, 0.0, 0.0]
    values[axis] = 0.95 * axis_limit(axis, sign, credited, delay)
    environment = (*values, 0.0, 1e6, 0.0, 0.0, 0.0, 0.0, -10.0, 10.0, 0.0)
    coefficients = design_coefficients(FilterParams(100.0), FilterParams(72.0), 1.0 / T)
    kept = bounds(watched(**WATCHED)).kept
    law = at_rest(ten_minutes[0])
    ledger = EMPTY
    most = 0.0
    for x in ten_minutes:
        force, _, v, _, spring, _, _, _, law = render(x, law, environment, coefficients)
        ledger = book(ledger, law[1], force, delay, spring, values[2], v, credited / T, kept)
        most = max(most, ledger[EXCESS])
    assert most < 0.1 * ENERGY_LIMIT_J


@pytest.mark.parametrize(
    ("code", "faults", "device"),
    [
        ("force_at_limit", True, {}),
        ("overspeed", False, {"overspeed_m_per_s": 3.5}),
        ("energy", True, {"physical_damping_ns_per_m": CREDIT}),
    ],
)
def test_limit_cycle_ends_within_200_ms_of_the_first_clamped_tick(code, faults, device):
    """K = 800 without damping, each monitor alone; without any it goes on for ever."""
    spring = {Value.STIFFNESS: 800.0}
    for_ever = shaken(watched(False), spring)
    clamped = (for_ever["flags"] & Flag.CLAMPED) != 0
    assert for_ever["state"][-1] == State.ENABLED
    assert clamped[-1000:].mean() > 0.5
    flown = shaken(watched(faults, **device), spring)
    ended = first(flown["fault"])
    assert BY_NUMBER[int(flown["fault"][ended])].code == code
    assert ended <= first(clamped) + 200
    # the ramp of every fault
    assert not flown["force_n"][ended + 20 :].any()
