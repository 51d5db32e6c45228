"""Whatever a host does to the image in the emulator, it does what the reference firmware does on
the PC.
"""

from random import Random

import pytest
from support.hostile import Tally
from support.pico_hostile import PicoBench

from hapticd.usb.frames import StatusBit

CASE_BYTES = 50_000  # some 2,500 frames


@pytest.mark.timeout(600)  # a quarter of a minute on an idle core
@pytest.mark.parametrize("seed", range(4))
def test_no_host_tells_the_image_from_the_reference_firmware(seed: int) -> None:
    tally = Tally()
    bench = PicoBench(Random(seed).randbytes(CASE_BYTES), tally)
    bench.run()
    assert bench.pico.chip.complaints() == []
    assert tally.frames > 2500
    seen = StatusBit(tally.statuses)
    assert StatusBit.BAD_FRAME | StatusBit.SEQ_GAP | StatusBit.EMERGENCY_STOP in seen
    assert StatusBit.WATCHDOG | StatusBit.ENABLED in seen
