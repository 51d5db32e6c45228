"""What the paper left for future work: a section of REPORT.md for each part, with its rows, its
words and its figure.

lower_bound_*   mean |Z| of the envelope's lower edge over ln f in 2-20 Hz, dB re 1 N s/m
zwidth_*        mean distance of its edges there, dB
free_motion_*   mean |Z| without K there, dB re 1 N s/m
*_safe          passive without counting on friction, so at any amplitude; the others at the
                perturbation of the trials

The paper has nothing to compare these rows with.
"""

from dataclasses import replace
from functools import partial
from math import nan

import numpy as np

from hapticd.core.arrays import Floats
from hapticd.studies.weir2008.future_figures import (
    edge_figure,
    free_figure,
    levels_figure,
    shape_figure,
)
from hapticd.studies.weir2008.future_work import (
    TRIED_LEVELS,
    Bounds,
    FutureWorkResult,
    SearchCheck,
    mean_sd,
    shown_hz,
)
from hapticd.studies.weir2008.page import Drawing, Section
from hapticd.studies.weir2008.paper import ADDED_NS_PER_M, MAIN, MODES, NAMES, UNITS
from hapticd.studies.weir2008.rows import PaperRow
from hapticd.zwidth.report.passive_set import search_figure

__all__ = ["future_sections"]

PART = "beyond"  # of these rows in table.json
PREDICTED = np.empty(0)  # values by trials: there are none
BANDS = "bands are 95 % intervals of the mean over seeds (Student's t)"
LITTLE = 0.5  # of the growth before; below it a limit saturates


def future_sections(result: FutureWorkResult) -> tuple[Section, ...]:
    """Lower edge, free motion, shaped damping, levels; directed search where it was made."""
    parts = (_lower_edge, _free_motion, _shaped, _levels, *([_search] if result.searches else []))
    return tuple(part(result) for part in parts)


def _row(
    result: FutureWorkResult,
    quantity: str,
    runs: Floats,
    unit: str,
    predicted: float = nan,
    note: str = "",
) -> PaperRow:
    """A row by trials of each seed, or as predicted where there are none."""
    ours, sd = mean_sd(runs) if len(runs) else (predicted, nan)
    seeds = len(result.plan.seeds) if len(runs) else 0
    return PaperRow(
        quantity, nan, ours, unit, "independent", MAIN, sd, seeds, predicted, note, PART
    )


def restored(result: FutureWorkResult, kind: str = "") -> Floats:
    """How much of what active damping raised the lower edge by is taken back [%] (seeds,);
    `kind` "" or "_safe".
    """
    off, on, negative = (
        result.envelopes[f"{name}{kind}"].lower_db() for name in ("off", "on", "on_negative_B")
    )
    return np.asarray(100.0 * (on - negative) / (on - off))


def _lower_edge(result: FutureWorkResult) -> Section:
    rows = []
    for name, bounds in result.envelopes.items():
        note = _edge_note(result, name, bounds)
        low_db = bounds.lower_db()
        rows.append(_row(result, f"lower_bound_{name}", low_db, "dB", bounds.predicted_db(), note))
        rows.append(_row(result, f"zwidth_{name}", bounds.width_db(), "dB"))
    note = (
        "of what active damping raised the lower edge by; sd of the owners alone, other seeds and"
        " grids choose others (ADR-0027)"
    )
    rows += [
        _row(result, f"lower_bound_restored{kind}", restored(result, kind), "%", note=note)
        for kind in ("", "_safe")
    ]
    caption = f"Envelopes with the owners of their lower edges; {BANDS}."
    drawing = Drawing("beyond_lower_edge", caption, partial(edge_figure, result))
    return Section(
        "Future work: negative virtual damping",
        _lower_edge_words(result),
        tuple(rows),
        (drawing,),
    )


def _lower_edge_words(result: FutureWorkResult) -> str:
    low = {name: found.lower_db().mean() for name, found in result.envelopes.items()}
    wide = {name: found.width_db().mean() for name, found in result.envelopes.items()}
    at_noise, safe = (restored(result, kind).mean() for kind in ("", "_safe"))
    twice = ""
    if result.passing_twice:
        share = 100.0 * max(result.passing_twice[name] for name in ("off", "on", "on_negative_B"))
        twice = (
            f": with twice the force, {share:.0f} % at most of the owners of any of these edges"
            " pass"
        )
    return (
        f"Active damping raises the lower edge of the Z-width in 2-20 Hz from {low['off']:.1f} to"
        f" {low['on']:.1f} dB (re 1 N s/m, mean over ln f). With B < 0 it comes to"
        f" {low['on_negative_B']:.1f} dB, {at_noise:.0f} % of the way back, and the upper edge"
        f" stays. The Z-width there is {wide['off']:.1f} dB without active damping,"
        f" {wide['on']:.1f} dB with it, and {wide['on_negative_B']:.1f} dB with B < 0 beside it."
        " Without active damping, B < 0 alone brings the lower edge to"
        f" {low['off_negative_B']:.1f} dB.\n\nThese edges count on dry friction, as limits at one"
        f" perturbation do{twice}. Without counting on friction the lower edge is at"
        f" {low['off_safe']:.1f} dB without active damping, {low['on_safe']:.1f} dB with it,"
        f" {low['on_negative_B_safe']:.1f} dB with B < 0 beside it ({safe:.0f} % of the way back)."
        " All are edges of one grid, that of Figs. 3 and 8 with rows of B < 0. A finer grid goes"
        " lower, because K and M cancel more exactly, and other seeds let other environments pass:"
        " a decibel or two, more than the scatter in the table (ADR-0027)."
    )


def _edge_note(result: FutureWorkResult, name: str, bounds: Bounds) -> str:
    if not bounds.trials:
        return "predicted on the grid of Figs. 3 and 8; a finer grid goes lower"
    share = 100.0 * result.passing_twice[name]
    return (
        f"{bounds.trials} trials, {bounds.excluded} environments excluded; at twice the force"
        f" {share:.0f} % of its owners pass"
    )


def _free_motion(result: FutureWorkResult) -> Section:
    free = result.free
    count = len(result.plan.seeds)
    off, on, alone, both = free.motions
    heavier = shown_hz()[np.argmax(both.size.value > off.size.value)]
    words = (
        "No grid matters where no stiffness is rendered. Mean |Z| in 2-20 Hz is"
        f" {off.low_db().mean():.1f} dB without active damping and {on.low_db().mean():.1f} dB"
        f" with it. B = {alone.virtual_damping:.2f} N s/m alone gives"
        f" {alone.low_db().mean():.1f} dB, because the lag of the loop turns it into mass; with"
        f" M = {1e3 * both.mass_kg:.1f} g beside it {both.low_db().mean():.1f} dB is left, lighter"
        f" than the device without active damping below {heavier:.0f} Hz and heavier above. All"
        " four are passive for every input without friction, the last with"
        f" {both.reserve_ns_per_m:.2g} N s/m in reserve, which leaves nothing for an error of the"
        " model. Eq. 2 of the paper does not hold for B < 0 and is refused there."
    )
    rows = []
    for motion in free.motions:
        note = (
            f"B {motion.virtual_damping:.3g} Ns/m, M {1e3 * motion.mass_kg:.3g} g;"
            f" {motion.reserve_ns_per_m:.3g} Ns/m in reserve by the lifted theorem, without"
            f" friction{f'; {len(motion.runs)} of {count} seeds pass' if count else ''}"
        )
        rows.append(
            _row(
                result,
                f"free_motion_{motion.name}",
                motion.low_db(),
                "dB",
                motion.predicted_db(),
                note,
            )
        )
    ends = "on its axis, at the perturbation: below it the device runs away"
    rows += [
        _row(result, f"B_min_{MODES[end.level]}", end.values, "Ns/m", end.predicted, ends)
        for end in free.limits
    ]
    refused = f"refused: {free.refusal}"
    rows.append(
        PaperRow("eq2_on_negative_B", nan, nan, "-", "arithmetic", MAIN, note=refused, part=PART)
    )
    caption = f"|Z| where no stiffness is rendered; {BANDS}."
    drawing = Drawing("beyond_free_motion", caption, partial(free_figure, result))
    return Section("Future work: free motion", words, tuple(rows), (drawing,))


def _shaped(result: FutureWorkResult) -> Section:
    shaped = result.shaped
    plain_k, best_k = shaped.stiffest
    bounds = shaped.bounds
    best = shaped.best
    plain = shaped.plain
    words = (
        f"Damping above {best.corner_hz:g} Hz only keeps B and M within 5 % of what plain damping"
        f" allows and brings the lower edge in 2-20 Hz to {bounds.lower_db().mean():z.1f} dB, with"
        f" B >= 0: a Z-width of {bounds.width_db().mean():.1f} dB. K alone goes to"
        f" {100.0 * best.limits[0] / plain.limits[0]:.0f} % of what plain damping allows, K with"
        f" its best B and M to {100.0 * best_k / plain_k:.0f} %. The paper's \"added mechanical"
        ' dissipation is rarely needed at low frequency" does not hold for K alone: a sampled'
        " spring needs its dissipation at every frequency, down to 0, unless virtual B beside it"
        " brings some. A low-pass does the opposite, and beside the circuit's own lag it is active"
        " at high frequency."
    )
    light = "high-pass with the lightest free motion of those that keep B and M within 5 %"
    beside = (
        f"predicted; {100.0 * (best_k / plain_k - 1.0):+.0f} % against unshaped: virtual B gives"
        " slow motion its dissipation back"
    )
    limits = [
        (
            f"shaped_{NAMES[each.axis]}",
            each.values,
            UNITS[each.axis],
            each.predicted,
            (
                f"{100.0 * (each.predicted / plain.limits[each.axis] - 1.0):+.0f} % by prediction"
                " against the same damping unshaped"
            ),
        )
        for each in shaped.confirmed
    ]
    quantities = (
        ("shaped_corner", PREDICTED, "Hz", best.corner_hz, light),
        *limits,
        ("shaped_K_max_set", PREDICTED, "N/m", best_k, beside),
        ("shaped_lower_bound", bounds.lower_db(), "dB", bounds.predicted_db(), ""),
        ("shaped_zwidth", bounds.width_db(), "dB", nan, ""),
        ("shaped_free_motion", shaped.free.low_db(), "dB", best.free_db, ""),
    )
    caption = "Limits, free motion and envelope over the corner."
    drawing = Drawing("beyond_shaped", caption, partial(shape_figure, result))
    title = "Future work: damping that depends on frequency"
    return Section(title, words, tuple(_row(result, *row) for row in quantities), (drawing,))


def _levels(result: FutureWorkResult) -> Section:
    levels = result.levels
    low, _, high, highest = TRIED_LEVELS
    growth = levels.gain(low, high)
    later = levels.gain(high, highest)
    left = 100.0 * later / growth
    words = (
        f"Between {low:g} and {high:g} N s/m each N s/m of active damping buys {growth[0]:.0f} N/m"
        f" of K, {growth[1]:.2f} N s/m of B and {-1e3 * growth[2]:.1f} g of negative mass by"
        f" prediction; the table has the trials. From there to {highest:g} N s/m it buys"
        f" {left[0]:.0f} %, {left[1]:.0f} % and {left[2]:.0f} % of that. What is paid is free"
        f" motion: {levels.free_db[0]:.1f} dB without, {levels.free_db[-1]:.1f} dB at"
        f" {levels.level[-1]:g} N s/m."
    )
    rows = []
    for axis, name in enumerate(NAMES):
        runs = {each.level: each.values for each in levels.confirmed if each.axis == axis}
        gained = (runs[high] - runs[low]) / (high - low) if runs else PREDICTED
        above = (runs[highest] - runs[high]) / (highest - high) if runs else PREDICTED
        share = 100.0 * (mean_sd(above / gained)[0] if runs else later[axis] / growth[axis])
        unit = f"{UNITS[axis]} per Ns/m"
        ends = "it saturates" if share < 100.0 * LITTLE else "no saturation up to there"
        note = f"between {low:g} and {high:g} Ns/m of active damping"
        rows.append(_row(result, f"{name}_per_level", gained, unit, float(growth[axis]), note))
        note = f"between {high:g} and {highest:g} Ns/m; {share:.0f} % of the growth before: {ends}"
        rows.append(_row(result, f"{name}_per_level_beyond", above, unit, float(later[axis]), note))
    larger = levels.volume / levels.volume[0]
    note = f"predicted, B >= 0; {larger[-1]:.0f} times at {levels.level[-1]:g} Ns/m"
    own = float(larger[np.argmin(np.abs(levels.level - ADDED_NS_PER_M))])
    rows.append(_row(result, "set_volume_ratio", PREDICTED, "1", own, note))
    drawing = Drawing(
        "beyond_levels",
        "Limits, set and free motion over the level.",
        partial(levels_figure, result),
    )
    return Section("Future work: levels of active damping", words, tuple(rows), (drawing,))


def _search(result: FutureWorkResult) -> Section:
    words = [_search_words(found) for found in result.searches]
    saved = [
        f"{found.points} trials by {found.enough}" for found in result.searches if found.enough
    ]
    if saved:
        words.append(f"To know as much as one run of the grid, it replaces {' and '.join(saved)}.")
    by_mode = [
        (mode, row)
        for found, mode in zip(result.searches, MODES.values(), strict=False)
        for row in _search_rows(found)
    ]
    rows = tuple(replace(row, quantity=f"{row.quantity}_{mode}") for mode, row in by_mode)
    caption = "Slices of the set with the trials next to each, and all trials in their order."
    drawing = Drawing(
        "beyond_search", caption, partial(search_figure, [found.found for found in result.searches])
    )
    return Section("Future work: directed search", " ".join(words), rows, (drawing,))


def _search_words(found: SearchCheck) -> str:
    wrong = ", ".join(
        f"{found.share(points):.1f} % after {count}" for count, points in found.searched.items()
    )
    return (
        f"At {found.active_damping_ns_per_m:g} N s/m the search answers wrongly, in shares of the"
        f" passive points, {wrong} trials; prediction alone {found.share(found.predicted):.1f} %,"
        f" the grid repeated with other noise {found.share(found.other_noise):.1f} %."
    )


def _search_rows(found: SearchCheck) -> tuple[PaperRow, ...]:
    grid = f"of {found.passive} passive points among {found.points}"
    budgets = ", ".join(map(str, found.searched))
    enough = (
        f"first of {budgets} trials with no more wrong than the repeated grid"
        if found.enough
        else f"more than {max(found.searched)} trials are needed"
    )
    quantities = (
        ("grid_trials", found.points, "trials", "the whole grid by trials, one seed of noise"),
        ("search_trials", found.enough or nan, "trials", enough),
        *(
            (
                f"search_wrong_{count}",
                found.share(wrong),
                "%",
                f"points that {count} trials answer otherwise, {grid}",
            )
            for count, wrong in found.searched.items()
        ),
        (
            "prediction_wrong",
            found.share(found.predicted),
            "%",
            f"the same without a trial, {grid}",
        ),
        (
            "grid_again_wrong",
            found.share(found.other_noise),
            "%",
            f"the grid repeated with other noise, {grid}",
        ),
    )
    return tuple(
        PaperRow(name, nan, float(value), unit, "independent", MAIN, note=note, part=PART)
        for name, value, unit, note in quantities
    )
