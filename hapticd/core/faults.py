"""Every reason for which the servo leaves `enabled` by itself: one table of code, cause, action and
remedy.

Every tick record and state message contains the number; users and scripts read the code. Numbers
are never reused. `stop` is not a failure but a latched stop from any client. It is in the table so
that one field shows why the force is off.
"""

from typing import NamedTuple

__all__ = ["BY_CODE", "BY_NUMBER", "FAULTS", "Fault"]


class Fault(NamedTuple):
    """One row: `number` on the wire, `code` for users, then sentences."""

    number: int
    code: str
    cause: str
    action: str
    remedy: str


_TO_SAFE = "force to 0 in 20 ms, damping held at least at the safe level for 2 s, then released"

FAULTS: tuple[Fault, ...] = (
    Fault(0, "none", "nothing is wrong", "none", "none"),
    Fault(
        1,
        "stop",
        "a stop was requested",
        _TO_SAFE,
        "make sure it is safe, then `hapticd reset`",
    ),
    Fault(
        2,
        "gateway_lost",
        "the gateway stopped sending its heartbeat",
        _TO_SAFE,
        "reset; if it happens again the computer is too busy, see `hapticd doctor`",
    ),
    Fault(
        3,
        "usb_lost",
        "the board was unplugged or its link failed",
        _TO_SAFE,
        "plug it in, reset, home or zero again",
    ),
    Fault(
        4,
        "frames_lost",
        "too many frames in a row were missing, bad or older than the last one sent",
        _TO_SAFE,
        "check cable, hub and other devices on the bus, then reset",
    ),
    Fault(
        5,
        "lost_slots",
        "the host missed too many ticks in a second",
        _TO_SAFE,
        "reduce the load of the computer (see `status`), reset",
    ),
    Fault(
        6,
        "not_finite",
        "the law produced NaN or infinity",
        _TO_SAFE,
        "check the parameters that were set, then reset",
    ),
    Fault(
        7,
        "board_watchdog",
        "the board received nothing in time and stopped",
        _TO_SAFE,
        "look for host pauses, then reset",
    ),
    Fault(
        8,
        "board_fault",
        "the board reports an amplifier or encoder fault",
        _TO_SAFE,
        "remove its cause, then reset",
    ),
    Fault(
        9,
        "sensor_range",
        "the encoder moved further in a tick than any hand can move it",
        _TO_SAFE,
        "if the handle rang, lower K, B or M; if not, check encoder and cable. Then reset, and home"
        " or zero",
    ),
    Fault(
        10,
        "over_temperature",
        "the winding is hotter than the device allows",
        _TO_SAFE,
        "let it cool, then reset",
    ),
    Fault(
        11,
        "home_failed",
        "no stop or index was found within force and time",
        _TO_SAFE,
        "let go of the handle, check the mechanism and the table [home], reset, home",
    ),
    Fault(
        12,
        "no_authority",
        "the board does not grant torque: emergency stop, or the amplifier is not ready",
        _TO_SAFE,
        "release the emergency stop, check the amplifier, then reset",
    ),
    Fault(
        13,
        "force_at_limit",
        "the force went back and forth between its limits faster than any hand",
        _TO_SAFE,
        "lower K, B or M, or ask for more active damping, then reset",
    ),
    Fault(
        14,
        "overspeed",
        "the handle was faster for some milliseconds than the device file allows",
        _TO_SAFE,
        "lower K, B or M, or ask for more active damping, then reset",
    ),
    Fault(
        15,
        "energy",
        "the display gave out more energy than its damping and the user can account for",
        _TO_SAFE,
        "lower K, B or M, or ask for more active damping, then reset",
    ),
    Fault(
        17,
        "sensor_glitch",
        "the encoder reads positions between which no handle can move, one after the other",
        _TO_SAFE,
        "check encoder, cable and shield, reset, home or zero",
    ),
    Fault(
        18,
        "board_restarted",
        "the board's firmware restarted: its position origin is lost",
        _TO_SAFE,
        "check its supply, then reset, and home or zero again",
    ),
    Fault(
        20,
        "home_no_current",
        "homing pushed, and the motor carried too little current",
        _TO_SAFE,
        "check motor, amplifier and `home.current_n_per_a`, then reset, home",
    ),
    Fault(
        21,
        "home_blocked",
        "homing met something, and the handle did not move away from it again",
        _TO_SAFE,
        "let go of the handle, look for friction near `home.force_n`, reset, home",
    ),
    Fault(
        22,
        "home_not_confirmed",
        "homing could not find the same stop twice, or the stop gives way",
        _TO_SAFE,
        "let go of the handle, check the mechanism, reset, home",
    ),
    Fault(
        23,
        "home_wrong_way",
        "the handle went against the push of homing",
        _TO_SAFE,
        "let go of the handle, check the signs of force and position, reset, home",
    ),
    Fault(
        24,
        "damping_not_delivered",
        "the board delivers less active damping than the environment in force was allowed for",
        _TO_SAFE,
        "lower K and B, check resistance compensation and amplifier, then reset",
    ),
    Fault(
        27,
        "commissioning",
        "the handle went against the force, too far or for too long while signs are not verified",
        _TO_SAFE,
        "let go of the handle, check the signs of force and position, reset, `hapticd rig motor`",
    ),
    Fault(
        28,
        "device_differs",
        "a board that made force was found to contradict its device file",
        _TO_SAFE,
        "read the differences in `hapticd status`, plug in the right board, reset",
    ),
)

BY_CODE = {fault.code: fault for fault in FAULTS}
BY_NUMBER = {fault.number: fault for fault in FAULTS}
