"""The simulated board's resistance DAC: what the circuit believes in, and who may move it."""

from dataclasses import replace

import pytest
from support.boards import ENABLE, TICK_NS, exchange, out_packet
from support.boards import board_params as rigid_board
from support.plant_devices import N_PER_A, alpha, weir_device

from hapticd.model.compose import board_fields
from hapticd.model.effects import Coulomb, WindingHeating, WindingTemperature
from hapticd.model.params import BoardParams
from hapticd.sim.axis import Axis
from hapticd.sim.board import BoardModel, hello
from hapticd.usb.frames import Capability

LEVEL = 5.0  # N s/m
COUNT = round(LEVEL / 10.0 * 65535)
FULL_OHM = 0.8
FORCE_N = 2.0
TORQUE = round(FORCE_N / 8.0 * 32767)


def stuck(celsius: float, **changes: object) -> BoardParams:
    """A board whose rotor does not move and whose winding keeps its temperature: the motor's force
    is alpha times the commanded one. At count 0 it compensates 20 degC.
    """
    model = weir_device(
        "amplifier",
        "damping_circuit",
        coulomb=Coulomb(rotor_n=10.0),
        heating=WindingHeating(
            thermal_resistance_k_per_w=0.0, time_constant_s=1e3, ambient_c=celsius
        ),
        winding=WindingTemperature(temperature_c=celsius, compensated_c=20.0),
    )
    fields = board_fields(model, [LEVEL], 10.0, FULL_OHM)
    return rigid_board(**{**fields, "trim_full_scale_ohm": FULL_OHM, **changes})


def motor_force(axis: Axis) -> float:
    return axis.plant.motor_force(axis.state, axis.force_n, axis.damping_n)


def settled(axis: Axis, count: int) -> float:
    """The motor's force, 20 ms after an OUT with this count."""
    axis.obey(ENABLE, TORQUE, COUNT, (), 0, count)
    axis.run_to(axis.now + 16 * 20)
    return motor_force(axis)


@pytest.mark.parametrize("celsius", [20.0, 50.0, 80.0])
@pytest.mark.parametrize("trim_ohm", [0.0, 0.1, 0.3])
@pytest.mark.parametrize("sign", [1, -1])
def test_count_moves_what_the_circuit_believes_in(celsius, trim_ohm, sign):
    """Closed form: alpha = 1 / (1 + g dR / K^2) with dR = R(T) - R(20 degC) - trim."""
    axis = Axis(stuck(celsius, trim_full_scale_ohm=sign * FULL_OHM))
    force_n = settled(axis, round(sign * trim_ohm / FULL_OHM * 32767))
    residual_ohm = 1.6 * 0.00393 * (celsius - 20.0) - trim_ohm
    expected = TORQUE * 8.0 / 32767 * alpha(LEVEL, residual_ohm, N_PER_A)
    assert force_n == pytest.approx(expected, rel=3e-4)


def test_count_is_held_by_the_watchdog_and_lost_with_the_supply():
    axis = Axis(stuck(80.0, watchdog_ms=20.0))
    settled(axis, 12_000)
    axis.run_to(16 * 100)
    assert axis.force_n == 0.0
    assert axis.resistance_count == 12_000
    axis.power_up()
    assert axis.resistance_count == 0
    weak = settled(axis, 0)
    residual_ohm = 1.6 * 0.00393 * 60.0
    assert weak == pytest.approx(FORCE_N * alpha(LEVEL, residual_ohm, N_PER_A), rel=3e-4)


def test_board_tells_whether_its_resistance_dac_is_connected():
    board = stuck(20.0)
    no_winding = rigid_board(trim_full_scale_ohm=FULL_OHM)
    for params, told in (
        (board, True),
        (replace(board, lacks=("resistance",)), False),
        (replace(board, trim_full_scale_ohm=0.0), False),
        (no_winding, False),
    ):
        assert bool(hello(params).capabilities & Capability.RESISTANCE) is told


@pytest.mark.parametrize("lacks", [(), ("resistance",)])
def test_count_reaches_the_circuit_by_the_wire_where_the_dac_is_connected(lacks):
    board = BoardModel(stuck(80.0, lacks=lacks))
    for tick in range(30):
        frame = exchange(board, tick, flags=ENABLE, torque=TORQUE, damping=COUNT, resistance=12_000)
    trim_ohm = 0.0 if lacks else 12_000 / 32767 * FULL_OHM
    expected_n = FORCE_N * alpha(LEVEL, 1.6 * 0.00393 * 60.0 - trim_ohm, N_PER_A)
    assert frame.current * 10.0 / 32767 * N_PER_A == pytest.approx(expected_n, rel=1e-3)


@pytest.mark.parametrize("resistance", [0, 12_000])
def test_voltage_is_that_of_the_winding_as_hot_as_it_is(resistance):
    """V = R(T) i of a rotor that stands, whatever the circuit believes of R."""
    board = BoardModel(stuck(80.0))
    for tick in range(30):
        frame = exchange(
            board, tick, flags=ENABLE, torque=TORQUE, damping=COUNT, resistance=resistance
        )
    ampere = frame.current * 10.0 / 32767
    assert frame.voltage * 30.0 / 32767 == pytest.approx(
        1.6 * (1.0 + 0.00393 * 60.0) * ampere, rel=2e-3
    )


def test_refused_out_leaves_the_count():
    board = BoardModel(stuck(80.0))
    exchange(board, 0, flags=ENABLE, torque=TORQUE, damping=COUNT, resistance=12_000)
    broken = bytearray(out_packet(1, flags=ENABLE, resistance=32_767))
    broken[-1] ^= 1
    board.on_out(memoryview(broken), TICK_NS)
    assert board._axis.resistance_count == 12_000
