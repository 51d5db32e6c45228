"""The reference firmware at length: `make firmware`, minutes. Prints its counts.

    python tests/million_frames.py [FOLDER]    its C sources, else those of the reference

1. a million hostile frames, to the firmware and to the simulated board: every frame, output and
   reply the same;
2. ten million steps of the fuzzer, with sanitizers, and its coverage of the sources;
3. a trial of 90 s in lock-step with each: the same record and the same verdict.

It ends with an AssertionError at the first difference or broken promise.
"""

import random
import sys
import tempfile
from functools import partial
from pathlib import Path
from unittest import mock

import numpy as np
from support.firmware_board import FirmwareBoard
from support.firmware_build import COVERED, REFERENCE, SANITIZED, fuzz, reached
from support.firmware_trial import fig7_trial
from support.hostile import Tally, compare_boards

from hapticd.sim.board import BoardModel

FRAMES = 1_000_000
CASE_BYTES = 4000
FUZZ_STEPS = 10_000_000
COVERED_STEPS = 1_000_000
SECONDS = 90.0

folder = Path(sys.argv[1]) if len(sys.argv) > 1 else REFERENCE
firmware = partial(FirmwareBoard, folder=folder)

tally = Tally()
seed = 0
while tally.frames < FRAMES:
    compare_boards(random.Random(seed).randbytes(CASE_BYTES), firmware, tally)
    seed += 1
print(f"{tally.frames} frames, {tally.refused} refused, {tally.packets} answers alike", flush=True)

with tempfile.TemporaryDirectory() as built:
    print("fuzzed:", fuzz(Path(built), FUZZ_STEPS, SANITIZED, folder), flush=True)
with tempfile.TemporaryDirectory() as built:
    fuzz(Path(built), COVERED_STEPS, COVERED, folder)
    for source, found in reached(Path(built), folder).items():
        missed = f"{found.missed} of {found.branches} branches never taken"
        print(f"{source}: {found.lines_percent:g} % of lines, {missed}", flush=True)

python = fig7_trial(BoardModel, SECONDS)
with mock.patch("hapticd.sim.backend.make_board", firmware):
    compiled = fig7_trial(FirmwareBoard, SECONDS)
assert python.verdict == compiled.verdict
assert np.array_equal(python.recorded.force_n, compiled.recorded.force_n)
assert np.array_equal(python.recorded.velocity_m_per_s, compiled.recorded.velocity_m_per_s)
print(f"trial of {SECONDS:g} s, {python.recorded.force_n.size} pairs alike:\n{python.verdict}")
