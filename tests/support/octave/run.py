"""Run spa.m, and make golden.json with it."""

import json
import shutil
import subprocess
import tempfile
from pathlib import Path

import numpy as np

FOLDER = Path(__file__).parent
GOLDEN = FOLDER / "golden.json"
REMEDY = "octave with octave-signal is needed to check the spectra: `make deps` installs both"


def record(n_samples: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Force and velocity of a filter driven by noise, with noise, offset and drift on both."""
    random = np.random.default_rng(seed)
    force = random.standard_normal(n_samples)
    velocity = np.convolve(force, [0.5, 0.3, -0.2, 0.1])[:n_samples] + 0.2 * random.standard_normal(
        n_samples
    )
    place = np.arange(n_samples) / n_samples
    return force + 0.3 - 0.5 * place, velocity - 0.1 + 0.4 * place


def spa_by_octave(force: np.ndarray, velocity: np.ndarray, lag: int, rate_hz: float) -> np.ndarray:
    """The columns that spa.m writes, (lag + 1, 8). RuntimeError with the remedy where octave or
    octave-signal is missing.
    """
    octave = shutil.which("octave-cli")
    if octave is None:
        raise RuntimeError(REMEDY)
    with tempfile.TemporaryDirectory(prefix="hapticd-octave-") as folder:
        given = Path(folder) / "record.txt"
        found = Path(folder) / "spectra.txt"
        np.savetxt(given, np.column_stack((force, velocity)), fmt="%.17g")
        command = [
            octave,
            "--norc",
            "--quiet",
            str(FOLDER / "spa.m"),
            str(given),
            str(found),
            str(lag),
            repr(rate_hz),
        ]
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=100)
        if done.returncode or not found.exists():
            raise RuntimeError(f"{REMEDY}; it said: {done.stderr.strip()[:300]}")
        return np.loadtxt(found)


def make_golden(
    n_samples: int = 500, lag: int = 40, rate_hz: float = 4000.0, seed: int = 5
) -> None:
    """Write golden.json: the record and the result of octave."""
    force, velocity = record(n_samples, seed)
    columns = spa_by_octave(force, velocity, lag, rate_hz)
    golden = {
        "lag": lag,
        "rate_hz": rate_hz,
        "force": force.tolist(),
        "velocity": velocity.tolist(),
        "columns": columns.T.tolist(),
    }
    GOLDEN.write_text(json.dumps(golden, indent=None, separators=(",", ":")) + "\n")


if __name__ == "__main__":
    make_golden()
