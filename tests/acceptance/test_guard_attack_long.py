"""The attack on the guard, on a few sequences: what it finds in guards that are none, and nothing
in ours. Then ways to get past it, one by one.
"""

from collections.abc import Callable
from typing import Any

import pytest
from support.guard_attack import FEW, answering
from support.whole_tick import SETTLED, Point

from benchmarks.guard_attack import Found, attack, device, fly_one
from benchmarks.guard_flight import plain_servo
from benchmarks.guard_flown import flown
from benchmarks.guard_requests import Guarded


def test_guard_that_refuses_everything_refuses_what_is_safe() -> None:
    found = attack(FEW[:1], lambda request: answering("refuse", request))
    assert not found.unsafe
    assert len(found.refused) == found.safe_further >= 4


@pytest.fixture(scope="module")
def some() -> Found:
    return attack(FEW)


def test_nothing_comes_into_force_that_a_hand_would_shake(some: Found) -> None:
    assert some.points > 200
    assert not some.unsafe


def test_few_requests_are_refused_that_no_hand_would_shake_further_out(some: Found) -> None:
    assert some.safe_further > 30
    assert len(some.refused) <= 0.05 * some.safe_further


# --- ways past the guard, each found in it once ---------------------------------------------------


class Client:
    """Somebody who asks a guard of the shipped display, without a board."""

    def __init__(self, policy: str, told: float | None = None) -> None:
        self.guarded = Guarded(device().judge.answer, plain_servo(), policy, told, 0)

    def ask(self, ticks: int = 300, **change: Any) -> None:
        """Ask for `change`, and give it so many ticks."""
        self.guarded.ask(change)
        self.guarded.run(ticks)

    def schedule(self, at_tick: int, **change: Any) -> None:
        self.guarded.ask(change, at_tick)

    def enable(self, ticks: int = 300) -> None:
        self.guarded.ask({}, enable=True)
        self.guarded.run(ticks)

    @property
    def ringing(self) -> list[Point]:
        """What came into force and rings in some hand."""
        self.guarded.run(2000)
        points = list(self.guarded.plans.points)
        worst = device().bench.worst(points) if points else []
        return [point for point, one in zip(points, worst, strict=True) if one > SETTLED]


def damping_still_rises_when_a_scheduled_spring_comes(client: Client) -> None:
    """1.74 N s/m take 87 ms at 20 N s/m/s."""
    client.enable()
    soon = client.guarded.tick + 100
    client.schedule(soon, active_damping=1.74)
    client.schedule(soon + 5, K=1500.0, ramp_s=0.0)


def scheduled_spring_is_still_there_when_damping_goes(client: Client) -> None:
    client.ask(active_damping=1.74)
    client.ask(K=1500.0)
    client.enable()
    soon = client.guarded.tick + 50
    client.schedule(soon, K=100.0, ramp_s=1.0)
    client.schedule(soon + 10, active_damping=0.0)


def spring_is_still_there_when_force_comes_on(client: Client) -> None:
    client.ask(active_damping=1.74)
    client.ask(K=1500.0)
    client.ask(200, K=100.0, active_damping=0.0, ramp_s=10.0)
    client.enable()


def wall_is_still_there_when_damping_goes(client: Client) -> None:
    """Its side comes to 0 on a ramp, on whose square its force depends."""
    client.ask(active_damping=1.74)
    client.ask(wall={"side": 1, "stiffness_n_per_m": 1500.0, "virtual_damping_ns_per_m": 0.0})
    client.enable()
    client.ask(50, wall={"side": 0}, ramp_s=2.0)
    client.ask(active_damping=0.0)


def negative_mass_is_easier_with_the_longest_delay(client: Client) -> None:
    """M = -8 g needs 2.32 N s/m at T / 8 and 2.05 at 1.5 T."""
    client.guarded.delay_periods = 1.5
    client.ask(active_damping=1.85)
    client.ask(M=-0.008)
    client.enable()


def ramps_of_different_length_are_under_way_when_damping_goes(client: Client) -> None:
    """K goes slowly and B comes quickly: on no line between both is K still there with all of B."""
    client.ask(active_damping=1.74)
    client.ask(K=1000.0)
    client.enable()
    client.ask(10, K=100.0, ramp_s=5.0)
    client.ask(10, B=1.5, ramp_s=0.2)
    client.ask(active_damping=0.9)


def stages_left_over_from_a_refused_change(client: Client) -> None:
    """Filters in use are refused by the servo; what was to come after them must not come."""
    client.ask(active_damping=3.0)
    client.ask(wall={"side": 1, "stiffness_n_per_m": 1700.0, "virtual_damping_ns_per_m": 3.3})
    client.enable()
    client.guarded.choose("auto")
    client.ask(filters={"velocity_hz": 300.0})
    client.ask(active_damping=0.0)


WAYS = [
    damping_still_rises_when_a_scheduled_spring_comes,
    scheduled_spring_is_still_there_when_damping_goes,
    spring_is_still_there_when_force_comes_on,
    wall_is_still_there_when_damping_goes,
    negative_mass_is_easier_with_the_longest_delay,
    ramps_of_different_length_are_under_way_when_damping_goes,
    stages_left_over_from_a_refused_change,
]


@pytest.mark.parametrize("policy", ["refuse", "clamp", "follow"])
@pytest.mark.parametrize("way", WAYS, ids=lambda one: one.__name__)
def test_there_is_no_way_past_the_guard(way: Callable[[Client], None], policy: str) -> None:
    client = Client(policy)
    way(client)
    assert not client.ringing


def test_guard_that_lets_everything_pass_is_found_out() -> None:
    found = attack(FEW[:3], lambda request: answering("apply", request))
    assert len(found.unsafe) > 10
    assert not found.refused


@pytest.mark.parametrize("seed", [1, 2])
def test_flight_in_a_hand_that_shakes_what_lies_further_out_is_in_order(seed: int) -> None:
    found = fly_one(seed)
    assert found.points > 50
    assert not found.wrong


def test_flight_without_a_guard_is_not_in_order() -> None:
    """The judge of flights is not blind itself."""
    blind = flown(4, lambda request: answering("apply", request), device().bench)
    assert blind.wrong
