"""A board that is not ready is waited for, and it is said what for: at the start, and when it comes
back to a servo that runs.
"""

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from support.boards import board_params
from support.gateway_rig import GatewayRig, running
from support.gateway_stand_in import setup
from support.models import servo_params

from hapticd.cli.app import main
from hapticd.core.errors import DaemonDown, MailboxError, ProtocolMismatch
from hapticd.core.params import UsbParams
from hapticd.core.units import NS_PER_S, VirtualClock
from hapticd.gateway.server import GatewayServer
from hapticd.mailbox import files, layout
from hapticd.mailbox.daemons import StopWord, press_stop, servo_lives
from hapticd.mailbox.layout import State
from hapticd.mailbox.servo_side import ServoMailbox
from hapticd.run import servo_main
from hapticd.run.lockstep import LockStep
from hapticd.run.servo_main import Servo
from hapticd.sim.backend import READY, Handle, SimulatedBackend, Unready
from hapticd.sim.board import BoardModel, hello
from hapticd.usb import codec
from hapticd.usb.codec import backoff_s
from hapticd.usb.device import Device
from hapticd.usb.link import UsbLink
from hapticd.usb.search import MISMATCH_NS, BoardSearch

START_NS = 1000 * NS_PER_S
FOREIGN_HELLO = b"\xff" * 8 + codec.encode_hello(hello(board_params()))[8:]
RIGHTS = "hapticd install-system"
SLOW = "the board is slow to answer, or hangs; it is asked again"
BOOT = "is it in its boot loader"
HASH = "the board speaks protocol ffffffffffffffff"
DTYPE = np.dtype([tuple(field) for field in layout.TELEMETRY])
OWNER = "another program has claimed the board"


class Looking:
    """A search at a simulated bus, in virtual time."""

    def __init__(self, unready: Unready = READY) -> None:
        self.clock = VirtualClock(START_NS)
        self.backend = SimulatedBackend(BoardModel(board_params()), self.clock, "bulk", unready)
        self.device = Device(UsbLink(UsbParams(serial="SIM0001"), self.backend), 1000.0)
        self.told: list[str] = []
        self.search = BoardSearch(self.device, self.told.append)

    def look_for(self, time_s: float) -> bool:
        """Look as a start does, for so long; whether the board was found."""
        end_ns = self.clock.now_ns() + round(time_s * NS_PER_S)
        while self.clock.now_ns() < end_ns:
            if self.search.look(self.clock.now_ns()) is not None:
                return True
            self.search.check_patience(self.clock.now_ns())
            self.clock.sleep_until_ns(max(self.search.retry_ns, self.clock.now_ns() + 1))
        return False

    @property
    def waited_s(self) -> float:
        return (self.clock.now_ns() - START_NS) / NS_PER_S


UNREADY = [
    (Unready(rights_s=0.3), 0.3, RIGHTS),
    (Unready(hello_s=5.0), 5.0, SLOW),
    (Unready(boot_loader_s=8.0), 8.0, BOOT),
    (Unready(boot_loader_s=20.0, boot_hello=FOREIGN_HELLO), 20.0, HASH),
]


@pytest.mark.parametrize(("unready", "time_s", "said"), UNREADY)
def test_board_that_is_not_ready_is_waited_for_and_it_is_said_what_for(
    unready: Unready, time_s: float, said: str
) -> None:
    looking = Looking(unready)
    assert looking.look_for(100.0)
    assert time_s <= looking.waited_s <= time_s + 2 * backoff_s(99)
    first, *_, last = looking.told
    assert said in first
    assert last == ""
    assert len(looking.told) == len(set(looking.told)) <= 3  # a dead device may be listed once more


def test_each_reason_is_told_once_in_the_order_in_which_they_came() -> None:
    looking = Looking(Unready(rights_s=1.0, hello_s=3.0, boot_loader_s=6.0))
    assert looking.look_for(100.0)
    expected = [RIGHTS, SLOW, BOOT]
    assert [word for word in expected if any(word in reason for reason in looking.told)] == expected
    assert len(looking.told) == len(set(looking.told))


def test_board_that_another_program_has_claimed_is_waited_for() -> None:
    looking = Looking()
    assert looking.backend.device is not None
    looking.backend.device.owner = Handle(looking.backend.device)
    assert not looking.look_for(60.0)
    looking.backend.device.owner = None
    assert looking.look_for(2.0)
    first, last = looking.told
    assert OWNER in first
    assert last == ""


def test_absent_board_is_waited_for_and_named() -> None:
    looking = Looking()
    looking.backend.unplug(away_s=40.0)
    assert looking.look_for(60.0)
    assert "no board 1209:0001 with serial SIM0001 at the bus" in looking.told[-2]


def test_hash_that_stays_wrong_ends_a_start_after_half_a_minute() -> None:
    looking = Looking(Unready(boot_loader_s=3600.0, boot_hello=FOREIGN_HELLO))
    with pytest.raises(ProtocolMismatch, match=f"{HASH}.*; flash firmware built") as caught:
        looking.look_for(3600.0)
    assert caught.value.exit_code == 78
    assert MISMATCH_NS <= looking.waited_s * NS_PER_S <= MISMATCH_NS + NS_PER_S


def test_wrong_hash_is_waited_for_anew_after_the_board_was_away() -> None:
    """Half a minute counts from the last thing that was not a wrong hash: somebody works on it."""
    looking = Looking(Unready(boot_loader_s=3600.0, boot_hello=FOREIGN_HELLO))
    assert not looking.look_for(25.0)
    looking.backend.unplug(away_s=3.0)
    assert not looking.look_for(25.0)
    looking.backend.unplug()
    looking.backend.unready = READY
    looking.backend.plug()
    assert looking.look_for(2.0)


def test_pauses_grow_to_a_second() -> None:
    looking = Looking()
    looking.backend.unplug()
    pauses = []
    for _ in range(12):
        looking.search.look(looking.clock.now_ns())
        pauses.append((looking.search.retry_ns - looking.clock.now_ns()) / NS_PER_S)
        looking.clock.sleep_until_ns(looking.search.retry_ns)
    assert pauses == [backoff_s(attempt) for attempt in range(1, 13)]
    assert pauses[-1] == 1.0


# --- a start, as the process makes it -------------------------------------------------------------


class Started(NamedTuple):
    """A servo that looks for its board, and what is seen of it meanwhile."""

    servo: Servo
    mailbox: ServoMailbox
    clock: VirtualClock
    reports: list[dict[str, Any]]
    status: list[str]


@pytest.fixture
def start(runtime: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., Started]]:
    made: list[ServoMailbox] = []

    def started(**traits: float) -> Started:
        clock = VirtualClock(START_NS)
        servo = Servo(servo_params(), board_params(**traits), clock)
        folder = files.runtime_folder()
        mailbox = ServoMailbox(folder, 1000.0, "", True, START_NS)
        made.append(mailbox)
        reports: list[dict[str, Any]] = []
        status: list[str] = []

        def notified(*lines: str) -> None:
            status.extend(lines)
            reports.append(json.loads((folder / files.REPORT).read_text()))

        monkeypatch.setattr(servo_main, "notify", notified)
        return Started(servo, mailbox, clock, reports, status)

    yield started
    for mailbox in made:
        mailbox.close()


def test_start_says_in_report_status_and_log_what_it_waits_for(
    start: Callable[..., Started], capfd: pytest.CaptureFixture[str]
) -> None:
    found = start(rights_s=0.5, boot_loader_s=3.0)
    assert found.servo.connect(found.mailbox)
    log = capfd.readouterr().err.splitlines()
    assert log == [f"hapticd servo: {line.removeprefix('STATUS=')}" for line in found.status]
    assert RIGHTS in log[0]
    assert BOOT in log[1]
    assert log[-1] == "hapticd servo: the board answers"
    for line, report in zip(found.status[:-1], found.reports, strict=False):
        assert line == f"STATUS=waiting for the board: {report['waiting_for']}"
        assert report["device"].endswith(", SIM0001")
    assert found.reports[-1]["waiting_for"] == ""
    found.servo.device.close()


def test_start_that_is_asked_to_end_ends(start: Callable[..., Started]) -> None:
    found = start(boot_loader_s=1000.0)
    sleep = found.clock.sleep_until_ns

    def asked_after_a_minute(until_ns: int) -> None:
        sleep(until_ns)
        if found.clock.now_ns() - START_NS > 60 * NS_PER_S:
            found.servo.stop()

    found.clock.sleep_until_ns = asked_after_a_minute  # type: ignore[method-assign]
    assert not found.servo.connect(found.mailbox)


def test_stop_that_is_pressed_before_the_first_tick_is_obeyed_by_it() -> None:
    with LockStep(servo_params(), board_params()) as stack:
        assert servo_lives(stack.mailbox.folder)
        press_stop(stack.mailbox.folder)
        record = stack.run(1)
    assert np.frombuffer(record, DTYPE)["state"].tolist() == [State.STOPPED]


def test_life_without_a_tick_leaves_the_ring_of_the_one_before(tmp_path: Path) -> None:
    first = ServoMailbox(tmp_path, 1000.0, "", True, 5)
    first.publish_head(layout.TELEMETRY_HEAD_WORD, 7)
    first.close()
    ring = (tmp_path / files.LAST_TELEMETRY).read_bytes()
    waited = ServoMailbox(tmp_path, 1000.0, "", True, 6)
    waited.close()
    assert (tmp_path / files.LAST_TELEMETRY).read_bytes() == ring
    assert [path.name for path in tmp_path.iterdir()] == [files.LAST_TELEMETRY]


# --- a servo that runs ----------------------------------------------------------------------------


def denied(backend: SimulatedBackend) -> None:
    backend.access_denied = True


def slow(backend: SimulatedBackend) -> None:
    backend.unready = Unready(hello_s=1e6)


def claimed(backend: SimulatedBackend) -> None:
    backend.kernel_driver = True
    backend.detach_kernel_driver = lambda handle, interface: None  # type: ignore[method-assign]


def test_servo_survives_a_report_that_cannot_be_written(monkeypatch: pytest.MonkeyPatch) -> None:
    def no_room(_content: object) -> None:
        raise MailboxError("servo.report: no room")

    with LockStep(servo_params(), board_params()) as stack:
        stack.run(10)
        monkeypatch.setattr(stack.mailbox, "report", no_room)
        stack.backend.unplug(away_s=0.2)
        stack.run(2000)
        assert stack.loop.connection.linked


# --- where it is told -----------------------------------------------------------------------------

REASON = "cannot open the board: Access denied"


@pytest.fixture
def waiting(runtime: Path) -> Iterator[ServoMailbox]:
    """A servo that waits for its board; there is no gateway, or it has no servo yet."""
    mailbox = ServoMailbox(files.runtime_folder(), 1000.0, "", True, START_NS)
    mailbox.report({"waiting_for": REASON})
    yield mailbox
    mailbox.close()


def test_status_without_a_gateway_says_what_the_servo_waits_for(
    waiting: ServoMailbox, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["status"]) == DaemonDown.exit_code
    assert capsys.readouterr().out == f"down: the servo waits for the board: {REASON}\n"
    assert main(["status", "--json"]) == DaemonDown.exit_code
    assert json.loads(capsys.readouterr().out)["servo"] == {"waiting_for": REASON}


def test_gateway_says_what_a_servo_waits_for_that_is_not_published_yet(
    waiting: ServoMailbox,
) -> None:
    gateway = GatewayServer(waiting.folder, setup(), VirtualClock(START_NS))
    gateway.step(0)
    assert gateway._status()["servo"] == {"waiting_for": REASON}
    waiting.stop_word.close()  # as the kernel does for a killed process
    assert gateway._status()["servo"] == {}
    waiting.stop_word = StopWord(waiting.folder)
    gateway.close()


def test_status_of_a_running_servo_says_what_it_waits_for(
    runtime: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with GatewayRig(files.prepare_folder(files.runtime_folder())) as rig, running(rig):
        with rig.lock:
            rig.servo.mailbox.report({"waiting_for": REASON})
        assert main(["status"]) == 0
        assert f"  board     the servo waits for the board: {REASON}" in capsys.readouterr().out
