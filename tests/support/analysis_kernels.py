"""Local polynomials, compiled or not, equal the least squares over the bins of a window."""

import numpy as np

from hapticd.signal.covariances import Fit, Transforms

SAMPLES = 4096
HALF = 20
SERVO = 1000
PLACES = np.array([1, 7, 50, 51, 68, 300, 301, 340, 900, 1500, 2030, 2048])  # ends, overlaps, gaps
ALL = np.arange(SERVO, SAMPLES - 1, SERVO)


def record(noise: float, shifts=ALL, ring: float = 0.999) -> Transforms:
    """Force, and the velocity of a resonance that rings for 1/(1 - ring) samples."""
    random = np.random.default_rng(5)
    force = random.normal(size=SAMPLES)
    velocity = np.zeros(SAMPLES)
    pole = ring * np.exp(2j * np.pi * 0.05)
    for k in range(2, SAMPLES):
        free = 2.0 * pole.real * velocity[k - 1] - ring**2 * velocity[k - 2]
        velocity[k] = free + force[k] - force[k - 1]
    velocity += noise * random.normal(size=SAMPLES)
    return Transforms(np.fft.rfft(force), np.fft.rfft(velocity), SAMPLES, HALF, shifts)


def fitted(fits, whole: Transforms, places=PLACES) -> Fit:
    found = Fit.empty(places.size)
    fits(whole, places, found)
    return found
