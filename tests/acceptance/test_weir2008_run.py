"""What is run for the paper: its grid, the verdict of a trial and, marked slow, the six limits by
trials.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from support.stand_in import StandIn
from support.tree import ROOT

from examples.weir2008 import run
from examples.weir2008.paper import FIG_7, LEVELS, LITERAL, MAIN, PAPER
from examples.weir2008.rows import by_quantity, rows
from examples.weir2008.run import (  # fmt: skip
    FINE,
    POINTS,
    ReproducePlan,
    by_prediction,
    conditions,
    run_reproduce,
)
from hapticd.zwidth.limits import LimitsParams, plan_limits, predicted_limit, run_limits
from hapticd.zwidth.map import MapPlan
from hapticd.zwidth.outcomes import Conditions, Outcome, kept_frequencies, run_trials
from hapticd.zwidth.store import TrialStore

DOCS = ROOT / "docs"
NAMES = ("K_max_off", "B_max_off", "M_min_off", "K_max_on", "B_max_on", "M_min_on")


def test_grid_is_the_papers_thirteen_days() -> None:
    assert POINTS.shape == (6384, 3)
    found = by_prediction(conditions(MAIN).display, LEVELS[1])
    assert found is not None
    assert found.environments[:, 2].min() == pytest.approx(-0.022)
    assert found.envelope.upper.value.min() > 0.0


def test_a_passive_trial_passes_and_an_escape_fails() -> None:
    kbm = np.array([[50.0, 2.0, 0.0], [0.0, 30.0, 0.0]])
    calm, wild = run_trials(replace(conditions(MAIN), seconds=20.0), LEVELS[1], kbm)
    assert (calm.passes, wild.passes) == (True, False)
    assert wild.answer != "passive"


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_six_limits_by_trials_within_eight_percent() -> None:
    plan = plan_limits(LimitsParams(conditions(MAIN), LEVELS, seeds=8, tolerance=FINE))
    found = run_limits(plan, TrialStore(None)).limits
    for limit, name in zip(found, NAMES, strict=True):
        assert limit.value == pytest.approx(PAPER[name], rel=0.08), (name, limit.values)


foretold = cache(predicted_limit)
SCATTER = 0.01  # of a limit from seed to seed
OUT_OF_LUCK = 2  # the seed with which nothing on an axis passes without active damping


def made_up(given: Conditions, level: float, points: np.ndarray) -> list[Outcome]:
    """Passes up to its predicted limit, more with each seed; 70 N/m from any higher band edge."""
    seed = given.excitation.seed
    from_higher = given.band_hz[0] > 2.0
    z = np.ones((kept_frequencies().size, 2))
    found = []
    for point in points:
        axis = int(np.argmax(np.abs(point / np.array([1000.0, 10.0, 0.02]))))
        end = 70.0 if from_higher else (1.0 + SCATTER * seed) * foretold(given.display, level, axis)
        alone = np.count_nonzero(point) < 2
        good = not alone or (
            abs(point[axis]) < abs(end) and not (seed == OUT_OF_LUCK and level == 0.0)
        )
        sd = np.full(len(z), 0.01)
        k, b, m = point.tolist()
        found.append(
            Outcome(
                (k, b, m), level, "passive", bool(good), 0.1, 0.0, 0.2, 1.0, 9.0, 0.02, 0.1, z, sd
            )
        )
    return found


def test_what_was_flown_reaches_the_table(monkeypatch: pytest.MonkeyPatch) -> None:
    """The whole run on two devices with made-up trials, one environment of the grid, and true
    single trials and walls.
    """

    def seventh(plan: MapPlan) -> MapPlan:
        only = (POINTS == FIG_7).all(axis=1)
        return replace(plan, levels=tuple(replace(level, near=only) for level in plan.levels))

    monkeypatch.setattr(run, "worth_trying", seventh)
    told: list[tuple[str, int, int]] = []
    plan = ReproducePlan((1, 2, 3), (MAIN, LITERAL))
    result = run_reproduce(plan, lambda *step: told.append(step), StandIn(made_up))
    table = by_quantity(rows(result))
    found = {name: by_device[MAIN] for name, by_device in table.items() if MAIN in by_device}
    expected = predicted_limit(conditions(MAIN).display, LEVELS[1], 0)
    assert found["K_max_on"].ours == pytest.approx((1.0 + 2 * SCATTER) * expected, rel=2 * FINE)
    assert found["K_max_on"].sd == pytest.approx(SCATTER * expected, rel=0.1)
    expected = predicted_limit(conditions(MAIN).display, LEVELS[0], 1)
    unlucky = (
        1.0 + SCATTER + 1.0 + 3 * SCATTER
    ) / 3.0  # a seed with which nothing passes counts as 0
    assert found["B_max_off"].ours == pytest.approx(unlucky * expected, rel=2 * FINE)
    assert (
        found["K_max_on"].seeds,
        found["K_ratio"].seeds,
        found["fig7_phase_advantage"].seeds,
    ) == (3, 3, 3)
    assert found["K_max_from_5_Hz_on"].ours == pytest.approx(70.0, rel=2 * FINE)
    assert found["fig4_passive"].seeds == 3
    assert (found["grid_passive_off"].ours, found["grid_growth"].ours) == (1, 1.0)
    assert "1 trials, the rest" in found["grid_passive_on"].note
    assert 200.0 < found["fig2_wall_K_off"].ours < 250.0
    assert "known to 4 %" in found["fig2_wall_K_off"].note
    assert (table["K_max_off"][LITERAL].ours, table["K_max_off"][LITERAL].seeds) == (
        0.0,
        0,
    )  # nothing predicted, none flown
    assert {what.split(",")[0] for what, _, _ in told} >= {
        "predicting",
        "axis limits",
        "trials",
        "Figs. 4 and 7",
        "walls",
        "done",
    }
    assert all(0 <= done <= total for _, done, total in told)
