"""Find and read the files, merge the command line, validate, check the rules between fields, and
keep the origin of every value.

A configuration may only be stricter than its device, a device must be consistent, and the requested
effects must exist and fit together. All mistakes of both files are reported at once, one line each,
with file, line, value, unit and limit. Rules that do not depend on a wrong value are checked too
(`config.parsed`).

Overrides must be merged before validation (they would otherwise not be checked).
"""

import copy
import hashlib
import json
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from hapticd.core.errors import ConfigError
from hapticd.core.params import LONGEST_TIMEOUT_MS
from hapticd.core.units import COPPER_PER_K, unit_of
from hapticd.model.effects import ALWAYS, BY_KEY
from hapticd.render.winding import LEAST_LOOP_GAIN, least_residual_ohm, loop_gain, ohm
from hapticd.settings.config import (
    Config,
    Parsed,
    TomlTable,
    Where,
    concerns,
    dotted,
    leaves,
    parsed,
    validated,
)
from hapticd.settings.device import (
    FROM_SCALES,
    TABLES,
    DeviceFile,
    DeviceModel,
    ResistanceTable,
)
from hapticd.settings.toml import Document, KeyPath, did_you_mean, read, shipped
from hapticd.usb.codec import I16_HIGHEST, I16_LOWEST

__all__ = [
    "Mistake",
    "MoreRules",
    "Override",
    "Settings",
    "find_config",
    "find_device",
    "load",
    "load_device",
]

FILE_NAME = "hapticd.toml"
SYSTEM_FILE = Path("/etc/hapticd") / FILE_NAME
# times the tolerance: a back-off long enough to measure the force there (servo.homing)
SHORTEST_BACK_OFF = 8.0
HIGHEST_CORNER = 0.45  # of the servo rate: the highest permitted corner of a filter
NEEDS = {"heating": "winding"}  # an effect that modifies another one


class Mistake(NamedTuple):
    """A violated rule."""

    path: KeyPath  # of the key
    value: Any  # at that key; None to omit it from the message
    reason: str
    rests_on: tuple[KeyPath, ...] = ()  # other keys of the file that determine the limit


class MoreRules(NamedTuple):
    """Rules of a caller, in addition to those of every configuration."""

    config: Callable[[Config], Iterable[Mistake]] = lambda _config: ()
    device: Callable[[DeviceFile], Iterable[Mistake]] = lambda _device: ()


@dataclass(frozen=True)
class Override:
    """A value from the command line in place of the file's."""

    path: tuple[str, ...]  # of the key
    value: object
    origin: str  # the user's input, for messages


@dataclass(frozen=True)
class Settings:
    """A validated configuration and its device."""

    config: Config
    device: DeviceFile
    config_file: Path
    device_file: Path
    origins: Mapping[str, str]  # dotted key -> file:line, an option, or `default`
    device_file_sha256: str  # of the device file's bytes, hex

    def plain(self) -> dict[str, Any]:
        """Return everything as JSON values; the device file's content under `device`."""
        return {
            **self.config.model_dump(mode="json"),
            "device": self.device.model_dump(mode="json"),
        }

    @property
    def config_hash(self) -> str:
        """SHA-256 (hex) of the canonical JSON: equal for equal values, independent of
        their file.
        """
        return hashlib.sha256(
            json.dumps(self.plain(), sort_keys=True, separators=(",", ":")).encode()
        ).hexdigest()


def find_config(given: Path | None = None, environ: Mapping[str, str] = os.environ) -> Path:
    """Return the first existing file: --config, $HAPTICD_CONFIG, $XDG_CONFIG_HOME/hapticd/,
    /etc/hapticd/.

    Otherwise the shipped file, which selects a simulated board. ConfigError if an explicit file
    does not exist.
    """
    variable = environ.get("HAPTICD_CONFIG")
    origin = "--config" if given else "$HAPTICD_CONFIG"
    if named := given or (Path(variable) if variable else None):
        if not named.exists():
            raise ConfigError(f"{named}: no such file, named by {origin}; check the path")
        return named
    # an empty variable counts as not set, according to the XDG specification
    home = Path(environ.get("XDG_CONFIG_HOME") or Path.home() / ".config")
    places = (home / "hapticd" / FILE_NAME, SYSTEM_FILE)
    return next((path for path in places if path.is_file()), shipped("config") / FILE_NAME)


def load(
    given: Path | None = None, overrides: tuple[Override, ...] = (), also: MoreRules | None = None
) -> Settings:
    """Return the whole configuration, validated. ConfigError with one line for each mistake, by the
    rules of every configuration and by `also`.
    """
    document = read(find_config(given))
    typed: dict[KeyPath, str] = {override.path: override.origin for override in overrides}

    def in_config(path: KeyPath) -> str:
        return typed.get(path) or document.where(path)

    config = parsed(Config, _merge(document.data, overrides), in_config)
    # only now: the configuration selects the device, and the command line may override it
    file, device = _device_of(config, document.path)
    broken = _broken(config, device, also or MoreRules())
    if lines := list(filter(None, (config.errors, device.errors, *broken))):
        raise ConfigError("\n".join(lines))
    assert file is not None
    return _settings(config.sound, document, device.sound, file, typed)


def _device_of(
    config: Parsed[Config], config_file: Path
) -> tuple[Document | None, Parsed[DeviceFile]]:
    """Return the device of `config`; none if its name is wrong itself."""
    if config.table is None or concerns((("device",),), config.wrong):
        return None, Parsed(None, config.where)
    try:
        document = read(find_device(config.table.device, config_file, config.where(("device",))))
    except ConfigError as error:
        return None, Parsed(None, config.where, str(error))
    return document, parsed(DeviceFile, document.data, document.where)


def _broken(config: Parsed[Config], device: Parsed[DeviceFile], also: MoreRules) -> Iterator[str]:
    """Yield a line for every violated rule that does not depend on another mistake in its file."""
    sound = None if device.errors else device.table
    if config.table is not None:
        mistakes = [*_config_rules(config.table), *also.config(config.table)]
        if sound is not None:
            mistakes += _between_rules(config.table, sound, device.where)
        for one in mistakes:
            if not concerns((one.path, *one.rests_on), config.wrong):
                yield _line(config.where, one)
    if sound is not None:
        for one in (*_device_rules(sound), *model_rules(sound), *also.device(sound)):
            yield _line(device.where, one)


def _settings(
    config: Config,
    document: Document,
    device: DeviceFile,
    file: Document,
    typed: Mapping[KeyPath, str],
) -> Settings:
    """Return the settings with the origin of each value; `typed`: values of the command line."""
    origins = {
        dotted(path): typed.get(path) or document.origin(path)
        for path, _ in leaves(config.model_dump())
    }
    for path, _ in leaves(device.model_dump()):
        origins[dotted(("device", *path))] = file.origin(path)
    return Settings(config, device, document.path, file.path, origins, file.sha256)


def load_device(path: Path) -> DeviceFile:
    """Return the device file `path` alone, validated. ConfigError with one line for
    each mistake.
    """
    document = read(path)
    device = validated(DeviceFile, document.data, document.where)
    report((document.where, (*_device_rules(device), *model_rules(device))))
    return device


def _merge(data: dict[str, Any], overrides: tuple[Override, ...]) -> dict[str, Any]:
    # the document keeps the content of the file, for `origins`
    merged = copy.deepcopy(data)
    for override in overrides:
        table = merged
        for name in override.path[:-1]:
            table = table.setdefault(name, {}) if isinstance(table, dict) else {}
        if isinstance(table, dict):  # otherwise a value replaces a table; validation reports that
            table[override.path[-1]] = override.value
    return merged


def find_device(name: str, config_file: Path, origin: str) -> Path:
    """Return the file of the device `name`: a path relative to `config_file`, devices/NAME.toml
    next to it, or a shipped one.

    ConfigError lists the known ones; `origin` is the place of the name.
    """
    if "/" in name or name.endswith(".toml"):
        return config_file.parent / name
    folders = [config_file.parent / "devices", shipped("config") / "devices"]
    found = next(
        (folder / f"{name}.toml" for folder in folders if (folder / f"{name}.toml").is_file()), None
    )
    if found is None:
        known = sorted({file.stem for folder in folders for file in folder.glob("*.toml")})
        hint = did_you_mean(name, known)
        raise ConfigError(
            f"{origin}: device = {name!r}: no such device file{hint}; known: {', '.join(known)}"
        )
    return found


def report(*parts: tuple[Where, Iterable[Mistake]]) -> None:
    """Raise ConfigError for violated rules; each part has its own function for file and line."""
    found = [_line(where, finding) for where, findings in parts for finding in findings]
    if found:
        raise ConfigError("\n".join(found))


def _line(where: Where, mistake: Mistake) -> str:
    unit = unit_of(str(mistake.path[-1]))
    value = "" if mistake.value is None else f" = {mistake.value}"
    return (
        f"{where(mistake.path)}: {dotted(mistake.path)}{value}{f' {unit}' if unit else ''}:"
        f" {mistake.reason}"
    )


def _config_rules(config: Config) -> Iterator[Mistake]:
    """Yield contradictions within the configuration."""
    why = ": a silent board delays the end of force by as much"
    yield from _at_most(("usb", "timeout_ms"), config.usb.timeout_ms, LONGEST_TIMEOUT_MS, why)
    highest_hz = HIGHEST_CORNER * config.realtime.rate_hz
    for name in ("velocity_filter", "acceleration_filter"):
        corner_hz = getattr(config.environment, name).frequency_hz
        path = ("environment", name, "frequency_hz")
        why = f", {HIGHEST_CORNER} of realtime.rate_hz"
        yield from _at_most(path, corner_hz, highest_hz, why, (("realtime", "rate_hz"),))


def _at_most(
    path: KeyPath, value: float, limit: float, why: str, rests_on: tuple[KeyPath, ...] = ()
) -> Iterator[Mistake]:
    """Require that the value at `path` is at most `limit`; `why` follows the limit in
    the message.
    """
    if value > limit:
        reason = f"must be at most {limit} {unit_of(str(path[-1]))}{why}"
        yield Mistake(path, value, reason, rests_on)


def _between_rules(config: Config, device: DeviceFile, in_device: Where) -> Iterator[Mistake]:
    """Yield settings that exceed the device or its travel."""
    yield from _limit_rules(config, device, in_device)
    built = config.simulation.effects
    if built is not None:
        yield from chosen_rules(device, ("simulation", "effects"), built)
    margin_m = config.environment.workspace.margin_m
    travel_m = device.travel.upper_m - device.travel.lower_m
    if travel_m >= 0:  # a negative travel is a mistake of the device file
        path = ("environment", "workspace", "margin_m")
        yield from _at_most(path, margin_m, travel_m / 2, ", half of the device's travel")


def _limit_rules(config: Config, device: DeviceFile, in_device: Where) -> Iterator[Mistake]:
    def within(path: KeyPath, value: float, limit: str) -> Iterator[Mistake]:
        why = f", the limit of the device ({in_device(('limits', limit))})"
        return _at_most(path, value, getattr(device.limits, limit), why)

    safety = config.safety
    if safety.force_limit_n is not None:
        yield from within(("safety", "force_limit_n"), safety.force_limit_n, "force_n")
    if safety.energy_controller and device.limits.physical_damping_ns_per_m is None:
        source = in_device(("limits",))
        yield Mistake(
            ("safety", "energy_controller"),
            True,
            f"needs `limits.physical_damping_ns_per_m` in the device file ({source}): without it no"
            " leak is known; measure it or switch the controller off",
        )
    for path, level in (
        (("active_damping_ns_per_m",), config.active_damping_ns_per_m),
        (("safety", "safe_active_damping_ns_per_m"), safety.safe_active_damping_ns_per_m),
    ):
        yield from within(path, level, "active_damping_ns_per_m")


def _device_rules(device: DeviceFile) -> Iterator[Mistake]:
    """Yield contradictions within a device file."""
    limits = device.limits
    plant = device.plant
    for name, limit, full in (
        ("force_n", limits.force_n, device.force.full_scale_n),
        (
            "active_damping_ns_per_m",
            limits.active_damping_ns_per_m,
            device.active_damping.full_scale_ns_per_m,
        ),
        ("probe_n", limits.probe_n, device.probe_torque.full_scale_n),
    ):
        yield from _at_most(("limits", name), limit, full, ", the full scale of its converter")
    yield from _temperature_rule(device)
    skew_us = device.probe_velocity.skew_us
    if device.simulated and skew_us:
        yield Mistake(
            ("probe_velocity", "skew_us"),
            skew_us,
            "must be 0: a simulated board samples both channels of the probe together",
        )
    yield from _order_rule(("travel",), "lower_m", "upper_m", device.travel)
    if device.simulated and plant is None and device.model is None:
        yield Mistake(("plant",), None, "is missing; a simulated board needs a device to move")
    yield from _order_rule(("plant",), "lower_stop_m", "upper_stop_m", plant)
    yield from _home_rules(device)
    yield from _resistance_rules(device)


def _temperature_rule(device: DeviceFile) -> Iterator[Mistake]:
    """Require that the temperature limit is within the range of its converter."""
    scale = device.temperature.params("c_per_count")
    hottest = I16_HIGHEST if scale.sign > 0 else I16_LOWEST
    # one count before the end, so that a hotter winding still has a count
    most_c = scale.to_value(hottest - scale.sign)
    limit_c = device.limits.temperature_c
    if limit_c > most_c:
        yield Mistake(
            ("limits", "temperature_c"),
            limit_c,
            f"must be at most {most_c:.6g} degC: its converter reads no more, so a hotter winding"
            " would be no fault; correct [temperature] or lower the limit",
        )


def _home_rules(device: DeviceFile) -> Iterator[Mistake]:
    """Require that the second contact is separate from the first, and that a push is possible."""
    home = device.home
    shortest_m = SHORTEST_BACK_OFF * home.tolerance_m
    if home.back_off_m < shortest_m:
        reason = f"must be at least {shortest_m} m, {SHORTEST_BACK_OFF:g} times tolerance_m"
        yield Mistake(("home", "back_off_m"), home.back_off_m, reason)
    why = ", the limit of the device"
    yield from _at_most(("home", "force_n"), home.force_n, device.limits.force_n, why)


def _resistance_rules(device: DeviceFile) -> Iterator[Mistake]:
    """Require that the compensation never exceeds the winding, and that it can work."""
    table = device.resistance
    if table is None:
        return
    if device.simulated and (device.model is None or "heating" not in device.model.effects):
        reason = "needs a [model] with the effect 'heating'; add it or leave this table out"
        yield Mistake(("resistance",), None, reason)
    limit_c = device.limits.temperature_c
    if not table.ambient_low_c < table.ambient_high_c < limit_c:
        yield Mistake(
            ("resistance", "ambient_high_c"),
            table.ambient_high_c,
            f"must lie between ambient_low_c = {table.ambient_low_c} degC and limits.temperature_c"
            f" = {limit_c} degC",
        )
        return
    yield from _compensation_rules(table, limit_c, device.limits.active_damping_ns_per_m)


def _compensation_rules(
    table: ResistanceTable, limit_c: float, active_damping_ns_per_m: float
) -> Iterator[Mistake]:
    params = table.params()
    coldest_ohm = ohm(params, table.ambient_low_c)
    most_ohm = coldest_ohm - table.tolerance_ohm
    if table.base_ohm > most_ohm:
        yield Mistake(
            ("resistance", "base_ohm"),
            table.base_ohm,
            f"must be at most {most_ohm:.4g} ohm, tolerance_ohm less than the winding has at"
            f" {table.ambient_low_c} degC: lower it, or ambient_low_c is too low",
        )
    least = (ohm(params, limit_c) - coldest_ohm) / table.time_constant_s
    if table.slew_ohm_per_s < least:
        reason = f"must be at least {least:.3g} ohm/s, as fast as the winding cools down"
        yield Mistake(("resistance", "slew_ohm_per_s"), table.slew_ohm_per_s, reason)
    found = loop_gain(params, least_residual_ohm(params, limit_c), active_damping_ns_per_m)
    if not found >= LEAST_LOOP_GAIN:
        yield Mistake(
            ("resistance", "tolerance_ohm"),
            table.tolerance_ohm,
            f"leaves a loop gain g dR / K^2 of {found:.3g} at {active_damping_ns_per_m} N s/m when"
            f" the sensor reads too high; the limit is {LEAST_LOOP_GAIN}, the circuit latches up at"
            " -1: raise it, lower model_error or limits.active_damping_ns_per_m, or narrow the"
            " ambient",
        )


def _order_rule(
    path: tuple[str, ...], low: str, high: str, table: TomlTable | None
) -> Iterator[Mistake]:
    """Require that the field `high` of a table, if there is one, is more than the field `low`."""
    if table is not None and getattr(table, low) >= getattr(table, high):
        reason = f"must be more than {low} = {getattr(table, low)} m"
        yield Mistake((*path, high), getattr(table, high), reason)


def _winding_rule(device: DeviceFile, model: DeviceModel) -> Iterator[Mistake]:
    """Require that the compensation of a simulated winding does not latch up at maximum damping."""
    winding, motor = model.table("winding"), model.table("motor")
    if winding is None or "winding" not in model.effects:
        return
    cold_ohm = motor.resistance_ohm * COPPER_PER_K * (winding.temperature_c - winding.compensated_c)
    per_n = motor.lever_m / motor.torque_constant_nm_per_a
    per_level = cold_ohm * per_n * per_n  # a product overflows to infinity, a power raises an error
    highest = device.limits.active_damping_ns_per_m
    if per_level * highest < LEAST_LOOP_GAIN:
        yield Mistake(
            ("model", "winding", "compensated_c"),
            winding.compensated_c,
            f"leaves a loop gain g dR / K^2 of {per_level * highest:.3g} at"
            f" limits.active_damping_ns_per_m = {highest} N s/m; the limit is {LEAST_LOOP_GAIN},"
            " the circuit latches up at -1: lower it, or that limit to"
            f" {LEAST_LOOP_GAIN / per_level:.3g}",
        )


def model_rules(device: DeviceFile) -> Iterator[Mistake]:
    """Yield mistakes in the [model] of a device file."""
    model = device.model
    if model is None:
        return
    if device.plant is not None:
        yield Mistake(("plant",), None, "is there as well as [model]; keep one of them")
    yield from chosen_rules(device, ("model", "effects"), model.effects)
    yield from _winding_rule(device, model)
    for key in TABLES:
        table = model.table(key)
        for name in () if table is None else table.sources:
            if name not in type(table).model_fields:
                hint = did_you_mean(name, list(type(table).model_fields))
                yield Mistake(("model", key, "sources"), name, f"is not a key of this table{hint}")
    if model.table("coupling") is not None and model.table("masses").slider_kg == 0.0:
        yield Mistake(
            ("model", "masses", "slider_kg"),
            0.0,
            "must be more than 0.0 kg: [model.coupling] needs something to couple",
        )
    yield from _order_rule(("model", "ends"), "lower_m", "upper_m", model.table("ends"))


def chosen_rules(
    device: DeviceFile, path: tuple[str, ...], names: Sequence[str]
) -> Iterator[Mistake]:
    """Yield mistakes in the list `names` of effects to build, at `path`."""
    model = device.model
    if model is None:
        reason = f"device {device.name!r} has no [model] that effects could be taken from"
        yield Mistake(path, None, reason)
        return
    for place, name in enumerate(names):
        if name not in BY_KEY:
            hint = did_you_mean(name, list(BY_KEY))
            yield Mistake(path, name, f"is not an effect{hint}; known: {', '.join(BY_KEY)}")
        elif name in ALWAYS:
            yield Mistake(path, name, "is always built; leave it out")
        elif name in names[:place]:
            yield Mistake(path, name, "is named twice")
        elif name not in FROM_SCALES and model.table(name) is None:
            yield Mistake(
                path,
                name,
                f"device {device.name!r} has no table [model.{name}]; add it or leave the effect"
                " out",
            )
        elif name in NEEDS and NEEDS[name] not in names:
            yield Mistake(path, name, f"needs the effect {NEEDS[name]!r}; add it")
