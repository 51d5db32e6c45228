"""Trials needed by the directed search: on oracles without noise for 2 % of the passive set's
volume, and on weir2008.

The oracles: 8 g, 2 N s/m, 1 kHz, force held, one tick late, Butterworth filters of 100 and 72 Hz.
The nonaffine one has a damping that the environment changes by up to 0.55 N s/m. A binary grid
needs 290,000 and 180,000 trials.

weir2008, undamped and damped, trials of 90 s with noise: compared with a grid of 2,002 that is
simulated twice (`examples.weir2008.future_work`).
"""

from collections.abc import Iterator

import numpy as np

from benchmarks import targets
from benchmarks.figures import Figure, compared, refused
from examples.weir2008.future_work import SearchCheck, compared_with_grid
from examples.weir2008.paper import LEVELS
from hapticd.model.loop import derivatives, held_force_model
from hapticd.settings.scene import load_scene
from hapticd.zwidth.acquisition import Search, first_trials, next_trials, predicted_passive
from hapticd.zwidth.outcomes import Conditions
from hapticd.zwidth.surrogate import Box, Observation

TARGETS = targets.of("directed")
BEND = {"search_nonaffine": 1.0, "search_affine": 0.0}
BOX = Box((0.0, -2.2, -0.009), (1450.0, 3.6, 0.015))
INSIDE = (300.0, 0.3, 0.001)
RATE_HZ = 1000.0
DELAY = 1.0
DAMPING = 2.0
ENOUGH = 0.02
BUDGET = 70
SAMPLES = 40_000
F = np.geomspace(1.0, 499.0, 400)

SCENE = "fig4"
BUDGETS = (20, 40, 80)
HEADLINE = 40


def measure() -> Iterator[Figure]:
    """Count trials until the wrongly classified volume is 2 % of the true one; then weir2008."""
    for name, bend in BEND.items():
        needed = _trials(bend)
        if needed is None:
            yield refused(name, TARGETS[name], f"not within 2 % after {BUDGET} trials")
        else:
            yield compared(name, TARGETS[name], float(needed), "trials")
    yield from _weir()


def _weir() -> Iterator[Figure]:
    scene = load_scene(SCENE)
    conditions = Conditions(scene, 90.0, scene.noise)
    levels = [compared_with_grid(conditions, level, BUDGETS) for level in LEVELS]
    shares = "; ".join(map(_summary, levels))
    note = f"wrong yes or no on {levels[0].points} grid points each, {shares}"
    passive = sum(level.passive for level in levels)
    share, before = (
        100 * sum(wrong) / passive
        for wrong in ([x.searched[HEADLINE] for x in levels], [x.predicted for x in levels])
    )
    yield compared(
        "search_weir_wrong_share", TARGETS["search_weir_wrong_share"], share, "%", before, note
    )
    enough = [level.enough for level in levels if level.enough is not None]
    if len(enough) < len(levels):
        yield refused(
            "search_weir_trials",
            TARGETS["search_weir_trials"],
            f"above the noise of the grid after {BUDGETS[-1]} trials; {note}",
        )
        return
    needed = float(max(enough))
    points = float(levels[0].points)
    yield compared("search_weir_trials", TARGETS["search_weir_trials"], needed, "trials")
    yield compared(
        "search_weir_grid_trials", TARGETS["search_weir_grid_trials"], points, "trials", needed
    )


def _summary(level: SearchCheck) -> str:
    shares = [
        f"{count} trials {level.share(wrong):.1f} %" for count, wrong in level.searched.items()
    ]
    rest = (
        f"prediction {level.share(level.predicted):.1f} %, noise of the grid"
        f" {level.share(level.other_noise):.1f} %"
    )
    whole = f"{rest} of {level.passive} passive"
    return f"{level.active_damping_ns_per_m:g} N s/m: {', '.join(shares)}, {whole}"


def _trials(bend: float) -> int | None:
    search = Search(BOX)
    samples = BOX.to_environment(np.random.default_rng(7).random((SAMPLES, 3)))
    truth = np.concatenate(
        [_resistance(part, bend).min(axis=1) >= 0.0 for part in np.array_split(samples, 20)]
    )
    while len(search.trials) < BUDGET:
        wanted = next_trials(search) if search.surrogate else first_trials(BOX, INSIDE)
        search = search.with_trials(
            wanted,
            [Observation(one, _resistance(one[None], bend)[0], np.zeros(F.size)) for one in wanted],
        )
        if np.mean(predicted_passive(search, samples) != truth) <= ENOUGH * truth.mean():
            return len(search.trials)
    return None


def _resistance(environments: np.ndarray, bend: float) -> np.ndarray:
    turn = np.exp(2j * np.pi * F / RATE_HZ)
    law = np.stack((np.ones(F.size), *derivatives(turn, RATE_HZ)))
    felt = (law * held_force_model(F, RATE_HZ, DELAY) / (2j * np.pi * F)).real
    k, b, m = environments.T
    bent = 0.35 * np.sin(k / 250.0) + 0.2 * np.tanh(b) * np.cos(400.0 * m)
    return np.asarray(DAMPING + bend * bent[:, None] + environments @ felt)
