"""A run of `beyond` as rows of the table of `reproduce`: part "beyond", nothing in the paper to compare with.

lower_bound_*   mean |Z| of the envelope's lower edge over ln f in 2-20 Hz, dB re 1 N s/m
zwidth_*        mean distance of its edges there, dB
free_motion_*   mean |Z| without K there, dB re 1 N s/m
*_safe          passive without counting on friction, so at any amplitude; the others at the perturbation of the trials
"""

from collections.abc import Iterator
from math import nan

import numpy as np

from hapticd.analysis.arrays import Floats
from hapticd.measure.beyond import FLOWN, LOW_HZ, BeyondResult, Bounds, Levels, mean_db, mean_sd, shown_hz
from hapticd.measure.reproduce_rows import ADDED_NS_PER_M, MAIN, MODES, NAMES, UNITS, Row

PART = "beyond"
LITTLE, SATURATES, GROWS = 0.5, "it saturates", "no saturation up to there"  # share of growth left


def parts(result: BeyondResult) -> dict[str, tuple[Row, ...]]:
    """Rows by the figure that they belong to."""
    return {
        "envelopes": tuple(_envelopes(result)),
        "free": tuple(_free(result)),
        "shaped": tuple(_shaped(result)),
        "levels": tuple(_levels(result)),
        "searches": tuple(_searches(result)),
    }


def rows(result: BeyondResult) -> tuple[Row, ...]:
    """All rows."""
    return tuple(row for part in parts(result).values() for row in part)


def _row(quantity: str, runs: Floats, unit: str, seeds: int, predicted: float = nan, note: str = "") -> Row:
    ours, sd = mean_sd(runs) if len(runs) else (predicted, nan)
    return Row(quantity, nan, ours, unit, "independent", MAIN, sd, seeds, predicted, note, PART)


def restored(result: BeyondResult, kind: str = "") -> Floats:
    """How much of what added damping raised the lower edge by is taken back [%] (seeds,); `kind` "" or "_safe"."""
    off, on, negative = (result.envelopes[f"{name}{kind}"].lower_db() for name in ("off", "on", "on_negative_B"))
    return np.asarray(100.0 * (on - negative) / (on - off))


def _envelopes(result: BeyondResult) -> Iterator[Row]:
    count = len(result.plan.seeds)
    for name, bounds in result.envelopes.items():
        guess = bounds.predicted_db()
        yield _row(f"lower_bound_{name}", bounds.lower_db(), "dB", count, guess, _edge_note(result, name, bounds))
        yield _row(f"zwidth_{name}", bounds.width_db(), "dB", count)
    note = "of what added damping raised the lower edge by; sd of the owners alone, other seeds and grids choose others (ADR 0034)"
    for kind in ("", "_safe"):
        yield _row(f"lower_bound_restored{kind}", restored(result, kind), "%", count, note=note)


def _edge_note(result: BeyondResult, name: str, bounds: Bounds) -> str:
    if not bounds.flown:
        return "predicted on the grid of Figs. 3 and 8; a finer grid goes lower"
    share = 100.0 * result.hardy[name]
    return (
        f"{bounds.flown} trials flown, {bounds.struck} environments struck out; at twice the force {share:.0f} % of its owners pass"
    )


def _free(result: BeyondResult) -> Iterator[Row]:
    free, count = result.free, len(result.plan.seeds)
    for motion in free.motions:
        guess = float(mean_db(shown_hz(), motion.predicted[None], LOW_HZ)[0])
        note = (
            f"B {motion.damping:.3g} Ns/m, M {1e3 * motion.mass_kg:.3g} g; {motion.spare:.3g} Ns/m to spare by the lifted theorem, "
            f"without friction{f'; {len(motion.runs)} of {count} seeds pass' if count else ''}"
        )
        yield _row(f"free_motion_{motion.name}", motion.low_db(), "dB", count, guess, note)
    for limit in free.limits:
        note = "on its axis, at the perturbation: beyond it the device runs away"
        yield _row(f"B_min_{MODES[limit.level]}", limit.values, "Ns/m", count, limit.predicted, note)
    yield Row("eq2_on_negative_B", nan, nan, "-", "arithmetic", MAIN, note=f"refused: {free.refusal}", part=PART)


def _shaped(result: BeyondResult) -> Iterator[Row]:
    shaped, count = result.shaped, len(result.plan.seeds)
    note = "high-pass with the lightest free motion of those that keep B and M within 5 %"
    yield _row("shaped_corner", np.empty(0), "Hz", 0, shaped.best.hertz, note)
    for each in shaped.confirmed:
        plain = shaped.plain.limits[each.axis]
        note = f"{100.0 * (each.predicted / plain - 1.0):+.0f} % by prediction against the same damping unshaped"
        yield _row(f"shaped_{NAMES[each.axis]}", each.values, UNITS[each.axis], count, each.predicted, note)
    plain, best = shaped.stiffest
    note = f"predicted; {100.0 * (best / plain - 1.0):+.0f} % against unshaped: virtual B gives slow motion its dissipation back"
    yield _row("shaped_K_max_set", np.empty(0), "N/m", 0, best, note)
    yield _row("shaped_lower_bound", shaped.bounds.lower_db(), "dB", count, shaped.bounds.predicted_db())
    yield _row("shaped_zwidth", shaped.bounds.width_db(), "dB", count)
    yield _row("shaped_free_motion", shaped.free.low_db(), "dB", count, shaped.best.free_db)


def _levels(result: BeyondResult) -> Iterator[Row]:
    levels, count = result.levels, len(result.plan.seeds)
    (low, _, middle, high), top = FLOWN, float(levels.level[-1])
    for axis, name in enumerate(NAMES):
        gained, later = _grown(levels, axis, low, middle), _grown(levels, axis, middle, high)
        guess = (float(levels.gain(low, middle)[axis]), float(levels.gain(middle, high)[axis]))
        unit = f"{UNITS[axis]} per Ns/m"
        yield _row(f"{name}_per_level", gained, unit, count, guess[0], f"between {low:g} and {middle:g} Ns/m of added damping")
        left = mean_sd(later / gained)[0] if len(gained) else guess[1] / guess[0]
        growth = f"{100.0 * left:.0f} % of the growth before: {SATURATES if left < LITTLE else GROWS}"
        note = f"between {middle:g} and {high:g} Ns/m; {growth}"
        yield _row(f"{name}_per_level_beyond", later, unit, count, guess[1], note)
    at = int(np.argmin(np.abs(levels.level - ADDED_NS_PER_M)))
    note = f"predicted, B >= 0; {levels.volume[-1] / levels.volume[0]:.0f} times at {top:g} Ns/m"
    yield _row("set_volume_ratio", np.empty(0), "1", 0, float(levels.volume[at] / levels.volume[0]), note)


def _searches(result: BeyondResult) -> Iterator[Row]:
    for found, mode in zip(result.searches, MODES.values(), strict=False):
        grid = f"of {found.passive} passive points among {found.points}"
        counts = ", ".join(map(str, found.searched))
        enough = f"first of {counts} trials with no more wrong than the grid flown again"
        told = (
            ("grid_trials", float(found.points), "trials", "the whole grid flown, one seed of noise"),
            (
                "search_trials", float(found.enough or nan), "trials",
                enough if found.enough else f"more than {max(found.searched)} trials are needed",
            ),
            *(
                (f"search_wrong_{count}", found.share(wrong), "%", f"yes or no that {count} trials hold otherwise, {grid}")
                for count, wrong in found.searched.items()
            ),
            ("prediction_wrong", found.share(found.predicted), "%", f"the same without a trial, {grid}"),
            ("grid_again_wrong", found.share(found.other_noise), "%", f"the grid flown with other noise, {grid}"),
        )  # fmt: skip
        for name, value, unit, note in told:
            yield Row(f"{name}_{mode}", nan, value, unit, "independent", MAIN, note=note, part=PART)


def _grown(levels: Levels, axis: int, low: float, high: float) -> Floats:
    """Growth of a limit per N s/m between two levels by trials (seeds,), empty without."""
    runs = {each.level: each.values for each in levels.confirmed if each.axis == axis}
    return (runs[high] - runs[low]) / (high - low) if runs else np.empty(0)
