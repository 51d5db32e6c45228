"""The report of a reproduction: sections of text, a table, reasons and figures, for a terminal and
as a Markdown page.

`sections` makes those of the paper itself: the question, the table, and Figs. 2, 3, 4, 7-11 with
two of our own. `future_work` adds the paper's future work. The page, the table and the figures are
all made from that one list.

A run leaves REPORT.md, the table as table.json, table.csv and table.md, and each figure as PNG and
SVG. All files are made in a temporary folder inside the target and moved there at the end, where
they replace the earlier run. So after Ctrl-C, or after a run that makes fewer files, the folder
contains the files of exactly one run. REPORT.md lists the files of a run; other files stay.
"""

import csv
import json
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from examples.weir2008.figures import (  # fmt: skip
    LABELS,
    edges_figure,
    envelope_figure,
    limits_figure,
    passive_figure,
    single_figure,
)
from examples.weir2008.paper import SECTIONS
from examples.weir2008.rows import PaperRow, rows
from examples.weir2008.run import ReproduceResult
from examples.weir2008.table import as_json, markdown, notes, paper_table, readings_table
from hapticd.core.errors import ConfigError
from hapticd.zwidth.report.paper import Table, text
from hapticd.zwidth.report.passive_set import walls_figure
from hapticd.zwidth.report.style import Figure, save, styled
from hapticd.zwidth.store import FIGURE_KINDS, Progress, Steps, silent

__all__ = ["TABLE_JSON", "keep", "sections", "terminal"]

SHAPE = "The paper does not describe the impacts on its walls: only the shape can be compared."
OWNERS = (
    "The strip names the parameter of the owner that weighs most at each frequency: of K/w, B and"
    " |M| w the largest; nobody where noise alone would make the envelope as wide. The lower edge"
    " over many noisy trials lies below its prediction partly because it is a minimum."
)
TITLE = "The paper, reproduced"
TABLE_JSON = "table.json"
REPORT = "REPORT.md"


@dataclass(frozen=True, slots=True)
class Drawing:
    """A figure to be drawn, within `styled`: `name` of its files, and its caption."""

    name: str
    caption: str
    draw: Callable[..., Figure]  # with `width_mm`


@dataclass(frozen=True, slots=True)
class Section:
    """`rows` of the table, or `content` in their place; `words` and captions are Markdown."""

    title: str
    words: str
    rows: tuple[PaperRow, ...] = ()
    drawings: tuple[Drawing, ...] = ()
    content: Table | None = None

    @property
    def table(self) -> Table:
        """The table as shown."""
        return self.content or paper_table(self.rows)


# --- the paper ------------------------------------------------------------------------------------


def sections(result: ReproduceResult) -> tuple[Section, ...]:
    """Return the sections in the order of the page."""
    drawings = {
        "limits": (
            Drawing(
                "limits",
                "**Limits** on their axes, and those of the paper.",
                partial(limits_figure, result),
            ),
        ),
        "figures": _drawings(result),
        "band_edge": (
            Drawing(
                "band_edge",
                "**K limits** over the lower edge of the judged band.",
                partial(edges_figure, result),
            ),
        ),
    }
    return tuple(
        replace(section, drawings=drawings.get(part, ()))
        for part, section in parts(rows(result)).items()
    )


def parts(found: Iterable[PaperRow]) -> dict[str, Section]:
    """Return the sections by the part of their rows, without figures; a part outside the paper has
    only its table.
    """
    by_part: dict[str, tuple[PaperRow, ...]] = {}
    for row in found:
        by_part[row.part] = (*by_part.get(row.part, ()), row)
    made = {}
    for part, kept in by_part.items():
        content = SECTIONS.get(part, {"title": part, "words": ""})
        made[part] = Section(content["title"], content["words"], kept)
    if "readings" in made:
        made["readings"] = replace(
            made["readings"], content=readings_table(by_part["limits"], by_part["readings"])
        )
    return made


def _drawings(result: ReproduceResult) -> tuple[Drawing, ...]:
    """Return drawings of the paper's figures; Fig. 2 only if walls were tested."""
    off, on = LABELS
    drawn: list[tuple[int, str, Callable[..., Figure], str]] = [
        (3, f"Z-width {off}", partial(envelope_figure, result, (0,)), OWNERS),
        (
            4,
            "one trial, K = 100 N/m, B = 1 N s/m, M = 10 g",
            partial(single_figure, result, (0,)),
            "",
        ),
        (7, "K = 50 N/m, B = 2 N s/m, M = 0", partial(single_figure, result, (1, 2)), ""),
        (8, f"Z-width {on}", partial(envelope_figure, result, (1,)), OWNERS),
        (9, f"passive environments {off}", partial(passive_figure, result.found[0]), ""),
        (10, f"passive environments {on}", partial(passive_figure, result.found[1]), ""),
        (
            11,
            "Z-width without and with active damping",
            partial(envelope_figure, result, (0, 1)),
            OWNERS,
        ),
    ]
    if result.walls is not None:
        drawn.insert(
            0, (2, "walls that come to rest, M = 0", partial(walls_figure, result.walls), SHAPE)
        )
    return tuple(
        Drawing(
            f"fig{number:02d}",
            f"**Fig. {number}.** {words[0].upper()}{words[1:]}. {more}".strip(),
            partial(draw, f"Fig. {number}: {words}"),
        )
        for number, words, draw, more in drawn
    )


# --- text -----------------------------------------------------------------------------------------


def page(title: str, head: str, sections: Iterable[Section]) -> str:
    """Return Markdown; figures are expected in the same folder."""
    parts = [f"# {title}", head]
    for section in sections:
        parts += [f"## {section.title}", section.words, table_part(section) if section.rows else ""]
        parts += [
            f"![{drawing.name}]({drawing.name}.png)\n\n{drawing.caption}"
            for drawing in section.drawings
        ]
    return "\n\n".join(part.strip() for part in parts if part) + "\n"


def table_part(section: Section) -> str:
    """Return the table of a section and the reasons below, as Markdown."""
    reasons = "\n".join(f"- {note}" for note in notes(section.rows))
    return f"{markdown(section.table)}\n{reasons}".strip()


def terminal(sections: Sequence[Section]) -> str:
    """Return the sections as text for a terminal, without figures."""
    return "\n\n".join(
        "\n".join([section.title, "", text(section.table), *notes(section.rows)])
        for section in sections
        if section.rows
    )


# --- files ----------------------------------------------------------------------------------------


def keep(
    sections: Sequence[Section],
    folder: Path,
    content: Mapping[str, Any],
    tell: Progress = silent,
    width_mm: float | None = None,
) -> list[Path]:
    """Write everything into `folder`, which is created; `content` (quick, seeds, table, provenance)
    becomes table.json, figures are `width_mm` [mm] wide or as drawn. ConfigError.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with TemporaryDirectory(prefix=".unfinished-", dir=folder) as name:
            unfinished = Path(name)
            _draw(sections, unfinished, width_mm, tell)
            _write(sections, unfinished, content)
            made = sorted(unfinished.iterdir())
            for name in _of_the_run_before(folder) - {file.name for file in made}:
                (folder / name).unlink(missing_ok=True)
            return [file.replace(folder / file.name) for file in made]
    except OSError as error:
        raise ConfigError(
            f"{folder}: {error.strerror}; name a folder that you may write to with --out"
        ) from error


def _of_the_run_before(folder: Path) -> set[str]:
    """Return the names of the figures of the earlier run."""
    if not (folder / REPORT).is_file():
        return set()
    named = re.findall(r"\]\((\w+)\.png\)", (folder / REPORT).read_text(errors="replace"))
    return {f"{name}.{kind}" for name in named for kind in FIGURE_KINDS}


def _draw(
    sections: Sequence[Section], folder: Path, width_mm: float | None, tell: Progress
) -> None:
    drawings = [drawing for section in sections for drawing in section.drawings]
    steps = Steps(tell, len(drawings))
    for drawing in drawings:
        steps.next(f"drawing {drawing.name}")
        with styled():
            save(drawing.draw(width_mm=width_mm), folder, drawing.name)
    steps.end()


def _write(sections: Sequence[Section], folder: Path, content: Mapping[str, Any]) -> None:
    rows = [row for section in sections for row in section.rows]
    cells = as_json(rows)
    (folder / TABLE_JSON).write_text(json.dumps(content, indent=1) + "\n")
    (folder / "table.md").write_text(table_part(Section(TITLE, "", tuple(rows))) + "\n")
    (folder / REPORT).write_text(page(TITLE, _head(content), sections))
    with (folder / "table.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, list(cells[0]))
        writer.writeheader()
        writer.writerows(cells)


def _head(content: Mapping[str, Any]) -> str:
    how = (
        "by prediction alone, without trials"
        if content["quick"]
        else f"90 s trials, {content['seeds']} seeds behind each limit on its axis"
    )
    made = content["provenance"]
    versions = ", ".join(f"{name} {version}" for name, version in made["libraries"].items())
    return (
        "D. W. Weir, J. E. Colgate and M. A. Peshkin, *Measuring and increasing Z-width with"
        f" active electrical damping*, Haptics Symposium 2008, on SIMULATED devices: {how}. Made"
        f" {made['date']} by hapticd {made['hapticd']} ({versions}). What was tried and what does"
        " not match stands in docs/reproduction.md."
    )
