"""The report of a reproduction: sections of words, a table, reasons and figures, as text for a terminal and as a Markdown page.

Whatever has something to say adds sections: `paper.sections` for the paper itself, others for what goes beyond it. The page, the
table and the figures are all made from that one list.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from hapticd.measure.reproduce_rows import Row
from hapticd.report.paper_table import markdown, notes, paper_table
from hapticd.report.table import Table, text

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, slots=True)
class Drawing:
    """A figure to be drawn, within `figures.style`: `name` of its files, what it shows."""

    name: str
    caption: str
    draw: "Callable[[], Figure]"


@dataclass(frozen=True, slots=True)
class Section:
    """`rows` of the table, shown as `content` if that is given; `words` and captions are Markdown."""

    title: str
    words: str
    rows: tuple[Row, ...] = ()
    drawings: tuple[Drawing, ...] = ()
    content: Table | None = None

    @property
    def table(self) -> Table:
        """As shown."""
        return self.content or paper_table(self.rows)


def page(title: str, head: str, sections: Iterable[Section]) -> str:
    """Markdown; figures are expected beside it."""
    parts = [f"# {title}", head]
    for section in sections:
        parts += [f"## {section.title}", section.words]
        if section.rows:
            parts += [table_part(section)]
        parts += [f"![{drawing.name}]({drawing.name}.png)\n\n{drawing.caption}" for drawing in section.drawings]
    return "\n\n".join(part.strip() for part in parts if part) + "\n"


def table_part(section: Section) -> str:
    """Its table and the reasons below, as Markdown."""
    told = "\n".join(f"- {note}" for note in notes(section.rows))
    return f"{markdown(section.table)}\n{told}".strip()


def terminal(sections: Sequence[Section]) -> str:
    """The same for a terminal, without figures."""
    parts = ["\n".join([text(section.table), *notes(section.rows)]) for section in sections if section.rows]
    titles = [section.title for section in sections if section.rows]
    return "\n\n".join(f"{title}\n\n{part}" for title, part in zip(titles, parts, strict=True))
