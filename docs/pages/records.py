"""Meanings of the fields and flags of a tick's record, for the pages that list them.

The names are those of the record. A test compares both, so that every added, removed or renamed
field has to be described here.
"""

from hapticd.core.environment import FURTHER
from hapticd.core.units import unit_of
from hapticd.mailbox.layout import COMMISSIONING, TELEMETRY, Flag, LateCause, State, Watched
from hapticd.servo import plan
from hapticd.usb.frames import StatusBit
from pages.markdown import table

# units of fields whose names have none
UNITS = {
    "tick": "ticks",
    "slot": "periods",
    "lost_slots": "periods",
    "resistance_count": "counts",
    "events_lost": "events",
}
FIELDS = {
    "tick": "number of the tick since the servo started",
    "time_ns": "time at which the tick woke, on the host's monotonic clock",
    "board_us": "time of the sample, on the board's clock",
    "revision": "number of accepted changes; equals `revision` of the receipt",
    "state": ", ".join(f"{int(state)} {state.name.lower()}" for state in State),
    "fault": "number of the fault; 0 without one",
    "perturbing": "1 while a waveform plays",
    "homed": "1 when the origin is known",
    "actor": "client that made the last change; 0 for the servo itself",
    "lease_control": "client with the lease of the environment; 0 for none",
    "lease_active_damping": "client with the lease of the active damping; 0 for none",
    "gain": "factor on the force, 0 to 1; ramps after `enable`",
    "stiffness_n_per_m": "virtual stiffness K in force",
    "virtual_damping_ns_per_m": "virtual damping B in force (rendered)",
    "mass_kg": "virtual mass M in force",
    "active_damping_asked_ns_per_m": "active damping that was requested",
    "active_damping_ns_per_m": "active damping sent to the board, after ramps and quantisation",
    "wall_stiffness_n_per_m": "stiffness of the virtual wall in force",
    "wall_position_m": "position of the virtual wall",
    **{one.column: one.meaning for one in FURTHER},
    "proxy_m": "position of the proxy, from which the virtual spring acts; 0 without a law",
    "wall_side": "+1: solid beyond the position, -1: solid before it, 0: no wall",
    "watches": "bits: limit-cycle faults that are on, see below",
    "environment_revision": "number of changes of the environment and of the active damping",
    "resistance_count": "count sent for the resistance compensation",
    "flags": "bits: conditions of this tick, see below",
    "status": "bits: status that the board sent, see below",
    "arrival": "0 a sample in time; k after k lost ones; -k no sample for k periods",
    "host": "bits: link, gateway and board as the servo sees them, see below",
    "slot": "periods since the start, lost ones included; ramps and holds follow it",
    "position_m": "position of the handle, not filtered",
    "velocity_m_per_s": "velocity from the position, filtered",
    "acceleration_m_per_s2": "acceleration from the position, filtered",
    "stiffness_force_n": "part of the force from K",
    "virtual_damping_force_n": "part of the force from B",
    "mass_force_n": "part of the force from M",
    "field_force_n": "part of the force from the wall and from soft ends of the travel",
    "force_n": "force that was sent, after gain and limits",
    "work_j": "work done on the device since the servo started",
    "excess_j": "energy given out that neither damping nor a change covers",
    "winding_c": "temperature of the motor's winding",
    "current_a": "current of the motor",
    "voltage_v": "voltage of the motor",
    "emf_velocity_m_per_s": "velocity from the back-EMF of the motor",
    "wake_ns": "delay of the wake-up after the deadline",
    "read_ns": "time for reading the frame",
    "step_ns": "time for computing the force",
    "write_ns": "time for writing the frame",
    "publish_ns": "time for publishing the record of the tick before",
    "lost_slots": "periods without a tick since the servo started",
    "late_cause": "cause of the lateness of the tick before; 0 if it was on time, see below",
    "late_ns": "time from the next deadline to the end of the tick before; 0 if it was on time",
    "delay_us": "delay from sample to force, by the board's clock; -1 if unknown",
    "delay_spread_us": "maximum minus minimum delay of the last 256 ticks",
    "frame_age_us": "age of the frame when it was read; -1 if unknown",
    "active_damping_effect_ns_per_m": "active damping that the board reports as in effect",
    "event_us": "time of the event at the board's pins, on the board's clock; -1 if unknown or none",
    "event_code": "code at the board's event pins, in the tick that brought its change; -1 for none",
    "events_lost": "events at the board's pins that were lost since the servo started",
    "in_frame": "frame from the board, unchanged",
    "out_frame": "frame to the board, as it was sent",
    "tail": "equals `tick`; absent in recordings",
}
FLAGS = {
    "MISSING_IN": "no new sample; the force of the tick before was repeated",
    "BAD_IN": "a damaged frame arrived",
    "INTERPOLATED": "positions of lost frames were interpolated for the filters",
    "SEEDED": "the filters started again, at rest at this position",
    "LATE": "the tick woke more than a period late",
    "CLAMPED": "the force was limited",
    "NOT_FINITE": "a computed value was not a finite number",
    "WRITE_FAILED": "the frame could not be written",
    "RAMPING": "a parameter is on its ramp",
    "QUIET_RAMP": "the force ramps up after a gap",
    "EASED": "parameters wait for the limit of the force step",
    "DOUBTED": "the sample is implausible and not used yet; the motion is extrapolated",
    "GLITCH": "the samples before were glitches and were replaced",
    "BELIEVED": "the samples before were real motion",
    "PAUSED": "ramps wait for their energy budget",
    "CONTROLLED": "the energy controller set more active damping, or less K and B, than requested",
    "WITHHELD": "no frame was sent, to test the board's watchdog",
    "PROXY_HELD": "the proxy stays: its law is late or has no lease, or its energy is used up",
}
LATE_CAUSES = {
    "NONE": "the tick before was on time",
    "WAKE": "it woke late",
    "SUBMISSION": "the kernel took its transfers late (in flight)",
    "BUS": "the board got a frame late, or no frame came",
    "COMPLETION": "the board was in time, the end of the transfer was late",
    "TRANSFER": "a transfer was late, its part is not known (one after the other)",
    "STEP": "the computation of the force took long",
    "PUBLISH": "the work after the frame took long: record, replies, counters",
}
WATCHES = {
    "FORCE_AT_LIMIT": "the fault `force_at_limit` is on",
    "OVERSPEED": "the fault `overspeed` is on",
    "ENERGY": "the fault `energy` is on",
    "COMMISSIONING": "the signs of the device are not verified yet",
}
HOST = {
    "LINK_UP": "the board is connected",
    "GATEWAY_ALIVE": "the gateway's heartbeat arrives",
    "AMPLIFIER_TOLD": "the board reports whether its amplifier is ready",
    "DEVICE_DIFFERS": "the board contradicts its device file",
    "RATE_NOT_HELD": "the bus is too slow for the rate",
    "NO_TEMPERATURE": "the board does not measure the winding's temperature",
    "COMPENSATES": "the board has a resistance DAC that the servo moves",
}
STATUS = {
    "ENABLED": "the board grants torque",
    "WATCHDOG": "the board's watchdog has tripped",
    "BAD_FRAME": "the board received a damaged frame",
    "SEQ_GAP": "the board received a frame out of sequence",
    "FORCE_CLAMPED": "the board limited the torque",
    "FIFO_UNDERRUN": "the perturbation ran out of samples",
    "FIFO_OVERFLOW": "perturbation samples were dropped",
    "OVER_TEMPERATURE": "the board reports over-temperature",
    "AMPLIFIER_FAULT": "the amplifier reports a fault",
    "ENCODER_FAULT": "the encoder reports a fault",
    "INDEX": "the index mark of the encoder was passed",
    "PROBE_OVERFLOW": "probe samples were lost on the board",
    "EMERGENCY_STOP": "the emergency stop is pressed",
    "AMPLIFIER_READY": "the amplifier is ready",
    "SIMULATED": "the board is simulated",
}


def fields_table() -> str:
    """Return every field of the record with unit, type and meaning."""
    rows = [
        (f"`{name}`", UNITS.get(name, unit_of(name)), f"`{kind_of(name)}`", FIELDS[name])
        for name, *_ in TELEMETRY
    ]
    return table(("field", "unit", "type", "meaning"), rows)


def kind_of(name: str) -> str:
    """Return the numpy type of a field."""
    _, kind, *shape = next(field for field in TELEMETRY if field[0] == name)
    return f"{kind} x {shape[0][0]}" if shape else str(kind)


def bits() -> dict[str, dict[str, int]]:
    """Return the bit fields: each bit's value by name."""
    return {
        "flags": {flag.name: int(flag) for flag in Flag},
        "watches": {
            **{bit.name: int(bit) for bit in Watched},
            "COMMISSIONING": COMMISSIONING,
        },
        "host": {name: getattr(plan, name) for name in HOST},
        "status": {str(bit.name): int(bit) for bit in StatusBit},
    }


MEANINGS = {"flags": FLAGS, "watches": WATCHES, "host": HOST, "status": STATUS}


def bits_tables() -> str:
    """Return a table for each bit field, and one for the causes of late ticks."""
    parts = []
    for field, values in bits().items():
        rows = [
            (str(value), f"`{name}`", MEANINGS[field][name])
            for name, value in sorted(values.items(), key=lambda item: item[1])
        ]
        parts.append(f"### Bits of `{field}`\n\n{table(('value', 'name', 'meaning'), rows)}")
    rows = [(str(int(one)), f"`{one.name}`", LATE_CAUSES[one.name]) for one in LateCause]
    parts.append(f"### Values of `late_cause`\n\n{table(('value', 'name', 'meaning'), rows)}")
    return "\n".join(parts)
