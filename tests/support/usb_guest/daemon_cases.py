"""The whole daemon, started before its board, with a private network as in the shipped unit. One
daemon runs through all cases, in their order. Run by `make test-usb` in a user-mode kernel
(tests/acceptance/test_usb_stack.py).
"""

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from machine import Board, Looker, in_own_network, until

from hapticd.client import Client
from hapticd.core.errors import CommandError, DaemonDown
from hapticd.mailbox import files
from hapticd.settings.toml import shipped

RATE = "[realtime]\nrate_hz = 250.0\nmode = 'off'\n"
# three processes and the board share one virtual core, and time is not the point here: slots are
# lost, and verdicts of the guard would come late
LENIENT = (
    "[safety]\nlost_slots_limit = 10000\nmissing_frames_limit = 100\n[usb]\ntimeout_ms = 5\n"
    '[guard]\npolicy = "off"\n'
)
FOLDER = Path(tempfile.mkdtemp(prefix="daemon-"))
SIMULATED = FOLDER / "simulated.toml"


class Daemon:
    """`hapticd run` for a real board."""

    def __init__(self) -> None:
        simulated = (shipped("config") / "devices" / "simulated.toml").read_text()
        # the board of that file, without the simulated flag, as found at a bus
        real = simulated.replace("simulated = true\n", "").partition("[plant]")[0]
        (FOLDER / "board.toml").write_text(real)
        (FOLDER / "hapticd.toml").write_text(f"device = '{FOLDER}/board.toml'\n{RATE}{LENIENT}")
        self.log = FOLDER / "log"
        words = ["run", "--json", "--no-console", "--config", str(FOLDER / "hapticd.toml")]
        with self.log.open("wb") as log:
            self.process = subprocess.Popen(
                in_own_network([sys.executable, "-m", "hapticd", *words]),
                stdout=log,
                stderr=log,
                env={**os.environ, "XDG_RUNTIME_DIR": str(FOLDER)},
            )
        self._client: Client | None = None

    @property
    def client(self) -> Client:
        if self._client is None:
            self._client = Client(name="case", timeout_s=20.0, folder=FOLDER / "hapticd")
        return self._client

    def report(self) -> dict[str, Any]:
        """Return the servo's report on itself and its board."""
        assert self.process.poll() is None, self.log.read_text()
        try:
            return dict(json.loads((FOLDER / "hapticd" / files.REPORT).read_text()))
        except (OSError, ValueError):
            return {}

    def answers(self) -> bool:
        """Return whether the servo ticks; it does not while it examines a board that returned."""
        try:
            return bool(self.client.status().state)
        except DaemonDown:
            return False

    def has_board(self, differences: Sequence[str] = ()) -> None:
        """The board is back, and was looked at."""

        def back() -> bool:
            report = self.report()
            found = report.get("differences", [])
            return report.get("waiting_for") == "" and found == list(differences)

        until(back, "the board is back")
        until(self.answers, "a servo that ticks")

    def reset(self) -> None:
        """Reset a fault whose cause disappeared with the first frames."""

        def done() -> bool:
            with suppress(CommandError):
                self.client.reset()
            return bool(self.client.status().state == "disabled")

        until(done, "a reset")

    def zero(self) -> None:
        """The origin where the board is, in a tick in which a frame came."""

        def done() -> bool:
            with suppress(CommandError):
                return bool(self.client.zero())
            return False

        until(done, "an origin")

    def render(self, board: Board) -> None:
        """Force on."""
        self.enable(board, self.zero)
        self.client.wait_for("enabled")

    def enable(self, board: Board, first: Callable[[], None] = lambda: None) -> None:
        """`first`, then `enable`. The bus may have been too slow for the rate while it was
        measured, where the machine is busy: it is measured again with each plug.
        """

        def enabled() -> bool:
            first()
            try:
                self.client.enable()
            except CommandError as error:
                if "a pair of transfers takes" not in str(error):
                    raise
                board.unplug()
                self.waits_for("no board")
                board.plug()
                self.has_board()
                self.reset()
                return False
            return True

        until(enabled, "a bus that holds the rate")

    def waits_for(self, reason: str) -> None:
        """Wait until report and log contain this reason."""
        until(lambda: reason in self.report().get("waiting_for", ""), reason)
        until(lambda: reason in self.log.read_text(), f"the log: {reason}")

    def ready(self) -> bool:
        return '"ready"' in self.log.read_text()

    def end(self) -> int:
        if self._client is not None:
            self._client.close()
        self.process.terminate()
        return self.process.wait(20.0)


@pytest.fixture(scope="module")
def board(udev: None) -> Iterator[Board]:
    """Not plugged in."""
    SIMULATED.write_text(RATE)
    board = Board("--config", str(SIMULATED))
    yield board
    board.end()


@pytest.fixture(scope="module")
def daemon(board: Board) -> Iterator[Daemon]:
    daemon = Daemon()
    yield daemon
    if daemon.process.poll() is None:
        daemon.end()


def test_daemon_waits_for_a_board_that_is_not_there(daemon: Daemon) -> None:
    daemon.waits_for("no board 1209:0001 with serial SIM0001 at the bus")
    assert not daemon.ready()


def test_slow_board_does_not_end_a_start(daemon: Daemon, board: Board) -> None:
    board("hello nak")
    board.plug()
    daemon.waits_for("the board is slow to answer, or hangs; it is asked again")
    board("hello stall")
    daemon.waits_for("is it in its boot loader")
    assert not daemon.ready()


def test_board_that_was_plugged_in_late_is_rendered(
    daemon: Daemon, board: Board, record_property: Callable[[str, object], None]
) -> None:
    board("heal")
    until(daemon.ready, "a daemon that is ready")
    daemon.client.set(K=100.0)
    daemon.render(board)
    before = board("count")["out"]
    until(lambda: board("count")["out"] > before + 250, "a second of frames")
    found = daemon.client.status()
    assert found.state == "enabled"
    bus = found.servo["transport"]
    counters = found.counters
    record_property(
        "daemon",
        f"a pair of transfers takes {bus['pair_us']:.0f} us: {bus['rate_hz']:g} Hz of 250 Hz held,"
        f" latch at {bus['sample_phase']:g}; {counters['lost_slots']} slots lost and"
        f" {counters['missing_in']} frames missing until tick {found.tick}",
    )


def test_plug_pulled_under_force_is_a_latched_fault(daemon: Daemon, board: Board) -> None:
    board.unplug()
    daemon.client.wait_for("fault", timeout_s=20.0)
    assert daemon.client.status().fault == "usb_lost"
    daemon.waits_for("no board 1209:0001 with serial SIM0001 at the bus")


def test_reconnect_that_is_refused_says_why(daemon: Daemon, board: Board) -> None:
    board("hello nak")
    board.plug()
    daemon.waits_for("the board is slow to answer, or hangs; it is asked again")
    board("hello hash")
    daemon.waits_for("the board speaks protocol")
    assert "the board speaks protocol" in daemon.client.status().servo["waiting_for"]
    with Looker() as thief:
        until(lambda: thief.look() == "SIM0001", "the thief has the board")
        daemon.waits_for("another program has claimed the board")
    board("heal")
    daemon.has_board()


def test_board_that_is_another_by_its_hello_makes_no_force(daemon: Daemon, board: Board) -> None:
    board.unplug()
    daemon.waits_for("no board")
    board("hello serial")
    board.plug()
    daemon.has_board(["serial: the board says 'ANOTHER', the device file 'SIM0001'"])
    daemon.reset()
    daemon.zero()
    with pytest.raises(CommandError, match="ANOTHER"):
        daemon.client.enable()


def test_board_that_came_back_is_disabled_and_asks_for_home(daemon: Daemon, board: Board) -> None:
    board.unplug()
    daemon.waits_for("no board")
    board("heal")
    board.plug()
    daemon.has_board()
    assert daemon.client.status().state in ("fault", "disabled")
    daemon.reset()
    with pytest.raises(CommandError, match="home"):
        daemon.enable(board)
    daemon.render(board)
    daemon.client.stop()


def test_reference_firmware_answers_in_the_place_of_the_board(daemon: Daemon, board: Board) -> None:
    board.unplug()
    daemon.waits_for("no board")
    firmware = Board("--config", str(SIMULATED), "--firmware")
    try:
        firmware.plug()
        daemon.has_board()
        daemon.reset()
        daemon.render(firmware)
        before = firmware("count")["in"]
        until(lambda: firmware("count")["in"] > before + 100, "frames of the firmware")
        assert daemon.client.status().state == "enabled"
        daemon.client.stop()
    finally:
        firmware.end()


def test_daemon_ends_as_it_is_asked_without_its_board(daemon: Daemon) -> None:
    assert daemon.end() == 0
