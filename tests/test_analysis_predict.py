"""The predicted loop: closed forms, the z-plane, friction, a simulation of the true law, and
what is refused.
"""

import re

import numpy as np
import pytest
from analysis_devices import display, rigid
from hypothesis import given, settings
from hypothesis import strategies as st
from law import environment_tuple

from hapticd.analysis.impedance import impedance
from hapticd.analysis.linearise import (
    GAIN,
    LonePort,
    MovingPort,
    Perturbation,
    density_weights,
    hung,
    port_admittance,
)
from hapticd.analysis.loop import (
    close_loop,
    derivatives,
    held,
    pulse_transfer,
    spectral_radius,
    with_viscous,
)
from hapticd.analysis.passive_set import axis_limit
from hapticd.analysis.predict import predict, predicted_impedance
from hapticd.analysis.spectra import spa
from hapticd.errors import AnalysisError
from hapticd.params import EnvironmentParams, FilterParams
from hapticd.plant.discrete import discretise
from hapticd.plant.effects import (
    AntiAlias,
    Load,
    Multiplier,
    PassiveHand,
    VelocityHighpass,
    WindingTemperature,
)
from hapticd.plant.step import held_force_response
from hapticd.render.law import at_rest, design_coefficients, render

F = np.array([0.5, 2.0, 10.0, 47.0, 120.0, 333.0, 499.0, 700.0, 1500.0])
T = 1e-3
NONE = (None, None)
WHITE = Perturbation(2.5e-5, 1700.0)


@pytest.mark.parametrize("delay", [0.0, 0.125, 1.0, 1.6])
@pytest.mark.parametrize("point", [(0.0, 0.0, 0.0), (100.0, 1.0, 0.01), (0.0, -0.5, -0.004)])
def test_rigid_device_adds_the_held_law_to_its_own(delay, point):
    """Z = jwm + b + C e^(-jwdT) (1 - e^(-jwT))/(jwT) / (jw), affine in the environment, but for
    images of the motion.
    """
    s = 2j * np.pi * F
    law = np.array(point) @ np.stack((np.ones(F.size), *derivatives(np.exp(s * T), 1000.0)))
    expected = 0.008 * s + 2.0 + law * np.exp(-s * delay * T) * (1 - np.exp(-s * T)) / (s * T) / s
    assert predicted_impedance(rigid(delay=delay), point, F, recorded=False) == pytest.approx(
        expected, rel=2e-3
    )


@pytest.mark.parametrize("point", [(0.0, 0.0, 0.0), (100.0, 1.0, 0.01), (0.0, -0.5, -0.004)])
def test_rigid_device_without_delay_is_exact(point):
    """Y = P (1 - H0 C P/(jw) / (1 + G C)), G from the exact response of a mass to a held force."""
    s = 2j * np.pi * F
    z = np.exp(2j * np.pi * F * T)
    decay, push, reach, shove = held_force_response(0.008, 2.0, T)
    pulse = (shove * (z - decay) + push * reach) / ((z - 1) * (z - decay))
    law = np.array(point) @ np.stack((np.ones(F.size), *derivatives(z, 1000.0)))
    own = 1.0 / (0.008 * s + 2.0)
    expected = own - own * (1 - np.exp(-s * T)) / (s * T) * law * own / s / (1 + pulse * law)
    assert predicted_impedance(rigid(), point, F, recorded=False) == pytest.approx(
        1.0 / expected, rel=1e-9
    )


@pytest.mark.parametrize("delay", [0.0, 0.4, 1.0, 2.25])
def test_pulse_transfer_of_a_free_mass(delay):
    """T^2/m (z+1) / (2 (z-1)^2), and its modified z-transform for the fraction of a tick."""
    z = np.exp(2j * np.pi * F * T)
    whole, d = divmod(delay, 1.0)
    early = (1 - d) ** 2 / 2
    middle = 0.5 + d * (1 - d)
    late = d**2 / 2
    expected = (
        T**2 / 0.008 * (early * z**2 + middle * z + late) / (z * (z - 1) ** 2) * z ** (-whole)
    )
    assert pulse_transfer(rigid(viscous=0.0, delay=delay), z) == pytest.approx(expected, rel=1e-9)


def test_hold_is_half_a_period_late():
    assert held(np.array([1.0]), 1000.0, 0.125)[0] == pytest.approx(
        np.exp(-2j * np.pi * 0.625e-3), rel=1e-5
    )


@pytest.mark.parametrize("beta", [0.1, 0.4, 0.8284, 1.2, 1.8])
def test_stiffness_limit_is_that_of_the_z_plane(beta):
    """Undamped mass, no filter, no delay: K T^2/m = 2 b (2 - b) / (2 + b) with b = B T/m
    (Hulin; Gil).
    """
    alpha = 2 * beta * (2 - beta) / (2 + beta)
    stiff = alpha * 0.008 / T**2
    damper = beta * 0.008 / T
    inside, outside = spectral_radius(
        rigid(viscous=0.0), [[0.999 * stiff, damper, 0], [1.001 * stiff, damper, 0]], filters=NONE
    )
    assert inside < 1.0 < outside


@pytest.mark.parametrize(("delay", "above"), [(0.0, 2.0), (1.0, np.sqrt(5) - 1)])
def test_virtual_mass_limits_are_those_of_the_z_plane(delay, above):
    """-m < M < 2 m without delay, (sqrt 5 - 1) m with one tick."""
    free = rigid(viscous=1e-6, delay=delay)
    masses = 0.008 * np.array([-1.002, -0.998, 0.999 * above, 1.001 * above])
    points = np.column_stack((np.zeros((4, 2)), masses))
    assert list(spectral_radius(free, points, filters=NONE) < 1.0) == [False, True, True, False]


def test_free_device_drifts_and_is_stable():
    assert spectral_radius(rigid(), [[0, 0, 0]])[0] == pytest.approx(np.exp(-2.0 / 0.008 * T))
    assert spectral_radius(rigid(viscous=0.0), [[0, 0, 0]])[0] == pytest.approx(1.0)


def test_held_device_does_not_drift():
    """With a spring of its own K = 0 is no drift: the slow pole counts."""
    held_by = rigid(extra=[Load(stiffness_n_per_m=1.0)])
    assert spectral_radius(held_by, [[0, 0, 0]])[0] == pytest.approx(
        np.exp(-T * 1.0 / 2.0), rel=1e-5
    )


def test_negative_stiffness_is_refused_unless_allowed():
    """Re Z > 0 all over the band, and unstable: 132 of 1,599 random environments are like this."""
    point = [[-34.0, -0.86, 0.0048]]
    found = predict(display(), point, 1.74, perturbation=WHITE)
    assert found.margin_ns_per_m[0] > 0.0
    assert found.refused[0]
    assert not found.passive[0]
    allowed = predict(display(), point, 1.74, perturbation=WHITE, allow_negative_stiffness=True)
    assert allowed.margin_ns_per_m[0] > 0.0
    assert allowed.spectral_radius[0] > 1.0
    assert not allowed.passive[0]


def test_some_passive_looking_environments_are_unstable():
    points = np.random.default_rng(4).uniform((-60, -2, -0.01), (300, 6, 0.02), (1500, 3))
    found = predict(display(), points, 1.74, perturbation=WHITE, allow_negative_stiffness=True)
    looks = found.margin_ns_per_m >= 0.0
    assert 0 < (looks & (found.spectral_radius >= 1.0)).sum() < looks.sum()
    assert not (found.passive & ~(found.spectral_radius < 1.0)).any()


def test_many_points_are_judged_as_each_alone():
    points = np.random.default_rng(2).uniform((0, -1, -0.01), (200, 3, 0.02), (1100, 3))
    together = predict(display(), points, perturbation=WHITE)
    for index in (0, 500, 1023, 1024, 1099):
        alone = predict(display(), points[index : index + 1], perturbation=WHITE)
        assert alone.passive[0] == together.passive[index]
        assert alone.margin_ns_per_m[0] == pytest.approx(together.margin_ns_per_m[index], rel=1e-9)
        assert alone.friction_ns_per_m[0] == pytest.approx(
            together.friction_ns_per_m[index], rel=1e-9
        )


def test_margin_is_the_least_real_part_of_the_impedance():
    point = (50.0, 2.0, 0.0)
    found = predict(display(), [point], perturbation=WHITE)
    band = np.linspace(2.0, 500.0, 9961)
    z = predicted_impedance(display(), point, band, perturbation=WHITE)
    assert found.margin_ns_per_m[0] == pytest.approx(z.real.min(), abs=2e-3)
    assert found.worst_hz[0] == pytest.approx(band[np.argmin(z.real)], abs=0.5)
    assert found.margin_deg[0] == pytest.approx(
        90 - np.degrees(np.abs(np.angle(z))).max(), abs=0.02
    )
    assert (band[0], band[-1]) == (2.0, 500.0)


@given(st.floats(0.005, 0.06), st.floats(0.1, 3.0), st.floats(0.002, 0.02))
@settings(max_examples=20, deadline=None)
def test_friction_of_a_free_mass_follows_its_energy_balance(coulomb, viscous, mass):
    """White force on a mass: variance S / (4 m (b + bc)), so bc = g sqrt(4 m (b + bc) / S); the
    band ends at 1700 Hz.
    """
    found = predict(rigid(mass, viscous, coulomb=coulomb), [[0, 0, 0]], perturbation=WHITE)
    level = found.friction_ns_per_m[0]
    sd = found.velocity_sd[0]
    assert level * sd == pytest.approx(GAIN * coulomb, rel=1e-6)
    corner = (viscous + level) / (2 * np.pi * mass)
    assert sd == pytest.approx(
        np.sqrt(2.5e-5 / (4 * mass * (viscous + level)) * 2 / np.pi * np.arctan(1700 / corner)),
        rel=0.02,
    )


def test_only_friction_squared_over_density_counts():
    point = [[60.0, 1.0, 0.002]]
    one = predict(display(coulomb=0.02), point, perturbation=Perturbation(1e-5, 1700.0))
    other = predict(display(coulomb=0.06), point, perturbation=Perturbation(9e-5, 1700.0))
    assert one.friction_ns_per_m == pytest.approx(other.friction_ns_per_m)
    assert one.margin_ns_per_m == pytest.approx(other.margin_ns_per_m)


def test_friction_on_the_slider_is_felt_at_the_probe():
    point = [[50.0, 2.0, 0.0]]
    on_rotor = predict(display(), point, perturbation=WHITE)
    on_slider = predict(display(coulomb=0.0, slider_coulomb=0.0293), point, perturbation=WHITE)
    split = predict(
        display(coulomb=0.0293 / 2, slider_coulomb=0.0293 / 2), point, perturbation=WHITE
    )
    for other in (on_slider, split):
        assert other.margin_ns_per_m == pytest.approx(on_rotor.margin_ns_per_m, rel=0.1)
        assert other.velocity_sd == pytest.approx(on_rotor.velocity_sd, rel=0.05)
    assert split.friction_ns_per_m == pytest.approx(on_rotor.friction_ns_per_m, rel=0.06)


def test_hung_dampers_equal_dampers_in_the_device():
    """Without a law the admittance with dampers hung on its ports is exactly that of the device
    that has them.
    """
    both = display(coulomb=0.01, slider_coulomb=0.01)
    levels = (0.7, 1.3)
    nothing = np.zeros((1, 3))
    afterwards = hung(port_admittance(close_loop(both, F), nothing), np.array(levels)[:, None])
    inside = port_admittance(close_loop(with_viscous(both, levels), F), nothing)
    assert afterwards == pytest.approx(inside, rel=1e-9)


def test_without_perturbation_there_is_no_friction():
    found = predict(display(), [[50.0, 2.0, 0.0]])
    assert found.friction_ns_per_m[0] == 0.0
    assert np.isnan(found.velocity_sd[0])
    assert found.perturbation is None
    assert found.margin_ns_per_m == pytest.approx(
        predict(display(coulomb=0.0), [[50.0, 2.0, 0.0]], perturbation=WHITE).margin_ns_per_m
    )


def test_device_that_friction_no_longer_holds_is_not_passive():
    """Above the stiffness that viscous friction carries alone, a burst escapes although the
    calm solution has Re Z > 0.
    """
    found = predict(display(), [[90.0, 0, 0], [125.0, 0, 0]], perturbation=WHITE)
    assert list(found.calm) == [True, False]
    assert list(found.passive) == [True, False]
    assert (found.margin_ns_per_m > 0.0).all()


@pytest.mark.parametrize(("level", "reach"), [(0.0, 300.0), (1.74, 1500.0)])
def test_stiffness_axis_fails_once_and_for_good(level, reach):
    points = np.column_stack((np.linspace(0.0, reach, 300), np.zeros((300, 2))))
    passive = predict(display(), points, level, perturbation=WHITE).passive
    assert 0 < passive.sum() < 300
    assert np.array_equal(passive, np.arange(300) < passive.sum())


def calibrated(damping):
    """The calibrated display: 5.4 % of the winding's resistance uncompensated, multiplier
    trimmed for 1.74 N s/m.
    """
    trim = [
        Multiplier(gain_error=1 / 0.945 - 1),
        WindingTemperature(temperature_c=33.45, compensated_c=20.0),
    ]
    model = display(extra=trim)
    return lambda points: predict(model, points, damping, perturbation=WHITE).passive


@pytest.mark.parametrize(
    ("damping", "axis", "reach", "paper"),
    [
        (0.0, 0, 400, 100),
        (0.0, 1, 8, 3),
        (0.0, 2, -0.02, -0.008),
        (1.74, 0, 1500, 600),
        (1.74, 1, 15, 8),
        (1.74, 2, -0.05, -0.022),
    ],
)
def test_six_limits_are_near_the_paper(damping, axis, reach, paper):
    """Linearised friction is good to 17 % of the six axis limits of Weir 2008, section 5; the
    simulation comes nearer.
    """
    assert axis_limit(calibrated(damping), axis, reach) == pytest.approx(paper, rel=0.17)


def simulated(model, point, torque):
    """The true law of the servo around the exact map of the device; the mean velocity at 4 kHz.
    The delay is T/4.
    """
    environment = environment_tuple(EnvironmentParams(*point), 1e9)
    coefficients = design_coefficients(FilterParams(100.0), FilterParams(72.0), model.rate_hz)
    step = discretise(model, 0.25 * T)
    law = at_rest(0.0)
    force = 0.0
    before = 0.0
    x = np.zeros(len(step.a))
    travel = np.zeros(torque.size + 1)
    command = step.b[:, model.inputs.command]
    probe = step.b[:, model.inputs.torque]
    encoder = model.outputs.encoder.row()
    recorded = model.outputs.recorded_travel.row()
    for k, push in enumerate(torque):
        if k % 4 == 0:
            before = force
            force, *_, law = render(float(encoder @ x), law, environment, coefficients)
        x = step.a @ x + command * (force if k % 4 else before) + probe * push
        travel[k + 1] = recorded @ x
    return np.diff(travel) * 4000.0


@pytest.mark.parametrize("point", [(100.0, 1.0, 0.01), (0.0, 2.0, -0.004)])
def test_prediction_is_what_the_true_law_shows(point):
    """25 s of the servo's own law on the exact device, measured as a trial is, against the
    formula.
    """
    model = display(coulomb=0.0, viscous=1.5, delay=0.25)
    torque = 0.22 * np.random.default_rng(1).standard_normal(100_000)
    found = impedance(spa(torque, simulated(model, point, torque)), "h_force")
    inside = (found.frequency_hz > 5.0) & (found.frequency_hz < 450.0)
    expected = predicted_impedance(model, point, found.frequency_hz[inside])
    error = np.log(found.impedance_ns_per_m[inside] / expected)
    assert np.median(np.abs(error)) < 0.01
    assert np.abs(np.mean(error)) < 0.003
    assert np.mean(np.abs(error.imag) < 3.0 * found.relative_sd[inside] + 0.01) > 0.97


def test_recorded_mass_reads_as_the_tangent():
    """v' = v + h u / m, mean velocity v + h u / (2 m): Z = (2 m / h) (z - 1) / (z + 1), images
    and all.
    """
    found = predicted_impedance(rigid(viscous=1e-9), (0.0, 0.0, 0.0), F)
    assert found == pytest.approx(1j * 2.0 * 0.008 * 4000.0 * np.tan(np.pi * F / 4000.0), rel=1e-6)


@pytest.mark.parametrize("point", [(100.0, 1.0, 0.01), (200.0, 2.0, 0.0), (30.0, 0.0, -0.004)])
@pytest.mark.parametrize(
    "make", [lambda: rigid(delay=0.25), lambda: display(coulomb=0.0, viscous=1.5, delay=0.25)]
)
def test_images_of_the_law_are_nothing_below_500_hz(make, point):
    """A multisine through the servo's own law, line by line: no noise, the law's images
    included.
    """
    model = make()
    f = np.arange(2.0, 500.0, 7.0)
    torque = sines(f, 20_000)
    force, velocity = (
        np.fft.rfft(signal[-4000:])[f.astype(int)]
        for signal in (torque, simulated(model, point, torque))
    )
    assert force / velocity == pytest.approx(predicted_impedance(model, point, f), rel=5e-5)


def sines(f, count):
    phase = np.random.default_rng(7).uniform(0.0, 2.0 * np.pi, (f.size, 1))
    return 0.02 * np.cos(2.0 * np.pi * f[:, None] * np.arange(count) / 4000.0 + phase).sum(axis=0)


def test_recorded_channels_show_their_own_dynamics():
    point = (100.0, 1.0, 0.01)
    f = F[F < 500.0]
    seen = [
        predicted_impedance(display(extra=extra), point, f)
        for extra in ([], [VelocityHighpass(corner_hz=0.1)])
    ]
    assert seen[1] / seen[0] == pytest.approx(1.0 + 0.1 / (1j * f), rel=1e-6)


def test_filter_before_the_means_leaves_no_images():
    """Both channels are averaged then: Z is true with a low corner, without it |Z| is 5 %
    larger.
    """
    point = (100.0, 1.0, 0.01)
    f = F[F < 500.0]
    filtered = predicted_impedance(display(extra=[AntiAlias(corner_hz=20.0)]), point, f)
    assert filtered == pytest.approx(
        predicted_impedance(display(), point, f, recorded=False), rel=2e-3
    )
    assert abs(predicted_impedance(display(), point, f) / filtered)[-1] > 1.05


def test_added_damping_adds_to_the_low_end():
    gained = predicted_impedance(display(), (0, 0, 0), F[1:3], 1.74) - predicted_impedance(
        display(), (0, 0, 0), F[1:3], 0.0
    )
    assert gained.real == pytest.approx(1.74, rel=1e-3)


def test_passive_hand_does_not_make_a_passive_loop_unstable():
    """Coupled stability: what is called passive stays stable in the hand (Colgate and Hogan
    1988).
    """
    random = np.random.default_rng(3)
    points = random.uniform((0, 0, -0.004), (80, 2.5, 0.01), (60, 3))
    passive = points[predict(display(coulomb=0.0, viscous=1.5), points).passive]
    assert len(passive) > 20
    for _ in range(20):
        m, b, k, grip_k, grip_b = random.uniform(
            (0.001, 0.2, 5, 200, 0.5), (0.05, 4, 300, 5000, 10)
        )
        hand = PassiveHand(
            mass_kg=m,
            damping_ns_per_m=b,
            stiffness_n_per_m=k,
            grip_stiffness_n_per_m=grip_k,
            grip_damping_ns_per_m=grip_b,
        )
        assert (
            spectral_radius(display(coulomb=0.0, viscous=1.5, extra=[hand]), passive) < 1.0
        ).all()


@pytest.mark.parametrize("points", [[[1.0, 2.0]], [1.0, 2.0, 3.0], [[np.inf, 0.0, 0.0]]])
def test_environments_must_be_finite_triples(points):
    message = "rows of three finite numbers K [N/m], B [N s/m], M [kg] are needed"
    with pytest.raises(AnalysisError, match=re.escape(message)):
        predict(display(), points)


def test_empty_list_is_judged_empty():
    assert predict(display(), np.empty((0, 3)), perturbation=WHITE).passive.size == 0


def test_edge_of_what_bursts_bear_has_no_teeth():
    """Largest K over B at one M rises, then falls: bursts see a narrow resonance between the
    lines too.
    """
    damping = np.linspace(0.0, 4.0, 41)
    stiffness = np.linspace(0.0, 400.0, 401)
    points = np.array([(k, b, -0.0024) for b in damping for k in stiffness])
    passive = predict(display(), points, perturbation=WHITE).passive.reshape(41, 401)
    edge = passive.sum(axis=1)
    assert np.array_equal(passive, np.arange(401) < edge[:, None])
    top = np.argmax(edge)
    assert (np.diff(edge[: top + 1]) >= 0).all()
    assert (np.diff(edge[top:]) <= 0).all()


def test_deviation_of_a_narrow_resonance_is_that_of_its_closed_form():
    """White force on mass, spring and damper: variance S / (4 m b), whatever the grid; a sum of
    lines is 70 % off.
    """
    f = np.arange(1.0, 200.0, 2.0)
    for stiffness in np.linspace(60.0, 70.0, 11):
        y = 1.0 / (0.3 + 2j * np.pi * f * 0.008 + stiffness / (2j * np.pi * f))[None]
        alone = LonePort(np.abs(y) ** 2, y.real, y.imag, 0.3)
        weight = density_weights(f, Perturbation(2.5e-5, 1e9))
        for damper in (0.3, 0.1, 0.01):
            found = MovingPort(f, alone, weight).sd(np.array([damper]))[0]
            assert found == pytest.approx(np.sqrt(2.5e-5 / (4.0 * 0.008 * damper)), rel=0.05)
