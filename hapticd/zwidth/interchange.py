"""Z(f) of a trial, with its interval, for the tools of control engineering.

    npz   python-control:  d = numpy.load("trial.npz")
                           control.FrequencyResponseData(d["response"], d["omega_rad_per_s"])
    mat   MATLAB, Octave:  load trial.mat; sys = frd(response, omega_rad_per_s)
    csv   a line for each frequency, the units in the header

The interval is that of Re Z: |Z| q s on each side, with the relative deviation s of `impedance` and
Student's q at the confidence of the verdict for all frequencies together (Sidak). It covers the
random errors that the intervals of the verdict cover, without the error of a fit (`resolved`).

The minimum Re Z over the band is the input feedforward passivity index of control theory, here of
the band alone: nu = min lambda_min(Z + Z^H) / 2. Each of these tools can compute it again.

Frequencies without a value are omitted, and so is 0 Hz.
"""

from pathlib import Path
from typing import Any, Literal

import numpy as np

from hapticd.core.arrays import Floats
from hapticd.core.errors import ConfigError
from hapticd.core.extras import need
from hapticd.signal.impedance import spread_of
from hapticd.signal.verdict import half_width, sidak
from hapticd.zwidth.store import csv_text
from hapticd.zwidth.trial import TrialResult

__all__ = ["Format", "frequency_response", "write_response"]

Format = Literal["npz", "mat", "csv"]


def frequency_response(result: TrialResult) -> dict[str, Any]:
    """Return Z over the band of the verdict, by name: `frequency_hz`, `omega_rad_per_s` (F,),
    `response` (F,) complex [N s/m], `real_low_ns_per_m`, `real_high_ns_per_m`, `sd_ns_per_m`,
    `coherence` (F,), and the numbers `confidence`, `passivity_index_ns_per_m`.
    """
    z = result.measured
    low_hz, high_hz = result.verdict.band_hz
    inside = (z.frequency_hz >= max(low_hz, 1e-9)) & (z.frequency_hz <= high_hz)
    use = inside & np.isfinite(z.impedance_ns_per_m)
    response = z.impedance_ns_per_m[use]
    level = sidak(result.verdict.confidence, response.size)
    relative = half_width(z.coherence[use], z.degrees_of_freedom, level)
    half = spread_of(np.abs(response), relative)
    return {
        "frequency_hz": z.frequency_hz[use],
        "omega_rad_per_s": 2.0 * np.pi * z.frequency_hz[use],
        "response": response,
        "real_low_ns_per_m": response.real - half,
        "real_high_ns_per_m": response.real + half,
        "sd_ns_per_m": z.sd_ns_per_m[use],
        "coherence": z.coherence[use],
        "confidence": result.verdict.confidence,
        "passivity_index_ns_per_m": float(response.real.min()),
    }


def write_response(result: TrialResult, path: Path, form: Format) -> Path:
    """Write the response to `path`. ConfigError if it cannot be written; MissingLibrary for a .mat
    file without scipy.
    """
    found = frequency_response(result)
    try:
        if form == "npz":
            np.savez(path, **found)
        elif form == "mat":  # as `frd` takes it: the response 1 x 1 x F, all else in columns
            response = {"response": found["response"].reshape(1, 1, -1)}
            need("scipy.io", "a .mat file").savemat(path, {**found, **response}, oned_as="column")
        else:
            path.write_text(csv_text(_columns(found)))
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}; name a file that you may write") from error
    return path


def _columns(found: dict[str, Any]) -> dict[str, Floats]:
    """Return one column per number, for text."""
    return {
        "frequency_hz": found["frequency_hz"],
        "real_ns_per_m": found["response"].real,
        "imaginary_ns_per_m": found["response"].imag,
        **{name: found[name] for name in ("real_low_ns_per_m", "real_high_ns_per_m")},
        **{name: found[name] for name in ("sd_ns_per_m", "coherence")},
    }
