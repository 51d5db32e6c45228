"""NAME.zwidth: one display's Z-width in a small JSON file that can be passed on and laid beside others.

It holds the envelopes with their owners and uncertainty, the axis limits, the conditions under which they were found, and the
hash of the device file that they belong to: a file that was edited since is another device.

`compare` reads several of them, checks that they are comparable, and divides by the mass that moves. Numbers of two displays
are comparable where they were asked for in one way: band, judged frequencies, perturbation, length of a trial, confidence, port
and estimator. What is unlike is refused by name unless it was allowed, and an allowed difference is told with the result. The
perturbation counts as alike if its force is the same, or the same per mass (`analysis.compare`).

Files that were written before the judged frequencies were kept have neither them nor the mass: the first and last frequency of
their envelope stand for the one, the device file with their hash, where it is shipped, for the other.
"""

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from math import nan
from pathlib import Path
from typing import Any

import numpy as np

from hapticd.analysis.boundary import AXES, Limits
from hapticd.analysis.compare import Conditions, check_alike, compared, differences, normalised_limits, same_force
from hapticd.analysis.envelope import Edge, Envelope
from hapticd.analysis.metrics import stiffness_damping_area, stiffness_rate, zero_mass_bandwidth_hz
from hapticd.analysis.verdict import Judged
from hapticd.errors import AnalysisError, ConfigError
from hapticd.measure import outcomes
from hapticd.measure.campaign import LevelMap
from hapticd.measure.scenes import Display, device_scene, filters
from hapticd.measure.store import plain
from hapticd.plant.compose import compose
from hapticd.plant.model import Model
from hapticd.settings.document import read
from hapticd.settings.load import find_device
from hapticd.settings.resources import shipped

SUFFIX, VERSION = ".zwidth", 1
EDGES = ("upper", "lower", "phase_upper", "phase_lower")
USUAL = Conditions("", nan)
NUMBERS = ("stiffness_damping_area", "stiffness_rate_per_s", "zero_mass_bandwidth_hz")


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
    f = outcomes.kept_frequencies()
    free = display.impedances(np.zeros((1, 3)), level.damping_ns_per_m, f)[0]
    return {
        "added_damping_ns_per_m": level.damping_ns_per_m,
        "stiffness_damping_area": stiffness_damping_area(level.found),
        "stiffness_rate_per_s": stiffness_rate(level.found, 0.0),
        "zero_mass_bandwidth_hz": zero_mass_bandwidth_hz(f, free),
    }


def conditions_of(conditions: outcomes.Conditions, judged: Judged) -> dict[str, Any]:
    """Under which all of it was found, as `analysis.compare` asks for it, and as older programs read it."""
    model = conditions.display.model
    corners = (one.frequency_hz for one in filters(conditions.scene))
    return {
        "seconds": conditions.seconds, "band_hz": conditions.band_hz, "judged": judged, "perturbation": conditions.excitation,
        "simulated": True, "confidence": conditions.confidence, "mass_kg": model.mass_kg,
        "probe_mass_kg": model.probe_mass_kg, "rate_hz": model.rate_hz,
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


@dataclass(frozen=True, slots=True)
class Reach:
    """How far one of K, B, M goes alone [N/m, N s/m, kg], the interval of that, and the same per kg of moving mass."""

    name: str
    value: float
    lower: float
    upper: float
    per_mass: float


@dataclass(frozen=True, eq=False)
class Level:
    """At one added damping [N s/m]: the envelope [N s/m], the same per mass [1/s], limits, and other people's numbers."""

    damping_ns_per_m: float
    envelope: Envelope
    per_mass: Envelope | None
    limits: tuple[Reach, ...]
    numbers: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class Compared:
    """One display. `name`: the device, with its file where several have one name."""

    name: str
    conditions: Conditions
    levels: tuple[Level, ...]

    @property
    def judged(self) -> str:
        """Where it was judged, in words."""
        first, last = self.conditions.judged_hz
        return f"first judged {first:.3g} Hz, last judged {last:.3g} Hz"


@dataclass(frozen=True, eq=False)
class Comparison:
    """Two displays or more; `unlike`: what differs and was allowed, or is alike per force and not per mass."""

    displays: tuple[Compared, ...]
    unlike: tuple[str, ...]


def compare(paths: Iterable[Path], allow: Iterable[str] = ()) -> Comparison:
    """The displays in `paths`. ConfigError for a file that is no summary; AnalysisError for fewer than two, for conditions that
    are unlike and not in `allow`, and for names in `allow` that are no conditions.
    """
    files = [(path, *_display(path)) for path in paths]
    if len(files) < 2:
        raise AnalysisError("one display is no comparison; name two files that `hapticd zwidth report` wrote, or more")
    devices = [known.device for _, known, _ in files]
    unlike = _checked([known for _, known, _ in files], set(allow))
    displays = (
        Compared(known.device if devices.count(known.device) == 1 else str(path), known, levels) for path, known, levels in files
    )
    return Comparison(tuple(displays), unlike)


def _display(path: Path) -> tuple[Conditions, tuple[Level, ...]]:
    content = read_portable(path)
    try:
        known = _conditions(content)
        return known, tuple(_level(content, one, known) for one in content["envelopes"])
    except (KeyError, IndexError, TypeError, ValueError) as error:
        raise ConfigError(
            f"{path}: not a whole Z-width summary ({error!r}); write it again with `hapticd zwidth report`"
        ) from error


def _checked(known: list[Conditions], allow: set[str]) -> tuple[str, ...]:
    if wrong := allow - set(Conditions.__dataclass_fields__):
        raise AnalysisError(
            f"--allow {','.join(sorted(wrong))}: no such condition; known: {', '.join(Conditions.__dataclass_fields__)}"
        )
    first, unlike = known[0], list[str]()
    for other in known[1:]:
        alike = same_force(first, other)  # on displays of other masses
        check_alike((first, other), {*allow, *alike})
        unlike += [name for name in differences(first, other) if name not in alike]
    return tuple(dict.fromkeys(unlike))


def _conditions(content: Mapping[str, Any]) -> Conditions:
    told, first = content["conditions"], content["envelopes"][0]["envelope"]
    low, high = told["band_hz"]
    inside = [f for f in first["frequency_hz"] if low <= f <= high]
    judged = told.get("judged") or {"first_hz": inside[0], "last_hz": inside[-1]}
    model = None if "mass_kg" in told else _model(content)
    masses = {"mass_kg": model.mass_kg, "probe_mass_kg": model.probe_mass_kg} if model else {}
    known = {**masses, **told}
    return Conditions(
        device=content["device"], mass_kg=known.get("mass_kg", nan), port=first["port"],
        probe_mass_kg=known.get("probe_mass_kg", 0.0), rate_hz=told.get("rate_hz", 1000.0),
        filters=told.get("filters", USUAL.filters), band_hz=(low, high), estimator=first["estimator"],
        grip=told.get("grip", "free"), perturbation_psd_n2_per_hz=told["perturbation"]["psd_n2_per_hz"],
        judged_hz=(judged["first_hz"], judged["last_hz"]), confidence=told.get("confidence", 0.95), seconds=told["seconds"],
        simulated=told["simulated"],
    )  # fmt: skip


def _model(content: Mapping[str, Any]) -> Model | None:
    """Of the shipped device that the file belongs to; None if it is another one."""
    try:
        if device_hash(content["device"]) != content["device_file_sha256"]:
            return None
    except ConfigError:
        return None
    scene = device_scene(content["device"])
    return compose(scene) if scene else None


def _level(content: Mapping[str, Any], drawn: Mapping[str, Any], conditions: Conditions) -> Level:
    damping, found = drawn["added_damping_ns_per_m"], _envelope(drawn["envelope"])
    heavy = conditions.mass_kg > 0.0
    numbers: Mapping[str, Any] = next((one for one in content.get("numbers", ()) if one["added_damping_ns_per_m"] == damping), {})
    return Level(
        damping, found, compared([(conditions, found)])[0][1] if heavy else None,
        tuple(_reaches(content["limits"], damping, conditions.mass_kg if heavy else nan)),
        {name: _number(numbers.get(name)) for name in NUMBERS},
    )  # fmt: skip


def _envelope(kept: Mapping[str, Any]) -> Envelope:
    edges = {name: _edge(kept[name]) for name in EDGES}
    return Envelope(
        frequency_hz=np.asarray(kept["frequency_hz"], np.float64), trials=tuple(kept["trials"]), port=kept["port"],
        estimator=kept["estimator"], kind=kept["kind"], **edges,
    )  # fmt: skip


def _edge(kept: Mapping[str, Any]) -> Edge:
    value, sd = (np.array([_number(one) for one in kept[part]]) for part in ("value", "sd"))
    return Edge(value, sd, np.asarray(kept["owner"], np.int64))


def _reaches(limits: Iterable[Mapping[str, Any]], damping: float, mass_kg: float) -> Iterable[Reach]:
    for limit in limits:
        scan = limit["scan"]
        if scan["damping_ns_per_m"] != damping or scan["amplitude"] != 1.0:
            continue
        value = _number(limit["value"])
        yield Reach(AXES[scan["axis"]], value, _number(limit["lower"]), _number(limit["upper"]), _per_mass(value, mass_kg))


def _per_mass(value: float, mass_kg: float) -> float:
    if not mass_kg > 0.0:
        return nan
    both = (min(0.0, value), max(0.0, value))
    low, high = normalised_limits(Limits(both, both, both), mass_kg).stiffness
    return low + high


def _number(value: Any) -> float:
    return nan if value is None else float(value)
