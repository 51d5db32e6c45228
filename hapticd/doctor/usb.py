"""The board on the bus: is it there, may we open it, does it stay awake. A simulated board needs none of it."""

from pathlib import Path

from hapticd.doctor.asked import Asked
from hapticd.doctor.finding import Finding, fail, ok, warn
from hapticd.doctor.machine import Machine
from hapticd.doctor.rights import INSTALL, JOIN

RULES = ("etc/udev/rules.d", "usr/lib/udev/rules.d", "lib/udev/rules.d", "run/udev/rules.d")
SIMULATED = "the configured board is simulated"
ABSENT = "no board to look at"


def board_path(machine: Machine, asked: Asked) -> Path | None:
    """Folder of the configured board in sysfs; None if it is not on the bus."""
    for path in machine.find("sys/bus/usb/devices/*"):
        found = [machine.text(str(path.relative_to(machine.root) / name)) for name in ("idVendor", "idProduct", "serial")]
        if found[:2] == asked.board.split(":") and asked.usb.serial in (None, found[2]):
            return path
    return None


def board(machine: Machine, asked: Asked) -> Finding:
    """The configured board is on the bus."""
    name, path = "USB board", board_path(machine, asked)
    if asked.simulated:
        return ok(name, SIMULATED)
    if path is not None:
        return ok(name, f"{asked.board} at {path.name}")
    serial = f" with serial {asked.usb.serial}" if asked.usb.serial else ""
    fix = f"plug it in and switch it on (lsusb -d {asked.board}); ids: usb.vendor_id and usb.product_id, serial: device file"
    return fail(name, f"no {asked.board}{serial} on the bus", "the servo waits for it and renders nothing", fix)


def permission(machine: Machine, asked: Asked) -> Finding:
    """This user may open it."""
    name, path = "USB permission", board_path(machine, asked)
    if asked.simulated or path is None:
        return ok(name, SIMULATED if asked.simulated else ABSENT)
    place = str(path.relative_to(machine.root))
    bus, device = (machine.number(f"{place}/{part}") or 0 for part in ("busnum", "devnum"))
    node = f"dev/bus/usb/{bus:03}/{device:03}"
    if machine.may_write(machine.root / node):
        return ok(name, f"/{node} may be opened")
    fix = f"{INSTALL} (udev rule), sudo udevadm control --reload && sudo udevadm trigger; {JOIN}"
    return fail(name, f"/{node} may not be opened", "the servo cannot talk to the board", fix)


def autosuspend(machine: Machine, asked: Asked) -> Finding:
    """It does not fall asleep while the servo pauses."""
    name, path = "USB autosuspend", board_path(machine, asked)
    if asked.simulated or path is None:
        return ok(name, SIMULATED if asked.simulated else ABSENT)
    control = f"{path.relative_to(machine.root)}/power/control"
    if machine.text(control) != "auto":
        return ok(name, "off for the board")
    why = "the board falls asleep while no one talks to it, and takes milliseconds to come back"
    return warn(name, "on for the board", why, f"echo on | sudo tee /{control}; for good: {INSTALL} (udev rule)")


def udev_rule(machine: Machine, asked: Asked) -> Finding:
    """The rule that gives the board to group hapticd, for the configured ids."""
    name = "udev rule"
    found = [path for folder in RULES for path in machine.find(f"{folder}/*hapticd*.rules")]
    vendor, product = asked.board.split(":")
    if any(vendor in (text := path.read_text()) and product in text for path in found):
        return ok(name, f"/{found[0].relative_to(machine.root)}")
    if asked.simulated:
        return ok(name, SIMULATED)
    shown = f"/{found[0].relative_to(machine.root)} names another board" if found else "none for hapticd"
    return warn(
        name,
        shown,
        "the board belongs to root when it is plugged in",
        f"{INSTALL}, sudo udevadm control --reload && sudo udevadm trigger",
    )


CHECKS = (board, permission, autosuspend, udev_rule)
