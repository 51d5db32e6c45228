"""The trials as files: formats of a record, and the place of the truth.

trial-NN.csv.gz   a header line with columns and units, metadata as remarks, a sample a line
trial-NN.npz      the same columns and metadata as arrays; without times, which the rate gives
truth.json        the truth of each trial; no other file contains it LICENSE, README.txt

Columns are `time_s`, `perturbation_n` (the force of the probe on the device) and `velocity_m_per_s`
(of the port, its mean over the sample). Their sampling rate is 4 kHz, as in the paper. At 12.288 s
(twelve periods of the window's grid) both forms of thirty trials stay below 20 MB. The paper took
90 s, so estimators have less data. Force is rounded to 1 mN and velocity to 10 um/s, far below the
effect of the perturbation.

The same trial gives the same bytes on one machine and one version of numba, numpy and zlib. The
content of a file does not depend on the time and place of its creation.

Limitations: another release of the compiler. Motion with friction is chaotic, so a trial may then
have another noise of the same kind, and the same truth.
"""

import gzip
import io
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np

from examples.trials.plan import SECONDS, TrialSpec, truth_json
from hapticd.core.arrays import Floats
from hapticd.core.errors import ConfigError
from hapticd.zwidth.engine.batch import simulate
from hapticd.zwidth.sources import SUBSTEPS
from hapticd.zwidth.store import Progress, Steps, silent

__all__ = ["FORCE", "METADATA", "TRUTH", "VELOCITY", "make", "recorded", "write_trial"]

RATE_HZ = 4000.0
FORCE, VELOCITY = "perturbation_n", "velocity_m_per_s"
DECIMALS = 3, 5  # of them
METADATA = (
    "rate_hz",
    "stiffness_n_per_m",
    "virtual_damping_n_s_per_m",
    "mass_kg",
    "active_damping_n_s_per_m",
)
TRUTH = "truth.json"
LICENSE = Path(__file__).parent / "LICENSE"
ABOUT = """Recorded trials of simulated one-axis haptic displays

A display renders a stiffness K, a virtual damping B and a mass M. A probe shakes it with white
noise while force and velocity are recorded at the port. Is the display passive from 2 to 500 Hz?

perturbation_n      force of the probe on the device, N
velocity_m_per_s    velocity of the port, m/s, mean over each sample
time_s              s; the sampling rate is 4000 Hz

The position of the port is the sum of velocity_m_per_s / 4000. Z = force / velocity; it is passive
where Re Z >= 0. K, B, M and active damping are those that the experimenter asked for. The devices
differ, and are not named.

truth.json has the answers. Look at it when you have written your verdicts:

trial,verdict,margin_n_s_per_m,margin_low_n_s_per_m,margin_high_n_s_per_m
trial-01,passive,0.4,0.1,0.7

verdict: passive, not_passive (also of an unstable trial) or undecided. The margin is the least Re Z
from 2 to 500 Hz. Margins and their limits may be left out. `python -m examples.trials score` of
hapticd compares them with the truth.

Licence: CC0 1.0 (LICENSE).
"""


def make(
    folder: Path, chosen: tuple[TrialSpec, ...], seconds: float = SECONDS, tell: Progress = silent
) -> list[Path]:
    """Write the trials `chosen` of that length [s], their truth and description; return the paths
    of all files. ConfigError if the folder is not writable, or numba is not installed.
    """
    steps = Steps(tell, len(chosen))
    try:
        folder.mkdir(parents=True, exist_ok=True)
        files = [*said(folder, chosen)]
        for spec in chosen:
            steps.next(spec.name)
            files += write_trial(folder, spec, *recorded(spec, seconds))
    except OSError as error:
        raise ConfigError(
            f"{folder}: {error.strerror}; name a folder that you may write to"
        ) from error
    steps.end()
    return files


def said(folder: Path, chosen: tuple[TrialSpec, ...]) -> tuple[Path, ...]:
    """Write truth, licence and description."""
    truth, about = folder / TRUTH, folder / "README.txt"
    truth.write_text(json.dumps(truth_json(chosen), indent=1) + "\n")
    about.write_text(ABOUT)
    return truth, about, Path(shutil.copyfile(LICENSE, folder / LICENSE.name))


def recorded(spec: TrialSpec, seconds: float) -> tuple[Floats, Floats]:
    """Return force [N] and velocity [m/s] (N,) of the trial at 4 kHz, as written."""
    found = simulate(
        spec.scene,
        [spec.rendered],
        seconds,
        spec.seed,
        active_damping=spec.active_damping_ns_per_m,
        excitation=spec.excitation,
        substeps=SUBSTEPS,
        keep="records",
    )
    force, velocity = (
        np.asarray(np.round(channel, digits) + 0.0, np.float64)  # no -0
        for channel, digits in zip(found.record(0), DECIMALS, strict=True)
    )
    return force, velocity


def write_trial(folder: Path, spec: TrialSpec, force_n: Floats, velocity: Floats) -> list[Path]:
    """Write force [N] and velocity [m/s] (N,) as CSV and npz; return their paths."""
    values = (RATE_HZ, *spec.environment, spec.active_damping_ns_per_m)
    metadata = dict(zip(METADATA, values, strict=True))
    text, arrays = folder / f"{spec.name}.csv.gz", folder / f"{spec.name}.npz"
    lines = csv(metadata, force_n, velocity).encode()
    text.write_bytes(gzip.compress(lines, compresslevel=9, mtime=0))
    columns = {FORCE: force_n.astype(np.float32), VELOCITY: velocity.astype(np.float32)}
    content: dict[str, Any] = {**columns, **metadata}
    np.savez_compressed(arrays, **content)
    return [text, arrays]


def csv(metadata: dict[str, float], force_n: Floats, velocity: Floats) -> str:
    """Return the columns as text."""
    out = io.StringIO()
    out.write(f"time_s,{FORCE},{VELOCITY}\n")
    out.writelines(f"# {name} = {value:g}\n" for name, value in metadata.items())
    columns = np.column_stack((np.arange(force_n.size) / RATE_HZ, force_n, velocity))
    np.savetxt(out, columns, ("%.5f", *(f"%.{digits}f" for digits in DECIMALS)), ",")
    return out.getvalue()
