"""A finished figure at the width of a column or of a page of a paper.

A figure is drawn once, as wide as it suits a screen, and `fit` brings it to a width in print. It
does not shrink a picture, for then its type would shrink too; it arranges the figure anew:

    type      8 pt and more become 7 pt and more, which is the least that journals take
    panels    those that would be too narrow beside each other go to the next line, in their order;
              a bar of colours stays at its panel
    legends   all of a narrow figure become one below it, in as many columns as there is room for
    words     titles, labels and the legend are broken into lines
    ticks     of numbers that would touch, the round ones stay; words become smaller
    numbers   beside marks that would lie on each other: the first one stays
    height    follows from all that, and from what a page can hold

The data are never touched: lines, marks, limits of axes are those that were drawn.

What would break it: a legend whose handles are containers, such as those of an errorbar, since the
legend is made again from its own lines, marks and areas; and axes that stand in no grid.
"""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from math import lcm, log10
from textwrap import fill
from typing import Any

from hapticd.core.errors import ConfigError
from hapticd.zwidth.report.style import BELOW, Axes, Figure

__all__ = ["width_mm"]

MM_PER_IN = 25.4
# of a column and of a page of IEEE Transactions: 3.5 in and 7 1/8 in
WIDTHS_MM = {"column": 88.9, "text": 181.0}
NARROWEST_MM = 60.0
WIDEST_MM = 400.0

LEAST_PT = 7.0
NARROW_IN = 5.0  # below it type is smaller, and legends stand below the figure
TYPE = 0.85  # of a narrow figure, over the type of a screen
PANEL_IN = 1.6  # a panel is not narrower
PANEL_SHARE = 0.5  # nor less than that of its width on a screen
FLATTEST = 0.7  # of the height of a panel on a screen
HIGHEST_IN = 9.0  # that a page holds
EDGE_IN = 0.1  # kept free on both sides of words
MOST_COLUMNS = 6  # of a legend
AXIS_IN = 0.55  # that ticks and labels take beside axes
APART = 1.05  # of the size of labels from one to the next
FIXED = "\u00a0"  # a space at which no line ends
LEAST_LETTERS = 8  # of a line
# a number with its unit, and what stands in brackets
UNITS = r"\([^()]*\)|[\w.]+ (N s/m|N/m|N|Hz|g|mm/s|m/s|mm|s|%)(?=\W|$)|\w = \S+"
COLOURS = "<colorbar>"  # what matplotlib calls its axes
OVERLAP = 0.5  # of the height of a panel: it stands in that row


def width_mm(text: str) -> float:
    """The width [mm] that `text` names: column, text or a number. ConfigError for others."""
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


def fit(figure: Figure, wide_mm: float) -> None:
    """Bring `figure` to that width [mm], and to the height that it then takes."""
    width_in = wide_mm / MM_PER_IN
    renderer = _renderer(figure)
    figure.draw_without_rendering()
    bands = _pooled([_band(figure, row) for row in _rows(figure)])
    narrow = width_in < NARROW_IN
    _set_type(figure, TYPE if narrow else 1.0)
    figure.set_figwidth(width_in)
    lines = _reflow(bands, width_in)
    _legends(figure, width_in, narrow, renderer)
    _break_title(figure, width_in, renderer)
    extra_in = _extra_in(figure, renderer)
    body_in = _body_in(bands, width_in, HIGHEST_IN - extra_in)
    _break_labels(lines, width_in, renderer)
    figure.set_figheight(body_in + extra_in)
    figure.draw_without_rendering()
    _break_upright(figure, renderer)
    figure.draw_without_rendering()
    _break_across(figure, renderer)
    figure.draw_without_rendering()
    _thin(figure, renderer)
    _declutter(figure, renderer)


# --- panels ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Band:
    """Panels beside each other on a screen, in the order of reading; sizes of one of them and of
    all [in].
    """

    axes: tuple[Axes, ...]
    columns: int
    panel_in: float
    height_in: float
    aside_in: float = 0.0  # that a bar of colours takes

    def beside(self, width_in: float) -> int:
        """How many of its panels have room in a line."""
        least_in = max(PANEL_IN, PANEL_SHARE * self.panel_in) + self.aside_in
        return min(self.columns, max(1, int(width_in / least_in)))

    def line_count(self, width_in: float) -> int:
        """Lines that its panels then take."""
        return -(-len(self.axes) // self.beside(width_in))


def _box(axis: Axes) -> Any:
    """What the grid gives to a panel; one with an aspect of its own may be drawn smaller."""
    return axis.get_position(original=True)


def _rows(figure: Figure) -> list[list[Axes]]:
    """Axes that stand beside each other, from above; one that spans two rows joins them."""
    rows: list[list[Axes]] = []
    panels = [one for one in figure.axes if one.get_label() != COLOURS]  # those follow their panel
    for axis in sorted(panels, key=lambda one: -_box(one).y1):
        place = _box(axis)
        foot = min((_box(one).y0 for one in rows[-1]), default=1.0) if rows else 1.0
        if rows and place.y1 - foot > OVERLAP * place.height:
            rows[-1].append(axis)
        else:
            rows.append([axis])
    return rows


def _band(figure: Figure, row: list[Axes]) -> _Band:
    """One row of a screen; a panel as high as the row is read last."""
    width_in = float(figure.get_figwidth())
    boxes = {axis: _box(axis) for axis in row}
    tops = sorted({round(box.y1, 2) for box in boxes.values()}, reverse=True)
    lefts = {round(box.x0, 2) for box in boxes.values()}
    whole = max(box.y1 for box in boxes.values()) - min(box.y0 for box in boxes.values())
    level = len(tops) > 1

    def read(axis: Axes) -> tuple[bool, int, float]:
        box = boxes[axis]
        return (level and box.height > OVERLAP * 1.5 * whole, tops.index(round(box.y1, 2)), box.x0)

    ordered = tuple(sorted(row, key=read))
    tight = [axis.get_tightbbox() for axis in row]
    top = max(box.y1 for box in tight if box is not None)
    foot = min(box.y0 for box in tight if box is not None)
    high_in = (top - foot) / figure.dpi
    coloured = any(one.get_label() == COLOURS for one in figure.axes)
    return _Band(
        ordered,
        len(lefts),
        width_in / len(lefts),
        high_in / max(1, len(tops)),
        AXIS_IN if coloured else 0.0,
    )


def _pooled(bands: Iterable[_Band]) -> list[_Band]:
    """Rows of as many panels, one below the other, are one band."""
    found: list[_Band] = []
    for band in bands:
        before = found[-1] if found else None
        alike = before and 1 < before.columns == band.columns == len(band.axes)
        if before and alike:
            found[-1] = replace(
                before,
                axes=(*before.axes, *band.axes),
                height_in=max(before.height_in, band.height_in),
            )
        else:
            found.append(band)
    return found


def _by_column(axes: Iterable[Axes]) -> list[Axes]:
    """Panels that come into one line each: columns of a screen one after the other."""
    return sorted(axes, key=lambda one: (round(_box(one).x0, 2), -_box(one).y1))


def _reflow(bands: Sequence[_Band], width_in: float) -> list[list[Axes]]:
    """Put panels into the next line where they have no room; the lines."""
    lines: list[list[Axes]] = []
    widths: list[int] = []
    for band in bands:
        count = band.beside(width_in)
        ordered = band.axes if count > 1 else _by_column(band.axes)
        for begin in range(0, len(ordered), count):
            line = list(ordered[begin : begin + count])
            alone = len(line) == 1 and not _shares(line[0], band.axes)
            lines.append(line)
            widths.append(1 if alone else count)
    if all(band.beside(width_in) == band.columns for band in bands):
        return lines
    first = {axis: band.axes[0] for band in bands for axis in band.axes}
    labels = {axis: (axis.get_xlabel(), axis.get_ylabel()) for axis in first}
    _place(lines, widths)
    for line in lines:
        _dress(line, lines, first, labels)
    return lines


def _place(lines: Sequence[Sequence[Axes]], widths: Sequence[int]) -> None:
    """A grid of those lines, each with room for so many panels."""
    figure = lines[0][0].figure
    columns = lcm(*widths)
    heights = [_box(line[0]).height for line in lines]
    grid = figure.add_gridspec(len(lines), columns, height_ratios=heights)
    for row, (line, width) in enumerate(zip(lines, widths, strict=True)):
        span = columns // width
        for place, axis in enumerate(line):
            axis.set_subplotspec(grid[row, place * span : (place + 1) * span])


def _shares(axis: Axes, others: Iterable[Axes]) -> bool:
    return any(
        other is not axis and axis.get_shared_x_axes().joined(axis, other) for other in others
    )


def _dress(
    line: Sequence[Axes],
    lines: Sequence[Sequence[Axes]],
    first: dict[Axes, Axes],
    labels: dict[Axes, tuple[str, str]],
) -> None:
    """Labels of what stands at the left and at the foot now."""
    at = next(place for place, one in enumerate(lines) if one[0] is line[0])
    below = lines[at + 1] if at + 1 < len(lines) else []
    for place, axis in enumerate(line):
        origin = first[axis]
        if place == 0 and not axis.yaxis.get_tick_params()["labelleft"]:
            axis.set_ylabel(labels[origin][1])
            axis.tick_params(labelleft=True)
        if place and axis.get_shared_y_axes().joined(axis, line[0]):
            axis.set_ylabel("")
            axis.tick_params(labelleft=False)
        under = below[place] if place < len(below) else None
        covered = under is not None and axis.get_shared_x_axes().joined(axis, under)
        if covered:
            axis.set_xlabel("")
        elif not axis.xaxis.get_tick_params()["labelbottom"]:
            axis.set_xlabel(next((labels[one][0] for one in first if _same(one, axis, first)), ""))
        axis.tick_params(labelbottom=not covered)


def _same(one: Axes, axis: Axes, first: dict[Axes, Axes]) -> bool:
    """Whether both stood in one band, with a label below the one."""
    return first[one] is first[axis] and bool(one.get_xlabel())


def _body_in(bands: Sequence[_Band], width_in: float, most_in: float) -> float:
    """Height [in] of all panels: flatter where they are narrower, at most `most_in`."""
    found = 0.0
    for band in bands:
        share = width_in / band.beside(width_in) / band.panel_in
        flat = min(1.0, max(FLATTEST, share**0.5))
        found += flat * band.height_in * band.line_count(width_in)
    return min(found, most_in)


# --- words ----------------------------------------------------------------------------------------


def _renderer(figure: Figure) -> Any:
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    canvas: Any = FigureCanvasAgg(figure)
    return canvas.get_renderer()


def _set_type(figure: Figure, scale: float) -> None:
    from matplotlib.text import Text

    for words in figure.findobj(Text):
        words.set_fontsize(max(LEAST_PT, scale * float(words.get_fontsize())))
    for axis in figure.axes:
        for each in (axis.xaxis, axis.yaxis):
            size = each.get_tick_params().get("labelsize")
            now = next((label.get_fontsize() for label in each.get_ticklabels()), LEAST_PT)
            each.set_tick_params(labelsize=size if isinstance(size, float) else now)


def _break(words: Any, width_in: float, renderer: Any, upright: bool = False) -> None:
    """Break the lines of a text that are longer than `width_in`, never between a number and its
    unit.
    """
    lines = words.get_text().split("\n")
    broken = []
    for line in lines:
        words.set_text(line)
        box = words.get_window_extent(renderer)
        long_in = (box.height if upright else box.width) / words.figure.dpi
        most = int(len(line) * width_in / long_in) if long_in > width_in else len(line)
        broken.append(_filled(line, most))
    words.set_text("\n".join(broken))


def _filled(line: str, most: int) -> str:
    if most >= len(line):
        return line
    bound = re.sub(UNITS, lambda found: found[0].replace(" ", FIXED), line)
    return fill(bound, max(most, LEAST_LETTERS), break_long_words=False).replace(FIXED, " ")


def _break_title(figure: Figure, width_in: float, renderer: Any) -> None:
    for title in _titled(figure, figure.get_suptitle()):
        _break(title, width_in - EDGE_IN, renderer)


def _titled(owner: Any, text: str) -> list[Any]:
    """The text of a figure or of axes that says so."""
    from matplotlib.text import Text

    shown = (one for one in owner.get_children() if isinstance(one, Text))
    return [one for one in shown if text and one.get_text() == text]


def _break_labels(lines: Sequence[Sequence[Axes]], width_in: float, renderer: Any) -> None:
    for line in lines:
        for axis in line:
            room_in = width_in / len(line)
            for words in (*_titled(axis, axis.get_title("left")), axis.xaxis.label):
                _break(words, room_in - AXIS_IN, renderer)


def _break_upright(figure: Figure, renderer: Any) -> None:
    """Break labels that are longer than their axes are high."""
    for axis in figure.axes:
        high_in = axis.get_window_extent(renderer).height / figure.dpi
        _break(axis.yaxis.label, high_in + EDGE_IN, renderer, upright=True)


def _break_across(figure: Figure, renderer: Any) -> None:
    """Break titles of panels that would go on over the next panel or the edge."""
    boxes = {axis: axis.get_window_extent(renderer) for axis in figure.axes}
    for axis, box in boxes.items():
        beside = (one.x0 for one in boxes.values() if one.x0 > box.x1 and one.y1 > box.y0)
        room_in = (min(beside, default=float(figure.bbox.x1)) - box.x0) / figure.dpi
        for words in _titled(axis, axis.get_title("left")):
            _break(words, room_in - EDGE_IN, renderer)


def _legends(figure: Figure, width_in: float, narrow: bool, renderer: Any) -> None:
    """One legend below, in as many columns as there is room for."""
    own = [*figure.legends]
    within: list[Any] = [axis.get_legend() for axis in figure.axes if narrow]
    inside = [legend for legend in within if legend]
    if not own and not inside:
        return
    handles: dict[str, Any] = {}
    for legend in (*inside, *own):
        for handle, words in zip(legend.legend_handles, legend.get_texts(), strict=True):
            handles.setdefault(words.get_text(), handle)
    title = next((one.get_title().get_text() for one in (*own, *inside)), "")
    for legend in (*inside, *own):
        legend.remove()
    size = (own or inside)[0].get_texts()[0].get_fontsize()
    for columns in range(min(len(handles), MOST_COLUMNS), 0, -1):
        legend = figure.legend(
            handles=[*handles.values()],
            labels=[*handles],
            ncols=columns,
            title=title or None,
            fontsize=size,
            title_fontsize=size,
            **BELOW,
        )
        for words in (*legend.get_texts(), legend.get_title()):
            _break(words, width_in / columns - AXIS_IN if columns == 1 else width_in, renderer)
        if columns == 1 or legend.get_window_extent(renderer).width < width_in * figure.dpi:
            return
        legend.remove()


def _extra_in(figure: Figure, renderer: Any) -> float:
    """Height [in] of title and legends."""
    parts = [*figure.legends, *_titled(figure, figure.get_suptitle())]
    return float(
        sum(part.get_window_extent(renderer).height / figure.dpi + EDGE_IN for part in parts)
    )


# --- what would touch -----------------------------------------------------------------------------


def _thin(figure: Figure, renderer: Any) -> None:
    """Of tick labels that would touch, keep those of round numbers."""
    for axis in figure.axes:
        for each, upright in ((axis.xaxis, False), (axis.yaxis, True)):
            shown = [one for one in each.get_major_ticks() if one.label1.get_visible()]
            spans = {}
            for one in shown:
                box = one.label1.get_window_extent(renderer)
                if one.label1.get_text() and box.width:
                    spans[one.get_loc()] = (box.y0, box.y1) if upright else (box.x0, box.x1)
            kept = _kept(spans, each.get_scale() == "log")
            if len(kept) == len(spans):
                continue
            if any(one.label1.get_text()[:1].isalpha() for one in shown):
                each.set_tick_params(labelsize=LEAST_PT)  # words: none may be left out
            else:
                each.set_major_formatter(_only(each.get_major_formatter(), kept))


def _kept(spans: dict[float, tuple[float, float]], logarithmic: bool) -> set[float]:
    """Those whose labels are apart: round ones first, or each second, third... of a scale."""
    if logarithmic:
        kept: list[float] = []
        for value in sorted(spans, key=_roundness):
            if all(_apart(spans[value], spans[other]) for other in kept):
                kept.append(value)
        return set(kept)
    values = sorted(spans)
    for step in range(1, len(values) + 1):
        some = values[::step]
        if all(_apart(spans[one], spans[other]) for one, other in pairwise(some)):
            return set(some)
    return set(values)


def _roundness(value: float) -> tuple[bool, bool, float]:
    """Powers of ten first, then 1, 2 and 5 of each."""
    power = log10(value) if value > 0.0 else 0.5
    return (abs(power - round(power)) > 1e-9, f"{value:e}"[0] not in "125", value)


def _apart(one: tuple[float, float], other: tuple[float, float]) -> bool:
    middle = abs(sum(one) - sum(other)) / 2.0
    return middle > APART * (one[1] - one[0] + other[1] - other[0]) / 2.0


def _only(words: Any, kept: set[float]) -> Any:
    """A formatter that is silent beside `kept`."""
    from matplotlib.ticker import FuncFormatter

    return FuncFormatter(lambda value, place: words(value, place) if value in kept else "")


def _declutter(figure: Figure, renderer: Any) -> None:
    """Of texts within axes that would lie on each other, the first one stays."""
    for axis in figure.axes:
        kept: list[Any] = []
        for words in axis.texts:
            box = words.get_window_extent(renderer)
            if any(box.overlaps(other) for other in kept):
                words.set_visible(False)
            else:
                kept.append(box)
