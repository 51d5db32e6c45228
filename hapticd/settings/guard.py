"""Settings -> guard.json: the device model of the guard, composed once, as numbers.

The model is the whole linear device of the device file, with the effects of a live board, or the
one rigid mass of a simulated board without a model. A real device without a model has none, so
passivity is unknown. A .zwidth file is valid only for the device file, rate and filters of its
measurement; any difference is kept as the reason for its refusal.

JSON must not round numbers of the model (floats are written so that they are read back to the last
bit).
"""

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from hapticd.core.errors import ConfigError
from hapticd.core.params import (
    EnvironmentLimits,
    GuardParams,
    GuardSetup,
    MeasuredLevel,
    MeasuredParams,
    ModelParams,
    ServoParams,
)
from hapticd.core.units import COPPER_PER_K
from hapticd.model.effects import Effect, Motor, WindingTemperature
from hapticd.settings.build import device_effects, guard_params, rigid_effects
from hapticd.settings.inputs import SETTINGS_BYTES, regular
from hapticd.settings.load import Settings

__all__ = ["guard_setup"]

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
