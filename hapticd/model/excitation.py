"""Perturbation records at 4 kHz, one value held for each 250 us, from a counter-based generator.

Noise is band-limited Gaussian: white at the given one-sided density S [N^2/Hz] up to the band, then
a raised cosine down to 0 at the end of the taper, made in the frequency domain over the whole
record. Stream i of a seed is Philox with the key (seed, i). It gives the same numbers in any order
of drawing, so results cannot depend on chunks or threads.

rms = sqrt(S x band) plus the taper: 2.5e-5 N^2/Hz to 1.7 kHz is 0.21 N.

A mark is a maximum-length sequence of 1023 signs, one sample each (Golomb, "Shift Register
Sequences", 1967). It identifies a trial in a record of another system and shows where it begins
(`zwidth.alignment`). Its amplitude is the rms of the perturbation that it replaces, so it satisfies
every limit of the perturbation.

A stream must not be drawn in pieces: a record is made whole, then cut.
"""

from enum import IntEnum
from math import pi, sqrt

import numpy as np

from hapticd.core.arrays import Floats
from hapticd.core.errors import ConfigError
from hapticd.core.units import PROBE_RATE_HZ
from hapticd.model.scene import Excitation

__all__ = ["Stream", "band_noise", "generator", "mark_signs", "marked", "torque_record"]

NOISE_SAMPLES_MAX = 1 << 26  # of one record: half a gigabyte, 4.7 hours
MARK_ORDER = 10  # stages of the shift register
MARK_TAPS = (3, 10)  # x^10 + x^3 + 1 is primitive
MARK_LEAD = 1000  # samples of perturbation before the mark
TAPER = 1.12  # the cosine ends at this multiple of the band, or at 2 kHz


class Stream(IntEnum):
    """Families of streams, 2^32 apart; trial i draws from family + i."""

    SHARED = 0
    TORQUE = 1 << 32
    ESTIMATE = 2 << 32
    VELOCITY = 3 << 32


def generator(seed: int, stream: int) -> np.random.Generator:
    """The generator of one stream."""
    return np.random.Generator(np.random.Philox(key=np.array([seed, stream], dtype=np.uint64)))


def torque_record(
    excitation: Excitation, samples: int, seed: int, stream: int = Stream.SHARED
) -> Floats:
    """Return the force [N] at the endpoint, (samples,), or one period of it, which is then
    repeated.

    ConfigError for an unknown kind, a band beyond 2 kHz, or noise too long for memory.
    """
    if excitation.kind == "none":
        return np.zeros(samples)
    if excitation.kind == "push":
        return np.where(
            np.arange(samples) >= round(excitation.start_s * PROBE_RATE_HZ), excitation.force_n, 0.0
        )
    if not 0.0 < excitation.band_hz <= 0.5 * PROBE_RATE_HZ:
        raise ConfigError(
            f"excitation band {excitation.band_hz:g} Hz: must lie between 0 and"
            f" {PROBE_RATE_HZ // 2} Hz"
        )
    if excitation.kind == "noise":
        if samples > NOISE_SAMPLES_MAX:
            raise ConfigError(
                f"noise for {samples / PROBE_RATE_HZ:g} s needs {samples * 8e-9:.1f} GB, at most"
                f" {NOISE_SAMPLES_MAX / PROBE_RATE_HZ:g} s are made; use a multisine or a record"
                " that repeats"
            )
        return band_noise(
            samples, excitation.psd_n2_per_hz, excitation.band_hz, generator(seed, stream)
        )
    if excitation.kind == "multisine":
        return multisine(excitation, generator(seed, stream))
    raise ConfigError(f"excitation {excitation.kind!r}: use one of none, noise, multisine, push")


def band_noise(
    samples: int, psd_n2_per_hz: float, band_hz: float, random: np.random.Generator
) -> Floats:
    """Return Gaussian noise [N] (samples,), of one-sided density `psd_n2_per_hz` up to `band_hz`.
    Its mean is 0.
    """
    frequency_hz = np.fft.rfftfreq(samples, 1.0 / PROBE_RATE_HZ)
    end_hz = min(TAPER * band_hz, 0.5 * PROBE_RATE_HZ)
    fall = np.clip((frequency_hz - band_hz) / max(end_hz - band_hz, 1e-9), 0.0, 1.0)
    amplitude = (
        sqrt(psd_n2_per_hz * PROBE_RATE_HZ * samples / 4.0) * 0.5 * (1.0 + np.cos(pi * fall))
    )
    amplitude[0] = 0.0
    parts = random.standard_normal((2, len(frequency_hz)))
    return np.fft.irfft(amplitude * (parts[0] + 1j * parts[1]), samples)


def multisine(excitation: Excitation, random: np.random.Generator) -> Floats:
    """Return one period [N]: every harmonic up to the band, of equal amplitude and random phase.
    Its rms is `force_n`. ConfigError if the period has no harmonic.
    """
    samples = round(excitation.period_s * PROBE_RATE_HZ)
    highest = int(excitation.band_hz * excitation.period_s)
    if samples < 2 or not 1 <= highest < (samples + 1) // 2:
        raise ConfigError(
            f"multisine of {excitation.period_s:g} s up to {excitation.band_hz:g} Hz has no"
            " harmonics; lengthen period_s"
        )
    spectrum = np.zeros(samples // 2 + 1, dtype=complex)
    spectrum[1 : highest + 1] = np.exp(2j * pi * random.random(highest))
    return np.fft.irfft(spectrum, samples) * (excitation.force_n * samples / sqrt(2.0 * highest))


def mark_signs() -> Floats:
    """Return the mark, (1023,) of +1 and -1: one period of a maximum-length sequence."""
    bits = [1] * MARK_ORDER
    while len(bits) < (1 << MARK_ORDER) - 1:
        bits.append(bits[-MARK_TAPS[0]] ^ bits[-MARK_TAPS[1]])
    return 1.0 - 2.0 * np.array(bits, dtype=np.float64)


def marked(force_n: Floats) -> Floats:
    """Return `force_n` (n,) with a mark of its rms in place of the samples from `MARK_LEAD` on.
    ConfigError if it is too short.
    """
    signs = mark_signs()
    end = MARK_LEAD + signs.size
    if force_n.size < end:
        raise ConfigError(
            f"a perturbation of {force_n.size} samples has no room for a mark, {end} are needed;"
            " make the trial longer"
        )
    return np.concatenate((force_n[:MARK_LEAD], float(np.std(force_n)) * signs, force_n[end:]))
