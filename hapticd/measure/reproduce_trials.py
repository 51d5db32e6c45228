"""The devices, trials and the rule behind `reproduce`: 90 s of white noise each, judged as the paper judged them.

A trial passes if it neither ran away nor filled the force range, and if all phases of Z lie within +-90 degrees from the lower
band edge to 500 Hz, both included (`passivity.within_90_deg`).

What would break it: an edge below 1/(M T) = 1.95 Hz. It is read all the same where it is asked for, and drawn as what it is.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cache
from math import inf

import numpy as np

from hapticd.analysis.arrays import Complexes, Flags, Floats
from hapticd.analysis.linearise import Perturbation
from hapticd.analysis.loop import Filters
from hapticd.analysis.passivity import within_90_deg
from hapticd.analysis.predict import DEFAULT_BAND_HZ, frequencies, predict
from hapticd.analysis.spa import DEFAULT_LAG
from hapticd.analysis.spectra import Spectra
from hapticd.measure.scenes import SATURATED, display, filters
from hapticd.plant.compose import compose
from hapticd.plant.model import Model
from hapticd.settings.scene import load_scene
from hapticd.sim.engine import simulate
from hapticd.sim.engine.shape import LANES
from hapticd.units import PROBE_RATE_HZ

SCENES = {"weir2008": "fig7", "weir2008_probe_hp": "rival", "weir2008_literal": "literal"}
MAIN = "weir2008"
ADDED_NS_PER_M = 1.74  # Weir, Colgate and Peshkin 2008, section 5
LEVELS = (0.0, ADDED_NS_PER_M)
SECONDS = 90.0  # section 2.2
SUBSTEPS = 4  # matched to what 90 s of noise leave uncertain
TOGETHER = LANES["f64"]
WINDOW_HZ = PROBE_RATE_HZ / DEFAULT_LAG  # 1/(M Ts): below it the window says nothing
EDGES_HZ = (1.0, 2.0, 3.0, 5.0, 10.0)

Point = tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class Subject:
    """A device of the table: its model as composed for the trials of the paper, and the filters it was calibrated with."""

    name: str
    model: Model
    filters: Filters
    force_limit_n: float

    def passive(self, points: Floats, level: float, band_hz: tuple[float, float] = DEFAULT_BAND_HZ) -> Flags:
        """Predicted for environments (N, 3) at a damping level [N s/m], with the perturbation of the trials and as recorded:
        what a high-pass of the velocity channel does to the phase counts."""
        return predict(self.model, points, level, self.filters, Perturbation(), band_hz, recorded=True).passive

    def impedances(self, points: Floats, level: float, band_hz: tuple[float, float]) -> tuple[Floats, Complexes]:
        """(frequencies (F,), Z (N, F) as recorded) by prediction; both ends of the band are among the frequencies."""
        f = frequencies(band_hz, Perturbation())
        return f, display(load_scene(SCENES[self.name])).impedances(points, level, f)


@cache
def subject(name: str) -> Subject:
    """One of SCENES by the name of its device."""
    scene = load_scene(SCENES[name])
    model = compose(scene)
    return Subject(name, model, filters(scene), model.force_limit_n or inf)


def flown(
    device: Subject, points: Floats, level: float, seed: int, seconds: float = SECONDS, dtype: str = "f64"
) -> Iterator[Spectra | None]:
    """Spectra of a trial of each environment (N, 3), all with the torque of `seed`; None of one that ran away or saturated."""
    together = LANES[dtype]
    for first in range(0, len(points), together):
        found = simulate(
            device.model, points[first : first + together], seconds, seed,
            damping=level, filters=device.filters, substeps=SUBSTEPS, keep="spectra", dtype=dtype,
        )  # fmt: skip
        calm = ~found.diverged & (found.max_force_n < SATURATED * device.force_limit_n)
        yield from (found.spectra(trial) if good else None for trial, good in enumerate(calm))


def passes(trial: Spectra | None, low_hz: float = DEFAULT_BAND_HZ[0]) -> bool:
    """The paper's rule from `low_hz` to 500 Hz."""
    return trial is not None and within_90_deg(trial, (low_hz, DEFAULT_BAND_HZ[1]))


def decided(trials: Iterable[Spectra | None], low_hz: float = DEFAULT_BAND_HZ[0]) -> Flags:
    """`passes` of many (N,)."""
    return np.array([passes(trial, low_hz) for trial in trials])
