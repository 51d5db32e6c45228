"""Record a running daemon; finish, inspect and convert recordings; replay them.

A replay runs the servo's own step on the recorded frames, so it repeats a recording bit by bit.
"""

import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from hapticd.cli import terminal
from hapticd.cli.change import changes, connect
from hapticd.core.environment import flat
from hapticd.core.errors import ConfigError, HapticdError
from hapticd.core.process import die_with_parent, on_stop
from hapticd.mailbox.layout import Value
from hapticd.protocol.limits import PLACES

with terminal.deferred_imports():
    from hapticd.recording import file as files
    from hapticd.recording import pack, recorder
    from hapticd.zwidth import store
    from hapticd.zwidth.report import style
    from hapticd.zwidth.report import trial as figures


ENDING = ".h5"


def _recording_name(file: Path) -> Path:
    """Return `file` if it is a valid name of a recording; otherwise BadParameter."""
    if file.suffix != ENDING:
        raise typer.BadParameter(f"{file}: a recording is called NAME{ENDING}: {file.stem}{ENDING}")
    return file


def record(
    file: Annotated[
        Path,
        typer.Argument(
            metavar="FILE",
            callback=_recording_name,
            help="NAME.h5; named NAME.part.h5 until it is complete.",
        ),
    ],
    seconds: Annotated[
        float | None,
        typer.Option(
            "--seconds", metavar="S", help="Recorded time (default: until Ctrl-C).", min=0.001
        ),
    ] = None,
    note: Annotated[
        str, typer.Option("--note", metavar="TEXT", help="A note that is kept in the file.")
    ] = "",
    instance: terminal.Instance = terminal.INSTANCE,
    parent: terminal.Parent = None,
    as_json: terminal.Json = False,
) -> None:
    """Record the running daemon: every tick with raw frames, the probe, events, and everything that
    a replay needs.

    Ctrl-C completes the file. A killed recorder loses at most 100 ms: see `hapticd rec recover`.
    """
    die_with_parent(parent)
    asked: list[bool] = []
    on_stop(lambda: asked.append(True))
    params = recorder.RecordingParams(file, seconds, note)
    with connect(instance) as client, terminal.progress(as_json) as tell:

        def draw(progress: "recorder.RecordingProgress") -> None:
            tell(_progress_words(progress), round(progress.seconds), round(seconds or 0))

        result = recorder.record(client, params, lambda: bool(asked), draw)
    terminal.show(result, [finished_line(result["ended"], result)], as_json)


def finished_line(ended: str, summary: dict[str, Any]) -> str:
    """Return one line about a finished file."""
    simulated = "SIMULATED, " if summary["simulated"] else ""
    lost = f", {summary['lost_slots']} slots lost" if summary["lost_slots"] else ""
    dropped = f", {summary['dropped_bytes']} bytes dropped" if summary["dropped_bytes"] else ""
    return (
        f"{summary['file']}: {ended}, {simulated}{summary['seconds']:.3f} s,"
        f" {summary['records']} records, {summary['missing']['servo']} missing{lost}{dropped},"
        f" {summary['bytes'] / 1e6:.3g} MB"
    )


def _progress_words(progress: "recorder.RecordingProgress") -> str:
    missing = f", {progress.missing} MISSING" if progress.missing else ""
    return (
        f"{progress.seconds:.1f} s, {progress.records} records{missing},"
        f" {progress.file_bytes / 1e6:.1f} MB"
    )


rec_app = typer.Typer(no_args_is_help=True, help="Recover, inspect and convert recordings.")
Source = Annotated[
    Path,
    typer.Argument(
        metavar="FILE", callback=terminal.there, help="NAME.h5, NAME.part.h5 or NAME.flight."
    ),
]
Target = Annotated[
    Path | None,
    typer.Argument(
        metavar="[OUT]",
        help="Output file (default: next to FILE, with another suffix).",
        show_default=False,
    ),
]
ATTRIBUTES_SHOWN = (
    "started_utc", "device_name", "device_serial", "rate_hz", "winding_c", "hapticd_version",
    "hapticd_commit", "kernel", "cpu", "realtime", "calibration_doubts", "certificate", "leases",
    "note",
)  # fmt: skip


@terminal.verb(rec_app, "recover")
def recover(file: Source, out: Target = None, as_json: terminal.Json = False) -> None:
    """Recover an unfinished recording, or convert a flight recording."""
    summary = pack.pack(file, out or _beside(file, ".h5"), recovered=True)
    terminal.show(summary, [finished_line("recovered", summary)], as_json)


@terminal.verb(rec_app, "info")
def info(file: Source, as_json: terminal.Json = False) -> None:
    """Show the contents of a recording and its origin."""
    with files.open_recording(file) as recording:
        found = pack.summary(recording)
        attributes = {name: _plain(value) for name, value in recording.attributes.items()}
        energy_j: dict[str, float] = {}
        with suppress(ConfigError):  # records of another version
            energy_j = files.total_j(recording)
    lines = _info_lines(found, energy_j, attributes)
    terminal.show({**found, "energy_j": energy_j, "attributes": attributes}, lines, as_json)


def _info_lines(
    found: dict[str, Any], energy_j: dict[str, float], attributes: dict[str, Any]
) -> Iterator[str]:
    badge = terminal.coloured("SIMULATED  ", terminal.YELLOW) if found["simulated"] else ""
    missing = found["missing"]
    yield (
        f"{badge}{found['seconds']:.3f} s, {found['records']} records, {found['probe_samples']}"
        f" probe samples, {found['lives']} servo life"
    )
    yield f"missing: {missing['servo']} records, {missing['probe']} probe samples"
    if lost := found["lost_slots"]:
        yield f"lost slots: {lost} periods without a tick, for the host came late"
    if energy_j:
        yield f"work on the device: {_energy_words(energy_j)}"
    for name in ATTRIBUTES_SHOWN:
        if attributes.get(name) not in (None, "", "{}"):
            yield f"{name} = {attributes[name]}"


def _energy_words(energy_j: dict[str, float]) -> str:
    """Return the energies that are not 0: `0.27 mJ (damping -0.15, hold_delay 0.42), unexplained 0
    mJ`.
    """
    beside = ("whole", "unexplained", "electrical_commanded")
    causes = [
        f"{name} {1e3 * value:.3g}"
        for name, value in energy_j.items()
        if value and name not in beside
    ]
    return (
        f"{1e3 * energy_j['whole']:.3g} mJ ({', '.join(causes) or 'no motion under force'}),"
        f" unexplained {1e3 * energy_j['unexplained']:.3g} mJ"
    )


def _plain(value: Any) -> Any:
    return value.item() if hasattr(value, "item") else value


@terminal.verb(rec_app, "export")
def export(
    kind: Annotated[
        Literal["mat", "csv"],
        typer.Argument(metavar="mat|csv", help="Format: MATLAB 5 or comma-separated values."),
    ],
    file: Source,
    out: Target = None,
    as_json: terminal.Json = False,
) -> None:
    """Convert a recording: `hapticd rec export mat FILE`."""
    target = out or _beside(file, f".{kind}")
    with files.open_recording(file) as recording:
        mat = kind == "mat"
        paths = [pack.to_mat(recording, target)] if mat else pack.to_csv(recording, target)
    written = [str(path) for path in paths]
    terminal.show({"files": written}, written, as_json)


def _beside(file: Path, ending: str) -> Path:
    stem = file.name.removesuffix(".part.h5").removesuffix(".h5").removesuffix(".flight")
    target = file.with_name(stem + ending)
    if target.exists():
        raise ConfigError(f"{target} exists; name another file")
    return target


def replay(
    file: Annotated[
        Path,
        typer.Argument(
            metavar="FILE", callback=terminal.there, help="NAME.h5, NAME.part.h5 or NAME.flight."
        ),
    ],
    held: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="NAME=VALUE",
            help="Hold a setting at a value, as in `hapticd set`; may be repeated.",
        ),
    ] = None,
    plot: Annotated[
        Path | None,
        typer.Option(
            "--plot", metavar="NAME", help="Draw NAME.png, .svg and .pdf (always with --set)."
        ),
    ] = None,
    figure_width: terminal.FigureWidth = None,
    as_json: terminal.Json = False,
) -> None:
    """Replay a recorded motion, bit by bit or with settings held at other values, and draw both
    forces.

    The motion stays as recorded, so the result is the force that the law would have commanded.
    Exit 1 if a plain replay differs by one bit.
    """
    words = held or []
    terminal.need_figures(bool(words or plot))
    with files.open_recording(file) as recording:
        begin = time.process_time()
        result = files.replay_recording(recording, _instead(words))
        seconds = time.process_time() - begin
        rate_hz = recording.params.realtime.rate_hz
        simulated = bool(recording.attributes["simulated"])
    found = {
        **result.to_json(),
        "times_real_time": len(result.replayed) / rate_hz / seconds,
        "held": words,
    }
    if words or plot:
        drawn = plot or file.with_name(f"{file.name.partition('.')[0]}-replay")
        title = f"{file.name}{', SIMULATED' if simulated else ''}"
        found["figures"] = _drawn(result, drawn, title, ", ".join(words), figure_width)
    terminal.show(found, _replay_lines(found), as_json)
    if not words and result.first_difference is not None:
        raise HapticdError(
            f"{file}: the replay differs from the recording; another version recorded it, or the"
            " file is damaged"
        )


def _instead(words: list[str]) -> dict[Value, float]:
    found = {PLACES[name]: float(value) for name, value in flat(changes(words))}
    if Value.ACTIVE_DAMPING in found:
        found[Value.ACTIVE_DAMPING_ON] = float(found[Value.ACTIVE_DAMPING] != 0.0)
    return found


def _drawn(
    result: "files.ReplayResult", path: Path, title: str, changed: str, width_mm: float | None
) -> list[str]:
    figure = figures.replay_figure(result, title, changed or "replayed", width_mm)
    name = path.stem if path.suffix in {f".{kind}" for kind in store.FIGURE_KINDS} else path.name
    return [str(one) for one in style.save(figure, path.parent, name)]


def _replay_verdict(found: dict[str, Any]) -> str:
    """Return the verdict of a replay; with held settings, the change of the force."""
    if not found["held"]:
        return "bit-exact" if found["bit_exact"] else "different"
    held = f"with {', '.join(found['held'])}"
    if found["first_force_tick"] is None:
        return f"{held} the force is the same"
    return (
        f"{held} the force is another from tick {found['first_force_tick']} on, by"
        f" {found['force_rms_n']['difference']:.4g} N rms"
    )


def _replay_lines(found: dict[str, Any]) -> Iterator[str]:
    speed = f"{found['times_real_time']:.0f} x real time"
    segments = "1 segment" if found["legs"] == 1 else f"{found['legs']} segments"
    yield f"{found['ticks']} ticks in {segments}, {speed}: {_replay_verdict(found)}"
    if left_out := found["left_out"]:
        yield (
            f"left out: {left_out} ticks; a replay begins at the servo's first checkpoint, after"
            " the start and after a gap"
        )
    if (first := found["first_difference"]) and not found["held"]:
        yield (
            f"from tick {first['tick']}: {first['field']} was {first['recorded']}, is"
            f" {first['replayed']}"
        )
    for name in ("recorded", "replayed"):
        rms_n, peak_n = (found[size][name] for size in ("force_rms_n", "force_peak_n"))
        yield f"force {name:8}  rms {rms_n:.4g} N, peak {peak_n:.4g} N"
    if not any(found["force_peak_n"].values()):
        yield (
            "no force in either: force was off, or nothing moved; enable the display, set a"
            " stiffness and move the handle while it records"
        )
    yield from found.get("figures", [])
