"""Periods of a multisine: exact for a linear device, with an interval that is valid with noise and
with friction.
"""

from dataclasses import replace

import numpy as np

from hapticd.model.excitation import generator, multisine
from hapticd.model.scene import Excitation
from hapticd.signal.impedance import impedance, relative_sd
from hapticd.signal.verdict import student_quantile
from hapticd.zwidth.engine.batch import simulate
from support.spectral_trials import mass_damper

RATE_HZ = 4000.0
PERIOD = 4096
BAND = (2.0, 500.0)
SHAKEN = Excitation("multisine", force_n=0.2, period_s=PERIOD / RATE_HZ)
DEVICE = mass_damper(0.008, 1.0, 50.0)


def forces(realisations, periods, seed=1, shaken=SHAKEN):
    """(realisations, periods, PERIOD) of force."""
    one = np.stack([multisine(shaken, generator(seed, number)) for number in range(realisations)])
    return np.repeat(one[:, None], periods, axis=1)


def answered(force, device=DEVICE, noise_m_per_s=0.0, seed=1):
    """Velocity of a linear device in steady state, with white noise of the sensor."""
    f = np.fft.rfftfreq(PERIOD, 1.0 / RATE_HZ)
    f[0] = f[1]
    spectrum = np.fft.rfft(force, axis=2) / device(f)
    spectrum[..., 0] = 0.0
    noise = noise_m_per_s * np.random.default_rng(seed).standard_normal(force.shape)
    return np.fft.irfft(spectrum, PERIOD, axis=2) + noise


def inside(found, band=BAND):
    return (found.frequency_hz >= band[0]) & (found.frequency_hz <= band[1])


def covered(found, truth):
    """Return the frequencies of the band at which the 95 % interval of the phase contains the
    truth.
    """
    freedom = found.degrees_of_freedom - 2.0
    half = student_quantile(0.975, freedom) * relative_sd(found.coherence, freedom)
    use = inside(found)
    turned = np.angle(impedance(found, "h_force").impedance_ns_per_m[use] / truth[use])
    return np.abs(turned) <= half[use]


# --- nonlinear devices ----------------------------------------------------------------------------


def simulated(model, point, count, periods):
    """Return (count, periods, PERIOD) of force and velocity of a simulated display, without the
    first period.
    """
    force = np.tile(
        forces(count, 1, shaken=replace(SHAKEN, band_hz=500.0, force_n=0.11))[:, 0],
        (1, periods + 1),
    )
    found = simulate(
        model,
        np.tile(point, (count, 1)),
        force.shape[1] / RATE_HZ,
        keep="records",
        own_torque=True,
        excitation=force,
        substeps=4,
    )
    return tuple(
        np.asarray(signal, np.float64).reshape(count, periods + 1, PERIOD)[:, 1:]
        for signal in (found.torque_n, found.velocity_m_per_s)
    )
