"""What a laboratory has to know of the circuit before it builds one, out of ngspice."""

import numpy as np
import pytest
from support.programs import program

from firmware_iface.hardware import studies
from firmware_iface.hardware.netlist import VALUES, draw
from firmware_iface.hardware.studies import (
    FULL_NS_PER_M,
    K_F,
    R_HAT_OHM,
    ceiling,
    compensating,
    copper_ohm,
    deep,
    driven,
    emergency_stop,
    growth_per_s,
    impedance,
    kicked,
    level_for,
    noise_mn,
    resting,
    shorted,
    switched,
)

R_OHM = VALUES["r_motor"].value
ONE_HZ = np.array([1.0])
DRAWS = 24
LEAK_N = K_F * VALUES["i_leak"].value


@pytest.fixture(autouse=True)
def _simulator():
    program("ngspice")


def alpha(active_damping_ns_per_m, delta_ohm):
    """Of an under-compensation by `delta_ohm` (Weir 2008, Eq. 6 closed through the amplifier)."""
    return 1.0 / (1.0 + active_damping_ns_per_m * delta_ohm / K_F**2)


# --- delivered damping ----------------------------------------------------------------------------


@pytest.mark.parametrize("active_damping_ns_per_m", [0.87, 1.74, 5.0, 9.9])
def test_delivered_damping_is_flat_to_100_hz_and_falls_with_the_circuits_lag(
    active_damping_ns_per_m,
):
    hz = np.geomspace(1.0, 1e3, 31)
    found = impedance(active_damping_ns_per_m, hz)
    low = active_damping_ns_per_m * alpha(active_damping_ns_per_m, R_OHM - R_HAT_OHM)

    assert found[0].real == pytest.approx(low, rel=3e-3)
    assert found.real[hz < 101.0].min() > 0.95 * low
    assert found.real[-1] < 0.65 * low
    assert found.real.min() > 0.0


def test_tolerances_of_the_parts_spread_delivered_damping_by_less_than_a_fifth():
    rng = np.random.default_rng(2008)
    delivered = [impedance(1.74, ONE_HZ, draw(rng))[0].real for _ in range(DRAWS)]

    assert 0.03 < np.std(delivered) / np.mean(delivered) < 0.1
    assert max(delivered) < 1.2 * 1.74
    assert min(delivered) > 0.8 * 1.74


# --- Eq. 3: the winding alone ---------------------------------------------------------------------


def test_shorted_winding_damps_by_k2_over_r_without_any_electronics():
    v = VALUES
    around_ohm = R_OHM + v["r_wire"].value + v["r_on"].value

    assert shorted(ONE_HZ)[0].real == pytest.approx(K_F**2 / around_ohm, rel=1e-3)
    bare = {"r_wire": 1e-6, "r_on": 1e-6}
    assert shorted(ONE_HZ, bare)[0].real == pytest.approx(1.70, rel=1e-3)


# --- wrong resistance -----------------------------------------------------------------------------


@pytest.mark.parametrize("wrong", [-0.3, -0.2, -0.1, 0.1, 0.2, 0.3])
def test_wrong_resistance_scales_delivered_damping_by_alpha(wrong):
    """`wrong` is R^ / R - 1; at 1.74 N s/m even 30 % too much does not latch."""
    found = impedance(1.74, ONE_HZ, compensating(R_OHM * (1.0 + wrong)))[0].real

    assert found == pytest.approx(1.74 * alpha(1.74, -wrong * R_OHM), rel=3e-3)


def test_a_compensation_for_60_degrees_has_a_loop_gain_of_0_16_or_0_93_on_a_winding_of_20():
    too_much_ohm = copper_ohm(60.0) - copper_ohm(20.0)

    assert deep(1.74, too_much_ohm) == pytest.approx(0.16, abs=0.005)
    assert deep(10.0, too_much_ohm) == pytest.approx(0.925, abs=0.005)
    at_most = studies.DEEPEST * K_F**2 / too_much_ohm
    assert at_most == pytest.approx(3.24, abs=0.02)


@pytest.mark.parametrize(("share", "latches"), [(0.3, False), (0.9, False), (1.1, True)])
def test_over_compensation_latches_up_at_a_loop_gain_of_one_and_at_no_less(share, latches):
    """A push of 10 mN for 1 ms: gone after 0.3 s, or the amplifier at its limit for good."""
    r_hat_ohm = R_OHM + share * K_F**2 / FULL_NS_PER_M
    force = kicked(FULL_NS_PER_M, 0.3, compensating(r_hat_ohm))["v(force)"]

    if latches:
        assert abs(force[-1]) > 8.0
    else:
        assert abs(force[-1]) < 1e-6
        assert np.abs(force).max() < 0.02


def test_at_the_bound_the_static_gain_is_1_43_and_at_0_92_it_is_12_5():
    static = {}
    for share in (studies.DEEPEST, 0.92):
        r_hat_ohm = R_OHM + share * K_F**2 / FULL_NS_PER_M
        found = impedance(FULL_NS_PER_M, ONE_HZ, compensating(r_hat_ohm))[0].real
        static[share] = found / FULL_NS_PER_M

    assert static[studies.DEEPEST] == pytest.approx(1.43, rel=0.01)
    assert static[0.92] == pytest.approx(12.5, rel=0.03)


@pytest.mark.parametrize("celsius", [15.0, 20.0, 40.0, 60.0, 80.0])
def test_compensated_for_the_coldest_winding_it_is_never_over_compensated(celsius):
    found = impedance(1.74, ONE_HZ, {"t_motor": celsius})[0].real

    assert found == pytest.approx(1.74 * alpha(1.74, copper_ohm(celsius) - R_HAT_OHM), rel=3e-3)
    assert found < 1.74


# --- where the circuit itself rings ---------------------------------------------------------------


def test_circuit_rings_above_its_ceiling_and_not_below():
    highest, hz = ceiling()
    below = kicked(0.9 * highest, 0.012, step_s=2e-6)
    above = kicked(1.1 * highest, 0.012, step_s=2e-6)

    assert 60.0 < highest < 75.0
    assert 5e3 < hz < 9e3
    assert growth_per_s(below, 0.003, 0.006, 0.001) < 0.0
    assert abs(above["v(force)"]).max() > 1.0


@pytest.mark.parametrize(("error", "least"), [(-0.3, 18.0), (-0.1, 35.0), (0.1, 120.0)])
def test_a_winding_with_less_inductance_than_compensated_rings_sooner(error, least):
    """`error` is that of the winding's own inductance; L^ stays."""
    highest, _ = ceiling({"l_motor": VALUES["l_motor"].value * (1.0 + error)})

    assert least < highest < 1.3 * least
    assert highest > FULL_NS_PER_M


# --- offset and noise -----------------------------------------------------------------------------


def test_fifty_microvolts_at_the_sense_are_one_milliampere_and_1_65_mn_and_make_the_device_creep():
    offset = {"vos_ina": 50e-6}
    held, _ = resting(0.0, offset)
    through_damping = resting(1.74, offset)[0] / alpha(1.74, R_OHM - R_HAT_OHM) - held

    assert abs(held) == pytest.approx(1.65e-3, rel=0.01)
    # the same offset reaches the damping by R^ i, with the other sign
    assert through_damping == pytest.approx(1.74 * R_HAT_OHM * 1e-3 / K_F, rel=0.4)
    assert np.sign(through_damping) == -np.sign(held)
    assert abs(resting(0.0, offset)[1]) > 4e-3  # m/s, against viscous friction alone
    assert abs(resting(FULL_NS_PER_M, offset)[0]) > 5e-3


def test_white_noise_of_the_parts_is_micronewtons_in_1_khz():
    """1/f noise and that of the converters is not in the netlist."""
    quiet, damped, most = (noise_mn(b) for b in (0.0, 1.74, FULL_NS_PER_M))

    assert 0.002 < quiet < 0.01
    assert 0.002 < damped < 0.01
    assert most < 0.03


# --- saturation -----------------------------------------------------------------------------------


def test_damping_vanishes_in_an_impact_that_saturates_the_amplifier():
    """-8.09 N commanded and 5 N s/m: at rest, and at a speed whose damping has no room left."""
    level = 5.0
    slow = (driven(0.0, 0.21, level) - driven(0.0, 0.2, level)) / 0.01
    fast = (driven(0.0, 1.51, level) - driven(0.0, 1.5, level)) / 0.01

    assert slow == pytest.approx(-level * alpha(level, R_OHM - R_HAT_OHM), rel=0.01)
    assert abs(fast) < 0.05
    limit_n = K_F * VALUES["i_limit"].value
    assert abs(driven(0.0, 1.5, level)) == pytest.approx(limit_n, rel=0.02)


def test_supply_limits_the_force_in_the_direction_of_a_fast_motion():
    """(V_max - K v) / R is less than the command there; the estimate uses the measured voltage."""
    speed = 4.0
    force = driven(2.5, speed, 0.0, {"v_op": 100.0})
    resistances = R_OHM + sum(VALUES[name].value for name in ("r_sense", "r_wire", "r_on")) + 0.01
    v = {name: one.value for name, one in VALUES.items()}
    reach_a = (v["v_supply"] - v["v_drop"] - K_F * speed) / (resistances + v["r_drop"])

    assert force == pytest.approx(K_F * reach_a, rel=0.03)
    assert force < 8.09


# --- power-up, reset, pulled plug, emergency stop -------------------------------------------------

FALLS = "pwl(0 2.5 5m 2.5 6m 0)"
OFF_AT_5_MS = "pwl(0 1 5m 1 5.01m 0)"


def force_at(waves, seconds):
    return float(waves["v(force)"][np.searchsorted(waves["time"], seconds) - 1])


def test_power_up_makes_no_force_wherever_the_torque_dac_floats():
    for volt in (0.0, 2.1):
        rising = {"enable": "0", "ref": "pwl(0 0 5m 0 6m 2.5)", "dac": f"pwl(0 0 5m 0 6m {volt})"}
        waves = switched(rising)

        assert np.abs(waves["v(force)"]).max() < 2.0 * LEAK_N


def test_reset_of_the_processor_ends_the_force_by_the_enable_alone():
    """The DAC keeps its 2.5 V and the damping its level."""
    waves = switched({"dac": "2.5", "enable": OFF_AT_5_MS}, values=level_for(1.74))

    assert force_at(waves, 0.0049) > 6.0
    assert np.abs(waves["v(force)"][waves["time"] > 0.0051]).max() < 2.0 * LEAK_N


def test_a_pulled_plug_ends_the_force_even_with_the_amplifier_stuck_on():
    """The offset of the level shifter is the reference of the DAC: both fall together."""
    stuck = switched({"dac": FALLS, "ref": FALLS}, 0.08)
    pulled = switched({"dac": FALLS, "ref": FALLS, "enable": OFF_AT_5_MS})

    assert force_at(stuck, 0.0049) > 8.0
    assert abs(force_at(stuck, 0.08)) < 1e-4
    assert np.abs(stuck["v(force)"]).max() < 8.1  # never on to the other sign
    assert abs(force_at(pulled, 0.0052)) < 2.0 * LEAK_N


def test_emergency_stop_opens_the_amplifier_before_it_shorts_the_winding():
    speed = 0.2
    waves = emergency_stop(speed)
    time, force, top = (waves[name] for name in ("time", "v(force)", "v(top)"))
    v = VALUES
    open_s = 0.005 + v["t_open"].value
    short_s = 0.005 + v["t_short"].value
    between = (time > open_s + 0.002) & (time < short_s - 0.001)

    assert force_at(waves, 0.0049) > 3.0
    assert np.abs(force[between]).max() < 5e-3
    assert np.abs(top).max() < v["v_tvs"].value * 1.05
    around_ohm = R_OHM + v["r_wire"].value + v["r_on"].value
    assert force_at(waves, 0.03) == pytest.approx(-(K_F**2) / around_ohm * speed, rel=2e-3)
