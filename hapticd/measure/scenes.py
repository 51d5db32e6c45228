"""What procedures ask of a scene: its environment as a point, its damping level, itself without an effect, its impedance.

Z is measured as the paper does it (noise at the probe, `analysis.spa`) and taken on frequencies that are evenly spaced in
ln f. They lie on the grid of the paper's window, so that a longer window has them on its grid too.
"""

from dataclasses import replace
from math import inf

import numpy as np
import numpy.typing as npt

from hapticd.analysis.arrays import Complexes, Floats
from hapticd.analysis.linearise import Perturbation, linearise
from hapticd.analysis.loop import Filters, close_loop
from hapticd.analysis.predict import DEFAULT_BAND_HZ, coulomb
from hapticd.analysis.spa import DEFAULT_LAG, spa
from hapticd.analysis.spectra import Spectra
from hapticd.errors import AnalysisError
from hapticd.params import EnvironmentParams, FilterParams, WallParams
from hapticd.plant.catalogue import ALWAYS
from hapticd.plant.model import Model
from hapticd.plant.scene import Excitation, Scene
from hapticd.sim.engine import BatchResult
from hapticd.units import PROBE_RATE_HZ

FREQUENCIES = 60
SUBSTEPS = 4  # per 4 kHz sample: their error is below the chance of a 90 s trial (docs/accuracy.md)
SATURATED = 1.0 - 1e-6  # of the force limit: float32 rounds it


def point(scene: Scene) -> tuple[float, float, float]:
    """K [N/m], B [Ns/m], M [kg] that the scene renders."""
    rendered = scene.environment
    return rendered.stiffness_n_per_m, rendered.damping_ns_per_m, rendered.mass_kg


def level(scene: Scene) -> float:
    """The highest electrical damping [Ns/m] of the scene."""
    return max(step.level_ns_per_m for step in scene.damping)


def filters(scene: Scene) -> tuple[FilterParams, FilterParams]:
    """Of velocity and acceleration."""
    return scene.environment.velocity_filter, scene.environment.acceleration_filter


def free_of_walls(scene: Scene) -> EnvironmentParams:
    """The environment without its wall, which has no impedance of its own."""
    return replace(scene.environment, wall=WallParams())


def noise(scene: Scene) -> Excitation:
    """The scene's own noise, or the paper's where the scene has none."""
    return scene.excitation if scene.excitation.kind == "noise" else Excitation("noise", seed=scene.excitation.seed)


def perturbation(source: Excitation) -> Perturbation:
    """What a prediction knows of noise or a multisine."""
    return Perturbation(source.psd_n2_per_hz, source.band_hz)


def predicted_impedances(
    model: Model, points: Floats, frequency_hz: Floats, damping_ns_per_m: float, filters: Filters, source: Perturbation
) -> Complexes:
    """Z (N, F) [N s/m] of environments (N, 3) as trials record it, friction linearised on the same frequencies (F,)."""
    loop, friction = close_loop(model, frequency_hz, damping_ns_per_m, filters), coulomb(model)
    return np.asarray(linearise(loop, points, friction, np.zeros_like(friction), source).impedance * loop.recorded)


def candidates(scene: Scene) -> tuple[str, ...]:
    """Effects that can be left out."""
    return tuple(effect.key for effect in scene.effects if effect.key not in ALWAYS)


def without(scene: Scene, *keys: str) -> Scene:
    """The scene without these effects."""
    return replace(scene, effects=tuple(effect for effect in scene.effects if effect.key not in keys))


def is_linear(scene: Scene) -> bool:
    """Whether nothing in it is not linear, so that its impedance is known exactly."""
    return not any(effect.nonlinearity for effect in scene.effects) and scene.environment.wall.side == 0


def frequencies(band_hz: tuple[float, float] = DEFAULT_BAND_HZ, count: int = FREQUENCIES) -> Floats:
    """About `count` frequencies (F,) [Hz] inside the band, evenly in ln f, on the grid of the paper's window."""
    spacing = 0.5 * PROBE_RATE_HZ / DEFAULT_LAG
    first, last = np.ceil(band_hz[0] / spacing), np.floor(band_hz[1] / spacing)
    return np.asarray(np.unique(np.round(np.geomspace(first, last, count))) * spacing)


def spectra_on(torque_n: npt.ArrayLike, velocity_m_per_s: npt.ArrayLike, frequency_hz: Floats, lag: int = DEFAULT_LAG) -> Spectra:
    """Spectra of a record at `frequency_hz` (F,), by the whole grid of its window where that has them."""
    if lag % DEFAULT_LAG:
        return spa(torque_n, velocity_m_per_s, lag=lag, frequency_hz=frequency_hz)
    whole = spa(torque_n, velocity_m_per_s, lag=lag)
    at = np.rint(frequency_hz * (2 * lag / PROBE_RATE_HZ)).astype(int)
    return replace(whole, frequency_hz=frequency_hz, velocity=whole.velocity[at], force=whole.force[at], cross=whole.cross[at])


def calm(found: BatchResult, force_limit_n: float | None) -> list[int]:
    """Trials that ran to their end without reaching the force limit: the others ran away, and have no impedance."""
    limit_n = inf if force_limit_n is None else force_limit_n
    return [int(trial) for trial in np.flatnonzero(~found.diverged & (found.max_force_n < SATURATED * limit_n))]


def pooled(trials: list[Spectra]) -> Complexes:
    """Z (F,) of several trials together: sums of their spectra. AnalysisError without trials."""
    if not trials:
        raise AnalysisError("not stable: no trial ran to its end, so there is no impedance")
    return np.asarray(sum(trial.cross for trial in trials) / sum(trial.velocity for trial in trials))
