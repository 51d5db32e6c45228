"""The image of the Pico, in the emulator, at a true Linux USB stack in a user-mode kernel: it is
enumerated there, answers in order, leaves the bus when its processor hangs, and is found again.

The chip follows the machine's clock as well as it can, so nothing here says how long anything took.
"""

import json
import re
import shlex
import sys
from typing import Any

import pytest
from support.pico_chip import UNIQUE_ID
from support.pico_firmware import image
from support.pico_modules import modules
from support.tree import TESTS
from support.usb_kernel import kernel
from support.usb_machine import run

LIMIT_S = 300.0
FRAMES = 300

# the first of them also waits for the kernel's build
pytestmark = [pytest.mark.process, pytest.mark.timeout(1500)]


@pytest.fixture(scope="module")
def told() -> dict[str, Any]:
    guest = TESTS / "support" / "usb_guest"
    case = shlex.join([sys.executable, str(guest / "pico_case.py"), str(image())])
    path = f"PYTHONPATH={TESTS.parent}:{TESTS}:{guest}"
    outcome = run(kernel(), f"{path} HAPTICD_NODE_MODULES={modules()} {case}", LIMIT_S)
    found = re.search(r"^GUEST-PICO (.*)$", outcome.text, re.MULTILINE)
    assert found, outcome.text
    return dict(json.loads(found[1]))


def test_kernel_enumerates_the_board(told: dict[str, Any]) -> None:
    assert (told["speed"], told["serial"], told["manufacturer"]) == ("12", UNIQUE_ID, "hapticd")


@pytest.mark.parametrize("way", ["in_turn", "in_flight"])
def test_every_frame_is_answered_in_order(way: str, told: dict[str, Any]) -> None:
    assert told[way]["serial"] == UNIQUE_ID
    assert told[way]["in_order"] == FRAMES


def test_board_that_hangs_leaves_the_bus_and_is_found_again(told: dict[str, Any]) -> None:
    assert told["lost"]
    assert told["again"]["in_order"] == FRAMES


def test_chip_forgives_all_of_it(told: dict[str, Any]) -> None:
    assert told["complaints"] == 0
