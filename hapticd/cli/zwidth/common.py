"""Shared parts of the verbs of `zwidth`: options, scenes, conditions, output, and a live device.

Early end (`interruptible`, `keeping`). If a verb ends early, by Ctrl-C or by dead workers, it
prints in one line which results are kept and how to continue.

Live device (`open_rig`, `announce`). It is identified before a trial. Every motion is announced in
advance: the name of the device, whether it is real, and the environment in which it is enabled.
Every exit of the process must leave the device disabled.
"""

import signal
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hapticd.cli import change, terminal
from hapticd.core.errors import ConfigError, HapticdError
from hapticd.core.units import US_PER_S
from hapticd.protocol.limits import CommandLimits, environment_limits

if TYPE_CHECKING:
    from matplotlib.figure import Figure

with terminal.deferred_imports():
    from hapticd.client import client as clients
    from hapticd.guard import safe_region
    from hapticd.model import scene as model_scene
    from hapticd.recording import provenance
    from hapticd.settings import device as device_files
    from hapticd.settings import scene as scene_files
    from hapticd.settings import toml
    from hapticd.zwidth import outcomes, sources, store, watch
    from hapticd.zwidth.report import style

SceneName = Annotated[
    str,
    typer.Option("--scene", metavar="NAME|FILE", help="Device, effects, filters and perturbation."),
]
Out = Annotated[
    Path | None,
    typer.Option(
        "--out",
        metavar="DIR",
        help="Folder for results (default: one in zwidth-runs/, named by date).",
    ),
]
Seconds = Annotated[float, typer.Option("--seconds", metavar="S", help="Length of a trial.")]
Seed = Annotated[int, typer.Option("--seed", min=0, help="Seed of the perturbation.")]
Band = Annotated[
    tuple[float, float],
    typer.Option("--band", metavar="LOW HIGH", help="Judged band, Hz."),
]
Confidence = Annotated[
    float, typer.Option("--confidence", min=0.5, max=0.9999, help="Confidence of the verdict.")
]
Damping = Annotated[
    str,
    typer.Option(
        "--active-damping", metavar="LEVEL[,LEVEL...]", help="Levels of active damping, N s/m."
    ),
]
VirtualStiffness = Annotated[
    float | None, typer.Option("-K", "--stiffness", metavar="N/M", help="Virtual stiffness.")
]
VirtualDamping = Annotated[
    float | None, typer.Option("-B", "--viscous", metavar="NS/M", help="Virtual damping.")
]
VirtualMass = Annotated[
    float | None, typer.Option("-M", "--mass", metavar="KG", help="Virtual mass.")
]
OneDamping = Annotated[
    float | None, typer.Option("--active-damping", metavar="NS/M", help="Active damping.", min=0)
]
Plot = Annotated[
    bool, typer.Option("--plot/--no-plot", help="Draw PNG, SVG and PDF into the run folder.")
]
Where = Annotated[
    str,
    typer.Option(
        "--executor",
        metavar="auto|thread|process|dask://HOST:PORT",
        help=(
            "Executor of trials: threads, one process per core, or the workers of a Dask scheduler"
            " (extra: cluster); auto: processes for a map of thousands of trials, otherwise"
            " threads."
        ),
    ),
]
JsonOutcomes = Annotated[
    bool,
    typer.Option(
        "--json",
        help=(
            "One JSON object per line on stdout: each outcome as it arrives, at last the result"
            " with 'ok'."
        ),
    ),
]


@dataclass(frozen=True, kw_only=True)
class TrialsOptions:
    """Conditions common to many trials: executor, length, noise, and band."""

    where: Where = "auto"
    seconds: Seconds = 90.0
    seed: Seed = 1
    band: Band = (2.0, 500.0)


@dataclass(frozen=True, kw_only=True)
class ResultsOptions:
    """Folder of the results, figures, and the form of the output."""

    out: Out = None
    plot: Plot = True
    figure_width: terminal.FigureWidth = None
    as_json: JsonOutcomes = False


Range = tuple[float, float, int]
RUNS = Path("zwidth-runs")
OUTCOME_FIELDS = (
    "environment",
    "active_damping_ns_per_m",
    "answer",
    "passes",
    "margin_ns_per_m",
    "margin_lower",
    "margin_upper",
    "worst_hz",
    "first_judged_hz",
    "last_judged_hz",
)


@contextmanager
def keeping(kept: "store.TrialStore", folder: Path) -> Iterator[None]:
    """Print which results are kept and how to continue if a run ends early.

    Causes are Ctrl-C (exit 130), or workers that died.
    """
    try:
        yield
    except KeyboardInterrupt:
        terminal.talk(_goes_on(kept, folder))
        raise typer.Exit(130) from None
    except HapticdError:
        if kept.known:
            terminal.talk(_goes_on(kept, folder))
        raise


@contextmanager
def interruptible(kept: str = "no result of this run was stored") -> Iterator[None]:
    """On Ctrl-C (exit 130), print one line about kept results."""
    try:
        yield
    except KeyboardInterrupt:
        terminal.talk(f"interrupted: {kept}")
        raise typer.Exit(130) from None


def drawn(folder: Path, name: str, figure: "Callable[[], Figure]", wanted: bool) -> Iterable[Path]:
    """Return the files of the figure `name` of a run, if it is `wanted`."""
    with drawing(folder):
        return style.save(figure(), folder, name) if wanted else ()


def drawing(folder: Path) -> AbstractContextManager[None]:
    """Return the context in which figures of a kept result are drawn."""
    return interruptible(f"the result is kept in {folder}, without all of its figures")


def _goes_on(kept: "store.TrialStore", folder: Path) -> str:
    return (
        f"{len(kept.known)} trials are kept in {folder}; the same command with --out {folder} goes"
        " on there"
    )


def scene_of(name: str) -> "model_scene.Scene":
    """Return the scene of that name, or the simulated device of that name with all of its effects.

    ConfigError lists the known names.
    """
    try:
        return scene_files.load_scene(name)
    except ConfigError as error:
        found = sources.device_scene(str(Path(name).resolve()) if name.endswith(".toml") else name)
        if found is None:
            raise error
        return found


def record_file(word: str, known: tuple[str, ...]) -> Path:
    """Return the record file `word`, which is none of `known`. BadParameter if it does
    not exist.
    """
    path = Path(word)
    meant = toml.did_you_mean(word, known)
    if meant and not path.exists():
        raise typer.BadParameter(f"{word!r} is not {', '.join(known)} or a file{meant}")
    terminal.there(path)
    return path


def device_of(name: str) -> "device_files.DeviceFile":
    """Return the device file of that scene, or of that name; `scene_of` has found it before."""
    try:
        return scene_files.load_files(name).device
    except ConfigError:
        return sources.device_file(str(Path(name).resolve()) if name.endswith(".toml") else name)


def require_within(name: str, shown: "sources.Display", asked: dict[str, float]) -> None:
    """Raise BadParameter for values that a daemon would refuse to render on this device."""
    own = device_of(name)
    ceiling = own.limits.active_damping_ns_per_m
    filters = shown.scene.environment.filters
    known = own.model is not None
    passive = safe_region.passive_ranges(shown.model, filters, ceiling) if known else {}
    widest = environment_limits(passive)
    limits = CommandLimits(shown.model.rate_hz, ceiling, widest)
    if broken := limits.broken_by(asked):
        raise typer.BadParameter("; ".join(one["msg"] for one in broken))


def conditions(
    scene: "model_scene.Scene",
    seconds: float,
    seed: int,
    band_hz: tuple[float, float] = (2.0, 500.0),
    confidence: float = 0.95,
) -> "outcomes.Conditions":
    """Return the conditions of many trials: the scene's noise with that seed."""
    noise = replace(scene.noise, seed=seed)
    return outcomes.Conditions(scene, seconds, noise, band_hz, confidence)


def levels(text: str) -> tuple[float, ...]:
    """Return the levels [N s/m] in the text of --active-damping. BadParameter for others."""
    try:
        found = tuple(float(part) for part in text.split(","))
    except ValueError:
        raise typer.BadParameter(
            f"--active-damping {text!r}: numbers in N s/m, separated by commas, for example 0,1.74"
        ) from None
    if not all(0.0 <= level < inf for level in found):
        raise typer.BadParameter(
            f"--active-damping {text!r}: levels must be finite and not negative"
        )
    return found


def ranged(name: str, given: Range, least: int = 2) -> Range:
    """Return `given` if LOW is below HIGH and N from `least` to 1000; otherwise BadParameter."""
    low, high, count = given
    if not (-inf < low < high < inf and least <= count <= 1000):
        raise typer.BadParameter(
            f"{name} {low:g} {high:g} {count}: LOW below HIGH, and N values from {least} to 1000,"
            " are needed"
        )
    return given


def environment_words(trial: "sources.Trial") -> str:
    """Return K, B, M and active damping of `trial` with their units."""
    k, b, m = trial.environment
    active = f"active damping {trial.active_damping_ns_per_m:g} N s/m"
    return f"K {k:g} N/m, B {b:g} N s/m, M {m:g} kg, {active}"


def print_outcomes(new: "list[outcomes.Outcome]", **more: Any) -> None:
    """Print a line of JSON for each outcome: its environment, verdict and margin, and `more`."""
    for outcome in new:
        shown = store.to_json({name: getattr(outcome, name) for name in OUTCOME_FIELDS})
        terminal.data_json({"type": "outcome", **more, **shown})


def show_result(
    found: dict[str, Any],
    lines: Iterable[str],
    folder: Path,
    figures: Iterable[Path],
    as_json: bool,
) -> None:
    """Print the result, its folder and its figures: the last line of --json, or as text."""
    files = [str(path) for path in figures]
    kept = {**found, "folder": str(folder), "figures": files}
    terminal.show(kept, [*lines, f"kept in {folder}", *files], as_json)


def write_summary(folder: Path, about: dict[str, Any], **more: Any) -> None:
    """Write run.json: the description `about` of the run, and its provenance (with `more`)."""
    store.write_run(folder, {**about, "provenance": provenance_now(**more)})


def folder(out: Path | None, what: str) -> Path:
    """Return the folder of the results."""
    return out or RUNS / f"{datetime.now(UTC):%Y%m%dT%H%M%S}-{what}"


def tell_open(levels: list[dict[str, Any]], what: str) -> None:
    """Print at which ends of `what`, a grid or a box, the set of each level continues."""
    for level in levels:
        if level["open_ends"]:
            ends = ", ".join(level["open_ends"])
            damping = f"{level['active_damping_ns_per_m']:g} N s/m"
            terminal.talk(f"at {damping} the set goes beyond the {what}: {ends}")


def provenance_now(**more: Any) -> dict[str, Any]:
    """Return the provenance of a run: versions, machine, the time, and `more`."""
    return provenance.provenance(date=datetime.now(UTC).isoformat(timespec="seconds"), **more)


# --- a live device --------------------------------------------------------------------------------


@dataclass(frozen=True)
class Rig:
    """A daemon, and known facts of its device."""

    client: "clients.Client"
    instance: str  # name of the daemon
    device: str  # name in its device file
    simulated: bool  # its board is simulated
    skew_s: float  # delay of the probe's velocity behind its force, from its device file
    model: "model_scene.Scene | None"  # of the simulated device of that name, if there is one

    @property
    def origin(self) -> str:
        """Origin of its records."""
        return f"daemon {self.instance!r}, device {self.device!r}"


def open_rig(instance: str, stack: ExitStack) -> Rig:
    """Connect for as long as `stack` is open; DaemonDown without an answer.

    A signal that ends this process also ends the trial with force off.
    """
    stack.enter_context(signals_end_with_force_off())
    client = stack.enter_context(change.connect(instance))
    servo = client.hello().servo
    name = servo.device.name
    model = sources.scene_of_device(name)
    if model is not None:
        filtered = replace(
            model.environment,
            velocity_filter=servo.environment.velocity_filter,
            acceleration_filter=servo.environment.acceleration_filter,
        )
        model = replace(model, environment=filtered)
    skew_s = servo.device.probe_skew_us / US_PER_S
    return Rig(client, instance, name, servo.simulated, skew_s, model)


def announce(
    rig: Rig, trial: "sources.Trial", scene: "model_scene.Scene | None", skew_s: float
) -> None:
    """Print the coming action on stderr. `scene` is the one of the option, `skew_s` the correction
    applied.
    """
    kind = "simulated" if rig.simulated else "real, it moves"
    terminal.talk(
        f"enables the device {rig.device!r} of daemon {rig.instance!r} ({kind}) in"
        f" {environment_words(trial)}, and perturbs it; Ctrl-C ends the trial and"
        " switches the force off"
    )
    if rig.skew_s:
        terminal.talk(
            f"by the device file, the probe's velocity lags its force by"
            f" {US_PER_S * rig.skew_s:.3g} us; {US_PER_S * skew_s:.3g} us are corrected"
        )
    if trial.environment[0] == 0.0:
        terminal.talk(
            "with K = 0 no force keeps the device within its travel; use -K"
            f" {watch.CENTRING_N_PER_M:g}"
        )
    if rig.model is None:
        terminal.talk(f"there is no model of the device {rig.device!r}, so no prediction")
    if scene is not None and (rig.model is None or scene.device != rig.model.device):
        terminal.talk(
            f"scene {scene.name!r} is of the device {scene.device!r}, not of the daemon's: the"
            f" scene's environment is rendered on {rig.device!r}"
        )


@contextmanager
def signals_end_with_force_off() -> Iterator[None]:
    """Treat SIGTERM and SIGHUP like Ctrl-C: force off.

    The exit code is 128 + the signal's number. A signal with another handler is left alone.
    """

    def leave(number: int, frame: object) -> None:
        raise SystemExit(128 + number)

    ending = (signal.SIGTERM, signal.SIGHUP)
    unhandled = [number for number in ending if signal.getsignal(number) == signal.SIG_DFL]
    for number in unhandled:
        signal.signal(number, leave)
    try:
        yield
    finally:
        for number in unhandled:
            signal.signal(number, signal.SIG_DFL)
