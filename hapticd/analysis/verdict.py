"""What a judgement on a trial says: the answer and, always with it, band, confidence, margins,
stability and amplitude.
"""

from dataclasses import dataclass, field
from math import isnan, nan
from typing import Literal

from hapticd.analysis.diagnostics import Finding
from hapticd.analysis.energy import Energy

Answer = Literal["passive", "not_passive", "undecided"]
Stability = Literal["stable", "unstable", "unknown"]

# times the length of a record; beyond it the margin is not told from 0, and no length can be
# foretold
FORESEEABLE = 10.0

_WORDS = {
    "passive": "passive in band",
    "not_passive": "not passive in band",
    "undecided": "undecided in band",
}


def needed(seconds_needed: float, seconds: float) -> str:
    """What record would decide where one of `seconds` did not, in words."""
    if not seconds_needed <= FORESEEABLE * seconds:
        return (
            f"a record more than {FORESEEABLE:g} times as long would be needed: the margin is not"
            " told from 0"
        )
    return f"a record like it of some {two_digits(seconds_needed)} s would decide"


def hertz(value: float) -> str:
    """A frequency as a verdict names it: three digits, whole numbers from 100 Hz on."""
    return f"{value:.{2 if value < 10.0 else 1 if value < 100.0 else 0}f}"


def two_digits(value: float) -> str:
    """As much as is known of a length or a number that is foretold; never 0."""
    return f"{max(1.0, float(f'{value:.2g}')):g}"


@dataclass(frozen=True, slots=True)
class Margin:
    """Least value over the band, at `frequency_hz`, and limits between which the true least
    value lies.
    """

    value: float
    lower: float
    upper: float
    frequency_hz: float

    def __str__(self) -> str:
        return (
            f"{self.value:.3g} ({self.lower:.3g}..{self.upper:.3g}, worst at"
            f" {self.frequency_hz:.1f} Hz)"
        )


@dataclass(frozen=True, slots=True)
class Judged:
    """From where to where something was judged [Hz]; nan where nothing was."""

    first_hz: float
    last_hz: float

    def __str__(self) -> str:
        if isnan(self.first_hz):
            return "nothing judged"
        return f"judged {hertz(self.first_hz)} to {hertz(self.last_hz)} Hz"

    @property
    def words(self) -> str:
        """The same as a sentence of its own."""
        if isnan(self.first_hz):
            return "nothing judged: all trials ran away"
        return f"first judged {hertz(self.first_hz)} Hz, last judged {hertz(self.last_hz)} Hz"


NOTHING_JUDGED = Judged(nan, nan)


@dataclass(frozen=True, slots=True)
class Amplitude:
    """One-sided density of the perturbation, mean over the band, and standard deviation of the
    velocity.
    """

    force_psd_n2_per_hz: float
    velocity_sd_m_per_s: float


@dataclass(frozen=True, slots=True)
class Verdict:
    """Answer and conditions. `within_90_deg` is the paper's plain rule, `port` the place where Z
    was looked at.

    What was judged are `n_frequencies`, from `first_judged_hz` to `last_judged_hz`: the edges of
    `band_hz`, unless the spectra are of lines alone (a multisine) or of chosen frequencies; then
    the first and the last of those inside.

    "stable" without a `spectral_radius` (of the predicted loop) says that no escape was seen in
    this record. `seconds` is the length of the record, `seconds_needed` that of one like it that
    would decide; inf at margin 0. What is narrower than `resolution_hz` was averaged with what is
    beside it.
    """

    answer: Answer
    band_hz: tuple[float, float]
    confidence: float
    first_judged_hz: float
    last_judged_hz: float
    n_frequencies: int
    margin_ns_per_m: Margin
    margin_deg: Margin
    within_90_deg: bool
    stability: Stability
    amplitude: Amplitude
    port: str
    seconds: float
    seconds_needed: float
    resolution_hz: float
    spectral_radius: float | None = None
    energy: Energy | None = None
    findings: tuple[Finding, ...] = field(default_factory=tuple)

    def __str__(self) -> str:
        low, high = self.band_hz
        density = self.amplitude.force_psd_n2_per_hz
        speed = 1e3 * self.amplitude.velocity_sd_m_per_s
        words = (
            (
                f"{_WORDS[self.answer]} [{low:g}, {high:g}] Hz at {100 * self.confidence:g} %"
                " confidence"
            ),
            self._stability(),
            (
                f"margin at a resolution of {self.resolution_hz:.2g} Hz, {self.judged}:"
                f" {self.margin_ns_per_m} N s/m, {self.margin_deg} deg"
            ),
            (
                f"perturbation {density:.3g} N^2/Hz, velocity {speed:.3g} mm/s rms over"
                f" {self.seconds:.3g} s at the {self.port}"
            ),
            *(finding.message for finding in self.findings),
        )
        return "; ".join(words)

    @property
    def judged(self) -> Judged:
        """From where to where."""
        return Judged(self.first_judged_hz, self.last_judged_hz)

    def _stability(self) -> str:
        if self.spectral_radius is not None:
            return f"{self.stability}, spectral radius {self.spectral_radius:.6g}"
        return {
            "stable": "stable as far as seen",
            "unstable": "unstable",
            "unknown": "stability unknown",
        }[self.stability]
