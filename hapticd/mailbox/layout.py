"""The tables of the mailbox: every offset, record and number on which two processes must agree.

A change of any table changes LAYOUT_HASH, and processes of different versions refuse each other.
The telemetry table is also the dtype that `servo.raw` contains (numpy `descr` form), so an
acquisition client needs no copy of it.
"""

import hashlib
import struct
from collections.abc import Mapping
from enum import IntEnum
from typing import Final, NamedTuple

from hapticd.core.environment import FIELDS, FIRST_FURTHER_SLOT, FURTHER, SLOTS, STRENGTHS

__all__ = [
    "ANY_TERMS",
    "COMMAND_HEAD_WORD",
    "COMMAND_VALUES",
    "COMMISSIONING",
    "COMMISSIONING_LIMITS",
    "COMPUTED_FIELDS",
    "COUNTERS",
    "COUNTER_WORD",
    "EPOCH_WORD",
    "GATEWAY_BEAT_WORD",
    "HEADER",
    "HEADER_PID",
    "LATCHED",
    "LAYOUT_HASH",
    "LONGEST_SILENCE_S",
    "LOST_SLOTS",
    "MAILBOX_BYTES",
    "MEASURED",
    "PERTURBATION_SAMPLES",
    "PLAN",
    "PLAN_FIELDS",
    "RECORD",
    "REVISION_MASK",
    "RING_RECORDS",
    "RING_SLOTS",
    "SERVO_BEAT_WORD",
    "STAGES",
    "STEPPED",
    "STRENGTH_VALUES",
    "TELEMETRY",
    "TELEMETRY_BYTES",
    "TELEMETRY_HEAD_WORD",
    "TELEMETRY_OFFSET",
    "VALUE_LIMITS",
    "Command",
    "Flag",
    "LateCause",
    "Result",
    "State",
    "Value",
    "ValueLimit",
    "Watched",
    "following",
    "newer",
    "offset_of",
    "value_limits",
    "values_of",
]

MAGIC = b"HAPTICD\0"

# --- header page: written once by the servo before `epoch`, which is written last -----------------
# magic, layout hash, pid, start_ns, rate_hz, config hash (hex), simulated
HEADER = struct.Struct("<8s8sQqd64sB")
HEADER_PID: Final = 2  # place in a header
# u64 index into the mailbox file: start time of this servo life, 0 during its construction
EPOCH_WORD = 32

# --- words: single u64, one writer each -----------------------------------------------------------
SERVO_BEAT_WORD = 64  # monotonic ns, written every tick
GATEWAY_BEAT_WORD = 72  # monotonic ns, written by the gateway at least every 100 ms
COMMAND_HEAD_WORD = 80  # commands posted (gateway)
COMMAND_TAIL_WORD = 88  # commands taken (servo)
ANSWER_HEAD_WORD = 96  # answers posted (servo)
ANSWER_TAIL_WORD = 104  # answers taken (gateway)
GATEWAY_PID_WORD = 112
LAST_ACTOR_WORD = 113  # the largest client number assigned in this servo life (gateway)
PERTURBATION_LEASE_WORD = 114  # actor that holds the lease of the perturbation, 0: none (gateway)
INHERITED_WORD = 115  # commands posted by the gateways before this one (gateway)
GATEWAYS_WORD = 116  # gateways that have served this servo life (gateway)
JOURNAL_HEAD_WORD = 120  # requests obeyed (servo)
CHECKPOINT_ASKED_WORD = 122  # checkpoints requested (gateway)
CHECKPOINT_HEAD_WORD = 124  # checkpoints written (servo)
COUNTER_WORD = 128  # COUNTERS, u64 each
LOST_SLOTS = 1 << 32  # modulus of the count of lost slots
PAGE = 4096


def _whole_pages(length: int) -> int:
    return -(-length // PAGE) * PAGE


COUNTERS = (
    "ticks",
    "late_events",
    "lost_slots",
    "grace_late_events",
    "grace_lost_slots",
    "missing_in",
    "bad_in",
    "stale_in",
    "behind_in",
    "sequence_gap",
    "write_errors",
    "reconnects",
    "sim_slip_ns",
    "commands",
    "bad_commands",
    "dropped_answers",
    "board_lives",
    "empty_in",
)
# parts of a tick: each has a field `_ns` in the record, the source of the histograms
STAGES = ("wake", "read", "step", "write", "publish")

# --- command ring: gateway -> servo ---------------------------------------------------------------
RING_SLOTS = 64
# seq, kind, actor, apply_tick (0: now), values, crc32 of all before, pad
COMMAND_VALUES = FIRST_FURTHER_SLOT + len(FURTHER)
COMMAND = struct.Struct(f"<QIIQ{COMMAND_VALUES}dII")
COMMAND_OFFSET = 2 * PAGE
COMMAND_CRC_OFFSET = COMMAND.size - 8

# --- answer ring: servo -> gateway ----------------------------------------------------------------
# seq, result, fault number, revision, first_tick, ramp_end_tick, effective, crc32, pad
ANSWER = struct.Struct(f"<QIIQQQ{COMMAND_VALUES}dII")
ANSWER_OFFSET = COMMAND_OFFSET + _whole_pages(RING_SLOTS * COMMAND.size)

# --- journal: the requests that the servo obeyed, with their ticks; records, checkpoint and journal
# are enough for a replay
JOURNAL_SLOTS = 256
# number, tick, seq, kind, actor, apply_tick, values, number again
JOURNAL = struct.Struct(f"<QQQIIQ{COMMAND_VALUES}dQ")
JOURNAL_OFFSET = ANSWER_OFFSET + _whole_pages(RING_SLOTS * ANSWER.size)

# --- checkpoints: the servo's whole state before a tick, on request, in two alternating slots -----
# number, tick, length and crc32 of the marshalled state that follows
CHECKPOINT = struct.Struct("<QQII")
CHECKPOINT_SLOT = 2 * PAGE
CHECKPOINT_OFFSET = JOURNAL_OFFSET + _whole_pages(JOURNAL_SLOTS * JOURNAL.size)
MAILBOX_BYTES = CHECKPOINT_OFFSET + 2 * CHECKPOINT_SLOT
assert CHECKPOINT_OFFSET % PAGE == 0

PERTURBATION_HEADER = PAGE
PERTURBATION_SAMPLES = 1 << 19  # i16 counts: 131 s at 4 kHz, repeated with `loop`


class State(IntEnum):
    """State of the servo; its number is in every record."""

    DISABLED = 0
    ENABLED = 1
    STOPPED = 2
    FAULT = 3
    HOMING = 4


LATCHED: Final = frozenset({State.STOPPED, State.FAULT})  # until a reset


class Command(IntEnum):
    """Requests of the gateway to the servo."""

    SET = 1
    DAMPING = 2
    ENABLE = 3
    DISABLE = 4
    STOP = 5
    RESET = 6
    ZERO = 7
    HOME = 8
    PERTURB_START = 9
    PERTURB_STOP = 10
    FAULT = 11  # one of FROM_GATEWAY (servo.commands)
    # cancel scheduled changes of the masked places by other actors; nothing else changes
    CANCEL = 12
    WITHHOLD = 13  # no frames for a while, for the board's watchdog (servo.watchdog_trial)
    # set the terms of judgements; changes scheduled under other terms are cancelled
    TERMS = 14
    WITHDRAWN = 15  # in place of one that the gateway withdrew before the servo took it
    PROXY = 16  # new position of the proxy; not answered


class Value(IntEnum):
    """Places of the doubles of a command; bit `1 << place` in MASK marks a place as given."""

    MASK = 0
    RAMP_S = 1
    STIFFNESS = SLOTS["K"]
    VIRTUAL_DAMPING = SLOTS["B"]
    MASS = SLOTS["M"]
    VELOCITY_FILTER_HZ = SLOTS["filters.velocity_hz"]
    VELOCITY_FILTER_ZETA = SLOTS["filters.velocity_zeta"]
    ACCELERATION_FILTER_HZ = SLOTS["filters.acceleration_hz"]
    ACCELERATION_FILTER_ZETA = SLOTS["filters.acceleration_zeta"]
    WALL_STIFFNESS = SLOTS["wall.stiffness_n_per_m"]
    WALL_VIRTUAL_DAMPING = SLOTS["wall.virtual_damping_ns_per_m"]
    WALL_POSITION = SLOTS["wall.position_m"]
    WALL_SIDE = SLOTS["wall.side"]
    ACTIVE_DAMPING = SLOTS["active_damping"]
    ACTIVE_DAMPING_ON = 14  # 0 or 1
    SAMPLES = 15  # PERTURB_START: length of the waveform
    LOOP = 16  # PERTURB_START: 0 or 1
    LEASE_CONTROL = 17
    LEASE_ACTIVE_DAMPING = 18
    STOP_OWNER = 19  # answers: actor that pressed stop, 0: several, or the servo itself
    LIMIT_CYCLE_FAULTS = 20  # 0 or 1: faults force_at_limit and energy
    # revision of the environment for which a change was judged; in answers, the present one
    ENVIRONMENT_REVISION = 21
    FAULT_NUMBER = 22  # FAULT: its number
    SILENCE_S = 23  # WITHHOLD: duration
    # number of the terms by which a change was judged; ANY_TERMS: the end of a bounded change
    TERMS = 24
    UNTIL_TICK = 25  # from which the fields of the change return to their values before it
    PROXY = 26  # m
    locals().update({one.path.upper(): one.slot for one in FURTHER})


def values_of(given: Mapping[Value, float]) -> tuple[float, ...]:
    """Return the doubles of a command with exactly these values."""
    values = [0.0] * COMMAND_VALUES
    for place, value in given.items():
        values[place] = float(value)
    values[Value.MASK] = float(sum(1 << place for place in given))
    return tuple(values)


class ValueLimit(NamedTuple):
    """The range of a value, both ends included."""

    low: float
    high: float
    unit: str


LONGEST_SILENCE_S: Final = 1.0
# places to which a force is proportional
STRENGTH_VALUES: Final = tuple(Value(one.slot) for one in STRENGTHS)
# device and rate may narrow these
VALUE_LIMITS: dict[Value, ValueLimit] = {
    **{Value(one.slot): ValueLimit(one.low, one.high, one.unit) for one in FIELDS},
    Value.RAMP_S: ValueLimit(0.0, 60.0, "s"),
    Value.ACTIVE_DAMPING_ON: ValueLimit(0.0, 1.0, "switch"),
    Value.SAMPLES: ValueLimit(1.0, float(PERTURBATION_SAMPLES), "samples"),
    Value.LOOP: ValueLimit(0.0, 1.0, "switch"),
    Value.LEASE_CONTROL: ValueLimit(0.0, float((1 << 32) - 1), "id"),  # a u4 of the record
    Value.LEASE_ACTIVE_DAMPING: ValueLimit(0.0, float((1 << 32) - 1), "id"),
    Value.LIMIT_CYCLE_FAULTS: ValueLimit(0.0, 1.0, "switch"),
    Value.ENVIRONMENT_REVISION: ValueLimit(0.0, float((1 << 32) - 1), "revision"),
    Value.FAULT_NUMBER: ValueLimit(0.0, 255.0, "fault"),
    # far below the time for which a board holds damping
    Value.SILENCE_S: ValueLimit(1e-3, LONGEST_SILENCE_S, "s"),
    # exact integers in a double
    Value.TERMS: ValueLimit(0.0, float(1 << 53), "number"),
    Value.UNTIL_TICK: ValueLimit(1.0, float(1 << 53), "tick"),
    Value.PROXY: ValueLimit(-10.0, 10.0, "m"),
}
COMMISSIONING_LIMITS: dict[Value, ValueLimit] = {
    Value(one.slot): ValueLimit(one.unverified[0], one.unverified[1], one.unit)
    for one in FIELDS
    if one.unverified is not None
}
FILTER_LIMIT = 0.45  # highest corner as a fraction of the rate


def value_limits(
    rate_hz: float, active_damping_limit_ns_per_m: float, commissioning: bool = False
) -> dict[Value, ValueLimit]:
    """Return VALUE_LIMITS, narrowed by the servo rate [Hz], the device's damping limit [N s/m] and
    unverified signs.
    """
    boxed = COMMISSIONING_LIMITS if commissioning else {}
    narrower = {
        Value.ACTIVE_DAMPING: active_damping_limit_ns_per_m,
        Value.VELOCITY_FILTER_HZ: FILTER_LIMIT * rate_hz,
        Value.ACCELERATION_FILTER_HZ: FILTER_LIMIT * rate_hz,
    }
    return {
        place: ValueLimit(low, min(high, narrower.get(place, high)), unit)
        for place, (low, high, unit) in (VALUE_LIMITS | boxed).items()
    }


ANY_TERMS: Final = 0
REVISION_MASK: Final = 0xFFFFFFFF  # a revision is a u4 of the record, and the same everywhere


def following(revision: int) -> int:
    """Return the revision after `revision`."""
    return revision + 1 & REVISION_MASK


def newer(one: int, other: int) -> bool:
    """Return whether revision `one` was counted after `other`, also across their wrap."""
    return 0 < one - other & REVISION_MASK <= REVISION_MASK >> 1


class Result(IntEnum):
    """The result of a command."""

    APPLIED = 1
    SCHEDULED = 2  # at_tick is in the future: a second answer follows, APPLIED or SUPERSEDED
    SUPERSEDED = 3  # a later command replaced every parameter before this one took effect
    REFUSED_STATE = 4  # not in this state
    REFUSED_CAUSE = 5  # the cause of the fault persists
    REFUSED_NOT_HOMED = 6
    REFUSED_NO_GATEWAY = 7  # enable without a gateway heartbeat
    REFUSED_RANGE = 8
    REFUSED_FULL = 9  # 16 commands are scheduled already
    REFUSED_LATE = 10  # at_tick has passed
    CANCELLED = 11  # removed by a stop, a fault, other terms or the end of its client
    REFUSED_OWNER = 12  # reset within 1 s of another client's stop
    REFUSED_NO_AUTHORITY = 13  # the board would not grant torque: emergency stop or amplifier
    REFUSED_FILTER = 14  # a force passes the filters
    REFUSED_RATE = 16  # the bus is too slow for the rate
    REFUSED_DEVICE = 17  # the board contradicts its device file
    REFUSED_REVISION = 18  # it was judged for another environment than the one in force
    REFUSED_COMMISSIONING = 19  # the signs of the device are not verified
    REFUSED_SAMPLE = 20  # no valid position arrived in its tick
    REFUSED_TERMS = 21  # it was judged by other terms than those in force


# --- telemetry: one record per tick ---------------------------------------------------------------
TELEMETRY = (
    ("tick", "<u8"),
    ("time_ns", "<i8"),
    ("board_us", "<i8"),
    # --- the plan: changes only on commands, ramps and safety transitions; packed once per change
    ("revision", "<u4"),
    ("state", "u1"),
    ("fault", "u1"),
    ("perturbing", "u1"),
    ("homed", "u1"),
    ("actor", "<u4"),
    ("lease_control", "<u4"),
    ("lease_active_damping", "<u4"),
    ("gain", "<f4"),
    ("stiffness_n_per_m", "<f8"),
    ("virtual_damping_ns_per_m", "<f8"),
    ("mass_kg", "<f8"),
    ("active_damping_asked_ns_per_m", "<f8"),
    ("active_damping_ns_per_m", "<f8"),
    ("wall_stiffness_n_per_m", "<f8"),
    ("wall_position_m", "<f8"),
    *((one.column, "<f8") for one in FURTHER),
    ("proxy_m", "<f8"),  # where the spring is anchored (servo.proxy)
    ("wall_side", "<i4"),
    ("watches", "<u4"),  # Watched
    ("environment_revision", "<u4"),  # counts changes of environment and damping
    ("resistance_count", "<i4"),  # of the resistance compensation, as sent
    # --- this tick
    ("flags", "<u4"),
    ("status", "<u4"),
    # of the sample: 0 on time, k after k lost ones (usb.device), -k none for k periods
    ("arrival", "<i4"),
    ("host", "<u4"),  # servo.plan: LINK_UP and the others
    # the time of ramps, holds and budgets, in periods: tick + slots lost so far
    ("slot", "<u8"),
    ("position_m", "<f8"),
    ("velocity_m_per_s", "<f8"),
    ("acceleration_m_per_s2", "<f8"),
    ("stiffness_force_n", "<f8"),
    ("virtual_damping_force_n", "<f8"),
    ("mass_force_n", "<f8"),
    ("field_force_n", "<f8"),
    ("force_n", "<f8"),
    ("work_j", "<f8"),  # done on the device; excess_j: energy given out without cover
    ("excess_j", "<f8"),
    ("winding_c", "<f4"),
    ("current_a", "<f4"),
    ("voltage_v", "<f4"),
    ("emf_velocity_m_per_s", "<f4"),
    ("wake_ns", "<i4"),
    ("read_ns", "<i4"),
    ("step_ns", "<i4"),
    ("write_ns", "<i4"),
    ("publish_ns", "<i4"),
    ("lost_slots", "<u4"),
    # of the tick before, 0 if it was on time: the cause (LateCause), and how long after the next
    # deadline it ended
    ("late_cause", "<u4"),
    ("late_ns", "<i4"),
    # from a sample to the force that was in effect when this tick's sample was latched, by the
    # board's clock; -1: unknown
    ("delay_us", "<i4"),
    ("delay_spread_us", "<i4"),  # maximum minus minimum delay of the last whole 256 ticks
    # of the IN frame when it was read, by both clocks; -1: unknown, or the board withholds torque
    ("frame_age_us", "<i4"),
    ("active_damping_effect_ns_per_m", "<f4"),  # active damping in effect, reported by the board
    # of the event at the board's pins in this tick's frame (usb.device)
    ("event_us", "<i8"),
    ("event_code", "<i4"),
    ("events_lost", "<u4"),
    ("in_frame", "V64"),
    ("out_frame", "V32"),
    ("tail", "<u8"),  # = tick; differs while the record is being overwritten
)

_NAMES = [name for name, *_ in TELEMETRY]
_PLAN_END = _NAMES.index("resistance_count") + 1
_MEASURED = _NAMES.index("winding_c")
PLAN_FIELDS = TELEMETRY[3:_PLAN_END]
COMPUTED_FIELDS = TELEMETRY[_NAMES.index("position_m") : _MEASURED]  # by the law and its energy
_CODES = {"<u8": "Q", "<i8": "q", "<u4": "I", "<i4": "i", "<f4": "f", "<f8": "d", "u1": "B"}


def _codes(fields: tuple[tuple[object, ...], ...]) -> str:
    parts = []
    for _, kind, *shape in fields:
        text = str(kind)
        if text[0] == "V":
            parts.append(f"{text[1:]}s")
            continue
        count = f"{shape[0][0]}" if shape else ""  # type: ignore[index]
        parts.append(count + _CODES[text])
    return "".join(parts)


PLAN = struct.Struct("<" + _codes(PLAN_FIELDS))
# Every field is aligned to its size: no gaps. A tick packs the two halves separately, because
# CPython turns more than 30 arguments of a call into a list and a tuple, which takes 0.2 us.
STEPPED = struct.Struct(f"Qqq{PLAN.size}s" + _codes(TELEMETRY[_PLAN_END:_MEASURED]))
MEASURED = struct.Struct(_codes(TELEMETRY[_MEASURED:]))
RECORD = struct.Struct(STEPPED.format + MEASURED.format)
assert RECORD.size == STEPPED.size + MEASURED.size
RING_RECORDS = 8192  # 8 s at 1 kHz


def offset_of(name: str) -> int:
    """Return the number of bytes of a record before its field `name`."""
    return struct.calcsize("<" + _codes(TELEMETRY[: _NAMES.index(name)]))


TELEMETRY_HEAD_WORD = 0  # u64 index in telemetry.ring: records written
TELEMETRY_EPOCH_WORD = 1
TELEMETRY_OFFSET = PAGE
TELEMETRY_BYTES = PAGE + RING_RECORDS * RECORD.size


class Flag(IntEnum):
    """Bits of `flags` in a record."""

    MISSING_IN = 1  # no fresh sample: the command of the tick before was repeated
    BAD_IN = 2
    INTERPOLATED = 4  # the filters got interpolated positions of lost frames
    SEEDED = 8  # the filters were set to rest at this position
    LATE = 16
    CLAMPED = 32
    NOT_FINITE = 64
    WRITE_FAILED = 128
    RAMPING = 256
    QUIET_RAMP = 512  # force returns from 0 after a gap
    EASED = 1024  # parameters are held back by the device's force step (servo.energy)
    # servo.samples: the sample is doubted, and the motion is continued straight; the samples before
    # were glitches, and the filters got positions between; they were true motion
    DOUBTED = 2048
    GLITCH = 4096
    BELIEVED = 8192
    PAUSED = 16384  # ramps wait, because they have added the maximum energy of a second
    CONTROLLED = 32768  # the energy controller holds more damping, or less K and B, than requested
    WITHHELD = 65536  # no frame was sent: test of the board's watchdog (servo.watchdog_trial)
    PROXY_HELD = 131072  # the proxy stays: its law is late or gone, or has no energy left


class LateCause(IntEnum):
    """The part of a late tick with the largest excess over its usual time (servo.late)."""

    NONE = 0  # on time
    WAKE = 1
    SUBMISSION = 2  # of its transfers: the kernel took them late
    BUS = 3  # the board got an OUT late, or no IN arrived
    COMPLETION = 4  # the board was in time, but the end of the transfer was late
    TRANSFER = 5  # an unknown part of a transfer
    STEP = 6
    PUBLISH = 7


class Watched(IntEnum):
    """Bits of `watches` in a record: active faults that end a limit cycle (servo.safety)."""

    FORCE_AT_LIMIT = 1
    OVERSPEED = 2
    ENERGY = 4


COMMISSIONING = 8  # a further bit of `watches`: the signs of the device are not verified

LAYOUT_HASH = hashlib.sha256(
    repr(
        (
            HEADER.format,
            COMMAND.format,
            ANSWER.format,
            JOURNAL.format,
            CHECKPOINT.format,
            TELEMETRY,
            COUNTERS,
            STAGES,
            list(State),
            list(Command),
            list(Value),
            list(Result),
            list(LateCause),
        )
    ).encode()
).digest()[:8]
