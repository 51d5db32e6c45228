"""The units, as systemd's own tools judge them; the promises they make; what the processes tell
systemd.
"""

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from support.systemd import DEADLINE_S, Service

from hapticd.mailbox import files, layout
from hapticd.run import supervisor
from hapticd.settings.load import Override, load
from hapticd.settings.toml import shipped


@pytest.fixture
def service(runtime: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Service]:
    address = str(runtime / "notify")
    monkeypatch.setenv("NOTIFY_SOCKET", address)
    found = Service(address)
    yield found
    found.socket.close()


@contextmanager
def servo_process(
    folder: Path, environment: dict[str, str], **board: float
) -> Iterator[subprocess.Popen[bytes]]:
    """A servo whose simulated board has the traits `board`."""
    traits = (Override(("simulation", name), value, "test") for name, value in board.items())
    settings = load(
        shipped("config") / "hapticd.toml",
        (Override(("realtime", "mode"), "off", "test"), *traits),
    )
    written = supervisor.write(folder, settings, files.DEFAULT_INSTANCE)
    command = [
        sys.executable,
        "-m",
        "hapticd.run.servo_main",
        *(str(written[name]) for name in (files.SERVO_JSON, files.BOARD_JSON)),
    ]
    child = subprocess.Popen(command, env={**os.environ, **environment})
    try:
        yield child
    finally:
        child.kill()
        child.wait(DEADLINE_S)


@pytest.mark.process
def test_servo_under_systemd_tells_its_life(service: Service) -> None:
    with servo_process(files.runtime_folder(), {"WATCHDOG_USEC": "200000"}) as servo:
        assert service.hear() == (servo.pid, ["STATUS=looking for the board"])
        assert service.hear() == (servo.pid, ["READY=1", "STATUS=1000 Hz, SIMULATED"])
        feeder, lines = service.hear()
        assert lines == ["WATCHDOG=1"]
        assert feeder != servo.pid
        assert os.sched_getscheduler(feeder) == os.SCHED_OTHER
        servo.send_signal(signal.SIGTERM)
        assert servo.wait(DEADLINE_S) == 0
        heard = [(feeder, ["WATCHDOG=1"])]
        while heard[-1][1] == ["WATCHDOG=1"]:
            heard.append(service.hear())
        assert heard[-1] == (servo.pid, ["STOPPING=1"])


@pytest.mark.process
def test_servo_tells_systemd_what_it_waits_for_and_starts_when_the_board_is_ready(
    service: Service,
) -> None:
    with servo_process(files.runtime_folder(), {}, rights_s=1.0, boot_loader_s=4.0) as servo:
        said = [service.hear()[1]]
        while "READY=1" not in said[-1]:
            said.append(service.hear()[1])
        waited = [lines[0] for lines in said if lines[0].startswith("STATUS=waiting for the board")]
        assert "Access denied" in waited[0]
        assert any("is it in its boot loader" in line for line in waited)
        assert ["STATUS=the board answers"] in said
        servo.send_signal(signal.SIGTERM)
        assert servo.wait(DEADLINE_S) == 0


@pytest.mark.process
def test_ring_of_a_live_servo_moves_for_the_feeder(service: Service) -> None:
    with servo_process(files.runtime_folder(), {"WATCHDOG_USEC": "0"}):
        while "READY=1" not in service.hear()[1]:
            pass
        ring = files.open_map(
            files.runtime_folder() / files.TELEMETRY, layout.TELEMETRY_BYTES, writable=False
        )
        words = memoryview(ring).cast("Q")
        first = words[layout.TELEMETRY_HEAD_WORD]
        while words[layout.TELEMETRY_HEAD_WORD] == first:
            pass
