"""scenes/NAME.toml, the JSON schemas of all files, and the guard's model of the device.

Scene (`load_scene`). It is a device, its environment, its excitation and its effects. `load_scene`
finds a scene file and its device, merges the changes of the scene, validates, and builds the
`Scene`. A scene's [model.KEY] changes single numbers of the device's table of that name. The merged
device is validated like a single file, and messages refer to the file and line of the wrong number.

Schemas (`schema_text`). Every kind of file has a JSON schema, for editors (`#:schema` in the first
line of a file) and `taplo check`.

Limitations: a scene that changes a number of a table that its device does not have. The table then
lacks its other numbers, and the message lists them.

guard.json (`guard_setup`). It is the device model of the guard, composed once, as numbers. The
model is the whole linear device of the device file, with the effects of a live board. A simulated
board without a model is one rigid mass. A real device without a model has none, so passivity is
unknown. A .zwidth file is valid only for the device file, rate and filters of its measurement; any
difference is kept as the reason for its refusal.

JSON must not round numbers of the model (floats are written so that they are read back to the last
bit).
"""

import copy
import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import Field

from hapticd.core.environment import ServoRateHz
from hapticd.core.errors import ConfigError
from hapticd.core.params import EnvironmentLimits, GuardParams, RealtimeParams, ServoParams
from hapticd.core.units import COPPER_PER_K, unit_of
from hapticd.model.effects import Effect, Motor, WindingTemperature
from hapticd.model.params import GuardSetup, MeasuredLevel, MeasuredParams, ModelParams
from hapticd.model.scene import DampingStep, Excitation, Scene, converter_effects
from hapticd.settings.build import (
    device_effects,
    device_params,
    environment_params,
    guard_params,
    rigid_effects,
)
from hapticd.settings.config import Config, EnvironmentTable, TomlTable, Where, validated
from hapticd.settings.device import DeviceFile, effects_of
from hapticd.settings.load import Settings, chosen_rules, find_device, model_rules, report
from hapticd.settings.toml import (
    SETTINGS_BYTES,
    Document,
    KeyPath,
    did_you_mean,
    read,
    regular,
    shipped,
)

__all__ = ["build_scene", "guard_setup", "load_files", "load_scene", "schema_text"]


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
        effects=effects_of(device.model, scene.effects, converter_effects(device_params(device))),
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


# --- guard.json -----------------------------------------------------------------------------------
AXES = ("K", "B", "M")  # order of the axes in a .zwidth file
ENDS = ("K+", "B-", "B+", "M-", "M+")  # order of the ends in MeasuredLevel


def guard_setup(settings: Settings, servo: ServoParams, limits: EnvironmentLimits) -> GuardSetup:
    """Return guard.json, for the guard of the servo with the parameters `servo`, where clients may
    request K, B, M within `limits`. ConfigError as for `compose`.
    """
    guard = guard_params(settings)
    model = _model(settings, servo.realtime.rate_hz)
    return GuardSetup(
        guard=guard,
        config_hash=servo.config_hash,
        environment=servo.environment,
        active_damping_ns_per_m=servo.active_damping_ns_per_m,
        active_damping_limit_ns_per_m=servo.device.active_damping_limit_ns_per_m,
        active_damping_count_ns_per_m=servo.device.active_damping.per_count,
        limits=limits,
        model=model,
        model_hash="" if model is None else _hash(model),
        measured=_measured(guard, settings, servo),
    )


def _hash(model: ModelParams) -> str:
    """Return the SHA-256 (hex) of the model's numbers."""
    return hashlib.sha256(json.dumps(asdict(model), sort_keys=True).encode()).hexdigest()


def _model(settings: Settings, rate_hz: float) -> ModelParams | None:
    device = settings.device
    effects = rigid_effects(device) or device_effects(device, settings.config.simulation.effects)
    if device.resistance is not None:
        effects = compensated(effects, device.resistance.tolerance_ohm)
    return model_params(device.name, effects, rate_hz) if effects else None


def compensated(effects: tuple[Effect, ...], tolerance_ohm: float) -> tuple[Effect, ...]:
    """Return `effects` with a winding so warm that `tolerance_ohm` is uncompensated. This is the
    maximum that the servo permits damping and force to become.

    If this is passive, so is any reduction of both by the same share, as far as the circuit is
    fast. Re Z is linear in the share, and with neither of them it is the device's own damping.
    """
    cold = next((one.resistance_ohm for one in effects if isinstance(one, Motor)), None)

    def warm(effect: Effect) -> Effect:
        if not isinstance(effect, WindingTemperature) or cold is None:
            return effect
        kelvin = tolerance_ohm / (cold * COPPER_PER_K)
        return replace(effect, temperature_c=effect.compensated_c + kelvin)

    return tuple(warm(one) for one in effects)


def model_params(name: str, effects: Iterable[Effect], rate_hz: float) -> ModelParams:
    """Return the device with these effects as numbers. ConfigError as for `compose_device`."""
    from hapticd.model.compose import compose_device  # numpy: never loaded by a servo

    model = compose_device(name, effects, rate_hz)
    outputs = model.outputs
    impulse = outputs.recorded_impulse

    def rows(matrix: Any) -> tuple[tuple[float, ...], ...]:
        return tuple(tuple(row) for row in matrix.tolist())

    return ModelParams(
        name=name,
        rate_hz=rate_hz,
        delay_periods=float(model.delay_periods),
        states=tuple(state.name for state in model.states),
        a0=rows(model.a0),
        a1=rows(model.a1),
        b0=rows(model.b0),
        b1=rows(model.b1),
        command=model.inputs.command,
        torque=model.inputs.torque,
        encoder=outputs.encoder.params(),
        position=outputs.position.params(),
        velocity=outputs.velocity.params(),
        recorded_velocity=outputs.recorded_velocity.params(),
        recorded_travel=outputs.recorded_travel.params(),
        recorded_impulse=None if impulse is None else impulse.params(),
        contacts=model.contacts,
    )


def _measured(guard: GuardParams, settings: Settings, servo: ServoParams) -> MeasuredParams | None:
    if not guard.measured:
        return None
    path = Path(guard.measured)
    try:
        content = json.loads(regular(path, SETTINGS_BYTES).read_text())
        return measured_params(path.name, content, settings.device_file.read_bytes(), servo)
    except (OSError, ValueError, KeyError, TypeError, ConfigError) as error:
        return MeasuredParams(path.name, f"{path}: no Z-width summary that can be used ({error})")


def measured_params(
    file: str, content: Mapping[str, Any], device_file: bytes, servo: ServoParams
) -> MeasuredParams:
    """Return the limits of the .zwidth `content` for the device of `device_file` and the servo
    `servo`.
    """
    stated = content["conditions"]
    corners = tuple(float(corner) for corner in stated["filters_hz"])
    refused = _refused(content, stated, device_file, servo.realtime.rate_hz)
    return MeasuredParams(
        file, refused, corners, float(stated["perturbation"]["psd_n2_per_hz"]), _levels(content)
    )


def _refused(
    content: Mapping[str, Any], stated: Mapping[str, Any], device_file: bytes, rate_hz: float
) -> str:
    if content["device_file_sha256"] != hashlib.sha256(device_file).hexdigest():
        return (
            f"it was measured on {content['device']!r} with another device file; measure this"
            " device with `hapticd zwidth`"
        )
    if float(stated["rate_hz"]) != rate_hz:
        return (
            f"it was measured at {stated['rate_hz']:g} Hz, the servo runs at {rate_hz:g} Hz;"
            " measure at this rate"
        )
    return ""


def _levels(content: Mapping[str, Any]) -> tuple[MeasuredLevel, ...]:
    """Return axis limits by level; K has one end, B and M have two, as far as they were
    searched.
    """
    found: dict[float, dict[str, float]] = {}
    for limit in content["limits"]:
        scan = limit["scan"]
        if scan.get("amplitude", 1.0) != 1.0:
            continue
        ends = [float(limit[end]) for end in ("lower", "upper", "value") if limit[end] is not None]
        nearest = min(ends, key=abs)
        ends_of = found.setdefault(float(scan["active_damping_ns_per_m"]), {})
        ends_of[f"{AXES[scan['axis']]}{'-' if nearest < 0.0 else '+'}"] = nearest
    return tuple(
        MeasuredLevel(level, *(ends.get(end, 0.0) for end in ENDS))
        for level, ends in sorted(found.items())
    )
