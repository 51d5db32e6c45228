"""The calibrations behind a device's numbers, and doubts about them.

Each scale of a device file contains the date and the board of its measurement (`ScaleParams`).
Measurements with the device depend on the scales of position and force, and of those that it has or
relies on: active damping, probe, winding temperature, compensated resistance. A calibration is in
doubt if its table has no date, a date after today, or one older than the device file's
`calibration_days`. It is also in doubt if it belongs to another board, or if its scale of force has
changed since, because active damping is calibrated in newtons.

A simulated device matches its file by definition and needs no calibration.

Every scale in use must be listed here.
"""

import datetime
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from hapticd.core.errors import AnalysisError
from hapticd.core.params import CALIBRATION_DAYS
from hapticd.usb.codec import I16_HIGHEST

__all__ = ["CalibrationDoubt", "doubts", "refuse_doubts", "used_scales"]

SAME_SCALE = 0.01  # relative: tolerance of a repeated gain

STEPS = {
    "position": "encoder",
    "force": "motor",
    "active_damping": "damping",
    "probe_torque": "probe",
    "probe_velocity": "probe",
    "temperature": "temperature",
}  # by table of the device file, the step of `hapticd rig` that measures it


@dataclass(frozen=True, slots=True)
class CalibrationDoubt:
    """A doubtful calibration, with the reason."""

    table: str  # of the device file
    reason: str

    def __str__(self) -> str:
        return f"{self.table}: {self.reason}"

    @property
    def remedy(self) -> str:
        """The way to resolve the doubt."""
        if step := STEPS.get(self.table):
            return f"`hapticd rig {step}`"
        return (
            f"measure it, and write measured_on and serial into [{self.table}] of the device file"
        )


def used_scales(device: Mapping[str, Any], probed: bool = False) -> dict[str, Mapping[str, Any]]:
    """Return the scales, by table, behind measurements with `device`, as given in `hello`; with
    `probed` those of the probe as well.
    """
    names = ["position", "force"]
    if device["active_damping_limit_ns_per_m"] > 0.0:
        names.append("active_damping")
    if probed or "probe" in device["relies_on"]:
        names += ["probe_torque", "probe_velocity"]
    if "temperature" in device["relies_on"]:
        names.append("temperature")
    found: dict[str, Mapping[str, Any]] = {name: device[name] for name in names}
    if resistance := device.get("resistance"):
        found["resistance"] = resistance["trim"]
    return found


def doubts(
    servo: Mapping[str, Any], day: datetime.date, probed: bool = False
) -> tuple[CalibrationDoubt, ...]:
    """Return the calibrations in doubt at `day`, of the `servo` in a hello; with `probed` those of
    the probe as well.
    """
    if servo["simulated"]:
        return ()
    device = servo["device"]
    most = int(device.get("calibration_days", CALIBRATION_DAYS))
    return tuple(
        CalibrationDoubt(table, reason)
        for table, scale in used_scales(device, probed).items()
        for reason in (
            *_reasons(scale, str(device["serial"]), most, day),
            *_outlived(table, device),
        )
    )


def _outlived(table: str, device: Mapping[str, Any]) -> Iterator[str]:
    """Yield the reason if the active damping of `device` does not match its scale of force."""
    then_n = float(device.get("active_damping_with_force_n", 0.0))
    now_n = float(device["force"]["per_count"]) * I16_HIGHEST
    if table == "active_damping" and then_n and abs(now_n - then_n) > SAME_SCALE * then_n:
        yield (
            f"it was found with a scale of force of {then_n:g} N at full count, which is"
            f" {now_n:.6g} N now"
        )


def _reasons(scale: Mapping[str, Any], serial: str, most: int, day: datetime.date) -> Iterator[str]:
    of = str(scale.get("serial", ""))
    if of not in ("", serial):
        yield f"it is of the board {of!r}, this one is {serial!r}"
    if not scale["measured_on"]:
        yield "it has no date, so no measurement of it is known"
        return
    age = (day - datetime.date.fromisoformat(scale["measured_on"])).days
    if age > most:
        yield f"it is {age} days old ({scale['measured_on']}), {most} days are the limit"
    elif age < -1:  # a day for time zones
        yield f"it is dated {scale['measured_on']}, after today ({day.isoformat()})"


def refuse_doubts(found: tuple[CalibrationDoubt, ...]) -> None:
    """Raise AnalysisError that lists `found`, if there are any."""
    if found:
        steps = ", ".join(dict.fromkeys(one.remedy for one in found))
        listed = "; ".join(map(str, found))
        raise AnalysisError(
            f"calibrations that cannot be relied on: {listed}. Measure them ({steps}), or ask for"
            " the trial with --uncalibrated: its verdict then says so"
        )
