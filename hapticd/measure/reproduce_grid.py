"""The paper's grid search: 6,384 environments, undamped and damped, and the envelope of those that are passive.

Prediction says which trials cannot pass: those where even 85 % of the environment would not. The others are flown. Between
a laboratory's 13 days and seconds stands only that. Without trials the prediction alone fills set and envelope.

What would break it: a set that is not star-shaped about K = B = M = 0; a passive piece far from the rest would be missed.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from hapticd.analysis.arrays import Flags, Floats, Integers
from hapticd.analysis.boundary import Limits, PassiveSet, grid, passive_set, set_limits
from hapticd.analysis.envelope import Envelope, Trial, of_predicted, of_trial, widened
from hapticd.analysis.impedance import Impedance, impedance
from hapticd.analysis.passivity import judge
from hapticd.analysis.spectra import Spectra
from hapticd.errors import AnalysisError
from hapticd.measure.reproduce_trials import Subject, flown, passes

AXES = (
    np.array([0.0, 25.0, 50.0, 75.0, 100.0, 150.0, 200.0, 300.0, 400.0, 600.0, 800.0, 1000.0]),
    np.arange(19) * 0.5,
    np.arange(-12, 16) * 0.002,
)
POINTS = grid(AXES)
NEAR = 0.85
SHOWN_HZ = (1.9, 1000.0)
SEED = 1
PEAK_HZ = (40.0, 200.0)
PROMINENT = 1.01  # above the valleys on both sides
CALMED = 9  # frequencies, about 9 Hz


@dataclass(frozen=True, eq=False)
class Peak:
    """A maximum of an envelope: its |Z| [N s/m], by how much it stands above the higher of its valleys, its owner (K, B, M)."""

    frequency_hz: float
    size_ns_per_m: float
    rise: float
    owner: Floats


@dataclass(frozen=True, eq=False)
class Found:
    """Of one damping level: `passive` (nK, nB, nM) of the grid, `flown` trials; the envelope, its owners' environments by name."""

    level: float
    passive: Flags
    undecided: int
    flown: int
    envelope: Envelope
    environments: Floats

    @property
    def limits(self) -> Limits:
        """Extremes of the set, in steps of the grid."""
        return set_limits(self.as_set)

    @property
    def as_set(self) -> PassiveSet:
        """With margins of +-1."""
        return passive_set(AXES, np.where(self.passive, 1.0, -1.0))

    def owners(self, which: Integers) -> Floats:
        """(K, B, M) (F, 3) of an edge's owners."""
        return np.asarray(self.environments[which])

    def peak(self) -> Peak | None:
        """The upper edge's most prominent maximum in PEAK_HZ, if any."""
        f, size = self.envelope.frequency_hz, _calmed(self.envelope.upper.value) if self.flown else self.envelope.upper.value
        inside = np.flatnonzero((f >= PEAK_HZ[0]) & (f <= PEAK_HZ[1]))
        part = size[inside]
        before, after = np.minimum.accumulate(part), np.minimum.accumulate(part[::-1])[::-1]
        rise = part / np.maximum(before, after)
        highest = int(np.argmax(rise))
        if rise[highest] < PROMINENT:
            return None
        at = int(inside[highest])
        return Peak(float(f[at]), float(size[at]), float(rise[highest]) - 1.0, self.owners(self.envelope.upper.owner)[at])


def _calmed(values: Floats) -> Floats:
    """Running median over what the window cannot resolve, against the noise of the estimate."""
    padded = np.pad(values, CALMED // 2, mode="edge")
    return np.asarray(np.median(np.lib.stride_tricks.sliding_window_view(padded, CALMED), axis=1))


def candidates(device: Subject, level: float) -> Integers:
    """Places in POINTS of the trials that may pass."""
    hopeful = device.passive(POINTS, level) | device.passive(NEAR * POINTS, level)
    return np.flatnonzero(hopeful)


def searched(device: Subject, level: float, places: Integers) -> list[tuple[int, Trial]]:
    """Fly a part of the grid; the trials that pass by the paper's rule, with their places."""
    kept = []
    for place, spectra in zip(places, flown(device, POINTS[places], level, SEED, dtype="f32"), strict=True):
        if spectra is not None and passes(spectra):
            kept.append((int(place), _trial(spectra, int(place))))
    return kept


def by_trials(level: float, kept: Iterable[tuple[int, Trial]], count: int) -> Found:
    """Set and envelope of the trials that passed, in the order of the grid."""
    ordered = sorted(kept, key=lambda pair: pair[0])
    passive = np.zeros(len(POINTS), np.bool_)
    passive[[place for place, _ in ordered]] = True
    envelope = of_trial(ordered[0][1])
    for _, trial in ordered[1:]:
        envelope = widened(envelope, trial)
    undecided = sum(trial.verdict.answer != "passive" for _, trial in ordered)
    return Found(level, passive.reshape([axis.size for axis in AXES]), undecided, count, envelope, POINTS[passive])


def by_prediction(device: Subject, level: float) -> Found:
    """The same without trials: `undecided` and `flown` are 0, the envelope has no uncertainty. AnalysisError for an empty set."""
    passive = device.passive(POINTS, level)
    kept = POINTS[passive]
    if not len(kept):
        raise AnalysisError(f"{device.name}: no environment of the grid is passive at {level:g} N s/m; there is no envelope")
    f, z = device.impedances(kept, level, SHOWN_HZ)
    inside = (f >= SHOWN_HZ[0]) & (f <= SHOWN_HZ[1])
    shape = [axis.size for axis in AXES]
    return Found(level, passive.reshape(shape), 0, 0, of_predicted(f[inside], z[:, inside]), kept)


def _trial(spectra: Spectra, place: int) -> Trial:
    verdict = judge(spectra, channels=False)
    k, b, m = POINTS[place]
    return Trial(named(POINTS[place]), (float(k), float(b), float(m)), shown(spectra), verdict)


def shown(spectra: Spectra) -> Impedance:
    """The impedance on the frequencies of the figures."""
    inside = (spectra.frequency_hz >= SHOWN_HZ[0]) & (spectra.frequency_hz <= SHOWN_HZ[1])
    return impedance(spectra.part(inside))


def named(point: Floats) -> str:
    """An environment in words."""
    return f"K {point[0]:g} B {point[1]:g} M {1e3 * point[2]:g} g"
