"""What the figures of the paper have in common: as wide as a page; colours and lines are those of `looks`."""

from hapticd.measure.reproduce_trials import LEVELS
from hapticd.report.looks import of_levels, words_of

WIDTH_IN = 6.69  # 17 cm, two columns: letters keep their size in print
SMALL_PT = 8.0  # nothing is smaller
LOOKS = tuple(of_levels(LEVELS))
WORDS = tuple(words_of(level) for level in LEVELS)


def simulated(device: str, seeds: int) -> str:
    """How the numbers of a figure came about."""
    return f"SIMULATED {device}, {'90 s of noise a trial' if seeds else 'predicted'}"
