"""The yardstick of the engine in C: compile engine_reference.c for a scene, with the engine's own
numbers.

The C contains exactly the contents of the scene's kernel: the same states, the same nonzero
coefficients, the same friction, the same sub-steps. `Yard` runs that C at the machine's best: one
thread a core, all cores at once, no other work.
"""

import ctypes
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from math import ceil
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.engine_scene import Lanes
from benchmarks.worker import BenchError
from hapticd.core.arrays import aligned
from hapticd.zwidth.engine.batch import workers
from hapticd.zwidth.engine.shape import Shape

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
C_LANES = {"f32": (16, 32, 64), "f64": (8, 16, 32)}
LAW_ROWS = 6
SUM_ROWS = 6
CHOOSING = 9  # rounds in which the lane count is chosen
COUNTED = ("COUNT", "COUNTS", "FORCE_COUNT", "FORCE_COUNTS", "LIMIT")
AGREEMENT = {"f32": 1e-3, "f64": 1e-9}  # of the sums of a run; f32 occasionally differs by a count


class CReference:
    """The same scene in C with `lanes` parallel trials; a call plays the same as `ours`. BenchError
    without a compiler.
    """

    def __init__(self, ours: Lanes, dtype: str, lanes: int) -> None:
        shape = ours.group.made.shape
        self._play = _library(shape, REALS[dtype], lanes).play
        scalar = ours.torque.dtype.type
        self.lanes = lanes
        self.ticks = ours.ticks
        self.samples = shape.samples
        self.kept = 0
        self.scene = np.array(_scene(ours), scalar)
        self.state = aligned((shape.states + LAW_ROWS + 1) * lanes, scalar)
        self.sums, self.out = (
            aligned(SUM_ROWS * lanes, scalar),
            aligned((shape.samples + 1) * lanes * ours.ticks, scalar),
        )
        self.kbm = aligned(3 * lanes, scalar)
        self.kbm[:] = np.resize(ours.params, (lanes, 3)).T.ravel()
        self.torque = ours.torque
        self.reset()

    def reset(self) -> None:
        """Set to rest, with empty sums."""
        self.state[:] = self.sums[:] = 0.0
        self.sums[: self.lanes] = 1.0

    def __call__(self) -> None:
        arrays = (self.state, self.kbm, self.sums, self.scene, self.torque, self.out)
        pointers = (array.ctypes.data_as(ctypes.c_void_p) for array in arrays)
        self._play(*pointers, ctypes.c_long(self.ticks), ctypes.c_long(self.kept))

    @property
    def steps(self) -> int:
        """4 kHz samples of a call, of all lanes."""
        return self.lanes * self.ticks * self.samples

    def squared(self) -> Any:
        """Return the sum of squared velocity of each trial since `reset`."""
        return self.sums[self.lanes : 2 * self.lanes]


class Yard:
    """The C of the scene of `ours` on all cores, with its best lane count; `keep`: it stores every
    sample, as needed for analysis.

    BenchError without a compiler, or if C and engine play different motions.
    """

    def __init__(self, ours: Lanes, dtype: str, keep: bool = False) -> None:
        check_same(ours, CReference(ours, dtype, C_LANES[dtype][0]), dtype)
        teams = [
            [CReference(ours, dtype, lanes) for _ in range(workers())] for lanes in C_LANES[dtype]
        ]
        for one in (one for team in teams for one in team):
            one.kept = int(keep)
        self._team = min(teams, key=lambda team: min(_timed(team, 1) for _ in range(CHOOSING)))
        self.found: list[float] = []

    def time(self, samples: float) -> None:
        """Add a round over as many 4 kHz samples, all trials together: seconds for each, with all
        cores busy.
        """
        self.found.append(_timed(self._team, ceil(samples / sum(one.steps for one in self._team))))


def _timed(team: list[CReference], calls: int) -> float:
    with ThreadPoolExecutor(len(team)) as threads:
        begin = time.perf_counter()
        list(threads.map(_repeat, team, [calls] * len(team)))
        taken_s = time.perf_counter() - begin
    return taken_s / (calls * sum(one.steps for one in team))


def _repeat(run: CReference, calls: int) -> None:
    for _ in range(calls):
        run()


def check_same(ours: Lanes, theirs: CReference, dtype: str) -> None:
    """Raise BenchError unless both, just created, play the same motion."""
    ours()
    theirs()
    count = min(ours.lanes, theirs.lanes)
    squares = ours.group.tallied()["SPEED2"][:count]
    difference = np.abs(theirs.squared()[:count] / squares - 1.0).max()
    if not difference < AGREEMENT[dtype]:
        raise BenchError(
            f"engine_reference.c moves otherwise than the engine, by {difference:.1e}; correct it"
        )
    theirs.reset()


def _scene(ours: Lanes) -> list[float]:
    """Return struct scene of engine_reference.c, by the engine's names; numbers missing in the
    kernel are 0, or exactly 1.
    """
    shape = ours.group.made.shape
    names = ours.group.made.kernel.COEFFICIENTS
    numbers = dict(zip(names, ours.group.coefficients, strict=True))
    states = range(shape.states)
    ones = {f"R{term.state}": 1.0 for term in shape.sample if term.one}
    numbers = ones | numbers
    wanted = [f"A{i}_{j}" for i in states for j in states]
    wanted += [f"{letter}{i}" for letter in ("G", "T", "H0_", "R") for i in states]
    wanted += ["RU", "RT", "RH0", "LEVEL0", *COUNTED, *(f"FILTER{i}" for i in range(10))]
    return [float(numbers.get(name, 0.0)) for name in wanted]


def _defines(shape: Shape) -> Iterable[str]:
    """Yield the compile-time definitions of the C: the terms it has. BenchError for an unsupported
    scene.
    """
    rubs = len(shape.contacts) == 1 and shape.contacts[0].velocity == 1
    if not rubs or any(shape.drift) or shape.rotor_laws or shape.stops or shape.waits:
        raise BenchError(
            "engine_reference.c has friction on the first body and no other nonlinearity"
        )
    states = range(shape.states)
    yield f"STATES={shape.states}"
    yield f"SUBSTEPS={shape.substeps}"
    yield f"SAMPLE_AT={shape.sample_step}"
    yield f"SAMPLE_INSIDE={int(shape.sample_inside)}"
    yield f"FORCE_QUANTUM={int(shape.force_quantum)}"
    yield f"FEEDS={_mask(*(sum(1 << j for j in row) for row in shape.feeds))}"
    yield f"PUSHED={_mask(*map(int, shape.torque))}"
    yield f"RUBBED={_mask(*map(int, shape.contacts[0].column))}"
    yield f"APART={_mask(*(int(i in shape.distances) for i in states))}"
    seen = (int(any(term.state == i for term in shape.sample)) for i in range(shape.states))
    yield f"SEEN={_mask(*seen)}"


def _mask(*values: int) -> str:
    return "{" + ",".join(map(str, values)) + "}"


def _library(shape: Shape, real: str, lanes: int) -> ctypes.CDLL:
    asked = [f"-D{define}" for define in (*_defines(shape), f"REAL={real}", f"LANES={lanes}")]
    return compiled(SOURCE, [*OPTIONS, *asked], ["-lm"])


def compiled(
    source: Path, options: list[str], libraries: list[str], remedy: str = ""
) -> ctypes.CDLL:
    """Return `source` as a library. BenchError without a compiler, or if it fails."""
    compiler = shutil.which("cc")
    if compiler is None:
        raise BenchError("no C compiler `cc`: `make deps` installs one")
    with tempfile.TemporaryDirectory(prefix="hapticd-bench-") as folder:
        library = Path(folder) / source.with_suffix(".so").name
        command = [compiler, *options, str(source), "-o", str(library), *libraries]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            said = next(
                (line for line in done.stderr.splitlines() if "error" in line), "no message"
            )
            raise BenchError(f"cc refused {source.name}{remedy}: {said}")
        return ctypes.CDLL(str(library))
