"""What colours, lines and marks mean, the same in every figure: this is the one table of it.

    blue, solid          with added damping, the paper's level where it is one of several; others in brown, wine, olive
    red, dashed          without added damping; nothing else is dashed
    dotted               predicted, black or in the colour of what it predicts; a hollow mark is predicted too
    grey area            not judged
    bracket at the foot  the frequencies that a number was averaged over
    orange, green, sky, forest, purple   K, B > 0, M > 0, B < 0, M < 0
    disc, cross, triangle                a trial passes, fails, escapes

A tinted band about a line is its interval of 95 %. What would break it: a figure that chooses colours of its own.
"""

from collections.abc import Iterable, Sequence
from math import pi, sqrt, tan
from typing import TYPE_CHECKING, Any

from hapticd.analysis.confidence import MANY, student_quantile
from hapticd.measure.reproduce_trials import ADDED_NS_PER_M
from hapticd.report import figures

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Look = dict[str, Any]

DOTTED = (0, (1, 1.3))
OFF: Look = {"color": figures.RED, "linestyle": (0, (4, 1.5))}
ON: Look = {"color": figures.BLUE, "linestyle": "-"}
BROWN, WINE, OLIVE = "#8C510A", "#882255", "#7A7A1A"
MORE: tuple[Look, ...] = tuple({"color": colour, "linestyle": "-"} for colour in (BROWN, WINE, OLIVE, figures.BLACK))
PREDICTED: Look = {"color": figures.BLACK, "linestyle": DOTTED, "linewidth": 1.0}
FOREST = "#00553D"
PARTS = (("K", figures.ORANGE), ("B > 0", figures.GREEN), ("M > 0", figures.SKY), ("B < 0", FOREST), ("M < 0", figures.PURPLE))
DEVICES: tuple[Look, ...] = tuple(
    {"color": colour, "marker": marker} for colour, marker in ((figures.BLACK, "o"), (WINE, "s"), (OLIVE, "^"))
)
LEVEL_MARKS = ("s", "o", "D", "v", "P")
ANSWERS = {"passes": "o", "fails": "x", "escapes": "^"}
INTERVAL = "95 % interval"
NOT_JUDGED = "#e9e9e9"
PROBABILITY = 0.975  # each side of an interval of 95 %


def of_levels(levels: Sequence[float]) -> list[Look]:
    """One for each level of added damping [N s/m]: none; the paper's, or else the first that is some; the others in order."""
    first = ADDED_NS_PER_M if ADDED_NS_PER_M in levels else next((level for level in levels if level), None)
    others = iter(MORE)
    return [OFF if not level else ON if level == first else next(others, MORE[-1]) for level in levels]


def words_of(level: float) -> str:
    """A level of added damping [N s/m] in a legend."""
    return f"with {level:g} N s/m of added damping" if level else "without added damping"


def of_mean(count: int) -> float:
    """Half an interval of 95 % of a mean of `count` values, over their standard deviation: Student's t; 0 for a single one."""
    if count < 2:
        return 0.0
    freedom = count - 1
    if freedom == 1:
        return tan(pi * (PROBABILITY - 0.5)) / sqrt(count)
    return student_quantile(PROBABILITY, freedom - freedom % 2 if freedom < MANY else freedom) / sqrt(count)


def tint(colour: str, share: float = 0.14) -> str:
    """That colour, opaque and light: areas that overlap stay what they are, and never look grey."""
    parts = (int(colour[at : at + 2], 16) for at in (1, 3, 5))
    return "#" + "".join(f"{round(255 - share * (255 - part)):02x}" for part in parts)


def not_judged(axes: Iterable["Axes"], band_hz: tuple[float, float]) -> None:
    """Grey outside the band. Call it when the frequency axes have their range."""
    for axis in axes:
        low, high = axis.get_xlim()
        for begin, end in ((low, band_hz[0]), (band_hz[1], high)):
            if begin < end:
                axis.axvspan(begin, end, color=NOT_JUDGED, linewidth=0, zorder=0)
        axis.set_xlim(low, high)


def grey_patch() -> Any:
    """Of a legend: not judged."""
    from matplotlib.patches import Patch

    return Patch(color=NOT_JUDGED, label="not judged")


def averaged(axis: "Axes", band_hz: tuple[float, float], height: float = 0.03) -> None:
    """A bracket at that share of the height of the axes under the frequencies that are averaged, where their range shows them."""
    low, high = axis.get_xlim()
    ends = max(low, band_hz[0]), min(high, band_hz[1])
    bracket: Look = {"color": figures.BLACK, "linewidth": 1.0, "marker": "|", "markersize": 7}
    axis.plot(ends, (height, height), transform=axis.get_xaxis_transform(), clip_on=False, **bracket)
