"""Find the origin of position as the device file says; only while disabled."""

import time

from hapticd.cli import options, output
from hapticd.cli.change import connect, receipt_text
from hapticd.errors import CommandError

POLL_S = 0.05


def command(instance: options.Instance = options.INSTANCE, as_json: options.Json = False) -> None:
    """Find the origin of position as the device file says, and wait for it; only while disabled."""
    with connect(instance) as client:
        receipt = client.home()
        if not as_json:
            output.talk(receipt_text(receipt))
        while (found := client.status())["state"] == "homing":
            time.sleep(POLL_S)
    if found["state"] != "disabled":
        raise CommandError("stopped", f"home: {found['cause']}; {found['remedy']}")
    if as_json:
        output.data_json({"ok": True, "state": found["state"], "homed": bool(found.get("homed"))})
    else:
        output.data("disabled: the origin is known" if found.get("homed") else "disabled: this device needs no homing")
