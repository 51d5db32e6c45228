"""Axis limits and their store: what was interrupted goes on, and comes out as if it had not
been.
"""

from typing import Any

import pytest
from support.stand_in import StandIn
from support.zwidth_limits import PLAN, Flown, environments

from hapticd.zwidth.limits import Scan, run_limits
from hapticd.zwidth.outcomes import Conditions, Outcome
from hapticd.zwidth.store import TrialStore


def test_limits_go_on_where_they_were_interrupted(tmp_path: Any) -> None:
    uninterrupted = TrialStore(tmp_path / "whole.jsonl")
    whole = run_limits(PLAN, uninterrupted)
    rounds: list[int] = []

    def interrupted(scan: Scan, conditions: Conditions, new: list[Outcome]) -> None:
        rounds.append(len(new))
        if len(rounds) == 4:
            raise KeyboardInterrupt

    path = tmp_path / "trials.jsonl"
    with pytest.raises(KeyboardInterrupt):
        run_limits(PLAN, TrialStore(path), on_outcomes=interrupted)
    had = environments(TrialStore(path))
    flown = Flown()
    resumed = run_limits(PLAN, TrialStore(path), executor=StandIn(flown))
    assert repr(resumed.limits) == repr(whole.limits)
    assert 0 < len(had) < len(environments(uninterrupted))
    assert not had & set(flown.points)
    assert resumed.made == len(flown.points)
    assert TrialStore(path).known == TrialStore(tmp_path / "whole.jsonl").known


def test_limits_that_are_kept_are_not_flown_again(tmp_path: Any) -> None:
    store = TrialStore(tmp_path / "trials.jsonl")
    first = run_limits(PLAN, store)
    assert first.made == sum(limit.trials for limit in first.limits)
    ended: list[tuple[int, int]] = []
    again = run_limits(
        PLAN,
        TrialStore(tmp_path / "trials.jsonl"),
        lambda what, done, total: ended.append((done, total)),
        on_outcomes=lambda *_: pytest.fail("what was kept is not told again"),
        executor=StandIn(lambda *_: pytest.fail("a trial that the store has was made again")),
    )
    assert again.made == 0
    assert repr(again.limits) == repr(first.limits)
    assert ended[-1] == (3, 3)


def test_torn_round_costs_its_missing_trials_alone(tmp_path: Any) -> None:
    path = tmp_path / "trials.jsonl"
    whole = run_limits(PLAN, TrialStore(path))
    lines = path.read_text().splitlines(keepends=True)
    path.write_text("".join(lines[:-5]) + lines[-5][:100])
    flown = Flown()
    assert repr(run_limits(PLAN, TrialStore(path), executor=StandIn(flown)).limits) == repr(
        whole.limits
    )
    assert len(flown.points) == 5
