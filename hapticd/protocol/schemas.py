"""The requests of clients as strict models, one per command, and the errors in words.

Strict: no text or booleans for numbers, no null for an omitted field, no unknown keys, no
non-finite numbers. Ranges depend on the device and are in `limits`. `parse` reports both kinds of
error in the same form: field, value, valid range with unit, remedy. It repeats values of a client
only in printable ASCII, cut short. `json_schema` gives the same for programs.
"""

from copy import deepcopy
from difflib import get_close_matches
from functools import cache
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    TypeAdapter,
    ValidationError,
    WithJsonSchema,
    create_model,
    model_validator,
)
from pydantic_core import ErrorDetails

from hapticd.core.environment import FIELDS, JUDGED, flat
from hapticd.core.errors import CommandError
from hapticd.core.params import (
    LONGEST_LEASE_S,
    SHORTEST_LEASE_S,
    AtEnd,
    BasisName,
    DampingMode,
    Leased,
    Policy,
)
from hapticd.mailbox.layout import LONGEST_SILENCE_S
from hapticd.protocol import answers
from hapticd.protocol.codec import ID_LENGTH, ID_LIMIT, SHOWN, RequestId, request_id, shown
from hapticd.protocol.limits import QUANTITIES, CommandLimits

__all__ = [
    "ADAPTER",
    "PROTOCOL_VERSION",
    "Change",
    "Damping",
    "Enable",
    "GuardRequest",
    "Hello",
    "Judged",
    "LeaseRequest",
    "Mark",
    "Perturb",
    "Proxy",
    "Request",
    "Set",
    "invalid",
    "json_schema",
    "parse",
]

PROTOCOL_VERSION = 1
_ID_SCHEMA = {
    "anyOf": [
        {"type": "integer", "minimum": 0, "maximum": ID_LIMIT - 1},
        {"type": "string", "maxLength": ID_LENGTH},
    ]
}


def _no_switch(value: Any) -> Any:
    if isinstance(value, bool):
        raise ValueError("expected a number, not true or false")
    return value


Id = Annotated[RequestId, BeforeValidator(request_id), WithJsonSchema(_ID_SCHEMA)]
Tick = Annotated[int, Field(gt=0, lt=ID_LIMIT)]
Side = Annotated[
    Literal[-1, 0, 1], BeforeValidator(_no_switch)
]  # true equals 1 and would pass as one


def _absent(text: str, **limits: Any) -> Any:
    """Return a field that may be omitted but not null; `given` lists the fields that were sent."""
    return Field(default=None, description=text, **limits)


class MessagePart(BaseModel):
    """Base of all messages and their parts."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, allow_inf_nan=False)

    @property
    def given(self) -> dict[str, Any]:
        """The fields that were sent, as plain values."""
        return self.model_dump(exclude_unset=True)


class CommandMessage(MessagePart):
    """Base of all commands."""

    v: int = Field(PROTOCOL_VERSION, description="version of this protocol")
    id: Id = Field(None, description="comes back in the reply")

    def change(self, level_ns_per_m: float) -> dict[str, Any]:
        """Return the changes of the environment, nested as in `set`. Active damping is a number;
        `on` means `level_ns_per_m`.
        """
        return {}

    @property
    def auto(self) -> bool | None:
        """Whether the guard selects the level of active damping; None: as before."""
        return None

    @property
    def end_tick(self) -> int:
        """The tick at which a bounded change ends; 0 for one without an end."""
        return 0


class Hello(CommandMessage):
    """Return versions, limits and endpoints; set the name of the client."""

    cmd: Literal["hello"]
    name: str = Field(
        "client",
        pattern=r"^[ -~]{1,32}$",
        description="shown as the actor of this client's changes",
    )


class Get(CommandMessage):
    """Return the parameters in force."""

    cmd: Literal["get"]


def _rendered(name: str, table: str, base: type[MessagePart], description: str) -> Any:
    """Return `base` with the fields of the environment in `table`."""
    numbers: dict[str, Any] = {}
    for one in FIELDS:
        inside, _, leaf = one.key.rpartition(".")
        if inside == table:
            numbers[leaf] = Side if one.unit == "side" else float, _absent(one.meaning)
    return create_model(name, __base__=base, __doc__=description, **numbers)


if TYPE_CHECKING:  # a type checker cannot use a model that is created at run time
    Filters = MessagePart
    Wall = MessagePart
else:
    text = "Low-pass filters of the derivatives."
    Filters = _rendered("Filters", "filters", MessagePart, text)
    Wall = _rendered("Wall", "wall", MessagePart, "Unilateral wall.")


class Judged(CommandMessage):
    """Base of the requests that the guard judges."""

    strict: bool = Field(
        False,
        description="judged as under policy refuse, whatever the policy is; guard: so is its mode",
    )


class Change(Judged):
    """Base of the requests that can be timed."""

    at_tick: Tick = _absent("servo tick at which it comes into force; left out: the next")
    if_rev: int = _absent("only if the revision is still this one", ge=0, lt=ID_LIMIT)


if TYPE_CHECKING:
    Rendered = Change
else:
    Rendered = _rendered("Rendered", "", Change, "Common to what changes the environment.")


class Set(Rendered):
    """Change any of the parameters; each ramps from its present value."""

    # A change of an Environment, not another form of one: only the fields that were sent, with
    # ramp, ticks and revision. Its fields come from the table, and `Environment.changed` takes its
    # `change`.

    cmd: Literal["set"]
    filters: Filters = _absent("derivative filters")
    wall: Wall = _absent("unilateral wall")
    limit_cycle_faults: bool = _absent(
        "whether force_at_limit and energy end a limit cycle; on again when force is off"
    )
    ramp_s: float = _absent("length of the ramp; left out: as configured")
    until_tick: Tick = _absent(
        "servo tick at which it ends: the same fields return to their values before it; the end is"
        " judged with the change. A stop or a fault cancels it; if it would raise K, B, M or a"
        " wall, so do other terms, another gateway or another holder of the lease; an end that"
        " lowers comes at once with other terms"
    )

    @model_validator(mode="after")
    def _ends_after_it_begins(self) -> "Set":
        if "until_tick" in self.model_fields_set and self.until_tick <= (self.at_tick or 0):
            raise ValueError(f"until_tick = {self.until_tick}: must be after at_tick")
        if "until_tick" in self.model_fields_set and not self.at_tick:
            # otherwise the change could start after its end was refused as late
            raise ValueError("until_tick: give at_tick as well")
        return self

    @model_validator(mode="after")
    def _asks_for_something(self) -> "Set":
        names = (*JUDGED, "limit_cycle_faults")
        if not any(key.partition(".")[0] in names for key, _ in flat(self.given)):
            raise ValueError(f"nothing to set; give one of {', '.join(names)}")
        return self

    def change(self, level_ns_per_m: float) -> dict[str, Any]:
        """Return the fields that were sent; a table without any is left out."""
        given = self.given
        return {name: given[name] for name in JUDGED if given.get(name, {}) != {}}

    @property
    def auto(self) -> bool | None:
        """False if a level was sent, which is the client's choice."""
        return False if "active_damping" in self.model_fields_set else None

    @property
    def end_tick(self) -> int:
        """The tick at which the change ends, if one was sent."""
        return self.until_tick if "until_tick" in self.model_fields_set else 0


class Damping(Change):
    """Switch the active damping, set its level and switch it on, or let the guard select it."""

    cmd: Literal["damping"]
    value: Literal["on", "off", "auto"] | float = Field(
        description="on, off, a level (0 is off), or auto: the least level that the guard finds"
    )

    def change(self, level_ns_per_m: float) -> dict[str, Any]:
        """Return the resulting level; nothing with `auto`."""
        levels = {"on": level_ns_per_m, "off": 0.0}
        level = levels.get(self.value) if isinstance(self.value, str) else float(self.value)
        return {} if level is None else {"active_damping": level}

    @property
    def auto(self) -> bool:
        """Whether the guard selects the level."""
        return self.value == "auto"


class Enable(Judged):
    """Switch force on, with a gain ramp."""

    cmd: Literal["enable"]


class Disable(CommandMessage):
    """Switch force off."""

    cmd: Literal["disable"]


class Stop(CommandMessage):
    """Latched stop; any client may send it at any time, whatever else the message contains."""

    cmd: Literal["stop"]


class Reset(CommandMessage):
    """Leave `stopped` or `fault` for `disabled`."""

    cmd: Literal["reset"]


class Zero(CommandMessage):
    """Set the present position as x = 0."""

    cmd: Literal["zero"]


class Home(CommandMessage):
    """Find the origin by the method in the device file."""

    cmd: Literal["home"]


class Withhold(CommandMessage):
    """Send no frames to the board for a while, to trip its watchdog; only in `disabled`."""

    cmd: Literal["withhold"]
    seconds: float = Field(
        ge=1e-3, le=LONGEST_SILENCE_S, description="for how long; records have flag WITHHELD"
    )


class Perturb(CommandMessage):
    """Load a waveform in chunks, then start and stop it."""

    cmd: Literal["perturb"]
    action: Literal["load", "start", "stop"]
    samples_n: list[float] | bytes = _absent(
        "force in newtons at 4 kHz: numbers, or little-endian float32 (msgpack only)"
    )
    offset: int = Field(
        0,
        ge=0,
        lt=ID_LIMIT,
        description="samples loaded before this chunk; 0 begins a new waveform",
    )
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


Ttl = Annotated[float, Field(ge=SHORTEST_LEASE_S, le=LONGEST_LEASE_S)]


class Proxy(CommandMessage):
    """Move the anchor of the virtual spring, for a law in a process of one's own; return handle and
    proxy.
    """

    cmd: Literal["proxy"]
    position_m: float = _absent(
        "where it goes, at limited speed and energy; needs the lease of the environment and state"
        " enabled; left out: only read"
    )

    @property
    def reads(self) -> bool:
        """Whether it moves nothing."""
        return "position_m" not in self.model_fields_set


class LeaseRequest(CommandMessage):
    """Take, renew or release the exclusive right to change a part of the display. A lease lasts as
    long as its connection sends a request at least every `ttl_s`.
    """

    cmd: Literal["lease"]
    what: Leased = Field(description="measuring: all three, with neither guard nor energy faults")
    action: Literal["take", "renew", "release", "fail"] = Field(
        "take", description="fail: release it, and do what `at_end` says: its holder has an error"
    )
    ttl_s: Ttl = _absent("take: it ends when nothing is asked for so long; left out: as configured")
    at_end: AtEnd = _absent(
        "take: when this client dies, fails or is silent, zero: the environment goes to 0 if it is"
        " leased; disable: force off; left out: as configured"
    )
    take_over: bool = Field(False, description="take: also from another, whose lease ends")

    @model_validator(mode="after")
    def _fits_its_action(self) -> "LeaseRequest":
        strange = self.model_fields_set & {"ttl_s", "at_end", "take_over"}
        if strange and self.action != "take":
            raise ValueError(f"{min(strange)} does not belong to action {self.action}")
        return self


class GuardRequest(Judged):
    """Set the treatment of environments that are not known to be passive; without
    fields: query it.
    """

    cmd: Literal["guard"]
    policy: Policy = _absent(
        "off: judge nothing; warn: apply the change and warn; clamp: go as far as is safe; refuse:"
        " apply nothing unsafe; follow: as refuse, but reduce the environment before active damping"
        " falls"
    )
    basis: BasisName = _absent("what a verdict rests on")
    margin_ns_per_m: float = _absent("damping that has to be left, N s/m", ge=0, le=1e3)
    mode: DampingMode = _absent(
        "active damping off, at its level, or at the least level that keeps the margin"
    )

    def damping(self) -> Damping:
        """Return the damping command for its mode."""
        value = "on" if self.mode == "level" else self.mode
        return Damping(cmd="damping", value=value, strict=self.strict)


class Status(CommandMessage):
    """Return the state of servo and gateway."""

    cmd: Literal["status"]


class Dump(CommandMessage):
    """Write the flight recording; the reply contains the path, and an event reports the end."""

    cmd: Literal["dump"]


class Mark(CommandMessage):
    """Note a text with the newest tick as an event `mark`, which recordings keep."""

    cmd: Literal["mark"]
    text: str = Field(min_length=1, max_length=96, description="what happens at this tick")


class Schema(CommandMessage):
    """Return this protocol as JSON schema."""

    cmd: Literal["schema"]


Request = (
    Hello
    | Get
    | Set
    | Damping
    | Enable
    | Disable
    | Stop
    | Reset
    | Zero
    | Home
    | Withhold
    | Perturb
    | Proxy
    | LeaseRequest
    | GuardRequest
    | Status
    | Dump
    | Mark
    | Schema
)
ADAPTER: TypeAdapter[Request] = TypeAdapter(Annotated[Request, Field(discriminator="cmd")])
MODELS: dict[str, type[CommandMessage]] = {
    get_args(model.model_fields["cmd"].annotation)[0]: model for model in get_args(Request)
}

# replies to hello, get, status, guard, proxy, lease and changes, and the topic `event`; in the JSON
# schema as `HelloAnswer` and so on
ANSWERS = (
    answers.Hello,
    answers.Get,
    answers.Status,
    answers.GuardStatus,
    answers.Coupling,
    answers.LeaseHeld,
    answers.LeaseReleased,
    answers.Receipt,
    answers.GuardVerdict,
    answers.Event,
)
LIMITED = {
    *JUDGED,
    "ramp_s",
    "value",
    "samples_n",
    "position_m",
}  # fields whose ranges depend on the device
WITHOUT_LIMIT = {name for model in MODELS.values() for name in model.model_fields} - LIMITED

MOST_DETAILS = 8
_BRANCHES = frozenset(
    {"list[float]", "bytes", "float", "literal['on','off','auto']"}
)  # names of union members in an error's path
_REMEDY = "the command `schema` lists what is allowed"


def parse(plain: dict[str, Any], limits: CommandLimits) -> Request:
    """Return the request in `plain`.

    CommandError `unsupported_version` or `invalid`, with one line per wrong field.
    """
    version = plain.get("v", PROTOCOL_VERSION)
    if type(version) is int and version != PROTOCOL_VERSION:
        raise CommandError(
            "unsupported_version",
            f"v = {shown(version)}: this gateway speaks {PROTOCOL_VERSION}; use a client of the"
            " same release",
        )
    try:
        request = ADAPTER.validate_python(plain)
    except ValidationError as error:
        found = [_explained(item, limits) for item in error.errors(include_url=False)]
        raise invalid(
            list({item["loc"]: item for item in reversed(found)}.values())[::-1]
        ) from error
    limited = {name: value for name, value in request.given.items() if name not in WITHOUT_LIMIT}
    if broken := limits.broken_by(limited):
        raise invalid(broken)
    return request


_REASONS = {  # replace pydantic's messages, by type of error
    "finite_number": "not a finite number",
    "float_type": "not a number",
    "int_type": "not a whole number",
    "literal_error": "not {}",
}


def invalid(detail: list[dict[str, Any]]) -> CommandError:
    """Return the error for a request that breaks the schema or a limit. detail is [{loc, msg}], for
    a number beyond its limit [{loc, msg, value, unit, low, high}].
    """
    detail = detail[:MOST_DETAILS]
    return CommandError("invalid", "; ".join(item["msg"] for item in detail), detail)


def _explained(item: ErrorDetails, limits: CommandLimits) -> dict[str, str]:
    command, *path = [str(part) for part in item["loc"]] or [""]
    names = [part for part in path if part not in _BRANCHES]
    loc = ".".join(map(shown, names))
    given = shown(item["input"])
    value = f"'{given}'" if isinstance(item["input"], str) else given
    if item["type"].startswith("union_tag"):
        asked = item["input"].get("cmd", "") if isinstance(item["input"], dict) else ""
        reason = f"unknown command{_meant(asked, tuple(MODELS))}; known: {', '.join(MODELS)}"
        return {"loc": "cmd", "msg": f"cmd = {shown(asked)}: {reason}"}
    if item["type"] == "extra_forbidden":
        return {
            "loc": loc,
            "msg": f"{loc}: unknown field{_meant(names[-1], _fields(command, names))}; {_REMEDY}",
        }
    if item["type"] == "missing":
        return {"loc": loc, "msg": f"{loc}: missing; {_REMEDY}"}
    if item["type"] == "value_error" and not loc:
        return {"loc": command, "msg": f"{command}: {item['ctx']['error']}"}
    context = item.get("ctx", {})
    # a value_error comes from a validator in this module
    said = str(context["error"]) if item["type"] == "value_error" else item["msg"]
    known = _REASONS.get(item["type"])
    reason = known.format(context.get("expected")) if known else said
    remedy = limits.remedy(loc.partition(".")[0] if loc.startswith("samples_n") else loc) or _REMEDY
    return {
        "loc": loc or command,
        "msg": f"{QUANTITIES.get(loc, loc) or command} = {value}: {shown(reason, 120)}; {remedy}",
    }


def _meant(name: Any, known: tuple[str, ...]) -> str:
    lower = {one.lower(): one for one in known}
    near = get_close_matches(str(name)[:SHOWN].lower(), lower, n=1)
    return f", did you mean {lower[near[0]]!r}?" if near else ""


def _fields(command: str, names: list[str]) -> tuple[str, ...]:
    parts: dict[str, type[MessagePart]] = {"filters": Filters, "wall": Wall}
    part = parts.get(names[0]) if len(names) > 1 else MODELS.get(command)
    return tuple(part.model_fields) if part else ()


def json_schema(limits: CommandLimits) -> dict[str, Any]:
    """Return the protocol as JSON schema, with unit, minimum and maximum on this device."""
    schema = deepcopy(_schema_of_any_device())
    for title, model in schema["$defs"].items():
        part = {"Filters": "filters.", "Wall": "wall."}.get(title, "")
        for name, field in model.get("properties", {}).items():
            if field.get("default", ...) is None and name != "id":
                del field["default"]
            if part + name in limits.of and name != "samples_n":
                limit = limits.of[part + name]
                field |= {"unit": limit.unit, "minimum": limit.low, "maximum": limit.high}
    return schema


@cache  # it takes a tenth of a second
def _schema_of_any_device() -> dict[str, Any]:
    schema: dict[str, Any] = ADAPTER.json_schema()
    for one in ANSWERS:
        answer = TypeAdapter(one).json_schema()
        schema["$defs"] |= answer.pop("$defs", {}) | {f"{one.__name__}Answer": answer}
    return schema
