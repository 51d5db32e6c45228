"""Cost of recording, in time and in bytes, and speed of a replay.

The recorder's CPU is compared with that of a process that appends the same bytes by h5py at the
same time.
"""

import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from math import pi, sin
from pathlib import Path
from statistics import median

from benchmarks import daemon, targets
from benchmarks.figures import Figure, compared
from benchmarks.telemetry import cpu_s
from benchmarks.worker import ROOT, BenchError, environment, next_json, started
from hapticd.client import Client
from hapticd.core.units import PROBE_RATE_HZ
from hapticd.mailbox.layout import RECORD
from hapticd.protocol.telemetry import PROBE_DTYPE as PROBE
from hapticd.recording.file import open_recording, replay_recording
from hapticd.recording.pack import pack
from hapticd.recording.recorder import RecordingParams

TARGETS = targets.of("record")
SETTLED_S = 3.0
MEASURED_S = 30.0
REPLAYS = 3
TICKS_HZ = 1000
WAVE_N = [0.3 * sin(2 * pi * 5 * index / 4000) for index in range(4000)]


def measure() -> Iterator[Figure]:
    """Yield the CPU of a recorder of an enabled, moving servo; bytes of its live file over the
    received ones; CPU of the replay.
    """
    with tempfile.TemporaryDirectory(prefix="hapticd-bench-") as folder:
        params = RecordingParams(Path(folder) / "bench.h5")
        used, bare = _recorded(params)
        note = f"of a core; {MEASURED_S:g} s at 1 kHz, probe at 4 kHz"
        yield compared("record_cpu_ratio", TARGETS["record_cpu_ratio"], used, "%", bare, note)
        yield _bytes(params.part)
        pack(params.part, params.file)
        yield _replay(params.file)


def _recorded(params: RecordingParams) -> tuple[float, float]:
    """Return the percent of a core, of the recorder and of minimal appending; the recorder is
    killed, so that its live file stays.
    """
    with daemon.running("record") as instance:
        with Client(instance) as client:
            client.set(K=50, B=2)
            client.enable()
            client.perturb_load(WAVE_N)
            client.perturb_start(loop=True)
        command = [
            sys.executable,
            "-m",
            "hapticd",
            "record",
            str(params.file),
            "--instance",
            instance,
        ]
        recorder = subprocess.Popen(command, env=environment(), cwd=ROOT, stderr=subprocess.PIPE)
        try:
            while not params.part.exists() and recorder.poll() is None:
                time.sleep(0.1)
            time.sleep(SETTLED_S)
            appending = _appending(params.file.with_name("bare.h5"))
            begin = time.monotonic()
            begin_s = cpu_s(recorder.pid)
            bare_s = next_json(appending, "append_worker")["cpu_s"]
            took_s = time.monotonic() - begin
            if recorder.poll() is not None:
                raise BenchError(f"the recorder ended early: {recorder.communicate()[1].decode()}")
            used_s = cpu_s(recorder.pid) - begin_s
        finally:
            recorder.kill()
            recorder.communicate()
    return 100.0 * used_s / took_s, 100.0 * bare_s / took_s


def _appending(file: Path) -> "subprocess.Popen[bytes]":
    """Start an `append_worker` and wait until its measurement begins."""
    rates = [str(TICKS_HZ), str(PROBE_RATE_HZ), str(MEASURED_S)]
    process = started("append_worker", [str(file), *rates])
    next_json(process, "append_worker")
    return process


def _bytes(part: Path) -> Figure:
    """Return the live file, uncompressed, over the bytes of the received records."""
    with open_recording(part) as recording:
        ticks = recording.rows["servo"]
        samples = recording.rows["probe"]
    raw = ticks * RECORD.size + samples * PROBE.itemsize
    note = f"per tick, with its probe samples; {ticks} ticks"
    return compared(
        "record_bytes_ratio",
        TARGETS["record_bytes_ratio"],
        part.stat().st_size / ticks,
        "B",
        raw / ticks,
        note,
    )


def _replay(file: Path) -> Figure:
    """Return recorded seconds over the CPU seconds of reading and replaying them, bit-exactly."""
    times = []
    for _ in range(REPLAYS):
        begin = time.process_time()
        with open_recording(file) as recording:
            result = replay_recording(recording)
        times.append(time.process_time() - begin)
    if result.first_difference is not None:
        raise BenchError(f"the replay was not bit-exact: {result.first_difference}")
    return compared(
        "replay_speed",
        TARGETS["replay_speed"],
        float(result.time_s[-1]),
        "s",
        median(times),
        "recorded time over CPU time",
    )
