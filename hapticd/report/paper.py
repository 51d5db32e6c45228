"""The paper, reproduced, as sections of a page: what was asked, the table, and Figs. 2, 3, 4, 7-11 with two of our own."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

from hapticd.measure.reproduce import ReproduceResult
from hapticd.measure.reproduce_rows import Row
from hapticd.measure.reproduce_table import rows
from hapticd.report.paper_envelopes import envelope_figure
from hapticd.report.paper_impedance import single_figure
from hapticd.report.paper_limits import edges_figure, limits_figure
from hapticd.report.paper_maps import set_figure
from hapticd.report.paper_page import Drawing, Section
from hapticd.report.paper_style import WORDS
from hapticd.report.paper_table import readings_table
from hapticd.report.zwidth_walls import walls_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

WORDED = {
    "limits": (
        "Limits on their axes",
        "The other two parameters are 0 while one is searched. After ± one standard deviation between seeds, in round brackets\n"
        "the difference from the paper, in square brackets the note below the table. *Calibrated*: fitted, or so by\n"
        "construction; *independent*: not used in any fit; *arithmetic*: follows from printed numbers alone.",
    ),
    "readings": (
        "Axis and set readings",
        '"The maximum passive virtual stiffness" can be the limit on its axis, or the largest over the whole passive set. Both,\n'
        "side by side; the notes are those of the set readings.",
    ),
    "figures": (
        "Figures",
        "The paper's curves exist only as pictures, so its words are compared. Added damping is a solid line, none a dashed one;\n"
        "dotted lines are predicted; grey is not judged. A tinted band holds the true value with 95 % probability, as far as the\n"
        "noise of the trial goes (in an envelope of the owning trial alone). An envelope's lower edge is the smallest of many\n"
        "noisy values: it lies below its prediction partly because it is a minimum. `share` is that of the seeds which pass.",
    ),
    "band_edge": (
        "Two explanations, one experiment",
        "A lag in the path of the force costs K at every frequency, a high-pass in the velocity channel only at the lowest:\n"
        "moving the lower edge of the judged band tells them apart, on an archived record too.",
    ),
    "arithmetic": ("Arithmetic", "No simulation: the paper's own numbers and equations."),
}
SHAPE = "The paper does not say how its walls were hit: only the shape can be compared."
OWNERS = (
    "The strip names the parameter of the owner that weighs most at each frequency: of K/w, B and |M| w the largest; nobody "
    "where noise alone would make the envelope as wide. The lower edge over many noisy trials lies below its prediction partly "
    "because it is a minimum."
)


def sections(result: ReproduceResult) -> tuple[Section, ...]:
    """In the order of the page."""
    drawings = {
        "limits": (Drawing("limits", "**Limits** on their axes beside the paper's.", lambda: limits_figure(result)),),
        "figures": tuple(_drawings(result)),
        "band_edge": (Drawing("band_edge", "**K limits** over the lower edge of the judged band.", lambda: edges_figure(result)),),
    }
    return tuple(replace(section, drawings=drawings.get(part, ())) for part, section in parts(rows(result)).items())


def parts(found: Iterable[Row]) -> dict[str, Section]:
    """The sections by the part of their rows, without figures; a part that is none of the paper's has its table alone."""
    by_part: dict[str, tuple[Row, ...]] = {}
    for row in found:
        by_part[row.part] = (*by_part.get(row.part, ()), row)
    made = {part: Section(*WORDED.get(part, (part, "")), kept) for part, kept in by_part.items()}
    if "readings" in made:
        made["readings"] = replace(made["readings"], content=readings_table(by_part["limits"], by_part["readings"]))
    return made


def _drawings(result: ReproduceResult) -> Iterator[Drawing]:
    """Of the paper's figures; Fig. 2 only where walls were hit."""

    def drawn(number: int, words: str, draw: "Callable[[str], Figure]", more: str = "") -> Drawing:
        title = f"Fig. {number}: {words}"
        return Drawing(f"fig{number:02d}", f"**Fig. {number}.** {words[0].upper()}{words[1:]}. {more}".strip(), lambda: draw(title))

    def envelope(*places: int) -> "Callable[[str], Figure]":
        return lambda title: envelope_figure(result, places, title)

    def single(*places: int) -> "Callable[[str], Figure]":
        return lambda title: single_figure(result, places, title)

    walls, off, on = result.walls, *WORDS
    if walls is not None:
        yield drawn(2, "walls that come to rest, M = 0", lambda title: walls_figure(walls, title), SHAPE)
    yield drawn(3, f"Z-width {off}", envelope(0), OWNERS)
    yield drawn(4, "one trial, K = 100 N/m, B = 1 N s/m, M = 10 g", single(0))
    yield drawn(7, "K = 50 N/m, B = 2 N s/m, M = 0", single(1, 2))
    yield drawn(8, f"Z-width {on}", envelope(1), OWNERS)
    yield drawn(9, f"passive environments {off}", lambda title: set_figure(result.found[0], title))
    yield drawn(10, f"passive environments {on}", lambda title: set_figure(result.found[1], title))
    yield drawn(11, "Z-width without and with added damping", envelope(0, 1), OWNERS)
