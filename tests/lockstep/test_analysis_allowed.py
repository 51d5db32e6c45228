"""What a device withstands, against closed forms and the rest of the analysis."""

import numpy as np
import pytest
from support.guard_device import (
    VISCOUS_NS_PER_M,
    change,
    rigid,
    rigid_judge,
    setup_of,
    shipped_judge,
    sprung,
    with_hidden_growth,
)

from hapticd.core.environment import Environment
from hapticd.guard.judge import Judge
from hapticd.guard.safe_region import intervals
from hapticd.model.bases import LEVELS, Conditions, Theorem, cached_levels, model_of
from hapticd.model.compose import compose
from hapticd.model.loop import PAPER_FILTERS, spectral_radius
from hapticd.model.theorem import (
    circles,
    lifted_margin,
    lifted_system,
    lifted_worst,
    outside_circles,
    required_damping,
)
from hapticd.zwidth.sources import device_scene

T_S = 1e-3


def display(k: float, b: float = 0.0, m: float = 0.0, added: float = 0.0) -> Environment:
    first, second = PAPER_FILTERS
    assert first is not None
    assert second is not None
    return Environment(
        k,
        b,
        m,
        velocity_filter=first,
        acceleration_filter=second,
        active_damping_ns_per_m=added,
    )


def conditions(spare: float = 0.0, delay: float = 0.0) -> Conditions:
    return Conditions(0.0, PAPER_FILTERS, delay, spare)


@pytest.mark.parametrize("viscous", [0.5, 2.0, 6.0])
def test_largest_stiffness_of_a_rigid_device_is_twice_its_damping_over_the_period(
    viscous: float,
) -> None:
    """Colgate and Schenkel: b > K T / 2 with B = 0, no delay."""
    verdict = change(rigid_judge(viscous), {})["verdict"]
    assert verdict["allowed"]["K"] == pytest.approx([0.0, 2.0 * viscous / T_S], rel=2e-3)


def test_margin_of_a_rigid_device_is_its_damping_minus_what_is_required() -> None:
    theorem = Theorem(model_of(rigid(delay_periods=0.375)))
    draw = np.random.default_rng(1)
    points = draw.uniform((0.0, -1.0, -0.02), (900.0, 3.0, 0.02), (30, 3))
    required, hz = required_damping(points, delay_periods=0.375)
    read = [theorem.reading(tuple(point), conditions(delay=0.375)) for point in points]
    margins = np.array([one.margin_ns_per_m for one in read])
    np.testing.assert_allclose(margins, VISCOUS_NS_PER_M - required, atol=2e-3)
    worst = np.array([one.worst_hz for one in read])
    # flat near 0 Hz: what a spring asks for hardly depends on the frequency
    steep = hz > 5.0
    np.testing.assert_allclose(worst[steep], hz[steep], rtol=0.03, atol=2.0)


def test_worst_frequency_is_where_the_margin_ends() -> None:
    """At that frequency alone the device has no more to spare than the margin."""
    scene = device_scene("weir2008")
    assert scene is not None
    lifted = lifted_system(compose(scene), 0.0)
    found = lifted_worst(lifted, (100.0, 1.0, 0.0), 1000.0)
    assert found.margin_ns_per_m == lifted_margin(lifted, [(100.0, 1.0, 0.0)])[0]
    point = np.array([(100.0, 1.0, 0.0)])
    assert outside_circles(circles(lifted, found.margin_ns_per_m - 1e-6), point)[0]
    assert not outside_circles(circles(lifted, found.margin_ns_per_m + 1e-6), point)[0]
    form = circles(lifted, found.margin_ns_per_m + 1e-3).form
    k, b = 100.0, 1.0
    values = np.array([1.0, k, b, 0.0, k * k, k * b, 0.0, b * b, 0.0, 0.0]) @ form
    angle = 2.0 * np.pi * found.worst_hz * T_S
    worst = int(np.argmin(abs(lifted.angles - angle)))
    short = np.flatnonzero(values < 0.0)
    assert worst in short
    assert short.size == np.ptp(short) + 1 < 20


def test_a_stable_negative_stiffness_is_refused_too() -> None:
    """On a device with a spring of its own the loop is stable, and no angle that is looked at shows
    what K < 0 does at 0 Hz.
    """
    model = model_of(sprung())
    theorem = Theorem(model)
    points = np.array([[-10.0, 0.0, 0.0], [10.0, 0.0, 0.0]])
    assert (spectral_radius(model, points) < 1.0).all()
    assert outside_circles(circles(lifted_system(model)), points).all()
    assert theorem.safe(points, conditions()).tolist() == [False, True]


def test_safe_points_are_stable() -> None:
    scene = device_scene("weir2008")
    assert scene is not None
    model = compose(scene)
    draw = np.random.default_rng(3)
    points = draw.uniform((0.0, -20.0, -0.3), (3000.0, 20.0, 0.3), (4000, 3))
    flags = Theorem(model).safe(points, conditions(delay=model.delay_periods))
    assert (spectral_radius(model, points[flags]) < 1.0).all()


def test_passive_but_unstable_is_not_safe() -> None:
    """The theorem presumes stability: what grows where the probe does not see it passes every
    circle.
    """
    model = model_of(with_hidden_growth(rigid()))
    points = np.array([[100.0, 0.5, 0.0]])
    assert outside_circles(circles(lifted_system(model)), points).all()
    assert not Theorem(model).safe(points, conditions())[0]
    assert Theorem(model_of(rigid())).safe(points, conditions())[0]


def test_allowed_ends_are_safe_and_a_step_beyond_is_not() -> None:
    judge = shipped_judge()
    now = {"K": 40.0, "B": 0.3, "M": 0.001}
    verdict = change(judge, {}, now=now)["verdict"]
    for name, span in (("K", 400.0), ("B", 3.0), ("M", 0.02)):
        low, high = verdict["allowed"][name]
        step = 2e-3 * span
        assert low <= now[name] <= high
        for end, out in ((low, low - step), (high, high + step)):
            assert change(judge, now | {name: end})["verdict"]["safe"]
            if name != "K" or out > 0.0:
                assert not change(judge, now | {name: out})["verdict"]["safe"]


def test_a_safe_display_has_an_interval_for_each() -> None:
    """Also at rest and free, where the loop drifts and an end of B is an eigenvalue of 1 twice."""
    for added in (0.0, 1.74, 10.0):
        judge = Judge(setup_of(rigid(0.36, 0.125)))
        allowed = change(judge, {}, now={"active_damping": added})["verdict"]["allowed"]
        low, high = allowed["B"]
        assert low == pytest.approx(-0.36 - added, rel=1e-2)
        assert low < 0.0 < high
        assert allowed["M"] is not None
        assert allowed["K"][0] == 0.0


def test_nearest_safe_interval_of_a_point_that_is_not() -> None:
    verdict = change(rigid_judge(), {"K": 6000.0})["verdict"]
    assert verdict["safe"] is False
    assert verdict["allowed"]["K"] == pytest.approx([0.0, 2.0 * VISCOUS_NS_PER_M / T_S], rel=2e-3)
    # no mass and no damper makes so stiff a spring passive
    assert verdict["allowed"]["M"] is None


def two_islands(values: np.ndarray) -> np.ndarray:
    return ((values > -3.0) & (values < -1.0)) | ((values > 2.0) & (values < 5.0))


def islands_of_both(asked: list[np.ndarray], sure: bool) -> list[np.ndarray]:
    """Two axes alike; one hopes for an island that is not sure."""
    first, second = (two_islands(values) for values in asked)
    return [first, second & ~(sure & (asked[1] < 0.0))]


def test_interval_is_the_connected_one() -> None:
    ranges = [(-10.0, 10.0)] * 2
    inside = intervals(islands_of_both, ranges, (3.0, 3.0))
    assert inside[0] == inside[1] == pytest.approx([2.0, 5.0], abs=5e-3)
    assert intervals(islands_of_both, ranges, (-0.5, 9.0))[0] == pytest.approx(
        [-3.0, -1.0], abs=5e-3
    )
    nothing = intervals(lambda asked, sure: [one > 99.0 for one in asked], ranges, (0.0, 0.0))
    assert nothing == [None, None]


def test_interval_that_is_hoped_for_and_not_sure_gives_way_to_the_next() -> None:
    found = intervals(islands_of_both, [(-10.0, 10.0)] * 2, (-2.0, -2.0))
    assert found[0] == pytest.approx([-3.0, -1.0], abs=5e-3)
    assert found[1] == pytest.approx([2.0, 5.0], abs=5e-3)


def test_kept_levels_are_few_and_have_the_ends() -> None:
    levels = cached_levels(10.0, 1.74)
    assert len(levels) <= LEVELS
    assert {0.0, 1.74, 10.0} <= set(levels)
    assert cached_levels(0.0, 1.74) == (0.0,)
