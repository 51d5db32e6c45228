"""Record every tick, every probe sample and every event into one HDF5 file."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hapticd.cli import options, output
from hapticd.cli.change import connect

if TYPE_CHECKING:
    from hapticd.measure.recorder import Progress

File = Annotated[Path, typer.Argument(metavar="FILE", help="NAME.h5; while it grows it is called NAME.part.h5.")]
Seconds = Annotated[float | None, typer.Option("--seconds", metavar="S", help="Recorded time; else until Ctrl-C.", min=0.001)]
Note = Annotated[str, typer.Option("--note", metavar="TEXT", help="Your words, kept in the file.")]


def command(
    file: File,
    seconds: Seconds = None,
    note: Note = "",
    instance: options.Instance = options.INSTANCE,
    as_json: options.Json = False,
) -> None:
    """Record the running daemon: every tick with raw frames, the probe, events, and what a replay needs.

    Ctrl-C ends it in order. A recorder that was killed loses at most 100 ms: `hapticd rec recover`.
    """
    from hapticd.assembly.process import on_stop
    from hapticd.measure.recorder import RecordingParams, record

    asked: list[bool] = []
    on_stop(lambda: asked.append(True))
    with connect(instance) as client, _bar(seconds, quiet=as_json) as tell:
        result = record(client, RecordingParams(file, seconds, note), lambda: bool(asked), tell)
    if as_json:
        output.data_json({"ok": True, **result})
    else:
        output.data(told(result["ended"], result))


def told(ended: str, summary: dict[str, Any]) -> str:
    """One line about a finished file."""
    simulated = "SIMULATED, " if summary["simulated"] else ""
    missing, size_mb = summary["missing"]["servo"], summary["bytes"] / 1e6
    taken = f"{summary['seconds']:.3f} s, {summary['records']} records, {missing} missing"
    return f"{summary['file']}: {ended}, {simulated}{taken}, {size_mb:.3g} MB"


@contextmanager
def _bar(seconds: float | None, quiet: bool) -> "Iterator[Callable[[Progress], None]]":
    """A progress bar on stderr, where someone watches."""
    if quiet or not sys.stderr.isatty():
        yield lambda progress: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, TextColumn, TimeElapsedColumn
    from rich.progress import Progress as Bar

    columns = TextColumn("recording"), BarColumn(), TextColumn("{task.description}"), TimeElapsedColumn()
    with Bar(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task("", total=seconds)

        def tell(progress: "Progress") -> None:
            missing = f", {progress.missing} MISSING" if progress.missing else ""
            text = f"{progress.seconds:.1f} s, {progress.records} records{missing}, {progress.file_bytes / 1e6:.1f} MB"
            bar.update(task, completed=progress.seconds, description=text)

        yield tell
