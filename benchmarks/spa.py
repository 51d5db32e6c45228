"""Detrend and `spa` of one 90 s trial, beside scipy at equal resolution and beside C with FFTW.

CPU time of one thread, the three interleaved, least of all rounds.
"""

import ctypes
import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.figures import Figure, compared, refused
from benchmarks.worker import BenchError
from hapticd.analysis.kernels import kernels
from hapticd.analysis.spa import spa
from hapticd.analysis.spectra import Spectra

TARGETS = {"spa_scipy": ">= 5x", "spa_fftw": "<= 2x"}
N_SAMPLES, RATE_HZ, LAG = 360_000, 4000.0, 2048
EQUAL_RESOLUTION = 3072  # samples of scipy's Hann segments: the half-width and degrees of freedom of LAG, in a good size
ROUNDS = 30
SOURCE = Path(__file__).with_name("spa_reference.c")
OPTIONS = ("-O3", "-march=native", "-ffast-math", "-std=gnu11", "-Wall", "-Wextra", "-Werror", "-fPIC", "-shared")


def measure() -> Iterator[Figure]:
    """Our time against both, in one process."""
    force, velocity = _record()
    runs: dict[str, Callable[[], Any]] = {"ours": lambda: spa(force, velocity, RATE_HZ, LAG)}
    missing = {name: _added(runs, name, make, force, velocity) for name, make in (("scipy", _scipy), ("fftw", _fftw))}
    times = _least(runs)
    note = "" if kernels().compiled else "numba is missing: the plain kernels ran; install hapticd[fast]"
    if missing["scipy"]:
        yield refused("spa_scipy", TARGETS["spa_scipy"], missing["scipy"])
    else:
        yield compared("spa_scipy", TARGETS["spa_scipy"], times["scipy"], "ms", times["ours"], note)
    if missing["fftw"]:
        yield refused("spa_fftw", TARGETS["spa_fftw"], missing["fftw"])
    else:
        yield compared("spa_fftw", TARGETS["spa_fftw"], times["ours"], "ms", times["fftw"], note)


def _record() -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(1)
    force = random.standard_normal(N_SAMPLES)
    velocity = np.convolve(force, [0.5, 0.3, -0.2])[:N_SAMPLES] + 0.1 * random.standard_normal(N_SAMPLES)
    return force, velocity


def _added(runs: dict[str, Callable[[], Any]], name: str, make: Callable[..., Callable[[], Any]], *record: np.ndarray) -> str:
    """Put the peer into `runs`; why it is not there, empty if it is."""
    try:
        runs[name] = make(*record)
    except (BenchError, ImportError) as error:
        return str(error)
    return ""


def _scipy(force: np.ndarray, velocity: np.ndarray) -> Callable[[], Any]:
    from scipy import signal

    options = {"fs": RATE_HZ, "window": "hann", "nperseg": EQUAL_RESOLUTION, "detrend": False}

    def run() -> tuple[Any, Any, Any]:
        y, u = signal.detrend(force), signal.detrend(velocity)
        return signal.csd(u, y, **options), signal.welch(u, **options), signal.welch(y, **options)

    return run


def _fftw(force: np.ndarray, velocity: np.ndarray) -> Callable[[], Any]:
    """The compiled yardstick. BenchError without compiler or FFTW, or when its spectra are not ours."""
    compiler = shutil.which("cc")
    if compiler is None:
        raise BenchError("no C compiler `cc`: `make deps` installs one")
    with tempfile.TemporaryDirectory(prefix="hapticd-bench-") as folder:
        file = Path(folder) / "spa_reference.so"
        done = subprocess.run(
            [compiler, *OPTIONS, str(SOURCE), "-o", str(file), "-lfftw3", "-lm"], capture_output=True, text=True, check=False
        )
        if done.returncode:
            raise BenchError(
                f"cc refused spa_reference.c, is libfftw3-dev there (`make deps`)? {done.stderr.strip().splitlines()[0]}"
            )
        library = ctypes.CDLL(str(file))
    if not library.spa_prepare(ctypes.c_long(LAG)):
        raise BenchError("FFTW made no plan")
    out = np.empty((3, LAG + 1), np.complex128)
    pointers = [array.ctypes.data_as(ctypes.c_void_p) for array in (force, velocity, out)]

    def run() -> np.ndarray:
        library.spa_reference(pointers[0], pointers[1], ctypes.c_long(force.size), pointers[2])
        return out

    _check_same(run(), spa(force, velocity, RATE_HZ, LAG))
    return run


def _check_same(theirs: np.ndarray, ours: Spectra) -> None:
    for mine, other in zip((ours.velocity, ours.force, ours.cross), theirs, strict=True):
        if np.max(np.abs(mine - other)) > 1e-9 * np.max(np.abs(mine)):
            raise BenchError("spa_reference.c computes other spectra than hapticd.analysis.spa; correct it")


def _least(runs: dict[str, Callable[[], Any]]) -> dict[str, float]:
    """CPU time of each in ms, the least of all rounds."""
    for run in runs.values():
        run()
    taken: dict[str, list[float]] = {name: [] for name in runs}
    for _ in range(ROUNDS):
        for name, run in runs.items():
            begin = time.process_time()
            run()
            taken[name].append(1e3 * (time.process_time() - begin))
    return {name: min(times) for name, times in taken.items()}
