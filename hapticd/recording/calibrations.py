"""On which calibrations a device's numbers rest, and which of them cannot be relied on.

Each scale of a device file says when and at which board it was measured (`ScaleParams`). What is
measured with the device rests on those of position and force, of active damping where it has any,
of the probe and the winding's temperature where it relies on them, and of the compensated
resistance where it has that. A calibration is in doubt when its table has no date, when it is older
than the device file's `calibration_days`, dated after today, of another board than the device's, or
found with a scale of force that has changed since: active damping is weighed in newtons.
A simulated device is what its file says: nothing is asked for.

Every scale that is used must be listed here.
"""

import datetime
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from hapticd.core.errors import AnalysisError
from hapticd.core.params import CALIBRATION_DAYS
from hapticd.usb.codec import I16_HIGHEST

__all__ = ["CalibrationDoubt", "doubts", "refuse_doubts", "used_scales"]

SAME_SCALE = 0.01  # relative: what a gain that is measured again may differ by

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
    """A calibration that cannot be relied on, and why."""

    table: str  # of the device file
    reason: str

    def __str__(self) -> str:
        return f"{self.table}: {self.reason}"

    @property
    def remedy(self) -> str:
        """How to be sure of it again."""
        if step := STEPS.get(self.table):
            return f"`hapticd rig {step}`"
        return (
            f"measure it, and write measured_on and serial into [{self.table}] of the device file"
        )


def used_scales(device: Mapping[str, Any], probed: bool = False) -> dict[str, Mapping[str, Any]]:
    """The scales, by table, on which measurements with `device` rest, which is as `hello` says it;
    those of the probe as well if it is `probed`.
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
    """Calibrations that cannot be relied on at `day`, of the `servo` that a hello tells of; of the
    probe as well if it is `probed`.
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
    """Why the active damping of `device` does not go with its scale of force."""
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
    """AnalysisError that names each of `found`, if there are any."""
    if found:
        steps = ", ".join(dict.fromkeys(one.remedy for one in found))
        listed = "; ".join(map(str, found))
        raise AnalysisError(
            f"calibrations that cannot be relied on: {listed}. Measure them ({steps}), or ask for"
            " the trial with --uncalibrated: its verdict then says so"
        )
