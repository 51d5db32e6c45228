"""Measured values go into the device file; everything else there stays, and it stays valid."""

import datetime
import shutil
import tomllib
from pathlib import Path
from typing import Any

import pytest

from hapticd.core.errors import ConfigError
from hapticd.rig.certificate import changed, write_changes
from hapticd.rig.result import Change, rounded
from hapticd.settings.toml import shipped

DAY = datetime.date(2026, 3, 4)
TEMPLATE = shipped("config") / "devices" / "example-board.toml"


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return Path(shutil.copy(TEMPLATE, tmp_path / "own.toml"))


def test_a_value_is_replaced_and_every_comment_stays(file: Path) -> None:
    before = file.read_text()
    device = write_changes(file, [Change("force", "full_scale_n", 7.5)], "rig motor", DAY)
    assert device.force.full_scale_n == 7.5
    assert device.force.measured_on == DAY
    assert device.force.measured_by == "rig motor"
    after = file.read_text()
    assert after.count("#") == before.count("#")
    kept = [line for line in after.splitlines() if "measured_by" not in line]
    assert [line.partition("#")[2] for line in kept] == [
        line.partition("#")[2] for line in before.splitlines()
    ]
    old, new = tomllib.loads(before), tomllib.loads(after)
    assert {name: old[name] for name in old if name != "force"} == {
        name: new[name] for name in new if name != "force"
    }


def test_a_table_that_is_missing_is_added(file: Path) -> None:
    changes = [
        Change("commissioning", "signs_verified", True),
        Change("commissioning", "serial", "CHANGE-ME"),
    ]
    device = write_changes(file, changes, "rig motor", DAY)
    assert device.commissioning is not None
    assert device.commissioning.signs_verified
    assert device.commissioning.measured_on == DAY
    write_changes(file, changes, "rig motor", DAY)
    assert file.read_text().count("[commissioning]") == 1


def test_a_file_that_would_not_be_valid_leaves_the_old_one(file: Path) -> None:
    before = file.read_bytes()
    with pytest.raises(ConfigError, match="full_scale_n"):
        write_changes(file, [Change("force", "full_scale_n", -1.0)], "rig motor", DAY)
    assert file.read_bytes() == before
    assert [path.name for path in file.parent.iterdir()] == ["own.toml"]


MODEL = [
    Change("model", "effects", ("viscous", "coulomb")),
    Change("model.masses", "rotor_kg", 0.05),
    Change("model.motor", "torque_constant_nm_per_a", 0.12),
    Change("model.motor", "lever_m", 0.075),
    Change("model.motor", "resistance_ohm", 1.5),
    Change("model.viscous", "rotor_ns_per_m", 0.2),
    Change("model.coulomb", "rotor_n", 0.03),
]


def test_a_model_of_several_tables_is_written_and_dated(file: Path) -> None:
    """The source of an effect is a tag: how it was measured goes to its note."""
    device = write_changes(file, MODEL, "rig identify", DAY, "0.05 kg")
    assert device.model is not None
    assert device.model.effects == ("viscous", "coulomb")
    assert device.model.table("masses").rotor_kg == 0.05
    assert device.model.table("coulomb").source == "calibrated"
    assert device.model.table("coulomb").note == "rig identify: 0.05 kg"
    assert device.model.table("coulomb").measured_by == "rig identify"
    assert device.model.table("coulomb").measured_on == DAY
    again = [Change("model.coulomb", "rotor_n", 0.04), Change("model", "effects", ("coulomb",))]
    before = tomllib.loads(file.read_text())
    device = write_changes(file, again, "rig identify", DAY, "0.04 N")
    assert device.model is not None
    assert device.model.table("coulomb").rotor_n == 0.04
    after = tomllib.loads(file.read_text())
    assert after["model"].pop("coulomb") != before["model"].pop("coulomb")
    assert after["model"].pop("effects") != before["model"].pop("effects")
    assert after == before


def test_a_new_key_stands_with_its_table_and_not_below_the_comments_that_follow(file: Path) -> None:
    before = file.read_text().splitlines()
    write_changes(file, [Change("temperature", "offset_count", 12.0)], "rig temperature", DAY)
    after = file.read_text().splitlines()
    place = after.index("offset_count = 12.0")
    assert after[place - 1].startswith("source = ")
    assert after[place + 1] == 'measured_by = "rig temperature"'
    assert (
        after[place + 2 :] == before[before.index("# [resistance]" + before[place + 1][14:]) - 1 :]
    )


@pytest.mark.parametrize(
    "text",
    [
        "[model.masses]\nrotor_kg = 1.0\n[force]\nsign = 1\n[model.coulomb]\nrotor_n = 0.1\n",
        "[force]\r\nsign = 1  # seen\r\n\r\n[model.masses]\r\nrotor_kg = 1.0",
        "[model]\neffects = [\n  'a', # of the paper\n]\n[model.masses]\nrotor_kg = 1.0\n[force]\n",
    ],
    ids=["tables apart", "lines of Windows", "a list over lines"],
)
def test_other_ways_to_lay_out_a_file_are_written_as_well(text: str) -> None:
    values: Any = {
        ("model.masses", "rotor_kg"): 2.0,
        ("model", "effects"): ("b", "c"),
        ("model.motor", "winding_ohm"): 1.5,
        ("force", "sign"): -1,
    }
    found = tomllib.loads(changed(text, values))
    assert found["model"]["masses"] == {"rotor_kg": 2.0}
    assert found["model"]["effects"] == ["b", "c"]
    assert found["model"]["motor"] == {"winding_ohm": 1.5}
    assert found["force"] == {"sign": -1}


def test_an_offset_alone_leaves_the_source_of_the_gain(file: Path) -> None:
    write_changes(file, [Change("force", "full_scale_n", 7.5)], "rig motor", DAY, "gain")
    device = write_changes(file, [Change("force", "offset_count", 9.0)], "rig motor", DAY, "offset")
    assert device.force.source == "rig motor: gain"
    both = [Change("force", "full_scale_n", 7.4), Change("force", "offset_count", 8.0)]
    assert write_changes(file, both, "rig motor", DAY, "both").force.source == "rig motor: both"


def test_half_widths_stand_beside_what_was_measured_and_go_with_the_next_measurement(
    file: Path,
) -> None:
    known = [Change("force", "full_scale_n", 7.5, 0.012)]
    assert write_changes(file, known, "rig motor", DAY).force.half_width_95 == {
        "full_scale_n": 0.012
    }
    assert "half_width_95 = {full_scale_n = 0.012}" in file.read_text()
    unknown = [Change("force", "full_scale_n", 7.4)]
    assert write_changes(file, unknown, "rig motor", DAY).force.half_width_95 == {}


def test_a_step_that_is_none_and_a_width_of_nothing_are_refused(file: Path) -> None:
    """A misspelt step would grant no tolerance, and nobody would see why."""
    with pytest.raises(ConfigError, match=r"force\.measured_by = 'rig moter': must be 'rig"):
        write_changes(file, [Change("force", "full_scale_n", 7.5)], "rig moter", DAY)
    text = file.read_text().replace("[force]", "[force]\nhalf_width_95 = { full_scale = 1.0 }")
    file.write_text(text)
    with pytest.raises(ConfigError, match="'full_scale' is not a key of this table"):
        write_changes(file, [Change("force", "sign", 1)], "rig motor", DAY)


def test_a_file_that_is_no_toml_any_more_is_named_and_left(file: Path) -> None:
    file.write_text("[force\n")
    with pytest.raises(ConfigError, match=r"own\.toml:1"):
        write_changes(file, [Change("force", "sign", -1)], "rig motor", DAY)
    assert file.read_text() == "[force\n"


def test_who_may_read_the_file_stays(file: Path) -> None:
    file.chmod(0o640)
    write_changes(file, [Change("force", "sign", -1)], "rig motor", DAY)
    assert file.stat().st_mode & 0o777 == 0o640


def test_what_is_not_understood_is_refused_and_says_what_to_write() -> None:
    text = 'force = { full_scale_n = 8.0, source = "here" }\n'
    with pytest.raises(ConfigError, match=r"force\.full_scale_n = 7\.5"):
        changed(text, {("force", "full_scale_n"): 7.5})


def test_hashes_in_text_are_no_comments() -> None:
    text = '[force]\nsource = "board #3"  # whose\nsign = 1\n[position]\nsign = 1\n'
    found = changed(text, {("force", "source"): 'say "now"', ("position", "sign"): -1})
    assert tomllib.loads(found) == {
        "force": {"source": 'say "now"', "sign": 1},
        "position": {"sign": -1},
    }
    assert "# whose" in found


def test_the_shipped_template_is_not_written_into() -> None:
    with pytest.raises(ConfigError, match="copy it"):
        write_changes(TEMPLATE, [Change("force", "sign", -1)], "rig motor", DAY)


def test_a_value_has_digits_down_to_a_hundredth_of_its_interval() -> None:
    assert rounded(7.98765432, 7.9, 8.1) == 7.988
    assert rounded(7.98765432, 8.0, 8.0) == 7.98765
