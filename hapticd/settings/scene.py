"""Find a scene file and its device, merge what the scene changes, validate, and build the `Scene`.

A scene's [model.KEY] changes single numbers of the device's table of that name; the merged device is validated as if it
stood in one file, and messages point to the file and line that the wrong number came from.
"""

import copy
from pathlib import Path
from typing import Any

from hapticd.errors import ConfigError
from hapticd.plant.scene import DampingStep, Excitation, Scene
from hapticd.settings.build import converter_effects, environment_params
from hapticd.settings.check import report
from hapticd.settings.device import Device
from hapticd.settings.document import Document, KeyPath, read
from hapticd.settings.effects import effects_of
from hapticd.settings.explain import Where
from hapticd.settings.load import find_device, validated
from hapticd.settings.meant import did_you_mean
from hapticd.settings.model_rules import chosen_rules, model_rules
from hapticd.settings.resources import shipped
from hapticd.settings.scene_file import SceneFile


def scene_names() -> list[str]:
    """The scenes that travel with the package."""
    return sorted(file.stem for file in (shipped("config") / "scenes").glob("*.toml"))


def load_scene(name: str | Path) -> Scene:
    """The scene of that name, or in that file. ConfigError with one line for everything that is wrong."""
    return build_scene(*load_files(name))


def load_files(name: str | Path) -> tuple[str, SceneFile, Device]:
    """(name, scene file, its device with the scene's changes), validated."""
    document = read(find_scene(name))
    scene = validated(SceneFile, document.data, document.where)
    device_document = read(find_device(scene.device, document.path, document.where(("device",))))
    data, where = _changed(device_document, document)
    device = validated(Device, data, where)
    report((where, model_rules(device)), (document.where, chosen_rules(device, ("effects",), scene.effects)))
    return document.path.stem, scene, device


def find_scene(name: str | Path) -> Path:
    """A path to a .toml file as it is, else a shipped scene. ConfigError names those there are."""
    if str(name).endswith(".toml"):
        return Path(name)
    file = shipped("config") / "scenes" / f"{name}.toml"
    if not file.is_file():
        known = scene_names()
        raise ConfigError(f"{name!r}: no such scene{did_you_mean(str(name), known)}; known: {', '.join(known)}")
    return file


def build_scene(name: str, scene: SceneFile, device: Device) -> Scene:
    """The validated files as the values that `compose` takes."""
    assert device.model is not None
    steps = tuple(DampingStep(step.at_s, step.level_ns_per_m) for step in sorted(scene.damping, key=lambda step: step.at_s))
    return Scene(
        name=name,
        title=scene.title,
        device=scene.device,
        effects=effects_of(device.model, scene.effects, converter_effects(device)),
        environment=environment_params(scene.environment, device.travel),
        damping=steps if steps and steps[0].at_s == 0.0 else (DampingStep(0.0, 0.0), *steps),
        excitation=Excitation(**scene.excitation.model_dump()),
        seconds=scene.seconds,
        rate_hz=scene.rate_hz,
        start_position_m=scene.start.position_m,
        start_velocity_m_per_s=scene.start.velocity_m_per_s,
        allow_unstable=scene.allow_unstable,
    )


def _changed(device: Document, scene: Document) -> tuple[dict[str, Any], Where]:
    data = copy.deepcopy(device.data)
    for key, numbers in scene.data.get("model", {}).items():
        data.setdefault("model", {}).setdefault(key, {}).update(numbers)

    def where(path: KeyPath) -> str:
        return scene.where(path) if scene.value(path) is not None else device.where(path)

    return data, where
