"""Flying recorded motions again: the same bits whatever happened, other forces for other
settings, damage found.
"""

import json

import msgpack
import numpy as np
import pytest
from support.boards import board_params
from support.flight import Flight
from support.models import device_params, servo_params
from support.recorded import RecordedFlight

from hapticd.core.params import HomeParams
from hapticd.mailbox.layout import Command, Result, State, Value
from hapticd.model.params import InjectionParams
from hapticd.recording import replay
from hapticd.servo.plan import SETTLED, ServoState, flatten, unflatten

ROUGH = tuple(
    InjectionParams(kind, tick=tick, count=count)
    for kind, tick, count in (
        ("drop_in", 1000, 3),
        ("corrupt_in", 1200, 2),
        ("drop_out", 1400, 2),
        ("drop_in", 1600, 6),
    )
)


def eventful() -> tuple[RecordedFlight, replay.Segment]:
    """Two and more seconds with everything: ramps, filters, scheduled changes, lost frames,
    stop, reset, fault.
    """
    with RecordedFlight(board=board_params(injections=ROUGH)) as flight:
        flight.move()
        flight.fly(800)
        stack = flight.stack
        stack.do(Command.DAMPING, {Value.ACTIVE_DAMPING: 1.74, Value.ACTIVE_DAMPING_ON: 1.0})
        flight.fly(400)
        stack.do(Command.SET, {Value.WALL_STIFFNESS: 500.0, Value.WALL_SIDE: 1.0})
        stack.command(
            Command.SET, {Value.STIFFNESS: 80.0, Value.RAMP_S: 0.3}, at_tick=stack.loop.tick + 100
        )
        flight.fly(600)
        for kind in (Command.STOP, Command.RESET, Command.ENABLE):
            stack.do(kind)
            flight.fly(300)
            if kind is Command.RESET:
                other = stack.do(Command.SET, {Value.VELOCITY_FILTER_HZ: 60.0})
                assert other.result is Result.APPLIED
        stack.do(Command.DISABLE)
        stack.do(Command.ZERO)
        flight.fly(100)
        return flight, flight.leg()


@pytest.fixture(scope="module")
def flown() -> tuple[RecordedFlight, replay.Segment]:
    return eventful()


def test_flight_had_everything(flown: tuple[RecordedFlight, replay.Segment]) -> None:
    records = flown[1].records
    assert {State.DISABLED, State.ENABLED, State.STOPPED} <= set(records["state"].tolist())
    assert records["arrival"].min() < -1
    assert records["arrival"].max() > 1
    assert np.ptp(records["active_damping_ns_per_m"]) > 1.0
    assert np.abs(records["force_n"]).max() > 0.01


def test_reflight_is_bit_exact(flown: tuple[RecordedFlight, replay.Segment]) -> None:
    flight, leg = flown
    assert replay.difference(leg.records, replay.replay(flight.params, leg)) is None


def test_checkpoint_survives_json_and_msgpack(flown: tuple[RecordedFlight, replay.Segment]) -> None:
    flight, leg = flown
    for again in (
        json.loads(json.dumps(leg.state)),
        msgpack.unpackb(msgpack.packb(leg.state), strict_map_key=False),
    ):
        assert (
            replay.difference(leg.records, replay.replay(flight.params, leg._replace(state=again)))
            is None
        )


def test_one_changed_bit_is_found(flown: tuple[RecordedFlight, replay.Segment]) -> None:
    flight, leg = flown
    records = leg.records.copy()
    records["work_j"].view(np.uint64)[700] ^= 1
    found = replay.difference(records, replay.replay(flight.params, leg))
    assert found is not None
    assert (found.field, found.tick) == ("work_j", int(records["tick"][700]))


def test_sent_torque_and_damping_are_compared(flown: tuple[RecordedFlight, replay.Segment]) -> None:
    flight, leg = flown
    for place, field in ((4, "torque"), (6, "damping")):
        records = leg.records.copy()
        frames = (
            np.ascontiguousarray(records["out_frame"])
            .view(np.uint8)
            .reshape(len(records), -1)
            .copy()
        )
        frames[50, place] ^= 1
        records["out_frame"] = frames.view(records.dtype["out_frame"]).ravel()
        found = replay.difference(records, replay.replay(flight.params, leg))
        assert found is not None
        assert found.field == field


def test_bytes_of_a_bad_frame_are_not_believed(
    flown: tuple[RecordedFlight, replay.Segment],
) -> None:
    flight, leg = flown
    records = leg.records.copy()
    records["in_frame"][records["arrival"] < 0] = np.void(b"\xff" * 64)
    assert (
        replay.difference(records, replay.replay(flight.params, leg._replace(records=records)))
        is None
    )


def test_forgotten_request_is_found(flown: tuple[RecordedFlight, replay.Segment]) -> None:
    flight, leg = flown
    without = leg._replace(requests=[one for one in leg.requests if one.kind != Command.SET])
    assert replay.difference(leg.records, replay.replay(flight.params, without)) is not None


def test_held_settings_act_from_the_first_tick_to_the_last(
    flown: tuple[RecordedFlight, replay.Segment],
) -> None:
    flight, leg = flown
    other = replay.replay(
        flight.params,
        leg,
        {Value.STIFFNESS: 10.0, Value.VIRTUAL_DAMPING: 0.0, Value.ACTIVE_DAMPING_ON: 0.0},
    )
    enabled = (other["gain"] == 1.0) & (leg.records["arrival"] >= 0)
    assert set(other["stiffness_n_per_m"].tolist()) == {10.0}
    assert np.allclose(
        other["stiffness_force_n"][enabled],
        -10.0 * leg.records["position_m"][enabled],
        rtol=1e-12,
        atol=1e-12,
    )
    assert other["virtual_damping_force_n"].any() == np.False_
    assert other["active_damping_asked_ns_per_m"].max() == pytest.approx(0.0)
    assert np.array_equal(other["position_m"], leg.records["position_m"])


def test_other_filters_are_held_though_the_servo_would_have_refused_them(
    flown: tuple[RecordedFlight, replay.Segment],
) -> None:
    flight, leg = flown
    other = replay.replay(flight.params, leg, {Value.VELOCITY_FILTER_HZ: 5.0})
    enabled = (leg.records["gain"] == 1.0) & (leg.records["arrival"] >= 0)
    moved = other["velocity_m_per_s"][enabled].std()
    assert moved < 0.5 * leg.records["velocity_m_per_s"][enabled].std()


def test_other_settings_stay_as_they_were_asked(
    flown: tuple[RecordedFlight, replay.Segment],
) -> None:
    flight, leg = flown
    other = replay.replay(flight.params, leg, {Value.VIRTUAL_DAMPING: 5.0})
    assert np.array_equal(other["stiffness_n_per_m"], leg.records["stiffness_n_per_m"])
    assert np.array_equal(other["state"], leg.records["state"])


def test_scheduled_change_of_a_held_setting_is_ignored() -> None:
    with RecordedFlight() as flight:
        flight.move()
        flight.stack.command(Command.SET, {Value.STIFFNESS: 80.0, Value.RAMP_S: 0.0}, at_tick=900)
        flight.fly(1200)
        leg = flight.leg()
    assert leg.records["stiffness_n_per_m"].max() == 80.0
    assert set(
        replay.replay(flight.params, leg, {Value.STIFFNESS: 10.0})["stiffness_n_per_m"].tolist()
    ) == {10.0}


def test_fault_is_flown_again() -> None:
    board = board_params(injections=(InjectionParams("encoder_jump", tick=900, value=100_000.0),))
    with RecordedFlight(board=board) as flight:
        flight.move()
        flight.fly(1500)
        leg = flight.leg()
    assert State.FAULT in leg.records["state"]
    assert replay.difference(leg.records, replay.replay(flight.params, leg)) is None


def states() -> list[ServoState]:
    """A state of each kind."""
    home = HomeParams(method="stop", speed_m_per_s=0.05, force_n=1.0)
    flight = Flight(servo_params(device=device_params(home=home)))
    found = [flight.state]
    flight.do(Command.HOME)
    found.append(flight.state)
    flight.do(Command.DISABLE)
    flight.do(Command.ENABLE)
    flight.do(
        Command.SET, {Value.STIFFNESS: 100.0, Value.WALL_SIDE: -1.0}, at_tick=flight.tick + 500
    )
    flight.fly(50, encoder=1000)
    found.append(flight.state)
    flight.do(Command.STOP)
    flight.fly(3, encoder=900)
    return [*found, flight.state]


@pytest.mark.parametrize("state", states(), ids=lambda state: state[SETTLED].plan.state.name)
def test_every_state_survives_flattening(state: ServoState) -> None:
    again = unflatten(json.loads(json.dumps(flatten(state))))
    assert again == state
    plan = again[SETTLED].plan
    assert type(plan) is type(state[SETTLED].plan)
    assert [type(one) for one in plan.scheduled] == [
        type(one) for one in state[SETTLED].plan.scheduled
    ]


def test_request_during_a_pause_of_the_gateway_is_noted_once() -> None:
    with RecordedFlight() as flight:
        flight.move()
        flight.fly(400)
        noted, tail, lost = flight.stack.gateway.journal(0)
        assert [one.kind for one in noted] == [Command.SET, Command.ENABLE, Command.PERTURB_START]
        assert (lost, flight.stack.gateway.journal(tail)) == (0, ([], tail, 0))
