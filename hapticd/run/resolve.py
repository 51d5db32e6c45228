"""Settings -> servo.json, board.json, gateway.json and guard.json in the runtime folder.

The processes start from these files alone: they read no TOML and load no pydantic.

`to_plain` and `from_plain` must preserve every parameter to the last bit.
"""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

from hapticd.core.errors import ConfigError
from hapticd.core.params import EnvironmentLimits, GatewaySetup, GuardSetup, ServoParams, to_plain
from hapticd.mailbox import files
from hapticd.mailbox.environment_limits import UNKNOWN, WIDEST, environment_limits
from hapticd.protocol.limits import CommandLimits
from hapticd.settings.build import (
    board_params,
    gateway_params,
    guard_params,
    servo_params,
)
from hapticd.settings.guard import guard_setup
from hapticd.settings.load import Settings

__all__ = ["resolve", "write"]

CONFIGURED = {
    "K": "environment.stiffness_n_per_m",
    "B": "environment.virtual_damping_ns_per_m",
    "M": "environment.mass_kg",
}
WRITTEN = (files.SERVO_JSON, files.BOARD_JSON, files.GATEWAY_JSON, files.GUARD_JSON)


def resolve(settings: Settings, instance: str) -> dict[str, Any]:
    """Return the content of each file, by its name. A real board has no board.json. ConfigError if
    the environment at start is beyond the limits for clients.
    """
    board = board_params(settings)
    unbounded = servo_params(settings, instance)
    guard = guard_setup(settings, unbounded, WIDEST)
    limits = _limits(settings, guard)
    _refuse_beyond(limits, settings, unbounded)
    servo = replace(unbounded, device=replace(unbounded.device, environment_limits=limits))
    setup = GatewaySetup(
        servo, gateway_params(settings), guard_params(settings), settings.config.lease
    )
    plain = {
        files.SERVO_JSON: to_plain(servo),
        files.GATEWAY_JSON: to_plain(setup),
        files.GUARD_JSON: to_plain(replace(guard, limits=limits)),
    }
    return plain if board is None else {**plain, files.BOARD_JSON: to_plain(board)}


def _limits(settings: Settings, guard: GuardSetup) -> EnvironmentLimits:
    """Return the limits of K, B and M for clients, from the [model] of the device file."""
    if settings.device.model is None:
        return environment_limits(UNKNOWN)
    from hapticd.guard.safe_region import ranges_of  # numpy, already loaded for the guard's model

    return environment_limits(ranges_of(guard))


def _refuse_beyond(limits: EnvironmentLimits, settings: Settings, servo: ServoParams) -> None:
    known = CommandLimits(
        servo.realtime.rate_hz, servo.device.active_damping_limit_ns_per_m, limits
    )
    environment = servo.environment
    broken = [
        f"{settings.origins[place]}: {known.complaint(axis, value, place)}"
        for axis, place in CONFIGURED.items()
        if not known.allows(axis, value := getattr(environment, place.partition(".")[2]))
    ]
    if broken:
        raise ConfigError("\n".join(broken))


def write(folder: Path, settings: Settings, instance: str) -> dict[str, Path]:
    """Write the files into `folder`, which is created and checked; return the path of each file
    written.

    Each file is written completely or not at all, and is never missing: under systemd both units
    write before they start. An old board.json is removed if the board is now real. MailboxError if
    the folder belongs to another user or is full.
    """
    files.prepare_folder(folder)
    plain = resolve(settings, instance)
    if files.BOARD_JSON not in plain:
        files.remove(folder, files.BOARD_JSON)
    texts = {name: json.dumps(content, indent=1) + "\n" for name, content in plain.items()}
    return {name: files.write_whole(folder / name, text) for name, text in texts.items()}
