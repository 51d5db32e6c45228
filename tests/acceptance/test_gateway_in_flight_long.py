"""What is under way when a gateway is replaced, a board restarts or the ring is full: the command
server, with the guard's judge, in front of the servo itself, on virtual time.
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
