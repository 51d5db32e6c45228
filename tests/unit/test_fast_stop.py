"""`hapticd stop` reaches what moves: every live daemon of this user and the service, past
leftovers, strangers and whatever hangs; and it says whom it has stopped.
"""

import json
import os
import socket
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest
from support.fast_stop import servo
from support.gateway_rig import GatewayRig, running

from hapticd.cli.app import main as command_line
from hapticd.client import fast_stop
from hapticd.client.fast_stop import main, stop
from hapticd.core.errors import DaemonDown, MailboxError
from hapticd.mailbox import daemons, files
from hapticd.mailbox.daemons import NOT_PRESSED, RuntimeFolder
from hapticd.mailbox.layout import State


@pytest.fixture
def service(runtime: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of a system service, which is there."""
    folder = runtime / "service"
    folder.mkdir(mode=0o750)
    monkeypatch.setattr(files, "SERVICE_FOLDER", folder)
    return folder


def leftovers(folder: Path) -> None:
    """What a daemon leaves behind that was killed."""
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    (folder / files.MAILBOX).write_bytes(b"x")
    (folder / files.STOP).write_bytes(NOT_PRESSED)
    with socket.socket(socket.AF_UNIX) as dead:
        dead.bind(str(folder / files.COMMAND_SOCKET))


def as_user(monkeypatch: pytest.MonkeyPatch, uid: int) -> None:
    monkeypatch.setattr(os, "getuid", lambda: uid)


# --- whom it reaches ------------------------------------------------------------------------------


def test_leftovers_of_a_dead_daemon_do_not_shield_the_service(service: Path) -> None:
    leftovers(files.runtime_folder())
    with servo(service) as moving:
        assert [one.folder for one in stop(None).daemons] == [str(service)]
        assert moving.stop_word.pressed
        assert daemons.daemon_folder() == service


def test_private_daemon_does_not_shadow_the_service(service: Path) -> None:
    with servo(files.runtime_folder(), "toy") as own, servo(service, "rig", False) as moving:
        found = stop(None)
        assert own.stop_word.pressed
        assert moving.stop_word.pressed
    assert [(one.device, one.simulated) for one in found.daemons] == [("toy", True), ("rig", False)]


def test_service_is_named_as_such(service: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with servo(service, "rig, 7", False):
        assert main(None, False) == 0
    assert capsys.readouterr().out.startswith("service (rig, 7, REAL BOARD): ")


def test_stop_reaches_every_instance_and_with_a_name_that_one_alone(service: Path) -> None:
    names = ["default", "left", "right"]
    with ExitStack() as stack:
        rigs = {
            name: stack.enter_context(servo(files.runtime_folder(name), name)) for name in names
        }
        assert [one.instance for one in stop("left").daemons] == ["left"]
        assert [rigs[name].stop_word.pressed for name in names] == [False, True, False]
        assert [one.instance for one in stop(None).daemons] == names
        assert all(rig.stop_word.pressed for rig in rigs.values())


def test_default_by_name_is_ones_own_and_the_service(service: Path) -> None:
    own = servo(files.runtime_folder())
    with own, servo(service), servo(files.runtime_folder("left")) as left:
        found = stop("default")
        assert [one.folder for one in found.daemons] == [
            str(files.runtime_folder()),
            str(service),
        ]
        assert not left.stop_word.pressed


@pytest.mark.parametrize("started_in", ["session", "memory"])
def test_daemon_of_another_environment_is_reached(
    runtime: Path, monkeypatch: pytest.MonkeyPatch, started_in: str
) -> None:
    """Started in a session and stopped from cron, or the other way round."""
    uid = os.getuid()
    memory = runtime / "shm"
    memory.mkdir()
    monkeypatch.setattr(files, "SESSION_FOLDERS", runtime / "user")
    monkeypatch.setattr(files, "MEMORY_FOLDER", memory)
    places = {
        "session": runtime / "user" / str(uid) / "hapticd",
        "memory": memory / f"hapticd-{uid}",
    }
    with servo(places[started_in]) as moving:
        assert [one.folder for one in stop(None).daemons] == [str(places[started_in])]
        assert moving.stop_word.pressed


def test_a_stop_is_the_clients_in_whose_name_it_is_pressed(runtime: Path) -> None:
    with GatewayRig(files.runtime_folder()) as rig:
        client = rig.client()
        actor = rig.ask(client, cmd="hello")["result"]["actor"]
        with running(rig):
            stop("default", actor)
        assert rig.servo.word_pressers == {actor}
        assert rig.servo.taken == []  # nothing behind it that could come later


def test_everyone_is_pressed_before_anyone_is_waited_for(
    service: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with servo(files.runtime_folder()) as own, servo(service) as moving:
        seen: list[bool] = []

        def waited(_pressed: list[RuntimeFolder]) -> list[RuntimeFolder]:
            seen.extend([own.stop_word.pressed, moving.stop_word.pressed])
            return []

        monkeypatch.setattr(fast_stop, "_taken", waited)
        stop(None)
    assert seen == [True, True]


# --- whom it believes -----------------------------------------------------------------------------


def test_strangers_folder_is_refused_by_name_and_never_opened(
    runtime: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Whoever takes the name first in shared memory could else answer `stopped`."""
    monkeypatch.delenv("XDG_RUNTIME_DIR")
    memory = runtime / "shm"
    memory.mkdir()
    monkeypatch.setattr(files, "MEMORY_FOLDER", memory)
    stranger = os.getuid()
    as_user(monkeypatch, stranger + 1)
    trap = memory / f"hapticd-{stranger + 1}"
    with servo_of_a_stranger(trap) as word:
        assert main(None, False) == DaemonDown.exit_code
        assert word.read_bytes() == NOT_PRESSED
        said = capsys.readouterr().err
        assert f"{trap} belongs to user {stranger}, not to {stranger + 1}" in said
        with pytest.raises(MailboxError, match="belongs to user"):
            daemons.daemon_folder()


@contextmanager
def servo_of_a_stranger(folder: Path) -> Iterator[Path]:
    folder.mkdir(mode=0o700)
    word = folder / files.STOP
    word.write_bytes(NOT_PRESSED)
    with word.open("rb") as held:
        files.fcntl.flock(held, files.fcntl.LOCK_EX)
        yield word


@pytest.mark.parametrize("mode", [0o720, 0o702, 0o777])
def test_folder_that_others_may_write_is_refused_by_name(runtime: Path, mode: int) -> None:
    folder = files.runtime_folder()
    with servo(folder) as moving:
        folder.chmod(mode)
        with pytest.raises(DaemonDown, match=f"hapticd may be written by others .mode {mode:o}."):
            stop(None)
        assert not moving.stop_word.pressed
        folder.chmod(0o700)


def test_link_in_place_of_a_folder_is_refused_by_name(runtime: Path) -> None:
    with servo(runtime / "elsewhere") as moving:
        files.runtime_folder().symlink_to(runtime / "elsewhere")
        with pytest.raises(DaemonDown, match="hapticd is a link; remove it"):
            stop(None)
        assert not moving.stop_word.pressed


def test_instance_below_a_folder_that_is_not_believed_is_refused(runtime: Path) -> None:
    with servo(files.runtime_folder("left")) as moving:
        files.runtime_folder().chmod(0o777)
        with pytest.raises(DaemonDown, match="may be written by others"):
            stop("left")
        with pytest.raises(MailboxError, match="may be written by others"):
            daemons.daemon_folder("left")
        assert not moving.stop_word.pressed
        files.runtime_folder().chmod(0o700)


def test_service_of_another_user_is_believed_where_only_root_places_folders(
    service: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    owner = service.stat().st_uid
    with servo(service) as moving:
        service.parent.chmod(0o777)
        with pytest.raises(DaemonDown, match="others may have put it there"):
            stop(None)
        service.parent.chmod(0o711)
        assert stop(None).daemons
        assert moving.stop_word.pressed
    # what it is to everybody but the service's own user: a folder of somebody else
    if owner == 0:
        as_user(monkeypatch, 1)
        daemons.require_trusted(service)


@contextmanager
def without_rights() -> Iterator[None]:
    """Not even root may enter what is closed."""
    before = os.geteuid()
    os.seteuid(before or 65534)
    try:
        yield
    finally:
        os.seteuid(before)


COMMANDS = [["status"], ["get"], ["set", "K=1"], ["enable"], ["disable"], ["reset"], ["zero"]]
COMMANDS += [["home"], ["damping", "on"], ["dump"], ["perturb", "stop"], ["monitor", "--json"]]


@pytest.mark.parametrize("words", COMMANDS)
def test_service_that_may_not_be_entered_is_one_clear_sentence(
    service: Path, words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    service.parent.chmod(0o755)
    assert command_line(words) == DaemonDown.exit_code  # loads what may not be readable below
    capsys.readouterr()
    service.chmod(0)
    with without_rights():
        code = command_line(words)
    said = capsys.readouterr().err
    assert code == 1
    assert said.count("\n") == 1
    assert f"{service}: you may not enter the service's folder; have yourself added to" in said


def test_stop_of_ones_own_names_the_service_that_it_may_not_enter(
    service: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    service.parent.chmod(0o755)
    with servo(files.runtime_folder()):
        for step in (files.runtime_folder(), files.runtime_folder() / files.STOP):
            step.chmod(0o755 if step.is_dir() else 0o666)
        service.chmod(0)
        with without_rights():
            assert main(None, False) == 0
    assert f"left alone: {service}: you may not enter" in capsys.readouterr().err


def test_living_daemon_that_could_not_be_pressed_is_said_and_fails(
    service: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    service.parent.chmod(0o755)
    with servo(service), servo(files.runtime_folder("left")):
        service.chmod(0o755)
        (service / files.STOP).chmod(0o444)
        for step in (files.runtime_folder(), files.runtime_folder("left")):
            step.chmod(0o755)
        (files.runtime_folder("left") / files.STOP).chmod(0o666)
        with without_rights():
            assert main(None, True) == 1
    told = capsys.readouterr()
    assert f"NOT STOPPED: {service / files.STOP}: Permission denied" in told.err
    answer = json.loads(told.out)
    assert not answer["ok"]
    assert [one["instance"] for one in answer["daemons"]] == ["left"]


# --- what it says ---------------------------------------------------------------------------------


def test_servo_that_takes_the_stop_confirms_it_and_the_answer_names_everyone(
    service: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fast_stop, "TAKEN_MS", 10_000)
    with GatewayRig(files.prepare_folder(files.runtime_folder())) as rig:
        rig.servo.mailbox.report({"device": "example, SIM-1", "simulated": True})
        with running(rig):
            assert main(None, False) == 0
            assert capsys.readouterr().out == (
                "default (example, SIM-1, SIMULATED): stopped: force off; `hapticd reset` when it"
                " is safe\n"
            )
            assert main("default", True) == 0
        assert rig.servo.state is State.STOPPED
    answer = json.loads(capsys.readouterr().out)
    assert (answer["ok"], answer["state"]) == (True, "stopped")
    assert answer["daemons"] == [
        {
            "folder": str(files.runtime_folder()),
            "instance": "default",
            "device": "example, SIM-1",
            "simulated": True,
            "state": "stopped",
        }
    ]


def test_stop_is_confirmed_once_the_word_is_taken_back_and_not_before(
    runtime: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    with servo(files.runtime_folder(), "example, 7", False) as moving:
        assert main(None, False) == 0
        assert capsys.readouterr().out == (
            "default (example, 7, REAL BOARD): pressed; the servo has not taken it yet, see"
            " `hapticd status`\n"
        )
        looks = iter([moving.stop_word.mend, moving.stop_word.mend, moving.stop_word.take_back])
        monkeypatch.setattr(fast_stop.time, "sleep", lambda _seconds: next(looks)())
        monkeypatch.setattr(fast_stop, "TAKEN_MS", 10_000)
        assert main(None, False) == 0
    assert "stopped: force off" in capsys.readouterr().out
    assert list(looks) == []


def test_one_servo_that_stands_still_does_not_hide_that_another_has_stopped(
    service: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with servo(files.runtime_folder()) as own, servo(service):
        monkeypatch.setattr(fast_stop.time, "sleep", lambda _seconds: own.stop_word.take_back())
        monkeypatch.setattr(fast_stop, "TAKEN_MS", 5)
        assert [one.state for one in stop(None).daemons] == ["stopped", "pressed"]


def test_gateway_that_hangs_does_not_keep_the_stop_away(
    runtime: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with GatewayRig(files.prepare_folder(files.runtime_folder())) as rig:  # nobody steps it
        assert main(None, False) == 0
        assert "pressed" in capsys.readouterr().out
        rig.servo.tick()
        assert rig.servo.state is State.STOPPED


def test_socket_whose_queue_is_full_does_not_keep_the_stop_away(runtime: Path) -> None:
    with servo(files.runtime_folder()) as moving, socket.socket(socket.AF_UNIX) as deaf:
        path = str(files.runtime_folder() / files.COMMAND_SOCKET)
        deaf.bind(path)
        deaf.listen(0)
        with socket.socket(socket.AF_UNIX) as first:
            first.connect(path)
            assert stop(None).daemons[0].state == "pressed"
            assert moving.stop_word.pressed


def test_nothing_alive_exits_3(runtime: Path, capsys: pytest.CaptureFixture[str]) -> None:
    leftovers(files.runtime_folder())
    assert main(None, False) == 3
    assert "no daemon runs there; start it with `hapticd run`" in capsys.readouterr().err
    assert main(None, True) == 3
    assert '"ok": false' in capsys.readouterr().out
