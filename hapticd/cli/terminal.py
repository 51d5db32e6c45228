"""Shared parts of the verbs: late imports, options, output, the progress bar, figures on disk.

Data go to stdout, messages to stderr, errors are one line each. rich and matplotlib are loaded on
first use.

Late imports (`deferred_imports`). They happen when a module is first used, so that `--help` and
small verbs start quickly.

    with deferred_imports():
        import numpy as np
        from hapticd.zwidth import limits

Each name bound there represents a module, which is imported at the first access to one of its
names. So only whole modules can be deferred, not names of them, and a missing module is an error at
its first use. No placeholder is in `sys.modules`: libraries that search all modules, like
`inspect`, would load unneeded modules, in the middle of other imports.

A package must not reuse the name of one of its modules.
"""

import builtins
import dataclasses
import inspect
import json
import os
import shutil
import sys
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from threading import get_ident
from types import ModuleType
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hapticd.core.errors import CommandError, ConfigError, DaemonDown, HapticdError, MailboxError
from hapticd.core.extras import need
from hapticd.mailbox.files import DEFAULT_INSTANCE, runtime_folder

# --- late imports ---------------------------------------------------------------------------------


class _Waiting(ModuleType):
    """A module that is imported on first use."""

    def __getattr__(self, name: str) -> Any:
        return getattr(import_module(self.__name__), name)


def _waiting(
    name: str, globals: Any = None, locals: Any = None, fromlist: Any = (), level: int = 0
) -> ModuleType:
    """Return the value bound by `import name`, or `from name import fromlist`. ImportError for
    `import a.b`, which binds a.
    """
    if "." in name and not fromlist:
        raise ImportError(f"import {name}: name it with `from`, so that it can wait")
    found = _Waiting(name)
    for one in fromlist or ():
        setattr(found, one, _Waiting(f"{name}.{one}"))
    return found


@contextmanager
def deferred_imports() -> Iterator[None]:
    """Defer the imports within this context until first use."""
    usual = builtins.__import__
    here = get_ident()

    def imported(
        name: str, globals: Any = None, locals: Any = None, fromlist: Any = (), level: int = 0
    ) -> ModuleType:
        act = _waiting if get_ident() == here else usual
        return act(name, globals, locals, fromlist, level)

    builtins.__import__ = imported
    try:
        yield
    finally:
        builtins.__import__ = usual


with deferred_imports():
    from hapticd.settings import toml
    from hapticd.zwidth import store
    from hapticd.zwidth.report import paper, style


if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["progress", "talk"]

Verb = Callable[..., None]


def verb(app: typer.Typer, name: str, **settings: Any) -> Callable[[Verb], Verb]:
    """Make a function the verb `name` of `app`; its docstring is the help.

    Every paragraph becomes one line, which a terminal of any width may wrap. A parameter that is a
    dataclass of options is replaced by its fields.
    """

    def register(function: Verb) -> Verb:
        paragraphs = inspect.cleandoc(function.__doc__ or "").split("\n\n")
        text = "\n\n".join(" ".join(paragraph.split()) for paragraph in paragraphs)
        app.command(name, help=text, **settings)(_with_single_options(function))
        return function

    return register


def _with_single_options(function: Verb) -> Verb:
    """Return `function` with each dataclass among its parameters replaced by its fields.

    Typer makes an option of every parameter in a signature, so a new signature is written here.
    """
    parameters = inspect.signature(function).parameters
    groups = {name: one.annotation for name, one in parameters.items() if _is_group(one)}
    if not groups:
        return function

    def called(**given: Any) -> None:
        for name, group in groups.items():
            given[name] = group(
                **{field.name: given.pop(field.name) for field in dataclasses.fields(group)}
            )
        function(**given)

    single: list[inspect.Parameter] = []
    for name, one in parameters.items():
        of_group = inspect.signature(groups[name]).parameters.values() if name in groups else ()
        single += of_group or [one]
    single = [one.replace(kind=inspect.Parameter.KEYWORD_ONLY) for one in single]
    called.__annotations__ = {one.name: one.annotation for one in single}
    setattr(called, "__signature__", inspect.Signature(single))  # noqa: B010
    return called


def _is_group(parameter: inspect.Parameter) -> bool:
    return dataclasses.is_dataclass(parameter.annotation)


BOLD = "1"  # SGR codes
RED = "1;31"
YELLOW = "1;33"
GREEN = "1;32"
LEAST_WIDTH = 40  # minimum width of wrapped lines, for any terminal


def data(text: str) -> None:
    """Print a line of data."""
    print(text, flush=True)


def data_json(content: Any) -> None:
    """Print one object in one line."""
    print(json.dumps(content, default=str), flush=True)


def show(found: Mapping[str, Any], lines: Iterable[str], as_json: bool) -> None:
    """Print the result of a verb: with --json one object that begins with `ok`, otherwise lines."""
    if as_json:
        data_json({"ok": True, **found})
        return
    for line in lines:
        data(line)


def talk(text: str) -> None:
    """Print a line for a person."""
    print(text, file=sys.stderr, flush=True)


def hush() -> None:
    """Discard all further output of this process: its reader has left."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for descriptor in (1, 2):
        os.dup2(nowhere, descriptor)
    os.close(nowhere)


def coloured(text: str, colour: str, stream: Any = None) -> str:
    """Return `text` in `colour` if the stream (default stdout) is a terminal and NO_COLOR is not
    set.
    """
    plain = os.environ.get("NO_COLOR") or not (stream or sys.stdout).isatty()
    return text if plain else f"\x1b[{colour}m{text}\x1b[0m"


def wrapped(text: str, stream: Any = None) -> str:
    """Return `text` in lines of the terminal's width, those after the first indented. It is
    unchanged if the stream (default stderr) is not a terminal: programs expect whole lines.
    """
    if not (stream or sys.stderr).isatty():
        return text
    width = max(LEAST_WIDTH, shutil.get_terminal_size().columns)
    return textwrap.fill(
        text, width, subsequent_indent="  ", break_long_words=False, break_on_hyphens=False
    )


def complain(error: HapticdError, as_json: bool) -> None:
    """Print an error, in one line per item; with --json also as an object on stdout."""
    for line in str(error).splitlines():
        name = coloured("hapticd:", RED, sys.stderr)
        talk(name + wrapped(f"hapticd: {line}").removeprefix("hapticd:"))
    if as_json:
        code = error.code if isinstance(error, CommandError) else type(error).__name__
        content = {"code": code, "message": str(error), "detail": _detail(error)}
        if isinstance(error, CommandError) and error.guard:
            content["guard"] = dataclasses.asdict(error.guard)
        data_json({"ok": False, "error": content})


def _detail(error: HapticdError) -> Any:
    """Return the details of an error for programs."""
    if isinstance(error, DaemonDown):
        return error.plain()
    return error.detail if isinstance(error, CommandError) else None


def explain(mistake: Any, as_json: bool) -> int:
    """Print a usage error, as Typer shows it; with --json also as an object on stdout. Return the
    exit code.
    """
    from typer.rich_utils import rich_format_error

    rich_format_error(mistake)
    if as_json:
        content = {"code": "usage", "message": mistake.format_message()}
        content["detail"] = getattr(mistake, "detail", None)
        data_json({"ok": False, "error": content})
    return int(mistake.exit_code)


Json = Annotated[bool, typer.Option("--json", help="One JSON object on stdout.")]
JsonLines = Annotated[bool, typer.Option("--json", help="One JSON object per line on stdout.")]


def _named(name: str | None, origin: str = "--instance") -> str | None:
    """Return `name` if it is valid for an instance; otherwise raise BadParameter with
    its `origin`.
    """
    try:
        if name is not None:
            runtime_folder(name)
    except MailboxError as error:
        raise typer.BadParameter(str(error), param_hint=f"'{origin}'") from None
    return name


def _before(name: str | None) -> str | None:
    return _named(name)


def _chosen(context: typer.Context, parameter: typer.CallbackParam, name: str | None) -> str | None:
    """Return the name after the verb, or the one before it, or that of the environment
    or default.
    """
    source = context.get_parameter_source(parameter.name or "")
    origin = source.name if source else ""
    if origin != "COMMANDLINE" and context.obj is not None:
        return _named(context.obj)
    return _named(name, INSTANCE_VARIABLE if origin == "ENVIRONMENT" else "--instance")


def there(path: Path | None) -> Path | None:
    """Return `path` if it exists; otherwise raise BadParameter with a similar name."""
    if path is None or os.path.exists(path):
        return path
    folder = path.parent
    meant = toml.did_you_mean(path.name, os.listdir(folder)) if os.access(folder, os.R_OK) else ""
    raise typer.BadParameter(f"{path}: no such file; check the path and its permissions{meant}")


INSTANCE_VARIABLE = "HAPTICD_INSTANCE"
Instance = Annotated[
    str,
    typer.Option(
        "--instance",
        metavar="NAME",
        envvar=INSTANCE_VARIABLE,
        show_envvar=False,
        callback=_chosen,
        help=f"Name of the daemon (default: ${INSTANCE_VARIABLE}); may also precede the verb.",
    ),
]
InstanceBefore = Annotated[
    str | None,
    typer.Option(
        "--instance",
        metavar="NAME",
        callback=_before,
        help=f"Name of the daemon (default: ${INSTANCE_VARIABLE}); may also follow the verb.",
    ),
]
OneOfAll = Annotated[
    str | None,
    typer.Option(
        "--instance",
        metavar="NAME",
        callback=_chosen,
        help="Stop only this daemon (default: all of yours and the service;"
        f" ${INSTANCE_VARIABLE} is ignored).",
    ),
]
ConfigFile = Annotated[
    Path | None,
    typer.Option(
        "--config",
        metavar="FILE",
        help="Configuration (default: $HAPTICD_CONFIG, ~/.config, /etc, then the shipped one).",
    ),
]
INSTANCE = DEFAULT_INSTANCE
Parent = Annotated[  # the process with which a verb ends, for internal use
    int | None, typer.Option("--parent", hidden=True)
]


SIMULATED_BANNER = """\
 ████  █  █   █  █   █  █       ███   █████  █████  ████
█      █  ██ ██  █   █  █      █   █    █    █      █   █
 ███   █  █ █ █  █   █  █      █████    █    ████   █   █
    █  █  █   █  █   █  █      █   █    █    █      █   █
████   █  █   █   ███   █████  █   █    █    █████  ████"""


@contextmanager
def progress(quiet: bool = False) -> "Iterator[store.Progress]":
    """Yield `tell(what, done, total)`, which draws the bar; total 0: unknown.

    Without a terminal, or `quiet`, it does nothing.
    """
    from rich import progress as bars
    from rich.console import Console

    console = Console(stderr=True)
    columns = (
        bars.BarColumn(30),
        bars.MofNCompleteColumn(),
        bars.TimeElapsedColumn(),
        bars.TimeRemainingColumn(),
        bars.TextColumn("{task.description}"),
    )
    hidden = quiet or not console.is_terminal
    with bars.Progress(*columns, console=console, transient=True, disable=hidden) as bar:
        task = bar.add_task("", total=None)

        def tell(what: str, done: int, total: int) -> None:
            bar.update(task, description=what, completed=done, total=total or None)

        yield tell


SceneName = Annotated[
    str, typer.Argument(metavar="SCENE", help="Shipped scene, or path of a .toml file.")
]
Plot = Annotated[bool, typer.Option("--plot/--no-plot", help="Draw a figure as PNG, SVG and PDF.")]
Out = Annotated[Path, typer.Option("--out", metavar="FOLDER", help="Folder for figures.")]
HERE = Path()


def need_figures(wanted: bool) -> None:
    """Fail before the work rather than after it.

    MissingLibrary if figures are wanted and matplotlib is missing.
    """
    if wanted:
        need("matplotlib", "a figure")


def need_engine(figures: bool = False) -> None:
    """Fail before a prediction rather than after it.

    MissingLibrary if numba is missing, or matplotlib when figures are wanted.
    """
    need("numba", "the batch engine")
    need_figures(figures)


def figure_width_mm(text: str) -> float:
    """Return the width [mm] of --figure-width. BadParameter for invalid text."""
    try:
        return paper.width_mm(text)
    except ConfigError as error:
        raise typer.BadParameter(str(error)) from None


FigureWidth = Annotated[
    float | None,
    typer.Option(
        "--figure-width",
        metavar="column|text|MM",
        parser=figure_width_mm,
        help="Width of printed figures: column (88.9 mm), page (181 mm), or a number of mm.",
    ),
]


def save_figure(figure: "Figure", folder: Path, name: str, as_json: bool) -> list[str]:
    """Save the figure's files, print their paths, and return them."""
    paths = [str(path) for path in style.save(figure, folder, name)]
    if not as_json:
        talk(f"drawn: {', '.join(paths)}")
    return paths
