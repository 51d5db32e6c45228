"""A scene for the whole stack: the parameters of a servo and of the simulated board that it is
played on, for lock-step runs.
"""

from pathlib import Path

from hapticd.params import BoardParams, RealtimeParams, SafetyParams, ServoParams, UsbParams
from hapticd.plant.compose import compose
from hapticd.plant.effects import sample_timing
from hapticd.settings.build import board_of, device_params
from hapticd.settings.scene import build_scene, load_files

AT_ONCE_NS_PER_M_S = 1e6  # damping steps of a scene are steps


def scene_params(
    name: str | Path, instance: str = "scene", seed: int = 1
) -> tuple[ServoParams, BoardParams]:
    """(servo, board) that play the scene `name` at its rate and with its delay. ConfigError as
    `load_scene` and `compose`.

    The servo renders the scene's environment once it is enabled; damping steps and excitation are
    commands, which the caller gives when their time has come. Converters of the wire quantise
    whether or not the scene asks for it.
    """
    files = load_files(name)
    device = files.device
    scene = build_scene(files)
    model = compose(scene)
    phase, lag_periods = sample_timing(model.delay_periods)
    levels = tuple(step.level_ns_per_m for step in scene.damping)
    board = board_of(
        device,
        scene.rate_hz,
        scene.effects,
        levels,
        sample_phase=phase,
        lag_periods=lag_periods,
        seed=seed,
    )
    limit_n = model.force_limit_n or device.limits.force_n
    servo = ServoParams(
        instance=instance,
        simulated=True,
        environment=scene.environment,
        device=device_params(device),
        safety=SafetyParams(force_limit_n=limit_n, damping_slew_ns_per_m_s=AT_ONCE_NS_PER_M_S),
        realtime=RealtimeParams(rate_hz=scene.rate_hz, mode="off"),
        usb=UsbParams(serial=device.serial),
        added_damping_ns_per_m=max(levels),
    )
    return servo, board
