"""Measure the transfer times of the bus between host and board, and set the sample phase
accordingly.

A tick reads the latched IN, computes, and writes the OUT; the board latches the next IN one phase
after it has accepted that. The ticks are on time if

    phase + IN transfer + step + OUT transfer  <=  period

A phase of 0.875 leaves an eighth of a period, 125 us at 1 kHz: enough if a transfer is a call, too
little for a bus. A pair of transfers takes 0.33 ms at the median through a Linux kernel, and 1.45
times as much at the 99th percentile. Room is therefore left for 1.45 times the measured median and
50 us of step. The phase is the largest multiple of 1/16 of the period, up to 0.875, that leaves it.
The cost for the force is known: it acts (1 - phase) periods after its sample.

With transfers in flight (`usb.flight`) a tick waits for neither. The condition is then

    phase + transit of an OUT to the board + transit of its IN + step  <=  period

without a wake-up. That round is measured in the same way as a tick, at one phase after the other,
from later ones to earlier; the first whose median leaves 50 us is used. A frame that arrives later
makes its tick wait and its force act later, and costs no slot.

The first check is whether there is a bus, by a control transfer, which no board counts: an answer
within 100 us comes from the same process. Only then are frames exchanged, all without torque: an
OUT, a pause of a period for its IN to arrive, and the read.

Limitations: a board whose control transfers are faster than its frames; a bus that became busier
between measurement and use (the delay in each record would show it).
"""

from math import floor
from statistics import median
from typing import NamedTuple

from hapticd.core.clock import Clock
from hapticd.core.errors import LinkTimeout
from hapticd.core.units import NS_PER_US, US_PER_S
from hapticd.usb import frames
from hapticd.usb.device import Device
from hapticd.usb.frames import Capability, Request

__all__ = ["Transport", "settle_transport"]

USUAL_PHASE = 0.875  # of a period: default of a board (firmware_iface/PROTOCOL.md)
PHASES = 16  # in a period
PAIRS = 32
GREETINGS = 3
ROUNDS = 16  # at one phase, in flight
LOOKS = 4  # reads for the answer of a round, each a time-out long
NO_BUS_US = 100.0  # USB needs at least three frames of 125 us for a control transfer
SLOWEST_OVER_MEDIAN = 1.45  # 99th percentile of pairs through a Linux kernel
STEP_US = 50.0  # wake-up, law and record of one tick, margin included
RATE_STEP_HZ = 10.0


class Transport(NamedTuple):
    """The measurement and its results."""

    pair_us: float  # of an OUT and an IN transfer; 0 without a bus
    sample_phase: float  # of a period, from an OUT to the latch of its IN
    delay_us: float  # from a sample to its force
    rate_hz: float  # highest possible one, or the servo's own
    in_flight: bool  # an OUT and an IN may be in progress while the servo computes


def settle_transport(device: Device, clock: Clock) -> Transport:
    """Measure the bus of a greeted `device` and set the phase of its board.

    A returned rate below the servo's own means that the bus is too slow for it. LinkError from the
    link.
    """
    period_us = device.period_us
    rate_hz = US_PER_S / period_us
    in_flight = device.link.in_flight
    if _greeting_us(device, clock) < NO_BUS_US:
        delay_us = (1.0 - USUAL_PHASE) * period_us
        return Transport(0.0, USUAL_PHASE, delay_us, rate_hz, in_flight)
    assert device.hello is not None
    settable = bool(device.hello.capabilities & Capability.SAMPLE_PHASE)
    measured = _in_flight if in_flight else _in_turn
    pair_us, phase, held_hz = measured(device, clock, settable)
    device.begin()
    if held_hz < rate_hz:
        rate_hz = RATE_STEP_HZ * floor(held_hz / RATE_STEP_HZ)
    return Transport(pair_us, phase, (1.0 - phase) * period_us, rate_hz, in_flight)


def _in_turn(device: Device, clock: Clock, settable: bool) -> tuple[float, float, float]:
    """Return the time of a pair [us], the phase and the possible rate [Hz], from the median of
    pairs.
    """
    period_us = device.period_us
    pair_us = median(_pairs_us(device, clock))
    needed_us = SLOWEST_OVER_MEDIAN * pair_us + STEP_US
    if not settable:
        return pair_us, USUAL_PHASE, US_PER_S / needed_us * (1.0 - USUAL_PHASE)
    phase = min(USUAL_PHASE, max(0, floor(PHASES * (1.0 - needed_us / period_us))) / PHASES)
    device.set_phase(phase * period_us)
    return pair_us, phase, US_PER_S / needed_us


def _in_flight(device: Device, clock: Clock, settable: bool) -> tuple[float, float, float]:
    """Return the same by trying phases, from later ones to earlier, until the answers arrive in
    time.
    """
    period_us = device.period_us
    if not settable:
        round_us = _round_us(device, clock)
        pair_us = round_us - USUAL_PHASE * period_us
        held_hz = US_PER_S / (pair_us + STEP_US) * (1.0 - USUAL_PHASE)
        return pair_us, USUAL_PHASE, held_hz
    device.set_phase(0.0)
    round_us = _round_us(device, clock)
    first = floor(PHASES * (1.0 - (round_us + STEP_US) / period_us)) + 2
    phase = 0.0
    for sixteenths in range(min(first, floor(PHASES * USUAL_PHASE)), 0, -1):
        device.set_phase(sixteenths / PHASES * period_us)
        tried_us = _round_us(device, clock)
        if tried_us + STEP_US <= period_us:
            phase, round_us = sixteenths / PHASES, tried_us
            break
    else:
        device.set_phase(0.0)
    pair_us = round_us - phase * period_us
    return pair_us, phase, US_PER_S / (pair_us + STEP_US)


def _round_us(device: Device, clock: Clock) -> float:
    """Return the time from an OUT to its answer, both in flight: the median of ROUNDS.
    LinkTimeout.
    """
    period_ns = round(device.period_us * NS_PER_US)
    device.begin()
    clock.sleep_until_ns(clock.now_ns() + period_ns)
    device.receive()  # the answer to that frame
    rounds = []
    for _ in range(ROUNDS):
        start_ns = clock.now_ns()
        device.send(0, 0, 0, 0)
        device.link.drain()  # not in a tick: waiting for an OUT is allowed
        if any(device.receive()[0] >= 0 for _ in range(LOOKS)):
            rounds.append((clock.now_ns() - start_ns) / NS_PER_US)
        clock.sleep_until_ns(max(clock.now_ns(), start_ns + period_ns))
    if len(rounds) < ROUNDS - 1:
        raise LinkTimeout(
            f"the board answered {len(rounds)} of {ROUNDS} frames while the bus was measured"
        )
    return median(rounds)


def _greeting_us(device: Device, clock: Clock) -> float:
    times = []
    for _ in range(GREETINGS):
        start_ns = clock.now_ns()
        device.link.request(Request.HELLO, frames.HELLO_BYTES)
        times.append(clock.now_ns() - start_ns)
    return min(times) / NS_PER_US


def _pairs_us(device: Device, clock: Clock) -> list[float]:
    """Return the time of each of PAIRS pairs: an OUT without torque, and an IN that is ready."""
    period_ns = round(device.period_us * NS_PER_US)
    pairs = []
    clock.sleep_until_ns(clock.now_ns() + period_ns)
    device.receive()  # the answer to the frame that `connect` sent
    for _ in range(PAIRS):
        start_ns = clock.now_ns()
        device.send(0, 0, 0, 0)
        sent_ns = clock.now_ns()
        clock.sleep_until_ns(sent_ns + period_ns)
        ready_ns = clock.now_ns()
        device.receive()
        pairs.append((sent_ns - start_ns + clock.now_ns() - ready_ns) / NS_PER_US)
    return pairs
