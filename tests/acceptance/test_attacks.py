"""Each row of `make attack` in short, and that its counter rises when one loss is injected."""

import os
import selectors
import signal
import socket
import subprocess
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace
from pathlib import Path
from random import Random
from typing import Any
from unittest import mock

import numpy as np
import pytest
from support.attacks import documents, peers, signals, surroundings
from support.attacks.late import Block, detectable, judged
from support.attacks.lifecycle import ATTACKS, Attack
from support.attacks.live import DTYPE, LiveDaemon, Watch, until
from support.attacks.peers import KINDS, Peers
from support.attacks.rows import LEAST, Losses, Row
from support.attacks.signals import DEADLY
from support.attacks.stage import Stage, Stop, settings, shared_stage
from support.attacks.table import ROWS
from support.defects import defect
from support.firmware_board import FirmwareBoard

from hapticd.client.blocks import BlockDecoder
from hapticd.client.client import GatewayConnection
from hapticd.core.errors import DaemonDown
from hapticd.gateway import peers as zmtp
from hapticd.gateway.command_server import CommandServer
from hapticd.mailbox import files, layout
from hapticd.mailbox.layout import State
from hapticd.recording import pack
from hapticd.servo.plan import LINK_UP
from hapticd.sim.axis import Axis
from hapticd.usb import codec, frames

pytestmark = pytest.mark.process


@pytest.fixture(scope="module")
def stage() -> Iterator[Stage]:
    with shared_stage() as stage:
        yield stage


@pytest.mark.usefixtures("stage")
@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.name)
def test_nothing_is_lost(row: Row) -> None:
    outcome = row.attack(row.short, 1)
    assert outcome.lost == 0, outcome.found
    assert outcome.tried >= row.short
    if row.name == "late-ticks":  # judged by `make attack` alone; here, that both were measured
        assert min(outcome.figures[name] for name in ("ticks", "control_ticks", "cpu_s")) > 0.0


# --- one loss -------------------------------------------------------------------------------------


@contextmanager
def one_reply_lost() -> Iterator[None]:
    serve = CommandServer.serve
    swallowed: list[object] = []

    def lossy(*arguments: Any) -> Any:
        replies = serve(*arguments)
        if replies and not swallowed:
            swallowed.append(replies.pop())
        return replies

    with mock.patch.object(CommandServer, "serve", lossy):
        yield


@contextmanager
def one_broken_frame_taken() -> Iterator[None]:
    in_parser = codec.in_parser
    taken: list[object] = []

    def lossy(buffer: Any) -> Any:
        parse = in_parser(buffer)

        def believing() -> Any:
            head = parse()
            if head is None and not taken:
                head = frames.IN_SEALED.unpack(buffer)
                taken.append(head)
            return head

        return believing

    with mock.patch.object(codec, "in_parser", lossy):
        yield


@contextmanager
def one_file_in_another_error() -> Iterator[None]:
    read = documents.read_settings
    failed: list[object] = []

    def failing(path: Path) -> None:
        if not failed:
            failed.append(path)
            raise ZeroDivisionError("float division by zero")
        read(path)

    with mock.patch.object(documents, "read_settings", failing):
        yield


@contextmanager
def one_recording_gone() -> Iterator[None]:
    packed = pack.pack
    gone: list[object] = []

    def losing(path: Path, out: Path, **how: Any) -> Any:
        if path.name == "any.part.h5" and not gone:
            gone.append(path)
            path.unlink()
            return {"dropped_bytes": 1}
        return packed(path, out, **how)

    with mock.patch.object(pack, "pack", losing):
        yield


@contextmanager
def one_frame_unheard() -> Iterator[None]:
    """By the firmware."""
    heard = FirmwareBoard.on_out
    dropped: list[object] = []

    def deaf(board: Any, data: memoryview, t_ns: int) -> None:
        if not dropped and board._axis.force_n:
            dropped.append(bytes(data))
            return
        heard(board, data, t_ns)

    with mock.patch.object(FirmwareBoard, "on_out", deaf):
        yield


@contextmanager
def one_force_too_large() -> Iterator[None]:
    command = Axis._command
    grown: list[float] = []

    def wrong(axis: Any, force_n: float, seq: int) -> None:
        if not grown and abs(force_n) > 0.5:
            grown.append(force_n)
            force_n *= 20.0
        command(axis, force_n, seq)

    with mock.patch.object(Axis, "_command", wrong):
        yield


@contextmanager
def one_watchdog_asleep() -> Iterator[None]:
    bite = Axis._fail_safe
    slept: list[object] = []

    def asleep(axis: Any) -> None:
        if not slept:
            slept.append(axis)
        if axis in slept:
            axis._alarm_at = axis.now + 32
        else:
            bite(axis)

    with mock.patch.object(Axis, "_fail_safe", asleep):
        yield


@contextmanager
def one_servo_enabled_by_somebody() -> Iterator[None]:
    struck = signals._struck

    def meddled(daemon: LiveDaemon, *others: Any) -> None:
        struck(daemon, *others)
        daemon.to_force()

    strikes = [signals.Strike("servo", signal.SIGKILL)]
    with (
        mock.patch.object(signals, "_struck", meddled),
        mock.patch.object(signals, "order", return_value=strikes),
    ):
        yield


@contextmanager
def one_start_not_refused() -> Iterator[None]:
    done = subprocess.CompletedProcess([], 0, "", "")
    with (
        mock.patch.object(surroundings, "mounts_permitted", return_value=False),
        mock.patch.object(subprocess, "run", return_value=done),
    ):
        yield


@contextmanager
def one_servo_ended() -> Iterator[None]:
    opened = surroundings.Peers.open
    killed: list[int] = []

    def killing(peers: Any, *arguments: Any) -> Any:
        if not killed:
            pid = int((peers.folder / files.SERVO_LOCK).read_text())
            killed.append(pid)
            os.kill(pid, signal.SIGKILL)
            until(lambda: (peers.folder / files.SERVO_LOCK).read_text() != str(pid), "the next")
        return opened(peers, *arguments)

    with mock.patch.object(surroundings.Peers, "open", killing):
        yield


@contextmanager
def one_start_that_heals_nothing() -> Iterator[None]:
    def failing(daemon: LiveDaemon) -> None:
        raise AssertionError("it does not start again")

    with mock.patch.object(LiveDaemon, "restart", failing):
        yield


@contextmanager
def one_name_reached() -> Iterator[None]:
    with (
        mock.patch.object(surroundings, "_trespasses", return_value=1),
        mock.patch.object(surroundings, "_modes", _found_open),
    ):
        yield


def _found_open(folder: Path) -> None:
    assert os.geteuid() == 0, "a name is open to others"


INJECTED: dict[str, tuple[Callable[[], AbstractContextManager[None]], int]] = {
    "commands": (one_reply_lost, 300),
    "frames": (one_broken_frame_taken, 300),
    "toml": (one_file_in_another_error, 10),
    "hdf5": (one_recording_gone, 10),
    "frames-out": (one_frame_unheard, 2000),
    "force-path": (one_force_too_large, 4_000),
    "dead-servo": (one_watchdog_asleep, 1),
    "signals": (one_servo_enabled_by_somebody, 1),
    "runtime-folder": (one_start_not_refused, 1),
    "disk": (one_start_not_refused, 1),
    "memory": (one_servo_ended, 1),
    "folder-files": (one_start_that_heals_nothing, 1),
    "local-user": (one_name_reached, 1),
}
# seeds of a start that is refused, of a flight with force
FIRST = {"runtime-folder": 2, "force-path": 3}


@pytest.mark.usefixtures("stage")
@pytest.mark.parametrize("name", INJECTED)
def test_counter_rises_when_one_loss_is_injected(name: str) -> None:
    row = next(row for row in ROWS if row.name == name)
    injected, times = INJECTED[name]
    with injected():
        outcome = row.attack(times, FIRST.get(name, 1))
    assert outcome.lost >= 1
    assert outcome.found


# known defects that the row has to see, and lives enough to meet each
DEFECTS = {
    "enable-in-stages": [("lifecycle_enable_in_stages_outlives_a_disable", 8)],
    "gateway-stands-still": [("lifecycle_verdict_without_deadline", 2)],
    "bounded-push": [("lifecycle_no_end", 4)],
    "measuring-lease": [("lifecycle_terms_cancel_nothing", 4)],
    "former-gateway": [("lifecycle_terms_cancel_nothing", 4)],
    "policy-made-strict": [("guard_scheduled_by_other_terms", 4)],
    "gateway-beside-servo": [("lifecycle_judged_by_the_models_delay", 4)],
    "mute-perturbation": [("mute_withheld_plays", 8)],
    "client-numbers": [("lifecycle_client_numbers_begin_again", 4)],
    "masks": [("mask_not_looked_at", 4), ("mask_made_slots_unlooked_at", 4)],
    "dead-gateways-ring": [("lifecycle_what_a_dead_gateway_left_is_obeyed", 4)],
    "closed-connection": [
        ("lifecycle_waiting_outlives_its_connection", 8),
        ("lifecycle_enable_with_the_servo_outlives_its_connection", 8),
    ],
}


@pytest.mark.parametrize("attack", ATTACKS, ids=lambda attack: attack.name)
def test_counter_rises_when_a_known_defect_is_put_back(attack: Attack) -> None:
    for name, times in DEFECTS[attack.name]:
        with defect(name):
            outcome = attack.run(times, 1)
        assert outcome.lost >= 1, name
        assert outcome.found
    assert attack.run(1, 1).lost == 0


@pytest.mark.parametrize("attack", ATTACKS, ids=lambda attack: attack.name)
def test_every_kind_comes_often_enough_in_a_whole_run(attack: Attack) -> None:
    idle = attack._replace(play=lambda chosen, random: None)
    row = idle.row()
    came = idle.run(row.times, 1).came
    assert set(came) == {value for values in attack.features.values() for value in values}
    assert min(came.values()) >= LEAST


# --- what peers cost the others is counted alike in all their rows --------------------------------


def one_block_withheld(stage: Stage) -> AbstractContextManager[object]:
    decode = BlockDecoder.decode
    came: list[int] = []

    def lossy(decoder: Any, payload: bytes) -> Any:
        block = decode(decoder, payload)
        came.append(len(block.records))
        if len(came) == 3:
            return replace(block, gap=block.gap + len(block.records))
        return block

    return mock.patch.object(BlockDecoder, "decode", lossy)


def one_request_unanswered(stage: Stage) -> AbstractContextManager[object]:
    exchange = GatewayConnection.exchange
    asked: list[str] = []

    def lossy(line: Any, cmd: str, *rest: Any) -> Any:
        asked.append(line._name)
        if line._name == "bystander" and asked.count("bystander") == 2:  # the first connects
            raise DaemonDown("nobody answers")
        return exchange(line, cmd, *rest)

    return mock.patch.object(GatewayConnection, "exchange", lossy)


def one_gateway_killed(stage: Stage) -> AbstractContextManager[object]:
    return _once(stage, lambda: os.kill(stage.daemon.processes()["gateway"], signal.SIGKILL))


def one_fault_latched(stage: Stage) -> AbstractContextManager[object]:
    return _once(stage, lambda: stage.watch.faults.update(["overspeed"]))


def _once(stage: Stage, act: Callable[[], object]) -> AbstractContextManager[object]:
    stop = stage.stop

    acted: list[object] = []

    def acting() -> Stop:
        if not acted:
            acted.append(act())
        return stop()

    return mock.patch.object(stage, "stop", acting)


@pytest.mark.parametrize(
    "injected", [one_block_withheld, one_request_unanswered, one_gateway_killed, one_fault_latched]
)
def test_what_peers_cost_the_others_is_counted(stage: Stage, injected: Any) -> None:
    with injected(stage):
        outcome = stage.attacked("multipart", 200, 1)
    assert outcome.lost >= 1, outcome


# --- what was tried, and what was refused ---------------------------------------------------------


class HalfOpen(threading.Thread):
    """A gateway that takes every second connection, and closes the others."""

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self.taken: list[socket.socket] = []
        self.selector = selectors.DefaultSelector()
        for name in (files.COMMAND_SOCKET, files.TELEMETRY_SOCKET):
            listener = socket.socket(socket.AF_UNIX)
            listener.bind(str(folder / name))
            listener.listen(500)
            self.selector.register(listener, selectors.EVENT_READ)
        self.ending = threading.Event()

    def run(self) -> None:
        number = 0
        while not self.ending.is_set():
            for key, _ in self.selector.select(0.05):
                line = key.fileobj.accept()[0]
                number += 1
                if number % 2:
                    line.close()
                else:
                    line.sendall(zmtp.GREETING)
                    self.taken.append(line)

    def close(self) -> None:
        self.ending.set()
        self.join()
        for one in (*self.taken, *(key.fileobj for key in self.selector.get_map().values())):
            one.close()
        self.selector.close()


@pytest.mark.parametrize("kind", sorted(KINDS.keys() - {"burn", "killed-clients"}))
def test_refused_pieces_are_not_counted_as_tried(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(peers, "HELD_S", 0.1)
    gateway = HalfOpen(tmp_path)
    gateway.start()
    attacker = Peers(tmp_path, 1)
    try:
        KINDS[kind](attacker, 30)
    finally:
        attacker.close()
        gateway.close()
    assert attacker.done >= 30
    assert attacker.refused >= 5
    if kind in ("slow-readers", "half-open", "crowd"):
        assert attacker.done <= len(gateway.taken)


@pytest.mark.parametrize("kind", sorted(KINDS.keys() - {"burn"}))
def test_attack_that_nobody_takes_is_none(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(peers, "GIVEN_UP_S", 0.1)
    monkeypatch.setattr(peers, "HELD_S", 0.1)
    attacker = Peers(tmp_path, 1)
    with pytest.raises(SystemExit, match="nothing was taken"):
        KINDS[kind](attacker, 30)
    attacker.close()
    assert attacker.done == 0


def test_whole_run_has_the_time_outs_of_a_user() -> None:
    assert "gateway_timeout_s" not in settings(patient=False)
    assert "gateway_timeout_s" in settings(patient=True)


@pytest.mark.parametrize("row", ["disk", "memory", "folder-files", "local-user"])
def test_no_whole_row_is_patient(row: str, monkeypatch: pytest.MonkeyPatch) -> None:
    begun: list[str] = []

    def refused(text: str, *_: object, **__: object) -> None:
        begun.append(text)
        raise KeyboardInterrupt

    monkeypatch.setattr("support.attacks.stage.LiveDaemon", refused)
    for module in ("stage", "surroundings"):  # the short form's stage may stand beside this
        monkeypatch.setattr(f"support.attacks.{module}.shared", [])
    with pytest.raises(KeyboardInterrupt):
        next(one for one in ROWS if one.name == row).attack(3, 2)
    assert begun == [settings(patient=False)]


# --- force that came back -------------------------------------------------------------------------


def test_servo_that_is_live_from_its_first_tick_on_is_seen(tmp_path: Path) -> None:
    """No change of state tells of it."""
    rows = ticks(300)
    rows["state"] = State.ENABLED
    watch = WatchAlone(tmp_path)
    watch._take(rows)
    assert not watch.changes
    daemon = mock.Mock(state=lambda: "disabled")
    with pytest.raises(AssertionError, match="force came back"):
        signals._stays_without_force(daemon, watch)


@pytest.mark.parametrize("number", DEADLY)
def test_force_that_comes_back_after_a_killed_supervisor_is_counted(
    number: signal.Signals, monkeypatch: pytest.MonkeyPatch
) -> None:
    looked: list[object] = []
    monkeypatch.setattr(signals, "_stays_without_force", lambda *_: looked.append(number))
    monkeypatch.setattr(signals, "_struck", lambda daemon, watch, *_: vars(watch).update(lives=2))
    monkeypatch.setattr(signals, "_stopped", lambda *_: None)
    daemon = mock.Mock(state=lambda: "disabled", processes=lambda: {"supervisor": 1})
    watch = mock.Mock(lives=1, changes=[])
    losses = Losses()
    signals._one(daemon, watch, signals.Strike("supervisor", number), Random(1), losses)
    assert looked == [number]
    assert not losses.count


# --- late ticks -----------------------------------------------------------------------------------


def ticks(count: int) -> Any:
    """Records of a servo that is in time."""
    rows = np.zeros(count, DTYPE)
    rows["tick"] = rows["slot"] = np.arange(count)
    rows["host"] = LINK_UP
    return rows


class WatchAlone(Watch):
    def start(self) -> None:
        """It is given its records, or told to look."""

    def join(self, timeout: float | None = None) -> None:
        """It never began."""


def test_watch_follows_a_ring_round_its_end_and_survives_what_is_done_to_its_file(
    tmp_path: Path,
) -> None:
    path = tmp_path / files.TELEMETRY
    path.write_bytes(bytes(layout.TELEMETRY_BYTES))

    def write(first: int, count: int) -> None:
        rows = ticks(count)
        rows["tick"] = rows["slot"] = np.arange(first, first + count)
        ring = np.memmap(path, DTYPE, "r+", layout.TELEMETRY_OFFSET, layout.RING_RECORDS)
        ring[np.arange(first, first + count) % layout.RING_RECORDS] = rows
        ring.flush()
        with path.open("r+b") as file:
            file.write((first + count).to_bytes(8, "little"))

    write(0, layout.RING_RECORDS - 50)
    watch = WatchAlone(tmp_path)
    assert watch.lives == 1
    known = watch.ticks
    write(layout.RING_RECORDS - 50, 100)
    watch._look()
    assert (watch.ticks - known, watch.late, watch.unread, watch.lives) == (100, 0, 0, 1)
    assert watch._last["tick"] == layout.RING_RECORDS + 49
    os.truncate(path, 100)
    watch._look()
    path.write_bytes(b"\xff" * 200)
    watch._look()
    path.unlink()
    watch._look()
    assert watch.lives == 1
    watch.close()


@pytest.mark.parametrize(("faulty", "late"), [(False, (1, 1)), (True, (1, 0))])
def test_one_late_tick_is_counted_and_apart_where_the_board_was_ill(
    tmp_path: Path, faulty: bool, late: tuple[int, int]
) -> None:
    rows = ticks(300)
    rows["slot"][150:] += 2
    rows["arrival"][140] = -1 if faulty else 0
    watch = WatchAlone(tmp_path)
    for begin in range(0, 300, 50):
        watch._take(rows[begin : begin + 50])
    assert (watch.late, watch.late_quiet) == late
    assert watch.ticks == 300


def test_more_late_ticks_than_beside_the_control_are_a_loss() -> None:
    control = Block(3, 100_000, 0.0)
    least = detectable(100_000, control)
    assert judged(Block(least - 1, 100_000, 0.0), control).lost == 0
    assert judged(Block(least, 100_000, 0.0), control).lost == 1
    assert least == 14  # 14 or more of 17 in one of two equal halves: p = 0.0064, 13 of 16: 0.0106


def test_every_row_has_a_loss_that_was_injected() -> None:
    peers = KINDS.keys() - {"burn"}
    assert {row.name for row in ROWS} == {*INJECTED, *DEFECTS, *peers, "late-ticks"}
