"""What the verbs of `zwidth` share: options, a progress bar, the scene that is meant,
outcomes as lines, conditions.
"""

from collections.abc import Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace
from datetime import UTC, datetime
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hapticd.cli import terminal
from hapticd.errors import HapticdError

if TYPE_CHECKING:
    from hapticd.measure.outcomes import Conditions, Outcome
    from hapticd.measure.sources import Trial
    from hapticd.measure.store import TrialStore
    from hapticd.plant.scene import Scene

SceneName = Annotated[
    str,
    typer.Option("--scene", metavar="NAME|FILE", help="Device, effects, filters and perturbation."),
]
Out = Annotated[
    Path | None,
    typer.Option("--out", metavar="DIR", help="Keep results there; else zwidth-runs/, by date."),
]
Seconds = Annotated[float, typer.Option("--seconds", metavar="S", help="Length of a trial.")]
Seed = Annotated[int, typer.Option("--seed", min=0, help="Of the perturbation.")]
Band = Annotated[
    tuple[float, float],
    typer.Option("--band", metavar="LOW HIGH", help="Hz in which a verdict is given."),
]
Confidence = Annotated[
    float, typer.Option("--confidence", min=0.5, max=0.9999, help="Of a verdict.")
]
Damping = Annotated[
    str,
    typer.Option("--damping", metavar="LEVEL[,LEVEL...]", help="Levels of active damping, N s/m."),
]
OneDamping = Annotated[
    float | None, typer.Option("--damping", metavar="NS/M", help="Active damping.", min=0)
]
Plot = Annotated[
    bool, typer.Option("--plot/--no-plot", help="Draw PNG and SVG into the run folder.")
]
Where = Annotated[
    str,
    typer.Option(
        "--executor",
        metavar="thread|process|dask://HOST:PORT",
        help=(
            "Where trials run: here, in a process a core, or on the workers of a Dask scheduler"
            " (extra: cluster)."
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
Admittance = Annotated[bool, typer.Option("--admittance", help="Draw the admittance as well.")]
Range = tuple[float, float, int]
RUNS = Path("zwidth-runs")
TOLD = (
    "environment",
    "damping_ns_per_m",
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
def keeping(store: "TrialStore", folder: Path) -> Iterator[None]:
    """Where something ends a campaign early, Ctrl-C (exit 130) or dead workers, say
    what is kept and how to go on.
    """
    try:
        yield
    except KeyboardInterrupt:
        terminal.talk(_goes_on(store, folder))
        raise typer.Exit(130) from None
    except HapticdError:
        if store.known:
            terminal.talk(_goes_on(store, folder))
        raise


@contextmanager
def interruptible(kept: str = "nothing of this run was kept") -> Iterator[None]:
    """Ctrl-C (exit 130) is answered in one line about what is kept."""
    try:
        yield
    except KeyboardInterrupt:
        terminal.talk(f"interrupted: {kept}")
        raise typer.Exit(130) from None


def drawing(folder: Path) -> AbstractContextManager[None]:
    """While figures of a run are drawn whose result is kept."""
    return interruptible(f"the result is kept in {folder}, without all of its figures")


def _goes_on(store: "TrialStore", folder: Path) -> str:
    return (
        f"{len(store.known)} trials are kept in {folder}; the same command with --out {folder} goes"
        " on there"
    )


def scene_of(name: str) -> "Scene":
    """The scene, or a simulated device's name with all of its effects. ConfigError
    names what there is.
    """
    from hapticd.errors import ConfigError
    from hapticd.measure.scenes import device_scene
    from hapticd.settings.scene import load_scene

    try:
        return load_scene(name)
    except ConfigError as error:
        found = device_scene(str(Path(name).resolve()) if name.endswith(".toml") else name)
        if found is None:
            raise error
        return found


def conditions(
    scene: "Scene",
    seconds: float,
    seed: int,
    band_hz: tuple[float, float] = (2.0, 500.0),
    confidence: float = 0.95,
) -> "Conditions":
    """Of a campaign: trials with the scene's noise of that seed."""
    from hapticd.measure.outcomes import Conditions
    from hapticd.measure.scenes import noise

    return Conditions(scene, seconds, replace(noise(scene), seed=seed), band_hz, confidence)


def levels(text: str) -> tuple[float, ...]:
    """Damping levels of an option."""
    try:
        found = tuple(float(part) for part in text.split(","))
    except ValueError:
        raise typer.BadParameter(
            f"--damping {text!r}: numbers in N s/m, separated by commas, for example 0,1.74"
        ) from None
    if not all(0.0 <= level < inf for level in found):
        raise typer.BadParameter(f"--damping {text!r}: levels are not negative, and finite")
    return found


def ranged(name: str, given: Range, least: int = 2) -> Range:
    """LOW HIGH N of an option, LOW below HIGH, N from `least` to 1000."""
    low, high, count = given
    if not (-inf < low < high < inf and least <= count <= 1000):
        told = f"{name} {low:g} {high:g} {count}"
        raise typer.BadParameter(
            f"{told}: LOW below HIGH, and N values from {least} to 1000, are needed"
        )
    return given


def environment_words(trial: "Trial") -> str:
    """K, B, M and active damping of `trial` with their units."""
    k, b, m = trial.environment
    active = f"active damping {trial.damping_ns_per_m:g} N s/m"
    return f"K {k:g} N/m, B {b:g} N s/m, M {m:g} kg, {active}"


def follow(new: "list[Outcome]", **more: Any) -> None:
    """A line of JSON for each outcome: type "outcome", K, B and M, verdict, margin [N
    s/m] with its interval, and `more`.
    """
    from hapticd.measure.store import plain

    for outcome in new:
        terminal.data_json(
            {"type": "outcome", **more, **plain({name: getattr(outcome, name) for name in TOLD})}
        )


def folder(out: Path | None, what: str) -> Path:
    """Where results are kept."""
    return out or RUNS / f"{datetime.now(UTC):%Y%m%dT%H%M%S}-{what}"


def kept(folder: Path, files: Iterable[Path]) -> None:
    """Say where results are, and name the figures."""
    terminal.data(f"kept in {folder}")
    for file in files:
        terminal.data(str(file))


def told(**more: Any) -> dict[str, Any]:
    """Provenance with the time."""
    from hapticd.measure.recording.provenance import provenance

    return provenance(date=datetime.now(UTC).isoformat(timespec="seconds"), **more)
