"""devices/NAME.toml: values per count of a device, its limits, and its simulated plant.

A scale is written as the value at the converter's full count (32767 signed, 65535 for the damping
scale factor), like the nominal scales in hapticd_wire.h: value = sign * (count - offset_count) *
full_scale / full_count. Position and temperature are given per count.

[model] has one table per effect, generated from the effects themselves, so that each is described
once:

    [model]
    effects = ["probe", "coulomb"]      effects of a live simulated board; a scene has its own list
    [model.coulomb]
    rotor_n = 0.0293
    source = "calibrated"               paper | inferred | calibrated; `sources` tags single numbers

Converters and limits are not repeated there: `encoder`, `force_dac`, `damping_dac`, `probe_adc` and
`saturation` take their numbers from the scales and limits of the same file.

Every field of an effect must be a number.
"""

import datetime
import hashlib
from collections.abc import Iterable
from dataclasses import MISSING, fields
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import Field, create_model, field_validator

from hapticd.core.params import (
    CALIBRATION_DAYS,
    ENERGY_LIMIT_J,
    RAMP_ENERGY_J,
    HomeParams,
    ResistanceParams,
    RigStep,
    ScaleParams,
)
from hapticd.core.units import COPPER_PER_K
from hapticd.model.effects import ALWAYS, BY_KEY, PROVENANCE, Effect
from hapticd.settings.config import TomlTable
from hapticd.usb.codec import I16_HIGHEST

__all__ = ["DeviceFile", "signs_hash"]

MeasuredBy = Literal[RigStep, "paper", ""]

SERIAL_BYTES = 16  # of the hello reply
FROM_SCALES = ("encoder", "force_dac", "damping_dac", "probe_adc", "saturation")
RELIED_ON: Any = ("probe", "temperature")
Tag = Literal["paper", "inferred", "calibrated"]


class Provenance(TomlTable):
    """Date and origin of the numbers of a table."""

    measured_on: datetime.date | None = None
    """Date of the measurement, or of the verification of the signs."""
    measured_by: MeasuredBy = ""
    """The step of `hapticd rig` that measured it, "paper", or empty for any other origin. A scale
    measured by a step may differ from the board's nominal one by a factor of 1.5, any other by 1.1.
    """


class Measured(Provenance):
    """A table whose numbers may have intervals."""

    half_width_95: dict[str, Annotated[float, Field(ge=0)]] = Field(default_factory=dict)
    """Half widths of 95 % intervals of numbers of this table, by key, in the unit of the number."""

    @field_validator("half_width_95")
    @classmethod
    def _of_own_keys(cls, halves: dict[str, float]) -> dict[str, float]:
        if unknown := sorted(set(halves) - set(cls.model_fields)):
            raise ValueError(f"{unknown[0]!r} is not a key of this table")
        return halves


class EffectTable(Provenance):
    """Fields of every effect in addition to its numbers."""

    source: Tag
    """Origin of its numbers."""
    sources: dict[str, Tag] = Field(default_factory=dict)
    """Numbers with another origin."""
    note: str = ""
    """Further information on the numbers, as text."""


class _OfAnEffect(EffectTable, use_attribute_docstrings=False):
    """No source text: pydantic would search every loaded module for it."""


def _table(kind: type[Effect]) -> type[EffectTable]:
    numbers: dict[str, Any] = {}
    for item in fields(kind):
        if item.name not in PROVENANCE:
            default = ... if item.default is MISSING else item.default
            numbers[item.name] = (float, Field(default, **item.metadata))
    return create_model(kind.__name__, __base__=_OfAnEffect, __doc__=kind.__doc__, **numbers)


TABLES = {key: _table(kind) for key, kind in BY_KEY.items() if key not in FROM_SCALES}


class _Tables(TomlTable, use_attribute_docstrings=False):
    def table(self, key: str) -> Any:
        """Return the table of the effect `key`; None if the device has none."""
        return getattr(self, key)


if TYPE_CHECKING:

    class DeviceModel(_Tables):
        """The effects of a simulated device."""

        effects: tuple[str, ...]

else:
    DeviceModel = create_model(
        "DeviceModel",
        __base__=_Tables,
        __doc__="The effects of a simulated device.",
        effects=(
            tuple[str, ...],
            Field(
                strict=False,
                description="What a live board builds; masses and motor are always there.",
            ),
        ),
        **{
            key: (table, ...) if key in ALWAYS else (table | None, None)
            for key, table in TABLES.items()
        },
    )


def effects_of(
    model: DeviceModel, names: Iterable[str], scales: dict[str, Effect]
) -> tuple[Effect, ...]:
    """Return the effects `names` with the numbers of `model`, and masses and motor, which always
    exist.

    Effects of converters are taken from `scales`, by key.
    """
    return tuple(
        scales[name] if name in FROM_SCALES else _effect(name, model.table(name))
        for name in [*ALWAYS, *(name for name in names if name not in ALWAYS)]
    )


def _effect(key: str, table: EffectTable) -> Effect:
    plain = table.model_dump(exclude=set(Provenance.model_fields))
    plain["sources"] = tuple(plain["sources"].items())
    return BY_KEY[key](**plain)


class Scale(Measured):
    sign: Literal[-1, 1] = 1
    offset_count: float = 0.0
    """Count of the value zero."""
    serial: str = ""
    """Serial number of the board at the measurement. Default: the device's own."""
    source: str = Field(min_length=1)
    """Origin of the scale: calibration record, data sheet, paper, or "assumed"."""

    def params(self, key: str, counts: int = 1) -> ScaleParams:
        """Return the scale for the processes: the number `key` is the value of `counts`."""
        half = self.half_width_95.get(key)
        return ScaleParams(
            getattr(self, key) / counts,
            self.sign,
            self.offset_count,
            None if half is None else half / counts,
            self.measured_on.isoformat() if self.measured_on else "",
            self.measured_by,
            self.serial,
            self.source,
        )


class Position(Scale):
    m_per_count: float = Field(gt=0)


class Force(Scale):
    full_scale_n: float = Field(gt=0)
    """At 32767 counts."""


class ActiveDampingTable(Scale):
    full_scale_ns_per_m: float = Field(gt=0)
    """At 65535 counts."""
    with_force_full_scale_n: float | None = Field(None, gt=0)
    """`force.full_scale_n` at the time of the measurement, which depends on it; measure again after
    a change of that scale."""


class Velocity(Scale):
    full_scale_m_per_s: float = Field(gt=0)
    """At 32767 counts."""


class ProbeVelocity(Velocity):
    skew_us: float = Field(0.0, ge=-1000, le=1000)
    """Delay of the velocity of a sample behind its force, from `rig probe`; corrected in every live
    trial. 0 if both are sampled together, as on a simulated board."""


class Current(Scale):
    full_scale_a: float = Field(gt=0)
    """At 32767 counts."""


class Voltage(Scale):
    full_scale_v: float = Field(gt=0)
    """At 32767 counts."""


class Temperature(Scale):
    c_per_count: float = Field(gt=0)


class ResistanceTable(Provenance):
    """Compensation of the winding's resistance by the board, and parameters of the winding."""

    sign: Literal[-1, 1] = 1
    """-1 if a positive count reduces the compensated resistance."""
    full_scale_ohm: float = Field(gt=0, le=1e4)
    """Resistance added to `base_ohm` by 32767 counts."""
    base_ohm: float = Field(gt=0, le=1e4)
    """Compensated resistance at count 0: at most that of the coldest winding."""
    winding_ohm: float = Field(gt=0, le=1e4)
    """Resistance of the winding at `reference_c`."""
    reference_c: float = Field(20.0, ge=-40, le=150)
    per_k: float = Field(COPPER_PER_K, gt=0, le=0.02)
    """Relative change of its resistance; default: copper."""
    tolerance_ohm: float = Field(gt=0, le=1e4)
    """Difference kept between winding and compensation: the possible error of the other numbers."""
    slew_ohm_per_s: float = Field(gt=0, le=1e4)
    """Of the trim."""
    force_n_per_a: float = Field(ge=1e-3, le=1e4)
    """Endpoint force per ampere of the motor."""
    heat_from: Literal["current", "force"] = "current"
    """Source of the heating: the motor current reported by the board, or the commanded force if it
    reports none."""
    thermal_resistance_k_per_w: float = Field(gt=0, le=1e4)
    """Winding to surroundings."""
    time_constant_s: float = Field(ge=1, le=1e5)
    """Of the winding against its surroundings."""
    ambient_low_c: float = Field(ge=-40, le=100)
    """Lowest temperature of the surroundings."""
    ambient_high_c: float = Field(ge=-40, le=100)
    """Highest temperature of the surroundings."""
    model_error: float = Field(ge=0, le=0.9)
    """Possible relative error of thermal resistance and time constant."""
    serial: str = ""
    """Serial number of the board at the measurement. Default: the device's own."""
    source: str = Field(min_length=1)
    """Origin of the numbers."""

    def params(self) -> ResistanceParams:
        """Return the table for the servo."""
        own = self.model_dump(exclude={"sign", "source", "serial", *Provenance.model_fields})
        trim = ScaleParams(
            self.full_scale_ohm / I16_HIGHEST,
            self.sign,
            measured_on=self.measured_on.isoformat() if self.measured_on else "",
            measured_by=self.measured_by,
            serial=self.serial,
            source=self.source,
        )
        return ResistanceParams(trim=trim, **own)


class LimitsTable(TomlTable):
    """Limits of the device; the configuration may only be stricter."""

    force_n: float = Field(gt=0)
    active_damping_ns_per_m: float = Field(ge=0)
    probe_n: float = Field(ge=0)
    temperature_c: float = Field(gt=0, le=200)
    speed_m_per_s: float = Field(gt=0)
    """A higher speed is a sensor fault, not a motion."""
    overspeed_m_per_s: float | None = Field(None, gt=0)
    """A higher speed for 5 ms is a fault. Default: 0.7 of `speed_m_per_s`."""
    physical_damping_ns_per_m: float | None = Field(None, ge=0)
    """Guaranteed damping of the device without active damping: well below the measured one. If
    omitted, the fault `energy` is off."""
    energy_j: float = Field(ENERGY_LIMIT_J, gt=0)
    """Energy that the display may release in excess of that damping: fault `energy`."""
    force_step_n: float = Field(1.0, gt=0)
    """Largest step of force in one tick by an enable or a change of parameters; a larger step takes
    several ticks. 1 N gives a free handle of 8 g 0.1 m/s."""
    ramp_energy_j: float = Field(RAMP_ENERGY_J, gt=0)
    """Maximum elastic and kinetic energy added by enables and changes of parameters within a
    second; ramps that would add more wait. 0.03 J is K = 600 N/m switched on 10 mm from rest."""
    acceleration_m_per_s2: float = Field(500.0, gt=0)
    """A faster change of speed is accepted only if the next sample continues it: an encoder glitch
    returns."""


class Travel(TomlTable):
    """Usable range of position after homing."""

    lower_m: float
    upper_m: float


class CommissioningTable(Provenance):
    """Verification that force and position have the signs of this file."""

    signs_verified: bool = False
    """False: a tenth of the force, a small box for K, B and M, and every push is watched."""
    serial: str = ""
    """Serial number of the board at the verification; it is void for another board."""
    firmware: str = Field("", pattern=r"^([0-9]{1,3}\.[0-9]{1,3})?$")
    """Its firmware at that time, from its hello, like 1.0; a board with another firmware makes no
    force. Default: any."""
    signs: str = Field("", pattern=r"^([0-9a-f]{16})?$")
    """The verified signs, as written by `hapticd rig motor`: a hash of the signs of force and
    position, serial number and firmware. If it does not match the file, the signs are not verified.
    """
    life: int | None = Field(None, ge=0, le=255)
    """Life of that board at the verification: the number changes at every start."""
    source: str = ""
    """Method of the verification."""


def signs_hash(serial: str, firmware: str, force_sign: int, position_sign: int) -> str:
    """Return the hash of verified signs, for a board with this serial and firmware."""
    seen = f"{serial}|{firmware}|force {force_sign:+d}|position {position_sign:+d}"
    return hashlib.sha256(seen.encode()).hexdigest()[:16]


class MotorTable(Measured):
    """The measured motor; a simulated one is described by `plant` or `model`."""

    force_n_per_a: float = Field(ge=1e-3, le=1e4)
    """Endpoint force per ampere."""
    winding_ohm: float = Field(gt=0, le=1e4)
    """Resistance of the winding at `reference_c`."""
    reference_c: float = Field(20.0, ge=-40, le=150)
    lever_m: float | None = Field(None, gt=0, le=10)
    """Radius from torque to endpoint force, stated by the owner; used only for the torque constant,
    the product of `force_n_per_a` and `lever_m`."""
    source: str = ""
    """Origin of the numbers."""


class RigidTable(TomlTable):
    """Plant of the simulated board: one rigid mass, without a model of its effects."""

    mass_kg: float = Field(gt=0)
    """Device and probe."""
    viscous_ns_per_m: float = Field(ge=0)
    lower_stop_m: float
    upper_stop_m: float
    torque_constant_n_per_a: float = Field(gt=0)
    winding_ohm: float = Field(gt=0)
    ambient_c: float = Field(ge=-40, le=100)
    source: str = Field(min_length=1)


class DeviceFile(TomlTable):
    """A device file."""

    name: str = Field(min_length=1)
    serial: str = Field(min_length=1, max_length=SERIAL_BYTES, pattern=r"^[!-~]+$")
    """As reported by the board."""
    simulated: bool = False
    position: Position
    force: Force
    active_damping: ActiveDampingTable
    probe_torque: Force
    probe_velocity: ProbeVelocity
    current: Current
    voltage: Voltage
    emf_velocity: Velocity
    temperature: Temperature
    resistance: ResistanceTable | None = None
    """Compensation of the winding's resistance; if omitted, there is none."""
    limits: LimitsTable
    travel: Travel
    home: HomeParams = HomeParams()
    commissioning: CommissioningTable | None = None
    """If omitted, signs count as verified for a simulated device, and as not verified for a real
    one."""
    calibration_days: int = Field(CALIBRATION_DAYS, ge=1, le=36500)
    """An older calibration is listed with all numbers that depend on it, and `zwidth trial live`
    refuses it."""
    relies_on: tuple[Literal["probe", "temperature"], ...] = Field(RELIED_ON, strict=False)
    """Capabilities of the board required for the use of the device."""
    motor: MotorTable | None = None
    """The motor, if it was measured."""
    plant: RigidTable | None = None
    """Plant of a simulated board: one rigid mass."""
    model: DeviceModel | None = None
    """Full model of a simulated board, instead of `plant`."""
