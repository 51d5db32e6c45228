"""How every figure looks and is kept: drawn off-screen, PNG to look at and SVG to print, units at the axes.

Colours are Okabe and Ito's (2008), told apart by everybody; whatever colour says, a line style or a marker says as well. What they
mean is in `looks`.
The same data give the same bytes: SVG carries no date and no random names.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hapticd.errors import ConfigError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

BLUE, ORANGE, GREEN, RED, PURPLE, SKY, BLACK, GREY = (
    "#0072B2", "#E69F00", "#009E73", "#D55E00", "#CC79A7", "#56B4E9", "#000000", "#888888",
)  # fmt: skip
ROUND = ((1.0,), (1.0, 2.0, 5.0), (1.0, 1.5, 2.0, 3.0, 5.0, 7.0))
FEWEST_TICKS = 3
LEAST_RANGE = 2.5  # of a logarithmic axis
INTERVAL = 1.96  # standard deviations on each side of a band of 95 %
STYLE: Any = {
    "figure.dpi": 110, "savefig.dpi": 110, "font.size": 9.5, "axes.titlesize": 10, "axes.labelsize": 9.5, "legend.fontsize": 8.5,
    "axes.grid": True, "grid.color": "#dddddd", "grid.linewidth": 0.6, "axes.spines.top": False, "axes.spines.right": False,
    "axes.axisbelow": True, "legend.frameon": True, "legend.framealpha": 0.9, "legend.edgecolor": "#cccccc", "lines.linewidth": 1.3,
    "svg.hashsalt": "hapticd", "svg.fonttype": "none",
}  # fmt: skip


@contextmanager
def style() -> Iterator[None]:
    """Within it figures look like ours. ConfigError without matplotlib."""
    try:
        import matplotlib as mpl
    except ImportError as error:
        raise ConfigError(f"figures are drawn with matplotlib ({error}): install hapticd[plot]") from error
    with mpl.rc_context(STYLE):
        yield


def axes(rows: int, columns: int, width_in: float, height_in: float, **more: Any) -> "tuple[Figure, list[Axes]]":
    """A figure without a window, and its axes row by row. Call it within `style`."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width_in, height_in), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.subplots(rows, columns, squeeze=False, **more)
    return figure, list(grid.ravel())


def mosaic(panels: Any, width_in: float, height_in: float, **more: Any) -> "tuple[Figure, dict[str, Axes]]":
    """A figure whose axes have names; one that is named twice spans both places. Call it within `style`."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width_in, height_in), layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.subplot_mosaic(panels, **more)


def save(figure: "Figure", folder: Path, name: str) -> tuple[Path, Path]:
    """NAME.png and NAME.svg in `folder`, which is made. ConfigError if it cannot be written to."""
    paths = folder / f"{name}.png", folder / f"{name}.svg"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with style():
            figure.savefig(paths[0], metadata={"Software": None})
            figure.savefig(paths[1], metadata={"Date": None})
    except OSError as error:
        raise ConfigError(f"{folder}: {error.strerror}; name a folder that you may write to with --out") from error
    return paths


def hertz_axis(axis: "Axes", low_hz: float, high_hz: float) -> None:
    """A logarithmic frequency axis with the numbers that people say."""
    from matplotlib.ticker import FixedLocator, NullLocator

    spoken = [digit * 10.0**power for power in range(-1, 5) for digit in (1, 2, 5)]
    axis.set_xscale("log")
    axis.set_xlim(low_hz, high_hz)
    axis.xaxis.set_major_locator(FixedLocator([f for f in spoken if low_hz <= f <= high_hz]))
    axis.xaxis.set_minor_locator(NullLocator())
    axis.xaxis.set_major_formatter(lambda value, place: f"{value:g}")
    axis.set_xlabel("frequency (Hz)")


def seconds_axis(axis: Any) -> None:
    """Label a logarithmic axis of seconds with the prefixes that people use."""
    from matplotlib.ticker import EngFormatter

    _spoken(axis)
    axis.set_major_formatter(EngFormatter(unit="s", sep=" "))


def plain_axis(axis: Any) -> None:
    """Label a logarithmic axis with plain numbers."""
    _spoken(axis)
    axis.set_major_formatter(lambda value, place: f"{value:g}")


def _spoken(axis: Any) -> None:
    """A few round numbers: decades, or 1, 2, 5 of each, or finer ones where the axis is short."""
    from matplotlib.ticker import FixedLocator, NullLocator

    low, high = axis.get_view_interval()
    if high < LEAST_RANGE * low:
        low, high = (low * high / LEAST_RANGE) ** 0.5, (low * high * LEAST_RANGE) ** 0.5
        setters = {"x": axis.axes.set_xlim, "y": axis.axes.set_ylim}
        setters[axis.axis_name](low, high)
    for digits in ROUND:
        ticks = [digit * 10.0**power for power in range(-15, 16) for digit in digits if low <= digit * 10.0**power <= high]
        if len(ticks) >= FEWEST_TICKS:
            break
    axis.set_major_locator(FixedLocator(ticks))
    axis.set_minor_locator(NullLocator())
