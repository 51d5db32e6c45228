"""record, rec, dump and replay from the command line; the way from a live toggle to the plot of
another one.
"""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from support.daemon import DEADLINE_S, Daemon, until

from hapticd.cli.app import main


@pytest.mark.process
def test_from_a_live_toggle_to_the_plot_of_another(
    runtime: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    part = tmp_path / "toggle.part.h5"
    final = tmp_path / "toggle.h5"
    with Daemon(runtime) as daemon:
        for words in (["set", "K=50", "B=2"], ["enable"]):
            assert daemon.cli(*words) == 0
        command = [
            sys.executable,
            "-m",
            "hapticd",
            "record",
            str(final),
            "--instance",
            daemon.instance,
        ]
        recording = subprocess.Popen(command, stdout=subprocess.DEVNULL)
        try:
            size = until(
                lambda: part.exists() and part.stat().st_size > 500_000 and part.stat().st_size,
                "it records",
            )
            assert daemon.cli("damping", "on") == 0
            until(lambda: part.stat().st_size > size + 1_000_000, "it goes on")
        finally:
            recording.send_signal(signal.SIGKILL)
            recording.wait(DEADLINE_S)
        assert daemon.cli("dump") == 0
        flight = Path(capsys.readouterr().out.splitlines()[-1].partition(": ")[0])
        assert flight.stat().st_size > 500_000
    assert main(["rec", "recover", str(part)]) == 0
    assert main(["replay", str(final), "--json"]) == 0
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["bit_exact"] is True
    assert main(["replay", str(final), "--set", "B=0.5"]) == 0
    assert (tmp_path / "toggle-replay.png").stat().st_size > 10_000
    assert main(["replay", str(flight)]) == 0


@pytest.mark.process
def test_interrupt_ends_a_recording_in_order(runtime: Path, tmp_path: Path) -> None:
    with Daemon(runtime) as daemon:
        command = [
            sys.executable,
            "-m",
            "hapticd",
            "record",
            str(tmp_path / "a.h5"),
            "--instance",
            daemon.instance,
            "--json",
        ]
        recording = subprocess.Popen(command, stdout=subprocess.PIPE, env={**os.environ})
        until(
            lambda: (
                (tmp_path / "a.part.h5").exists()
                and (tmp_path / "a.part.h5").stat().st_size > 300_000
            ),
            "it records",
        )
        recording.send_signal(signal.SIGINT)
        out, _ = recording.communicate(timeout=DEADLINE_S)
    told = json.loads(out)
    assert (recording.returncode, told["ended"], told["missing"]["servo"]) == (0, "stopped", 0)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.h5"]
