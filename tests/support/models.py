"""Parameter sets that tests share: the simulated device of config/devices/simulated.toml in
plain values.
"""

import dataclasses
from typing import Any

from hapticd.core.environment import Environment
from hapticd.core.params import (
    DeviceParams,
    RealtimeParams,
    SafetyParams,
    ScaleParams,
    ServoParams,
    UsbParams,
)
from hapticd.render.law import LawInputs
from support.boards import BOARD

COUNT_M = BOARD.position_m_per_count
COUNT_N = BOARD.force_n_per_count
COUNT_NS_PER_M = BOARD.active_damping_ns_per_m_per_count


def device_params(**changes: Any) -> DeviceParams:
    base = DeviceParams(
        name="simulated",
        serial="SIM0001",
        position=ScaleParams(COUNT_M),
        force=ScaleParams(COUNT_N),
        active_damping=ScaleParams(COUNT_NS_PER_M),
        probe_torque=ScaleParams(BOARD.probe_torque_n_per_count),
        probe_velocity=ScaleParams(BOARD.probe_velocity_m_per_s_per_count),
        current=ScaleParams(BOARD.current_a_per_count),
        voltage=ScaleParams(BOARD.voltage_v_per_count),
        emf_velocity=ScaleParams(1.0 / 32767),
        temperature=ScaleParams(0.01),
        force_limit_n=8.0,
        active_damping_limit_ns_per_m=10.0,
        probe_limit_n=1.0,
        temperature_limit_c=120.0,
        speed_limit_m_per_s=20.0,
        force_step_n=1.0,
    )
    return dataclasses.replace(base, **changes)


def servo_params(**changes: Any) -> ServoParams:
    base = ServoParams(
        instance="test",
        simulated=True,
        environment=Environment(),
        device=device_params(),
        safety=SafetyParams(),
        realtime=RealtimeParams(mode="off"),
        usb=UsbParams(),
        config_hash="0" * 64,
    )
    return dataclasses.replace(base, **changes)


def environment_tuple(params: Environment, limit_n: float) -> LawInputs:
    """Return `params` as the law takes them, without bias."""
    wall = params.wall
    ends = params.workspace
    kbm = (params.stiffness_n_per_m, params.virtual_damping_ns_per_m, params.mass_kg)
    solid = (
        wall.stiffness_n_per_m,
        wall.virtual_damping_ns_per_m,
        wall.position_m,
        float(wall.side),
    )
    return (
        *kbm,
        0.0,
        limit_n,
        *solid,
        ends.lower_m,
        ends.upper_m,
        ends.stiffness_n_per_m,
        *params.further,
    )
