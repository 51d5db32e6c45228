"""The verdict on a trial: passive in a band, not passive in it, or undecided, always with its
conditions.

Z is positive real where Re Z >= 0, and the sign of Re Z is that of the cross-power Re Phi_Fv,
whichever estimator is used. Re Z is known to h = t |Z| sqrt((1 - g2) / (g2 (nu - 2))) at each
frequency, the phase to arcsin(h / |Z|), with Student's t at a level raised so that all intervals of
the band hold together. The margin is the minimum of Re Z or of 90 degrees - |phase|. It lies
between the minimum of the lower limits and the minimum of the upper limits:

    passive       the minimum lower limit is above 0       not passive    an upper limit is below 0

For fitted values (`resolved`) h also includes the possible error of the fit.

The level (`sidak`): n statements that each hold with probability p^(1/n) hold together with at
least p when their errors are independent or, as between neighbouring values of a windowed spectrum,
positively correlated (Sidak 1967; Slepian 1962). n counts all judged values. The number of
independent values (band over bandwidth) is smaller, but with it a lossless device gives twice the
promised false alarms, because the extreme of a smooth curve lies between them.

A resonance that rings for a good part of the record swells as a random walk does. Motion that the
perturbation explains is judged by its Re Z. Unexplained motion is active if Re Z shows it,
otherwise undecided: noise gives the record's end a share of the force of ring / (2 length) on
average, exponentially distributed. The requested length is that of `RINGS` rings, or that in which
the same end would have a share of 1 - `DRIVEN`.

A device that is not stable is not passive, whatever its Re Z: with a virtual K < 0 or a closed loop
of spectral radius above 1 the real part may be positive throughout. Findings that turn the phase
(skew, high-pass) or distort the channels (saturation) make a verdict impossible. The paper's plain
rule, all phases within +-90 degrees, is evaluated as well. With 5 mm/s of sensor noise it calls a
passive device with a margin of 1 degree non-passive in every trial.

Margins are those of the recorded channels: the force is held and the velocity averaged over the
interval of a sample, so Re Z of a rigid device reads high by 1 / sinc^2(f / rate) - 1
(`impedance.reads_high`). Its sign does not change. The effect on other devices depends on the model
(`loop`), so nothing is corrected here: predictions for trials use the recorded channels.

The band is judged from edge to edge; an edge between lines of the window is interpolated
(`Spectra.band`). Multisines and user-defined frequencies are judged where they are, so a verdict
contains its first and its last frequency.

A band below 1/(M T), where the window smooths, is refused, and so is a record of too few windows.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from math import atan, cos, isclose, isnan, nan, pi, sin, sqrt, tan
from statistics import NormalDist
from typing import Literal

import numpy as np

from hapticd.core.arrays import Complexes, Floats, bisect
from hapticd.core.errors import AnalysisError
from hapticd.core.units import DEFAULT_BAND_HZ, percent
from hapticd.signal.channels import channel_findings
from hapticd.signal.findings import SWELLS, Energy, Finding, Record, coherence_findings
from hapticd.signal.impedance import (
    Estimator,
    Impedance,
    impedance,
    reads_high,
    relative_sd,
    spread_of,
)
from hapticd.signal.resolved import Resolved
from hapticd.signal.spectra import Spectra, lines_beside

__all__ = [
    "FORESEEABLE",
    "LEAST_FREEDOM",
    "NEAR_HZ",
    "Judged",
    "Verdict",
    "half_width",
    "judge",
    "needed",
    "sidak",
    "student_quantile",
    "two_digits",
]

Answer = Literal["passive", "not_passive", "undecided"]
Stability = Literal["stable", "unstable", "unknown"]
Channels = Literal["recorded"]  # held force, averaged velocity

MANY = 18.0  # degrees of freedom from which the expansion of Student's t holds
# degrees of freedom of a window's values below which the intervals are invalid
LEAST_FREEDOM = 20.0
LEAST_EXACT = 4.0  # the same of plain averages: two of them
DRIVEN = 0.8  # of the velocity's power, from which a motion is due to the perturbation
NEAR_HZ = 1e-5  # an edge this close to a line is that line
# times the length of a record; beyond it the margin cannot be distinguished from 0, and no length
# can be predicted
FORESEEABLE = 10.0
_WORDS = {
    "passive": "passive in band",
    "not_passive": "not passive in band",
    "undecided": "undecided in band",
}
CHANNELS_READ = "Re Z of a rigid device reads 0.2 % high at 100 Hz, 5.3 % at 500 Hz"
LEAST_TOLD = 1e-4  # of Re Z
LOST_EDGE = "lost_edge"
SHORT_RECORD = "short_record"
RINGS = 8.0  # in a record, from which calm seconds are not merely early ones
LOUD_END = (
    20.0  # rings in a record from which its end leaves less than DRIVEN only once in 3000 records
)


def sidak(confidence: float, statements: int) -> float:
    """Return the confidence that each of `statements` needs so that all hold together with
    `confidence`. AnalysisError for a confidence outside 0..1.
    """
    if not 0.0 < confidence < 1.0:
        raise AnalysisError(f"confidence {confidence}: must lie between 0 and 1; 0.95 is usual")
    return float(confidence ** (1.0 / max(1, statements)))


def student_quantile(probability: float, degrees_of_freedom: float) -> float:
    """Return the quantile of Student's t: Cornish-Fisher expansion in 1/nu (Abramowitz and Stegun
    26.7.5), 1e-4 of t from nu = 18 on.

    Below 18, nu must be an integer, and the quantile is exact. AnalysisError for any other nu.
    """
    if degrees_of_freedom < MANY:
        return _few(probability, degrees_of_freedom)
    z = NormalDist().inv_cdf(probability)
    nu = degrees_of_freedom
    terms = (
        (z**3 + z) / 4.0,
        (5.0 * z**5 + 16.0 * z**3 + 3.0 * z) / 96.0,
        (3.0 * z**7 + 19.0 * z**5 + 17.0 * z**3 - 15.0 * z) / 384.0,
        (79.0 * z**9 + 776.0 * z**7 + 1482.0 * z**5 - 1920.0 * z**3 - 945.0 * z) / 92160.0,
    )
    return z + sum(term / nu ** (power + 1) for power, term in enumerate(terms))


def _few(probability: float, degrees_of_freedom: float) -> float:
    """Return the quantile by bisection of the closed form P(t); tan of the angle is t /
    sqrt(nu).
    """
    nu = round(degrees_of_freedom)
    if nu < 1 or not isclose(nu, degrees_of_freedom):
        raise AnalysisError(
            f"{degrees_of_freedom:g} degrees of freedom: below {MANY:g} a whole number is needed;"
            " average more"
        )
    # to the last bit
    low, high = bisect(lambda angle: _student(angle, nu) < probability, atan(-1e9), atan(1e9), 100)
    return sqrt(nu) * tan(0.5 * (low + high))


def _student(angle: float, nu: int) -> float:
    """Return P(t) by a finite sum: 26.7.3 of Abramowitz and Stegun for odd nu, 26.7.4 for even
    nu.
    """
    odd = nu % 2
    term = cos(angle) if odd else 1.0
    total = term if nu > 1 else 0.0
    for place in range(1, nu // 2):
        term *= (2 * place - 1 + odd) / (2 * place + odd) * cos(angle) ** 2
        total += term
    inside = 2.0 / pi * (angle + sin(angle) * total) if odd else sin(angle) * total
    return 0.5 * (1.0 + inside)


def needed(seconds_needed: float, seconds: float) -> str:
    """Describe the record length that would decide where one of `seconds` did not."""
    if not seconds_needed <= FORESEEABLE * seconds:
        return (
            f"a record more than {FORESEEABLE:g} times as long would be needed: the margin cannot"
            " be distinguished from 0"
        )
    return f"a record like it of some {two_digits(seconds_needed)} s would decide"


def hertz(value: float) -> str:
    """Format a frequency as verdicts do: three digits, whole numbers from 100 Hz on."""
    return f"{value:.{2 if value < 10.0 else 1 if value < 100.0 else 0}f}"


def two_digits(value: float) -> str:
    """Format a predicted length or number with two digits; never 0."""
    return f"{max(1.0, float(f'{value:.2g}')):g}"


@dataclass(frozen=True, slots=True)
class Margin:
    """Minimum over the band, and limits of the true minimum."""

    value: float  # N s/m or deg
    lower: float  # same unit
    upper: float  # same unit
    frequency_hz: float  # where `value` is

    def __str__(self) -> str:
        return (
            f"{self.value:.3g} ({self.lower:.3g}..{self.upper:.3g}, worst at"
            f" {self.frequency_hz:.1f} Hz)"
        )


@dataclass(frozen=True, slots=True)
class Judged:
    """The judged range of frequencies, nan if nothing was judged, and the channels used."""

    first_hz: float = nan
    last_hz: float = nan
    channels: Channels = "recorded"

    def __str__(self) -> str:
        if isnan(self.first_hz):
            return "nothing judged"
        return (
            f"judged {hertz(self.first_hz)} to {hertz(self.last_hz)} Hz by the {self.channels}"
            " channels"
        )

    @property
    def words(self) -> str:
        """The same as a sentence."""
        if isnan(self.first_hz):
            return "nothing judged: all trials ran away"
        return (
            f"first judged {hertz(self.first_hz)} Hz, last judged {hertz(self.last_hz)} Hz, by the"
            f" {self.channels} channels: {CHANNELS_READ}"
        )


@dataclass(frozen=True, slots=True)
class Amplitude:
    """One-sided density of the perturbation, mean over the band, and standard deviation of the
    velocity.
    """

    force_psd_n2_per_hz: float  # one-sided, mean over the band
    velocity_sd_m_per_s: float


@dataclass(frozen=True, slots=True)
class Verdict:
    """The answer, and always with it its conditions.

    "stable" without a `spectral_radius` means that this record shows no escape.
    """

    answer: Answer
    band_hz: tuple[float, float]
    confidence: float  # that the answer is right, all frequencies together
    first_judged_hz: float  # the edge of `band_hz`, or the first line of a multisine inside it
    last_judged_hz: float  # the edge of `band_hz`, or the last line of a multisine inside it
    n_frequencies: int  # that were judged
    margin_ns_per_m: Margin  # of Re Z
    margin_deg: Margin  # of 90 - |phase|
    within_90_deg: bool  # the paper's plain rule
    stability: Stability
    amplitude: Amplitude
    port: str  # where Z was judged
    seconds: float  # length of the record
    seconds_needed: float  # length of a similar one that would decide; inf at margin 0
    resolution_hz: float  # narrower features are averaged with their surroundings
    spectral_radius: float | None = None  # of the predicted loop, if it was predicted
    energy: Energy | None = None  # None without the samples
    findings: tuple[Finding, ...] = field(default_factory=tuple)
    channels: Channels = "recorded"  # whose Re Z the margins are
    # share by which they read Re Z of a rigid device high, at the margin's frequency
    reads_high: float = nan

    def __str__(self) -> str:
        low, high = self.band_hz
        density = self.amplitude.force_psd_n2_per_hz
        speed = 1e3 * self.amplitude.velocity_sd_m_per_s
        return "; ".join(
            (
                (
                    f"{_WORDS[self.answer]} [{low:g}, {high:g}] Hz at {100 * self.confidence:g} %"
                    " confidence"
                ),
                self._stability(),
                (
                    f"margin at a resolution of {self.resolution_hz:.2g} Hz, {self.judged}:"
                    f" {self.margin_ns_per_m} N s/m, {self.margin_deg} deg{self._read_high()}"
                ),
                (
                    f"perturbation {density:.3g} N^2/Hz, velocity {speed:.3g} mm/s rms over"
                    f" {self.seconds:.3g} s at the {self.port}"
                ),
                *(finding.message for finding in self.findings),
            )
        )

    @property
    def judged(self) -> Judged:
        """The judged range of frequencies."""
        return Judged(self.first_judged_hz, self.last_judged_hz, self.channels)

    @property
    def whole_band(self) -> bool:
        """Whether no edge of `band_hz` was lost under a drift."""
        return not _has(LOST_EDGE, self.findings)

    @property
    def passes(self) -> bool:
        """Whether the trial passes the paper's rule, which rejects an unstable trial and one that
        lost an edge of its band.
        """
        return self.within_90_deg and self.whole_band and self.stability != "unstable"

    def _read_high(self) -> str:
        if not self.reads_high >= LEAST_TOLD:
            return ""
        at_hz = hertz(self.margin_ns_per_m.frequency_hz)
        return (
            f"; the {self.channels} channels read Re Z of a rigid device"
            f" {percent(self.reads_high)} high at {at_hz} Hz"
        )

    def _stability(self) -> str:
        if self.spectral_radius is not None:
            return f"{self.stability}, spectral radius {self.spectral_radius:.6g}"
        return {
            "stable": "stable as far as seen",
            "unstable": "unstable",
            "unknown": "stability unknown",
        }[self.stability]


def judge(
    trial: Spectra,
    record: Record | None = None,
    band_hz: tuple[float, float] = DEFAULT_BAND_HZ,
    confidence: float = 0.95,
    estimator: Estimator = "spa",
    spectral_radius: float | None = None,
    behind_mass_kg: float = 0.0,
    channels: bool = True,
    below_window: bool = False,
) -> Verdict:
    """Judge `trial` in `band_hz`.

    `record` (of `findings.examine`) adds energy, escape and saturation; `spectral_radius` is that
    of the predicted closed loop. `behind_mass_kg` > 0 judges the device behind the probe's mass: Re
    Z is the same there. `channels` also tests for skew and high-pass, which takes longer than the
    rest; simulated records have neither. `below_window` judges a band that begins below 1/(M T),
    which is otherwise refused, from the window's smoothed values.

    AnalysisError for a band below 1/(M T), above half the sample rate or without frequencies, and
    for records of fewer than 20 degrees of freedom.
    """
    inside = _judged(trial, band_hz, below_window)
    f = inside.frequency_hz
    at_port = impedance(inside, estimator)
    z = at_port.without_mass(behind_mass_kg) if behind_mass_kg else at_port
    resistance_ns_per_m = z.impedance_ns_per_m.real
    known = _known_to(trial, inside, at_port, sidak(confidence, f.size))
    margin_ns_per_m = _least(resistance_ns_per_m, known.chance + np.abs(known.bias.real), f)
    findings = (
        *_reread(trial, record.findings if record else ()),
        *coherence_findings(trial, band_hz, estimator),
        *(channel_findings(trial) if channels else ()),
        *_lost_edges(trial, inside, band_hz),
    )
    stability = _stability(findings, record is not None, spectral_radius)
    return Verdict(
        answer=_answer(margin_ns_per_m, stability, findings),
        band_hz=band_hz,
        confidence=confidence,
        first_judged_hz=float(f[0]),
        last_judged_hz=float(f[-1]),
        n_frequencies=f.size,
        margin_ns_per_m=margin_ns_per_m,
        margin_deg=_least(
            90.0 - np.abs(z.phase_deg),
            _angle_deg(known.across, np.abs(z.impedance_ns_per_m)),
            f,
        ),
        # the sign of Re Z is that of the cross-power
        within_90_deg=bool((inside.cross.real > 0.0).all()),
        stability=stability,
        amplitude=Amplitude(float(2.0 * inside.force.mean() / trial.rate_hz), _velocity_sd(trial)),
        port=z.port,
        seconds=trial.seconds,
        seconds_needed=max(
            _seconds_needed(resistance_ns_per_m, known, trial),
            _seconds_of_rings(trial)
            if isinstance(trial, Resolved) and _has(SHORT_RECORD, findings)
            else 0.0,
        ),
        resolution_hz=trial.bandwidth_hz,
        spectral_radius=spectral_radius,
        energy=record.energy if record else None,
        findings=findings,
        reads_high=reads_high(margin_ns_per_m.frequency_hz, trial.rate_hz),
    )


def _reread(trial: Spectra, findings: tuple[Finding, ...]) -> tuple[Finding, ...]:
    """Revise the findings of the samples in the light of `resolved`. A motion that the perturbation
    explains did not run away by itself, however it swells and fades; Re Z at the resonance shows
    whether it is stable. If the ends of the record explain the motion as well, the question stays
    open.
    """
    if not isinstance(trial, Resolved):
        return findings
    instead: dict[str, Finding] = {}
    if trial.explained > DRIVEN:
        instead = dict.fromkeys(("escape", "swells"), Finding("swells", SWELLS))
    elif LOUD_END * trial.ring[0] > trial.seconds:
        instead = {"swells": _short_record(trial)}
    return (*(instead.get(one.code, one) for one in findings), Finding("resolved", trial.said))


def _seconds_of_rings(trial: Resolved) -> float:
    """Return the record length that would separate a ring from a loop that runs away slowly: the
    share of the ends falls as 1 / length.
    """
    return max(RINGS * trial.ring[0], (1.0 - trial.explained) / (1.0 - DRIVEN) * trial.seconds)


def _short_record(trial: Resolved) -> Finding:
    """Return the finding with the record length that would separate a ring from a slow runaway."""
    ring_s, at_hz = trial.ring
    longer_s = _seconds_of_rings(trial)
    rings = (
        f"rings for {two_digits(ring_s)} s: the record of {trial.seconds:.3g} s is shorter"
        f" than {two_digits(longer_s / ring_s)} rings; take {two_digits(longer_s)} s"
        if longer_s <= FORESEEABLE * trial.seconds
        else f"has no damping that shows in {trial.seconds:.3g} s; take a record of"
        f" {two_digits(FORESEEABLE * trial.seconds)} s, or add damping"
    )
    return Finding(
        SHORT_RECORD,
        f"the motion at {hertz(at_hz)} Hz swells as noise makes a ring swell, and {rings}",
    )


def _lost_edges(trial: Spectra, inside: Spectra, band_hz: tuple[float, float]) -> Iterator[Finding]:
    """Report the first edge of the band without power of its own or a line beyond it as a
    replacement: the band is not called passive there.
    """
    for edge_hz, end_hz, inwards in zip(
        band_hz, inside.frequency_hz[[0, -1]], (1, -1), strict=True
    ):
        if trial.whole and inwards * (end_hz - edge_hz) > NEAR_HZ:
            yield Finding(
                LOST_EDGE,
                f"the edge at {hertz(edge_hz)} Hz is lost under a drift, so nothing from there to"
                f" {hertz(float(end_hz))} Hz is called passive; record longer, or hold the display"
                " with a small stiffness",
            )
            return


def _judged(trial: Spectra, band_hz: tuple[float, float], below_window: bool) -> Spectra:
    """Return the spectra for a verdict on `band_hz`. AnalysisError as for `judge`."""
    low, high = band_hz
    if low < trial.lowest_hz and not below_window:
        raise AnalysisError(
            f"band from {low:g} Hz: the {trial.span} contains nothing below {trial.lowest_hz:.3g}"
            " Hz; start there, or record a longer one"
        )
    least = LEAST_EXACT if trial.exact else LEAST_FREEDOM
    if trial.degrees_of_freedom < least:
        raise AnalysisError(
            f"record of {trial.seconds:.3g} s: too short for a verdict with a {trial.span}; record"
            f" {least / trial.degrees_of_freedom * trial.seconds:.3g} s or more"
        )
    half_rate_hz = 0.5 * trial.rate_hz
    if low <= half_rate_hz and high > half_rate_hz * (1.0 + 1e-12):
        raise AnalysisError(
            f"band to {high:g} Hz: samples at {trial.rate_hz:g} Hz contain nothing above"
            f" {half_rate_hz:g} Hz; end there"
        )
    if not low <= min(high, half_rate_hz) or not trial.band(band_hz).frequency_hz.size:
        raise AnalysisError(
            f"no frequency of the estimate lies in {low:g}..{high:g} Hz; widen the band"
        )
    return trial.band(band_hz)


def half_width(coherence: Floats, degrees_of_freedom: float, level: float) -> Floats:
    """Return half of the interval of Re Z over |Z| (F,), each side at `level`: the sine of that of
    the phase; inf without coherence.
    """
    freedom = degrees_of_freedom - 2.0
    return student_quantile(level, freedom) * relative_sd(coherence, freedom)


@dataclass(frozen=True, eq=False)
class _Known:
    """Possible errors of the values of a band (F,)."""

    chance: Floats  # N s/m, of Re Z and across Z
    bias: Complexes  # N s/m, of Z; 0 of a window's values, whose smoothing is named where it shows
    across: Floats  # N s/m, both together across Z, which turns its phase


def _known_to(trial: Spectra, inside: Spectra, at_port: Impedance, level: float) -> _Known:
    """Return the errors by chance at that level, each side, and those of the fits of `resolved`."""
    z = at_port.impedance_ns_per_m
    size = np.abs(z)
    chance = spread_of(
        size, half_width(coherence_inside(trial, inside), trial.degrees_of_freedom, level)
    )
    relative = inside.bias if isinstance(inside, Resolved) else np.zeros(z.size, np.complex128)
    return _Known(chance, relative * z, chance + size * np.abs(relative.imag))


def coherence_inside(trial: Spectra, inside: Spectra) -> Floats:
    """Return the coherence g2 (F,) of a band. At an edge between lines it is at most that of the
    neighbouring lines: side lobes of a drift may remove power of the motion there and raise the
    coherence.
    """
    found = inside.coherence.copy()
    if trial.whole:
        for place in {0, found.size - 1}:
            below, above = lines_beside(inside.frequency_hz[place], trial.rate_hz, trial.lag)
            if below < above:
                found[place] = min(found[place], *trial.part(slice(below, above + 1)).coherence)
    return found


def _angle_deg(half: Floats, size: Floats) -> Floats:
    """Return the phase interval for +-`half` of the real part."""
    share = np.divide(half, size, out=np.ones_like(half), where=half < size)
    return np.degrees(np.arcsin(share))


def _least(values: Floats, half: Floats, frequency_hz: Floats) -> Margin:
    """Return the margin of `values` known to +-`half`; an unknown value (nan) is unbounded."""
    known = np.isfinite(values)
    lower = np.where(known, values - half, -np.inf)
    upper = np.where(known, values + half, np.inf)
    worst = int(np.argmin(np.where(known, values, np.inf)))
    return Margin(
        float(values[worst]), float(lower.min()), float(upper.min()), float(frequency_hz[worst])
    )


def _answer(margin: Margin, stability: Stability, findings: tuple[Finding, ...]) -> Answer:
    if stability == "unstable":
        return "not_passive"
    if any(finding.voids for finding in findings):
        return "undecided"
    if margin.upper < 0.0:
        return "not_passive"
    unsure = _has(LOST_EDGE, findings) or _has(SHORT_RECORD, findings)
    return "passive" if margin.lower > 0.0 and not unsure else "undecided"


def _has(code: str, findings: tuple[Finding, ...]) -> bool:
    return any(finding.code == code for finding in findings)


def _stability(
    findings: tuple[Finding, ...], recorded: bool, spectral_radius: float | None
) -> Stability:
    if any(finding.unstable for finding in findings) or (
        spectral_radius is not None and not spectral_radius < 1.0
    ):
        return "unstable"
    return "stable" if recorded or spectral_radius is not None else "unknown"


def _velocity_sd(trial: Spectra) -> float:
    """Return the standard deviation [m/s] from the spectrum. Its mean over all lines is the
    variance; on other frequencies a trapezoid is used.
    """
    return float(np.sqrt(2.0 * np.trapezoid(trial.velocity, trial.frequency_hz) / trial.rate_hz))


def _seconds_needed(values: Floats, known: _Known, trial: Spectra) -> float:
    """Return the record length that would decide. A record longer by (chance / value)^2 brings the
    limit of a value to 0; all values must be above, or one below. Bias does not fall with length.
    """
    left = np.maximum(np.abs(values) - np.abs(known.bias.real), 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        factor = np.where(np.isfinite(values) & (left > 0.0), (known.chance / left) ** 2, np.inf)
    below = values < 0.0
    return float(trial.seconds * (factor[below].min() if below.any() else factor.max()))
