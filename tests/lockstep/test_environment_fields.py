"""Every field of the environment's table goes all the way: from a word at the shell through the
message, guard, mailbox, law and record into a recording, and back.
"""

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.boards import board_params
from support.models import servo_params
from support.recorded import RecordedFlight, recorded_into

from benchmarks.guard_attack import shipped_judge
from benchmarks.guarded_stack import GuardedStack
from hapticd.cli.change import changes
from hapticd.core.environment import FIELDS, Environment, EnvironmentField, WorkspaceParams
from hapticd.mailbox.layout import COMMAND_VALUES, Command
from hapticd.protocol.limits import CommandLimits
from hapticd.recording.file import open_recording
from hapticd.render.law import constant
from hapticd.run.lockstep import LockStep
from hapticd.servo.plan import environment_of

FIXED = {"workspace", "velocity_filter.mapping", "acceleration_filter.mapping"}
COUNT_NS_PER_M = 2e-4  # of the simulated board's active damping
KEYS = pytest.mark.parametrize("field", FIELDS, ids=lambda one: one.key)


def leaves(kind: Any, prefix: str = "") -> Iterator[str]:
    """Paths of all numbers of a dataclass."""
    for one in dataclasses.fields(kind):
        path = f"{prefix}{one.name}"
        inner = one.default if one.default is not dataclasses.MISSING else None
        if path in FIXED:
            continue
        if dataclasses.is_dataclass(inner):
            yield from leaves(type(inner), f"{path}.")
        else:
            yield path


def asked_value(field: EnvironmentField) -> float:
    """A value that the device allows and that is not the one it starts with."""
    if field.key == "wall.side":
        return -1.0
    limit = CommandLimits.announced(servo_params()).of[field.key]
    return round(limit.low + 0.3 * (limit.high - limit.low), 4)


def inside(message: dict[str, Any], key: str) -> Any:
    table, _, leaf = key.rpartition(".")
    return (message[table] if table else message)[leaf]


def test_environment_has_no_number_without_a_row_in_the_table() -> None:
    assert sorted(one.path for one in FIELDS) == sorted(leaves(Environment))
    slots = [one.slot for one in FIELDS]
    assert len(set(slots)) == len(slots)


@KEYS
def test_field_reaches_guard_mailbox_law_and_record(field: EnvironmentField) -> None:
    value = asked_value(field)
    start = inside(Environment().message(), field.key)
    assert value != start
    with LockStep(servo_params(), board_params()) as stack:
        guarded = GuardedStack(stack, shipped_judge().answer, "warn")
        given = changes([f"{field.key}={value:g}"])
        reply = guarded.ask(cmd="set", **given)
        effective = inside(reply["receipt"]["effective"], field.key)
        assert effective == pytest.approx(value, abs=COUNT_NS_PER_M)
        question = next(one for one in guarded.line.asked if one["ask"] == "change")
        assert inside(question["change"], field.key) == pytest.approx(value)
        guarded.run(1000)
        target = guarded.guard.in_force.target()
        assert inside(target.message(), field.key) == pytest.approx(value, abs=COUNT_NS_PER_M)
        if field.column and field.ramped:
            assert guarded.view.record[field.column] == pytest.approx(value, abs=COUNT_NS_PER_M)
        assert any(abs(one - value) < COUNT_NS_PER_M for one in law_numbers(stack))


def law_numbers(stack: LockStep) -> list[float]:
    """What the tick goes by, with the whole gain: the law's inputs, filters and active damping."""
    plan = stack.loop.state[0].plan._replace(gain=constant(1.0))
    inputs = environment_of(plan, stack.loop.tick, WorkspaceParams(), 1.0)
    filters = [number for one in plan.filters for number in (one.frequency_hz, one.damping_ratio)]
    return [*inputs, *filters, plan.active_damping_asked]


def test_whole_environment_comes_back_from_its_row_and_its_message() -> None:
    rows = {one.path: asked_value(one) for one in FIELDS}
    whole = Environment().with_values(rows)
    row = [whole.row().get(place, 0.0) for place in range(COMMAND_VALUES)]
    assert Environment().with_slots(dict(enumerate(row))) == whole
    assert Environment().changed(whole.message()) == whole
    assert whole.fields({"wall": {"side": 0}, "K": 0}) == {
        "wall": {"side": -1},
        "K": whole.stiffness_n_per_m,
    }


def test_columns_of_the_table_are_recorded_and_read_back(tmp_path: Path) -> None:
    ramped = [one for one in FIELDS if one.ramped]
    with RecordedFlight() as flight:
        flight.stack.run(5)
        flight.stack.do(Command.SET, {one.slot: asked_value(one) for one in ramped})
        flight.fly(300)
        recorded_into(tmp_path / "one.h5", flight)
    with open_recording(tmp_path / "one.h5") as recording:
        for one in ramped:
            if one.column:
                last = recording.column("servo", one.column)[-1]
                np.testing.assert_allclose(last, asked_value(one), err_msg=one.key)
