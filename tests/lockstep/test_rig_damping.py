"""`rig damping`: the balance of momentum against closed forms, intervals, and a board whose damping
is another than its device file's.
"""

from math import exp, log

import numpy as np
import pytest
from support.models import COUNT_M, COUNT_N
from support.rig_damping import RATE_HZ, device, made_up, nothing
from support.rig_hand import Hand

from hapticd.core.errors import AnalysisError
from hapticd.core.params import ScaleParams
from hapticd.rig.steps.coast_down import analyse, row_of
from hapticd.rig.steps.damping import measure

FORCE = ScaleParams(COUNT_N)
RECORD = np.dtype(
    [
        ("slot", "<u8"),
        ("position_m", "<f8"),
        ("force_n", "<f8"),
        ("active_damping_effect_ns_per_m", "<f4"),
        ("current_a", "<f4"),
        ("delay_us", "<i4"),
    ]
)


def glided(t, mass_kg, damping, friction_n, force_n, push_s):
    """Position (n,) at `t` (n,) [s] of a mass under friction that is pushed from 0 to `push_s` and
    glides, in closed form, with the time at which it rests.
    """
    tau = mass_kg / damping
    top = (force_n - friction_n) / damping
    first = top * (1.0 - exp(-push_s / tau))
    way = top * push_s - tau * first
    slow = friction_n / damping
    rest_s = push_s + tau * log(1.0 + first / slow)

    def glide(s):
        return way + tau * (first + slow) * (1.0 - np.exp(-s / tau)) - slow * s

    pushed = np.clip(t, 0.0, push_s)
    during = top * pushed - tau * top * (1.0 - np.exp(-pushed / tau))
    after = glide(np.clip(t, push_s, rest_s) - push_s)
    return np.where(t <= push_s, during, after), rest_s


def recorded(mass_kg, damping, friction_n, force_n, push_s, level=0.0):
    """The records of such a push, sampled and counted as a board does."""
    t = np.arange(-0.2, 1.0, 1.0 / RATE_HZ)
    x, rest_s = glided(t, mass_kg, damping, friction_n, force_n, push_s)
    records = np.zeros(len(t), RECORD)
    records["slot"] = np.arange(len(t))
    records["position_m"] = COUNT_M * np.floor(x / COUNT_M + 0.5)
    records["force_n"] = np.where((t >= 0.0) & (t < push_s - 1e-9), force_n, 0.0)
    records["active_damping_effect_ns_per_m"] = level
    records["delay_us"] = -1  # no clock tells it
    return records, x[-1], rest_s


@pytest.mark.parametrize("mass_kg", [0.004, 0.008, 0.2])
@pytest.mark.parametrize("damping", [0.3, 2.0, 8.0])
def test_momentum_balances_whatever_the_mass(mass_kg, damping):
    """J = c D + Fc T: the closed form of every mass, and what is made of its counts."""
    records, way, rest_s = recorded(mass_kg, damping, 0.03, 0.3, 0.03, damping)
    row = row_of(records, FORCE, COUNT_M, RATE_HZ)
    assert row is not None
    assert row.impulse_ns == pytest.approx(0.3 * 0.03, rel=1e-3)
    assert row.way_m == pytest.approx(way, abs=0.6 * COUNT_M)
    assert row.seconds == pytest.approx(rest_s, abs=1e-3)
    assert row.damped_ns == pytest.approx(damping * way, rel=1e-3)
    assert damping * way + 0.03 * rest_s == pytest.approx(0.3 * 0.03, rel=1e-6)


@pytest.mark.parametrize("damping", [0.3, 1.0, 2.0, 4.0])
def test_the_time_of_motion_is_known_to_a_tenth_of_a_period_whatever_damps(damping):
    away_s = []
    for friction_n in np.linspace(0.03, 0.036, 9):
        records, _, rest_s = recorded(0.007, damping, friction_n, 0.3, 0.03, damping)
        away_s.append(row_of(records, FORCE, COUNT_M, RATE_HZ).seconds - rest_s)
    assert abs(np.mean(away_s)) < 1e-4


def smoothed(delay_us, smoothing_s):
    """The records of a push whose force is late and smoothed, in steps of 5 us."""
    mass_kg, damping, friction_n, force_n, push_s, step_s = 0.007, 0.3, 0.04, 0.3, 0.02, 5e-6
    x = v = force = 0.0
    seen = []
    for n in range(120_000):
        if n % 200 == 0:
            seen.append(x)
        target = force_n if 0.1 <= n * step_s - delay_us * 1e-6 < 0.1 + push_s else 0.0
        force += step_s / smoothing_s * (target - force)
        free = v + step_s / mass_kg * (force - damping * v)
        v = max(free - step_s / mass_kg * friction_n, 0.0)
        x += step_s * v
    records = np.zeros(len(seen), RECORD)
    records["slot"] = np.arange(len(seen))
    records["position_m"] = COUNT_M * np.floor(np.array(seen) / COUNT_M + 0.5)
    records["force_n"][100:120] = force_n
    records["delay_us"] = delay_us
    return records, damping, friction_n


@pytest.mark.parametrize("smoothing_s", [4e-4, 1e-3])
def test_a_push_acts_from_its_command_on_however_smoothed_it_is(smoothing_s):
    """What friction took lasts as long as the momentum says, to a tenth of a millisecond."""
    records, damping, friction_n = smoothed(625, smoothing_s)
    row = row_of(records, FORCE, COUNT_M, RATE_HZ)
    lasts_s = (row.impulse_ns - damping * row.way_m) / friction_n
    assert row.seconds == pytest.approx(lasts_s, abs=1e-4)


def test_a_push_to_the_other_side_is_the_same_row():
    there, _, _ = recorded(0.008, 2.0, 0.03, 0.3, 0.03, 2.0)
    back = there.copy()
    back["position_m"] *= -1.0
    back["force_n"] *= -1.0
    one = row_of(there, FORCE, COUNT_M, RATE_HZ)
    other = row_of(back, FORCE, COUNT_M, RATE_HZ)
    assert other == pytest.approx(one._replace(direction=-1.0), rel=1e-3)


@pytest.mark.parametrize("spoilt", ["slot", "begins", "ends"])
def test_a_push_that_misses_slots_or_rest_is_no_row(spoilt):
    records, _, _ = recorded(0.008, 2.0, 0.03, 0.3, 0.03)
    if spoilt == "slot":
        records["slot"][300:] += 1
    place = slice(0, 100) if spoilt == "begins" else slice(-100, None)
    if spoilt != "slot":
        records["position_m"][place] += np.linspace(0.0, 1e-4, 100)
    assert row_of(records, FORCE, COUNT_M, RATE_HZ) is None


def test_too_much_compensation_is_warned_about_and_refused():
    """At a loop gain of -0.2 and of -0.317 at the limit."""
    random = np.random.default_rng(6)
    for loop, verdict in ((-0.01, "ok"), (-0.02, "warning"), (-0.0317, "refused")):
        result = analyse(made_up(random, 1.0, loop=loop), device())
        assert result.findings[-1].verdict == verdict
        assert bool(result.changes) is (verdict != "refused")
    assert "at most 9.3" in result.findings[-1].remedy


def test_a_push_that_met_a_stop_is_refused():
    """The stop took a third of one impulse."""
    rows = made_up(np.random.default_rng(9), 1.0)
    assert analyse(rows, device()).settled
    rows[20] = rows[20]._replace(impulse_ns=1.5 * rows[20].impulse_ns)
    result = analyse(rows, device())
    assert not result.settled
    assert not result.changes
    assert any("a stop or a hand" in one.remedy for one in result.findings)


def test_a_gain_of_twice_the_file_is_refused():
    result = analyse(made_up(np.random.default_rng(7), 1.0, gain=2.3), device())
    assert not result.settled
    assert not result.changes


def test_the_interval_of_the_force_scale_is_part_of_that_of_damping():
    rows = made_up(np.random.default_rng(8), 1.0)
    wide = analyse(rows, device(half=0.0125 * COUNT_N)).values[0]
    assert (wide.high - wide.low) / 2.0 >= 0.0125 * wide.value


def test_damping_waits_for_the_signs():
    with Hand({"commissioning": True}) as hand, pytest.raises(AnalysisError, match="signs"):
        measure(hand.bench, nothing)


def test_a_device_that_may_not_be_damped_is_not_measured():
    with Hand({"active_damping_limit_ns_per_m": 0.0}) as hand:
        result = measure(hand.bench, nothing)
    assert result.findings[0].verdict == "not done"
    assert not result.changes
