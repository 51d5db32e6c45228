"""The guard with the judge it has, in front of the real servo, on virtual time: at every tick of a
change in stages the board reports the damping that the environment in force needs.
"""

from collections.abc import Iterator

import numpy as np
import pytest
from support.guard_stages import Flight, rendering


@pytest.fixture
def flight() -> Iterator[Flight]:
    flight = Flight()
    with flight.stack:
        yield flight
        flight.view.drop()


def test_toggled_damping_never_outruns_the_environment(flight: Flight) -> None:
    """Each request supersedes the one before, wherever its way stands."""
    rendering(flight, "follow")
    pauses = np.random.default_rng(7).integers(5, 250, 20).tolist()
    flown = []
    for place, pause in enumerate(pauses):
        flight.ask(cmd="damping", value="off" if place % 2 == 0 else "on")
        flown.append(flight.fly(pause))
    for record in np.concatenate(flown)[::7]:
        level = float(record["active_damping_effect_ns_per_m"])
        bare = {"wall": {"side": 0}, "M": 0.0, "active_damping": level}
        now = bare | {
            "K": float(record["stiffness_n_per_m"]),
            "B": float(record["virtual_damping_ns_per_m"]),
        }
        question = {
            "ask": "look",
            "now": now,
            "target": now,
            "delay_periods": None,
            "margin_ns_per_m": 0.0,
            "basis": "theorem",
            "level_on": level,
        }
        assert flight.judge.answer(question)["verdict"]["safe"] is True, now
