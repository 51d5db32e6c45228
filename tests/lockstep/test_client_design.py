"""Orders of conditions, and their table against the whole stack on virtual time."""

import csv
from collections import Counter

import numpy as np
import pytest
from support.boards import board_params
from support.models import servo_params

from hapticd.client.blocks import BlockDecoder
from hapticd.client.design import Condition, Table, blocks, joined, pairs, sweep
from hapticd.core.errors import ConfigError
from hapticd.run.lockstep import LockStepClient

A = Condition("soft", {"K": 100.0})
B = Condition("stiff", {"K": 120.0})


def named(conditions):
    return Counter(one.name for one in conditions)


def test_a_sweep_has_every_combination_once():
    found = sweep(K=(100, 200, 400), B=(1, 2))
    assert [tuple(one.settings.values()) for one in found] == [
        (100, 1), (100, 2), (200, 1), (200, 2), (400, 1), (400, 2),
    ]  # fmt: skip
    assert found[1].name == "K 100, B 2"


def test_each_block_has_each_condition_once_in_an_order_of_its_own():
    conditions = sweep(K=range(8))
    found = blocks(conditions, 20, seed=3)
    assert all(named(block) == Counter(one.name for one in conditions) for block in found)
    assert len({tuple(one.name for one in block) for block in found}) == 20
    assert found == blocks(conditions, 20, seed=3)
    assert found != blocks(conditions, 20, seed=4)


def test_every_condition_comes_first_about_equally_often():
    """Chi-square of 4 places, 0.1 % beyond 16.3."""
    conditions = sweep(K=range(4))
    firsts = named(block[0] for block in blocks(conditions, 4000, seed=5))
    assert sum((count - 1000) ** 2 / 1000 for count in firsts.values()) < 16.3


def test_half_of_the_pairs_begin_with_a():
    found = pairs(A, B, 40, seed=1)
    firsts = [first.name for first, _ in found]
    assert Counter(firsts) == {"soft": 20, "stiff": 20}
    assert all({first.name, second.name} == {"soft", "stiff"} for first, second in found)
    assert firsts != sorted(firsts)
    with pytest.raises(ConfigError, match="7 pairs"):
        pairs(A, B, 7, seed=1)


def test_rows_get_exactly_the_ticks_in_which_they_were_in_force(tmp_path):
    path = tmp_path / "session.csv"
    order = [one for block in blocks([A, B], 3, seed=2) for one in block]
    decoder = BlockDecoder()
    records = []
    with LockStepClient(servo_params(), board_params()) as device, Table(path, ("felt",)) as table:
        device.enable()
        for message in device.messages(("servo.raw",)):
            if message is not None:
                records.append(decoder.decode(message[1]).records)
            elif order:
                condition = order.pop(0)
                table.begin(device.set(**condition.settings, ramp_s=0.05), condition)
                table.answer(felt=condition.name)
            else:
                break
    ticks = np.concatenate(records)
    found = list(joined(path, ticks))
    assert len(found) == 6
    for row, part in found:
        stiffness = {"soft": 100.0, "stiff": 120.0}[row["condition"]]
        assert row["felt"] == row["condition"]
        assert float(row["K"]) == stiffness
        assert (part["stiffness_n_per_m"] == stiffness).all()
        assert (np.diff(part["tick"].astype(int)) == 1).all()
        assert part["tick"][0] == int(row["ramp_end_tick"])
        assert len(part) > 400  # of a block of 500, the ramp left out


def test_a_row_is_on_the_disk_before_the_next_condition_begins(tmp_path):
    path = tmp_path / "session.csv"
    with LockStepClient(servo_params(), board_params()) as device, Table(path) as table:
        device.enable()
        for condition in (A, B):
            table.begin(device.set(**condition.settings), condition)
        with path.open(newline="") as file:
            assert [row["condition"] for row in csv.DictReader(file)] == ["soft"]
    with path.open(newline="") as file:
        assert [row["condition"] for row in csv.DictReader(file)] == ["soft", "stiff"]


def test_a_session_does_not_overwrite_another_nor_invent_columns(tmp_path):
    path = tmp_path / "session.csv"
    with Table(path, ("felt",)) as table, pytest.raises(ConfigError, match="the table has felt"):
        table.answer(response=1)
    with pytest.raises(ConfigError, match="exists"):
        Table(path)
