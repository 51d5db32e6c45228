"""The calibrated device as all parts of `beyond` ask it: predicted in microseconds an environment, or flown for 90 s each.

Passive is what the paper's rule calls so at the perturbation of its trials. Much of the device's damping is dry friction, which
fades as the motion grows; `dry=False` therefore asks for passivity without counting on it, at any amplitude.

What would break it: comparing the two, or trials of one perturbation with a prediction at another.
"""

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from hapticd.analysis.arrays import Complexes, Flags, Floats
from hapticd.analysis.boundary import axis_limit
from hapticd.analysis.linearise import Perturbation
from hapticd.analysis.loop import Filters
from hapticd.analysis.predict import Prediction, predict
from hapticd.measure.executors import threads
from hapticd.measure.limits import REACH
from hapticd.measure.outcomes import TOGETHER, Conditions, Outcome, fly, kept_frequencies
from hapticd.measure.scenes import display, filters, noise, perturbation
from hapticd.plant.compose import compose
from hapticd.plant.model import Model
from hapticd.plant.scene import Scene
from hapticd.plant.shaped_damping import ShapedDamping

SHOWN_HZ = (2.0, 200.0)
NEAR = (0.7, 1.3)  # of the predicted limit: where trials look first
FAR = 2.5  # of it: where they look otherwise
ROUNDS = 2  # of TOGETHER trials each: to 0.02 % of the limit


@dataclass(frozen=True, eq=False)
class Display:
    """A scene whose environment and damping level are varied."""

    scene: Scene
    _known: dict[tuple[float, ...], Outcome] = field(default_factory=dict, repr=False)

    @cached_property
    def model(self) -> Model:
        """As composed."""
        return compose(self.scene)

    @cached_property
    def filters(self) -> Filters:
        """Of velocity and acceleration."""
        return filters(self.scene)

    @cached_property
    def perturbation(self) -> Perturbation:
        """Of the scene's trials."""
        return perturbation(noise(self.scene))

    def predicted(self, points: Floats, level: float, dry: bool = True) -> Prediction:
        """Of environments (N, 3) at a damping level [N s/m]; `dry`: with the friction as it is at the perturbation,
        and as the trials record it."""
        return predict(self.model, points, level, self.filters, self.perturbation if dry else None, recorded=dry)

    def passive(self, points: Floats, level: float, dry: bool = True) -> Flags:
        """(N,) at the perturbation; without `dry` also at any larger one."""
        found = self.predicted(points, level).passive
        return found if dry or not found.any() else found & self.predicted(points, level, dry=False).passive

    def impedances(self, points: Floats, level: float) -> Complexes:
        """Predicted Z (N, F) at `shown_hz()` as trials record it, friction as it is at the perturbation."""
        return display(self.scene).impedances(points, level, shown_hz())

    def flown(self, points: Floats, level: float, seed: int, amplitude: float = 1.0) -> list[Outcome]:
        """A trial of each environment (N, 3) with the noise of `seed`, its force multiplied by `amplitude`. Each is flown once."""
        keys = [(level, seed, amplitude, *map(float, point)) for point in points]
        new = np.array([place for place, key in enumerate(keys) if key not in self._known], np.int64)
        if new.size:
            for place, outcome in zip(new, self._fly(points[new], level, seed, amplitude), strict=True):
                self._known[keys[place]] = outcome
        return [self._known[key] for key in keys]

    def sized(self, points: Floats, level: float, seed: int) -> Floats:
        """|Z| (n, F) of those trials that pass."""
        runs = [sizes(outcome) for outcome in self.flown(points, level, seed) if outcome.passes]
        return np.array(runs).reshape(-1, shown_hz().size)

    def _fly(self, points: Floats, level: float, seed: int, amplitude: float) -> list[Outcome]:
        source = noise(self.scene)
        source = replace(source, seed=seed, psd_n2_per_hz=source.psd_n2_per_hz * amplitude**2)
        conditions = Conditions(self.scene, excitation=source)
        parts = [points[first : first + TOGETHER] for first in range(0, len(points), TOGETHER)]
        with threads() as pool:
            done = pool.map(lambda part: fly(conditions, level, part), parts)
            return [outcome for part in done for outcome in part]

    def limit(self, level: float, axis: int, reach: float | None = None) -> float:
        """Predicted axis limit, the others 0: N/m, Ns/m, kg."""
        return axis_limit(lambda points: self.passive(points, level), axis, REACH[axis] if reach is None else reach)

    def limits_by_trials(self, level: float, axis: int, near: float, seeds: tuple[int, ...]) -> Floats:
        """The same (seeds,) by trials about the predicted limit `near`; nan without one."""
        if not np.isfinite(near):
            return np.full(len(seeds), np.nan)
        with threads() as pool:
            return np.array(list(pool.map(lambda seed: self._searched(level, axis, near, seed), seeds)))

    def _searched(self, level: float, axis: int, near: float, seed: int) -> float:
        """The last value that passes before the first that fails; searched from 0 if it is not near the predicted one."""

        def decide(points: Floats) -> Flags:
            return np.array([outcome.passes for outcome in self.flown(points, level, seed)])

        low, high = NEAR[0] * near, NEAR[1] * near
        for _ in range(ROUNDS):
            points = np.zeros((TOGETHER, 3))
            points[:, axis] = np.linspace(low, high, TOGETHER)
            failed = np.flatnonzero(~decide(points))
            if not failed.size or failed[0] == 0:
                return axis_limit(decide, axis, FAR * near, steps=TOGETHER - 1)
            low, high = points[failed[0] - 1, axis], points[failed[0], axis]
        return float(low)

    def shaped(self, highpass_hz: float = 0.0, lowpass_hz: float = 0.0) -> "Display":
        """The same device with shaped damping."""
        effect = ShapedDamping(highpass_hz=highpass_hz, lowpass_hz=lowpass_hz)
        return Display(replace(self.scene, effects=(*self.scene.effects, effect)))


def shown_hz() -> Floats:
    """Frequencies (F,) of every impedance here, those of outcomes inside SHOWN_HZ."""
    f = kept_frequencies()
    return f[(f >= SHOWN_HZ[0]) & (f <= SHOWN_HZ[1])]


def sizes(outcome: Outcome) -> Floats:
    """|Z| (F,) of a trial at `shown_hz()`."""
    return np.asarray(np.hypot(*outcome.z.T)[np.isin(outcome.frequency_hz, shown_hz())])
