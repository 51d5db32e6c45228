"""Settings -> servo.json, board.json, gateway.json and guard.json in the runtime folder.

The processes start from these files alone: they read no TOML and load no pydantic.

What would break it: a parameter that `to_plain` and `from_plain` do not carry to the last bit.
"""

import json
from pathlib import Path
from typing import Any

from hapticd.mailbox import files
from hapticd.mailbox.layout import VALUE_LIMITS, Value
from hapticd.params import GatewaySetup, to_plain
from hapticd.settings.build import (
    board_params,
    gateway_params,
    guard_params,
    lease_params,
    servo_params,
)
from hapticd.settings.guard import guard_setup
from hapticd.settings.load import Settings

KBM = (Value.STIFFNESS, Value.DAMPING, Value.MASS)
WRITTEN = (files.SERVO_JSON, files.BOARD_JSON, files.GATEWAY_JSON, files.GUARD_JSON)


def resolve(settings: Settings, instance: str) -> dict[str, Any]:
    """Content of each file, by its name. A real board has no board.json."""
    board = board_params(settings)
    servo = servo_params(settings, instance)
    setup = GatewaySetup(
        servo, gateway_params(settings), guard_params(settings), lease_params(settings)
    )
    lowest, highest, _units = zip(*(VALUE_LIMITS[place] for place in KBM), strict=True)
    plain = {
        files.SERVO_JSON: to_plain(servo),
        files.GATEWAY_JSON: to_plain(setup),
        files.GUARD_JSON: to_plain(guard_setup(settings, servo, lowest, highest)),
    }
    return plain if board is None else {**plain, files.BOARD_JSON: to_plain(board)}


def write(folder: Path, settings: Settings, instance: str) -> dict[str, Path]:
    """Write the files into `folder`, which is made and checked; the path of each file written.

    Each file is written whole or not at all, and is never missing for a moment: under systemd both
    units write before they start. A board.json from before is removed if the board is real now.
    MailboxError if the folder belongs to somebody else or is full.
    """
    files.prepare_folder(folder)
    plain = resolve(settings, instance)
    if files.BOARD_JSON not in plain:
        files.remove(folder, files.BOARD_JSON)
    texts = {name: json.dumps(content, indent=1) + "\n" for name, content in plain.items()}
    return {name: files.write_whole(folder / name, text) for name, text in texts.items()}
