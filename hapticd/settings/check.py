"""Rules between fields: a configuration may only be stricter than its device, and a device must agree with itself."""

from collections.abc import Iterable, Iterator

from hapticd.errors import ConfigError
from hapticd.settings.device import Device
from hapticd.settings.explain import Where, dotted
from hapticd.settings.model_rules import Finding, chosen_rules, model_rules
from hapticd.settings.models import Config
from hapticd.units import unit_of

HIGHEST_CORNER = 0.45  # of the servo rate


def check(config: Config, device: Device, in_config: Where, in_device: Where) -> None:
    """Raise ConfigError with every broken rule, one line each."""
    built = config.simulation.effects
    chosen = () if built is None else chosen_rules(device, ("simulation", "effects"), built)
    report(
        (in_config, _config_rules(config, device, in_device)),
        (in_config, chosen),
        (in_device, _device_rules(device)),
        (in_device, model_rules(device)),
    )


def report(*parts: tuple[Where, Iterable[Finding]]) -> None:
    """Raise ConfigError if any rule is broken; each part brings its own way to file and line."""
    found = [_line(where, finding) for where, findings in parts for finding in findings]
    if found:
        raise ConfigError("\n".join(found))


def _line(where: Where, finding: Finding) -> str:
    path, value, reason = finding
    unit = unit_of(path[-1])
    return f"{where(path)}: {dotted(path)}{'' if value is None else f' = {value}'}{f' {unit}' if unit else ''}: {reason}"


def _config_rules(config: Config, device: Device, in_device: Where) -> Iterator[Finding]:
    force_n, damping = device.limits.force_n, device.limits.damping_ns_per_m
    asked_n = config.safety.force_limit_n
    if asked_n is not None and asked_n > force_n:
        source = in_device(("limits", "force_n"))
        yield ("safety", "force_limit_n"), asked_n, f"must be at most {force_n} N, the limit of the device ({source})"
    levels: dict[tuple[str, ...], float] = {
        ("added_damping_ns_per_m",): config.added_damping_ns_per_m,
        ("safety", "safe_damping_ns_per_m"): config.safety.safe_damping_ns_per_m,
    }
    for path, level in levels.items():
        if level > damping:
            source = in_device(("limits", "damping_ns_per_m"))
            yield path, level, f"must be at most {damping} N s/m, the limit of the device ({source})"
    highest_hz = HIGHEST_CORNER * config.realtime.rate_hz
    for name in ("velocity_filter", "acceleration_filter"):
        corner_hz = getattr(config.environment, name).frequency_hz
        if corner_hz > highest_hz:
            reason = f"must be at most {highest_hz} Hz, {HIGHEST_CORNER} of realtime.rate_hz"
            yield ("environment", name, "frequency_hz"), corner_hz, reason
    margin_m, travel = config.environment.workspace.margin_m, device.travel
    if 2 * margin_m > travel.upper_m - travel.lower_m >= 0:
        most_m = (travel.upper_m - travel.lower_m) / 2
        yield ("environment", "workspace", "margin_m"), margin_m, f"must be at most {most_m} m, half of the device's travel"


def _device_rules(device: Device) -> Iterator[Finding]:
    limits, plant = device.limits, device.plant
    for name, limit, full in (
        ("force_n", limits.force_n, device.force.full_scale_n),
        ("damping_ns_per_m", limits.damping_ns_per_m, device.damping.full_scale_ns_per_m),
        ("probe_n", limits.probe_n, device.probe_torque.full_scale_n),
    ):
        if limit > full:
            yield ("limits", name), limit, f"must be at most {full} {unit_of(name)}, the full scale of its converter"
    if device.travel.lower_m >= device.travel.upper_m:
        yield ("travel", "upper_m"), device.travel.upper_m, f"must be more than lower_m = {device.travel.lower_m} m"
    if device.simulated and plant is None and device.model is None:
        yield ("plant",), None, "is missing; a simulated board needs to know what it moves"
    if plant and plant.lower_stop_m >= plant.upper_stop_m:
        yield ("plant", "upper_stop_m"), plant.upper_stop_m, f"must be more than lower_stop_m = {plant.lower_stop_m} m"
