"""Dry friction, counts and the 8 N limit: where trials come to rest, and where they do not."""

import numpy as np
import pytest
from support.devices import COUNTS, MOTOR, STAR, device, rigid
from support.dry_friction import stop_time_s, turning_points_m
from support.engine_friction import BELOW_FRICTION_N, FIG4, RIGID_DRY
from support.engine_state import final

from hapticd.model.effects import Coulomb, Encoder, Load, Masses, Saturation, Viscous
from hapticd.model.scene import Excitation
from hapticd.zwidth.engine.batch import simulate

RAW = (None, None)
STILL = Excitation("none")
FREE = [[0.0, 0.0, 0.0]]
MASS = 0.008
QUANTUM_M = 0.5e-6


@pytest.mark.parametrize("substeps", [1, 4, 16])
def test_slide_stops_when_and_where_mechanics_says_and_stays(substeps):
    """m v / Fc = 13.33 ms, m v^2 / 2 Fc; then the velocity is 0 to the last bit."""
    model = rigid(0.0, Coulomb(rotor_n=0.03))
    result = simulate(
        model, FREE, 0.05, excitation=STILL, start=(0.0, 0.05), substeps=substeps, keep="records"
    )
    velocity = result.velocity_m_per_s[0]
    stop_s = stop_time_s(MASS, 0.05, 0.03)
    assert np.flatnonzero(velocity)[-1] == int(stop_s * 4000)
    assert not velocity[int(stop_s * 4000) + 1 :].any()
    assert velocity.sum() / 4000 == pytest.approx(0.5 * MASS * 0.05**2 / 0.03, rel=2e-4 / substeps)


def test_spring_loses_the_known_step_at_every_turn():
    """Each half cycle ends 2 Fc / K nearer to the middle; the rest is inside Fc / K, where it
    stays exactly.
    """
    parts = (Masses(rotor_kg=MASS), MOTOR, Load(stiffness_n_per_m=200.0), Coulomb(rotor_n=0.03))
    result = simulate(
        device(*parts, delay=0),
        FREE,
        0.3,
        excitation=STILL,
        start=(2.1e-3, 0.0),
        substeps=16,
        keep="records",
    )
    position = 2.1e-3 + np.concatenate([[0.0], np.cumsum(result.velocity_m_per_s[0])]) / 4000
    expected = turning_points_m(2.1e-3, 200.0, 0.03)
    assert len(expected) == 8
    turns = position[1:-1][np.diff(np.sign(np.diff(position))) != 0]
    assert np.allclose(turns[: len(expected) - 2], expected[1:-1], atol=2e-6)
    assert position[-1] == pytest.approx(expected[-1], abs=1e-6)
    assert not result.velocity_m_per_s[0, -100:].any()
    half_cycle_s = np.pi * np.sqrt(MASS / 200.0)
    assert np.flatnonzero(result.velocity_m_per_s[0])[-1] / 4000 == pytest.approx(
        7 * half_cycle_s, abs=3e-4
    )


@pytest.mark.parametrize(("push", "moves"), [(0.0499, False), (0.0501, True)])
def test_two_contacts_hold_up_to_the_sum_of_their_levels(push, moves):
    model = device(*STAR, Coulomb(rotor_n=0.02, slider_n=0.03))
    result = simulate(
        model, FREE, 0.5, excitation=Excitation("push", force_n=push), substeps=4, keep="records"
    )
    tail = result.velocity_m_per_s[0, 1000:]
    assert tail.any() == moves


@pytest.mark.parametrize("substeps", [1, 4])
def test_stuck_body_has_no_velocity_to_the_last_bit(substeps, monkeypatch):
    """Pushed by noise below its friction level, both contacts stuck."""
    model = device(*STAR, Coulomb(rotor_n=0.02, slider_n=0.03))
    options = {"excitation": BELOW_FRICTION_N, "start": (1e-5, 0.0), "substeps": substeps}
    rows, _ = final(monkeypatch, model, [[100.0, 1.0, 0.0]] * 3, 1.0, **options)
    assert not rows["X1"].any()
    assert not rows["X3"].any()
    assert rows["U"].any()


@pytest.mark.parametrize("dtype", ["f32", "f64"])
def test_stuck_rigid_body_stays_at_one_place(dtype):
    options = {"excitation": BELOW_FRICTION_N, "start": (1e-5, 0.0), "substeps": 4, "dtype": dtype}
    result = simulate(device(*RIGID_DRY), FIG4, 1.0, keep="ticks", **options)
    assert (result.position_m == result.position_m[0, 0]).all()


def test_stuck_slider_stays_at_one_place_while_the_rotor_moves():
    """The engine keeps its distance from the rotor, which shakes on the coupling's spring."""
    model = device(*STAR, Coulomb(rotor_n=1e-9, slider_n=0.05))
    result = simulate(model, FIG4, 1.0, excitation=BELOW_FRICTION_N, substeps=4, keep="ticks")
    assert abs(result.velocity_m_per_s).max() > 1e-5
    assert abs(result.position_m).max() < 1e-20


def test_stuck_rotor_lets_the_slider_ring_about_one_place():
    """Both masses start beside the ground's spring; the rotor is held, and the slider comes to
    rest on two springs.
    """
    coupling = 4e4
    ground = 1e3
    start = 1e-5
    model = device(*STAR, Load(stiffness_n_per_m=ground), Coulomb(rotor_n=0.0293))
    result = simulate(
        model, FREE, 1.0, excitation=STILL, start=(start, 0.0), substeps=4, keep="ticks"
    )
    assert not result.velocity_m_per_s.any()
    slider = result.position_m[0]
    assert abs(slider[:5] - slider[-1]).max() > 1e-8
    assert slider[-1] == pytest.approx(start * coupling / (coupling + ground), rel=1e-9)


@pytest.mark.parametrize("rate_hz", [500.0, 1000.0, 2000.0])
def test_friction_above_half_a_count_of_stiffness_ends_the_limit_cycle(rate_hz):
    """Diolaiti et al. 2006: Fc > K q / 2 comes to rest whatever the rate.

    Without friction a cycle may stay. A rounding error is a force of at most K q / 2; against the
    damping that the hold leaves it drives at most K q / 2 / ((b - K T / 2) w) at the resonance w.
    """
    stiffness = 400.0
    leak = stiffness / (2.0 * rate_hz)
    moving, resting = (
        simulate(
            rigid(1.1 * leak, Encoder(quantum_m=QUANTUM_M), *friction, rate_hz=rate_hz),
            [[stiffness, 0.0, 0.0]],
            60.0,
            excitation=STILL,
            start=(2e-4, 0.0),
            filters=RAW,
            substeps=4,
            keep="records",
        )
        for friction in ((), (Coulomb(rotor_n=0.6 * stiffness * QUANTUM_M),))
    )
    assert not resting.velocity_m_per_s[0, -4000:].any()
    tail = np.cumsum(moving.velocity_m_per_s[0, -4000:]) / 4000
    assert (
        QUANTUM_M < np.ptp(tail) < stiffness * QUANTUM_M / (0.1 * leak * np.sqrt(stiffness / MASS))
    )


def test_counts_leave_no_trace_of_the_sub_step():
    """Exact map and integer counts: trials at 1, 4 and 16 sub-steps differ by rounding alone."""
    model = rigid(0.5, COUNTS, delay=0.125)
    options = {"excitation": STILL, "start": (1e-4, 0.0), "keep": "ticks"}
    results = [simulate(model, [[600.0, 0.1, 0.0]], 1.0, substeps=n, **options) for n in (1, 4, 16)]
    for other in results[1:]:
        assert np.array_equal(results[0].force_n, other.force_n)
        assert np.abs(results[0].velocity_m_per_s - other.velocity_m_per_s).max() < 7e-15


def test_count_is_far_below_what_binds_the_device():
    """K <= 2 Fc / q: 600 N/m need 150 uN of friction, the device has 29 mN, so counts change
    nothing that matters.
    """
    fine, coarse = (
        simulate(
            device(*STAR, Coulomb(rotor_n=0.0293), *extra),
            [[600.0, 0.0, 0.0]],
            20.0,
            3,
            active_damping=1.74,
        )
        for extra in ((), (COUNTS,))
    )
    assert coarse.sigma_v_m_per_s[0] == pytest.approx(fine.sigma_v_m_per_s[0], rel=2e-3)


@pytest.mark.parametrize(("share", "escapes"), [(0.2, False), (8.0, True)])
def test_friction_holds_an_unstable_spring_until_the_noise_is_too_strong(share, escapes):
    """b_lin sigma^2 + 0.8 Fc sigma = S / (4 m) has a solution with b_lin < 0 only for 4 |b_lin| P <
    (0.8 Fc)^2.

    Beyond, the trial leaves for the 8 N limit. b_lin = b - K (T / 2) for a spring below its
    resonance.
    """
    coulomb = 0.03
    damping = 0.2
    stiffness = 500.0
    linear = damping - stiffness * 0.5e-3
    assert linear < 0.0
    power = share * (0.8 * coulomb) ** 2 / (4.0 * abs(linear))
    model = rigid(damping, Coulomb(rotor_n=coulomb), Saturation(limit_n=8.0))
    noise = Excitation("noise", psd_n2_per_hz=4.0 * MASS * power)
    result = simulate(
        model, [[stiffness, 0.0, 0.0]] * 3, 30.0, 1, excitation=noise, own_torque=True
    )
    assert not result.diverged.any()
    assert (result.max_force_n == 8.0).all() if escapes else (result.max_force_n < 4.0).all()


def test_saturation_is_left_without_a_scar():
    """20 cm away from a 200 N/m spring: 8 N at first, then the law takes over where it would
    have been.
    """
    model = device(
        Masses(rotor_kg=MASS),
        MOTOR,
        Viscous(rotor_ns_per_m=2.0),
        Saturation(limit_n=8.0),
        delay=0.125,
    )
    result = simulate(
        model, [[200.0, 1.0, 0.002]], 3.0, excitation=STILL, start=(0.2, 0.0), keep="ticks"
    )
    force = result.force_n[0]
    position = result.position_m[0]
    assert result.max_force_n[0] == 8.0
    first_free = int(np.argmax(np.abs(force) < 8.0))
    assert 10 < first_free < 500
    linear = simulate(
        device(Masses(rotor_kg=MASS), MOTOR, Viscous(rotor_ns_per_m=2.0), delay=0.125),
        [[200.0, 1.0, 0.002]],
        3.0,
        excitation=STILL,
        start=(0.2, 0.0),
        keep="ticks",
    )
    assert np.abs(linear.force_n).max() > 30.0
    assert abs(position[-1]) < 1e-6
    assert np.abs(force[-100:]).max() < 1e-3
