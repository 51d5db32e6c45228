"""Each known defect of the Pico's firmware, put into a copy of its sources, is found by the check
that the shipped image passes (test_pico_board.py).
"""

import re
from pathlib import Path

import pytest
from support.pico_checks import CHECKS, check_power_up
from support.pico_chip import PicoChip
from support.pico_defects import DEFECTS, POWER_UP, Defect
from support.pico_firmware import image, pico_params, start_chip
from support.pico_host import PicoHost
from support.pico_modules import EMULATOR
from support.pico_plant import Rig

from hapticd.core.errors import HapticdError

FOUND = (AssertionError, HapticdError)
UF2_HEAD = 32
CHECKSUM = "boot"  # the complaint that a changed image meets, below


@pytest.mark.parametrize("defect", DEFECTS.values(), ids=DEFECTS)
def test_defect_is_found(defect: Defect) -> None:
    chip = start_chip(image(changes=defect.changes), chip_id=defect.chip_id)
    try:
        with pytest.raises(FOUND):
            passes(chip, defect.check)
        if defect.complaint:
            assert defect.complaint in chip.complaint_kinds()
    finally:
        chip.close()


def test_every_kind_of_complaint_is_shown_by_a_defect() -> None:
    sources = [path.read_text() for path in EMULATOR.glob("*.mjs")]
    kinds = {kind for text in sources for kind in re.findall(r"complain\('(\w+)'", text)}
    assert kinds == {defect.complaint for defect in DEFECTS.values()} - {""} | {CHECKSUM}


def passes(chip: PicoChip, check: str) -> None:
    """AssertionError, or an error of the link, where the board does not pass, or the chip
    complains.
    """
    if check == POWER_UP:
        check_power_up(chip, Rig(chip, pico_params()))
        return
    host = PicoHost(chip)
    host.attach()
    CHECKS[check](host)
    assert chip.complaints() == []


def test_boot_rom_refuses_a_wrong_checksum(tmp_path: Path) -> None:
    raw = bytearray(image().read_bytes())
    raw[UF2_HEAD + 8] ^= 1
    path = tmp_path / "hapticd.uf2"
    path.write_bytes(raw)
    chip = start_chip(path)
    try:
        with pytest.raises(AssertionError):
            check_power_up(chip, Rig(chip, pico_params()))
        assert chip.complaint_kinds() == {CHECKSUM}
    finally:
        chip.close()
