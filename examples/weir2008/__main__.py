"""Weir, Colgate and Peshkin 2008 on simulated devices: limits, ratios, equations and Figs. 2-4 and
7-11 beside the paper's, and what the paper left to future work.

Writes REPORT.md, the table (JSON, CSV, Markdown) and the figures (PNG, SVG, PDF); with --json only
if --out names a folder. Ctrl-C is safe: the folder holds the files of one run, or none. Exit codes
are those of `hapticd`.
"""

import json
import sys
from argparse import ArgumentParser, ArgumentTypeError, Namespace
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from math import inf
from pathlib import Path
from time import monotonic
from typing import Any, NoReturn

from examples.weir2008 import future_page, future_work, page, run, table
from hapticd.cli.terminal import progress, talk
from hapticd.core.errors import ConfigError, HapticdError
from hapticd.core.extras import need
from hapticd.recording.provenance import provenance
from hapticd.zwidth.report.paper import width_mm
from hapticd.zwidth.store import Progress

LINE_S = 10.0  # between two lines of progress where stderr is no terminal
FEWEST_SEEDS, MOST_SEEDS = 2, 64
INTERRUPTED = 130


class Parser(ArgumentParser):
    """With --json, also writes a usage error as an object on stdout."""

    def __init__(self, as_json: bool) -> None:
        super().__init__("python -m examples.weir2008", description=__doc__, allow_abbrev=False)
        self.as_json = as_json

    def error(self, message: str) -> NoReturn:
        """Exit with code 2."""
        if self.as_json:
            tell_error("usage", message)
        super().error(message)


def parsed(arguments: Sequence[str]) -> Namespace:
    """Return the options."""
    parser = Parser("--json" in arguments)
    parser.add_argument(
        "--quick",
        action="store_true",
        help="prediction alone: seconds instead of minutes, without scatter and Fig. 2",
    )
    parser.add_argument(
        "--seeds",
        metavar="N",
        type=seed_count,
        default=run.SEEDS,
        help="noise realisations behind each limit (default 8)",
    )
    parser.add_argument(
        "--out",
        metavar="FOLDER",
        type=Path,
        help="folder for the results (default: a dated folder in zwidth-runs/)",
    )
    parser.add_argument(
        "--figure-width",
        metavar="column|text|MM",
        type=figure_width_mm,
        help="figures for print: a column (88.9 mm), a page (181 mm) or so many mm wide",
    )
    parser.add_argument("--json", action="store_true", help="one JSON object on stdout")
    return parser.parse_args(arguments)


def seed_count(text: str) -> int:
    """Return the number in the text of --seeds."""
    try:
        count = int(text)
    except ValueError:
        raise ArgumentTypeError(f"{text!r} is not an integer") from None
    if not FEWEST_SEEDS <= count <= MOST_SEEDS:
        raise ArgumentTypeError(f"{count} is not in the range {FEWEST_SEEDS} to {MOST_SEEDS}")
    return count


def figure_width_mm(text: str) -> float:
    """Return the width [mm] in the text of --figure-width."""
    try:
        return width_mm(text)
    except ConfigError as error:
        raise ArgumentTypeError(str(error)) from None


def main(arguments: Sequence[str]) -> int:
    """Reproduce the paper and return the exit code."""
    asked = parsed(arguments)
    try:
        reproduce(asked)
    except KeyboardInterrupt:
        talk("interrupted: no result of this run was stored")
        return INTERRUPTED
    except HapticdError as error:
        talk(f"weir2008: {error}")
        if asked.json:
            tell_error(type(error).__name__, str(error))
        return error.exit_code
    return 0


def reproduce(asked: Namespace) -> None:
    """Measure, write the files and print the table."""
    kept = asked.out is not None or not asked.json
    need("numba", "the batch engine")
    if kept:
        need("matplotlib", "a figure")
    files = []
    with watched() as tell:
        found = sections(asked, tell)
        content = summary(asked, found)
        if kept:
            files = page.keep(found, folder(asked.out), content, tell, asked.figure_width)
    named = [str(file) for file in files]
    if asked.json:
        print(json.dumps(content | {"files": named} if files else content))
    else:
        print(page.terminal(found), "", "kept", *(f"  {name}" for name in named), sep="\n")


def sections(asked: Namespace, tell: Progress) -> list[page.Section]:
    """Return all sections of the report."""
    paper = run.plan_reproduce(asked.quick, asked.seeds)
    beyond = future_work.plan_future_work(asked.quick)
    return [
        *page.sections(run.run_reproduce(paper, tell)),
        *future_page.future_sections(future_work.run_future_work(beyond, tell)),
    ]


def summary(asked: Namespace, found: list[page.Section]) -> dict[str, Any]:
    """Return the content of table.json."""
    return {
        "quick": asked.quick,
        "seeds": 0 if asked.quick else asked.seeds,
        "table": table.as_json(row for section in found for row in section.rows),
        "provenance": provenance(date=datetime.now(UTC).isoformat(timespec="seconds")),
    }


def folder(out: Path | None) -> Path:
    """Return the folder of the results."""
    return out or Path("zwidth-runs") / f"{datetime.now(UTC):%Y%m%dT%H%M%S}-reproduce"


# --- what is printed ------------------------------------------------------------------------------


def tell_error(code: str, message: str) -> None:
    """Print an error as an object on stdout, like every verb of `hapticd`."""
    error = {"code": code, "message": message, "detail": None}
    print(json.dumps({"ok": False, "error": error}), flush=True)


@contextmanager
def watched() -> Iterator[Progress]:
    """Show a progress bar; if stderr is not a terminal, a line every ten seconds, so that no log is
    silent for minutes.
    """
    if not sys.stderr.isatty():
        yield lines()
        return
    with progress() as tell:
        yield tell


def lines() -> Progress:
    """Return a function that prints progress as a line on stderr, at most one in ten seconds."""
    last_s = -inf

    def tell(what: str, done: int, total: int) -> None:
        nonlocal last_s
        if monotonic() >= last_s + LINE_S:
            last_s = monotonic()
            talk(f"{what}, {done} of {total}")

    return tell


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
