"""All checks in the order in which a person reads them."""

from collections.abc import Callable

from hapticd.doctor import folders, kernel, processor, rights, usb
from hapticd.doctor.asked import Asked
from hapticd.doctor.finding import Finding
from hapticd.doctor.machine import Machine

Check = Callable[[Machine, Asked], Finding]
CHECKS: tuple[Check, ...] = (*rights.CHECKS, *processor.CHECKS, *kernel.CHECKS, *usb.CHECKS, *folders.CHECKS)


def examine(machine: Machine, asked: Asked) -> list[Finding]:
    """One finding per check; nothing is measured and nothing is changed."""
    return [check(machine, asked) for check in CHECKS]
