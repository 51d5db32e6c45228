"""scenes/NAME.toml: a device, its environment, its excitation, and its effects.

`load_scene` finds a scene file and its device, merges the changes of the scene, validates, and
builds the `Scene`. A scene's [model.KEY] changes single numbers of the device's table of that name.
The merged device is validated like a single file, and messages refer to the file and line of the
wrong number.

The JSON schemas of all kinds of file are here too. They are for editors (`#:schema` in the first
line of a file) and `taplo check`.

Limitations: a scene that changes a number of a table that its device does not have (the table then
lacks its other numbers, and the message lists them).
"""

import copy
import json
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import Field

from hapticd.core.constraints import ServoRateHz
from hapticd.core.errors import ConfigError
from hapticd.core.params import RealtimeParams
from hapticd.core.units import unit_of
from hapticd.model.scene import DampingStep, Excitation, Scene
from hapticd.settings.build import converter_effects, environment_params
from hapticd.settings.config import Config, EnvironmentTable
from hapticd.settings.device import DeviceFile, effects_of
from hapticd.settings.load import chosen_rules, find_device, model_rules, report
from hapticd.settings.tables import TomlTable, Where, validated
from hapticd.settings.toml import Document, KeyPath, did_you_mean, read, shipped

__all__ = ["build_scene", "load_files", "load_scene", "schema_text"]


class DampingStepTable(TomlTable):
    """Active damping requested by the servo from `at_s` on."""

    at_s: float = Field(0.0, ge=0)
    """Time since the start; before the first step there is none."""
    level_ns_per_m: float = Field(ge=0)
    """The board rounds it to a count."""


class Start(TomlTable):
    """The endpoint at time 0."""

    position_m: float = 0.0
    """0 is the rest position of the environment's springs."""
    velocity_m_per_s: float = 0.0
    """Of all bodies together."""


class SceneFile(TomlTable):
    """A scene file."""

    title: str = Field(min_length=1)
    """One line, for figures and listings."""
    device: str = Field(min_length=1)
    """Name of a simulated device (devices/NAME.toml), or a path to one."""
    effects: tuple[str, ...] = Field(strict=False)
    """Effects of the device to build; all others are left out."""
    seconds: float = Field(10.0, gt=0, le=1e6)
    """Duration of the simulation, unless a command overrides it."""
    rate_hz: ServoRateHz = RealtimeParams().rate_hz
    """Of the servo."""
    allow_unstable: bool = False
    """Simulate a device whose damping circuit oscillates by itself."""
    environment: EnvironmentTable = EnvironmentTable()
    active_damping: tuple[DampingStepTable, ...] = Field((), strict=False)
    excitation: Excitation = Excitation()
    start: Start = Start()
    model: dict[str, dict[str, Any]] = Field(default_factory=dict)
    """Changes of the device: tables of its [model], changed number by number."""


SCHEMA_FILES = {
    "config": "hapticd.schema.json",
    "device": "device.schema.json",
    "scene": "scene.schema.json",
}
_KINDS: dict[str, type[TomlTable]] = {"config": Config, "device": DeviceFile, "scene": SceneFile}


def scene_names() -> list[str]:
    """Return the names of the scenes shipped with the package."""
    return sorted(file.stem for file in (shipped("config") / "scenes").glob("*.toml"))


def load_scene(name: str | Path) -> Scene:
    """Return the scene of that name, or in that file. ConfigError with one line for
    each mistake.
    """
    return build_scene(load_files(name))


class SceneFiles(NamedTuple):
    """A scene and its device, validated."""

    name: str
    scene: SceneFile
    device: DeviceFile  # with the scene's changes


def load_files(name: str | Path) -> SceneFiles:
    """Return the files of a scene, validated. ConfigError with one line for each mistake."""
    document = read(find_scene(name))
    scene = validated(SceneFile, document.data, document.where)
    device_document = read(find_device(scene.device, document.path, document.where(("device",))))
    data, where = _changed(device_document, document)
    device = validated(DeviceFile, data, where)
    report(
        (where, model_rules(device)),
        (document.where, chosen_rules(device, ("effects",), scene.effects)),
    )
    return SceneFiles(document.path.stem, scene, device)


def find_scene(name: str | Path) -> Path:
    """Return a path to a .toml file unchanged, otherwise a shipped scene. ConfigError lists the
    known ones.
    """
    if str(name).endswith(".toml"):
        return Path(name)
    file = shipped("config") / "scenes" / f"{name}.toml"
    if not file.is_file():
        known = scene_names()
        raise ConfigError(
            f"{name!r}: no such scene{did_you_mean(str(name), known)}; known: {', '.join(known)}"
        )
    return file


def build_scene(files: SceneFiles) -> Scene:
    """Return the validated files as the input of `compose`."""
    name, scene, device = files
    assert device.model is not None
    in_time = sorted(scene.active_damping, key=lambda step: step.at_s)
    steps = tuple(DampingStep(step.at_s, step.level_ns_per_m) for step in in_time)
    return Scene(
        name=name,
        title=scene.title,
        device=scene.device,
        effects=effects_of(device.model, scene.effects, converter_effects(device)),
        environment=environment_params(scene.environment, device.travel),
        active_damping=steps if steps and steps[0].at_s == 0.0 else (DampingStep(0.0, 0.0), *steps),
        excitation=scene.excitation,
        seconds=scene.seconds,
        rate_hz=scene.rate_hz,
        start_position_m=scene.start.position_m,
        start_velocity_m_per_s=scene.start.velocity_m_per_s,
        allow_unstable=scene.allow_unstable,
    )


def _changed(device: Document, scene: Document) -> tuple[dict[str, Any], Where]:
    """Return (the device's content with the scene's numbers, file:line of each key)."""
    data = copy.deepcopy(device.data)
    for key, numbers in scene.data.get("model", {}).items():
        data.setdefault("model", {}).setdefault(key, {}).update(numbers)

    def where(path: KeyPath) -> str:
        return scene.where(path) if scene.value(path) is not None else device.where(path)

    return data, where


def schema(kind: str) -> dict[str, Any]:
    """Return the JSON schema (draft 2020-12) of a kind of file, with units: `config`, `device` or
    `scene`.
    """
    found = _KINDS[kind].model_json_schema()
    for table in (found, *found["$defs"].values()):
        for name, entry in table["properties"].items():
            entry.pop("title", None)  # repeats the name
            if unit := unit_of(name):
                entry["unit"] = unit
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **found}


def schema_text(kind: str) -> str:
    """Return the schema as shipped."""
    return json.dumps(schema(kind), indent=2, ensure_ascii=False) + "\n"
