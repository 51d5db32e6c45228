"""What is under way when a gateway is replaced, a board restarts, the ring is full, or a wall is
changed: the command server, with the guard's judge, in front of the servo itself, on virtual time.
"""

from collections.abc import Iterator
from typing import Any

import pytest
from support.gateway_rig import packed
from support.guard_stages import LEVEL_NS_PER_M, STIFF, Flight
from test_gateway_in_flight import at_a_wall
from test_gateway_overtaken import enabled

from hapticd.mailbox.layout import State
from hapticd.model.params import InjectionParams
from hapticd.protocol.view import as_records


@pytest.fixture
def flight() -> Iterator[Flight]:
    flight = Flight()
    yield flight
    flight.stack.close()


@pytest.mark.parametrize(
    ("change", "ramp_s"), [({"virtual_damping_ns_per_m": 0.0}, 2.4), ({"side": 0}, 3.0)]
)
def test_a_new_gateway_takes_no_damping_from_a_wall_on_its_way_out(
    flight: Flight, change: dict[str, float], ramp_s: float
) -> None:
    """In the second half of the ramp of its side records round it to 0."""
    at_a_wall(flight, ramp_s, **change)
    flight.stack.run(round(500 * ramp_s))
    flight.another_gateway()
    flight.fly(650)
    refused = flight.ask(cmd="damping", value="off")
    assert "ramps from before the start of this gateway" in refused["error"]["message"]
    flight.fly(500)
    assert flight.ask(cmd="damping", value="off")["ok"]


@pytest.mark.parametrize(("kind", "away_s"), [("restart", 0.0), ("unplug", 0.02)])
def test_an_enable_in_stages_ends_with_the_board_that_it_was_asked_for(
    kind: str, away_s: float
) -> None:
    flight = Flight(InjectionParams(kind, tick=660, value=away_s))
    with flight.stack:
        assert flight.ask(cmd="guard", policy="refuse")["ok"]
        assert flight.ask(cmd="set", **STIFF, active_damping=LEVEL_NS_PER_M)["ok"]
        assert flight.ask(cmd="enable")["receipt"]["result"] == "staged"
        assert flight.view.tick < 650
        assert not (flight.fly(1000)["state"] == State.ENABLED).any()


# --- a client that floods the ring ----------------------------------------------------------------


def flooded(flight: Flight, ticks: int, *requests: dict[str, Any]) -> Any:
    """Records of passes of 20 ticks, in each of which client c sends what is always accepted."""
    records = []
    flood = [[b"c", packed(cmd="perturb", action="stop")]] * 70
    for _ in range(ticks // 20):
        records.append(flight.stack.run(20))
        now_ns = flight.stack.clock.now_ns()
        flight.view.refresh(now_ns)
        flight.server.serve([*([b"b", packed(**one)] for one in requests), *flood], now_ns)
        flight.server.collect(now_ns)
        requests = ()
    return as_records(b"".join(records))


def test_a_flood_does_not_keep_the_terms_of_the_guard_from_the_servo(flight: Flight) -> None:
    enabled(flight, "warn")
    at = flight.view.tick + 200
    assert flight.ask(cmd="set", **STIFF, at_tick=at, ramp_s=0.0)["ok"]
    flooded(flight, 40)
    records = flooded(flight, 200, {"cmd": "guard", "policy": "refuse"})
    assert not records["stiffness_n_per_m"].any()


# --- a wall that needs its damping: some of it helps the stiffness --------------------------------

HARD = {"stiffness_n_per_m": 3800.0, "virtual_damping_ns_per_m": 0.3, "side": 1, "position_m": 0.0}
UNDAMPED = {"virtual_damping_ns_per_m": 0.0}


def at_a_hard_wall(flight: Flight, policy: str, wall: dict[str, Any]) -> None:
    """That wall alone, with 2 N s/m of active damping and without force."""
    assert flight.ask(cmd="damping", value=2.0)["ok"]
    flight.fly(150)
    alone = {"K": 0.0, "B": 0.0, "M": 0.0, "filters": {"velocity_hz": 400.0}, "wall": wall}
    assert flight.ask(cmd="set", **alone, ramp_s=0.0)["ok"]
    assert flight.ask(cmd="guard", policy=policy)["ok"]
    flight.fly(20)


def test_an_enable_does_not_come_while_a_wall_without_its_damping_is_stiff(flight: Flight) -> None:
    at_a_hard_wall(flight, "refuse", HARD)
    assert flight.ask(cmd="enable")["guard"]["safe"]
    flight.fly(50)
    assert flight.ask(cmd="set", wall=UNDAMPED, ramp_s=0.0)["error"]["guard"]["safe"] is False
    assert flight.ask(cmd="disable")["ok"]
    assert flight.ask(cmd="set", wall={"stiffness_n_per_m": 500.0}, ramp_s=60.0)["ok"]
    assert flight.ask(cmd="set", wall=UNDAMPED, ramp_s=0.0)["ok"]
    assert flight.ask(cmd="enable")["error"]["guard"]["safe"] is False
    assert not flight.fly(100)["gain"].any()


def test_scheduled_changes_do_not_take_the_damping_from_a_stiff_wall(flight: Flight) -> None:
    at_a_hard_wall(flight, "refuse", HARD)
    assert flight.ask(cmd="enable")["ok"]
    flight.fly(50)
    due = int(flight.view.tick) + 1000
    softer = {"stiffness_n_per_m": 500.0}
    assert flight.ask(cmd="set", wall=softer, ramp_s=60.0, at_tick=due)["ok"]
    assert flight.ask(cmd="set", K=1.0, at_tick=due + 100)["ok"]
    last = flight.ask(cmd="set", wall=UNDAMPED, ramp_s=0.0, at_tick=due + 200)
    assert last["error"]["guard"]["safe"] is False


def test_damping_of_a_wall_that_rises_again_does_not_hide_how_far_it_fell(flight: Flight) -> None:
    """It has fallen from 0.3 to 0.03 N s/m and rises to 0.1: enough for the stiffness then."""
    at_a_hard_wall(flight, "off", HARD | {"stiffness_n_per_m": 500.0})
    assert flight.ask(cmd="enable")["ok"]
    assert flight.ask(cmd="set", wall=UNDAMPED, ramp_s=0.1)["ok"]
    flight.fly(90)
    assert flight.ask(cmd="set", wall={"virtual_damping_ns_per_m": 0.1}, ramp_s=2.0)["ok"]
    assert flight.ask(cmd="guard", policy="refuse")["ok"]
    harder = flight.ask(cmd="set", wall={"stiffness_n_per_m": 3650.0}, ramp_s=0.0)
    assert harder["receipt"]["result"] == "staged"
    assert flight.fly(100)["wall_stiffness_n_per_m"].max() == 500.0


def test_nor_from_an_enable(flight: Flight) -> None:
    at_a_hard_wall(flight, "off", HARD | {"stiffness_n_per_m": 500.0})
    assert flight.ask(cmd="set", wall=UNDAMPED, ramp_s=0.1)["ok"]
    flight.fly(90)
    harder = {"stiffness_n_per_m": 3650.0, "virtual_damping_ns_per_m": 0.1}
    assert flight.ask(cmd="set", wall=harder, ramp_s=2.0)["ok"]
    assert flight.ask(cmd="guard", policy="refuse")["ok"]
    assert flight.ask(cmd="enable")["error"]["guard"]["safe"] is False
    flight.fly(2000)
    assert flight.ask(cmd="enable")["guard"]["safe"]
