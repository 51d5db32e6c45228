"""Actions of a case on its machine: plug and unplug the board, grant and revoke rights, run
commands as other users and in a private network.
"""

import json
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Self

from hapticd.core.params import UsbParams
from hapticd.run.system_files import system_files

VHCI = Path("/sys/devices/platform/vhci_hcd.0")
DEVICES = Path("/sys/bus/usb/devices")
RULES = Path("/run/udev/rules.d/70-hapticd.rules")
UDEVD = "/lib/systemd/systemd-udevd"
HERE = Path(__file__).parent
LOOK = [sys.executable, str(HERE / "looker.py")]
DEADLINE_S = 60.0
GROUP = 60001  # hapticd, created by `init`
UIDS = {"bob": 60002, "alice": 60003}
GROUPS = {"bob": "60002,60001", "alice": "60003"}


def until(condition: Callable[[], Any], what: str) -> Any:
    """The first true value of `condition`."""
    deadline = time.monotonic() + DEADLINE_S
    while not (found := condition()):
        assert time.monotonic() < deadline, f"never: {what}"
        time.sleep(0.01)
    return found


def place() -> Path | None:
    """Where the kernel has the board."""
    for vendor in DEVICES.glob("*/idVendor"):
        try:
            if vendor.read_text().strip() == "1209":
                return vendor.parent
        except OSError:
            continue  # it has left
    return None


class Board:
    """A board process, and the cable between it and this kernel."""

    def __init__(self, *words: str) -> None:
        command = [sys.executable, str(HERE / "board_process.py"), *words]
        self.process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        self.address: str = self.reply()

    def reply(self) -> Any:
        assert self.process.stdout is not None
        return json.loads(self.process.stdout.readline())

    def __call__(self, words: str) -> Any:
        """Send a command to the process (board_process.py)."""
        assert self.process.stdin is not None
        self.process.stdin.write(words + "\n")
        self.process.stdin.flush()
        return self.reply()

    def plug(self) -> Path:
        """Plug the board in; return its place in the kernel."""
        attach(self.address)
        return until(lambda: (found := place()) and configured(found), "the board at the bus")

    def unplug(self) -> None:
        """Pull the cable, also during a transfer."""
        if place() is not None:
            self("pull")
            until(lambda: place() is None, "the board has left the bus")

    def end(self) -> None:
        self.unplug()
        assert self.process.stdin is not None
        self.process.communicate(timeout=DEADLINE_S)
        assert self.process.returncode == 0


def configured(found: Path) -> Path | None:
    """`found` once the kernel has made its interface."""
    return found if list(found.glob("*:1.0/bInterfaceClass")) else None


def attach(address: str) -> None:
    """By the kernel's own tool."""
    host, _, port = address.rpartition(":")
    words = ["usbip", "--tcp-port", port, "attach", "-r", host, "-b", "1-1"]
    done = subprocess.run(words, capture_output=True, text=True, timeout=DEADLINE_S)
    assert done.returncode == 0, done.stderr


class Looker:
    """Another process with its own link (looker.py), with the command modified by `around`."""

    def __init__(self, around: Callable[[Sequence[str]], list[str]] = list) -> None:
        self.process = subprocess.Popen(
            around(LOOK), stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )

    def look(self) -> str:
        """Open the board and greet it: its serial number, or why not. It stays open."""
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        print(file=self.process.stdin, flush=True)
        return self.process.stdout.readline().strip()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.process.communicate(timeout=DEADLINE_S)


_udevd: list["subprocess.Popen[bytes]"] = []


def have_udev(wanted: bool) -> None:
    """udevd with the rule that `hapticd install-system` writes, or none."""
    if wanted and not _udevd:
        RULES.write_text(system_files(UsbParams())["etc/udev/rules.d/70-hapticd.rules"])
        _udevd.append(subprocess.Popen([UDEVD], stderr=subprocess.DEVNULL))
        ping = ["udevadm", "control", "--ping"]
        until(lambda: subprocess.run(ping, capture_output=True).returncode == 0, "udevd")
    elif _udevd and not wanted:
        udevd = _udevd.pop()
        udevd.terminate()
        udevd.wait(DEADLINE_S)


def as_person(name: str) -> Callable[[Sequence[str]], list[str]]:
    """Return a function that makes a command run as bob or alice."""
    uid = str(UIDS[name])
    rights = ["setpriv", "--reuid", uid, "--regid", uid, "--groups", GROUPS[name]]
    # the checkout may be in a home that only root enters; the board has to be writable as well
    rights += ["--inh-caps=+dac_read_search", "--ambient-caps=+dac_read_search"]
    return lambda words: [*rights, *words]


def in_own_network(words: Sequence[str]) -> list[str]:
    """Return the command that runs `words` with a loopback interface only, as
    PrivateNetwork= does.
    """
    return ["unshare", "--net", "sh", "-c", 'ip link set lo up; exec "$@"', "sh", *words]
