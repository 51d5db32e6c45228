"""A live progress bar on stderr for work that takes long; nothing where nobody watches."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hapticd.measure.progress import Progress


@contextmanager
def progress(quiet: bool = False) -> "Iterator[Progress]":
    """Yields `tell(what, done, total)`, which draws the bar; without a terminal, or `quiet`, it does nothing."""
    from rich import progress as bars
    from rich.console import Console

    console = Console(stderr=True)
    columns = (bars.BarColumn(30), bars.MofNCompleteColumn(), bars.TimeElapsedColumn(), bars.TimeRemainingColumn())
    hidden = quiet or not console.is_terminal
    with bars.Progress(*columns, bars.TextColumn("{task.description}"), console=console, transient=True, disable=hidden) as bar:
        task = bar.add_task("", total=None)
        yield lambda what, done, total: bar.update(task, description=what, completed=done, total=total)
