"""The proxy of a law of one's own: the servo bounds whatever the law asks, and it ends without
force. A hand of one mass, with the exact motion of each tick.
"""

from dataclasses import replace
from math import inf, nan

import numpy as np
import pytest
from support.boards import board_params
from support.flight import masked
from support.models import COUNT_M, device_params, servo_params
from support.proxies import OWNER, RANGE_M, RATE_HZ, ProxyFlight, generous, with_range
from support.recorded import RecordedFlight

from hapticd.core.params import RealtimeParams, SafetyParams, ServoParams
from hapticd.mailbox.layout import Command, Flag, State, Value
from hapticd.protocol.ledger import book, samples
from hapticd.protocol.view import as_records
from hapticd.recording import replay
from hapticd.run.lockstep import LockStep
from hapticd.servo.energy import spring_energy
from hapticd.servo.plan import flatten, unflatten
from hapticd.servo.samples import believed_bend_m

SAFETY = SafetyParams()
TIMEOUT = round(SAFETY.proxy_timeout_s * RATE_HZ)


def held(flight: ProxyFlight) -> bool:
    return bool(flight.out[9] & Flag.PROXY_HELD)


def pump(flight: ProxyFlight) -> float:
    """Ahead of the hand by as much as the range allows, in the direction of its motion."""
    return RANGE_M if flight.velocity_m_per_s >= 0.0 else -RANGE_M


def test_spring_acts_on_the_distance_from_the_proxy() -> None:
    flight = ProxyFlight(with_range())
    flight.follow(lambda _: 0.005, 60)
    x = flight.out[1]
    assert flight.proxy_m == 0.005
    assert flight.out[4] == pytest.approx(200.0 * (0.005 - x), rel=1e-12)
    assert flight.out[8] == pytest.approx(flight.out[4] + flight.out[5], abs=3e-4)


def test_law_that_stays_at_0_changes_no_bit() -> None:
    with_law, alone = (ProxyFlight(with_range()) for _ in range(2))
    for flight in (with_law, alone):
        flight.velocity_m_per_s = 0.2
    for _ in range(300):
        assert with_law.aim(0.0) == alone.fly()
        assert with_law.blob == alone.blob
    assert with_law.state[1:] == alone.state[1:]


def test_wall_and_ends_of_the_workspace_stay_where_they_are() -> None:
    flight = ProxyFlight(with_range())
    wall = {Value.WALL_STIFFNESS: 500.0, Value.WALL_POSITION: 0.001, Value.WALL_SIDE: 1.0}
    flight.do(Command.SET, {**wall, Value.RAMP_S: 0.0})
    flight.follow(lambda _: 0.01, 400)
    assert flight.out[1] > 0.0015
    assert flight.out[7] == pytest.approx(-500.0 * (flight.out[1] - 0.001))


@pytest.mark.parametrize("stiffness", [200.0, 5000.0])
def test_jump_of_a_law_moves_the_proxy_at_its_speed_and_force_step(stiffness: float) -> None:
    flight = ProxyFlight(with_range(stiffness, generous()), mass_kg=100.0)
    path = [flight.proxy_m]
    for _ in range(60):
        flight.aim(RANGE_M)
        path.append(flight.proxy_m)
    step_n = flight.params.device.force_step_n
    allowed = min(SAFETY.proxy_speed_m_per_s / RATE_HZ, step_n / stiffness)
    assert path[-1] > 0.01
    assert np.diff(path).max() == pytest.approx(allowed)


@pytest.mark.parametrize("target_m", [nan, inf, -inf, 1.001 * RANGE_M, -1.0])
def test_position_that_is_no_number_or_outside_the_workspace_moves_nothing(
    target_m: float,
) -> None:
    flight = ProxyFlight(with_range())
    flight.follow(lambda _: target_m, 50)
    assert flight.plan.proxy.owner == 0
    assert flight.out[8] == 0.0


def test_position_that_is_not_in_the_mask_moves_nothing() -> None:
    flight = ProxyFlight(with_range())
    values = list(masked({Value.PROXY: 0.005}))
    values[Value.MASK] = 0.0
    flight._one(((1, int(Command.PROXY), OWNER, 0, tuple(values)),))
    flight.fly(50)
    assert flight.plan.proxy.owner == 0


def test_late_law_leaves_the_proxy_where_it_is() -> None:
    flight = ProxyFlight(with_range())
    flight.follow(lambda _: 0.005, 50)
    flight.aim(0.005 + 0.001)
    flight.fly(TIMEOUT)
    assert not held(flight)
    flight.fly()
    there = flight.proxy_m
    assert held(flight)
    assert there == 0.006
    flight.fly(500)
    assert flight.proxy_m == there
    flight.follow(lambda _: 0.001, 400)  # it may come back
    assert flight.proxy_m == 0.001
    assert not held(flight)


def test_shortest_timeout_is_a_tick_at_a_slow_rate() -> None:
    params = with_range(200.0, SafetyParams(proxy_timeout_s=0.002, enable_ramp_s=0.1))
    flight = ProxyFlight(replace(params, realtime=RealtimeParams(mode="off", rate_hz=240.0)))
    flight.follow(lambda _: 0.001, 40)
    assert flight.proxy_m == pytest.approx(0.001)
    assert not flight.plan.proxy.held
    flight.fly(2)
    assert flight.plan.proxy.held


def test_law_that_dies_on_the_way_leaves_the_proxy_on_the_way() -> None:
    flight = ProxyFlight(with_range(safety=generous(proxy_speed_m_per_s=0.05)))
    flight.fly(TIMEOUT)
    flight.aim(0.02)
    flight.fly(TIMEOUT + 1)
    there = flight.proxy_m
    flight.fly(200)
    assert 0.004 < there < 0.006
    assert flight.proxy_m == there
    assert held(flight)


def test_slow_law_moves_the_proxy_smoothly() -> None:
    flight = ProxyFlight(with_range(safety=generous()))
    path = []
    for tick in range(200):
        flight.aim(5e-5 * tick) if tick % 10 == 0 else flight.fly()
        path.append(flight.proxy_m)
    assert np.diff(path[20:]) == pytest.approx(5e-5, rel=1e-6)


def test_law_that_pumps_gives_the_hand_no_more_than_its_energy_and_power() -> None:
    ticks = 1500
    free = ProxyFlight(with_range(safety=generous()), mass_kg=0.2)
    bound = ProxyFlight(with_range(), mass_kg=0.2)
    found = []
    for flight in (free, bound):
        flight.velocity_m_per_s = 0.01
        before = flight.energy_j
        most = 0.0
        for _ in range(ticks):
            flight.aim(pump(flight))
            most = max(most, flight.energy_j - before)
        found.append(most)
    granted = SAFETY.proxy_energy_j + SAFETY.proxy_power_w * ticks / RATE_HZ
    assert found[0] > 2.0 * granted
    assert found[1] <= granted
    assert found[1] > 0.5 * SAFETY.proxy_energy_j


def test_energy_that_a_law_took_may_return_but_no_more_than_is_stored() -> None:
    """The hand loads the spring against the proxy, which gives way; then it comes back."""
    for stored_j, whole in ((1.0, True), (0.02, False)):
        safety = SafetyParams(proxy_energy_j=0.0, proxy_power_w=0.0, proxy_stored_j=stored_j)
        flight = ProxyFlight(with_range(1000.0, safety), mass_kg=1e6)
        flight.velocity_m_per_s = 0.05
        for _ in range(300):  # it gives way by half of the deflection
            flight.aim(0.5 * flight.position_m)
        taken_j = -flight.plan.proxy.energy_j
        assert taken_j == pytest.approx(min(stored_j, 0.5 * 1000.0 * 0.0075**2), rel=0.05)
        flight.velocity_m_per_s = 0.0
        back_m = flight.position_m - 0.0104  # 10.6 mm takes what was given
        flight.follow(lambda _, there=back_m: there, 300)
        assert held(flight) is not whole
        assert (flight.proxy_m == back_m) is whole


def test_only_the_holder_of_the_lease_moves_the_proxy() -> None:
    flight = ProxyFlight(with_range())
    flight.follow(lambda _: 0.005, 60)
    flight.aim(0.001, actor=OWNER + 1)
    assert flight.plan.proxy.target_m == 0.005
    flight.aim(0.01)
    flight.fly()
    there = flight.proxy_m
    flight.lease(OWNER + 1)  # taken over on the way
    flight.fly(20)
    assert flight.proxy_m == pytest.approx(there, abs=1e-3)
    stays = flight.proxy_m
    flight.follow(lambda _: 0.0, 50)
    assert held(flight)
    assert flight.proxy_m == stays
    flight.aim(0.0, actor=OWNER + 1)
    flight.fly(5)
    assert flight.proxy_m < stays


def test_proxy_without_a_lease_ends_when_the_spring_has_gone() -> None:
    flight = ProxyFlight(with_range())
    flight.follow(lambda _: 0.005, 60)
    flight.lease(0)
    flight.do(Command.SET, {Value.STIFFNESS: 0.0})
    flight.fly(60)
    assert flight.plan.proxy.owner == 0
    assert not held(flight)


@pytest.mark.parametrize("command", [Command.DISABLE, Command.STOP])
def test_end_of_force_ends_the_proxy_without_a_jump(command: Command) -> None:
    flight = ProxyFlight(with_range(), mass_kg=100.0)
    flight.follow(lambda _: 0.01, 20)
    there, force_n = flight.proxy_m, flight.out[8]
    assert force_n > 0.5
    flight.do(command)
    forces = []
    for _ in range(25):
        flight.aim(RANGE_M)  # the law goes on
        forces.append(flight.out[8])
        assert flight.proxy_m in (there, 0.0)
        assert flight.proxy_m == 0.0 or flight.blob["gain"] > 0.0
    assert max(forces) <= force_n
    assert forces[-1] == 0.0
    assert flight.plan.proxy.owner == 0
    if command is Command.STOP:
        assert flight.plan.state is State.STOPPED
        assert np.diff(forces).max() <= 0.0
        flight.do(Command.RESET)
    flight.do(Command.ENABLE)
    flight.fly(502)
    assert flight.out[4] == pytest.approx(-200.0 * flight.out[1])


def test_proxy_ends_in_the_tick_of_a_disable_that_an_enable_follows() -> None:
    flight = ProxyFlight(with_range())
    flight.follow(lambda _: 0.005, 60)
    both = [(1, int(kind), OWNER, 0, (0.0,) * 27) for kind in (Command.DISABLE, Command.ENABLE)]
    flight._one(tuple(both))
    assert flight.plan.state is State.ENABLED
    assert flight.plan.proxy.owner == 0


def test_unverified_signs_allow_no_proxy() -> None:
    params = replace(with_range(0.0), device=device_params(commissioning=True))
    flight = ProxyFlight(params)
    flight.follow(lambda _: 0.005, 5)
    assert flight.plan.proxy.owner == 0


def test_lost_frames_move_nothing() -> None:
    flight = ProxyFlight(with_range(safety=generous(proxy_speed_m_per_s=0.05)))
    flight.follow(lambda _: 0.02, 20)
    there = flight.proxy_m
    flight.fly(arrival=-1)
    assert flight.proxy_m == there
    flight.fly(arrival=1)
    assert flight.proxy_m == pytest.approx(there + 5e-5)


def test_moving_proxy_books_no_energy_of_ramps_and_pauses_none() -> None:
    params = with_range(safety=generous())
    params = replace(params, device=replace(params.device, ramp_energy_j=0.01))
    flight = ProxyFlight(params, mass_kg=100.0)
    flight.follow(lambda _: RANGE_M, 60)
    assert 0.5 * 200.0 * (flight.position_m - flight.proxy_m) ** 2 > 0.03
    assert not flight.plan.bookings or flight.plan.bookings[-1].energy_j < 0.001
    flight.do(Command.SET, {Value.STIFFNESS: 400.0, Value.RAMP_S: 0.05})
    flight.follow(lambda _: RANGE_M, 60)
    assert flight.blob["stiffness_n_per_m"] < 300.0  # its energy is that of the bent spring


def test_moving_proxy_gives_no_excess_of_energy() -> None:
    """The ledger of the fault `energy` counts what the display loses, not what a law gives."""
    flight = ProxyFlight(with_range(safety=generous()), mass_kg=0.2, damping_ns_per_m=1.0)
    flight.follow(lambda one: 0.01 * np.sin(6.28 * 2 * one.tick / RATE_HZ), 1000)
    assert flight.out[8] != 0.0
    assert flight.state[2][1] < 1e-4


def test_recording_with_a_proxy_replays_to_the_bit() -> None:
    board = board_params(lower_stop_m=-0.03, upper_stop_m=0.03)
    with RecordedFlight(servo_params(environment=with_range().environment), board) as flight:
        flight.fly(40)
        stack = flight.stack
        stack.do(Command.SET, {Value.LEASE_CONTROL: float(OWNER)})
        stack.do(Command.ENABLE)
        for number in range(50):
            target = 0.01 * np.sin(0.2 * number)
            stack.command(Command.PROXY, {Value.PROXY: target}, actor=OWNER)
            flight.fly(20)
        stack.do(Command.STOP)
        flight.fly(60)
        leg = flight.leg()
        assert np.ptp(leg.records["proxy_m"]) > 0.01
        assert leg.records["proxy_m"][-1] == 0.0
        assert replay.difference(leg.records, replay.replay(flight.params, leg)) is None
        without = leg._replace(requests=[o for o in leg.requests if o.kind != Command.PROXY])
        assert replay.difference(leg.records, replay.replay(flight.params, without)) is not None


def test_ledger_books_the_motion_of_the_proxy_apart_from_the_spring() -> None:
    params = servo_params(environment=with_range().environment)
    board = board_params(lower_stop_m=-0.03, upper_stop_m=0.03, viscous_ns_per_m=2.0)
    with LockStep(params, board) as stack:
        stack.run(5)
        stack.do(Command.SET, {Value.LEASE_CONTROL: float(OWNER)})
        stack.do(Command.ENABLE)
        stack.run(510)
        for number in range(40):
            target = 0.01 * np.sin(0.15 * number)
            stack.command(Command.PROXY, {Value.PROXY: target}, actor=OWNER)
            stack.run(10)
        records = as_records(b"".join(stack.blocks))
        rows = np.flatnonzero(records["flags"] & Flag.MISSING_IN == 0)
        table = samples(records, rows, params)
    booked, _ = book(table, 1.0 / RATE_HZ)
    bent_m = records["position_m"][rows] - records["proxy_m"][rows]
    stiffness = records["gain"][rows] * records["stiffness_n_per_m"][rows]
    stored_j = 0.5 * stiffness * bent_m**2
    assert stored_j.max() > 1e-5
    assert np.cumsum(booked["stiffness"]) == pytest.approx(stored_j[0] - stored_j, abs=1e-9)
    given_j = table["stiffness_n"][1:] + table["stiffness_n"][:-1]
    given_j = 0.5 * given_j * np.diff(records["proxy_m"][rows])
    assert booked["ramp"][600:].sum() == pytest.approx(given_j[599:].sum(), abs=1e-9)
    spring_j = 0.5 * (table["stiffness_n"][1:] + table["stiffness_n"][:-1])
    spring_j = spring_j * np.diff(table["position_m"])
    both_j = (booked["stiffness"] + booked["ramp"])[1:]
    assert both_j == pytest.approx(spring_j, abs=1e-12)


def test_checkpoint_contains_the_proxy() -> None:
    flight = ProxyFlight(with_range())
    flight.follow(lambda _: 0.005, 20)
    assert unflatten(flatten(flight.state)) == flight.state


def doubting() -> ServoParams:
    """A servo that doubts samples, with a slow proxy."""
    params = with_range(safety=generous(proxy_speed_m_per_s=0.05))
    device = replace(params.device, acceleration_limit_m_per_s2=500.0)
    return replace(params, device=device)


def ends_by(flight: ProxyFlight, way: str) -> None:
    """End the proxy, and make the same environment again with the proxy at 0."""
    if way == "disable":
        flight.do(Command.DISABLE)
        flight.do(Command.ENABLE)
        flight.fly(502)
        return
    flight.lease(0)
    flight.do(Command.SET, {Value.STIFFNESS: 0.0, Value.RAMP_S: 0.0})
    flight.fly(60)
    flight.lease(OWNER)
    flight.do(Command.SET, {Value.STIFFNESS: 1000.0, Value.RAMP_S: 0.0})


@pytest.mark.parametrize("way", ["disable", "lease"])
def test_proxy_that_begins_again_has_no_more_energy_than_before(way: str) -> None:
    flight = ProxyFlight(with_range(1000.0, SafetyParams(proxy_power_w=0.0)), mass_kg=1e6)
    flight.follow(lambda _: 0.0135, 100)
    assert not held(flight)
    limit_n = flight.params.force_limit_n
    used_j = spring_energy(1000.0, flight.proxy_m, limit_n)
    assert used_j > 0.07
    ends_by(flight, way)
    assert flight.plan.proxy.owner == 0
    assert flight.proxy_m == 0.0
    flight.follow(lambda _: 0.0135, 100)
    assert held(flight)
    assert used_j + spring_energy(1000.0, flight.proxy_m, limit_n) <= SAFETY.proxy_energy_j


def test_store_is_not_charged_by_a_rise_of_the_stiffness() -> None:
    """A rise ends the credit from before it. What the law takes after it counts in full."""
    safety = SafetyParams(proxy_energy_j=0.1, proxy_power_w=0.0)
    flight = ProxyFlight(with_range(200.0, safety), mass_kg=1e6)
    flight.follow(lambda _: 0.01, 60)
    flight.do(Command.SET, {Value.STIFFNESS: 1000.0, Value.RAMP_S: 0.02})
    flight.follow(lambda _: 0.01, 100)
    flight.follow(lambda _: 0.0, 100)  # takes 0.05 J
    assert flight.plan.proxy.energy_j < -0.03
    flight.do(Command.SET, {Value.STIFFNESS: 200.0, Value.RAMP_S: 0.02})
    flight.follow(lambda _: 0.01, 100)  # gives 0.01 J
    flight.do(Command.SET, {Value.STIFFNESS: 1000.0, Value.RAMP_S: 0.02})
    flight.fly()
    assert flight.plan.proxy.energy_j == 0.0


def test_sample_that_is_not_believed_moves_nothing() -> None:
    flight = ProxyFlight(doubting(), mass_kg=1e6)
    flight.follow(lambda _: 0.02, 20)
    there = flight.proxy_m
    flight.fly(encoder=round(0.004 / COUNT_M))
    assert flight.out[9] & Flag.DOUBTED
    assert flight.proxy_m == there
    flight.fly()
    assert flight.out[9] & Flag.GLITCH
    assert flight.proxy_m == pytest.approx(there + 5e-5)


def test_tick_that_is_repeated_after_a_glitch_moves_the_proxy_once() -> None:
    flight = ProxyFlight(doubting(), mass_kg=1e6)
    flight.follow(lambda _: 0.02, 20)
    bend_m = believed_bend_m(flight.params)
    flight.fly(encoder=round(0.9 * bend_m / COUNT_M))  # too small to be doubted
    assert not flight.out[9] & Flag.DOUBTED
    there = flight.proxy_m
    flight.fly()
    assert flight.out[9] & Flag.GLITCH
    assert flight.proxy_m == pytest.approx(there + 5e-5)


def test_ramp_and_proxy_together_step_the_force_as_the_device_file_allows() -> None:
    flight = ProxyFlight(with_range(500.0, generous()), mass_kg=1e6)
    forces = []
    for tick in range(40):
        if tick == 3:
            stiffer = {Value.STIFFNESS: 1000.0, Value.RAMP_S: 0.0}
            law = (1, int(Command.PROXY), OWNER, 0, masked({Value.PROXY: RANGE_M}))
            flight._one(((2, int(Command.SET), OWNER, 0, masked(stiffer)), law))
        else:
            flight.aim(RANGE_M)
        forces.append(flight.out[8])
    step_n = flight.params.device.force_step_n
    assert flight.blob["stiffness_n_per_m"] == 1000.0
    assert max(abs(np.diff(forces))) <= step_n + 1e-3
    assert flight.proxy_m > 0.01


def test_two_positions_in_one_tick_keep_the_interval_of_the_law() -> None:
    flight = ProxyFlight(with_range(safety=generous()))
    path = []
    for tick in range(200):
        if tick % 10:
            flight.fly()
        else:
            one, other = (masked({Value.PROXY: 5e-5 * tick - late}) for late in (1e-6, 0.0))
            kind = int(Command.PROXY)
            flight._one(((1, kind, OWNER, 0, one), (2, kind, OWNER, 0, other)))
        path.append(flight.proxy_m)
    assert np.diff(path[20:]) == pytest.approx(5e-5, rel=1e-6)


@pytest.mark.parametrize("direction", [-1.0, 1.0])
def test_lost_frames_give_no_excess_of_energy_beside_a_proxy(direction: float) -> None:
    flight = ProxyFlight(with_range(safety=generous()), mass_kg=100.0, damping_ns_per_m=1.0)
    flight.follow(lambda _: direction * 0.01, 100)
    flight.velocity_m_per_s = direction * 0.1
    for _ in range(20):
        flight.fly(3)
        flight.fly(arrival=-1)
        flight.fly(arrival=1)
    assert flight.out[9] & Flag.INTERPOLATED
    assert flight.state[2][1] < 1e-5
