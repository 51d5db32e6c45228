"""What a hand feels of a law without an impedance, and its noise at rest, for
`studies.port_energy`.

Felt impedance (`felt`). The probe plays one sine after the other, each of SINE times the push of
`port_energy`. Z is the ratio of the Fourier sums of force and velocity over the last second: the
describing function at this force. Encoder and force limit act, dry friction does not, as in the
column of the linear remedies. On a linear law both agree.

Noise at rest (`noise_at_rest`). The law plays in CPython (`played`), with the loop open: the handle
rests, and the positions are white, evenly distributed over a count of the encoder. Their rms is
that of rounding, quantum / sqrt(12), as in the column of the linear remedies. All of the first
TICKS count: some laws give one large force and are quiet afterwards.

Limitations: other forces, at which a nonlinear law has another impedance; Z at harmonics of the
sine.
"""

from math import inf, nan, pi
from typing import Any

import numpy as np

from hapticd.core.arrays import Complexes, Floats
from hapticd.core.units import PROBE_RATE_HZ
from hapticd.model.scene import Scene
from hapticd.render.law import at_rest, design_coefficients, render
from hapticd.studies.remedies import RENDERED_HZ
from hapticd.zwidth.engine.batch import simulate
from hapticd.zwidth.engine.parts import CONTROLLERS, ESTIMATORS, LawPart
from hapticd.zwidth.sources import SUBSTEPS, display

__all__ = ["SINE", "felt", "noise_at_rest", "played"]

SINE = 0.1  # amplitude of the probe's force over the push
SETTLED_S = 4.0  # length of a trial; its last second counts
TICKS = 4000  # of the noise at rest
NO_WALL = (0.0, 0.0, 0.0, 0.0, -inf, inf, 0.0)


def felt(
    scene: Scene, parts: tuple[LawPart, ...], asked: tuple[float, float], amplitude_n: float
) -> Complexes:
    """Return Z at RENDERED_HZ (3,) over the asked K / s + B, `asked` in N/m and N s/m, for sines of
    that amplitude; nan where the motion diverges.
    """
    calm = scene.without("coulomb")
    second = np.arange(PROBE_RATE_HZ) / PROBE_RATE_HZ
    found = []
    for hz in RENDERED_HZ:
        trial = simulate(
            display(calm).model,
            [[*asked, 0.0]],
            SETTLED_S,
            active_damping=calm.level_ns_per_m,
            environment=calm.free_of_walls,
            excitation=amplitude_n * np.sin(2.0 * pi * hz * second),
            substeps=SUBSTEPS,
            keep="records",
            parts=parts,
        )
        force, velocity = (one[-second.size :] for one in trial.record(0))
        turn = np.exp(-2j * pi * hz * second)
        z = nan if trial.diverged[0] else (force @ turn) / (velocity @ turn)
        found.append(z / (asked[0] / (2j * pi * hz) + asked[1]))
    return np.array(found)


def played(
    scene: Scene, parts: tuple[LawPart, ...], asked: tuple[float, float], positions_m: Floats
) -> Floats:
    """Return the forces [N] (N,) of the law with `parts` in CPython, tick by tick, for `asked` K
    [N/m] and B [N s/m], from rest at 0.
    """
    k, b = asked
    shown = display(scene)
    coefficients = design_coefficients(*scene.environment.filters, shown.model.rate_hz)
    state = at_rest(0.0)
    memories: list[Any] = [part.at_rest(0.0) for part in parts]
    limit = shown.force_limit_n
    forces = []
    for x in positions_m.tolist():
        inputs = (k, b, 0.0, 0.0, limit, *NO_WALL)
        for place, part in enumerate(parts):
            if part.kind in ESTIMATORS:
                v, memories[place] = ESTIMATORS[part.kind](x, memories[place], part.numbers)
                inputs = (k, 0.0, 0.0, -b * v, limit, *NO_WALL)
        force, *_, state = render(x, state, inputs, coefficients)
        for place, part in enumerate(parts):
            if part.kind in CONTROLLERS:
                force, memories[place] = CONTROLLERS[part.kind](
                    x, force, limit, memories[place], part.numbers
                )
        forces.append(force)
    return np.array(forces)


def noise_at_rest(scene: Scene, parts: tuple[LawPart, ...], asked: tuple[float, float]) -> float:
    """Return the rms force [N] of the law at rest; nan without an encoder."""
    quantum_m = display(scene).model.encoder_quantum_m
    if quantum_m is None:
        return nan
    positions = quantum_m * (np.random.default_rng(1).random(TICKS) - 0.5)
    return float(np.sqrt(np.mean(played(scene, parts, asked, positions) ** 2)))
