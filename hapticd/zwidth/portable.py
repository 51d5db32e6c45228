"""Results for others: the file NAME.zwidth, and Z(f) for the tools of control engineering.

NAME.zwidth (`portable`). It is one display's Z-width in a small JSON file, to pass on and to
compare with others. It holds the envelopes with their owners and uncertainty, the axis limits,
their conditions, and the hash of the device file: a file edited since then is another device. If
the rig has a certificate, the file names it, and whether the device file had changed since.

Comparison (`compare`). It reads several such files, checks that they are comparable, and divides by
the moving mass. Numbers of two displays are comparable under equal conditions: band, judged
frequencies, perturbation, length of a trial, confidence, port and estimator. Differences are
refused by name unless allowed, and an allowed difference is named with the result. The perturbation
counts as alike if its force is the same, or the same per mass (`zwidth.compare`).

Limitations: a device file edited without a new name; the hash shows it only to users with the older
file.

Z(f) (`write_response`). Z of a trial is written with its interval, for one of these tools:

    npz   python-control:  d = numpy.load("trial.npz")
                           control.FrequencyResponseData(d["response"], d["omega_rad_per_s"])
    mat   MATLAB, Octave:  load trial.mat; sys = frd(response, omega_rad_per_s)
    csv   a line for each frequency, the units in the header

The interval is that of Re Z: |Z| q s on each side, with the relative deviation s of `impedance`.
Student's q is at the confidence of the verdict for all frequencies together (Sidak). The interval
covers the random errors that the intervals of the verdict cover, without the error of a fit
(`resolved`).

The minimum Re Z over the band is the input feedforward passivity index of control theory, here of
the band alone: nu = min lambda_min(Z + Z^H) / 2. Each of these tools can compute it again.

Frequencies without a value are omitted, and so is 0 Hz.
"""

import hashlib
import json
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from math import nan
from pathlib import Path
from typing import Any, Literal

import numpy as np

from hapticd.core.arrays import Floats
from hapticd.core.errors import AnalysisError, ConfigError
from hapticd.core.extras import need
from hapticd.settings.load import find_device
from hapticd.settings.toml import SAMPLES_BYTES, read, regular, shipped
from hapticd.signal.impedance import spread_of
from hapticd.signal.verdict import Judged, half_width, sidak
from hapticd.zwidth import outcomes
from hapticd.zwidth.compare import (
    EnvelopeConditions,
    check_alike,
    normalised,
    stiffness_damping_area,
    stiffness_rate,
    zero_mass_bandwidth_hz,
)
from hapticd.zwidth.map import LevelMap
from hapticd.zwidth.passive_set import AXES, Edge, Envelope
from hapticd.zwidth.sources import Display
from hapticd.zwidth.store import csv_text, to_json
from hapticd.zwidth.trial import TrialResult

__all__ = [
    "SUFFIX",
    "Comparison",
    "compare",
    "conditions_of",
    "device_hash",
    "device_path",
    "numbers_of",
    "portable",
    "write_response",
]

SUFFIX = ".zwidth"
VERSION = 1
EDGES = ("upper", "lower", "phase_upper", "phase_lower")
NUMBERS = ("stiffness_damping_area", "stiffness_rate_per_s", "zero_mass_bandwidth_hz")


def device_path(name: str) -> Path:
    """Return the path of the shipped device file `name`, of the device file `name`, or of the
    device file that the scene file `name` refers to. ConfigError if there is none.
    """
    path = Path(name)
    if path.suffix != ".toml":
        return find_device(name, shipped("config") / "hapticd.toml", "device")
    named = read(path).data.get("device")
    return find_device(named, path, f"{path}: device") if named else path


def device_hash(name: str) -> str:
    """Return the SHA-256 (hex) of the device file that `device_path` finds."""
    return hashlib.sha256(device_path(name).read_bytes()).hexdigest()


def portable(
    device: str,
    file_hash: str,
    envelopes: Iterable[tuple[float, Envelope | None]],
    limits: Iterable[Any],
    conditions: Any,
    numbers: Iterable[Any] = (),
    certificate: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Return the content of such a file, as JSON: `envelopes` by active damping [Ns/m], in SI
    units. `certificate`: description of the rig's.
    """
    drawn = [
        {"active_damping_ns_per_m": level, "envelope": found}
        for level, found in envelopes
        if found is not None
    ]
    return {
        "zwidth": VERSION,
        "device": device,
        "device_file_sha256": file_hash,
        "certificate": to_json(certificate),
        "conditions": to_json(conditions),
        "limits": to_json(list(limits)),
        "envelopes": to_json(drawn),
        "numbers": to_json(list(numbers)),
    }


def numbers_of(level: LevelMap, display: Display) -> dict[str, float]:
    """Return the usual single numbers of a display, from its map at one level; its zero-mass
    bandwidth is predicted.
    """
    f = outcomes.kept_frequencies()
    free = display.impedances(np.zeros((1, 3)), level.active_damping_ns_per_m, f)[0]
    return {
        "active_damping_ns_per_m": level.active_damping_ns_per_m,
        "stiffness_damping_area": stiffness_damping_area(level.found),
        "stiffness_rate_per_s": stiffness_rate(level.found, 0.0),
        "zero_mass_bandwidth_hz": zero_mass_bandwidth_hz(f, free),
    }


def conditions_of(conditions: outcomes.Conditions, judged: Judged) -> dict[str, Any]:
    """Return the conditions of all of it, in the form of `zwidth.compare`."""
    model = conditions.display.model
    return {
        "seconds": conditions.seconds,
        "band_hz": conditions.band_hz,
        "judged": judged,
        "perturbation": conditions.excitation,
        "simulated": True,
        "confidence": conditions.confidence,
        "mass_kg": model.mass_kg,
        "probe_mass_kg": model.probe_mass_kg,
        "rate_hz": model.rate_hz,
        "filters_hz": [one.frequency_hz for one in conditions.scene.environment.filters],
        "port": "probe",
        "estimator": "spa",
        "grip": "free",
    }


def read_portable(path: Path) -> dict[str, Any]:
    """Return the content of `path`. ConfigError if it is not such a file."""
    try:
        content = dict(json.loads(regular(path, SAMPLES_BYTES).read_text()))
    except (OSError, ValueError, TypeError) as error:
        raise ConfigError(f"{path}: not a Z-width summary ({error})") from error
    if content.get("zwidth") != VERSION:
        raise ConfigError(
            f"{path}: version {content.get('zwidth')!r} of a Z-width summary; this program reads"
            f" {VERSION}"
        )
    return content


@dataclass(frozen=True, slots=True)
class Reach:
    """The limit of one of K, B, M alone [N/m, N s/m, kg], its interval, and the limit per kg of
    moving mass.
    """

    name: str
    value: float
    lower: float
    upper: float
    per_mass: float


@dataclass(frozen=True, eq=False)
class Level:
    """The data at one active damping [N s/m]: the envelope [N s/m], the same per mass [1/s],
    limits, and the usual single numbers.
    """

    active_damping_ns_per_m: float
    envelope: Envelope
    per_mass: Envelope | None
    limits: tuple[Reach, ...]
    numbers: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class Compared:
    """One display. `name`: the device, with its file if several share a name."""

    name: str
    conditions: EnvelopeConditions
    levels: tuple[Level, ...]


@dataclass(frozen=True, eq=False)
class Comparison:
    """Two displays or more; `unlike`: differences that were allowed, or are alike per force and not
    per mass.
    """

    displays: tuple[Compared, ...]
    unlike: tuple[str, ...]


def compare(paths: Iterable[Path], allow: Collection[str] = ()) -> Comparison:
    """Compare the displays in `paths`. ConfigError for a file that is not a summary; AnalysisError
    for fewer than two, for unlike conditions that are not in `allow`, and for names in `allow` that
    are not conditions.
    """
    files = [(path, *_display(path)) for path in paths]
    if len(files) < 2:
        raise AnalysisError(
            "one display is not a comparison; give at least two files that `hapticd zwidth report`"
            " wrote"
        )
    names = EnvelopeConditions.__dataclass_fields__
    if wrong := set(allow) - set(names):
        raise AnalysisError(
            f"--allow {','.join(sorted(wrong))}: no such condition; known: {', '.join(names)}"
        )
    unlike = check_alike([known for _, known, _ in files], allow)
    devices = [known.device for _, known, _ in files]
    displays = (
        Compared(known.device if devices.count(known.device) == 1 else str(path), known, levels)
        for path, known, levels in files
    )
    return Comparison(tuple(displays), unlike)


def _display(path: Path) -> tuple[EnvelopeConditions, tuple[Level, ...]]:
    content = read_portable(path)
    try:
        known = _conditions(content)
        return known, tuple(_level(content, one, known.mass_kg) for one in content["envelopes"])
    except (KeyError, IndexError, TypeError, ValueError) as error:
        raise ConfigError(
            f"{path}: not a whole Z-width summary ({error!r}); write it again with `hapticd zwidth"
            " report`"
        ) from error


def _conditions(content: Mapping[str, Any]) -> EnvelopeConditions:
    stated = content["conditions"]
    first = content["envelopes"][0]["envelope"]
    own = {
        name: value
        for name, value in stated.items()
        if name in EnvelopeConditions.__dataclass_fields__
    }
    own |= {
        "device": content["device"],
        "port": first["port"],
        "estimator": first["estimator"],
        "band_hz": tuple(stated["band_hz"]),
        "filters_hz": tuple(stated["filters_hz"]),
        "judged_hz": (stated["judged"]["first_hz"], stated["judged"]["last_hz"]),
        "perturbation_psd_n2_per_hz": stated["perturbation"]["psd_n2_per_hz"],
    }
    return EnvelopeConditions(**own)


def _level(content: Mapping[str, Any], drawn: Mapping[str, Any], mass_kg: float) -> Level:
    damping = drawn["active_damping_ns_per_m"]
    found = _envelope(drawn["envelope"])
    numbers: Mapping[str, Any] = next(
        (one for one in content.get("numbers", ()) if one["active_damping_ns_per_m"] == damping), {}
    )
    known = np.array([numbers.get(name) for name in NUMBERS], np.float64)  # null is nan
    return Level(
        damping,
        found,
        normalised(found, mass_kg) if mass_kg > 0.0 else None,
        tuple(_reaches(content["limits"], damping, mass_kg)),
        dict(zip(NUMBERS, known.tolist(), strict=True)),
    )


def _envelope(kept: Mapping[str, Any]) -> Envelope:
    edges = {
        name: Edge(
            np.array(kept[name]["value"], np.float64),
            np.array(kept[name]["sd"], np.float64),
            np.array(kept[name]["owner"]),
        )
        for name in EDGES
    }
    return Envelope(
        frequency_hz=np.asarray(kept["frequency_hz"], np.float64),
        trials=tuple(kept["trials"]),
        port=kept["port"],
        estimator=kept["estimator"],
        kind=kept["kind"],
        **edges,
    )


def _reaches(
    limits: Iterable[Mapping[str, Any]], damping: float, mass_kg: float
) -> Iterable[Reach]:
    for limit in limits:
        scan = limit["scan"]
        if scan["active_damping_ns_per_m"] == damping and scan["amplitude"] == 1.0:
            value, lower, upper = np.array(
                [limit[name] for name in ("value", "lower", "upper")], np.float64
            ).tolist()
            yield Reach(
                AXES[scan["axis"]], value, lower, upper, value / mass_kg if mass_kg > 0.0 else nan
            )


# --- Z(f) for other tools -------------------------------------------------------------------------
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
