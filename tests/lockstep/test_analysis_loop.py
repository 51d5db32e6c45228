"""The sampled loop: closed forms, the z-plane, and what the recorded channels show."""

import numpy as np
import pytest
from support.analysis_devices import display, law_on_device, rigid

from hapticd.model.effects import AntiAlias, Load, VelocityHighpass
from hapticd.model.loop import derivatives, held_force_model, pulse_transfer, spectral_radius
from hapticd.model.predict import predicted_impedance
from hapticd.model.step import held_force_response

F = np.array([0.5, 2.0, 10.0, 47.0, 120.0, 333.0, 499.0, 700.0, 1500.0])
T = 1e-3
NONE = (None, None)


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
    assert held_force_model(np.array([1.0]), 1000.0, 0.125)[0] == pytest.approx(
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
        for signal in (torque, law_on_device(model, point, torque))
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
