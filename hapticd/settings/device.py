"""devices/NAME.toml: what one count means on this very device, and what it may be asked for.

A scale is written as the value at the converter's full count (32767 signed, 65535 for the damping scale factor), as
hapticd_wire.h states nominal scales: value = sign * (count - offset_count) * full_scale / full_count. Position and
temperature are per count.
"""

import datetime
from typing import Literal

from pydantic import Field

from hapticd.params import HomeParams, ScaleParams
from hapticd.settings.effects import DeviceModel
from hapticd.settings.quantities import Table

SIGNED_FULL_COUNT, UNSIGNED_FULL_COUNT = 32767, 65535
SERIAL_BYTES = 16  # of the hello reply
_home = HomeParams()


class Scale(Table):
    sign: Literal[-1, 1] = 1
    offset_count: float = 0.0
    """Count that means zero."""
    date: datetime.date | None = None
    """When it was measured."""
    source: str = Field(min_length=1)
    """How it is known: calibration record, data sheet, paper, or "assumed"."""

    def params(self, per_count: float) -> ScaleParams:
        date = self.date.isoformat() if self.date else ""
        return ScaleParams(per_count, self.sign, self.offset_count, date, self.source)


class Position(Scale):
    m_per_count: float = Field(gt=0)


class Force(Scale):
    full_scale_n: float = Field(gt=0)
    """At 32767 counts."""


class AddedDamping(Scale):
    full_scale_ns_per_m: float = Field(gt=0)
    """At 65535 counts."""


class Velocity(Scale):
    full_scale_m_per_s: float = Field(gt=0)
    """At 32767 counts."""


class Current(Scale):
    full_scale_a: float = Field(gt=0)
    """At 32767 counts."""


class Voltage(Scale):
    full_scale_v: float = Field(gt=0)
    """At 32767 counts."""


class Temperature(Scale):
    c_per_count: float = Field(gt=0)


class Limits(Table):
    """What the device may be asked for; the configuration may only be stricter."""

    force_n: float = Field(gt=0)
    damping_ns_per_m: float = Field(ge=0)
    probe_n: float = Field(ge=0)
    temperature_c: float = Field(gt=0, le=200)
    speed_m_per_s: float = Field(gt=0)
    """Faster is not a motion but a sensor fault."""


class Travel(Table):
    """Usable range of position after homing."""

    lower_m: float
    upper_m: float


class Home(Table):
    """How the origin of position is found."""

    method: Literal["none", "stop", "index"] = "none"
    required: bool = _home.required
    """Refuse to enable before it was done."""
    direction: Literal[-1, 1] = -1
    speed_m_per_s: float = Field(_home.speed_m_per_s, gt=0, le=1)
    force_n: float = Field(_home.force_n, gt=0)
    position_m: float = _home.position_m
    """Where the stop or index lies."""
    timeout_s: float = Field(_home.timeout_s, gt=0, le=600)


class Plant(Table):
    """What the simulated board moves: one rigid mass, without a model of its effects."""

    mass_kg: float = Field(gt=0)
    """Device and probe."""
    viscous_ns_per_m: float = Field(ge=0)
    lower_stop_m: float
    upper_stop_m: float
    torque_constant_n_per_a: float = Field(gt=0)
    winding_ohm: float = Field(gt=0)
    ambient_c: float = Field(ge=-40, le=100)
    source: str = Field(min_length=1)


class Device(Table):
    """A device file."""

    name: str = Field(min_length=1)
    serial: str = Field(min_length=1, max_length=SERIAL_BYTES, pattern=r"^[!-~]+$")
    """As the board reports it."""
    simulated: bool = False
    position: Position
    force: Force
    damping: AddedDamping
    probe_torque: Force
    probe_velocity: Velocity
    current: Current
    voltage: Voltage
    emf_velocity: Velocity
    temperature: Temperature
    limits: Limits
    travel: Travel
    home: Home = Home()
    plant: Plant | None = None
    """What a simulated board moves: one rigid mass."""
    model: DeviceModel | None = None
    """What a simulated board moves, in full, instead of `plant`."""
