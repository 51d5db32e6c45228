"""Settings -> the parameters that the processes read. The only place that turns full scales into values per count."""

from pathlib import Path

from hapticd.params import (
    BoardParams,
    DeviceParams,
    EnvironmentParams,
    FilterParams,
    GatewayParams,
    HomeParams,
    InjectionParams,
    RealtimeParams,
    SafetyParams,
    ServoParams,
    UsbParams,
    WallParams,
    WorkspaceParams,
)
from hapticd.settings.device import SIGNED_FULL_COUNT, UNSIGNED_FULL_COUNT, Device
from hapticd.settings.load import Settings


def servo_params(settings: Settings, instance: str) -> ServoParams:
    """servo.json"""
    config, device = settings.config, settings.device
    safety = config.safety.model_dump()
    safety["force_limit_n"] = config.safety.force_limit_n or device.limits.force_n
    return ServoParams(
        instance=instance,
        simulated=device.simulated,
        environment=_environment(settings),
        device=device_params(device),
        safety=SafetyParams(**safety),
        realtime=RealtimeParams(**config.realtime.model_dump()),
        usb=UsbParams(**config.usb.model_dump(), serial=device.serial),
        added_damping_ns_per_m=config.added_damping_ns_per_m,
        config_hash=settings.config_hash,
    )


def board_params(settings: Settings) -> BoardParams | None:
    """board.json; None for a real board. Its nominal scales are those of the device file."""
    device, simulation = settings.device, settings.config.simulation
    if not device.simulated or device.plant is None:
        return None
    scales = device_params(device)
    return BoardParams(
        serial=device.serial,
        rate_hz=settings.config.realtime.rate_hz,
        position_m_per_count=scales.position.per_count,
        force_n_per_count=scales.force.per_count,
        damping_ns_per_m_per_count=scales.damping.per_count,
        probe_torque_n_per_count=scales.probe_torque.per_count,
        probe_velocity_m_per_s_per_count=scales.probe_velocity.per_count,
        current_a_per_count=scales.current.per_count,
        voltage_v_per_count=scales.voltage.per_count,
        emf_velocity_m_per_s_per_count=scales.emf_velocity.per_count,
        temperature_c_per_count=scales.temperature.per_count,
        force_limit_n=device.limits.force_n,
        **device.plant.model_dump(exclude={"source"}),
        sample_phase=simulation.sample_phase,
        watchdog_ms=simulation.watchdog_ms,
        seed=simulation.seed,
        injections=tuple(InjectionParams(**item.model_dump()) for item in simulation.injections),
    )


def gateway_params(settings: Settings) -> GatewayParams:
    """gateway.json. A relative key folder is meant beside the configuration file."""
    plain = settings.config.gateway.model_dump()
    if plain["curve_keys"] is not None:
        plain["curve_keys"] = str((settings.config_file.parent / Path(plain["curve_keys"])).absolute())
    return GatewayParams(**plain)


def device_params(device: Device) -> DeviceParams:
    """Scales per count and limits of a device file."""
    limits = device.limits
    return DeviceParams(
        name=device.name,
        serial=device.serial,
        position=device.position.params(device.position.m_per_count),
        force=device.force.params(device.force.full_scale_n / SIGNED_FULL_COUNT),
        damping=device.damping.params(device.damping.full_scale_ns_per_m / UNSIGNED_FULL_COUNT),
        probe_torque=device.probe_torque.params(device.probe_torque.full_scale_n / SIGNED_FULL_COUNT),
        probe_velocity=device.probe_velocity.params(device.probe_velocity.full_scale_m_per_s / SIGNED_FULL_COUNT),
        current=device.current.params(device.current.full_scale_a / SIGNED_FULL_COUNT),
        voltage=device.voltage.params(device.voltage.full_scale_v / SIGNED_FULL_COUNT),
        emf_velocity=device.emf_velocity.params(device.emf_velocity.full_scale_m_per_s / SIGNED_FULL_COUNT),
        temperature=device.temperature.params(device.temperature.c_per_count),
        force_limit_n=limits.force_n,
        damping_limit_ns_per_m=limits.damping_ns_per_m,
        probe_limit_n=limits.probe_n,
        temperature_limit_c=limits.temperature_c,
        speed_limit_m_per_s=limits.speed_m_per_s,
        home=HomeParams(**device.home.model_dump()),
    )


def _environment(settings: Settings) -> EnvironmentParams:
    asked, travel = settings.config.environment, settings.device.travel
    ends = asked.workspace
    return EnvironmentParams(
        stiffness_n_per_m=asked.stiffness_n_per_m,
        damping_ns_per_m=asked.damping_ns_per_m,
        mass_kg=asked.mass_kg,
        velocity_filter=FilterParams(**asked.velocity_filter.model_dump()),
        acceleration_filter=FilterParams(**asked.acceleration_filter.model_dump()),
        wall=WallParams(**asked.wall.model_dump()),
        workspace=WorkspaceParams(travel.lower_m + ends.margin_m, travel.upper_m - ends.margin_m, ends.stiffness_n_per_m),
    )
