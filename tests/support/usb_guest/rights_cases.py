"""Access to the board: late plugs, udev's rule, other owners, the kernel's own drivers. Run by
`make test-usb` in a user-mode kernel (tests/acceptance/test_usb_stack.py).
"""

import stat
from pathlib import Path

import pytest
from conftest import OURS
from machine import GROUP, Board, Looker, as_person, have_udev, in_own_network, place, until
from packets import answers, opens

from hapticd.core.errors import LinkAccess
from hapticd.usb.link import UsbLink


def test_rule_gives_the_board_to_the_group_and_to_nobody_else(board: Board) -> None:
    node = until(device_node, "a device node of the group")
    assert stat.S_IMODE(node.stat().st_mode) == 0o660
    with Looker(as_person("bob")) as bob:
        assert bob.look() == "SIM0001"
    with Looker(as_person("alice")) as alice:
        denied = alice.look()
    assert denied.startswith("LinkAccess: ")
    assert "errno 13" in denied
    assert "hapticd install-system" in denied
    assert "group hapticd" in denied
    at = place()
    assert at is not None
    assert (at / "power" / "control").read_text() == "on\n"


def device_node() -> Path | None:
    """Return the node of the board, once udevd has set its group."""
    at = place()
    if at is None:
        return None
    numbers = [int((at / name).read_text()) for name in ("busnum", "devnum")]
    node = Path("/dev/bus/usb/{:03}/{:03}".format(*numbers))
    return node if node.exists() and node.stat().st_gid == GROUP else None


def test_second_process_is_refused_and_told_why(board: Board, link: UsbLink) -> None:
    with Looker() as other:
        refused = other.look()
        assert refused.startswith("LinkAccess: ")
        assert "another program has claimed the board" in refused
        link.close()
        assert other.look() == "SIM0001"


def test_board_that_is_not_authorized_is_refused_with_the_remedy(board: Board) -> None:
    at = place()
    assert at is not None
    (at / "authorized").write_text("0")
    with pytest.raises(LinkAccess, match=r"de-authorized.*write 1 into its `authorized`"):
        UsbLink(OURS).open()
    (at / "authorized").write_text("1")
    link = UsbLink(OURS)
    until(lambda: opens(link), "the board again")
    link.close()


SURROUNDINGS = {
    "udevd": (True, False),
    "no-udevd": (False, False),
    "private-network": (True, True),
    "no-udevd-and-private-network": (False, True),
}


@pytest.mark.parametrize("where", SURROUNDINGS)
def test_board_that_is_plugged_in_late_and_again_is_found(where: str, any_board: Board) -> None:
    """libusb learns of devices from udevd's messages; those do not reach a private network."""
    with_udev, own_network = SURROUNDINGS[where]
    have_udev(with_udev)
    with Looker(in_own_network if own_network else list) as other:
        assert "no board 1209:0001 with serial SIM0001 at the bus" in other.look()
        for _ in range(2):
            any_board.plug()
            until(lambda: other.look() == "SIM0001", "the board that was plugged in")
            any_board.unplug()
            until(lambda: "no board" in other.look(), "the board that was unplugged")


def test_driver_of_the_kernel_gives_the_board_up(board: Board) -> None:
    """The last case: a change to the kernel's driver cannot be undone."""
    Path("/sys/bus/usb-serial/drivers/generic/new_id").write_text("1209 0001\n")
    at = place()
    assert at is not None
    interface = next(at.glob("*:1.0"))
    until((interface / "driver").exists, "the kernel's driver has the board")
    link = UsbLink(OURS)
    link.open()
    assert (interface / "driver").resolve().name == "usbfs"
    assert answers(link)
    link.close()
