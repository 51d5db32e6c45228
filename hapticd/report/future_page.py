"""A run of `beyond` as sections of the page of `reproduce`: what the paper left for future work,
with tables and figures.
"""

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from hapticd.measure.beyond import BeyondResult
from hapticd.measure.beyond_display import shown_hz
from hapticd.measure.beyond_levels import FLOWN
from hapticd.measure.beyond_rows import parts, restored
from hapticd.report.future_figures import edge_figure, free_figure, levels_figure, shape_figure
from hapticd.report.paper_page import Drawing, Section
from hapticd.report.passive_set import search_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TITLE = "Beyond the paper"
NAMES = {"envelopes": "lower_edge", "free": "free_motion", "shaped": "shaped", "levels": "levels", "searches": "search"}
BANDS = "bands are 95 % intervals of the mean over seeds (Student's t)"


def sections(result: BeyondResult) -> tuple[Section, ...]:
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
    found = parts(result)
    return tuple(
        Section(f"{TITLE}: {title}", words(result), found[part], (Drawing(f"beyond_{NAMES[part]}", caption, draw),))
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
        f"Damping above {shaped.best.highpass_hz:g} Hz only keeps B and M within 5 % of what plain damping allows "
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
