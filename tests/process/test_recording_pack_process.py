"""The final file and its exports: plain, compressed, whole or absent, open to other programs."""

import os
import subprocess
from pathlib import Path

import numpy as np
import pytest
from support.programs import program

from hapticd.recording.file import open_recording

DEADLINE_S = 60


@pytest.mark.process
def test_octave_opens_it(recording_file: Path, tmp_path: Path) -> None:
    octave = program("octave-cli")
    script = f"""
        r = load('{recording_file}');
        printf('%d %.17g ', numel(r.servo.force_n), max(abs(r.servo.position_m)));
        printf('%s %s\\n', class(r.servo.tick), class(r.event));
        printf('%d\\n', numel(r.probe.torque_n));
    """
    environment = {**os.environ, "HOME": str(tmp_path)}
    done = subprocess.run(
        [octave, "--norc", "--eval", script],
        capture_output=True,
        text=True,
        env=environment,
        timeout=DEADLINE_S,
    )
    lines = done.stdout.split()
    with open_recording(recording_file) as recording:
        position = recording.column("servo", "position_m")
        assert lines == [
            str(len(position)),
            f"{np.abs(position).max():.17g}",
            "int64",
            "struct",
            str(recording.rows["probe"]),
        ], done.stderr
