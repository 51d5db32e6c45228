"""Settings -> the JSON files that the two processes start from, in the runtime folder."""

import json
from pathlib import Path
from typing import Any

from hapticd.mailbox import files
from hapticd.params import GatewaySetup, to_plain
from hapticd.settings.build import board_params, gateway_params, servo_params
from hapticd.settings.load import Settings


def resolve(settings: Settings, instance: str) -> dict[str, Any]:
    """Content of each file by name; no board.json for a real board."""
    board = board_params(settings)
    servo = servo_params(settings, instance)
    setup = GatewaySetup(servo, gateway_params(settings))
    plain = {files.SERVO_JSON: to_plain(servo), files.GATEWAY_JSON: to_plain(setup)}
    return plain if board is None else {**plain, files.BOARD_JSON: to_plain(board)}


def write(folder: Path, settings: Settings, instance: str) -> dict[str, Path]:
    """Write them into `folder` (made and checked), each whole or not at all; a board.json that is
    not meant any more is removed.

    Under systemd both units do so before they start; a file that is meant is never missing for a
    moment. Returns the path of each file written. Raises MailboxError when the folder is not ours
    or full.
    """
    files.prepare_folder(folder)
    plain = resolve(settings, instance)
    if files.BOARD_JSON not in plain:
        files.remove(folder, files.BOARD_JSON)
    texts = {name: json.dumps(content, indent=1) + "\n" for name, content in plain.items()}
    return {name: files.write_whole(folder / name, text) for name, text in texts.items()}
