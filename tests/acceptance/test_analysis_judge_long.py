"""The way of a change: its order, what is judged of it, and what each policy makes of it."""

from support.guard_device import change, shipped_judge
from test_analysis_judge import LEVEL

from hapticd.guard.judge import Judge


def test_clamped_damping_goes_to_the_first_exit_and_not_to_a_kept_level() -> None:
    """Also when it stands at a kept level already: what is left of the way is not nothing."""
    judge = shipped_judge()
    shown = {"K": 500.0, "B": 2.0}
    for present in (1.74, 1.43):
        answer = change(
            judge, {"active_damping": 0.0}, policy="clamp", now=shown | {"active_damping": present}
        )
        given = answer["verdict"]["given"]["active_damping"]
        assert change(judge, {}, now=shown | {"active_damping": given})["verdict"]["safe"]
        assert not change(judge, {}, now=shown | {"active_damping": given - 0.03})["verdict"][
            "safe"
        ]


def test_same_requests_have_the_same_answers() -> None:
    asked = {"K": 150.0, "B": 1.0, "active_damping": LEVEL}
    first = change(Judge(shipped_judge().setup), asked)
    second = change(Judge(shipped_judge().setup), asked)
    assert first == second
