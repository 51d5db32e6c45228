"""Appearance and storage of all figures: sizes, axes, and the meaning of colours, lines and marks.

    blue, solid          with active damping: the usual level if there are several; others in
                         brown, wine, olive
    red, dashed          without active damping; nothing else is dashed
    dotted               predicted, black or in the colour of its subject; a hollow mark is
                         predicted too
    grey area            not judged
    orange, green, sky, forest, purple   K, B > 0, M > 0, B < 0, M < 0
    disc, cross, triangle                a trial passes, fails, escapes

A tinted band about a line is its interval of 95 %. Colours are Okabe and Ito's (2008), distinct to
every eye; each has a line style or a marker of the same meaning. Figures are drawn without a window
and stored as PNG of 300 dpi, SVG and PDF. The same data give the same bytes, because files contain
no dates or random names. Sizes are in `figure.mplstyle`, effects of the width in `paper`.

A figure must not choose colours of its own, and must be drawn inside `styled`.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from enum import StrEnum
from math import log10
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hapticd.core.arrays import Floats
from hapticd.core.extras import need
from hapticd.core.params import ACTIVE_DAMPING_NS_PER_M
from hapticd.zwidth.report import paper
from hapticd.zwidth.store import FIGURE_KINDS, not_writable

if TYPE_CHECKING:
    from matplotlib.axes import Axes as Axes
    from matplotlib.figure import Figure as Figure
else:
    Axes = Figure = Any  # matplotlib is optional: it is imported where something is drawn

__all__ = [
    "DEVICES",
    "FINE",
    "HOLLOW",
    "INTERVAL",
    "NORMAL",
    "OFF",
    "ON",
    "PARTS",
    "PREDICTED",
    "WIDTH_IN",
    "Axes",
    "Colour",
    "Figure",
    "Look",
    "axes",
    "draw_band",
    "hertz_axis",
    "legend_handles",
    "level_label",
    "level_styles",
    "mark",
    "mosaic",
    "patch",
    "plain_axis",
    "save",
    "simulated",
    "size_in",
    "styled",
]

Look = dict[str, Any]


class Colour(StrEnum):
    """Those of Okabe and Ito (2008), and darker ones."""

    BLUE = "#0072B2"
    ORANGE = "#E69F00"
    GREEN = "#009E73"
    RED = "#D55E00"
    PURPLE = "#CC79A7"
    SKY = "#56B4E9"
    BLACK = "#000000"
    GREY = "#888888"
    BROWN = "#8C510A"
    WINE = "#882255"
    OLIVE = "#7A7A1A"
    FOREST = "#00553D"


OFF: Look = {"color": Colour.RED, "linestyle": (0, (4, 1.5))}
ON: Look = {"color": Colour.BLUE, "linestyle": "-"}
MORE: tuple[Look, ...] = tuple(
    {"color": colour, "linestyle": "-"}
    for colour in (Colour.BROWN, Colour.WINE, Colour.OLIVE, Colour.BLACK)
)
PREDICTED: Look = {"color": Colour.BLACK, "linestyle": (0, (1, 1.3)), "linewidth": 1.0}
HOLLOW: Look = {"markerfacecolor": "white", "markeredgewidth": 0.8}
MARKS: Look = {"color": Colour.BLACK, "linestyle": ""}
PARTS = (
    ("K", Colour.ORANGE),
    ("B > 0", Colour.GREEN),
    ("M > 0", Colour.SKY),
    ("B < 0", Colour.FOREST),
    ("M < 0", Colour.PURPLE),
)
DEVICES: tuple[Look, ...] = tuple(
    {"color": colour, "marker": mark}
    for colour, mark in ((Colour.BLACK, "o"), (Colour.WINE, "s"), (Colour.OLIVE, "^"))
)
LEVEL_MARKS = ("s", "o", "D", "v", "P")
ANSWERS = {"passes": "o", "fails": "x", "escapes": "^"}
INTERVAL = "95 % interval"
PROBABILITY = 0.975  # each side of it
NORMAL = 1.96  # standard deviations on each side of it
NOT_JUDGED = "#e9e9e9"
# outside every frequency axis
LOWEST_HZ = 1e-3
HIGHEST_HZ = 1e6

WIDTH_IN = 6.69  # 17 cm, two columns: type keeps its size in print
STYLE = Path(__file__).with_name("figure.mplstyle")
UNDATED: dict[str, dict[str, Any]] = {
    ".png": {"Software": None},
    ".svg": {"Date": None},
    ".pdf": {"CreationDate": None},
}
FINE = ((1.0, 2.0, 5.0), (1.0, 1.5, 2.0, 3.0, 5.0, 7.0))
ROUND = ((1.0,), *FINE)
DECADE_IN = 0.95  # width for ticks at 1, 2 and 5
RATIOS = ("height_ratios", "width_ratios")
FEWEST_TICKS = 3
LEAST_RANGE = 2.5  # of a logarithmic axis


@contextmanager
def styled() -> Iterator[None]:
    """Apply this style within it, or in a function that it decorates. MissingLibrary without
    matplotlib.
    """
    with need("matplotlib", "a figure").rc_context(fname=STYLE):
        yield


# --- figures and axes -----------------------------------------------------------------------------


def mosaic(
    panels: paper.Panels,
    width_in: float,
    height_in: float,
    title: str = "",
    width_mm: float | None = None,
    panel_in: float = paper.PANEL_IN,
    **more: Any,
) -> tuple[Figure, dict[str, Axes]]:
    """Create a figure whose axes have names; a repeated name spans both places. It is `width_mm`
    [mm] wide, with its panels in more lines if necessary, by default of the size `width_in` by
    `height_in` [in]. Call it within `styled`.
    """
    from matplotlib.figure import Figure

    page_in = width_in if width_mm is None else width_mm / paper.MM_PER_IN
    type_pt = paper.set_type(page_in)
    lines = paper.arranged(panels, width_in, page_in, panel_in)
    if lines is not panels:
        more = {key: each for key, each in more.items() if key not in RATIOS}
    words = paper.fitted(title, page_in - paper.EDGE_IN, type_pt)
    longer_in = (words.count("\n") - title.count("\n")) * paper.LINE * type_pt / paper.PT_PER_IN
    high_in = paper.height_in(panels, lines, (width_in, height_in), page_in) + longer_in
    figure = Figure(figsize=(page_in, high_in))
    figure.suptitle(words, x=0.01, ha="left")
    return figure, figure.subplot_mosaic([[*line] for line in lines], **more)


def axes(
    rows: int, columns: int, width_in: float, height_in: float, title: str = "", **more: Any
) -> tuple[Figure, list[Axes]]:
    """Create a figure as `mosaic`, and return its axes row by row. Call it within `styled`."""
    panels = [[f"{row} {column}" for column in range(columns)] for row in range(rows)]
    figure, found = mosaic(panels, width_in, height_in, title, **more)
    return figure, [found[name] for row in panels for name in row]


def save(figure: Figure, folder: Path, name: str) -> tuple[Path, ...]:
    """Write NAME.png, NAME.svg and NAME.pdf to `folder`, which is created. The same figure gives
    the same bytes. ConfigError if it cannot be written.
    """
    paths = tuple(folder / f"{name}.{kind}" for kind in FIGURE_KINDS)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with styled():
            paper.settle(figure)
            for path in paths:
                figure.savefig(path, metadata=UNDATED[path.suffix])
    except OSError as error:
        raise not_writable(folder, error) from error
    return paths


def simulated(device: str, seconds: float, more: str = "") -> str:
    """Return the line below a title: the origin of the numbers of a figure; 0 s of trials: by
    prediction alone.
    """
    return (
        f"SIMULATED {device}, {f'{more}{seconds:g} s of noise a trial' if seconds else 'predicted'}"
    )


def size_in(axis: Axes) -> tuple[float, float]:
    """Return the approximate width and height [in] of axes: their figure is not laid out yet."""
    figure: Any = axis.figure
    wide_in, high_in = axis.get_position().size * figure.get_size_inches()
    return float(wide_in), float(high_in)


def hertz_axis(axis: Axes, low_hz: float, high_hz: float) -> None:
    """Set a logarithmic frequency axis with ticks at 1, 2 and 5 of each decade if there is room."""
    axis.set(xscale="log", xlim=(low_hz, high_hz), xlabel="frequency (Hz)")
    roomy = size_in(axis)[0] > DECADE_IN * log10(high_hz / low_hz)
    plain_axis(axis.xaxis, FINE[:1] if roomy else ROUND[:1])


def plain_axis(
    axis: Any,
    digits: Sequence[Sequence[float]] = ROUND,
    words: Callable[[float], str] = "{:g}".format,
) -> None:
    """Label a logarithmic axis with a few round numbers: decades, or 1, 2, 5 of each, or finer ones
    on a short axis; a nearly constant axis is widened. Call it after drawing the data.
    """
    from matplotlib.ticker import FixedLocator, NullLocator

    low, high = axis.get_view_interval()
    if high < LEAST_RANGE * low:
        middle = (low * high) ** 0.5
        low = middle / LEAST_RANGE**0.5
        high = middle * LEAST_RANGE**0.5
        axis.axes.set(**{f"{axis.axis_name}lim": (low, high)})
    for these in digits:
        ticks = [
            digit * 10.0**power
            for power in range(-15, 16)
            for digit in these
            if low <= digit * 10.0**power <= high
        ]
        if len(ticks) >= FEWEST_TICKS:
            break
    axis.set_major_locator(FixedLocator(ticks))
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(lambda value, place: words(value))


# --- lines, bands and marks -----------------------------------------------------------------------


def level_styles(levels: Sequence[float]) -> list[Look]:
    """Return one for each level of active damping [N s/m]: none; the usual one, or otherwise the
    first above 0; the others in order.
    """
    first = (
        ACTIVE_DAMPING_NS_PER_M
        if ACTIVE_DAMPING_NS_PER_M in levels
        else next((level for level in levels if level), None)
    )
    others = iter(MORE)
    return [
        OFF if not level else ON if level == first else next(others, MORE[-1]) for level in levels
    ]


def level_label(level: float) -> str:
    """Return the label of a level of active damping [N s/m] in a legend."""
    return f"with {level:g} N s/m of active damping" if level else "without active damping"


def tint(colour: str, share: float = 0.14) -> str:
    """Return that colour, opaque and light: overlapping areas keep their colours, and never look
    grey.
    """
    parts = (int(colour[at : at + 2], 16) for at in (1, 3, 5))
    return "#" + "".join(f"{round(255 - share * (255 - part)):02x}" for part in parts)


def draw_band(
    axis: Axes,
    x: Floats,
    value: Floats,
    spread: Any,
    look: Look,
    label: str | None = None,
    linear: bool = False,
) -> None:
    """Draw a line and its interval: `spread` (F,) on both sides of the logarithm of `value` (F,),
    or of itself if `linear`; nan: none.
    """
    low, high = (
        (value - spread, value + spread)
        if linear
        else (value * np.exp(-spread), value * np.exp(spread))
    )
    axis.fill_between(x, low, high, color=look["color"], alpha=0.28, linewidth=0)
    axis.plot(x, value, label=label, **look)


def legend_handles(axis: Axes) -> list[Any]:
    """Return handles of a legend: the drawn elements, each label once."""
    return [
        *{
            str(handle.get_label()): handle for handle in axis.get_legend_handles_labels()[0]
        }.values()
    ]


def mark(label: str, **look: Any) -> Any:
    """Return a line or a mark of a legend."""
    from matplotlib.lines import Line2D

    return Line2D([], [], label=label, **look)


def patch(label: str, colour: str, **more: Any) -> Any:
    """Return an area of a legend."""
    from matplotlib.patches import Patch

    return Patch(
        **{"facecolor": colour, "edgecolor": "#bbbbbb", "linewidth": 0.0, "label": label, **more}
    )


def not_judged(axes: Iterable["Axes"], band_hz: tuple[float, float]) -> Any:
    """Draw grey outside the band, and return its mark for a legend. Call it when the frequency axes
    have their range.
    """
    for axis in axes:
        for begin, end in ((LOWEST_HZ, band_hz[0]), (band_hz[1], HIGHEST_HZ)):
            axis.axvspan(begin, end, color=NOT_JUDGED, linewidth=0, zorder=0)
    return patch("not judged", NOT_JUDGED)
