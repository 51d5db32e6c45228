"""What a board says of itself against what its device file says.

The hello reply carries nominal full scales, limits and capabilities; the device file carries the
calibrated ones, and everything else is computed from those. A calibration corrects a nominal scale
by some per cent. A board of another range, or another board altogether, is off by far more, and
every newton that the servo computes for it is wrong. So numbers may differ by a tenth, a serial
number not at all, and a capability that the file relies on has to be there. NaN never agrees.

What would break it: a scale of the wire that the hello reply does not carry (back-EMF velocity,
temperature).
"""

from typing import NamedTuple

from hapticd.params import DeviceParams
from hapticd.wire.codec import I16_HIGHEST, U16_HIGHEST
from hapticd.wire.frames import Capability, HelloFrame

TOLERANCE = 0.1  # of the device file's number


class Stated(NamedTuple):
    """One number as both state it, in `unit`."""

    name: str
    by_board: float
    by_file: float
    unit: str


def differences(hello: HelloFrame, device: DeviceParams) -> tuple[str, ...]:
    """One phrase for each contradiction between a board and its device file; () if they agree."""
    numbers = tuple(
        f"{name}: the board says {by_board:.6g} {unit}, the device file {by_file:.6g} {unit}"
        for name, by_board, by_file, unit in _stated(hello, device)
        if not abs(by_board - by_file) <= TOLERANCE * by_file
    )
    missing = tuple(
        f"capability {name}: the device file relies on it, the board does not have it"
        for name in _relied_on(device)
        if not hello.capabilities & Capability[name.upper()]
    )
    return _serials(hello, device) + numbers + missing


def _serials(hello: HelloFrame, device: DeviceParams) -> tuple[str, ...]:
    if hello.serial == device.serial:
        return ()
    return (f"serial: the board says {hello.serial!r}, the device file {device.serial!r}",)


def _stated(hello: HelloFrame, device: DeviceParams) -> tuple[Stated, ...]:
    def full(per_count: float) -> float:
        return per_count * I16_HIGHEST

    speed = full(device.probe_velocity.per_count)
    damping = device.damping.per_count * U16_HIGHEST
    return (
        Stated("force full scale", hello.force_full_scale_n, full(device.force.per_count), "N"),
        Stated("damping full scale", hello.damping_full_scale_ns_per_m, damping, "N s/m"),
        Stated(
            "probe torque full scale",
            hello.probe_torque_full_scale_n,
            full(device.probe_torque.per_count),
            "N",
        ),
        Stated("probe velocity full scale", hello.probe_velocity_full_scale_m_s, speed, "m/s"),
        Stated(
            "current full scale", hello.current_full_scale_a, full(device.current.per_count), "A"
        ),
        Stated(
            "voltage full scale", hello.voltage_full_scale_v, full(device.voltage.per_count), "V"
        ),
        Stated("position", hello.position_m_per_count, device.position.per_count, "m/count"),
        Stated("force limit", hello.force_limit_n, device.force_limit_n, "N"),
    )


def _relied_on(device: DeviceParams) -> tuple[str, ...]:
    return device.relies_on + (("index",) if device.home.method == "index" else ())
