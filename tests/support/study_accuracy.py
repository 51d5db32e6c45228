"""The cost of accuracy: the knee, both comparisons with closed forms, and trials in lock-step."""

from math import nan

from hapticd.studies.accuracy import AccuracyRow

# --- the knee -------------------------------------------------------------------------------------


def row(seconds: float, total: float, sweep: str = "s") -> AccuracyRow:
    return AccuracyRow(sweep, "", seconds, nan, total)
