"""Free motion with added damping: how light can B < 0 make it again, and what is left of passivity there.

K = 0, so nothing resonates and no grid matters: |Z| is damping, mass, and what negative virtual damping takes away. The law's lag
t turns B < 0 into a mass, -|B| e^(-jwt) = -|B| + jw |B| t, some 14 g with the 1.74 N s/m of the paper, so B < 0 alone restores the
damping and not the motion; M < 0 beside it does.

Two limits are not the same. At the perturbation of the trials dry friction carries a part of B < 0; it fades as the motion grows,
until the device runs away. `safest` therefore asks for the lifted theorem of Colgate and Schenkel as well, without friction, for
every input. The best safe (B, M) has the least mean |Z| in dB over 2-20 Hz.
"""

from dataclasses import dataclass

import numpy as np

from hapticd.analysis.arrays import Floats
from hapticd.analysis.boundary import grid
from hapticd.analysis.lifted import lift, lifted_margin, lifted_passive
from hapticd.analysis.requirement import paper_equation_2, required_damping
from hapticd.errors import AnalysisError
from hapticd.measure.beyond_display import Display, shown_hz
from hapticd.measure.beyond_envelope import LOW_HZ, mean_db

FURTHEST = -12.0  # N s/m, of a predicted search of B
DAMPINGS, MASSES = 41, 25  # values of B and M that are looked at


@dataclass(frozen=True, eq=False)
class Motion:
    """|Z| of one environment without K over `shown_hz()`: `predicted` (F,), `runs` (seeds, F) of trials that pass, maybe none.

    `spare`: damping that the lifted theorem leaves [N s/m], without friction.
    """

    name: str
    level: float
    damping: float
    mass_kg: float
    predicted: Floats
    runs: Floats
    spare: float

    @property
    def size(self) -> Floats:
        """|Z| (F,): mean over trials, the prediction without."""
        return np.asarray(self.runs.mean(axis=0)) if len(self.runs) else self.predicted

    def low_db(self) -> Floats:
        """Mean over ln f in 2-20 Hz [dB re 1 N s/m], (seeds,), of the prediction (1,) without trials."""
        return mean_db(shown_hz(), self.runs if len(self.runs) else self.predicted[None], LOW_HZ)


@dataclass(frozen=True, eq=False)
class Free:
    """`motions`: off, on, on_negative_B, on_negative_BM. `limits`: of B downwards by level: predicted, by trials (seeds,).

    `needed`: damping that a rigid device needs under B alone [N s/m], `available` what this one has, without friction; `refusal`:
    what Eq. 2 answers about it.
    """

    motions: tuple[Motion, ...]
    limits: dict[float, tuple[float, Floats]]
    needed: float
    available: float
    refusal: str


def free_motion(display: Display, level: float, seeds: tuple[int, ...]) -> Free:
    """Undamped against damped by `level` [N s/m]."""
    ends = {at: display.limit(at, 1, FURTHEST) for at in (0.0, level)}
    lightest = -display.model.mass_kg * 2.0
    damping, _ = safest(display, level, ends[level], 0.0)
    both = safest(display, level, ends[level], lightest)
    asked = (
        ("off", 0.0, 0.0, 0.0),
        ("on", level, 0.0, 0.0),
        ("on_negative_B", level, damping, 0.0),
        ("on_negative_BM", level, *both),
    )
    motions = tuple(_motion(display, *each, seeds) for each in asked)
    limits = {at: (end, display.limits_by_trials(at, 1, end, seeds)) for at, end in ends.items()}
    needed = required_damping([(0.0, damping, 0.0)], display.scene.rate_hz, display.model.delay_periods, display.filters)[0]
    available = display.model.viscous_ns_per_m + level
    return Free(motions, limits, float(needed[0]), available, _refusal(damping, available))


def safest(display: Display, level: float, end: float, lightest_kg: float) -> tuple[float, float]:
    """(B, M) of the lightest motion that is safe, B from `end` and M from `lightest_kg` up to 0."""
    masses = np.linspace(lightest_kg, 0.0, MASSES) if lightest_kg else np.zeros(1)
    points = grid((np.zeros(1), np.linspace(end, 0.0, DAMPINGS), masses))
    points = points[display.passive(points, level, dry=False)]
    points = points[lifted_passive(lift(display.model, level, display.filters), points)]
    if not len(points):
        raise AnalysisError(
            f"{display.scene.name!r} at {level:g} N s/m: not passive without friction even where nothing is rendered"
        )
    best = points[mean_db(shown_hz(), np.abs(display.impedances(points, level)), LOW_HZ).argmin()]
    return float(best[1]), float(best[2])


def _motion(display: Display, name: str, level: float, damping: float, mass_kg: float, seeds: tuple[int, ...]) -> Motion:
    point = np.array([[0.0, damping, mass_kg]])
    runs = np.concatenate([np.empty((0, shown_hz().size)), *(display.sized(point, level, seed) for seed in seeds)])
    spare = float(lifted_margin(lift(display.model, level, display.filters), point)[0])
    return Motion(name, level, damping, mass_kg, np.abs(display.impedances(point, level))[0], runs, spare)


def _refusal(damping: float, physical: float) -> str:
    """What the paper's Eq. 2 answers when it is asked about B < 0."""
    try:
        paper_equation_2(0.0, damping, physical)
    except AnalysisError as refused:
        return str(refused)
    return ""
