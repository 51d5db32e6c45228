"""Trials with a known impedance: constructed spectra, and records of a linear device
under noise.
"""

import numpy as np

from hapticd.signal.spectra import Spectra

RATE_HZ = 4000.0
N_SAMPLES = 360_000
LAG = 2048


def exact_trial(
    impedance, coherence=1.0, n_samples=N_SAMPLES, force_psd=2.5e-5, lag=LAG
) -> Spectra:
    """Spectra without error of a device of `impedance(f)`, on the grid of the window."""
    f = np.arange(lag + 1) * (0.5 * RATE_HZ / lag)
    z = impedance(np.maximum(f, f[1]))  # a window excludes the pole at 0 Hz
    force = np.full(f.size, 0.5 * force_psd * RATE_HZ)
    cross = force / z.conj()
    return Spectra(
        f, np.abs(cross) ** 2 / (coherence * force), force, cross, RATE_HZ, n_samples, lag
    )


def filtered(impedance, force: np.ndarray, noise: np.ndarray, rate_hz=RATE_HZ) -> np.ndarray:
    """Velocity of a device of `impedance(f)` under `force` (N,), circular, plus `noise` (N,)."""
    f = np.fft.rfftfreq(force.size, 1.0 / rate_hz)
    f[0] = f[1]
    spectrum = np.fft.rfft(force) / impedance(f)
    spectrum[0] = 0.0
    return np.fft.irfft(spectrum, force.size) + noise


def record(
    impedance, seed: int, n_samples=N_SAMPLES, force_n=0.22, noise_m_per_s=1e-3, rate_hz=RATE_HZ
) -> tuple[np.ndarray, np.ndarray]:
    """Force and velocity of a trial: white force, white noise of the velocity sensor."""
    random = np.random.default_rng(seed)
    force = force_n * random.standard_normal(n_samples)
    return force, filtered(
        impedance, force, noise_m_per_s * random.standard_normal(n_samples), rate_hz
    )


def mass_damper(mass_kg=0.008, damping=1.0, stiffness=0.0):
    """Z(f) of mass, damper and spring."""
    return lambda f: 2j * np.pi * f * mass_kg + damping + stiffness / (2j * np.pi * f)


def with_phase_margin(degrees: float, mass_kg=0.008):
    """Return Z(f) of a mass whose phase is 90 - `degrees` everywhere."""
    return lambda f: 2.0 * np.pi * f * mass_kg * np.exp(1j * np.radians(90.0 - degrees))


def beside_mode(device, mass_kg: float, frequency_hz: float, quality: float):
    """Return Z(f) of `device` with an added mass on a spring, which resonates at that frequency."""
    rate = 2.0 * np.pi * frequency_hz

    def impedance(f):
        s = 2j * np.pi * f
        spring = mass_kg * rate / quality + mass_kg * rate**2 / s
        return device(f) + 1.0 / (1.0 / (s * mass_kg) + 1.0 / spring)

    return impedance
