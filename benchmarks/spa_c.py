"""The yardstick of spectra: spa_reference.c with FFTW, compiled here, and timed on all cores at
once.
"""

import ctypes
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.engine_c import compiled
from benchmarks.worker import BenchError
from hapticd.signal.spectra import DEFAULT_LAG as LAG
from hapticd.signal.spectra import spa
from hapticd.zwidth.engine.batch import workers

SOURCE = Path(__file__).with_name("spa_reference.c")
OPTIONS = [
    "-O3",
    "-march=native",
    "-ffast-math",
    "-std=gnu11",
    "-Wall",
    "-Wextra",
    "-Werror",
    "-fPIC",
    "-shared",
]
SINGLE = ["-DREAL=float", "-DFFTW(name)=fftwf_##name"]
LIBRARY = {"f64": "-lfftw3", "f32": "-lfftw3f"}
REAL = {"f64": np.float64, "f32": np.float32}
AGREEMENT = 1e-4  # of the largest value of a spectrum, in float32
REMEDY = ", is libfftw3-dev there (`make deps`)?"


class SpaReference:
    """The library in `dtype`. BenchError without compiler or FFTW."""

    def __init__(self, dtype: str) -> None:
        self.dtype = REAL[dtype]
        single = SINGLE if dtype == "f32" else []
        self._library = compiled(SOURCE, [*OPTIONS, *single], [LIBRARY[dtype], "-lm"], REMEDY)
        if not self._library.spa_prepare(ctypes.c_long(LAG)):
            raise BenchError("FFTW made no plan")

    def spectra(self, force: Any, velocity: Any) -> Any:
        """Return Phi_u, Phi_y, Phi_yu of one record (3, LAG + 1), as `spa`."""
        out = self._room(3)
        self._library.spa_reference(_at(force), _at(velocity), ctypes.c_long(len(force)), _at(out))
        return out

    def force_table(self, force: Any) -> Any:
        """Return transforms of all sections of a force shared by many trials."""
        table = self._room(-(-len(force) // LAG) + 1)
        self._library.spa_force(_at(force), ctypes.c_long(len(force)), _at(table))
        return table

    def shared(self, table: Any, velocity: Any) -> Any:
        """Return Phi_u and Phi_yu (2, LAG + 1) of a trial under that force."""
        out = self._room(2)
        self._library.spa_shared(_at(table), _at(velocity), ctypes.c_long(len(velocity)), _at(out))
        return out

    def _room(self, rows: int) -> Any:
        return np.empty((rows, LAG + 1), np.result_type(self.dtype, np.complex64))


class SpectraYard:
    """Spectra of a record by float32 FFTW on all cores, with the force shared and transformed in
    advance, as in a map.
    """

    def __init__(self, samples: int, rate_hz: float) -> None:
        draw = np.random.default_rng(1)
        self._made = SpaReference("f32")
        force = draw.standard_normal(samples).astype(np.float32)
        self._table = self._made.force_table(force)
        self._velocity = np.convolve(force, [0.5, 0.3, -0.2])[:samples].astype(np.float32)
        self.found: list[float] = []
        self._check(force, rate_hz)

    def _check(self, force: Any, rate_hz: float) -> None:
        """Raise BenchError unless its spectra equal ours."""
        mine = spa(force.astype(np.float64), self._velocity.astype(np.float64), rate_hz, LAG)
        theirs = self._made.shared(self._table, self._velocity)
        for own, other in zip((mine.velocity, mine.cross), theirs, strict=True):
            if np.max(np.abs(own - other)) > AGREEMENT * np.max(np.abs(own)):
                raise BenchError(
                    "spa_reference.c computes other shared spectra than hapticd.signal.spectra;"
                    " correct it"
                )

    def time(self, trials: int) -> None:
        """Add a round: seconds of a trial on one core, with all cores busy."""
        with ThreadPoolExecutor(workers()) as threads:
            begin = time.perf_counter()
            list(threads.map(self._repeat, [trials] * workers()))
            self.found.append((time.perf_counter() - begin) / trials)

    def one(self) -> None:
        """Compute a trial's spectra."""
        self._made.shared(self._table, self._velocity)

    def _repeat(self, trials: int) -> None:
        for _ in range(trials):
            self.one()


def _at(array: Any) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)
