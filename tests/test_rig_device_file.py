"""Measured values go into the device file; everything else there stays, and it stays valid."""

import datetime
import shutil
import tomllib
from pathlib import Path

import pytest

from hapticd.errors import ConfigError
from hapticd.rig.device_file import changed, write
from hapticd.rig.result import Change, rounded
from hapticd.settings.toml import shipped

DAY = datetime.date(2026, 3, 4)
TEMPLATE = shipped("config") / "devices" / "example-board.toml"


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return Path(shutil.copy(TEMPLATE, tmp_path / "own.toml"))


def test_a_value_is_replaced_and_every_comment_stays(file: Path) -> None:
    before = file.read_text()
    device = write(file, [Change("force", "full_scale_n", 7.5)], "rig motor", DAY)
    assert device.force.full_scale_n == 7.5
    assert device.force.date == DAY
    assert device.force.source == "rig motor"
    after = file.read_text()
    assert [line.partition("#")[2] for line in after.splitlines()] == [
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
    device = write(file, changes, "rig motor", DAY)
    assert device.commissioning is not None
    assert device.commissioning.signs_verified
    assert device.commissioning.date == DAY
    write(file, changes, "rig motor", DAY)
    assert file.read_text().count("[commissioning]") == 1


def test_a_file_that_would_not_be_valid_leaves_the_old_one(file: Path) -> None:
    before = file.read_bytes()
    with pytest.raises(ConfigError, match="full_scale_n"):
        write(file, [Change("force", "full_scale_n", -1.0)], "rig motor", DAY)
    assert file.read_bytes() == before
    assert [path.name for path in file.parent.iterdir()] == ["own.toml"]


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
        write(TEMPLATE, [Change("force", "sign", -1)], "rig motor", DAY)


def test_a_value_has_digits_down_to_a_hundredth_of_its_interval() -> None:
    assert rounded(7.98765432, 7.9, 8.1) == 7.988
    assert rounded(7.98765432, 8.0, 8.0) == 7.98765
