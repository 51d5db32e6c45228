"""The fake board with the calibrated device: time of its tick, CPU of the whole stack in lock-step.

`board_tick_us` is a write and read pair of the USB link with weir2008 (7 states, 16 sub-steps a tick) behind it; pyusb's own
few microseconds are in it.
"""

import time
from array import array
from collections.abc import Iterator
from statistics import median

from benchmarks.figures import Figure, compared
from benchmarks.lockstep import flight_s
from hapticd.assembly.scene import scene_params
from hapticd.assembly.simulation import simulated_backend
from hapticd.clock import VirtualClock
from hapticd.link.usb import UsbLink
from hapticd.units import NS_PER_MS, NS_PER_US
from hapticd.wire import codec, frames
from hapticd.wire.frames import OutFlag

SCENE = "fig4"
TARGETS = {"board_tick_us": "<= 40", "lockstep_weir_cpu_s": "<= 5"}
PAIRS, BLOCKS = 2000, 9


def measure() -> Iterator[Figure]:
    """Medians over blocks, and one flight."""
    yield compared("board_tick_us", TARGETS["board_tick_us"], median(_pairs_us()), "us", note=f"scene {SCENE}, moving")
    yield compared(
        "lockstep_weir_cpu_s", TARGETS["lockstep_weir_cpu_s"], flight_s(*scene_params(SCENE)), "s", note=f"scene {SCENE}"
    )


def _pairs_us() -> list[float]:
    """Microseconds of a write and read pair, one figure per block; the device is kept moving by a changing force."""
    servo, board = scene_params(SCENE)
    clock = VirtualClock(NS_PER_MS)
    link = UsbLink(servo.usb, simulated_backend(board, clock))
    link.open()
    out, reply = array("B", bytes(frames.OUT_BYTES)), array("B", bytes(frames.PACKET_BYTES))
    pack, found = codec.out_packer(out), []
    for block in range(BLOCKS):
        spent_ns = 0
        for index in range(PAIRS):
            number = block * PAIRS + index
            pack(number & 0xFFFF, int(OutFlag.ENABLE) if number else 0, 2000 * (-1) ** (number // 50), 0, 0)
            begin = time.perf_counter_ns()
            link.write(out)
            link.read(reply)
            spent_ns += time.perf_counter_ns() - begin
            clock.sleep_until_ns((number + 2) * NS_PER_MS)
        found.append(spent_ns / PAIRS / NS_PER_US)
    link.close()
    return found
