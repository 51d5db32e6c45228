"""`rig temperature`: closed forms on made-up counts, and the simulated board's sensor."""

import numpy as np
import pytest
from support.rig_hand import Hand

from hapticd.core.errors import AnalysisError, CommandError
from hapticd.rig.steps.winding import (
    KnownTemperatures,
    analyse_back_emf,
    analyse_temperature,
    drift_of,
    measure_temperature,
)

DEVICE = {
    "temperature": {"per_count": 0.01, "sign": 1, "offset_count": 0.0},
    "emf_velocity": {"per_count": 2.0 / 32767, "sign": 1, "offset_count": 0.0},
    "position": {"per_count": 1e-6, "half_width_95": 1e-9},
}
TICKS = 10_000
DTYPE = [("board_us", "<i8"), ("position_m", "<f8"), ("emf_velocity_m_per_s", "<f4")]


def counts(*celsius, per_count=0.01, offset=0.0, noise=0.0, seed=0):
    random = np.random.default_rng(seed)
    clean = np.array(celsius)[:, None] / per_count + offset
    return np.round(clean + noise * random.standard_normal((len(celsius), TICKS)))


def shaken(gain=1.0, offset=0.0, seed=0, size_m=3e-3, noise=2.0, delay=2):
    """6 s at 3 Hz; the channel says gain times the velocity of `delay` ticks ago."""
    random = np.random.default_rng(seed)
    at_s = np.arange(-delay, 6000) / 1000.0
    turns = 2.0 * np.pi * 3.0 * at_s
    speed = size_m * 2.0 * np.pi * 3.0 * np.cos(turns)
    found = np.zeros(6000, DTYPE)
    found["board_us"] = np.arange(6000) * 1000
    found["position_m"] = np.round(size_m * np.sin(turns[delay:]) / 5e-7) * 5e-7
    per_count = 2.0 / 32767
    told = speed[:6000] / (gain * per_count) + offset + noise * random.standard_normal(6000)
    found["emf_velocity_m_per_s"] = np.round(told) * per_count
    return found


def told(result):
    return {one.name: one for one in result.values}


def holds(value, truth):
    return value.low <= truth <= value.high


def refused(result):
    return [one for one in result.findings if one.verdict == "refused"]


def test_one_temperature_gives_the_count_that_means_0():
    result = analyse_temperature(
        counts(21.5, offset=130.0, noise=3.0), KnownTemperatures((21.5,)), DEVICE
    )
    assert result.settled
    values = told(result)
    assert values["temperature.offset_count"].value == pytest.approx(130.0, abs=0.2)
    assert holds(values["temperature.offset_count"], 130.0)
    assert values["temperature noise"].value == pytest.approx(0.03, rel=0.03)
    assert {one.key for one in result.changes} == {"sign", "offset_count"}


@pytest.mark.parametrize("per_count", [0.008, -0.012])
def test_two_temperatures_give_the_scale_and_its_sign(per_count):
    found = counts(20.0, 60.0, per_count=per_count, offset=-200.0)
    values = told(result := analyse_temperature(found, KnownTemperatures((20.0, 60.0)), DEVICE))
    assert values["temperature.c_per_count"].value == pytest.approx(abs(per_count), rel=2e-4)
    assert values["temperature.offset_count"].value == pytest.approx(-200.0, abs=1.0)
    changes = {one.key: one.value for one in result.changes}
    assert changes["sign"] == np.sign(per_count)
    assert changes["c_per_count"] == pytest.approx(abs(per_count), rel=1e-3)


@pytest.mark.parametrize(
    ("found", "stated", "name"),
    [
        (np.full((1, TICKS), 32767.0), (20.0,), "open or shorted"),
        (np.full((1, TICKS), -32768.0), (20.0,), "open or shorted"),
        (counts(20.0, 20.0), (20.0, 50.0), "stuck sensor"),
        (counts(80.0), (20.0,), "type of sensor"),
        (counts(20.0, 320.0), (20.0, 50.0), "in degC"),
    ],
)
def test_a_sensor_that_cannot_be_right_is_refused_by_name(found, stated, name):
    result = analyse_temperature(found, KnownTemperatures(stated), DEVICE)
    (finding,) = refused(result)
    assert name in finding.remedy
    assert not result.changes


def test_a_drift_is_told_in_kelvin_a_minute():
    random = np.random.default_rng(2)
    rising = 2000.0 + np.arange(TICKS) * 10.0 / TICKS + random.standard_normal(TICKS)
    drift = drift_of(rising, 0.01)
    assert holds(drift, 0.6)  # 10 counts in 10 s
    assert drift.high - drift.low < 0.1
    warned = analyse_temperature(
        np.array([2000.0 + 5.0 * (rising - 2000.0)]), KnownTemperatures((20.0,)), DEVICE
    )
    assert any("wait until" in one.remedy for one in warned.findings)


@pytest.mark.parametrize("gain", [1.2, -0.8])
def test_back_emf_is_known_by_the_encoder_though_it_comes_late(gain):
    at_rest = analyse_temperature(counts(20.0), KnownTemperatures((20.0,)), DEVICE)
    result = at_rest + analyse_back_emf(shaken(gain, offset=-12.0), DEVICE)
    assert result.settled
    values = told(result)
    full = values["emf_velocity.full_scale_m_per_s"]
    assert holds(full, 2.0 * abs(gain))
    assert full.high - full.low < 0.005 * full.value
    assert holds(values["emf_velocity.offset_count"], -12.0)
    changes = {(one.table, one.key): one.value for one in result.changes}
    assert changes["emf_velocity", "sign"] == np.sign(gain)


@pytest.mark.parametrize(
    ("ticks", "name"),
    [
        (shaken(size_m=1e-5), "not shaken"),
        (shaken(gain=1e6, noise=0.0), "dead back-EMF"),
        (shaken(noise=3000.0), "not a velocity"),
        (shaken(gain=10.0, noise=0.5), "full_scale_m_per_s"),
    ],
)
def test_a_back_emf_that_tells_nothing_is_refused_by_name(ticks, name):
    at_rest = analyse_temperature(counts(20.0), KnownTemperatures((20.0,)), DEVICE)
    result = at_rest + analyse_back_emf(ticks, DEVICE)
    (finding,) = refused(result)
    assert name in finding.remedy
    assert not result.changes


@pytest.mark.parametrize("celsius", [(), (20.0, 21.0), (20.0, 40.0, 60.0)])
def test_temperatures_that_tell_no_line_are_refused_before_anything(celsius):
    with Hand() as hand, pytest.raises(AnalysisError, match="temperatures"):
        measure_temperature(hand.bench, hand.ask, KnownTemperatures(celsius))


def test_a_device_that_is_enabled_is_left_alone():
    with Hand() as hand:
        hand.bench.enable()
        with pytest.raises(CommandError, match="disabled"):
            measure_temperature(hand.bench, hand.ask, KnownTemperatures((22.0,)))
