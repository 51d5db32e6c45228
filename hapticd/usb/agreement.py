"""Compare the hello of a board with its device file.

The hello reply contains nominal full scales, limits and capabilities. The device file contains the
calibrated ones, from which everything else is computed. A board of another range, or another board,
differs by far more than a calibration corrects, and every computed force would be wrong. Allowed
differences:

    a scale that was typed in     a tenth
    a scale that was measured     (by `hapticd rig`, on this board) a factor of MOST_CORRECTION:
                                  nominal scales are estimates of the firmware's author, and a wrong
                                  unit or range is a factor of at least 2
    the force limit               the same, but never more than a tenth upwards: the board clamps
                                  counts, so with a motor of 0.8 its 8 N are 6.4 N
    serial number                 none
    capabilities                  those required by the file must be present
    firmware                      the one with which the signs were verified; another may have other
                                  signs, which must be verified again

NaN never agrees. The rate must also be high enough for the board's samples (`probe_shortage`).

Limitations: a scale that the hello reply does not contain (back-EMF velocity, temperature); a
nominal scale that is wrong by the same factor as a mistyped mass of a step.
"""

from math import ceil
from typing import NamedTuple

from hapticd.core.params import MOST_CORRECTION, DeviceParams, ScaleParams
from hapticd.core.units import PROBE_RATE_HZ
from hapticd.usb.codec import I16_HIGHEST, U16_HIGHEST
from hapticd.usb.frames import PAIR_MAX, Capability, HelloFrame

__all__ = ["differences", "probe_shortage"]

TOLERANCE = 0.1  # of the device file's number, if it was not measured


class Range(NamedTuple):
    """The allowed ratio of the board's number to the device file's."""

    lowest: float
    highest: float


TYPED = Range(1.0 - TOLERANCE, 1.0 + TOLERANCE)
MEASURED = Range(1.0 / MOST_CORRECTION, MOST_CORRECTION)


class Stated(NamedTuple):
    """One number in both sources, in `unit`."""

    name: str
    by_board: float
    by_file: float
    unit: str
    allowed: Range


def differences(hello: HelloFrame, device: DeviceParams) -> tuple[str, ...]:
    """Return one phrase for each contradiction between a board and its device file; () if they
    agree.
    """
    numbers = tuple(
        f"{one.name}: the board says {one.by_board:.6g} {one.unit}, the device file"
        f" {one.by_file:.6g} {one.unit}"
        for one in _stated(hello, device)
        if not _agree(one)
    )
    missing = tuple(
        f"capability {name}: the device file relies on it, the board does not have it"
        for name in _relied_on(device)
        if not hello.capabilities & Capability[name.upper()]
    )
    return _serials(hello, device) + _firmware(hello, device) + numbers + missing


def probe_shortage(rate_hz: float) -> str:
    """Return why one frame per tick cannot carry all samples of probe and perturbation; empty if it
    can.
    """
    samples = PROBE_RATE_HZ / rate_hz
    if samples <= PAIR_MAX:
        return ""
    least_hz = ceil(PROBE_RATE_HZ / PAIR_MAX)
    return (
        f"at {rate_hz:g} Hz a frame carries {PAIR_MAX} of {samples:.3g} samples of probe"
        f" and perturbation, the others are lost; set realtime.rate_hz to at least {least_hz} Hz"
    )


def _serials(hello: HelloFrame, device: DeviceParams) -> tuple[str, ...]:
    if hello.serial == device.serial:
        return ()
    return (f"serial: the board says {hello.serial!r}, the device file {device.serial!r}",)


def _firmware(hello: HelloFrame, device: DeviceParams) -> tuple[str, ...]:
    if device.signs_firmware in ("", hello.firmware):
        return ()
    return (
        f"firmware: the board has {hello.firmware}, its signs were verified with"
        f" {device.signs_firmware}; set commissioning.signs_verified = false in the device file,"
        " start again, and verify them with `hapticd rig motor`",
    )


def _agree(one: Stated) -> bool:
    return one.allowed.lowest * one.by_file <= one.by_board <= one.allowed.highest * one.by_file


def _stated(hello: HelloFrame, device: DeviceParams) -> tuple[Stated, ...]:
    def scale(name: str, by_board: float, own: ScaleParams, unit: str, full: int) -> Stated:
        allowed = MEASURED if own.measured else TYPED
        return Stated(name, by_board, own.per_count * full, unit, allowed)

    force = scale("force full scale", hello.force_full_scale_n, device.force, "N", I16_HIGHEST)
    return (
        force,
        scale(
            "damping full scale",
            hello.damping_full_scale_ns_per_m,
            device.active_damping,
            "N s/m",
            U16_HIGHEST,
        ),
        scale(
            "probe torque full scale",
            hello.probe_torque_full_scale_n,
            device.probe_torque,
            "N",
            I16_HIGHEST,
        ),
        scale(
            "probe velocity full scale",
            hello.probe_velocity_full_scale_m_s,
            device.probe_velocity,
            "m/s",
            I16_HIGHEST,
        ),
        scale("current full scale", hello.current_full_scale_a, device.current, "A", I16_HIGHEST),
        scale("voltage full scale", hello.voltage_full_scale_v, device.voltage, "V", I16_HIGHEST),
        scale("position", hello.position_m_per_count, device.position, "m/count", 1),
        _limit(hello, device, force),
    )


def _limit(hello: HelloFrame, device: DeviceParams, force: Stated) -> Stated:
    """Return the limit at which the board clamps; with a measured motor, in newtons of the board's
    own scale.
    """
    own_n = device.force_limit_n
    if not device.force.measured:
        return Stated("force limit", hello.force_limit_n, own_n, "N", TYPED)
    allowed = Range(TYPED.lowest, MEASURED.highest)
    own_n *= force.by_board / force.by_file
    return Stated("force limit", hello.force_limit_n, own_n, "nominal N", allowed)


def _relied_on(device: DeviceParams) -> tuple[str, ...]:
    return device.relies_on + (("index",) if device.home.method == "index" else ())
