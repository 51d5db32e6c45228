"""Why a number differs from the paper's: one reason for each row of the table that does not match."""

from math import isnan

from hapticd.measure.reproduce_limits import Limit
from hapticd.measure.reproduce_rows import LITERAL, TOLERANCE, Row
from hapticd.measure.reproduce_trials import MAIN

UNDAMPED_LITERAL = (
    "the paper prints no friction and no physical damping: Re Z = 0 at K = B = M = 0, and nothing beyond it is passive"
)
LITERAL_REASONS = {
    "K_max": "without lag and friction, Eq. 2's KT/2 is all that 1.74 Ns/m has to pay; noise at 2 Hz costs the rest",
    "B_max": "1.74 Ns/m over 0.458 per filtered Ns/m: no Coulomb friction that grows as the motion slows down",
    "M_min": "1.74 Ns/m over 293 per kg: no Coulomb friction that grows as the motion slows down",
}
MAIN_REASONS = {
    "K_max_off": "beyond it the motion runs away, which prediction does not see: it lies a tenth above the trials",
    "M_min_on": "B wants more and M less in every fit: one damping for both cannot give 2.67 and 2.75",
}
HIGH_PASS_REASONS = {
    "K_max_on": "fails in 2-3 Hz alone, where the high-pass turns the phase; scatter between seeds is large",
    "K_max_off": "runs away beyond it: next to no viscous damping, so the limit scatters from seed to seed",
}
RATIO_REASONS = {
    "K": "follows from its two limits",
    "B": "B wants more and M less from the same damping, in every fit",
    "M": "B wants more and M less from the same damping, in every fit",
}
BOUGHT = "damping and mass beside it buy stiffness, with and without added damping"


def of_limit(quantity: str, device: str, difference: float) -> str:
    """Of an axis limit by its name; nothing where it matches, except where the device cannot."""
    stem, _, mode = quantity.rpartition("_")
    if device == LITERAL:
        return UNDAMPED_LITERAL if mode == "off" else LITERAL_REASONS[stem]
    if abs(difference) <= TOLERANCE:
        return ""
    if device == MAIN:
        return MAIN_REASONS.get(quantity, "residual of a fit of five numbers to six limits")
    return HIGH_PASS_REASONS.get(quantity, "fitted on one seed and fewer frequencies")


def of_ratio(name: str, row: Row) -> str:
    """Of on over off."""
    if isnan(row.ours):
        return "nothing is passive without added damping"
    return "" if row.matches else RATIO_REASONS[name]


def of_set(limit: Limit, row: Row, axis: Row) -> str:
    """Where on the set it is found, and why it is not the paper's; `axis` is its other reading."""
    if isnan(limit.predicted):
        return UNDAMPED_LITERAL
    others = [f"{name} {factor * value:.3g} {unit}" for name, factor, value, unit in _beside(limit)]
    place = f"with {' and '.join(others)} beside it"
    if row.matches:
        return ""
    if limit.device == LITERAL or limit.axis:
        return f"{place}; its axis reading differs by {100.0 * axis.difference:+.1f} % already"
    return f"{place}; {BOUGHT}"


def _beside(limit: Limit) -> list[tuple[str, float, float, str]]:
    units = (("K", 1.0, "N/m"), ("B", 1.0, "Ns/m"), ("M", 1e3, "g"))
    every = [(name, factor, value, unit) for (name, factor, unit), value in zip(units, limit.base, strict=True)]
    return [each for axis, each in enumerate(every) if axis != limit.axis]
