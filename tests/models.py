"""Parameter sets that tests share: the simulated device of config/devices/simulated.toml in plain values."""

import dataclasses
from typing import Any

from hapticd.params import (
    BoardParams,
    DeviceParams,
    EnvironmentParams,
    RealtimeParams,
    SafetyParams,
    ScaleParams,
    ServoParams,
    UsbParams,
)

MICROMETRE = 1e-6
COUNT_M = 0.5 * MICROMETRE
COUNT_N = 8.0 / 32767
COUNT_NS_PER_M = 10.0 / 65535


def device_params(**changes: Any) -> DeviceParams:
    base = DeviceParams(
        name="simulated", serial="SIM0001", position=ScaleParams(COUNT_M), force=ScaleParams(COUNT_N),
        damping=ScaleParams(COUNT_NS_PER_M), probe_torque=ScaleParams(1.0 / 32767), probe_velocity=ScaleParams(0.5 / 32767),
        current=ScaleParams(10.0 / 32767), voltage=ScaleParams(24.0 / 32767), emf_velocity=ScaleParams(1.0 / 32767),
        temperature=ScaleParams(0.01), force_limit_n=8.0, damping_limit_ns_per_m=10.0, probe_limit_n=1.0,
        temperature_limit_c=120.0, speed_limit_m_per_s=20.0,
    )  # fmt: skip
    return dataclasses.replace(base, **changes)


def servo_params(**changes: Any) -> ServoParams:
    base = ServoParams(
        instance="test", simulated=True, environment=EnvironmentParams(), device=device_params(), safety=SafetyParams(),
        realtime=RealtimeParams(mode="off"), usb=UsbParams(), config_hash="0" * 64,
    )  # fmt: skip
    return dataclasses.replace(base, **changes)


def board_params(**changes: Any) -> BoardParams:
    base = BoardParams(
        serial="SIM0001", rate_hz=1000.0, position_m_per_count=COUNT_M, force_n_per_count=COUNT_N,
        damping_ns_per_m_per_count=COUNT_NS_PER_M, probe_torque_n_per_count=1.0 / 32767,
        probe_velocity_m_per_s_per_count=0.5 / 32767, current_a_per_count=10.0 / 32767, voltage_v_per_count=24.0 / 32767,
        force_limit_n=8.0, mass_kg=0.008, viscous_ns_per_m=0.36, lower_stop_m=-1.0, upper_stop_m=1.0,
        torque_constant_n_per_a=1.65, winding_ohm=1.6, ambient_c=25.0,
    )  # fmt: skip
    return dataclasses.replace(base, **changes)
