"""The quadrature decoder of the Pico's firmware, by the data sheet's description of PIO (3.4): each
step is counted, a step over a state is reported, and a round is short enough for the edges that
docs/pico.md promises.
"""

from collections.abc import Iterable

import pytest
from support.pico_image import program_words

JMP, IN, OUT, PUSH, MOV, IRQ = 0, 2, 3, 4, 5, 6
PINS, X, PC, ISR, OSR = 0, 1, 5, 6, 7  # sources and destinations of MOV; PINS of IN
TO_ISR = 6  # destination of OUT
X_DECREMENT = 2  # condition of JMP
MASK = 0xFFFFFFFF
CYCLES_MOST = 10
FORWARD = (0b00, 0b01, 0b11, 0b10)  # B, A
SAME = 23  # where firmware_iface/pico/encoder.c starts


class Decoder:
    """One state machine with the program of the firmware, at the pins `state`."""

    def __init__(self, state: int) -> None:
        self.program = program_words()
        self.pins = state
        self.x = 0
        self.isr = 0
        self.osr = state
        self.pc = SAME
        self.skipped = False
        self.pushed = 0

    def round_to_sample(self) -> int:
        """Run up to the next sample of the pins; the cycles that it took."""
        cycles = 0
        while True:
            word = self.program[self.pc]
            cycles += 1
            self.pc += 1
            self.execute(word)
            if word >> 13 == IN:
                return cycles

    def execute(self, word: int) -> None:
        kind, field, low = word >> 13, word >> 5 & 7, word & 0x1F
        assert not word & 0x1F00, "a delay or a side-set"
        if kind == JMP:
            self.jump(field, low)
        elif kind == IN:
            assert field == PINS
            self.isr = (self.isr << low | self.pins) & MASK
        elif kind == OUT:
            assert field == TO_ISR
            self.isr = self.osr & (1 << low) - 1
            self.osr >>= low
        elif kind == PUSH:
            self.pushed, self.isr = self.isr, 0
        elif kind == MOV:
            self.move(field, low)
        else:
            assert (kind, field, low) == (IRQ, 0, 0)
            self.skipped = True

    def jump(self, condition: int, to: int) -> None:
        assert condition in (0, X_DECREMENT)
        if not condition or self.x:
            self.pc = to
        if condition:
            self.x = (self.x - 1) & MASK

    def move(self, to: int, source: int) -> None:
        value = {X: self.x, ISR: self.isr, OSR: self.osr}[source & 7]
        if source >> 3 == 1:
            value = ~value & MASK
        if to == X:
            self.x = value
        elif to == ISR:
            self.isr = value
        elif to == OSR:
            self.osr = value
        else:
            assert to == PC
            self.pc = value & 0x1F

    def count(self) -> int:
        return self.x - (1 << 32) if self.x >> 31 else self.x


def counted(states: Iterable[int]) -> Decoder:
    """A decoder that has sampled each of the states once, and then the last one again."""
    first, *others = states
    decoder = Decoder(first)
    for state in (*others, others[-1]):
        decoder.round_to_sample()
        decoder.pins = state
    for _ in range(2):
        assert decoder.round_to_sample() <= CYCLES_MOST
    return decoder


@pytest.mark.parametrize("at", range(4))
@pytest.mark.parametrize(("by", "skip"), [(0, False), (1, False), (2, True), (-1, False)])
def test_each_step_between_two_samples(at: int, by: int, skip: bool) -> None:
    decoder = counted([FORWARD[at], FORWARD[(at + by) % 4]])
    assert decoder.count() == (0 if skip else by)
    assert decoder.skipped == skip


def test_count_goes_below_zero_and_back() -> None:
    down = [FORWARD[-step % 4] for step in range(8)]
    assert counted(down).count() == -7
    assert counted([*down, *reversed(down)]).count() == 0


def test_no_way_round_takes_more_than_ten_cycles() -> None:
    longest = 0
    for at in range(4):
        for by in range(4):
            decoder = Decoder(FORWARD[at])
            decoder.round_to_sample()
            decoder.pins = FORWARD[(at + by) % 4]
            longest = max(longest, *(decoder.round_to_sample() for _ in range(4)))
    assert longest == CYCLES_MOST
