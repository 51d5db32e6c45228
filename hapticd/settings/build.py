"""Settings -> the parameters of the processes.

The only module that turns full scales into values per count.
"""

from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Any

from hapticd.core.environment import Environment, FilterParams, WallParams, WorkspaceParams
from hapticd.core.params import DeviceParams, GatewayParams, GuardParams, ServoParams, UsbParams
from hapticd.model.effects import Effect
from hapticd.model.params import BoardParams, BoardTraits
from hapticd.model.scene import converter_effects, rigid_body, smoothing_hz, timing_of
from hapticd.settings.config import RENDERED, EnvironmentTable, SimulatedBoard
from hapticd.settings.device import DeviceFile, Travel, effects_of, signs_hash
from hapticd.settings.load import Settings
from hapticd.usb.codec import I16_HIGHEST, U16_HIGHEST

__all__ = [
    "board_of",
    "board_params",
    "commissioning",
    "device_effects",
    "device_params",
    "gateway_params",
    "guard_params",
    "rigid_effects",
    "servo_params",
]

# fields of BoardParams: the field of [simulation.board] that replaces it, and its full count
FULL_SCALES = {
    "position_m_per_count": ("position_m_per_count", 1),
    "force_n_per_count": ("force_full_scale_n", I16_HIGHEST),
    "active_damping_ns_per_m_per_count": ("damping_full_scale_ns_per_m", U16_HIGHEST),
    "probe_torque_n_per_count": ("probe_torque_full_scale_n", I16_HIGHEST),
    "probe_velocity_m_per_s_per_count": ("probe_velocity_full_scale_m_per_s", I16_HIGHEST),
    "current_a_per_count": ("current_full_scale_a", I16_HIGHEST),
    "voltage_v_per_count": ("voltage_full_scale_v", I16_HIGHEST),
}
OVERSPEED = 0.7  # of the speed that counts as a sensor fault: see servo.safety


def servo_params(settings: Settings, instance: str) -> ServoParams:
    """Return the parameters of servo.json."""
    config = settings.config
    device = settings.device
    return ServoParams(
        instance=instance,
        simulated=device.simulated,
        environment=environment_params(settings.config.environment, settings.device.travel),
        device=replace(
            device_params(device),
            force_smoothing_hz=smoothing_hz(device_effects(device, config.simulation.effects)),
        ),
        safety=config.safety,
        realtime=config.realtime,
        usb=UsbParams(**asdict(config.usb), serial=device.serial),
        active_damping_ns_per_m=config.active_damping_ns_per_m,
        config_hash=settings.config_hash,
        device_file=str(settings.device_file.absolute()),
        device_file_sha256=settings.device_file_sha256,
    )


def board_params(settings: Settings) -> BoardParams | None:
    """Return the parameters of board.json; None for a real board. Its nominal scales are those of
    the device file.
    """
    device = settings.device
    simulation = settings.config.simulation
    if not device.simulated:
        return None
    built = device_effects(device, simulation.effects)
    phase, lag_periods = timing_of(built)
    board = board_of(
        device,
        settings.config.realtime.rate_hz,
        built,
        (
            settings.config.active_damping_ns_per_m,
            settings.config.safety.safe_active_damping_ns_per_m,
        ),
        sample_phase=phase if simulation.sample_phase is None else simulation.sample_phase,
        lag_periods=lag_periods if simulation.sample_phase is None else 0,
        **{trait.name: getattr(simulation, trait.name) for trait in fields(BoardTraits)},
    )
    return replace(board, **_another_board(simulation.board))


def _another_board(asked: SimulatedBoard) -> dict[str, Any]:
    """Return the fields of BoardParams in which the board differs from its device file."""
    named = {
        "hello_serial": asked.serial,
        "lacks": asked.lacks,
        "force_limit_n": asked.force_limit_n,
    }
    scales = {
        field: None if (full := getattr(asked, name)) is None else full / count
        for field, (name, count) in FULL_SCALES.items()
    }
    return {field: value for field, value in (named | scales).items() if value is not None}


def device_effects(device: DeviceFile, names: tuple[str, ...] | None = None) -> tuple[Effect, ...]:
    """Return the effects of a simulated device: `names`, by default those of its file.

    A device of one rigid mass has none.
    """
    model = device.model
    if model is None:
        return ()
    return effects_of(
        model, model.effects if names is None else names, converter_effects(device_params(device))
    )


def rigid_effects(device: DeviceFile) -> tuple[Effect, ...]:
    """Return the effects of a simulated board with one rigid mass, latched at the default phase;
    none for a device with a model or with neither.
    """
    if device.plant is None:
        return ()
    return rigid_body(
        device_params(device), **device.plant.model_dump(exclude={"ambient_c", "source"})
    )


def board_of(
    device: DeviceFile,
    rate_hz: float,
    effects: tuple[Effect, ...],
    exact_levels: tuple[float, ...],
    **firmware: Any,
) -> BoardParams:
    """Return the simulated board of `device` with these effects, or with the rigid mass of [plant].
    `exact_levels` [Ns/m] of active damping are exact, others interpolated. `firmware` are the last
    fields of BoardParams.
    """
    scales = device_params(device)
    moved = (
        _composed(device, rate_hz, effects, exact_levels)
        if device.plant is None
        else device.plant.model_dump(exclude={"source"})
    )
    return BoardParams(
        serial=device.serial,
        rate_hz=rate_hz,
        position_m_per_count=scales.position.per_count,
        force_n_per_count=scales.force.per_count,
        active_damping_ns_per_m_per_count=scales.active_damping.per_count,
        probe_torque_n_per_count=scales.probe_torque.per_count,
        probe_velocity_m_per_s_per_count=scales.probe_velocity.per_count,
        current_a_per_count=scales.current.per_count,
        voltage_v_per_count=scales.voltage.per_count,
        emf_velocity_m_per_s_per_count=scales.emf_velocity.per_count,
        temperature_c_per_count=scales.temperature.per_count,
        force_limit_n=device.limits.force_n,
        trim_full_scale_ohm=_trim_ohm(device),
        **moved,
        **firmware,
    )


def _composed(
    device: DeviceFile, rate_hz: float, effects: tuple[Effect, ...], exact_levels: tuple[float, ...]
) -> dict[str, Any]:
    from hapticd.model.compose import board_fields, compose_device, refuse_unstable

    model = compose_device(device.name, effects, rate_hz)
    refuse_unstable(model, (0.0, *exact_levels))
    highest_ns_per_m = device.limits.active_damping_ns_per_m
    return board_fields(model, exact_levels, highest_ns_per_m, abs(_trim_ohm(device)))


def _trim_ohm(device: DeviceFile) -> float:
    """Return the ohm of the resistance DAC at its full count, with its sign; 0 without one."""
    table = device.resistance
    return 0.0 if table is None else table.sign * table.full_scale_ohm


def gateway_params(settings: Settings) -> GatewayParams:
    """Return the parameters of gateway.json. A relative key folder is next to the configuration
    file.
    """
    gateway = settings.config.gateway
    if gateway.curve_keys is None:
        return gateway
    return replace(gateway, curve_keys=str(_beside(settings, gateway.curve_keys)))


def guard_params(settings: Settings) -> GuardParams:
    """Return the guard of gateway.json and guard.json, with the default policy of this device."""
    asked = settings.config.guard
    device = settings.device
    cautious = not device.simulated and device.model is not None
    return GuardParams(
        policy=asked.policy or ("refuse" if cautious else "warn"),
        basis=asked.basis,
        measured="" if asked.measured is None else str(_beside(settings, asked.measured)),
        margin_ns_per_m=asked.margin_ns_per_m,
    )


def _beside(settings: Settings, name: str) -> Path:
    """Return the file `name`, relative to the folder of the configuration file."""
    return (settings.config_file.parent / Path(name)).absolute()


def device_params(device: DeviceFile) -> DeviceParams:
    """Return scales per count and limits of a device file."""
    limits = device.limits
    return DeviceParams(
        name=device.name,
        serial=device.serial,
        position=device.position.params("m_per_count"),
        force=device.force.params("full_scale_n", I16_HIGHEST),
        active_damping=device.active_damping.params("full_scale_ns_per_m", U16_HIGHEST),
        probe_torque=device.probe_torque.params("full_scale_n", I16_HIGHEST),
        probe_velocity=device.probe_velocity.params("full_scale_m_per_s", I16_HIGHEST),
        active_damping_with_force_n=device.active_damping.with_force_full_scale_n or 0.0,
        probe_skew_us=device.probe_velocity.skew_us,
        current=device.current.params("full_scale_a", I16_HIGHEST),
        voltage=device.voltage.params("full_scale_v", I16_HIGHEST),
        emf_velocity=device.emf_velocity.params("full_scale_m_per_s", I16_HIGHEST),
        temperature=device.temperature.params("c_per_count"),
        force_limit_n=limits.force_n,
        active_damping_limit_ns_per_m=limits.active_damping_ns_per_m,
        probe_limit_n=limits.probe_n,
        temperature_limit_c=limits.temperature_c,
        force_step_n=limits.force_step_n,
        ramp_energy_j=limits.ramp_energy_j,
        acceleration_limit_m_per_s2=limits.acceleration_m_per_s2,
        speed_limit_m_per_s=limits.speed_m_per_s,
        overspeed_m_per_s=limits.overspeed_m_per_s or OVERSPEED * limits.speed_m_per_s,
        physical_damping_ns_per_m=limits.physical_damping_ns_per_m,
        energy_limit_j=limits.energy_j,
        home=device.home,
        relies_on=device.relies_on,
        resistance=None if device.resistance is None else device.resistance.params(),
        **_motor(device),
        commissioning=commissioning(device),
        signs_firmware=_signs_firmware(device),
        calibration_days=device.calibration_days,
    )


def commissioning(device: DeviceFile) -> bool:
    """Return whether the signs of `device` are not yet verified with this board."""
    table = device.commissioning
    if table is None:
        return not device.simulated
    seen = signs_hash(table.serial, table.firmware, device.force.sign, device.position.sign)
    return not table.signs_verified or table.serial != device.serial or table.signs != seen


def _signs_firmware(device: DeviceFile) -> str:
    """Return the firmware required by the verified signs; "": any."""
    table = device.commissioning
    return "" if table is None or commissioning(device) else table.firmware


def _motor(device: DeviceFile) -> dict[str, Any]:
    """Return the motor's parameters from the device file: measured, from the compensation,
    simulated, or the defaults of homing.
    """
    if measured := device.motor:
        found = _winding(measured.force_n_per_a, measured.winding_ohm, measured.reference_c)
        return found | {"motor_lever_m": measured.lever_m or 1.0}
    if known := device.resistance:
        return _winding(known.force_n_per_a, known.winding_ohm, known.reference_c)
    if plant := device.plant:
        return _winding(plant.torque_constant_n_per_a, plant.winding_ohm, plant.ambient_c)
    motor = device.model.table("motor") if device.model else None
    # a real device's model may contain a motor that was not measured
    if motor is not None and (device.simulated or motor.source != "inferred"):
        force_n_per_a = motor.torque_constant_nm_per_a / motor.lever_m
        return _winding(force_n_per_a, motor.resistance_ohm, motor.reference_c)
    return {"motor_n_per_a": device.home.current_n_per_a}


def _winding(force_n_per_a: float, resistance_ohm: float, reference_c: float) -> dict[str, float]:
    return {
        "motor_n_per_a": force_n_per_a,
        "winding_ohm": resistance_ohm,
        "winding_reference_c": reference_c,
    }


def environment_params(asked: EnvironmentTable, travel: Travel) -> Environment:
    """Return the rendered environment, with the soft ends inside the device's travel."""
    ends = asked.workspace
    return Environment(
        **{path: getattr(asked, path) for path in RENDERED},
        velocity_filter=FilterParams(**asked.velocity_filter.model_dump()),
        acceleration_filter=FilterParams(**asked.acceleration_filter.model_dump()),
        wall=WallParams(**asked.wall.model_dump()),
        workspace=WorkspaceParams(
            travel.lower_m + ends.margin_m, travel.upper_m - ends.margin_m, ends.stiffness_n_per_m
        ),
    )
