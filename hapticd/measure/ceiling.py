"""The largest electrical damping that a scene's device bears, and the largest with the scene's environment around it.

Both are edges of stability found by bisection on eigenvalues: of the open device in continuous time (`plant.stability`), and
of the exact map of one servo tick (`analysis.closed`), Coulomb friction left out. Above the first the analog circuit
oscillates whatever the servo does. The second is a range: too little damping can be unstable as well.

What limits the device is its resistance compensation (Weir, Colgate and Peshkin 2008, section 5): a winding colder than it
believes leaves a ceiling of K^2 / dR, a hot one may leave none. So the same is asked for a range of winding temperatures.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import inf, nan, tau

import numpy as np

from hapticd.analysis.closed import spectral_radius
from hapticd.errors import ConfigError
from hapticd.measure.scenes import filters, level, point
from hapticd.plant.compose import compose_device
from hapticd.plant.model import Model
from hapticd.plant.scene import Scene
from hapticd.plant.stability import damping_ceiling, modes
from hapticd.plant.winding import WindingTemperature

HIGHEST_NS_PER_M = 1e6  # no ceiling below it is none
BISECTIONS = 60
SCAN = 400
WARMER_K = (-40.0, -20.0, -10.0, -5.0, 0.0, 10.0, 40.0)


@dataclass(frozen=True, slots=True)
class Ceiling:
    """All damping levels in N s/m.

    `device`: the highest at which the device alone is stable, inf without one; `oscillation_hz` where it then oscillates (nan
    if it grows without). `lowest`, `highest`: between them the loop with the scene's environment is stable; nan if never.
    `scene` is the scene's own level, `loop_gain` g dR / K^2 at that level. `warmer`: (winding minus what the compensation
    believes [K], ceiling of the device), empty if the scene has no winding.
    """

    device: float
    oscillation_hz: float
    lowest: float
    highest: float
    scene: float
    loop_gain: float
    warmer: tuple[tuple[float, float], ...]


def ceiling(scene: Scene) -> Ceiling:
    """Of a scene, whether or not its own level is stable. ConfigError as `compose_device`, or for a shorted motor."""
    model = compose_device(scene.name, scene.effects, scene.rate_hz)
    if not (model.a1.any() or model.b1.any()):
        raise ConfigError(f"scene {scene.name!r}: the motor is shorted and obeys no damping command; leave out 'crowbar'")
    top, asked = damping_ceiling(model, HIGHEST_NS_PER_M), level(scene)
    lowest, highest = _loop(scene, model, top)
    circuit = model.level_gain * asked + model.level_offset_ns_per_m
    return Ceiling(
        device=_finite(top),
        oscillation_hz=nan if top >= HIGHEST_NS_PER_M else _frequency(model, top),
        lowest=lowest,
        highest=_finite(highest),
        scene=asked,
        loop_gain=circuit * model.residual_ohm / model.torque_constant_n_per_a**2,
        warmer=tuple((kelvin, _warmer(scene, kelvin)) for kelvin in WARMER_K if _windings(scene)),
    )


def _finite(level_ns_per_m: float) -> float:
    return float(level_ns_per_m) if level_ns_per_m < HIGHEST_NS_PER_M else inf


def _windings(scene: Scene) -> list[WindingTemperature]:
    return [effect for effect in scene.effects if isinstance(effect, WindingTemperature)]


def _warmer(scene: Scene, kelvin: float) -> float:
    """The ceiling with the winding `kelvin` above what is compensated."""
    own = _windings(scene)[0]
    other = replace(own, temperature_c=own.compensated_c + kelvin)
    effects = tuple(other if effect is own else effect for effect in scene.effects)
    return _finite(damping_ceiling(compose_device(scene.name, effects, scene.rate_hz), HIGHEST_NS_PER_M))


def _frequency(model: Model, edge_ns_per_m: float) -> float:
    """Of the mode that is about to grow."""
    found = modes(model, edge_ns_per_m)
    return float(abs(found[np.argmax(found.real)].imag) / tau)


def _loop(scene: Scene, model: Model, top: float) -> tuple[float, float]:
    """(lowest, highest) damping with which the sampled loop is stable."""

    def stable(level_ns_per_m: float) -> bool:
        return float(spectral_radius(model, np.array([point(scene)]), level_ns_per_m, filters(scene))[0]) < 1.0

    levels = [0.0, *(float(each) for each in np.geomspace(1e-3, top, SCAN))]
    good = [stable(each) for each in levels]
    if not any(good):
        return nan, nan
    first = good.index(True)
    last = next((k for k in range(first, len(good)) if not good[k]), len(good)) - 1
    lowest = _edge(stable, levels[first], levels[first - 1]) if first else 0.0
    return lowest, levels[last] if last == len(good) - 1 else _edge(stable, levels[last], levels[last + 1])


def _edge(stable: Callable[[float], bool], inside: float, outside: float) -> float:
    for _ in range(BISECTIONS):
        middle = 0.5 * (inside + outside)
        inside, outside = (middle, outside) if stable(middle) else (inside, middle)
    return inside
