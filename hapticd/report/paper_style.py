"""What the figures of the paper have in common: as wide as a page, added damping solid and blue, none dashed and red."""

from typing import Any

from hapticd.measure.reproduce_trials import ADDED_NS_PER_M
from hapticd.report import figures

WIDTH_IN = 6.69  # 17 cm, two columns: letters keep their size in print
SMALL_PT = 8.0  # nothing is smaller
OFF: dict[str, Any] = {"color": figures.RED, "linestyle": (0, (4, 1.5))}
ON: dict[str, Any] = {"color": figures.BLUE, "linestyle": "-"}
LOOKS = (OFF, ON)
PREDICTED: dict[str, Any] = {"color": figures.BLACK, "linestyle": (0, (1, 1.3)), "linewidth": 1.0}
WORDS = ("without added damping", f"with {ADDED_NS_PER_M:g} N s/m of added damping")
MARKS = ("o", "s", "^")  # of devices
TRUSTED = "95 % of the estimate"


def simulated(device: str, seeds: int) -> str:
    """How the numbers of a figure came about."""
    return f"SIMULATED {device}, {'90 s of noise a trial' if seeds else 'predicted'}"
