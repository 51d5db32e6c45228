"""Write the flight recording of the last minute."""

import time
from pathlib import Path

from hapticd.cli import options, output
from hapticd.cli.change import connect
from hapticd.errors import HapticdError

PATIENCE_S, LOOK_S = 20.0, 0.05


def command(instance: options.Instance = options.INSTANCE, as_json: options.Json = False) -> None:
    """Write the last minute at every tick, with raw frames, to a file; as it is done at every fault. See `hapticd replay`."""
    with connect(instance) as client:
        found = client.dump()
    path, deadline = Path(found["path"]), time.monotonic() + PATIENCE_S
    while not path.exists():
        if time.monotonic() > deadline:
            raise HapticdError(f"{path} was not written within {PATIENCE_S:g} s; `hapticd status` lists the last events")
        time.sleep(LOOK_S)
    if as_json:
        output.data_json({"ok": True, **found})
    else:
        output.data(f"{path}: {found['records']} records")
