"""The paper's future work: a section of REPORT.md for each part, with its rows, its text and its
figure. The texts are in `rows.toml`, their numbers here.

lower_bound_*   mean |Z| of the envelope's lower edge over ln f in 2-20 Hz, dB re 1 N s/m
zwidth_*        mean distance of its edges there, dB
free_motion_*   mean |Z| without K there, dB re 1 N s/m
*_safe          passive without friction, so at any amplitude; the others at the perturbation of the
                trials

The paper has no values to compare with these rows.
"""

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from math import nan
from typing import Any

import numpy as np

from examples.weir2008.future_figures import (
    edge_figure,
    free_figure,
    levels_figure,
    shape_figure,
)
from examples.weir2008.future_work import (
    TRIED_LEVELS,
    FutureWorkResult,
    SearchCheck,
    mean_sd,
    shown_hz,
)
from examples.weir2008.page import Drawing, Section
from examples.weir2008.paper import ADDED_NS_PER_M, MAIN, MODES, NAMES, SECTIONS
from examples.weir2008.rows import BY_TRIALS, PREDICTED, Found, Measured, told
from hapticd.core.arrays import Floats
from hapticd.zwidth.report.passive_set import search_figure

__all__ = ["future_sections"]

NO_RUNS = np.empty(0)  # no values by trials
LITTLE = 0.5  # of the growth before; below it a limit saturates

Facts = dict[str, Any]  # numbers for the text of a section


def future_sections(result: FutureWorkResult) -> tuple[Section, ...]:
    """Return lower edge, free motion, shaped damping, levels, and directed search if it
    was made.
    """
    searches = [found.found for found in result.searches]
    made = {
        "lower_edge": (*_lower_edge(result), partial(edge_figure, result)),
        "free_motion": (*_free_motion(result), partial(free_figure, result)),
        "shaped": (*_shaped(result), partial(shape_figure, result)),
        "levels": (*_levels(result), partial(levels_figure, result)),
    }
    if searches:
        made["search"] = (*_search(result), partial(search_figure, searches))
    sections = []
    for name, (facts, found, draw) in made.items():
        content = SECTIONS[name]
        drawing = Drawing(content["drawing"], content["caption"], draw)
        seeds = len(result.plan.seeds)
        counted = {key: replace(one, seeds=seeds if one.seeds else 0) for key, one in found.items()}
        rows = tuple(told(name, MAIN, counted))
        words = content["words"].format_map(facts)
        sections.append(Section(content["title"], words, rows, (drawing,)))
    return tuple(sections)


def _by_seed(
    runs: Floats,
    predicted: float = nan,
    case: str = "always",
    facts: Mapping[str, Any] | None = None,
) -> Measured:
    """Return a quantity by trials of each seed, or its prediction if there are none."""
    ours, sd = mean_sd(runs) if len(runs) else (predicted, nan)
    return Measured(ours, sd, len(runs), predicted, case, facts=facts or {})


def restored(result: FutureWorkResult, kind: str = "") -> Floats:
    """Return how much of the rise of the lower edge by active damping is removed [%] (seeds,);
    `kind` "" or "_safe".
    """
    off, on, negative = (
        result.envelopes[f"{name}{kind}"].lower_db() for name in ("off", "on", "on_negative_B")
    )
    return np.asarray(100.0 * (on - negative) / (on - off))


def _lower_edge(result: FutureWorkResult) -> tuple[Facts, Found]:
    found = {}
    for name, bounds in result.envelopes.items():
        share = 100.0 * result.passing_twice.get(name, nan)
        facts = {"trials": bounds.trials, "excluded": bounds.excluded, "share": share}
        case = BY_TRIALS if bounds.trials else PREDICTED
        edge_db = bounds.lower_db()
        found[f"lower_bound_{name}"] = _by_seed(edge_db, bounds.predicted_db(), case, facts)
        found[f"zwidth_{name}"] = _by_seed(bounds.width_db())
    for kind in ("", "_safe"):
        found[f"lower_bound_restored{kind}"] = _by_seed(restored(result, kind))
    twice = ""
    if result.passing_twice:
        share = 100.0 * max(result.passing_twice[name] for name in ("off", "on", "on_negative_B"))
        twice = SECTIONS["lower_edge"]["twice"].format(share=share)
    words = {
        "low": {name: bounds.lower_db().mean() for name, bounds in result.envelopes.items()},
        "wide": {name: bounds.width_db().mean() for name, bounds in result.envelopes.items()},
        "back_at_noise": restored(result).mean(),
        "back_safe": restored(result, "_safe").mean(),
        "twice": twice,
    }
    return words, found


def _free_motion(result: FutureWorkResult) -> tuple[Facts, Found]:
    free = result.free
    seeds = len(result.plan.seeds)
    off, _, alone, both = free.motions
    found = {"eq2_on_negative_B": Measured(nan, facts={"refusal": free.refusal})}
    for motion in free.motions:
        mass_g = 1e3 * motion.mass_kg
        facts = {"motion": motion, "mass_g": mass_g, "passed": len(motion.runs), "seeds": seeds}
        found[f"free_motion_{motion.name}"] = _by_seed(
            motion.low_db(), motion.predicted_db(), BY_TRIALS if seeds else PREDICTED, facts
        )
    for end in free.limits:
        found[f"B_min_{MODES[end.level]}"] = _by_seed(end.values, end.predicted)
    words = {
        "low": {motion.name: motion.low_db().mean() for motion in free.motions},
        "alone": alone,
        "both": both,
        "mass_g": 1e3 * both.mass_kg,
        "heavier_hz": shown_hz()[np.argmax(both.size.value > off.size.value)],
    }
    return words, found


def _shaped(result: FutureWorkResult) -> tuple[Facts, Found]:
    shaped = result.shaped
    plain_k, best_k = shaped.stiffest
    bounds = shaped.bounds
    best = shaped.best
    low_db = bounds.lower_db()
    found = {
        "shaped_corner": _by_seed(NO_RUNS, best.corner_hz),
        "shaped_K_max_set": _by_seed(
            NO_RUNS, best_k, facts={"percent": 100.0 * (best_k / plain_k - 1.0)}
        ),
        "shaped_lower_bound": _by_seed(low_db, bounds.predicted_db()),
        "shaped_zwidth": _by_seed(bounds.width_db()),
        "shaped_free_motion": _by_seed(shaped.free.low_db(), best.free_db),
    }
    for each in shaped.confirmed:
        percent = 100.0 * (each.predicted / shaped.plain.limits[each.axis] - 1.0)
        found[f"shaped_{NAMES[each.axis]}"] = _by_seed(
            each.values, each.predicted, "limit", {"percent": percent}
        )
    words = {
        "best": best,
        "low": low_db.mean(),
        "wide": bounds.width_db().mean(),
        "alone": 100.0 * best.limits[0] / shaped.plain.limits[0],
        "beside": 100.0 * best_k / plain_k,
    }
    return words, found


def _levels(result: FutureWorkResult) -> tuple[Facts, Found]:
    levels = result.levels
    low, _, high, highest = TRIED_LEVELS
    growth = levels.gain(low, high)
    later = levels.gain(high, highest)
    most = float(levels.level[-1])
    facts = {"low": low, "high": high, "highest": highest, "most": most}
    found = {}
    for axis, name in enumerate(NAMES):
        runs = {each.level: each.values for each in levels.confirmed if each.axis == axis}
        gained = (runs[high] - runs[low]) / (high - low) if runs else NO_RUNS
        above = (runs[highest] - runs[high]) / (highest - high) if runs else NO_RUNS
        share = 100.0 * (mean_sd(above / gained)[0] if runs else later[axis] / growth[axis])
        case = "saturates" if share < 100.0 * LITTLE else "grows"
        found[f"{name}_per_level"] = _by_seed(gained, float(growth[axis]), facts=facts)
        found[f"{name}_per_level_beyond"] = _by_seed(
            above, float(later[axis]), case, {**facts, "share": share}
        )
    larger = levels.volume / levels.volume[0]
    own = float(larger[np.argmin(np.abs(levels.level - ADDED_NS_PER_M))])
    found["set_volume_ratio"] = _by_seed(NO_RUNS, own, facts={**facts, "times": larger[-1]})
    words = {
        **facts,
        "levels": levels,
        "growth": growth,
        "mass_g": -1e3 * growth[2],
        "left": 100.0 * later / growth,
        "free_db": levels.free_db[-1],
    }
    return words, found


def _search(result: FutureWorkResult) -> tuple[Facts, Found]:
    content = SECTIONS["search"]
    pairs = list(zip(result.searches, MODES.values(), strict=False))
    found = {
        f"{quantity}_{mode}": one
        for each, mode in pairs
        for quantity, one in _checked(each).items()
    }
    searches = []
    for each in result.searches:
        shares = [f"{each.share(wrong):.1f} % after {n}" for n, wrong in each.searched.items()]
        predicted, other_noise = each.share(each.predicted), each.share(each.other_noise)
        searches.append(
            content["each"].format(
                found=each, wrong=", ".join(shares), predicted=predicted, other_noise=other_noise
            )
        )
    saved = [f"{each.points} trials by {each.enough}" for each in result.searches if each.enough]
    more = content["saved"].format(trials=" and ".join(saved)) if saved else ""
    return {"searches": " ".join(searches), "saved": more}, found


def _checked(found: SearchCheck) -> Found:
    """Return the quantities of the search at one active damping, without its mode."""
    budgets = ", ".join(map(str, found.searched))
    facts = {"found": found, "budgets": budgets, "most": max(found.searched)}
    case = "enough" if found.enough else "too_few"
    shares = {
        f"search_wrong_{count}": Measured(
            found.share(wrong), case="wrong", facts={**facts, "count": count}
        )
        for count, wrong in found.searched.items()
    }
    return {
        **shares,
        "grid_trials": Measured(float(found.points)),
        "search_trials": Measured(float(found.enough or nan), case=case, facts=facts),
        "prediction_wrong": Measured(found.share(found.predicted), facts=facts),
        "grid_again_wrong": Measured(found.share(found.other_noise), facts=facts),
    }
