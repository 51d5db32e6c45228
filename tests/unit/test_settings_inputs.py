"""What somebody names to be read is a regular file, or one clear error at once: nothing waits for
the other end of a pipe, and nothing reads a device for ever.
"""

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from hapticd.cli.app import main
from hapticd.core.errors import ConfigError
from hapticd.protocol.flight import SUFFIX
from hapticd.recording.file import open_recording
from hapticd.settings.load import find_config, load
from hapticd.settings.toml import MIB, SETTINGS_BYTES, read, regular
from hapticd.zwidth.portable import read_portable
from hapticd.zwidth.recorded import read_file

READERS: list[tuple[str, Callable[[Path], object]]] = [
    ("a.toml", load),
    ("a.toml", lambda path: read(find_config(path))),
    ("a.h5", open_recording),
    ("a" + SUFFIX, open_recording),
    ("a.h5", read_file),
    ("a.csv", read_file),
    ("a.json", read_portable),
]


def pipe(path: Path) -> None:
    os.mkfifo(path)


def device(path: Path) -> None:
    path.symlink_to("/dev/zero")


def folder(path: Path) -> None:
    path.mkdir()


@pytest.mark.timeout(20)
@pytest.mark.parametrize("made", [pipe, device])
@pytest.mark.parametrize(("name", "reader"), READERS)
def test_what_is_no_regular_file_is_refused_at_once(
    tmp_path: Path, name: str, reader: Callable[[Path], object], made: Callable[[Path], None]
) -> None:
    made(tmp_path / name)
    with pytest.raises(ConfigError, match=f"{name} is not a regular file"):
        reader(tmp_path / name)


@pytest.mark.timeout(20)
def test_device_file_that_is_a_pipe_is_refused_at_once(tmp_path: Path) -> None:
    pipe(tmp_path / "board.toml")
    (tmp_path / "hapticd.toml").write_text('device = "board.toml"')
    with pytest.raises(ConfigError, match=r"board\.toml is not a regular file"):
        load(tmp_path / "hapticd.toml")


@pytest.mark.timeout(20)
def test_waveform_that_is_a_pipe_is_refused_at_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pipe(tmp_path / "push.txt")
    assert main(["perturb", "load", str(tmp_path / "push.txt")]) == ConfigError.exit_code
    assert "push.txt is not a regular file" in capsys.readouterr().err


def test_folder_is_not_said_to_be_absent(tmp_path: Path) -> None:
    folder(tmp_path / "a.h5")
    with pytest.raises(ConfigError, match=r"a\.h5 is not a regular file"):
        open_recording(tmp_path / "a.h5")


def test_file_that_is_too_large_is_refused_with_the_limit(tmp_path: Path) -> None:
    path = tmp_path / "a.toml"
    path.touch()
    os.truncate(path, SETTINGS_BYTES)
    assert regular(path, SETTINGS_BYTES) == path
    os.truncate(path, 100 * MIB)
    with pytest.raises(ConfigError, match=r"a\.toml has 100 MiB, at most 4 MiB are read"):
        read(path)


@pytest.mark.parametrize("opening", ["[", "{a="])
def test_tables_that_are_nested_too_deeply_are_refused(tmp_path: Path, opening: str) -> None:
    path = tmp_path / "a.toml"
    path.write_text(f"x = {opening * 20_000}")
    with pytest.raises(ConfigError, match=r"a\.toml: tables or lists are nested too deeply"):
        read(path)


@pytest.mark.parametrize("configuration", ['{"a"', "[]", "{}", "5", '{"safety": 3}'])
def test_recording_with_a_damaged_configuration_is_refused(
    recording_file: Path, configuration: str
) -> None:
    with open_recording(recording_file) as recording:
        recording.attributes = {**recording.attributes, "configuration": configuration}
        with pytest.raises(ConfigError, match="or damaged"):
            _ = recording.params
