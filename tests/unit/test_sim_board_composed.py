"""The fake board with a composed device: what its frames say of it, transport delay, and a
plant that runs away.
"""

import pytest
from support.boards import ENABLE, LATCH_NS, PERTURB, TICK_NS, board_params, exchange, out_packet
from support.plant_devices import FULL, weir_device

from hapticd.model.compose import board_fields
from hapticd.model.discrete import discretise
from hapticd.model.effects import (
    AntiAlias,
    SensorNoise,
    VelocityHighpass,
    WindingHeating,
    WindingTemperature,
    WorkspaceEnds,
)
from hapticd.model.model import Model
from hapticd.sim.axis import Axis, Probe
from hapticd.sim.board import BoardModel
from hapticd.usb.frames import StatusBit

LINEAR = ("probe", "coupling", "viscous", "smoothing", "amplifier", "damping_circuit")


def board_of(model: Model, **changes):
    return board_params(**{**board_fields(model, (1.74,), 10.0), **changes})


def test_frames_tell_slider_current_and_estimate():
    model = weir_device(*LINEAR)
    params = board_of(model)
    board = BoardModel(params)
    frame = exchange(board, 0, flags=ENABLE, torque=20000, damping=65535)
    step = discretise(model, LATCH_NS * 1e-9, 65535 * params.active_damping_ns_per_m_per_count)
    force = 20000 * params.force_n_per_count
    x = dict(
        zip(
            (state.name for state in model.states),
            step.b[:, model.inputs.command] * force,
            strict=True,
        )
    )
    assert frame.encoder == round(x["slider_position"] / params.position_m_per_count)
    assert frame.current * params.current_a_per_count == pytest.approx(
        x["motor_force"] / 1.65, abs=params.current_a_per_count
    )
    assert frame.emf_velocity * params.emf_velocity_m_per_s_per_count == pytest.approx(
        x["velocity_estimate"], abs=1e-4
    )
    volts = 1.6 * x["motor_force"] / 1.65 + 1.65 * x["velocity_estimate"]
    assert frame.voltage * params.voltage_v_per_count == pytest.approx(volts, abs=1e-3)


@pytest.mark.parametrize(("phase", "lag"), [(0.5625, 1), (0.875, 0), (0.875, 3)])
def test_torque_takes_effect_after_its_lag(phase, lag):
    """The device of physics with 1.4375 periods of delay latches at 0.5625 T and lags one
    period.
    """
    axis = Axis(board_of(weir_device("probe"), sample_phase=phase, lag_periods=lag))
    axis.obey(ENABLE, 1000, 0, ())
    axis.run_to(16 * lag)
    assert axis.state == (0.0, 0.0)
    axis.run_to(16 * lag + 1)
    assert axis.state[1] == pytest.approx(1000 * 8.0 / 32767 / 0.008 * 1e-3 / 16)


def test_torque_on_its_way_is_cut_with_the_rest():
    axis = Axis(board_of(weir_device("probe"), lag_periods=1))
    axis.obey(ENABLE, 1000, 0, ())
    axis.run_to(8)
    axis.obey(0, 0, 0, ())
    axis.run_to(100)
    assert axis.state == (0.0, 0.0)


def test_torques_on_their_way_keep_their_order():
    axis = Axis(board_of(weir_device("probe", "viscous"), lag_periods=2))
    seen = []
    for tick in range(5):
        axis.obey(ENABLE, 100 * (tick + 1), 0, ())
        axis.run_to(16 * (tick + 1))
        seen.append(round(axis.force_n * 32767 / 8.0))
    assert seen == [0, 100, 200, 300, 400]  # each at the end of the second tick after its own


def test_record_is_the_filtered_channel():
    """A step of torque on a free mass: high-passed velocity, and both channels through the same
    low-pass.
    """
    model = weir_device(
        "probe", highpass=VelocityHighpass(corner_hz=0.1), alias=AntiAlias(corner_hz=1000.0)
    )
    params = board_of(model, probe_velocity_m_per_s_per_count=1e-5, probe_torque_n_per_count=1e-5)
    axis = Axis(params)
    h = 1e-3 / 16
    axis.obey(ENABLE | PERTURB, 0, 0, (5000,) * 12)
    axis.run_to(48)
    step = discretise(model, h)
    u = [0.0, 0.0]
    x = None
    found = []
    x = step.b[:, 0] * 0.0
    for interval in range(12):
        u[1] = 5000 * 1e-5 if interval else 0.0
        before = model.outputs.recorded_travel.row() @ x
        kept = model.outputs.recorded_impulse.row() @ x
        for _ in range(4):
            x = step.a @ x + step.b @ u
        found.append((model.outputs.recorded_impulse.row() @ x - kept) / 250e-6 + u[1])
        found.append((model.outputs.recorded_travel.row() @ x - before) / 250e-6)
    assert axis.probe.pairs == pytest.approx([value / 1e-5 for value in found], abs=0.51)
    assert axis.probe.pairs[2] < 4000  # the low-pass holds some of the first torque back


def test_noise_of_the_velocity_channel_is_seeded():
    params = board_of(
        weir_device("probe", noise=SensorNoise(velocity_m_per_s=1e-3)),
        probe_velocity_m_per_s_per_count=1e-6,
    )

    def record(seed):
        axis = Axis(
            board_of(weir_device("probe", noise=SensorNoise(velocity_m_per_s=1e-3)), seed=seed)
        )
        axis.run_to(4 * 60)
        return axis.probe.pairs[1::2]

    assert record(1) == record(1) != record(2)
    probe = Probe(params)
    for _ in range(4000):
        probe.end_interval(0.0)
        probe.forget(probe.index - 60)
    kept = probe.pairs[1::2]
    assert 0.5e3 < (sum(v * v for v in kept) / len(kept)) ** 0.5 < 2e3


def test_frames_tell_a_winding_that_warms_up():
    heating = WindingHeating(thermal_resistance_k_per_w=50.0, time_constant_s=0.05, ambient_c=20.0)
    cold = WindingTemperature(temperature_c=20.0, compensated_c=20.0)
    board = BoardModel(
        board_of(weir_device("probe", "amplifier", "coulomb", winding=cold, heating=heating))
    )
    first = exchange(board, 0, flags=ENABLE, torque=32767)
    for tick in range(1, 5):
        last = exchange(board, tick, flags=ENABLE, torque=32767 * (-1) ** tick)
    assert first.temperature < last.temperature
    assert 2000 < first.temperature < 12000


def test_a_runaway_is_a_fault_not_a_nan():
    axis = Axis(board_of(weir_device("probe"), force_n_per_count=10.0, force_limit_n=1e9))
    axis.obey(ENABLE, 32767, 0, ())
    axis.run_to(16 * 200)
    assert axis.diverged_at is not None
    assert axis.status == StatusBit.AMPLIFIER_FAULT
    assert axis.force_n == 0.0
    assert axis.state[1] == 0.0
    axis.clear_faults()
    assert axis.status == 0


def test_power_up_rests_where_it_stood():
    axis = Axis(board_of(weir_device(*FULL)))
    axis.obey(ENABLE, 20000, 0, ())
    axis.run_to(160)
    where = axis.plant.encoder(axis.state, 0.0, 0.0)
    axis.power_up()
    assert axis.zero_m == where > 0.0
    assert axis.state == (where, 0.0, where, 0.0, 0.0, 0.0, 0.0)


def test_ends_stop_the_slider_on_the_board():
    board = BoardModel(
        board_of(
            weir_device(*LINEAR, ends=WorkspaceEnds(lower_m=-0.001, upper_m=0.001)),
            force_limit_n=8.0,
        )
    )
    for tick in range(40):
        frame = exchange(board, tick, flags=ENABLE, torque=20000)
    assert frame.encoder == 2000
    board.on_out(out_packet(40, flags=ENABLE, torque=-20000), 40 * TICK_NS)
    for tick in range(41, 60):
        frame = exchange(board, tick, flags=ENABLE, torque=-20000)
    assert frame.encoder == -2000
