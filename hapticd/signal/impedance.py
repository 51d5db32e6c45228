"""From spectra to the impedance, its uncertainty and its unexplained part.

    "spa"       Z = Phi_yu / Phi_u: velocity as the input, the paper's choice
    "h_force"   Z = Phi_y / conj(Phi_yu): force as the input

    g2    = |Phi_yu|^2 / (Phi_u Phi_y)            coherence, of both
    Phi_v = Phi_out - |Phi_yu|^2 / Phi_in         noise spectrum, not below 0: of the force with
                                                  "spa", of the velocity otherwise
    Var Z = (C/N) |Z|^2 (1 - g2) / g2             of the complex value, half of it in each part
    Var Phi_v = (C/N) Phi_v^2                     twice that at 0 and half the sample rate

(Ljung, System Identification, 2nd ed. 1999, section 6.4.) With a noisy velocity "spa" shrinks |Z|
by g2 and preserves its phase. The force is exogenous and almost without noise, so "h_force" has no
such bias: use it where |Z| matters and g2 is low.
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from hapticd.core.arrays import Complexes, Floats
from hapticd.core.errors import AnalysisError
from hapticd.signal.spectra import Spectra

__all__ = ["Impedance", "impedance", "relative_sd", "spread_of"]

Estimator = Literal["spa", "h_force"]


@dataclass(frozen=True, eq=False)
class Impedance:
    """Estimated impedance Z(f) of one trial with its uncertainty."""

    frequency_hz: Floats
    impedance_ns_per_m: Complexes  # (F,) complex128
    sd_ns_per_m: Floats  # (F,) standard deviation of the complex value
    coherence: Floats  # (F,) g2, 0 to 1
    # (F,) spectrum of the output that the input does not explain: N^2 ("spa") or (m/s)^2
    noise: Floats
    noise_sd: Floats  # (F,) standard deviation of `noise`
    estimator: Estimator
    port: str  # where force and velocity were measured
    degrees_of_freedom: float  # nu of each spectral value

    @property
    def phase_deg(self) -> Floats:
        """Phase (F,) in -180..180 degrees."""
        return np.degrees(np.angle(self.impedance_ns_per_m))

    @property
    def relative_sd(self) -> Floats:
        """Standard deviation (F,) of ln|Z|, and of the phase in radians; inf without coherence."""
        return relative_sd(self.coherence, self.degrees_of_freedom)

    def without_mass(self, mass_kg: float, port: str = "device") -> "Impedance":
        """Return the impedance behind a rigid mass at the port, Z - j 2 pi f m. The real part, and
        so the verdict, does not change.
        """
        behind = self.impedance_ns_per_m - 2j * np.pi * self.frequency_hz * mass_kg
        return replace(self, impedance_ns_per_m=behind, port=port)


def relative_sd(coherence: Floats, degrees_of_freedom: float) -> Floats:
    """Return sqrt((1 - g2) / (g2 nu)) (F,): standard deviation of the phase [rad] and of ln|Z|."""
    unexplained = np.divide(
        1.0 - coherence, coherence, out=np.full_like(coherence, np.inf), where=coherence > 0.0
    )
    return np.sqrt(unexplained / degrees_of_freedom)


def reads_high(frequency_hz: float, rate_hz: float) -> float:
    """Return the share by which the recorded channels read Re Z of a rigid device high. Force held
    and velocity averaged over 1/rate make it 1 / sinc^2(f / rate): 0.2 % at 100 Hz of 4 kHz, 5.3 %
    at 500 Hz. `loop` predicts it for other devices.
    """
    return float(1.0 / np.sinc(frequency_hz / rate_hz) ** 2) - 1.0


def spread_of(size: Floats, relative: Floats) -> Floats:
    """Return `size` times its relative spread (F,); inf where the spread is infinite, whatever the
    size.
    """
    return np.asarray(
        np.multiply(size, relative, out=np.full_like(size, np.inf), where=np.isfinite(relative))
    )


def impedance(trial: Spectra, estimator: Estimator = "spa") -> Impedance:
    """Estimate Z with its uncertainty by "spa" (velocity as the input, the paper's choice) or
    "h_force" (force as the input). AnalysisError for another estimator.
    """
    coherence = trial.coherence
    if estimator == "spa":
        z = _ratio(trial.cross, trial.velocity)
        output = trial.force
        of_input = trial.velocity
    elif estimator == "h_force":
        z = _ratio(trial.force, trial.cross.conj())
        output = trial.velocity
        of_input = trial.force
    else:
        raise AnalysisError(
            f"estimator {estimator!r}: use 'spa' (velocity as input) or 'h_force' (force as input)"
        )
    square = trial.cross.real**2 + trial.cross.imag**2
    noise = np.maximum(
        output - np.divide(square, of_input, out=np.zeros_like(square), where=of_input > 0.0), 0.0
    )
    spread = np.sqrt(2.0) * relative_sd(coherence, trial.degrees_of_freedom)
    at_ends = trial.frequency_hz % (0.5 * trial.rate_hz) <= 1e-8  # 0 Hz, half the sample rate
    noise_sd = noise * np.sqrt(np.where(at_ends, 2.0, 1.0) * trial.variance_factor)
    return Impedance(
        trial.frequency_hz,
        z,
        spread_of(np.abs(z), spread),
        coherence,
        noise,
        noise_sd,
        estimator,
        trial.port,
        trial.degrees_of_freedom,
    )


def _ratio(numerator: Complexes | Floats, denominator: Complexes | Floats) -> Complexes:
    out = np.full(numerator.shape, complex("nan"))
    return np.asarray(np.divide(numerator, denominator, out=out, where=denominator != 0.0))
