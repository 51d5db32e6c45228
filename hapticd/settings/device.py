"""devices/NAME.toml: what one count means on this device, its limits, and its simulated plant.

A scale is written as the value at the converter's full count (32767 signed, 65535 for the damping
scale factor), as hapticd_wire.h states nominal scales:
value = sign * (count - offset_count) * full_scale / full_count. Position and temperature are given
per count.

[model] holds one table per effect, made from the effects themselves, so that each is described
once:

    [model]
    effects = ["probe", "coulomb"]      what a live simulated board builds; a scene names its own
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
    MeasuredBy,
    ResistanceParams,
    ScaleParams,
)
from hapticd.core.units import COPPER_PER_K
from hapticd.model.effects import ALWAYS, BY_KEY, PROVENANCE, Effect
from hapticd.settings.tables import TomlTable
from hapticd.usb.codec import I16_HIGHEST

__all__ = ["DeviceFile", "signs_hash"]

SERIAL_BYTES = 16  # of the hello reply
FROM_SCALES = ("encoder", "force_dac", "damping_dac", "probe_adc", "saturation")
RELIED_ON: Any = ("probe", "temperature")
Tag = Literal["paper", "inferred", "calibrated"]


class Provenance(TomlTable):
    """When and by whom the numbers of a table were measured."""

    measured_on: datetime.date | None = None
    """When it was measured or, for the signs, seen."""
    measured_by: MeasuredBy = ""
    """The step of `hapticd rig` that measured it, "paper", or nothing for any other origin. A scale
    that a step measured may differ from the board's nominal one by 1.5 times, any other by 1.1."""


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
    """What every effect has beside its numbers."""

    source: Tag
    """Where its numbers come from."""
    sources: dict[str, Tag] = Field(default_factory=dict)
    """Numbers that come from elsewhere."""
    note: str = ""
    """More about the numbers, in words."""


class _OfAnEffect(EffectTable, use_attribute_docstrings=False):
    """Without source text: pydantic would look for it in every module that is loaded."""


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
        """The table of the effect `key`; None if the device has none."""
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
    """The effects `names` with the numbers of `model`, and masses and motor, which always exist.

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
    """Count that means zero."""
    serial: str = ""
    """Of the board at which it was measured; left out: the device's own."""
    source: str = Field(min_length=1)
    """How it is known: calibration record, data sheet, paper, or "assumed"."""

    def params(self, key: str, counts: int = 1) -> ScaleParams:
        """As the processes read it: the number `key` is what so many `counts` mean."""
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
    """`force.full_scale_n` when it was measured, for it is weighed in newtons; with another one it
    has to be measured again."""


class Velocity(Scale):
    full_scale_m_per_s: float = Field(gt=0)
    """At 32767 counts."""


class ProbeVelocity(Velocity):
    skew_us: float = Field(0.0, ge=-1000, le=1000)
    """By which the velocity of a sample is later than its force, as `rig probe` finds it; taken
    out of every live trial. 0 where both are sampled together, as a simulated board does."""


class Current(Scale):
    full_scale_a: float = Field(gt=0)
    """At 32767 counts."""


class Voltage(Scale):
    full_scale_v: float = Field(gt=0)
    """At 32767 counts."""


class Temperature(Scale):
    c_per_count: float = Field(gt=0)


class ResistanceTable(Provenance):
    """How the board compensates the winding's resistance, and what is known of the winding."""

    sign: Literal[-1, 1] = 1
    """-1 when a positive count makes the circuit believe in fewer ohm."""
    full_scale_ohm: float = Field(gt=0, le=1e4)
    """What 32767 counts add to `base_ohm`."""
    base_ohm: float = Field(gt=0, le=1e4)
    """What the circuit compensates at count 0: no more than the winding has when it is coldest."""
    winding_ohm: float = Field(gt=0, le=1e4)
    """The winding itself, at `reference_c`."""
    reference_c: float = Field(20.0, ge=-40, le=150)
    per_k: float = Field(COPPER_PER_K, gt=0, le=0.02)
    """Relative change of its resistance; copper's by default."""
    tolerance_ohm: float = Field(gt=0, le=1e4)
    """By how much less than the winding has is compensated: what the other numbers may be wrong."""
    slew_ohm_per_s: float = Field(gt=0, le=1e4)
    """Of the trim."""
    force_n_per_a: float = Field(ge=1e-3, le=1e4)
    """Endpoint force per ampere of the motor."""
    heat_from: Literal["current", "force"] = "current"
    """What heats the winding: the motor current that the board reports, or the commanded force
    where it reports none."""
    thermal_resistance_k_per_w: float = Field(gt=0, le=1e4)
    """Winding to surroundings."""
    time_constant_s: float = Field(ge=1, le=1e5)
    """Of the winding against its surroundings."""
    ambient_low_c: float = Field(ge=-40, le=100)
    """The surroundings are never colder."""
    ambient_high_c: float = Field(ge=-40, le=100)
    """Nor hotter."""
    model_error: float = Field(ge=0, le=0.9)
    """Share by which thermal resistance and time constant may be wrong."""
    serial: str = ""
    """Of the board at which it was measured; left out: the device's own."""
    source: str = Field(min_length=1)
    """How it is known."""

    def params(self) -> ResistanceParams:
        """As the servo reads it."""
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
    """What the device may be asked for; the configuration may only be stricter."""

    force_n: float = Field(gt=0)
    active_damping_ns_per_m: float = Field(ge=0)
    probe_n: float = Field(ge=0)
    temperature_c: float = Field(gt=0, le=200)
    speed_m_per_s: float = Field(gt=0)
    """Faster is not a motion but a sensor fault."""
    overspeed_m_per_s: float | None = Field(None, gt=0)
    """Faster than this for 5 ms is a fault; left out: 0.7 of `speed_m_per_s`."""
    physical_damping_ns_per_m: float | None = Field(None, ge=0)
    """What the device damps for certain, without active damping: well below what was measured. Left
    out, the fault `energy` is off."""
    energy_j: float = Field(ENERGY_LIMIT_J, gt=0)
    """Energy that the display may give away beyond what that damping takes: fault `energy`."""
    force_step_n: float = Field(1.0, gt=0)
    """Largest step of force in one tick by an enable or a change of parameters; what would step
    further takes several ticks. 1 N gives a free handle of 8 g 0.1 m/s."""
    ramp_energy_j: float = Field(RAMP_ENERGY_J, gt=0)
    """Elastic and kinetic energy that enables and changes of parameters may bring in within a
    second; ramps that would bring in more wait. 0.03 J is K = 600 N/m brought in 10 mm off."""
    acceleration_m_per_s2: float = Field(500.0, gt=0)
    """What changes the speed faster is believed only when the next sample goes on from it: an
    encoder glitch comes back."""


class Travel(TomlTable):
    """Usable range of position after homing."""

    lower_m: float
    upper_m: float


class CommissioningTable(Provenance):
    """Whether somebody has seen that force and position have the signs that this file says."""

    signs_verified: bool = False
    """False: a tenth of the force, a small box for K, B and M, and every push is watched."""
    serial: str = ""
    """Of the board at which it was seen; with another one it counts for nothing."""
    firmware: str = Field("", pattern=r"^([0-9]{1,3}\.[0-9]{1,3})?$")
    """Its firmware then, as its hello said, like 1.0; a board with another one makes no force.
    Left out: any."""
    signs: str = Field("", pattern=r"^([0-9a-f]{16})?$")
    """What was verified, as `hapticd rig motor` writes it: a hash of the signs of force and
    position, serial number and firmware. Where it does not fit the file, nobody has seen them."""
    life: int | None = Field(None, ge=0, le=255)
    """In which life of that board it was seen: the number changes whenever it starts."""
    source: str = ""
    """How it was seen."""


def signs_hash(serial: str, firmware: str, force_sign: int, position_sign: int) -> str:
    """What names the signs that somebody has seen, at a board with this serial and firmware."""
    seen = f"{serial}|{firmware}|force {force_sign:+d}|position {position_sign:+d}"
    return hashlib.sha256(seen.encode()).hexdigest()[:16]


class MotorTable(Measured):
    """The motor as it was measured; a simulated one is described by `plant` or `model`."""

    force_n_per_a: float = Field(ge=1e-3, le=1e4)
    """Endpoint force per ampere."""
    winding_ohm: float = Field(gt=0, le=1e4)
    """The winding, at `reference_c`."""
    reference_c: float = Field(20.0, ge=-40, le=150)
    lever_m: float | None = Field(None, gt=0, le=10)
    """Radius that turns torque into endpoint force, as its owner says; nothing is computed from
    it here but the torque constant, the product of `force_n_per_a` and `lever_m`."""
    source: str = ""
    """How it is known."""


class RigidTable(TomlTable):
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


class DeviceFile(TomlTable):
    """A device file."""

    name: str = Field(min_length=1)
    serial: str = Field(min_length=1, max_length=SERIAL_BYTES, pattern=r"^[!-~]+$")
    """As the board reports it."""
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
    """How the winding's resistance is compensated; left out, it is not."""
    limits: LimitsTable
    travel: Travel
    home: HomeParams = HomeParams()
    commissioning: CommissioningTable | None = None
    """Left out: signs are verified for a simulated device, and are not for a real one."""
    calibration_days: int = Field(CALIBRATION_DAYS, ge=1, le=36500)
    """A calibration that is older is named wherever numbers rest on it, and `zwidth trial live`
    refuses it."""
    relies_on: tuple[Literal["probe", "temperature"], ...] = Field(RELIED_ON, strict=False)
    """Capabilities of the board without which the device may not be used."""
    motor: MotorTable | None = None
    """The motor, where somebody measured it."""
    plant: RigidTable | None = None
    """What a simulated board moves: one rigid mass."""
    model: DeviceModel | None = None
    """What a simulated board moves, in full, instead of `plant`."""
