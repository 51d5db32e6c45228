"""Compiled kernels on disk, and the coefficients that they take.

Kernels (`kernel`). They are generated once per shape, compiled once per machine, then loaded in a
fraction of a second. Their folder is $XDG_CACHE_HOME/hapticd/kernels-VERSION (~/.cache without it).
A kernel is k_HASH.py there, imported through sys.path, because numba's own disk cache requires this
to find compiled code again. HASH covers the text and the law it calls. `_called` must read every
file that kernels are compiled from (an old kernel would otherwise be loaded again).

Coefficients (`plant_numbers`, `law_numbers`). A model at a level of active damping, an environment
and trials become numbers by the names that the text uses (`source`). Every map is exact
(`model.discrete`). The kernel selects its coefficients by name. A name here that the text does not
use is ignored; a name that the text uses and that is missing here stays 0.
"""

import hashlib
import importlib
import os
import sys
import threading
from collections.abc import Iterator
from functools import cache, lru_cache
from pathlib import Path
from types import ModuleType

import numpy as np

from hapticd import __version__
from hapticd.core.arrays import Floats
from hapticd.core.environment import Environment, FilterParams
from hapticd.core.errors import ConfigError
from hapticd.core.extras import need
from hapticd.core.units import PROBE_RATE_HZ
from hapticd.model.discrete import discretise, drive_response_s
from hapticd.model.friction import reach
from hapticd.model.loop import Filters
from hapticd.model.model import DriveLimits, Map, Model
from hapticd.render import law
from hapticd.render.law import Biquad, design, scaled
from hapticd.zwidth.engine import parts
from hapticd.zwidth.engine.shape import Shape, sample_point
from hapticd.zwidth.engine.source import (
    ENDS,
    FILTERS,
    FURTHER_NAMES,
    ROTOR_LAWS,
    WALL,
    kernel_source,
)


@cache
def kernel(shape: Shape) -> ModuleType:
    """Return the module of `shape`: `run`, `plant`, `tally`, ROWS. ConfigError without numba or a
    writable folder.
    """
    need("numba", "the batch engine")
    text = kernel_source(shape)
    digest = hashlib.sha256(text.encode() + _called()).hexdigest()
    name = f"k_{digest[:16]}"
    folder = cache_folder()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / f"{name}.py"
        if not path.exists():
            _write(path, text)
    except OSError as error:
        raise ConfigError(
            f"kernels cannot be kept in {folder}: {error.strerror}; set XDG_CACHE_HOME to a folder"
            " of yours"
        ) from error
    if str(folder) not in sys.path:
        sys.path.append(str(folder))
    importlib.invalidate_caches()
    return importlib.import_module(name)


def cache_folder() -> Path:
    """Return the folder of the kernels."""
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "hapticd" / f"kernels-{__version__}"


@cache
def _called() -> bytes:
    """Return the other sources of a kernel besides its text."""
    paths = (Path(law.__file__), Path(parts.__file__), Path(__file__).with_name("compiled.py"))
    return b"".join(path.read_bytes() for path in paths)


def _write(path: Path, text: str) -> None:
    """Write atomically: other processes and threads may be writing the same kernel."""
    fresh = path.with_name(f"{path.name}.{os.getpid()}-{threading.get_ident()}")
    fresh.write_text(text)
    fresh.replace(path)


# --- coefficients ---------------------------------------------------------------------------------
NUMBERS = 256  # cached sets of coefficients: levels on the way to a wall, for several trials
UNFILTERED: Biquad = (1.0, 0.0, 0.0, 0.0, 0.0)


@lru_cache(maxsize=NUMBERS)
def plant_numbers(model: Model, shape: Shape, level_ns_per_m: float) -> dict[str, float]:
    """Return all numbers that depend on the plant, at this active damping; do not change them."""
    duration_s = 1.0 / (PROBE_RATE_HZ * shape.substeps)
    whole = discretise(model, duration_s, level_ns_per_m)
    numbers = dict(_map_rows(model, whole))
    numbers |= dict(_friction_rows(model, whole))
    numbers |= _output_rows(model, shape, whole)
    numbers |= _rounding(model)
    if model.rotor_forces:
        numbers |= _rotor_rows(model, duration_s)
    if model.drive is not None:
        numbers |= _drive_rows(model.drive, model.inputs.amplifier, whole)
    if model.ends is not None:
        numbers |= {"STOP_UP": model.ends.upper_m, "STOP_DOWN": model.ends.lower_m}
    return numbers


def law_numbers(environment: Environment, filters: Filters, rate_hz: float) -> dict[str, float]:
    """Return the inputs of the law other than K, B, M and the limit."""
    wall = environment.wall
    ends = environment.workspace
    values = (
        *_derivative(filters[0], rate_hz, rate_hz),
        *_derivative(filters[1], rate_hz, rate_hz**2),
        *(wall.stiffness_n_per_m, wall.virtual_damping_ns_per_m, wall.position_m, float(wall.side)),
        *environment.further,
        *(ends.lower_m, ends.upper_m, ends.stiffness_n_per_m),
    )
    return dict(zip((*FILTERS, *WALL, *FURTHER_NAMES, *ENDS), values, strict=True))


def _derivative(filtered: FilterParams | None, rate_hz: float, gain: float) -> Biquad:
    """Return the filter from differences to a derivative, with gain only for None."""
    through = filtered and design(
        filtered.frequency_hz, filtered.damping_ratio, filtered.mapping, rate_hz
    )
    return scaled(through or UNFILTERED, gain)


def _map_rows(model: Model, whole: Map) -> Iterator[tuple[str, float]]:
    place = model.inputs
    columns = {"G": place.command, "T": place.torque, "E": place.estimate, "Z": place.rotor_force}
    for i, row in enumerate(whole.a):
        yield from _named(f"A{i}_", row).items()
        yield from (
            (f"{letter}{i}", float(whole.b[i, column]))
            for letter, column in columns.items()
            if column is not None
        )
        if place.estimate is not None:
            yield f"D{i}", float(whole.b[i, place.estimate]) * model.estimate_offset_m_per_s


def _friction_rows(model: Model, whole: Map) -> Iterator[tuple[str, float]]:
    """Yield for each contact, per m/s that it takes from its own body: H, its effect on the states,
    and LEVEL, its maximum.
    """
    contacts = model.contacts
    own = _own_responses(model, whole)
    for c, contact in enumerate(contacts):
        yield f"LEVEL{c}", contact.level_n * float(own[c])
        yield from _named(f"H{c}_", -whole.b[:, contact.column] / own[c]).items()
    if len(contacts) == 2:
        bodies = [contact.velocity for contact in contacts]
        response = whole.b[np.ix_(bodies, [contact.column for contact in contacts])]
        inverse = np.linalg.inv(response) * own[1]
        yield from _named("W1", inverse[1]).items()


def _own_responses(model: Model, whole: Map) -> Floats:
    """Return the m/s (contacts,) that a newton on each contact gives its own body over `whole`."""
    return np.array([whole.b[contact.velocity, contact.column] for contact in model.contacts])


def _output_rows(model: Model, shape: Shape, whole: Map) -> dict[str, float]:
    outputs = model.outputs
    place = model.inputs
    level = whole.active_damping_ns_per_m
    rows = _named("TRAVEL", outputs.recorded_travel.row(level)) | _named(
        "MOTOR", outputs.motor_force.row(level)
    )
    rows["MOTOR_U"] = float(outputs.motor_force.through(level)[place.command])
    if outputs.recorded_impulse is not None:
        rows |= _named("IMPULSE", outputs.recorded_impulse.row(level))
    encoder = outputs.encoder.row(level)
    if not shape.sample_inside:
        return rows | _named("R", encoder)
    share = sample_point(model.delay_periods, shape.steps)[1]
    part = discretise(model, whole.duration_s * share, level)
    through = encoder @ part.b
    rows |= _named("R", encoder @ part.a)
    columns = {
        "RU": place.command,
        "RT": place.torque,
        "RE": place.estimate,
        "RZ": place.rotor_force,
    }
    rows |= {name: float(through[column]) for name, column in columns.items() if column is not None}
    if model.drive is not None:
        own = drive_response_s(model.drive, place.amplifier, whole)
        rows["RY"] = float(through[place.amplifier]) / own
    touched = through[[contact.column for contact in model.contacts]]
    rows |= _named("RH", -touched / _own_responses(model, whole))
    if place.estimate is not None:
        rows["RD"] = rows["RE"] * model.estimate_offset_m_per_s
    return rows


def _rounding(model: Model) -> dict[str, float]:
    rows: dict[str, float] = {}
    if model.encoder_quantum_m is not None:
        rows |= {"COUNT": model.encoder_quantum_m, "COUNTS": 1.0 / model.encoder_quantum_m}
    if model.force_quantum_n is not None:
        rows |= {"FORCE_COUNT": model.force_quantum_n, "FORCE_COUNTS": 1.0 / model.force_quantum_n}
    if model.force_limit_n is not None:
        rows["LIMIT"] = model.force_limit_n
    return rows


def _rotor_rows(model: Model, duration_s: float) -> dict[str, float]:
    """Return the travel of the rotor to the middle of a sub-step, per velocity, and the numbers of
    the laws.
    """
    rows = {"REACH": 0.5 * duration_s}
    for place, force in enumerate(model.rotor_forces):
        rows |= _named(f"PULL{place}_", np.array(ROTOR_LAWS[force.law].numbers(*force.numbers)))
    return rows


def _drive_rows(limits: DriveLimits, column: int | None, whole: Map) -> dict[str, float]:
    """Return the range of the motor force, and Y: the effect of a newton taken from it."""
    own = drive_response_s(limits, column, whole)
    can = reach(limits, whole.duration_s)
    return {
        "MOST": limits.limit_n,
        "KEEP": can.keep,
        "DRAG": can.drag_ns_per_m,
        "WIDTH": can.width_n,
        **_named("Y", whole.b[:, column] / own),
    }


def _named(letter: str, row: Floats) -> dict[str, float]:
    return {f"{letter}{index}": float(value) for index, value in enumerate(row)}
