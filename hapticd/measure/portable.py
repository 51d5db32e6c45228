"""NAME.zwidth: one display's Z-width in a small JSON file that can be passed on and laid beside others.

It holds the envelopes with their owners and uncertainty, the axis limits, the conditions under which they were found, and the
hash of the device file that they belong to: a file that was edited since is another device.
"""

import hashlib
import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from hapticd.analysis.envelope import Envelope
from hapticd.analysis.metrics import stiffness_damping_area, stiffness_rate, zero_mass_bandwidth_hz
from hapticd.analysis.verdict import Judged
from hapticd.errors import ConfigError
from hapticd.measure.campaign import LevelMap
from hapticd.measure.outcomes import Conditions, kept_frequencies
from hapticd.measure.plain import plain
from hapticd.measure.scenes import Display, filters
from hapticd.settings.document import read
from hapticd.settings.load import find_device
from hapticd.settings.resources import shipped

SUFFIX, VERSION = ".zwidth", 1


def device_hash(name: str) -> str:
    """SHA-256 (hex) of the shipped device file `name`, or of the device file that `name` is, or that a scene's file of that name
    names. ConfigError if there is none.
    """
    return hashlib.sha256(_device_file(name).read_bytes()).hexdigest()


def _device_file(name: str) -> Path:
    path = Path(name)
    if path.suffix != ".toml":
        return find_device(name, shipped("config") / "hapticd.toml", "device")
    named = read(path).data.get("device")
    return path if named is None else find_device(named, path, f"{path}: device")


def portable(
    device: str,
    file_hash: str,
    envelopes: Iterable[tuple[float, Envelope | None]],
    limits: Iterable[Any],
    conditions: Any,
    numbers: Iterable[Any] = (),
) -> dict[str, Any]:
    """The content of such a file: `envelopes` by added damping [Ns/m], in SI units."""
    drawn = [{"added_damping_ns_per_m": level, "envelope": found} for level, found in envelopes if found is not None]
    return {
        "zwidth": VERSION,
        "device": device,
        "device_file_sha256": file_hash,
        "conditions": plain(conditions),
        "limits": plain(list(limits)),
        "envelopes": plain(drawn),
        "numbers": plain(list(numbers)),
    }


def numbers_of(level: LevelMap, display: Display) -> dict[str, float]:
    """What others say of a display in one number, of its map at one level; how far it is free as predicted."""
    f = kept_frequencies()
    free = display.impedances(np.zeros((1, 3)), level.damping_ns_per_m, f)[0]
    return {
        "added_damping_ns_per_m": level.damping_ns_per_m,
        "stiffness_damping_area": stiffness_damping_area(level.found),
        "stiffness_rate_per_s": stiffness_rate(level.found, 0.0),
        "zero_mass_bandwidth_hz": zero_mass_bandwidth_hz(f, free),
    }


def conditions_of(conditions: Conditions, judged: Judged) -> dict[str, Any]:
    """Under which all of it was found, as `analysis.compare` asks for it, and as older programs read it."""
    display = conditions.display.model
    corners = (one.frequency_hz for one in filters(conditions.scene))
    return {
        "seconds": conditions.seconds, "band_hz": conditions.band_hz, "judged": judged, "perturbation": conditions.excitation,
        "simulated": True, "confidence": conditions.confidence, "mass_kg": display.mass_kg,
        "probe_mass_kg": display.probe_mass_kg, "rate_hz": display.rate_hz,
        "filters": ", ".join(f"{corner:g} Hz" for corner in corners), "port": "probe", "estimator": "spa", "grip": "free",
    }  # fmt: skip


def write_portable(path: Path, content: Mapping[str, Any]) -> Path:
    """Write it. ConfigError if that cannot be done."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(content) + "\n")
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}; name a folder that you may write to with --out") from error
    return path


def read_portable(path: Path, device: str = "") -> dict[str, Any]:
    """The content of `path`; with `device`, only if it belongs to that device file as it is now. ConfigError else."""
    try:
        content = dict(json.loads(path.read_text()))
    except (OSError, ValueError, TypeError) as error:
        raise ConfigError(f"{path}: no Z-width summary ({error})") from error
    if content.get("zwidth") != VERSION:
        raise ConfigError(f"{path}: version {content.get('zwidth')!r} of a Z-width summary; this program reads {VERSION}")
    if device and content["device_file_sha256"] != device_hash(device):
        raise ConfigError(f"{path}: made with another file of device {device!r}; measure again, or go back to that file")
    return content
