"""Detrend and `spa` of one 90 s trial, compared with scipy at equal resolution and with C using
FFTW.

CPU time of one thread, the three interleaved, minimum of all rounds.
"""

import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from benchmarks import targets
from benchmarks.figures import Figure, compared, refused
from benchmarks.spa_c import SpaReference
from benchmarks.worker import BenchError
from hapticd.signal import covariances as plain
from hapticd.signal.spectra import Spectra, spa

TARGETS = targets.of("spa")
N_SAMPLES = 360_000
RATE_HZ = 4000.0
LAG = 2048
# samples of scipy's Hann segments: the half-width and degrees of freedom of LAG, in a good size
EQUAL_RESOLUTION = 3072
ROUNDS = 30


def measure() -> Iterator[Figure]:
    """Compare our time with both, in one process."""
    force, velocity = _record()
    runs: dict[str, Callable[[], Any]] = {"ours": lambda: spa(force, velocity, RATE_HZ, LAG)}
    missing = {
        name: _added(runs, name, make, force, velocity)
        for name, make in (("scipy", _scipy), ("fftw", _fftw))
    }
    times = _least(runs)
    note = (
        ""
        if plain.kernels() is not plain
        else "numba is missing: the plain kernels ran; `make lab` installs it"
    )
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
    velocity = np.convolve(force, [0.5, 0.3, -0.2])[:N_SAMPLES] + 0.1 * random.standard_normal(
        N_SAMPLES
    )
    return force, velocity


def _added(
    runs: dict[str, Callable[[], Any]],
    name: str,
    make: Callable[..., Callable[[], Any]],
    *record: np.ndarray,
) -> str:
    """Put the peer into `runs`; return why it is missing, empty if it is not."""
    try:
        runs[name] = make(*record)
    except (BenchError, ImportError) as error:
        return str(error)
    return ""


def _scipy(force: np.ndarray, velocity: np.ndarray) -> Callable[[], Any]:
    from scipy import signal

    options = {"fs": RATE_HZ, "window": "hann", "nperseg": EQUAL_RESOLUTION, "detrend": False}

    def run() -> tuple[Any, Any, Any]:
        y = signal.detrend(force)
        u = signal.detrend(velocity)
        return signal.csd(u, y, **options), signal.welch(u, **options), signal.welch(y, **options)

    return run


def _fftw(force: np.ndarray, velocity: np.ndarray) -> Callable[[], Any]:
    """Return the compiled yardstick. BenchError without compiler or FFTW, or if its
    spectra differ.
    """
    made = SpaReference("f64")
    _check_same(made.spectra(force, velocity), spa(force, velocity, RATE_HZ, LAG))
    return lambda: made.spectra(force, velocity)


def _check_same(theirs: np.ndarray, ours: Spectra) -> None:
    for mine, other in zip((ours.velocity, ours.force, ours.cross), theirs, strict=True):
        if np.max(np.abs(mine - other)) > 1e-9 * np.max(np.abs(mine)):
            raise BenchError(
                "spa_reference.c computes other spectra than hapticd.signal.spectra; correct it"
            )


def _least(runs: dict[str, Callable[[], Any]]) -> dict[str, float]:
    """Return the CPU time of each in ms, minimum of all rounds."""
    for run in runs.values():
        run()
    taken: dict[str, list[float]] = {name: [] for name in runs}
    for _ in range(ROUNDS):
        for name, run in runs.items():
            begin = time.process_time()
            run()
            taken[name].append(1e3 * (time.process_time() - begin))
    return {name: min(times) for name, times in taken.items()}
