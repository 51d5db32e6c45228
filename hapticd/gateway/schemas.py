"""What a client may ask, as strict models: one per command, told apart by `cmd`.

Strict means: no text for numbers, no booleans for numbers, no null for "not given", no unknown keys, nothing infinite. The
ranges are not here but in `limits`, since they depend on the device; `explain` puts both complaints in the same form.
"""

from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, TypeAdapter, WithJsonSchema, model_validator

from hapticd.gateway.codec import ID_LENGTH, ID_LIMIT, RequestId, request_id

PROTOCOL_VERSION = 1
_ID_SCHEMA = {"anyOf": [{"type": "integer", "minimum": 0, "maximum": ID_LIMIT - 1}, {"type": "string", "maxLength": ID_LENGTH}]}


def _no_switch(value: Any) -> Any:
    if isinstance(value, bool):
        raise ValueError("a number is meant, not true or false")
    return value


Id = Annotated[RequestId, BeforeValidator(request_id), WithJsonSchema(_ID_SCHEMA)]
Tick = Annotated[int, Field(gt=0, lt=ID_LIMIT)]
Side = Annotated[Literal[-1, 0, 1], BeforeValidator(_no_switch)]  # true equals 1 and would pass as one


def _absent(text: str, **limits: Any) -> Any:
    """A field that may be left out but not be null; `given` lists those that were sent."""
    return Field(default=None, description=text, **limits)


class Table(BaseModel):
    """Common to all messages and their parts."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, allow_inf_nan=False)

    @property
    def given(self) -> dict[str, Any]:
        """The fields that were sent, as plain values."""
        return self.model_dump(exclude_unset=True)


class Command(Table):
    """Common to all commands."""

    v: int = Field(PROTOCOL_VERSION, description="version of this protocol")
    id: Id = Field(None, description="comes back in the reply")


class Hello(Command):
    """Who is there: versions, limits, endpoints; gives the client a name."""

    cmd: Literal["hello"]
    name: str = Field("client", pattern=r"^[ -~]{1,32}$", description="shown as the actor of this client's changes")


class Get(Command):
    """The parameters in force."""

    cmd: Literal["get"]


class Filters(Table):
    """Low-pass filters of the derivatives."""

    velocity_hz: float = _absent("corner of the velocity filter")
    velocity_zeta: float = _absent("its damping ratio")
    acceleration_hz: float = _absent("corner of the acceleration filter")
    acceleration_zeta: float = _absent("its damping ratio")


class Wall(Table):
    """Unilateral wall."""

    stiffness_n_per_m: float = _absent("stiffness")
    damping_ns_per_m: float = _absent("damping while pressed")
    position_m: float = _absent("where it stands")
    side: Side = _absent("+1: solid beyond the position, -1: before it, 0: no wall")


class Change(Command):
    """Common to what may be timed."""

    at_tick: Tick = _absent("servo tick at which it comes into force; left out: the next")
    if_rev: int = _absent("only if the revision is still this one", ge=0, lt=ID_LIMIT)


class Set(Change):
    """Change any of the parameters; each goes on a ramp from where it is."""

    cmd: Literal["set"]
    K: float = _absent("virtual stiffness")
    B: float = _absent("virtual damping")
    M: float = _absent("virtual mass")
    filters: Filters = _absent("derivative filters")
    wall: Wall = _absent("unilateral wall")
    damping: float = _absent("added electrical damping; 0 switches it off and keeps the level")
    ramp_s: float = _absent("length of the ramp; left out: as configured")

    @model_validator(mode="after")
    def _asks_for_something(self) -> "Set":
        if not self.model_fields_set & {"K", "B", "M", "damping"} and not any(part.given for part in self.parts()):
            raise ValueError("nothing to set; give one of K, B, M, filters, wall, damping")
        return self

    def parts(self) -> list[Table]:
        """The sub-tables that were sent."""
        return [part for name in ("filters", "wall") if isinstance(part := getattr(self, name), Table)]


class Damping(Change):
    """Switch the added electrical damping, or set its level and switch it on."""

    cmd: Literal["damping"]
    value: Literal["on", "off"] | float = Field(description="on, off or a level; 0 is off")


class Enable(Command):
    """Force on, with a gain ramp."""

    cmd: Literal["enable"]


class Disable(Command):
    """Force off."""

    cmd: Literal["disable"]


class Stop(Command):
    """Latched stop; taken from anyone at any time, whatever else the message holds."""

    cmd: Literal["stop"]


class Reset(Command):
    """Leave `stopped` or `fault` for `disabled`."""

    cmd: Literal["reset"]


class Zero(Command):
    """Here is x = 0."""

    cmd: Literal["zero"]


class Home(Command):
    """Find the origin as the device file says."""

    cmd: Literal["home"]


class Perturb(Command):
    """Load a waveform in chunks, then start and stop it."""

    cmd: Literal["perturb"]
    action: Literal["load", "start", "stop"]
    samples_n: list[float] | bytes = _absent("force in newtons at 4 kHz: numbers, or little-endian float32 (msgpack only)")
    offset: int = Field(0, ge=0, lt=ID_LIMIT, description="samples loaded before this chunk; 0 begins a new waveform")
    loop: bool = Field(False, description="start: repeat until stopped")

    @model_validator(mode="after")
    def _fits_its_action(self) -> "Perturb":
        takes = {"load": {"samples_n", "offset"}, "start": {"loop"}, "stop": set()}[self.action]
        strange = self.model_fields_set & {"samples_n", "offset", "loop"} - takes
        if strange:
            raise ValueError(f"{min(strange)} does not belong to action {self.action}")
        if self.action == "load" and "samples_n" not in self.model_fields_set:
            raise ValueError("samples_n is missing: load needs the force samples [N]")
        return self


class Status(Command):
    """Everything about servo and gateway."""

    cmd: Literal["status"]


class Dump(Command):
    """Write the flight recording now; the reply names the file, an event `flight` tells when it is there."""

    cmd: Literal["dump"]


class Schema(Command):
    """This protocol as JSON schema."""

    cmd: Literal["schema"]


Request = Hello | Get | Set | Damping | Enable | Disable | Stop | Reset | Zero | Home | Perturb | Status | Dump | Schema
ADAPTER: TypeAdapter[Request] = TypeAdapter(Annotated[Request, Field(discriminator="cmd")])
MODELS: dict[str, type[Command]] = {
    model.model_fields["cmd"].annotation.__args__[0]: model  # type: ignore[union-attr]
    for model in (Hello, Get, Set, Damping, Enable, Disable, Stop, Reset, Zero, Home, Perturb, Status, Dump, Schema)
}
