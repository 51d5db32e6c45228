"""The yardstick in C: compile tick_reference.c, and run it from the servo's own state over the
servo's own frames.
"""

import ctypes
import shutil
import struct
import subprocess
import time
from array import array
from math import isclose
from pathlib import Path
from typing import Any

from benchmarks.records import c_struct, place
from benchmarks.worker import ROOT, BenchError
from hapticd.core.params import ServoParams
from hapticd.core.units import US_PER_S
from hapticd.mailbox import layout
from hapticd.servo.safety import bounds
from hapticd.usb.codec import TORQUE_SEQUENCES
from hapticd.usb.frames import IN_HEAD

SOURCE = Path(__file__).with_name("tick_reference.c")
OPTIONS = ("-O2", "-std=gnu11", "-Wall", "-Wextra", "-Werror", "-fPIC", "-shared")
# struct servo
HELD = struct.Struct(f"=6d12d10d7d3d3d2d4d3q4H{2 * TORQUE_SEQUENCES}q{layout.PLAN.size}s")
# indices into IN_HEAD
SEQ = 0
ECHO = 1
BOARD_US = 5
NUMBERS = slice(place("position_m"), place("excess_j") + 1)  # of a record
OUT_FRAME = place("out_frame")


def compile_library(folder: Path) -> str:
    """Compile into `folder` and return the path of the shared library. BenchError without a
    compiler.
    """
    compiler = shutil.which("cc")
    if compiler is None:
        raise BenchError("no C compiler `cc`: `make deps` installs one")
    library = folder / "tick_reference.so"
    (folder / "record.h").write_text(c_struct())
    command = [
        compiler,
        *OPTIONS,
        "-I",
        str(folder),
        "-I",
        str(ROOT / "firmware_iface"),
        str(SOURCE),
        "-o",
        str(library),
        "-lm",
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        said = next((line for line in done.stderr.splitlines() if "error" in line), "no message")
        raise BenchError(f"cc refused tick_reference.c: {said}")
    return str(library)


class CReference:
    """The compiled tick for the device of `params`."""

    def __init__(self, library: str, params: ServoParams) -> None:
        self._library = ctypes.CDLL(library)
        self._params = params
        self._ring = ctypes.create_string_buffer(layout.RING_RECORDS * layout.RECORD.size)
        sizes = [
            ctypes.c_int.in_dll(self._library, name).value
            for name in ("record_bytes", "servo_bytes")
        ]
        if sizes != [layout.RECORD.size, HELD.size]:
            raise BenchError(
                f"tick_reference.c has sizes {sizes}, expected {[layout.RECORD.size, HELD.size]};"
                " correct it"
            )

    def run(self, state: tuple[Any, ...], tick: int, frames: "list[array[int]]") -> bytes:
        """Return records of the ticks from `tick` on over `frames`, from `state`. BenchError if it
        refuses a frame.
        """
        held = ctypes.create_string_buffer(self._held(state, tick, frames[0]), HELD.size)
        packets = b"".join(frame.tobytes() for frame in frames)
        first = self._library.reference_ticks(held, packets, self._ring, len(frames))
        if first:
            raise BenchError(
                f"tick_reference.c refused IN frame {first} of {len(frames)}; correct it"
            )
        size = layout.RECORD.size
        slots = layout.RING_RECORDS
        ring = bytes(self._ring)
        return b"".join(
            ring[size * (n % slots) : size * (n % slots + 1)]
            for n in range(tick, tick + len(frames))
        )

    def _held(self, state: tuple[Any, ...], tick: int, first: "array[int]") -> bytes:
        device = self._params.device
        head = IN_HEAD.unpack_from(first)
        period_us = round(US_PER_S / self._params.realtime.rate_hz)
        sensors = (device.temperature, device.current, device.voltage, device.emf_velocity)
        now, law, ledger, _, _ = state
        bound = bounds(self._params)
        damping_slope = device.active_damping.to_value(1.0) - device.active_damping.to_value(0.0)
        damping_start = device.active_damping.to_value(0.0)
        rate_hz = self._params.realtime.rate_hz
        force = device.force
        return HELD.pack(
            *law,
            *now.environment,
            *now.coefficients,
            *ledger,
            device.position.to_value(1.0),
            force.sign / force.per_count,
            force.to_value(1.0),
            bound.resistance + damping_start * rate_hz,
            damping_slope * rate_hz,
            bound.kept,
            self._params.realtime.rate_hz / US_PER_S,
            device.active_damping.to_value(1.0),
            *(scale.to_value(1.0) for scale in sensors),
            tick,
            head[BOARD_US] - period_us,
            period_us,
            head[SEQ],
            head[ECHO],
            now.out_flags,
            now.damping_count,
            *[head[BOARD_US] - period_us] * TORQUE_SEQUENCES,
            *[time.monotonic_ns()] * TORQUE_SEQUENCES,
            now.blob,
        )


def check_same_work(ours: bytes, theirs: bytes) -> None:
    """Raise BenchError unless the last record of both has the same numbers and an identical OUT
    frame.
    """
    mine, other = (layout.RECORD.unpack(block[-layout.RECORD.size :]) for block in (ours, theirs))
    near = all(
        isclose(a, b, rel_tol=1e-9, abs_tol=1e-15)
        for a, b in zip(mine[NUMBERS], other[NUMBERS], strict=True)
    )
    if not near:
        raise BenchError(
            f"tick_reference.c computes {other[NUMBERS]}, the servo {mine[NUMBERS]}; correct it"
        )
    if mine[OUT_FRAME] != other[OUT_FRAME]:
        raise BenchError(
            f"tick_reference.c sends {other[OUT_FRAME].hex()}, the servo {mine[OUT_FRAME].hex()};"
            " correct it"
        )
