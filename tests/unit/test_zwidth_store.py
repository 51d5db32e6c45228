"""Run folders and the store of trials, in the state in which accidents leave them."""

import pytest

from hapticd.core.errors import ConfigError
from hapticd.zwidth.store import TrialStore, read_summary, write_run

WHOLE = '{"key": "a", "x": 1}\n'


@pytest.mark.parametrize("line", ["3", "null", "[]", '"text"', '{"x": 1}', "{", "\x00"])
def test_foreign_lines_are_passed_over(tmp_path, line):
    path = tmp_path / "trials.jsonl"
    path.write_text(f"{WHOLE}{line}\n")
    assert TrialStore(path).known == {"a": {"x": 1}}


def test_bytes_that_are_no_text_cost_their_line_alone(tmp_path):
    path = tmp_path / "trials.jsonl"
    path.write_bytes(b"\xff\xfe\n" + WHOLE.encode())
    assert TrialStore(path).known == {"a": {"x": 1}}


def test_torn_line_is_cut_off_without_writing_the_rest_anew(tmp_path):
    """Whoever dies while it is rewritten would lose every trial."""
    path = tmp_path / "trials.jsonl"
    path.write_text(WHOLE + '{"key": "b"')
    before = path.stat()
    assert TrialStore(path).known == {"a": {"x": 1}}
    assert path.read_text() == WHOLE
    assert path.stat().st_ino == before.st_ino


def test_store_that_cannot_be_read_is_named(tmp_path):
    (tmp_path / "trials.jsonl").mkdir()
    with pytest.raises(ConfigError, match=r"trials\.jsonl: .*name a folder"):
        TrialStore(tmp_path / "trials.jsonl")


def test_full_disk_is_named(tmp_path):
    (tmp_path / "more.csv").symlink_to("/dev/full")
    (tmp_path / "run.json").write_text("{}")
    with pytest.raises(
        ConfigError,
        match=r"No space left on device; name a folder that you may write to with --out",
    ):
        write_run(tmp_path, {"x": 1}, texts={"more.csv": "f"})
    assert not (tmp_path / "run.json").exists()  # who finds one finds all that belongs to it


@pytest.mark.parametrize("content", ["[1]", "3", "null", "{"])
def test_summary_that_is_none_is_refused(tmp_path, content):
    (tmp_path / "run.json").write_text(content)
    with pytest.raises(ConfigError, match=r"no run folder"):
        read_summary(tmp_path)


def test_trials_that_were_not_written_are_not_kept(tmp_path):
    """Who is told that they are would go on from there."""
    (tmp_path / "trials.jsonl").symlink_to("/dev/full")
    with pytest.raises(ConfigError, match=r"trials\.jsonl: no file; name a folder"):
        TrialStore(tmp_path / "trials.jsonl")
    store = TrialStore(tmp_path / "file" / "trials.jsonl")
    (tmp_path / "file").touch()
    with pytest.raises(ConfigError, match=r"name a folder that you may write to with --out"):
        store.add([("a", {"x": 1})])
    assert store.known == {}
