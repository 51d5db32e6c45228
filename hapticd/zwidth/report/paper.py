"""The layout of a figure for its width, and tables as text.

Width (`arranged`, `settle`). A figure is drawn at its final size. A width, on a screen or in print,
determines:

    type      at least 7 pt, the minimum of journals: `NARROW_PT` on a narrow figure
    panels    those that would be too narrow next to each other go to the next line, in order
    legends   all of a narrow figure become one below it, in as many columns as fit
    words     titles, labels and legends are broken into lines, never before a unit
    height    follows from these, up to that of a page

A panel whose numbers or colour bar need more room than `PANEL_IN` needs a figure that passes
`panel_in`.

Tables (`Table`, `text`). Columns have units, and numbers have three digits and are aligned. Shares
and durations are formatted too (`changed`, `duration`). A column of numbers and words is aligned as
words.
"""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import chain, groupby
from math import inf, isnan, lcm
from textwrap import fill, wrap
from typing import TYPE_CHECKING, Any

from hapticd.core.errors import ConfigError
from hapticd.core.units import percent

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = [
    "Cell",
    "Table",
    "changed",
    "duration",
    "legends",
    "shown",
    "spread",
    "table",
    "text",
    "width_mm",
]

# --- tables ---------------------------------------------------------------------------------------
DIGITS = 3
WIDEST_LAST = 70  # characters of the last column
GAP = "  "
NONE = 1e-6  # a relative change that is only rounding

Cell = str | float


@dataclass(frozen=True, slots=True)
class Table:
    """`columns` are names, with their unit where they have one; a row has a cell for each."""

    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    title: str = ""


def table(columns: Iterable[str], rows: Iterable[Iterable[Cell]], title: str = "") -> Table:
    """Return a table from any iterables."""
    return Table(tuple(columns), tuple(tuple(row) for row in rows), title)


def text(content: Table) -> str:
    """Format the table, numbers right-aligned, words left-aligned, long words of the last column in
    several lines.
    """
    cells = [content.columns, *([shown(cell) for cell in row] for row in content.rows)]
    numeric = [
        all(not isinstance(row[place], str) for row in content.rows)
        for place in range(len(content.columns))
    ]
    broken = [_broken(row) for row in cells]
    widths = [
        max(len(line[place]) for block in broken for line in block)
        for place in range(len(content.columns))
    ]
    ruler = [["-" * width for width in widths]]
    lines = [line for block in (broken[0], ruler, *broken[1:]) for line in block]
    return "\n".join(
        [
            *([content.title] if content.title else []),
            *(_aligned(line, widths, numeric) for line in lines),
        ]
    )


def shown(cell: Cell) -> str:
    """Format a number to three digits; "-" for nan."""
    if isinstance(cell, str):
        return cell
    if isnan(cell):
        return "-"
    return f"{cell:.{DIGITS}g}" if abs(cell) < 1000.0 else f"{cell:,.0f}"


def changed(share: float) -> str:
    """Format a relative change."""
    if share == inf:
        return "all"
    if share < NONE:
        return "0 %"
    return percent(share)


def duration(seconds: float) -> str:
    """Format seconds with a suitable prefix."""
    if isnan(seconds):
        return "-"
    for factor, unit in ((1.0, "s"), (1e3, "ms"), (1e6, "us")):
        if seconds * factor >= 1.0:
            return f"{seconds * factor:.3g} {unit}"
    return f"{seconds * 1e9:.3g} ns"


def _broken(row: Sequence[str]) -> list[list[str]]:
    """Return the lines of a row: its last cell is wrapped."""
    first, *more = wrap(row[-1], WIDEST_LAST) or [""]
    blank = [""] * (len(row) - 1)
    return [[*row[:-1], first], *([*blank, line] for line in more)]


def _aligned(line: Sequence[str], widths: Sequence[int], numeric: Sequence[bool]) -> str:
    return GAP.join(
        cell.rjust(width) if right else cell.ljust(width)
        for cell, width, right in zip(line, widths, numeric, strict=True)
    ).rstrip()


# --- the width of a figure ------------------------------------------------------------------------
MM_PER_IN = 25.4
PT_PER_IN = 72.0
# of a column and of a page of IEEE Transactions: 3.5 in and 7 1/8 in
WIDTHS_MM = {"column": 88.9, "text": 181.0}
NARROWEST_MM = 60.0
WIDEST_MM = 400.0
LEAST_PT = 7.0

NARROW_IN = 5.0  # below it type is smaller, and legends are below the figure
SMALL = 0.833  # of font.size: matplotlib's "small"
NARROW_PT = 8.5  # font.size there; `small` is 7.1 pt
PANEL_IN = 1.6  # a panel is not narrower
PANEL_SHARE = 0.5  # nor less than that of its width on a screen
FLATTEST = 0.9  # of the height of a panel on a screen
HIGHEST_IN = 9.0  # height of a page
LINE = 1.35  # height of a line of words, over its type
EDGE_IN = 0.1  # margin of text
KEY_IN = 0.6  # width of the line or mark of a legend
BELOW: dict[str, Any] = {"loc": "outside lower center", "frameon": False}  # a legend
FIXED = "\u00a0"  # a non-breaking space
LEAST_LETTERS = 8  # of a line
# a number with its unit, and text in brackets
UNITS = r"\([^()]*\)|[\w.]+ (N s/m|N/m|N|Hz|g|mm/s|m/s|mm|s|%)(?=\W|$)|\w = \S+"

Panels = Sequence[Sequence[str]]
Inside = tuple["Axes", list[Any], dict[str, Any]]  # axes, handles, where


def width_mm(text: str) -> float:
    """Return the width [mm] for `text`: column, text or a number. ConfigError for others."""
    named = WIDTHS_MM.get(text)
    try:
        found = float(text) if named is None else named
    except ValueError:
        found = 0.0
    if not NARROWEST_MM <= found <= WIDEST_MM:
        names = ", ".join(f"{name} ({value:g} mm)" for name, value in WIDTHS_MM.items())
        raise ConfigError(
            f"figure width {text!r}: {NARROWEST_MM:g} to {WIDEST_MM:g} mm are possible, for type"
            f" stays at {LEAST_PT:g} pt and more; write {names}, or a number of mm"
        )
    return found


def set_type(width_in: float) -> float:
    """Set the size of type [pt] for a figure of that width, within `styled`, and return it."""
    from matplotlib import rcParams

    if width_in < NARROW_IN:
        rcParams["font.size"] = NARROW_PT
    return float(rcParams["font.size"])


def arranged(panels: Panels, own_in: float, page_in: float, panel_in: float = PANEL_IN) -> Panels:
    """Return names of panels, line by line, for a figure that is `own_in` [in] wide on a screen and
    is drawn `page_in` [in] wide. Single panels below each other are in the order of the columns.
    """
    known: set[str] = set()
    rows = []
    for row in panels:
        rows.append([name for name in dict.fromkeys(row) if name not in known])
        known.update(row)
    lines: list[list[str]] = []
    for count, alike in groupby(filter(None, rows), len):
        least_in = max(panel_in, PANEL_SHARE * own_in / count)
        names = [*chain.from_iterable(alike)]
        fitting = range(1, max(1, min(count, int(page_in / least_in))) + 1)
        beside = max(each for each in fitting if len(names) % each == 0)
        lines += [names[at : at + beside] for at in range(0, len(names), beside)]
    if len(lines) == len(rows):
        return panels
    if len(lines) == len(known):
        return [[name] for name in dict.fromkeys(chain.from_iterable(zip(*panels, strict=True)))]
    return spread(lines)


def spread(lines: Panels) -> Panels:
    """Arrange lines of different numbers of panels on one grid, with equal widths in each line."""
    columns = lcm(*map(len, lines))
    return [[name for name in line for _ in range(columns // len(line))] for line in lines]


def height_in(before: Panels, after: Panels, own_in: tuple[float, float], page_in: float) -> float:
    """Return the height [in] of a figure of size `own_in` after rearranging its panels: narrower
    panels are flatter.
    """
    columns, beside = (len(dict.fromkeys(panels[0])) for panels in (before, after))
    share = page_in / own_in[0] * columns / beside
    flat = min(1.0, max(FLATTEST, share**0.5))
    highest_in = HIGHEST_IN if page_in < own_in[0] else own_in[1]
    return float(min(highest_in, flat * own_in[1] * len(after) / len(before)))


def fitted(words: str, room_in: float, type_pt: float) -> str:
    """Break `words` into lines no longer than `room_in` [in], a number and its unit in one line."""
    return "\n".join(_filled(line, room_in, type_pt) for line in words.split("\n"))


def _filled(line: str, room_in: float, type_pt: float) -> str:
    from matplotlib.font_manager import FontProperties
    from matplotlib.textpath import text_to_path

    font = FontProperties(size=type_pt)
    long_pt, _, _ = text_to_path.get_text_width_height_descent(line, font, ismath=False)
    if long_pt <= PT_PER_IN * room_in:
        return line
    most = int(len(line) * PT_PER_IN * room_in / long_pt)
    bound = re.sub(UNITS, lambda found: found[0].replace(" ", FIXED), line)
    return fill(bound, max(most, LEAST_LETTERS), break_long_words=False).replace(FIXED, " ")


def settle(figure: "Figure") -> None:
    """Lay out a figure once for all of its files: titles and labels longer than their axes are
    broken into lines.
    """
    set_type(figure.get_figwidth())
    for part in (_labels, _titles):  # panels are narrower next to broken labels
        figure.draw_without_rendering()
        for words, room_in in chain.from_iterable(map(part, figure.axes)):
            words.set_text(fitted(words.get_text(), room_in, float(words.get_fontsize())))
    figure.draw_without_rendering()
    figure.set_layout_engine("none")


def _labels(axis: "Axes") -> list[tuple[Any, float]]:
    """Return the labels of axes, and the maximum length [in] of each."""
    figure: Any = axis.figure
    box = axis.get_window_extent()
    wide_in, high_in = box.width / figure.dpi, box.height / figure.dpi
    return [(axis.xaxis.label, wide_in + EDGE_IN), (axis.yaxis.label, high_in + EDGE_IN)]


def _titles(axis: "Axes") -> list[tuple[Any, float]]:
    """Return the title of axes, and its maximum length [in]."""
    figure: Any = axis.figure
    wide_in = axis.get_window_extent().width / figure.dpi
    texts = (one for one in axis.get_children() if hasattr(one, "get_text"))
    return [(one, wide_in) for one in texts if one.get_text() == axis.get_title("left")]


def legends(
    figure: "Figure", handles: Sequence[Any], ncols: int = 1, title: str = "", *inside: Inside
) -> None:
    """Add a legend of `handles` below a figure, and others `inside` its axes; a narrow figure gets
    one below for all. If `ncols` columns do not fit, fewer are used. Call it last, within `styled`.
    """
    narrow = figure.get_figwidth() < NARROW_IN
    if narrow:
        every = [*chain.from_iterable(own for _, own, _ in inside), *handles]
        handles = [*{str(one.get_label()): one for one in every}.values()]
    for axis, own, where in () if narrow else inside:
        axis.legend(handles=own, **where)
    if handles:
        _below(figure, handles, max(ncols, 2) if narrow else ncols, title)


def _below(figure: "Figure", handles: Sequence[Any], ncols: int, title: str) -> None:
    wide_in = float(figure.get_figwidth())
    small_pt = SMALL * set_type(wide_in)
    for one in handles:
        one.set_label(fitted(str(one.get_label()), wide_in - KEY_IN, small_pt))
    words = fitted(title, wide_in - EDGE_IN, small_pt) or None
    for columns in range(min(ncols, len(handles)), 0, -1):
        legend = figure.legend(handles=handles, ncols=columns, title=words, **BELOW)
        if columns == 1 or legend.get_window_extent().width < wide_in * figure.dpi:
            break
        legend.remove()
    lines = -(-len(handles) // columns) + (-len(handles) // ncols)
    figure.set_figheight(figure.get_figheight() + lines * LINE * small_pt / PT_PER_IN)
