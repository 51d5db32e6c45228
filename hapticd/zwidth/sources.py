"""Sources of a trial's record, properties of a scene for procedures, and the stepped sine.

Sources (`Source`). The batch engine (`simulated`), a file and a daemon (`live`) return a
`TrialRecord`.

An existing record (`watched`) is passed to the monitor second by second, as a daemon would send it.
It is cut where the monitor would have ended the trial.

Environment (`given`). One rule for all sources selects the rendered environment from the typed
values, the scene and the record. Omitted values of K, B and M are those of an explicitly named
scene, otherwise 0: K = 500 N/m alone does not imply the B and M of a scene that was not named. If
all three are omitted, the environment is that of the record, otherwise of the scene, otherwise 0.
The active damping is a property of the device's drive: unless typed, it is the record's, otherwise
the scene's.

A typed environment must be that of the file's record; only this package's own files contain theirs.

Scenes (`Display`). A procedure needs the impedance of a scene in many environments. `Display` is
the device of a scene, composed once, with all predictions.

Z is measured as in the paper (noise at the probe, `signal.spectra`) on frequencies evenly spaced in
ln f. They are on the grid of the paper's window, so the grid of a longer window contains them too.

A prediction and the trials compared with it must have the same perturbation.

Stepped sine (`stepped_sine`). It is an independent measurement of an impedance, one frequency after
the other, without spectral estimation. At each frequency the probe plays one sine, and the first
second is left out. Z is the ratio of the two channels' Fourier sums over whole seconds. Frequencies
are whole hertz, so whole seconds hold whole periods and nothing leaks. On a linear device it must
agree with noise. With Coulomb friction a sine of the same rms sees a different equivalent damping
(4/pi Fc/V instead of sqrt(2/pi) Fc/sigma). The two then differ, and both are right for their
amplitude.

Limitations: a loop that rings for longer than the second that is left out.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import lru_cache
from math import inf, nan
from pathlib import Path

import numpy as np

from hapticd.core.arrays import Complexes, Flags, Floats
from hapticd.core.environment import Environment
from hapticd.core.errors import AnalysisError, ConfigError
from hapticd.core.units import DEFAULT_BAND_HZ, PROBE_RATE_HZ
from hapticd.model.compose import compose
from hapticd.model.linearise import Perturbation
from hapticd.model.loop import Filters
from hapticd.model.model import Model
from hapticd.model.predict import Prediction, predict, recorded_impedances
from hapticd.model.scene import Excitation, Scene
from hapticd.settings.build import device_effects, rigid_effects
from hapticd.settings.config import validated
from hapticd.settings.device import DeviceFile
from hapticd.settings.load import find_config, find_device
from hapticd.settings.toml import Document, read, shipped
from hapticd.signal.spectra import DEFAULT_LAG
from hapticd.zwidth.store import EndReason, Progress, Steps, TrialRecord, silent
from hapticd.zwidth.watch import TrialMonitor, Watch

__all__ = [
    "NOISE",
    "SATURATED",
    "SUBSTEPS",
    "Display",
    "ReferenceSines",
    "Source",
    "Trial",
    "device_file",
    "device_scene",
    "display",
    "file_source",
    "frequencies",
    "given",
    "may_follow",
    "scene_of_device",
    "stepped_sine",
]

# --- scenes ---------------------------------------------------------------------------------------
TRIAL_S = 90.0
NOISE = Excitation("noise")  # the paper's perturbation
FREQUENCIES = 60
# per 4 kHz sample: error below the random error of a 90 s trial (docs/development/accuracy.md)
SUBSTEPS = 4
SATURATED = 1.0 - 1e-6  # of the force limit: float32 rounds it


@dataclass(frozen=True, eq=False)
class Display:
    """A scene's device with its environment's filters, under the perturbation of its trials; made
    by `display`.

    Passive means passive by the paper's rule at that perturbation. Much of a device's damping may
    be dry friction, which fades as the motion grows; `dry=False` therefore requires passivity
    without it, at any amplitude.
    """

    scene: Scene
    excitation: Excitation
    model: Model = field(repr=False)

    @property
    def filters(self) -> Filters:
        """The filters of velocity and acceleration."""
        return self.scene.environment.filters

    @property
    def perturbation(self) -> Perturbation:
        """The perturbation of its trials."""
        return Perturbation(self.excitation.psd_n2_per_hz, self.excitation.band_hz)

    @property
    def force_limit_n(self) -> float:
        """The force at which its command saturates [N]; inf without a limit."""
        return self.model.force_limit_n or inf

    def predicted(
        self,
        points: Floats,
        level: float,
        band_hz: tuple[float, float] = DEFAULT_BAND_HZ,
        dry: bool = True,
    ) -> Prediction:
        """Predict environments (N, 3) at a damping level [N s/m]; `dry`: with the friction at the
        perturbation, and as the trials record it.
        """
        return predict(
            self.model,
            points,
            level,
            self.filters,
            self.perturbation if dry else None,
            band_hz,
            recorded=dry,
        )

    def passive(
        self,
        points: Floats,
        level: float,
        band_hz: tuple[float, float] = DEFAULT_BAND_HZ,
        dry: bool = True,
    ) -> Flags:
        """Return (N,) at the perturbation; without `dry` also at any larger one."""
        found = self.predicted(points, level, band_hz).passive
        return (
            found
            if dry or not found.any()
            else found & self.predicted(points, level, band_hz, dry=False).passive
        )

    def impedances(self, points: Floats, level: float, frequency_hz: Floats) -> Complexes:
        """Return Z (N, F) [N s/m] of environments (N, 3) at `frequency_hz` (F,) as recorded."""
        return recorded_impedances(
            self.model, points, frequency_hz, level, self.filters, self.perturbation
        )


@lru_cache(maxsize=64)
def display(scene: Scene, excitation: Excitation | None = None) -> Display:
    """Return the scene's device, composed once, under `excitation`, by default its own noise.
    ConfigError as `compose`.
    """
    return Display(scene, excitation or scene.noise, _composed(scene))


_composed = lru_cache(maxsize=64)(compose)


def frequencies(band_hz: tuple[float, float] = DEFAULT_BAND_HZ, count: int = FREQUENCIES) -> Floats:
    """Return about `count` frequencies (F,) [Hz] inside the band, evenly in ln f, on the grid of
    the paper's window.
    """
    spacing = 0.5 * PROBE_RATE_HZ / DEFAULT_LAG
    first = np.ceil(band_hz[0] / spacing)
    last = np.floor(band_hz[1] / spacing)
    return np.asarray(np.unique(np.round(np.geomspace(first, last, count))) * spacing)


def device_scene(name: str) -> Scene | None:
    """Return the scene of the device file `name`; None if there is no such file, or it cannot be
    simulated.
    """
    try:
        document = _device_document(name)
    except ConfigError:
        return None
    if "device" in document.data:  # it refers to a device, so it is a scene
        return None
    device = validated(DeviceFile, document.data, document.where)
    effects = rigid_effects(device) or device_effects(device)
    if not effects:
        return None
    return Scene(
        document.path.stem,
        device.name,
        document.path.stem,
        effects,
        excitation=Excitation("noise"),
        seconds=TRIAL_S,
    )


def device_file(name: str) -> DeviceFile:
    """Return the device file `name`. ConfigError if it is missing or invalid."""
    document = _device_document(name)
    return validated(DeviceFile, document.data, document.where)


def _device_document(name: str) -> Document:
    return read(find_device(name, shipped("config") / "hapticd.toml", "device"))


def scene_of_device(title: str) -> Scene | None:
    """Return the scene of the device file that gives its device this name, from the configuration
    or otherwise from the shipped files; None if there is none, or it cannot be simulated.
    """
    shipped_files = sorted((shipped("config") / "devices").glob("*.toml"))
    for path in (*_configured(), *shipped_files):
        if read(path).data.get("name") == title:
            return device_scene(str(path))
    return None


def _configured() -> tuple[Path, ...]:
    """Return the device file of the configuration, if both exist."""
    try:
        document = read(find_config())
        return (find_device(str(document.data.get("device")), document.path, "device"),)
    except ConfigError:
        return ()


# --- sources --------------------------------------------------------------------------------------
LEAST_KEPT_S = 8.0
NAMES = (("K", "N/m"), ("B", "N s/m"), ("M", "kg"))
Typed = tuple[float | None, float | None, float | None]  # K [N/m], B [N s/m], M [kg]
SAME = 1e-6  # relative


@dataclass(frozen=True, slots=True)
class Trial:
    """The request to a source: K [N/m], B [Ns/m], M [kg], active damping [Ns/m], length,
    perturbation with its seed.
    """

    environment: tuple[float, float, float] = (0.0, 0.0, 0.0)
    active_damping_ns_per_m: float = 0.0
    seconds: float = 90.0
    excitation: Excitation = NOISE
    watch: Watch = field(default_factory=Watch)
    waveform_n: Floats | None = field(
        default=None, compare=False
    )  # at 4 kHz, repeated; in place of the excitation
    mark: bool = False  # the perturbation begins with one (`excitation.marked`), before the record


Source = Callable[[Trial, Progress], TrialRecord]


def file_source(recorded: TrialRecord) -> Source:
    """Return the record of a file for any request; environment and damping are then those that the
    user gives.
    """
    return lambda trial, tell: watched(recorded, trial.watch)


def watched(
    whole: TrialRecord, watch: Watch, winding_c: float = nan, command_n: Floats | None = None
) -> TrialRecord:
    """Return `whole` up to where the monitor would have ended it. `command_n` (ticks,): magnitudes
    of the commands.
    """
    monitor = TrialMonitor(watch, whole.rate_hz)
    second = round(whole.rate_hz)
    total = whole.force_n.size
    for start in range(0, total, second):
        part = slice(start, start + second)
        ticks = (
            np.zeros(1)
            if command_n is None
            else command_n[start * len(command_n) // total : part.stop * len(command_n) // total]
        )
        if monitor.see(
            whole.force_n[part],
            whole.velocity_m_per_s[part],
            winding_c,
            float(ticks.max(initial=0.0)),
        ):
            break
    if not monitor.ended:
        return whole
    kept = max(
        round(LEAST_KEPT_S * whole.rate_hz), round(monitor.seconds * whole.rate_hz)
    )  # judge at least this much of an existing record
    return replace(
        whole,
        force_n=whole.force_n[:kept],
        velocity_m_per_s=whole.velocity_m_per_s[:kept],
        ended=monitor.ended,
    )


def given(
    typed: Typed,
    active_damping_ns_per_m: float | None,
    scene: Scene | None,
    named: bool,
    recorded: TrialRecord | None = None,
) -> Environment:
    """Return the rendered environment; `named`: the user named `scene`. AnalysisError if a record
    was made in another environment than the typed one.
    """
    stated = recorded.rendered if recorded else None
    if stated is not None:
        _agrees(recorded.origin if recorded else "", typed, active_damping_ns_per_m, stated)
        return stated
    others = Environment().free
    if scene and (named or typed == (None, None, None)):
        others = scene.environment.free
    free = [other if own is None else own for own, other in zip(typed, others, strict=True)]
    active = active_damping_ns_per_m
    if active is None:
        active = scene.level_ns_per_m if scene else 0.0
    return Environment(active_damping_ns_per_m=active).with_free(free)


def _agrees(
    origin: str, typed: Typed, active_damping_ns_per_m: float | None, stated: Environment
) -> None:
    every = zip(
        (*NAMES, ("active damping", "N s/m")),
        (*typed, active_damping_ns_per_m),
        (*stated.free, stated.active_damping_ns_per_m),
        strict=True,
    )
    for (name, unit), said, known in every:
        if said is not None and abs(said - known) > SAME * abs(known):
            raise AnalysisError(
                f"{origin}: recorded in {name} = {known:g} {unit}, not {said:g} {unit}: leave"
                " that out"
            )


# --- the stepped sine -----------------------------------------------------------------------------
FREQUENCIES_HZ = (3.0, 5.0, 8.0, 13.0, 21.0, 34.0, 55.0, 89.0, 144.0, 233.0, 377.0, 480.0)
DWELL_S = 4.0
TRANSIENT_S = 1.0
HARMLESS = (EndReason.ESCAPE, EndReason.SATURATION, EndReason.DECIDED)
FORCE_N = 0.2  # rms, as that of the paper's noise


@dataclass(frozen=True, eq=False)
class ReferenceSines:
    """Z (F,) complex128 [N s/m] at `frequency_hz` (F,); nan where the trial ended early. `force_n`
    is the rms of each sine, `velocity_rms_m_per_s` (F,) that of the motion, all frequencies
    together.
    """

    frequency_hz: Floats
    impedance_ns_per_m: Complexes
    force_n: float
    velocity_rms_m_per_s: Floats


def stepped_sine(
    trial: Trial,
    source: Source,
    tell: Progress = silent,
    frequency_hz: tuple[float, ...] = FREQUENCIES_HZ,
    force_n: float = FORCE_N,
) -> ReferenceSines:
    """Measure Z of the environment of `trial` at whole frequencies, a short trial each."""
    steps = Steps(tell, len(frequency_hz))
    count = len(frequency_hz)
    z = np.full(count, np.nan, np.complex128)
    speed = np.full(count, np.nan)
    for place, f in enumerate(frequency_hz):
        steps.next(f"sine of {f:g} Hz")
        wave = (
            np.sqrt(2.0)
            * force_n
            * np.sin(2.0 * np.pi * f * np.arange(PROBE_RATE_HZ) / PROBE_RATE_HZ)
        )
        recorded = source(replace(trial, waveform_n=wave, seconds=DWELL_S), silent)
        if not recorded.ended:
            force, velocity = _settled(recorded)
            turn = np.exp(-2j * np.pi * f * np.arange(force.size) / recorded.rate_hz)
            z[place] = (force @ turn) / (velocity @ turn)
            speed[place] = np.std(velocity)
        if not may_follow(recorded):
            break
    steps.end()
    return ReferenceSines(np.asarray(frequency_hz, np.float64), z, force_n, speed)


def may_follow(recorded: TrialRecord) -> bool:
    """Whether another trial may follow: not after a disable or a change by another client, nor with
    a hot winding.
    """
    ended = recorded.ended
    return ended is None or ended.reason in HARMLESS


def _settled(recorded: TrialRecord) -> tuple[Floats, Floats]:
    """Force and velocity of the whole seconds at the end, both (n,)."""
    count = round(int(recorded.seconds - TRANSIENT_S) * recorded.rate_hz)
    return recorded.force_n[-count:], recorded.velocity_m_per_s[-count:]
