"""Replay a recorded motion through `servo.step`, bit by bit as recorded or with other settings.

A segment is a sequence of records without a gap that begins with a checkpoint. Every tick gets its
recorded input: the sample of its IN frame, its arrival, the host's information, and the requests
that it obeyed. So every number that step computed is reproduced; a difference means another program
or a damaged file. A counterfactual replay holds some settings at other values and ignores later
requests for them. The motion remains the recorded one, so the result shows the command of the law,
not the motion that would have followed.

A step must not read a clock or the mailbox, and every request must be recorded.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapticd.core.arrays import Records
from hapticd.core.params import ServoParams
from hapticd.core.units import US_PER_S
from hapticd.mailbox.client_side import Noted
from hapticd.mailbox.layout import (
    COMPUTED_FIELDS,
    PLAN_FIELDS,
    Command,
    Flag,
    Value,
    values_of,
)
from hapticd.servo.plan import (
    Request,
    ServoState,
    coefficients_of,
    in_slots,
    masked_places,
    unflatten,
    with_values,
)
from hapticd.servo.slow_path import refiltered
from hapticd.servo.step import make_step
from hapticd.usb import codec, frames

__all__ = ["Difference", "Segment", "difference", "replay"]


# columns of a replay: the plan of each tick, then the results of step
PLAN_DTYPE = np.dtype(list(PLAN_FIELDS))
PLAN_NAMES = tuple(str(field[0]) for field in PLAN_FIELDS)
COMPUTED = [("flags", "<u4"), ("torque", "<i4"), ("damping", "<u4"), *COMPUTED_FIELDS]
REPLAYED = np.dtype([*PLAN_FIELDS, *COMPUTED])
LOOP_FLAGS = int(Flag.LATE | Flag.WRITE_FAILED)  # set by the loop, not by step
_TORQUE_PLACE = frames.OUT_OFFSETS["torque"]
_DAMPING_PLACE = frames.OUT_OFFSETS["damping"]
_EFFECT_PLACE = frames.IN_OFFSETS["torque_age_us"]


class Segment(NamedTuple):
    """Initial state and input of a replay."""

    tick: int  # of the first record
    state: Any  # before that tick, flat, as servo.plan.flatten writes it
    records: Records  # (n,), without a gap
    requests: Sequence[Noted]  # obeyed requests


class Difference(NamedTuple):
    """The first number that differs."""

    tick: int
    field: str
    recorded: Any
    replayed: Any


def replay(
    params: ServoParams, segment: Segment, instead: dict[Value, float] | None = None
) -> NDArray[np.void]:
    """Return the results of step at each tick of `segment`: array of REPLAYED (n,).

    Settings in `instead` are held at these values from the start.
    """
    if instead:
        # the motion does not respond to this law, so its energy has no meaning
        params = replace(params, safety=replace(params.safety, limit_cycle_faults=False))
    step = make_step(params)
    state = unflatten(segment.state)
    obeyed = _by_tick(segment.requests)
    records = segment.records
    # time, and delay of the force in effect [periods], as passed to step by the loop
    slots: list[int] = records["slot"].tolist()
    periods_per_us = params.realtime.rate_hz / US_PER_S
    delays = [delay_us * periods_per_us for delay_us in records["delay_us"].tolist()]
    if instead:
        state = _held(state, instead, slots[0], params)
        obeyed = {
            tick: tuple(_without(one, set(instead)) for one in requests)
            for tick, requests in obeyed.items()
        }
    unpack = frames.IN_HEAD.unpack
    size = frames.IN_HEAD.size
    heads = records["in_frame"].tolist()
    head = unpack(heads[0][:size])
    damping = 0
    blobs = []
    rows = []
    columns = (records[name].tolist() for name in ("tick", "arrival", "host"))
    for tick, arrival, host, frame, delay, slot in zip(*columns, heads, delays, slots, strict=True):
        if arrival >= 0:
            head = unpack(frame[:size])
            _, damping, _ = frames.IN_EFFECT.unpack_from(frame, _EFFECT_PLACE)
        sample = (
            head[codec.HEAD_ENCODER],
            head[codec.HEAD_STATUS],
            head[codec.HEAD_TEMPERATURE],
            arrival,
            host,
            head[codec.HEAD_INDEX_OFFSET],
            delay,
            head[codec.HEAD_CURRENT],
            damping,
        )
        requests = in_slots(obeyed.get(tick, ()), slot - tick)
        state, (torque, *numbers, flags, _) = step(state, requests, sample, slot)
        settled, _, (work, excess, *_), _, _ = state
        blobs.append(settled.blob)
        rows.append((flags, torque, settled.damping_count, *numbers, work, excess))
    return _assembled(blobs, rows)


def _assembled(blobs: list[bytes], rows: list[tuple[Any, ...]]) -> NDArray[np.void]:
    replayed = np.empty(len(rows), REPLAYED)
    plans = np.frombuffer(b"".join(blobs), PLAN_DTYPE)
    for name in PLAN_NAMES:
        replayed[name] = plans[name]
    for field, column in zip(COMPUTED, zip(*rows, strict=True), strict=True):
        replayed[field[0]] = column
    return replayed


def difference(records: Records, replayed: NDArray[np.void]) -> Difference | None:
    """Return the first difference of `replayed` from the records, bit by bit; None if there is
    none.
    """
    for name in (*PLAN_NAMES, *(str(field[0]) for field in COMPUTED)):
        recorded = recorded_column(records, name)
        again = replayed[name]
        places = np.flatnonzero(_bits(recorded) != _bits(again))
        if places.size:
            place = int(places[0]) // (again.size // len(again))
            return Difference(
                int(records["tick"][place]), name, recorded[place].tolist(), again[place].tolist()
            )
    return None


def recorded_column(records: Records, name: str) -> NDArray[Any]:
    """Return the recorded column for the name `name` in REPLAYED."""
    if name == "flags":
        return np.asarray(records["flags"] & ~np.uint32(LOOP_FLAGS))
    if name in ("torque", "damping"):
        frame = np.ascontiguousarray(records["out_frame"]).view(np.uint8).reshape(len(records), -1)
        place, kind = (_TORQUE_PLACE, "<i2") if name == "torque" else (_DAMPING_PLACE, "<u2")
        sent = np.ascontiguousarray(frame[:, place : place + 2]).view(kind).ravel()
        return np.asarray(sent.astype(REPLAYED[name]))
    return np.asarray(records[name])


def _bits(column: NDArray[Any]) -> NDArray[np.uint64] | NDArray[Any]:
    """Return doubles as integers, so that NaN equals NaN and -0.0 differs from 0.0."""
    flat = column.ravel()
    return flat.view(np.uint64) if flat.dtype == np.float64 else flat


def _by_tick(requests: Sequence[Noted]) -> dict[int, tuple[Request, ...]]:
    found: dict[int, tuple[Request, ...]] = {}
    for one in requests:
        found[one.tick] = (
            *found.get(one.tick, ()),
            (one.seq, one.kind, one.actor, one.apply_tick, tuple(one.values)),
        )
    return found


# --- the counterfactual ---------------------------------------------------------------------------


def _without(request: Request, held: set[Value]) -> Request:
    """Return `request` without the held settings."""
    seq, kind, actor, apply_tick, values = request
    if kind not in (Command.SET, Command.DAMPING):
        return request
    return seq, kind, actor, apply_tick, _unmasked(values, held)


def _unmasked(values: tuple[float, ...], held: set[Value]) -> tuple[float, ...]:
    mask = sum(1 << place for place in masked_places(values) if place not in held)
    return (float(mask), *values[1:])


def _held(
    state: ServoState, instead: dict[Value, float], tick: int, params: ServoParams
) -> ServoState:
    """Return `state` with the settings of `instead` in force since before `tick`. ConfigError for
    an impossible filter.
    """
    settled, law, ledger, held, signs = state
    scheduled = tuple(
        one._replace(values=_unmasked(one.values, set(instead))) for one in settled.plan.scheduled
    )
    plan, _ = with_values(
        settled.plan._replace(scheduled=scheduled, limit_cycle_faults=False),
        values_of({**instead, Value.RAMP_S: 0.0}),
        tick - 1,
        params,
    )
    coefficients = settled.coefficients
    if plan.filters != settled.plan.filters:
        coefficients = coefficients_of(plan, params.realtime.rate_hz)
        law = refiltered(law, settled.coefficients, coefficients)
    settled = replace(settled, plan=plan, coefficients=coefficients, wake_tick=tick)
    return settled, law, ledger, held, signs
