"""Properties of a scene for procedures: its environment without walls, its damping level, itself
without an effect, its impedance; and its device, composed once, with all predictions (`Display`).

Z is measured as in the paper (noise at the probe, `signal.spectra`) on frequencies evenly spaced in
ln f. They are on the grid of the paper's window, so the grid of a longer window contains them too.

A prediction and the trials compared with it must have the same perturbation.
"""

from dataclasses import dataclass, field, replace
from functools import lru_cache
from math import inf
from pathlib import Path

import numpy as np

from hapticd.core.arrays import Complexes, Flags, Floats
from hapticd.core.environment import Environment, WallParams
from hapticd.core.errors import ConfigError
from hapticd.core.units import PROBE_RATE_HZ
from hapticd.model.compose import compose
from hapticd.model.effects import ALWAYS
from hapticd.model.linearise import Perturbation
from hapticd.model.loop import Filters
from hapticd.model.model import Model
from hapticd.model.predict import DEFAULT_BAND_HZ, Prediction, predict, recorded_impedances
from hapticd.model.scene import Excitation, Scene
from hapticd.settings.build import device_effects, rigid_effects
from hapticd.settings.config import validated
from hapticd.settings.device import DeviceFile
from hapticd.settings.load import find_config, find_device
from hapticd.settings.toml import Document, read, shipped
from hapticd.signal.spectra import DEFAULT_LAG

__all__ = [
    "NOISE",
    "SUBSTEPS",
    "Display",
    "candidates",
    "device_file",
    "device_scene",
    "display",
    "free_of_walls",
    "frequencies",
    "is_linear",
    "level",
    "noise",
    "scene_of_device",
    "without",
]

TRIAL_S = 90.0
NOISE = Excitation("noise")  # the paper's perturbation
FREQUENCIES = 60
# per 4 kHz sample: error below the random error of a 90 s trial (docs/development/accuracy.md)
SUBSTEPS = 4
SATURATED = 1.0 - 1e-6  # of the force limit: float32 rounds it


def level(scene: Scene) -> float:
    """Return the highest active damping [Ns/m] of the scene."""
    return max(step.level_ns_per_m for step in scene.active_damping)


def free_of_walls(scene: Scene) -> Environment:
    """Return the environment without its wall, which has no impedance of its own."""
    return replace(scene.environment, wall=WallParams())


def noise(scene: Scene) -> Excitation:
    """Return the scene's own noise, or the paper's if the scene has none."""
    return (
        scene.excitation
        if scene.excitation.kind == "noise"
        else Excitation("noise", seed=scene.excitation.seed)
    )


@dataclass(frozen=True, eq=False)
class Display:
    """A scene's device with its environment's filters, under the perturbation of its trials; made
    by `display`.

    Passive means passive by the paper's rule at that perturbation. Much of a device's damping may
    be dry friction, which fades as the motion grows; `dry=False` therefore requires passivity
    without it, at any amplitude.
    """

    scene: Scene
    excitation: Excitation
    model: Model = field(repr=False)

    @property
    def filters(self) -> Filters:
        """The filters of velocity and acceleration."""
        return self.scene.environment.filters

    @property
    def perturbation(self) -> Perturbation:
        """The perturbation of its trials."""
        return Perturbation(self.excitation.psd_n2_per_hz, self.excitation.band_hz)

    @property
    def force_limit_n(self) -> float:
        """The force at which its command saturates [N]; inf without a limit."""
        return self.model.force_limit_n or inf

    def predicted(
        self,
        points: Floats,
        level: float,
        band_hz: tuple[float, float] = DEFAULT_BAND_HZ,
        dry: bool = True,
    ) -> Prediction:
        """Predict environments (N, 3) at a damping level [N s/m]; `dry`: with the friction at the
        perturbation, and as the trials record it.
        """
        return predict(
            self.model,
            points,
            level,
            self.filters,
            self.perturbation if dry else None,
            band_hz,
            recorded=dry,
        )

    def passive(
        self,
        points: Floats,
        level: float,
        band_hz: tuple[float, float] = DEFAULT_BAND_HZ,
        dry: bool = True,
    ) -> Flags:
        """Return (N,) at the perturbation; without `dry` also at any larger one."""
        found = self.predicted(points, level, band_hz).passive
        return (
            found
            if dry or not found.any()
            else found & self.predicted(points, level, band_hz, dry=False).passive
        )

    def impedances(self, points: Floats, level: float, frequency_hz: Floats) -> Complexes:
        """Return Z (N, F) [N s/m] of environments (N, 3) at `frequency_hz` (F,) as recorded."""
        return recorded_impedances(
            self.model, points, frequency_hz, level, self.filters, self.perturbation
        )


@lru_cache(maxsize=64)
def display(scene: Scene, excitation: Excitation | None = None) -> Display:
    """Return the scene's device, composed once, under `excitation`, by default its own noise.
    ConfigError as `compose`.
    """
    return Display(scene, excitation or noise(scene), _composed(scene))


_composed = lru_cache(maxsize=64)(compose)


def candidates(scene: Scene) -> tuple[str, ...]:
    """Return the effects that can be left out."""
    return tuple(effect.key for effect in scene.effects if effect.key not in ALWAYS)


def without(scene: Scene, *keys: str) -> Scene:
    """The scene without these effects."""
    return replace(
        scene, effects=tuple(effect for effect in scene.effects if effect.key not in keys)
    )


def is_linear(scene: Scene) -> bool:
    """Whether the scene is linear, so that its impedance is known exactly."""
    return (
        not any(effect.nonlinearity for effect in scene.effects)
        and scene.environment.wall.side == 0
    )


def frequencies(band_hz: tuple[float, float] = DEFAULT_BAND_HZ, count: int = FREQUENCIES) -> Floats:
    """Return about `count` frequencies (F,) [Hz] inside the band, evenly in ln f, on the grid of
    the paper's window.
    """
    spacing = 0.5 * PROBE_RATE_HZ / DEFAULT_LAG
    first = np.ceil(band_hz[0] / spacing)
    last = np.floor(band_hz[1] / spacing)
    return np.asarray(np.unique(np.round(np.geomspace(first, last, count))) * spacing)


def device_scene(name: str) -> Scene | None:
    """Return the scene of the device file `name`; None if there is no such file, or it cannot be
    simulated.
    """
    try:
        document = _device_document(name)
    except ConfigError:
        return None
    if "device" in document.data:  # it refers to a device, so it is a scene
        return None
    device = validated(DeviceFile, document.data, document.where)
    effects = rigid_effects(device) or device_effects(device)
    if not effects:
        return None
    return Scene(
        document.path.stem,
        device.name,
        document.path.stem,
        effects,
        excitation=Excitation("noise"),
        seconds=TRIAL_S,
    )


def device_file(name: str) -> DeviceFile:
    """Return the device file `name`. ConfigError if it is missing or invalid."""
    document = _device_document(name)
    return validated(DeviceFile, document.data, document.where)


def _device_document(name: str) -> Document:
    return read(find_device(name, shipped("config") / "hapticd.toml", "device"))


def scene_of_device(title: str) -> Scene | None:
    """Return the scene of the device file that gives its device this name, from the configuration
    or otherwise from the shipped files; None if there is none, or it cannot be simulated.
    """
    shipped_files = sorted((shipped("config") / "devices").glob("*.toml"))
    for path in (*_configured(), *shipped_files):
        if read(path).data.get("name") == title:
            return device_scene(str(path))
    return None


def _configured() -> tuple[Path, ...]:
    """Return the device file of the configuration, if both exist."""
    try:
        document = read(find_config())
        return (find_device(str(document.data.get("device")), document.path, "device"),)
    except ConfigError:
        return ()
