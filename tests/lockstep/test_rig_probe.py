"""`rig probe`: closed forms on made-up motions, and the simulated board with other gains and signs
than its device file's.
"""

import numpy as np
import pytest
from support.rig_hand import Hand
from support.rig_probe import FREE, FRICTION, MASS, N, motion, told

from hapticd.core.errors import AnalysisError, CommandError
from hapticd.rig.excitation import LINES_HZ, Recording, amplitudes, lines, sines
from hapticd.rig.result import relative_half
from hapticd.rig.steps.probe import (
    AttachedMass,
    Recordings,
    alike,
    analyse,
    channels,
    force_gain,
    measure,
    offset,
)
from hapticd.rig.steps.probe_fits import ReferenceSpring, fit_added_mass, fit_velocity_channel

PLAIN = {
    "probe_limit_n": 1.0,
    "position": {"per_count": 5e-7, "half_width_95": 1e-9},
    "probe_torque": {"per_count": N, "sign": 1},
    "probe_velocity": {"per_count": N, "sign": 1},
}


def still(torque=7.0, velocity=-3.0, noise=2.0, seed=0):
    random = np.random.default_rng(seed)
    at = np.arange(20_000.0)
    counts = velocity + noise * random.standard_normal(at.size)
    return Recording(at, np.full(at.size, torque), np.round(counts), at, at, at.astype(np.uint8))


def both_channels(seed, late=0.2, seconds=15):
    """White noise into both; the velocity channel is `late` of a sample behind."""
    random = np.random.default_rng(seed)
    signal = 3000.0 * random.standard_normal(4000 * seconds)
    behind = (1.0 - late) * signal + late * np.roll(signal, 1)
    torque = np.round(signal + random.standard_normal(signal.size))
    velocity = np.round(-1.3 * behind + random.standard_normal(signal.size))
    at = np.arange(float(signal.size))
    return Recording(at, torque, velocity, at, at, at.astype(np.uint8))


def made_up(seed=1, gain=N, velocity_gain=N, mass_kg=0.02):
    return Recordings(
        still(seed=seed),
        motion(0.008, seed, gain, velocity_gain),
        motion(0.008 + mass_kg, seed + 1, gain, velocity_gain),
        both_channels(seed),
    )


def test_lines_are_the_amplitudes_of_sines_though_samples_are_missing():
    at = np.delete(np.arange(8000.0), np.arange(3000, 3200))
    signal = 3.0 * np.cos(2.0 * np.pi * 17.0 / 4000.0 * at - 0.5) + 2.0 + 1e-3 * at
    (found,) = amplitudes(at, signal[None, :])
    expected = np.where(LINES_HZ == 17.0, 3.0 * np.exp(-0.5j), 0.0)
    assert np.allclose(found, expected, atol=1e-6)


def test_the_perturbation_keeps_its_peak_and_holds_its_lines_alone():
    force = sines(0.7)
    assert np.abs(force).max() == pytest.approx(0.7)
    power = np.abs(np.fft.rfft(force))
    assert power[10:31].min() > 1e3 * np.delete(power, np.s_[10:31]).max()


def test_gains_offsets_and_skew_of_a_known_motion():
    result = analyse(made_up(gain=-1.17 * N, velocity_gain=0.9 * N), MASS, PLAIN, ReferenceSpring())
    values = told(result)
    full = values["probe_torque.full_scale_n"]
    assert full.low <= 1.17 * 2.0 <= full.high
    assert full.high - full.low < 0.01 * full.value
    speed = values["probe_velocity.full_scale_m_per_s"]
    assert speed.low <= 0.9 * 2.0 <= speed.high
    assert values["probe_torque.offset_count"].value == pytest.approx(7.0, abs=0.5)
    assert values["probe_velocity.offset_count"].value == pytest.approx(-3.0, abs=0.1)
    assert values["probe_velocity noise"].value == pytest.approx(2.0 * 0.9 * N, rel=0.02)
    assert values["probe skew"].value == pytest.approx(-0.2 * 250.0, abs=0.3)
    changes = {(one.table, one.key): one.value for one in result.changes}
    assert changes["probe_torque", "sign"] == -1
    assert changes["probe_velocity", "sign"] == 1
    assert changes["probe_torque", "full_scale_n"] == pytest.approx(2.34, rel=0.005)
    assert changes["probe_velocity", "skew_us"] == pytest.approx(-50.0, abs=0.3)
    assert result.settled


def test_a_limit_beyond_the_full_scale_comes_down_to_it():
    """Else the device file would be refused."""
    result = analyse(made_up(), MASS, PLAIN | {"probe_limit_n": 2.4}, ReferenceSpring())
    (limit,) = [one.value for one in result.changes if one.table == "limits"]
    assert 1.98 < limit < 2.0


def test_a_transmission_that_gives_is_not_read_as_mass():
    """A mass of 25 g goes 12 % further than the probe at 30 Hz."""
    level = -2.0 * np.pi * LINES_HZ * 0.2 / 4000.0
    bare, loaded = (motion(kg, 5, n_per_m=7e3) for kg in (0.008, 0.028))
    of_velocity = fit_velocity_channel(lines(bare))
    assert of_velocity.counts * N == pytest.approx(1.0, abs=5e-4)
    gain = force_gain(fit_added_mass(bare, loaded, of_velocity, level), MASS, 0.0)
    assert gain.relative_half < 0.01
    assert abs(gain.per_count / N - 1.0) <= gain.relative_half


def test_what_leaves_no_line_to_the_mass_is_refused():
    """Somebody forgot to fix it."""
    result = analyse(made_up(mass_kg=0.0), MASS, PLAIN, ReferenceSpring())
    assert not result.settled
    assert not result.changes
    assert any("was it fixed" in one.remedy for one in result.findings if one.verdict == "refused")


def test_a_mass_typed_ten_times_wrong_is_refused():
    result = analyse(made_up(), AttachedMass(0.2), PLAIN, ReferenceSpring())
    assert not result.settled
    assert not result.changes
    assert any("in kg" in one.remedy for one in result.findings)


@pytest.mark.parametrize(
    ("changes", "name"),
    [
        ({"velocity": np.zeros(16_000)}, "no velocity"),
        ({"torque": np.full(16_000, 3.0)}, "no torque"),
        ({"position_m": np.zeros(4_000)}, "stuck encoder"),
        ({"position_m": np.zeros(4_000), "velocity": np.zeros(16_000)}, "does not move the handle"),
        ({"velocity": np.random.default_rng(0).normal(0.0, 500.0, 16_000)}, "release the handle"),
    ],
)
def test_a_channel_that_tells_nothing_is_refused_by_name(changes, name):
    found = motion(0.008, 1)._replace(**changes)
    (finding,) = [one for one in channels(lines(found)) if one.verdict == "refused"]
    assert name in finding.remedy


def test_swapped_channels_are_refused_by_name():
    found = motion(0.008, 1)
    found = found._replace(torque=found.velocity, velocity=found.torque)
    refused = channels(lines(found))[-1]
    assert refused.verdict == "refused"
    assert "swapped" in refused.remedy


def test_likeness_is_that_of_the_best_delay():
    random = np.random.default_rng(0)
    one = random.standard_normal(21) + 1j * random.standard_normal(21)
    assert alike(-one * np.exp(-2j * np.pi * LINES_HZ * 0.1), one, 1.0) == pytest.approx(1.0)
    assert alike(one, one[::-1], 1.0) < 0.5
    assert alike(1j * one, one, 1e-3) < 0.05


def test_an_offset_that_still_drifts_says_so():
    """A high-pass forgets with 3 s what was before."""
    decay = 40.0 * np.exp(-np.arange(48_000.0) / 12_000.0)
    found = offset("offset", 5.0 + decay)
    assert found.low <= 5.0 <= found.high
    assert offset("offset", np.full(48_000, 5.0)).high == 5.5


def test_an_interval_is_that_of_the_device_file():
    assert relative_half({"per_count": 2.0, "half_width_95": 0.1}, 0.3) == pytest.approx(0.05)
    assert relative_half({"per_count": 2.0, "half_width_95": None}, 0.3) == 0.3


def test_a_mass_in_grams_is_refused_before_it_is_fixed():
    asked = []
    with Hand(touch=FRICTION, **FREE) as hand, pytest.raises(AnalysisError, match="is it in grams"):
        measure(hand.bench, asked.append, AttachedMass(20.0))
    assert not asked


def test_the_probe_waits_for_verified_signs():
    """The weak spring that keeps the handle would drive it off with a wrong sign."""
    with Hand({"commissioning": True}, touch=FRICTION, **FREE) as hand:
        with pytest.raises(AnalysisError, match="the probe is measured once the signs"):
            measure(hand.bench, hand.ask, MASS)
        assert hand.bench.status().state == "disabled"


def test_a_device_that_is_enabled_is_left_alone():
    with Hand() as hand:
        hand.bench.enable()
        with pytest.raises(CommandError, match="disabled"):
            measure(hand.bench, hand.ask, MASS)
