"""The shipped image of the Pico in an emulator of the chip, with a simulated device at its pins, a
host at its bus and the product's own link: what it has to do, and that the chip would forgive all
of it.
"""

import pytest
from support.pico_checks import CHECKS, IN_TURN, check_power_up
from support.pico_chip import B1
from support.pico_firmware import AS_SHIPPED, Dacs, image, pico_params, start_chip
from support.pico_host import PicoHost
from support.pico_plant import Rig

IN_FLIGHT = [name for name in CHECKS if name not in IN_TURN]
UNREAD = ("exchange", "replaced", "race", "burst")
OTHER_DACS = [
    Dacs("dac8563", "dac8563"),
    Dacs("mcp4922", "mcp4922"),
    Dacs("mcp4922", "dac8812"),
]


@pytest.mark.parametrize("check", CHECKS)
def test_board_does_what_it_has_to(check: str) -> None:
    with PicoHost() as host:
        CHECKS[check](host)


@pytest.mark.parametrize("check", IN_FLIGHT)
def test_board_does_the_same_with_transfers_in_flight(check: str) -> None:
    with PicoHost(in_flight=True) as host:
        CHECKS[check](host)


@pytest.mark.parametrize("check", UNREAD)
def test_silicon_that_cannot_abort_is_never_asked_to(check: str) -> None:
    """RP2040-E2: before B2, EP_ABORT does not work."""
    with PicoHost(start_chip(chip_id=B1)) as host:
        CHECKS[check](host)


@pytest.mark.parametrize("check", ["outputs", "stop", "silence", "reset"])
@pytest.mark.parametrize("dacs", OTHER_DACS, ids="-".join)
def test_board_with_other_dacs_does_the_same(dacs: Dacs, check: str) -> None:
    """MCP4922: 12 bits, and nothing comes out until it is written to. Damping as a voltage."""
    with PicoHost(start_chip(image(dacs.defines()), dacs)) as host:
        CHECKS[check](host)


@pytest.mark.parametrize("dacs", [AS_SHIPPED, *OTHER_DACS], ids="-".join)
def test_board_without_a_host_puts_out_nothing_with_any_dacs(dacs: Dacs) -> None:
    chip = start_chip(image(dacs.defines()), dacs)
    try:
        check_power_up(chip, Rig(chip, pico_params()))
    finally:
        chip.close()
