"""The report of a reproduction: sections of words, a table, reasons and figures, as text for a
terminal and as a Markdown page.

`sections` makes those of the paper itself: what was asked, the table, and Figs. 2, 3, 4, 7-11 with
two of our own; `future_sections` adds what it left for future work. The page, the table and the
figures are all made from that one list.

A run leaves REPORT.md, the table as table.json, table.csv and table.md, and each figure as PNG and
SVG. Everything is made in a folder of its own inside the one that was asked for and moved there at
the end, where it takes the place of the run before: whoever presses Ctrl-C finds the files of one
run there, and so does whoever asks for a run that makes less. What the run before made, its report
names; files that it does not name are somebody else's and stay.
"""

import csv
import json
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np

from hapticd.errors import ConfigError
from hapticd.measure.beyond import FLOWN, BeyondResult, shown_hz
from hapticd.measure.beyond_rows import parts as future_parts
from hapticd.measure.beyond_rows import restored
from hapticd.measure.progress import Progress, Steps, silent
from hapticd.measure.reproduce import ReproduceResult
from hapticd.measure.reproduce_rows import Row
from hapticd.measure.reproduce_table import rows
from hapticd.report import style
from hapticd.report.paper_figures import (
    WORDS,
    edge_figure,
    edges_figure,
    envelope_figure,
    free_figure,
    levels_figure,
    limits_figure,
    passive_figure,
    shape_figure,
    single_figure,
)  # fmt: skip
from hapticd.report.paper_table import as_json, markdown, notes, paper_table, readings_table
from hapticd.report.passive_set import search_figure, walls_figure
from hapticd.report.table import Table, text

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
TITLE = "The paper, reproduced"
FUTURE = "Beyond the paper"
FUTURE_NAMES = {"envelopes": "lower_edge", "free": "free_motion", "shaped": "shaped", "levels": "levels", "searches": "search"}
BANDS = "bands are 95 % intervals of the mean over seeds (Student's t)"
TABLE_JSON, REPORT = "table.json", "REPORT.md"


@dataclass(frozen=True, slots=True)
class Drawing:
    """A figure to be drawn, within `styled`: `name` of its files, what it shows."""

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


# --- the paper -------------------------------------------------------------------------------------------------------------------


def sections(result: ReproduceResult) -> tuple[Section, ...]:
    """In the order of the page."""
    drawings = {
        "limits": (Drawing("limits", "**Limits** on their axes beside the paper's.", partial(limits_figure, result)),),
        "figures": _drawings(result),
        "band_edge": (Drawing("band_edge", "**K limits** over the lower edge of the judged band.", partial(edges_figure, result)),),
    }
    return tuple(replace(section, drawings=drawings.get(part, ())) for part, section in parts(rows(result)).items())


def parts(found: Iterable[Row]) -> dict[str, Section]:
    """The sections by the part of their rows, without figures; a part that is none of the paper's
    has its table alone.
    """
    by_part: dict[str, tuple[Row, ...]] = {}
    for row in found:
        by_part[row.part] = (*by_part.get(row.part, ()), row)
    made = {part: Section(*WORDED.get(part, (part, "")), kept) for part, kept in by_part.items()}
    if "readings" in made:
        made["readings"] = replace(made["readings"], content=readings_table(by_part["limits"], by_part["readings"]))
    return made


def _drawings(result: ReproduceResult) -> tuple[Drawing, ...]:
    """Of the paper's figures; Fig. 2 only where walls were hit."""
    off, on = WORDS
    drawn: list[tuple[int, str, Callable[[str], Figure], str]] = [
        (3, f"Z-width {off}", partial(envelope_figure, result, (0,)), OWNERS),
        (4, "one trial, K = 100 N/m, B = 1 N s/m, M = 10 g", partial(single_figure, result, (0,)), ""),
        (7, "K = 50 N/m, B = 2 N s/m, M = 0", partial(single_figure, result, (1, 2)), ""),
        (8, f"Z-width {on}", partial(envelope_figure, result, (1,)), OWNERS),
        (9, f"passive environments {off}", partial(passive_figure, result.found[0]), ""),
        (10, f"passive environments {on}", partial(passive_figure, result.found[1]), ""),
        (11, "Z-width without and with added damping", partial(envelope_figure, result, (0, 1)), OWNERS),
    ]
    if result.walls is not None:
        drawn.insert(0, (2, "walls that come to rest, M = 0", partial(walls_figure, result.walls), SHAPE))
    return tuple(
        Drawing(
            f"fig{number:02d}",
            f"**Fig. {number}.** {words[0].upper()}{words[1:]}. {more}".strip(),
            partial(draw, f"Fig. {number}: {words}"),
        )
        for number, words, draw, more in drawn
    )


# --- what it left for future work ------------------------------------------------------------------------------------------------


def future_sections(result: BeyondResult) -> tuple[Section, ...]:
    """Lower edge, free motion, shaped damping, levels; directed search where it was made."""
    searched = [compared.found for compared in result.searches]
    told: list[tuple[str, Callable[[BeyondResult], str], str, str, Callable[[], Figure]]] = [
        (
            "negative virtual damping", _edge_words, "envelopes",
            f"Envelopes with the owners of their lower edges; {BANDS}.", partial(edge_figure, result),
        ),
        (
            "free motion", _free_words, "free",
            f"What is felt where no stiffness is rendered; {BANDS}.", partial(free_figure, result),
        ),
        (
            "damping that depends on frequency", _shape_words, "shaped",
            "Limits, free motion and envelope over the corner.", partial(shape_figure, result),
        ),
        (
            "levels of added damping", _level_words, "levels",
            "Limits, set and free motion over the level.", partial(levels_figure, result),
        ),
        (
            "directed search", _search_words, "searches",
            "Slices of the set with the trials next to each, and all trials in their order.", partial(search_figure, searched),
        ),
    ]  # fmt: skip
    found = future_parts(result)
    return tuple(
        Section(f"{FUTURE}: {title}", words(result), found[part], (Drawing(f"beyond_{FUTURE_NAMES[part]}", caption, draw),))
        for title, words, part, caption, draw in told
        if found[part]
    )


def _edge_words(result: BeyondResult) -> str:
    low = {name: found.lower_db().mean() for name, found in result.envelopes.items()}
    wide = {name: found.width_db().mean() for name, found in result.envelopes.items()}
    at_noise, safe = (restored(result, kind).mean() for kind in ("", "_safe"))
    twice = ""
    if result.hardy:
        share = 100.0 * max(result.hardy[name] for name in ("off", "on", "on_negative_B"))
        twice = f": shaken twice as hard, {share:.0f} % at most of the owners of any of these edges pass"
    return (
        "Added damping raises the lower edge of the Z-width in 2-20 Hz "
        f"from {low['off']:.1f} to {low['on']:.1f} dB (re 1 N s/m, mean over ln f). "
        f"With B < 0 it comes to {low['on_negative_B']:.1f} dB, {at_noise:.0f} % of the way back, and the upper edge stays. "
        f"The Z-width there is {wide['off']:.1f} dB without damping, {wide['on']:.1f} dB with it, "
        f"and {wide['on_negative_B']:.1f} dB with B < 0 beside it. "
        f"The undamped device with B < 0 reaches {low['off_negative_B']:.1f} dB.\n\n"
        f"These edges count on dry friction, as limits at one perturbation do{twice}. "
        f"Without counting on friction the lower edge is at {low['off_safe']:.1f} dB undamped, {low['on_safe']:.1f} dB damped, "
        f"{low['on_negative_B_safe']:.1f} dB with B < 0 ({safe:.0f} % of the way back). "
        "All are edges of one grid, that of Figs. 3 and 8 with rows of B < 0. A finer grid goes lower, because K and M cancel more "
        "exactly, and other seeds let other environments pass: a decibel or two, more than the scatter in the table (ADR 0034)."
    )


def _free_words(result: BeyondResult) -> str:
    off, on, alone, both = result.free.motions
    heavier = shown_hz()[np.argmax(both.size > off.size)]
    return (
        "No grid matters where no stiffness is rendered. "
        f"Mean |Z| in 2-20 Hz is {off.low_db().mean():.1f} dB undamped and {on.low_db().mean():.1f} dB damped. "
        f"B = {alone.damping:.2f} N s/m alone gives {alone.low_db().mean():.1f} dB, "
        "because the lag of the loop turns it into mass; "
        f"with M = {1e3 * both.mass_kg:.1f} g beside it {both.low_db().mean():.1f} dB is left, "
        f"lighter than the undamped device below {heavier:.0f} Hz and heavier above. "
        f"All four are passive for every input without friction, the last with {both.spare:.2g} N s/m to spare, "
        "which leaves nothing for an error of the model. Eq. 2 of the paper must not be asked about B < 0; it refuses."
    )


def _shape_words(result: BeyondResult) -> str:
    shaped = result.shaped
    alone = 100.0 * shaped.best.limits[0] / shaped.plain.limits[0]
    beside = 100.0 * shaped.stiffest[1] / shaped.stiffest[0]
    low, wide = shaped.bounds.lower_db().mean(), shaped.bounds.width_db().mean()
    return (
        f"Damping above {shaped.best.hertz:g} Hz only keeps B and M within 5 % of what plain damping allows "
        f"and brings the lower edge in 2-20 Hz to {low:z.1f} dB, with B >= 0: a Z-width of {wide:.1f} dB. "
        f"K alone goes to {alone:.0f} % of what plain damping allows, K with its best B and M to {beside:.0f} %. "
        'The paper\'s "added mechanical dissipation is rarely needed at low frequency" does not hold for K alone: '
        "a sampled spring needs its dissipation at every frequency, down to 0, unless virtual B beside it brings some. "
        "A low-pass does the opposite, and beside the circuit's own lag it is active at high frequency."
    )


def _level_words(result: BeyondResult) -> str:
    levels = result.levels
    low, high, highest = FLOWN[0], FLOWN[-2], FLOWN[-1]
    growth = levels.gain(low, high)
    left = 100.0 * levels.gain(high, highest) / growth
    return (
        f"Between {low:g} and {high:g} N s/m each N s/m of added damping buys {growth[0]:.0f} N/m of K, "
        f"{growth[1]:.2f} N s/m of B and {-1e3 * growth[2]:.1f} g of negative mass by prediction; the table has the trials. "
        f"From there to {highest:g} N s/m it buys {left[0]:.0f} %, {left[1]:.0f} % and {left[2]:.0f} % of that. "
        f"What is paid is free motion: {levels.free_db[0]:.1f} dB without, "
        f"{levels.free_db[-1]:.1f} dB at {levels.level[-1]:g} N s/m."
    )


def _search_words(result: BeyondResult) -> str:
    told = []
    for found in result.searches:
        counts = ", ".join(f"{found.share(wrong):.1f} % after {count}" for count, wrong in found.searched.items())
        told.append(
            f"At {found.damping_ns_per_m:g} N s/m the search holds wrongly, of the passive points, {counts} trials; "
            f"prediction alone {found.share(found.predicted):.1f} %, "
            f"the grid flown again with other noise {found.share(found.other_noise):.1f} %."
        )
    saved = [f"{found.points} trials by {found.enough}" for found in result.searches if found.enough]
    if saved:
        told.append(f"To know as much as one flight of the grid, it replaces {' and '.join(saved)}.")
    return " ".join(told)


# --- text ------------------------------------------------------------------------------------------------------------------------


def page(title: str, head: str, sections: Iterable[Section]) -> str:
    """Markdown; figures are expected beside it."""
    parts = [f"# {title}", head]
    for section in sections:
        parts += [f"## {section.title}", section.words, table_part(section) if section.rows else ""]
        parts += [f"![{drawing.name}]({drawing.name}.png)\n\n{drawing.caption}" for drawing in section.drawings]
    return "\n\n".join(part.strip() for part in parts if part) + "\n"


def table_part(section: Section) -> str:
    """Its table and the reasons below, as Markdown."""
    told = "\n".join(f"- {note}" for note in notes(section.rows))
    return f"{markdown(section.table)}\n{told}".strip()


def terminal(sections: Sequence[Section]) -> str:
    """The same for a terminal, without figures."""
    return "\n\n".join(
        "\n".join([section.title, "", text(section.table), *notes(section.rows)]) for section in sections if section.rows
    )


# --- files -----------------------------------------------------------------------------------------------------------------------


def keep(sections: Sequence[Section], folder: Path, told: Mapping[str, Any], tell: Progress = silent) -> list[Path]:
    """Write it all into `folder`, which is made; `told` (quick, seeds, table, provenance) goes into
    table.json. ConfigError.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with TemporaryDirectory(prefix=".unfinished-", dir=folder) as name:
            unfinished = Path(name)
            _draw(sections, unfinished, tell)
            _write(sections, unfinished, told)
            made = sorted(unfinished.iterdir())
            for name in _of_the_run_before(folder) - {file.name for file in made}:
                (folder / name).unlink(missing_ok=True)
            return [file.replace(folder / file.name) for file in made]
    except OSError as error:
        raise ConfigError(f"{folder}: {error.strerror}; name a folder that you may write to with --out") from error


def _of_the_run_before(folder: Path) -> set[str]:
    """Names of its figures."""
    if not (folder / REPORT).is_file():
        return set()
    named = re.findall(r"\]\((\w+)\.png\)", (folder / REPORT).read_text(errors="replace"))
    return {f"{name}.{kind}" for name in named for kind in ("png", "svg")}


def _draw(sections: Sequence[Section], folder: Path, tell: Progress) -> None:
    drawings = [drawing for section in sections for drawing in section.drawings]
    steps = Steps(tell, len(drawings))
    for drawing in drawings:
        steps.next(f"drawing {drawing.name}")
        with style.styled():
            style.save(drawing.draw(), folder, drawing.name)
    steps.end()


def _write(sections: Sequence[Section], folder: Path, told: Mapping[str, Any]) -> None:
    rows = [row for section in sections for row in section.rows]
    content = as_json(rows)
    (folder / TABLE_JSON).write_text(json.dumps(told, indent=1) + "\n")
    (folder / "table.md").write_text(table_part(Section(TITLE, "", tuple(rows))) + "\n")
    (folder / REPORT).write_text(page(TITLE, _head(told), sections))
    with (folder / "table.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, list(content[0]))
        writer.writeheader()
        writer.writerows(content)


def _head(told: Mapping[str, Any]) -> str:
    how = f"90 s trials, {told['seeds']} seeds behind each limit on its axis"
    if told["quick"]:
        how = "by prediction alone, without trials"
    made = told["provenance"]
    versions = ", ".join(f"{name} {version}" for name, version in made["libraries"].items())
    return (
        "D. W. Weir, J. E. Colgate and M. A. Peshkin, *Measuring and increasing Z-width with active electrical damping*, Haptics "
        f"Symposium 2008, on SIMULATED devices: {how}. Made {made['date']} by hapticd {made['hapticd']} ({versions}). "
        "What was tried and what does not match is told in docs/reproduction.md."
    )
