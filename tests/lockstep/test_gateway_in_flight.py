"""What is under way as another takes the lease, and ramps that go on while more is asked: the
command server, with the guard's judge, in front of the servo itself, on virtual time.
"""

from collections.abc import Iterator
from typing import Any

import pytest
from support.guard_stages import LEVEL_NS_PER_M, Flight
from test_gateway_overtaken import enabled, send, until_posted

# in the wall it needs more than the damping of the device
WALL = {
    "stiffness_n_per_m": 1.0, "virtual_damping_ns_per_m": 4.0, "position_m": 0.0, "side": 1,
}  # fmt: skip


@pytest.fixture
def flight() -> Iterator[Flight]:
    flight = Flight()
    yield flight
    flight.stack.close()


# --- leases: the servo stands from the posting until another holds the lease ----------------------


@pytest.mark.parametrize("policy", ["off", "warn", "refuse"])
@pytest.mark.parametrize("before", ["nobody", "its client"])
def test_a_change_that_the_servo_has_not_taken_does_not_come_under_the_lease_of_another(
    flight: Flight, policy: str, before: str
) -> None:
    enabled(flight, policy)
    if before == "its client":
        assert flight.ask(cmd="lease", what="environment")["ok"]
        flight.fly(5)
    send(flight, {"cmd": "set", "K": 30.0})
    until_posted(flight)
    send(flight, {"cmd": "lease", "what": "environment", "take_over": True}, client=b"b")
    assert not flight.fly(100)["stiffness_n_per_m"].any()


@pytest.mark.parametrize("asked", [{"cmd": "enable"}, {"cmd": "home"}, {"cmd": "zero"}])
def test_nor_does_what_switches_force_or_moves_the_origin(
    flight: Flight, asked: dict[str, Any]
) -> None:
    send(flight, asked)
    until_posted(flight)
    send(flight, {"cmd": "lease", "what": "environment"}, client=b"b")
    assert not flight.fly(100)["state"].any()
    (refused,) = (one for one in flight.replies if not one["ok"])
    assert "another's lease" in refused["error"]["message"]


def test_nor_does_a_perturbation(flight: Flight) -> None:
    enabled(flight, "warn")
    assert flight.ask(cmd="perturb", action="load", samples_n=[0.1] * 200)["ok"]
    send(flight, {"cmd": "perturb", "action": "start", "loop": True})
    until_posted(flight)
    send(flight, {"cmd": "lease", "what": "perturbation"}, client=b"b")
    assert not flight.fly(50)["perturbing"].any()


def test_force_0_comes_under_the_lease_of_another(flight: Flight) -> None:
    enabled(flight, "warn")
    assert flight.ask(cmd="set", K=20.0)["ok"]
    send(flight, {"cmd": "set", "K": 0.0})
    until_posted(flight)
    send(flight, {"cmd": "lease", "what": "environment"}, client=b"b")
    assert flight.fly(100)["stiffness_n_per_m"][-1] == 0.0


# --- ramps of a wall, which no record contains ----------------------------------------------------


def at_a_wall(flight: Flight, ramp_s: float, **change: float) -> None:
    """A wall that needs active damping, and `change` of it on the way."""
    assert flight.ask(cmd="guard", policy="refuse")["ok"]
    assert flight.ask(cmd="damping", value=LEVEL_NS_PER_M)["ok"]
    flight.fly(120)
    assert flight.ask(cmd="enable")["ok"]
    assert flight.ask(cmd="set", wall=WALL, ramp_s=0.0)["ok"]
    flight.fly(550)
    assert flight.ask(cmd="set", wall=change, ramp_s=ramp_s)["receipt"]["result"] == "applied"
    flight.fly(10)


def test_a_second_ramp_of_a_wall_does_not_hide_the_first(flight: Flight) -> None:
    at_a_wall(flight, 5.0, virtual_damping_ns_per_m=0.0)
    assert flight.ask(cmd="set", wall={"virtual_damping_ns_per_m": 0.1}, ramp_s=5.0)["ok"]
    assert flight.ask(cmd="damping", value="off")["receipt"]["result"] == "staged"


def test_nor_does_one_of_the_same_tick(flight: Flight) -> None:
    assert flight.ask(cmd="guard", policy="off")["ok"]
    send(flight, {"cmd": "set", "wall": WALL, "ramp_s": 0.0})
    send(flight, {"cmd": "set", "wall": {"virtual_damping_ns_per_m": 0.0}, "ramp_s": 5.0})
    flight.fly(5)
    assert flight.guard.in_force.now().wall.virtual_damping_ns_per_m == 4.0


def test_damping_does_not_go_while_force_rises_and_what_needs_it_goes(flight: Flight) -> None:
    assert flight.ask(cmd="guard", policy="refuse")["ok"]
    assert flight.ask(cmd="damping", value=LEVEL_NS_PER_M)["ok"]
    flight.fly(120)
    assert flight.ask(cmd="set", K=300.0, B=0.74)["ok"]
    assert flight.ask(cmd="enable")["ok"]
    flight.fly(200)
    assert flight.ask(cmd="set", B=0.0, ramp_s=4.0)["ok"]
    assert flight.ask(cmd="damping", value="off")["receipt"]["result"] == "staged"
