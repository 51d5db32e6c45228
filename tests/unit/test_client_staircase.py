"""The staircase: its rule, its turns, and where it goes for observers whose threshold is known."""

from math import erf, sqrt

import numpy as np
import pytest

from hapticd.client.design import Staircase
from hapticd.core.errors import ConfigError


def levels(answers: str, **options: float) -> list[float]:
    staircase = Staircase(1.0, factor=2.0, **options)
    found = [staircase.level]
    for one in answers:
        staircase.answer(one == "+")
        found.append(staircase.level)
    return found


def test_two_right_answers_lower_the_level_and_one_wrong_raises_it() -> None:
    assert levels("++") == [1.0, 1.0, 0.5]
    assert levels("+-") == [1.0, 1.0, 2.0]
    assert levels("-+++") == [1.0, 2.0, 2.0, 1.0, 1.0]


def test_three_down_needs_three() -> None:
    assert levels("+++", down=3) == [1.0, 1.0, 1.0, 0.5]


def test_level_stays_within_its_limits() -> None:
    assert levels("++++--", lowest=0.6, highest=1.5)[-1] == 1.5
    assert levels("++++", lowest=0.6)[-1] == 0.6


def test_turns_are_the_levels_at_which_the_direction_changed() -> None:
    staircase = Staircase(1.0, factor=2.0, reversals=3)
    for right in (True, True, False, True, True, False):
        staircase.answer(right)
    assert staircase.turns == [0.5, 1.0, 0.5]
    assert staircase.finished
    assert staircase.threshold == 0.5


def test_threshold_of_an_unfinished_staircase_is_refused() -> None:
    with pytest.raises(ConfigError, match="0 of 8 turns"):
        _ = Staircase(1.0).threshold


@pytest.mark.parametrize(
    "wrong",
    [
        {"level": 0.0},
        {"level": float("nan")},
        {"level": 2.0, "highest": 1.0},
        {"level": 1.0, "factor": 1.0},
        {"level": 1.0, "down": 0},
        {"level": 1.0, "reversals": 2},
    ],
)
def test_numbers_that_give_no_staircase_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(ConfigError, match="a staircase"):
        Staircase(**wrong)  # type: ignore[arg-type]


@pytest.mark.parametrize("down", [2, 3])
def test_it_finds_the_level_at_which_right_answers_are_as_likely_as_levitt_says(down: int) -> None:
    """p^down = 1/2 of an observer who guesses in half the cases below threshold."""
    random = np.random.default_rng(7)

    def share(level: float) -> float:
        return 0.5 * (1.0 + erf(level / sqrt(2.0)))

    found = []
    for _ in range(200):
        staircase = Staircase(3.0, down=down, reversals=30)
        while not staircase.finished:
            staircase.answer(bool(random.random() < share(staircase.level)))
        found.append(share(staircase.threshold))
    assert np.mean(found) == pytest.approx(0.5 ** (1 / down), abs=0.02)
