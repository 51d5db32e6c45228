"""`rig audit` and `rig trim` while a hand moves the handle: what is delivered, and what is left of
the winding, against the closed form alpha = 1 / (1 + g dR / K^2).
"""

import pytest
from support.models import COUNT_M
from test_rig_audit import FILE, MOVED_M, N_PER_A, Moving, board

from hapticd.core.errors import AnalysisError, HapticdError
from hapticd.protocol.view import as_records
from hapticd.rig.steps.delivery import measure_delivery, measure_residual


def values_of(result):
    return {one.name: one for one in result.values}


def holds(value, truth):
    return value.low <= truth <= value.high


@pytest.mark.parametrize(("residual_ohm", "verdict"), [(0.0, "ok"), (0.3, "warning")])
def test_audit_finds_what_a_warm_winding_takes_of_damping_and_force(residual_ohm, verdict):
    alpha = 1.0 / (1.0 + 5.0 * residual_ohm / N_PER_A**2)
    with Moving(FILE, **board(residual_ohm)) as hand:
        result = measure_delivery(hand.bench, hand.ask, 5.0)
        assert hand.bench.status().state == "disabled"
        hand.settle()
        assert hand.bench.newest["active_damping_ns_per_m"] == 0.0
    found = values_of(result)
    assert holds(found["delivered damping"], 5.0 * alpha)
    assert holds(found["delivered force"], alpha)
    assert [one.verdict for one in result.findings] == [verdict, verdict]
    assert not result.changes


def test_audit_says_when_it_does_not_know():
    with Moving(FILE, **board(0.0)) as hand:
        result = measure_delivery(hand.bench, lambda request: None, 5.0)
    assert [one.verdict for one in result.findings] == ["not done", "not done"]
    assert not result.values


@pytest.mark.parametrize(
    ("residual_ohm", "verdict"), [(0.08, "ok"), (-0.06, "warning"), (-0.1, "refused")]
)
def test_trim_finds_the_residual_and_judges_its_loop_gain(residual_ohm, verdict):
    told = []
    rho = residual_ohm / N_PER_A**2
    with Moving(FILE, **board(residual_ohm, trim_full_scale_ohm=0.8)) as hand:
        result = measure_residual(hand.bench, hand.ask, 6.0, told.append)
        assert hand.bench.status().state == "disabled"
    found = values_of(result)
    assert holds(found["residual resistance"], residual_ohm)
    assert holds(found["residual back-EMF"], rho)
    (finding,) = result.findings
    assert finding.verdict == verdict
    if verdict == "ok":
        assert len(told) == 6
        assert "any damping is stable" in told[-1]
    else:
        greatest = float(finding.remedy.split("damping is ")[1].split()[0])
        assert greatest == pytest.approx(-0.3 / rho, rel=0.1)
    if verdict == "refused":
        assert len(told) < 6  # it does not go on


@pytest.mark.parametrize("step", [measure_delivery, measure_residual])
def test_ctrl_c_ends_force_and_damping(step):
    def interrupted(request):
        raise KeyboardInterrupt

    with Moving(FILE, **board(0.0, trim_full_scale_ohm=0.8)) as hand:
        with pytest.raises(KeyboardInterrupt):
            step(hand.bench, interrupted)
        assert hand.bench.status().state == "disabled"
        records = as_records(hand.bench.run(500))
        assert not records["force_n"].any()
        assert not records["active_damping_ns_per_m"][-1]


def test_a_handle_that_is_let_go_comes_to_rest():
    with Moving(FILE, **board(0.0)) as hand:

        def lets_go(topics, look_s=0.05):
            hand.moves = hand.moves and hand.axis.now < 16 * 4000
            return type(hand.bench).messages(hand.bench, topics, look_s)

        hand.bench.messages = lets_go
        measure_delivery(hand.bench, hand.ask, 5.0)
        assert abs(hand.position_m) < 2.0 * MOVED_M
        still = as_records(hand.bench.run(100))["position_m"]
        assert still.max() - still.min() <= 2.0 * COUNT_M


def test_authority_that_is_lost_ends_the_audit():
    with Moving(FILE, **board(0.0)) as hand:

        def stopped(request):
            hand.axis.press_stop(True)

        with pytest.raises(HapticdError):
            measure_delivery(hand.bench, stopped, 5.0)
        assert not as_records(hand.bench.run(50))["force_n"].any()


@pytest.mark.parametrize("step", [measure_delivery, measure_residual])
def test_both_wait_for_the_signs(step):
    unseen = Moving(FILE | {"commissioning": True}, **board(0.0))
    with unseen as hand, pytest.raises(AnalysisError, match="signs"):
        step(hand.bench, hand.ask)
