"""The quadrature decoder of the Pico: a program of PIO, stepped cycle by cycle between the edges of
an encoder that goes as it is told.
"""

from itertools import accumulate
from random import Random
from types import SimpleNamespace

import pytest
from support.pico_firmware import pico_params
from support.pico_host import PicoHost

from hapticd.usb.frames import StatusBit

PIECE_S = 62.5e-6
COUNT_M = pico_params().position_m_per_count
PIECES = 400
REST = 32  # pieces without motion before and after


def moved(edges_per_s: float) -> list[int]:
    """Counts at the ends of pieces: to and fro at random, at up to that speed."""
    most = round(edges_per_s * PIECE_S)
    random = Random(1)
    steps = [random.choice((-most, most, random.randint(-most, most))) for _ in range(PIECES)]
    return [0] * REST + list(accumulate(steps))


def driven(track: list[int]) -> SimpleNamespace:
    """A plant whose encoder goes along `track`, whatever pushes it."""
    return SimpleNamespace(
        rest=lambda _position: (0,),
        step=lambda state, *_: (state[0] + 1,),
        encoder=lambda state, *_: track[min(state[0], len(track) - 1)] * COUNT_M,
    )


@pytest.mark.parametrize("edges_per_s", [1e4, 1e6, 4e6])
def test_every_count_is_right_at_any_speed_with_reversals(edges_per_s: float) -> None:
    track = [0] * 600 + moved(edges_per_s)  # the board starts and is enumerated meanwhile
    with PicoHost(plant=driven(track)) as host:
        seen = set()
        while host.rig.piece < len(track) + REST:
            frame = host.tick(enable=False)
            seen.add(frame.encoder)
            assert not frame.status & StatusBit.ENCODER_FAULT
        assert frame.encoder == track[-1] == host.chip.state.encoder
        assert len(seen) > 15


def test_encoder_faster_than_the_decoder_is_a_fault() -> None:
    """A round of the program takes 10 cycles: 12.5 million edges a second."""
    track = [0] * 600 + [900 * piece for piece in range(PIECES)]
    with PicoHost(plant=driven(track)) as host:
        while host.rig.piece < len(track) - 100:
            frame = host.tick(enable=False)
        assert frame.status & StatusBit.ENCODER_FAULT
