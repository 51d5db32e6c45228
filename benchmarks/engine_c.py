"""The yardstick of the engine in C: compiling engine_reference.c, and giving it the engine's own numbers."""

import ctypes
import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.engine_scene import Lanes
from benchmarks.worker import BenchError
from hapticd.analysis.arrays import aligned

SOURCE = Path(__file__).with_name("engine_reference.c")
OPTIONS = (
    "-O3",
    "-march=native",
    "-fno-math-errno",
    "-fno-trapping-math",
    "-std=gnu11",
    "-Wall",
    "-Wextra",
    "-Werror",
    "-fPIC",
    "-shared",
)
REALS = {"f32": "float", "f64": "double"}
STATE_ROWS, SUM_ROWS = 11, 6
SCENE = (
    *(f"A{i}_{j}" for i in range(4) for j in (1, 2, 3)),
    *(f"{letter}{i}" for letter in ("G", "T", "H0_") for i in range(4)),
    *("R1", "R2", "R3", "RU", "RT", "RH0", "LEVEL0", "W0", "COUNT", "COUNTS", "LIMIT"),
    *(f"FILTER{i}" for i in range(10)),
)  # struct scene, by the engine's names
AGREEMENT = {"f32": 1e-3, "f64": 1e-9}  # of the sums of a run; f32 differs by a count now and then


class CReference:
    """The same scene in C with `lanes` trials side by side; a call plays what `ours` plays. BenchError without a compiler."""

    def __init__(self, ours: Lanes, dtype: str, lanes: int) -> None:
        self._play = _library(dtype, lanes).play
        scalar, kernel = ours.torque.dtype.type, ours.group.made.kernel
        numbers = dict(zip(kernel.COEFFICIENTS, ours.group.coefficients, strict=True))
        self.lanes, self.ticks = lanes, ours.ticks
        self.scene = np.array([numbers[name] for name in SCENE], scalar)
        self.state, self.sums, self.out = (aligned(rows * lanes, scalar) for rows in (STATE_ROWS, SUM_ROWS, 5 * ours.ticks))
        self.kbm = aligned(3 * lanes, scalar)
        self.kbm[:] = np.resize(ours.params, (lanes, 3)).T.ravel()
        self.torque = ours.torque
        self.reset()

    def reset(self) -> None:
        """At rest, nothing summed."""
        self.state[:] = self.sums[:] = 0.0
        self.sums[: self.lanes] = 1.0

    def __call__(self) -> None:
        arrays = (self.state, self.kbm, self.sums, self.scene, self.torque, self.out)
        self._play(*(array.ctypes.data_as(ctypes.c_void_p) for array in arrays), ctypes.c_long(self.ticks), ctypes.c_long(0))

    def squared(self) -> Any:
        """Sum of squared velocity of each trial since `reset`."""
        return self.sums[self.lanes : 2 * self.lanes]


def check_same(ours: Lanes, theirs: CReference, dtype: str) -> None:
    """BenchError unless both, just made, play the same motion."""
    ours()
    theirs()
    count = min(ours.lanes, theirs.lanes)
    difference = np.abs(theirs.squared()[:count] / ours.group.v2[:count] - 1.0).max()
    if not difference < AGREEMENT[dtype]:
        raise BenchError(f"engine_reference.c moves otherwise than the engine, by {difference:.1e}; correct it")
    theirs.reset()


def _library(dtype: str, lanes: int) -> ctypes.CDLL:
    compiler = shutil.which("cc")
    if compiler is None:
        raise BenchError("no C compiler `cc`: `make deps` installs one")
    with tempfile.TemporaryDirectory(prefix="hapticd-bench-") as folder:
        library = Path(folder) / "engine_reference.so"
        asked = [f"-DREAL={REALS[dtype]}", f"-DLANES={lanes}", str(SOURCE), "-o", str(library), "-lm"]
        done = subprocess.run([compiler, *OPTIONS, *asked], capture_output=True, text=True, check=False)
        if done.returncode:
            raise BenchError(f"cc refused engine_reference.c: {done.stderr.strip().splitlines()[0]}")
        return ctypes.CDLL(str(library))
