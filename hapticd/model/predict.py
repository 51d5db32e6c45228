"""Prediction without a trial: whether an environment is passive on a device, for thousands at once.

Passive means two things. The sampled loop is stable (`loop`). The first harmonic of its impedance
(`loop`) has Re Z >= 0 over the whole band, with Coulomb friction linearised at a given perturbation
(`linearise`), from which it must not run away. Re Z alone does not suffice: of random environments
with Re Z > 0 in 2-500 Hz one in twelve has a spectral radius above 1. K < 0 is refused for that
reason unless allowed explicitly.

Stability is computed where Re Z does not decide, with the point's linearised friction, between
steps of 5 %. The prediction is that of white noise (first harmonic, as in a measurement). Safety
decides on the lifted requirement without friction, `theorem`. A hand can destabilise an environment
that is predicted passive only outside the band, by images, or in motions so large that friction
counts for less (`coupled`, ADR-0017). Compared with 90 s of simulated trials: phase to 0.6-1.9
degrees rms, limits of K and B to 5-14 %.

Z is the true impedance. With `recorded` it is that of the probe's channels, for comparison with a
measurement. An AC-coupled velocity amplifier of 0.1 Hz turns a spring's phase so far that 1,200 N/m
read as 690, without any effect on the safety of the loop.
"""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from hapticd.core.arrays import Complexes, Flags, Floats, Integers
from hapticd.core.errors import AnalysisError
from hapticd.core.units import DEFAULT_BAND_HZ
from hapticd.model.angles import MinimumRealPart, min_real_part, mode_lines
from hapticd.model.linearise import (
    Linearised,
    Perturbation,
    add_port_dampers,
    impedance_each,
    linearise,
    port_admittance,
    recorded_impedance,
)
from hapticd.model.loop import (
    PAPER_FILTERS,
    Filters,
    Loop,
    close_loop,
    port_states,
    spectral_radius,
)
from hapticd.model.model import Model

__all__ = [
    "NOMINAL_NS_PER_M",
    "Prediction",
    "chunks",
    "coulomb",
    "frequencies",
    "predict",
    "predicted_impedance",
    "recorded_impedances",
    "with_equivalent_damping",
]

_TOGETHER = 1024  # environments at once: their spectra stay in the cache
_LOOPS = 16  # kept: device, level and filters of the last predictions
_FRICTION_STEP = 1.05
_LEAST_FRICTION = 1e-4  # N s/m
NOMINAL_NS_PER_M = 1.5  # first guess of a body's friction


@dataclass(frozen=True, eq=False)
class Prediction:
    """For each of N environments (K, B, M) whether it is passive, and why."""

    points: Floats  # (N, 3) K N/m, B N s/m, M kg
    passive: Flags  # (N,)
    margin_ns_per_m: Floats  # (N,) minimum Re Z over the band
    margin_deg: Floats  # (N,) minimum 90 - |phase| over the band
    worst_hz: Floats  # (N,) where Re Z is minimal
    friction_ns_per_m: Floats  # (N,) linearised Coulomb friction of all bodies
    velocity_sd: Floats  # (N,) at the port, m/s; nan without perturbation
    spectral_radius: Floats  # (N,) of a tick; nan where Re Z < 0 had decided
    calm: Flags  # (N,) whether bursts of motion die out
    refused: Flags  # (N,) K < 0
    band_hz: tuple[float, float]
    perturbation: Perturbation | None  # None: friction omitted
    recorded: bool = False  # margins, and so `passive`, are those of the recorded channels

    @property
    def decided_margin(self) -> Floats:
        """`margin_ns_per_m` for `PassiveSet.of`: nan where Re Z >= 0 did not suffice."""
        return np.where(self.passive | (self.margin_ns_per_m < 0.0), self.margin_ns_per_m, np.nan)


def predict(
    model: Model,
    points: npt.ArrayLike,
    active_damping_ns_per_m: float = 0.0,
    filters: Filters = PAPER_FILTERS,
    perturbation: Perturbation | None = None,
    band_hz: tuple[float, float] = DEFAULT_BAND_HZ,
    allow_negative_stiffness: bool = False,
    recorded: bool = False,
    stability: bool = True,
) -> Prediction:
    """Predict whether `model` at that level of active damping is passive under the environments
    `points` (N, 3): K [N/m], B [N s/m], M [kg].

    `filters` are those of velocity and acceleration. Without a `perturbation` Coulomb friction is
    omitted. `recorded` evaluates Re Z as a measurement would, as in `predicted_impedance`; do not
    use it for decisions on safety. Without `stability`, `passive` ignores eigenvalues, for a first
    scan of many points. AnalysisError for a wrong shape.
    """
    kbm = environments(points)
    start, loop = _nominal(
        model, (band_hz[0], band_hz[1]), active_damping_ns_per_m, filters, perturbation
    )
    f = loop.frequency_hz
    inside = (f >= band_hz[0]) & (f <= band_hz[1])

    def judged(part: Floats) -> tuple[MinimumRealPart, Linearised]:
        found = linearise(loop, part, coulomb(model), start, perturbation)
        z = recorded_impedance(loop, part, found.impedance) if recorded else found.impedance
        dampers = found.friction - start[:, None]  # in addition to those of the loop

        def at(which: Integers, hz: Floats) -> Complexes:
            lines, line = np.unique(hz, return_inverse=True)
            own = close_loop(
                with_equivalent_damping(model, start), lines, active_damping_ns_per_m, filters
            )
            return impedance_each(own, line, part[which], dampers[:, which], recorded)

        return min_real_part(f[inside], z[:, inside], at), found

    least, found = zip(*(judged(part) for part in chunks(kbm)), strict=True)
    margin = np.concatenate([one.margin for one in least])
    calm = np.concatenate([one.calm for one in found])
    friction = np.concatenate([one.friction for one in found], axis=1)
    refused = (kbm[:, 0] < 0.0) & (not allow_negative_stiffness)
    hopeful = (margin >= 0.0) & calm & ~refused
    radius = np.full(len(kbm), np.nan)
    if stability:
        radius[hopeful] = _radius(
            model, kbm[hopeful], friction[:, hopeful], active_damping_ns_per_m, filters
        )
    return Prediction(
        points=kbm,
        passive=hopeful & ((np.nan_to_num(radius, nan=2.0) < 1.0) | (not stability)),
        margin_ns_per_m=margin,
        margin_deg=np.concatenate([one.angle for one in least]),
        worst_hz=np.concatenate([one.hz for one in least]),
        friction_ns_per_m=friction.sum(axis=0),
        velocity_sd=np.concatenate([one.velocity_sd for one in found]),
        spectral_radius=radius,
        calm=calm,
        refused=refused,
        band_hz=band_hz,
        perturbation=perturbation,
        recorded=recorded,
    )


def predicted_impedance(
    model: Model,
    point: npt.ArrayLike,
    frequency_hz: npt.ArrayLike,
    active_damping_ns_per_m: float = 0.0,
    filters: Filters = PAPER_FILTERS,
    perturbation: Perturbation | None = None,
    recorded: bool = True,
) -> Complexes:
    """Return Z (F,) complex128 [N s/m] at the probe under one environment (K, B, M) at
    `frequency_hz` (F,) > 0.

    `recorded`: as the board's probe records it, with force held and velocity averaged over 250 us
    (`loop`), through the filters of the velocity channel; False for the true one.
    """
    f = np.asarray(frequency_hz, np.float64)
    kbm = environments(np.atleast_2d(np.asarray(point, np.float64)))
    start, loop = _nominal(model, DEFAULT_BAND_HZ, active_damping_ns_per_m, filters, perturbation)
    level = linearise(loop, kbm, coulomb(model), start, perturbation).friction[:, 0]
    exact = close_loop(with_equivalent_damping(model, level), f, active_damping_ns_per_m, filters)
    z = linearise(exact, kbm, np.zeros(len(level)), np.zeros(len(level)), None).impedance
    return np.asarray((recorded_impedance(exact, kbm, z) if recorded else z)[0])


def recorded_impedances(
    model: Model,
    points: Floats,
    frequency_hz: Floats,
    active_damping_ns_per_m: float,
    filters: Filters,
    perturbation: Perturbation,
) -> Complexes:
    """Return Z (N, F) [N s/m] of environments `points` (N, 3) at `frequency_hz` (F,) as the board's
    probe records them.

    Each is its `predicted_impedance` within 0.02 % up to 500 Hz and 0.1 % at 1 kHz: friction is
    added to the ports of a loop that already has the device's friction without an environment.
    """
    start, loop = _nominal(model, DEFAULT_BAND_HZ, active_damping_ns_per_m, filters, perturbation)
    own = close_loop(
        with_equivalent_damping(model, start), frequency_hz, active_damping_ns_per_m, filters
    )
    parts = []
    for part in chunks(points):
        level = linearise(loop, part, coulomb(model), start, perturbation).friction
        z = 1.0 / add_port_dampers(port_admittance(own, part), level - start[:, None])[0, 0]
        parts.append(recorded_impedance(own, part, z))
    return np.concatenate(parts)


def environments(points: npt.ArrayLike) -> Floats:
    """Return `points` as (N, 3) float64. AnalysisError unless they are finite triples."""
    kbm = np.asarray(points, np.float64)
    if kbm.ndim != 2 or kbm.shape[1] != 3 or not np.isfinite(kbm).all():
        raise AnalysisError(
            f"environments of shape {kbm.shape}: rows of three finite numbers K [N/m], B [N s/m], M"
            " [kg] are needed"
        )
    return kbm


def frequencies(
    band_hz: tuple[float, float] = DEFAULT_BAND_HZ, perturbation: Perturbation | None = None
) -> Floats:
    """Return the frequencies [Hz] at which Z is computed: dense where K, B and M act, up to the end
    of the perturbation, both ends of the band included.
    """
    if not 0.0 < band_hz[0] <= band_hz[1] < np.inf:
        raise AnalysisError(
            f"a band of {band_hz[0]:g}..{band_hz[1]:g} Hz: from above 0 Hz upwards is needed;"
            " 2..500 is usual"
        )
    top = max(band_hz[1], perturbation.band_hz if perturbation else 0.0)
    base = np.concatenate(
        (
            np.geomspace(0.1, 5.0, 15)[:-1],
            np.arange(5.0, 41.0),
            np.geomspace(41.0, 130.0, 32)[:-1],
            np.geomspace(130.0, 2000.0, 46),
        )
    )
    return np.union1d(base[base <= top], band_hz)


def coulomb(model: Model) -> Floats:
    """Return the friction level [N] of each port of the loop, 0 without friction."""
    level = {contact.velocity: contact.level_n for contact in model.contacts}
    return np.array([level.get(state, 0.0) for state in port_states(model)])


def with_equivalent_damping(model: Model, level: Floats) -> Model:
    """Return `model` with the dampers `level` (ports,) on its bodies with friction."""
    dampers = dict(zip(port_states(model), level, strict=True))
    a0 = model.a0.copy()
    for contact in model.contacts:
        a0[:, contact.velocity] -= dampers[contact.velocity] * model.b0[:, contact.column]
    return replace(model, a0=a0)


@lru_cache(maxsize=_LOOPS)
def _nominal(
    model: Model,
    band_hz: tuple[float, float],
    active_damping_ns_per_m: float,
    filters: Filters,
    perturbation: Perturbation | None,
) -> tuple[Floats, Loop]:
    """Return the friction of the device without environment, and the loop that has it, with lines
    around its modes inside the band: later changes stay small. Cached for further points of the
    same device.
    """
    f = frequencies(band_hz, perturbation)
    force = coulomb(model)
    start = np.where(force > 0.0, NOMINAL_NS_PER_M if perturbation else 0.0, 0.0)
    for _ in range(2 if start.any() else 0):
        loop = close_loop(
            with_equivalent_damping(model, start), f, active_damping_ns_per_m, filters
        )
        start = linearise(loop, np.zeros((1, 3)), force, start, perturbation).friction[:, 0]
    near = with_equivalent_damping(model, start)
    lines = np.union1d(f, mode_lines(near, active_damping_ns_per_m, f[f <= band_hz[1]]))
    return start, close_loop(near, lines, active_damping_ns_per_m, filters)


def chunks(kbm: Floats) -> list[Floats]:
    """Cut environments (N, 3) into parts whose spectra stay in the cache."""
    return [kbm[first : first + _TOGETHER] for first in range(0, max(1, len(kbm)), _TOGETHER)]


def _radius(
    model: Model, kbm: Floats, friction: Floats, active_damping_ns_per_m: float, filters: Filters
) -> Floats:
    """Return the spectral radius (N,) with `friction` (ports, N): exact at a few values of the
    friction, for which one map each is made, and linear between them. From one to the next the port
    with the largest fraction goes first (Freudenthal's triangulation).
    """
    rubbing = friction.any(axis=1)
    steps = np.log(np.maximum(friction[rubbing], _LEAST_FRICTION)) / np.log(_FRICTION_STEP)
    node = np.floor(steps)
    order = np.argsort(node - steps, axis=0)
    share = np.take_along_axis(steps - node, order, axis=0)
    shares = np.vstack((np.ones(len(kbm)), share, np.zeros(len(kbm))))
    radius = np.zeros(len(kbm))
    for rank, weight in enumerate(shares[:-1] - shares[1:]):
        if rank:
            node[order[rank - 1], np.arange(len(kbm))] += 1.0
        level = np.zeros_like(friction)
        level[rubbing] = _FRICTION_STEP**node
        radius += weight * _radius_at(model, kbm, level, active_damping_ns_per_m, filters)
    return radius


def _radius_at(
    model: Model, kbm: Floats, level: Floats, active_damping_ns_per_m: float, filters: Filters
) -> Floats:
    """Return the spectral radius (N,) with friction `level` (ports, N), with one map per distinct
    level.
    """
    nodes, which = np.unique(level, axis=1, return_inverse=True)
    radius = np.empty(len(kbm))
    for place, node in enumerate(nodes.T):
        mine = which.ravel() == place
        radius[mine] = spectral_radius(
            with_equivalent_damping(model, node), kbm[mine], active_damping_ns_per_m, filters
        )
    return radius
