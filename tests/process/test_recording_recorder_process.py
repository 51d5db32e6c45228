"""A recorder ends in order, says gaps, and loses little when it is killed or crowded."""

import json
import resource
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import h5py
import pytest
from support.recorded import RecordedFlight

from hapticd.recording import pack
from hapticd.recording.file import open_recording

DEADLINE_S = 60


HALF_WAY = """
import pickle, sys, time
from pathlib import Path
from hapticd.recording.live import Writer
messages = pickle.load(open(sys.argv[1], "rb"))
names = ("schema", "simulated", "configuration", "layout")
writer = Writer(Path(sys.argv[2]), dict(zip(names, ("hapticd-recording/1", 1, *sys.argv[3:]))))
for place, (topic, payload) in enumerate(messages):
    writer.take(topic, payload)
    if place % 20 == 19:
        writer.write()
        print(writer.records, flush=True)
print("all", flush=True)
time.sleep(600)
"""


def write_elsewhere(
    recorded_run: RecordedFlight, folder: Path, **more: Any
) -> "subprocess.Popen[str]":
    """A process that writes all messages into run.part.h5, saying how many records it has
    flushed.
    """
    import pickle

    from hapticd.core.params import to_plain
    from hapticd.mailbox.layout import LAYOUT_HASH

    (folder / "messages").write_bytes(pickle.dumps(recorded_run.messages))
    arguments = [
        str(folder / "messages"),
        str(folder / "run.part.h5"),
        json.dumps(to_plain(recorded_run.params)),
        LAYOUT_HASH.hex(),
    ]
    return subprocess.Popen(
        [sys.executable, "-c", HALF_WAY, *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        **more,
    )


@pytest.fixture
def writing(recorded_run: RecordedFlight, tmp_path: Path) -> Iterator["subprocess.Popen[str]"]:
    process = write_elsewhere(recorded_run, tmp_path)
    yield process
    process.kill()
    process.communicate(timeout=DEADLINE_S)


@pytest.mark.process
def test_killed_recorder_loses_nothing_that_was_flushed(
    writing: "subprocess.Popen[str]", recorded_run: RecordedFlight, tmp_path: Path
) -> None:
    assert writing.stdout
    flushed = [int(writing.stdout.readline()) for _ in range(10)][-1]
    writing.send_signal(signal.SIGKILL)
    writing.wait(DEADLINE_S)
    part = tmp_path / "run.part.h5"
    final = tmp_path / "run.h5"
    with pytest.raises(OSError, match=r"."):
        h5py.File(part, "r")
    summary = pack.pack(part, final, recovered=True)
    assert summary["records"] >= flushed
    with open_recording(final) as recording:
        assert recording.attributes["recovered"] == 1
        records = recording.records(0, summary["records"])
    assert records.tobytes() == recorded_run.recorded[: len(records)].tobytes()  # type: ignore[attr-defined]
    assert not part.exists()


@pytest.mark.process
def test_live_file_can_be_read_meanwhile(writing: "subprocess.Popen[str]", tmp_path: Path) -> None:
    assert writing.stdout
    flushed = int(writing.stdout.readline())
    with open_recording(tmp_path / "run.part.h5") as recording:
        assert recording.rows["servo"] >= flushed


@pytest.mark.process
def test_full_disk_keeps_what_was_flushed(recorded_run: RecordedFlight, tmp_path: Path) -> None:
    limit = 1 << 20
    process = write_elsewhere(
        recorded_run,
        tmp_path,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit)),
    )
    out, err = process.communicate(timeout=DEADLINE_S)
    assert process.returncode != 0
    assert "File too large" in err or "OSError" in err or "RuntimeError" in err
    summary = pack.pack(tmp_path / "run.part.h5", tmp_path / "run.h5", recovered=True)
    assert summary["records"] >= int(out.split()[-1]) > 500
    with open_recording(tmp_path / "run.h5") as recording:
        records = recording.records(0, summary["records"])
    assert records.tobytes() == recorded_run.recorded[: len(records)].tobytes()  # type: ignore[attr-defined]
