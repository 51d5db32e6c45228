"""Whoever may write the stop word may only stop: what he does to the file, the servo ends up
stopped, its process lives, and the word works again.
"""

import errno
import os
import stat
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from support.boards import board_params
from support.gateway_rig import GatewayRig
from support.models import servo_params

from hapticd.core.errors import MailboxError
from hapticd.mailbox import files, layout
from hapticd.mailbox.daemons import MODE, NOT_PRESSED, StopWord, press_stop, servo_lives, stop_taken
from hapticd.mailbox.layout import Command, Result, State, Value
from hapticd.mailbox.servo_side import ServoMailbox
from hapticd.run import supervisor
from hapticd.run.lockstep import LockStep
from hapticd.servo.plan import SETTLED
from hapticd.settings.load import load
from hapticd.settings.toml import shipped
from hapticd.usb.frames import OutFlag

pytestmark = pytest.mark.usefixtures("either_way")


MENDED_TICKS = 256  # between two looks at what stands under the word's name
HELD_TICKS = 1000  # for which nobody resets a press of the word
FIG_4 = {Value.STIFFNESS: 100.0, Value.VIRTUAL_DAMPING: 1.0, Value.MASS: 0.010, Value.RAMP_S: 0.0}
ENABLE_TICKS = 520
FADE_TICKS = 21  # of a stop ramp of 20 ms, after which the word is taken back
DTYPE = np.dtype([tuple(field) for field in layout.TELEMETRY])


@pytest.fixture
def stack() -> Iterator[LockStep]:
    """A servo that renders."""
    with LockStep(servo_params(), board_params()) as found:
        found.run(5)
        assert found.do(Command.SET, FIG_4).result is Result.APPLIED
        assert found.do(Command.ENABLE).result is Result.APPLIED
        found.run(ENABLE_TICKS)
        yield found


def states(stack: LockStep, ticks: int) -> list[int]:
    found: list[int] = np.frombuffer(stack.run(ticks), DTYPE)["state"].tolist()
    return found


def cut_short(path: Path) -> None:
    os.truncate(path, 0)


def cut_by_a_byte(path: Path) -> None:
    os.truncate(path, 7)


def extended(path: Path) -> None:
    os.truncate(path, 1 << 40)


def written_over(path: Path) -> None:
    with path.open("r+b") as file:
        file.write(b"\0\0\0\0\0\0\0 ")


def removed(path: Path) -> None:
    path.unlink()


def replaced(path: Path) -> None:
    path.unlink()
    path.write_bytes(NOT_PRESSED)


def made_a_pipe(path: Path) -> None:
    path.unlink()
    os.mkfifo(path)


def made_a_link(path: Path) -> None:
    elsewhere = path.with_name("elsewhere")
    path.rename(elsewhere)
    path.symlink_to(elsewhere)


def made_a_folder(path: Path) -> None:
    path.unlink()
    (path / "x").mkdir(parents=True)


def closed_to_the_group(path: Path) -> None:
    path.chmod(0o600)


Mischief = Callable[[Path], None]
SEEN_AT_ONCE = [press_stop, cut_short, cut_by_a_byte, extended, written_over]
SEEN_BY_NAME = [removed, replaced, made_a_pipe, made_a_link, closed_to_the_group]


def at(path: Path, mischief: Mischief) -> None:
    mischief(path.parent if mischief is press_stop else path)


@pytest.mark.parametrize("mischief", SEEN_AT_ONCE)
def test_whatever_is_written_into_the_word_stops_in_the_next_tick(
    stack: LockStep, mischief: Mischief
) -> None:
    at(stack.mailbox.folder / files.STOP, mischief)
    assert states(stack, 1) == [State.STOPPED]


@pytest.mark.parametrize("mischief", SEEN_BY_NAME)
def test_word_that_is_not_the_servos_own_any_more_stops_within_256_ticks(
    stack: LockStep, mischief: Mischief
) -> None:
    at(stack.mailbox.folder / files.STOP, mischief)
    assert states(stack, MENDED_TICKS + 1)[-1] == State.STOPPED


@pytest.mark.parametrize("mischief", [*SEEN_AT_ONCE, *SEEN_BY_NAME])
def test_servo_serves_again_after_mischief_and_the_word_stops_again(
    stack: LockStep, mischief: Mischief
) -> None:
    folder = stack.mailbox.folder
    at(folder / files.STOP, mischief)
    stack.run(HELD_TICKS + MENDED_TICKS + FADE_TICKS)  # held since the last tick of the press
    assert stack.do(Command.RESET).result is Result.APPLIED
    assert stack.do(Command.ENABLE).result is Result.APPLIED
    assert states(stack, 2 * MENDED_TICKS)[-1] == State.ENABLED
    press_stop(folder)
    assert states(stack, 1) == [State.STOPPED]
    stack.run(FADE_TICKS)
    assert stop_taken(folder)
    found = (folder / files.STOP).lstat()
    assert (stat.S_ISREG(found.st_mode), stat.S_IMODE(found.st_mode)) == (True, MODE)
    assert found.st_size == len(NOT_PRESSED)


def test_word_that_cannot_be_taken_back_stays_a_stop(
    stack: LockStep, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Cut short where there is no room for a page."""

    def no_room(*_: object) -> int:
        raise OSError(errno.ENOSPC, "No space left on device")

    press_stop(stack.mailbox.folder)
    monkeypatch.setattr(os, "pwrite", no_room)
    assert states(stack, MENDED_TICKS + 50)[-1] == State.STOPPED
    monkeypatch.undo()
    assert states(stack, 1) == [State.STOPPED]
    assert not stack.mailbox.stop_word.pressed


class Touches:
    """What this process writes, cuts, reserves, removes, renames or closes, seen as it happens."""

    CALLS = ("pwrite", "write", "ftruncate", "truncate", "posix_fallocate", "fchmod", "open")
    CALLS += ("rename", "replace", "unlink", "close")

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.seen: list[str] = []
        for name in self.CALLS:
            monkeypatch.setattr(os, name, self._noted(name, getattr(os, name)))

    def _noted(self, name: str, call: Callable[..., object]) -> Callable[..., object]:
        def noted(*arguments: object, **options: object) -> object:
            self.seen.append(name)
            return call(*arguments, **options)

        return noted


@pytest.mark.parametrize("mischief", [*SEEN_AT_ONCE, *SEEN_BY_NAME])
def test_servo_touches_no_file_while_force_acts(
    stack: LockStep, monkeypatch: pytest.MonkeyPatch, mischief: Mischief
) -> None:
    """Whoever writes 100 MB into the word holds its inode: a write of the servo would wait for it,
    the last force in effect. Reading waits for nobody.
    """
    stack.run(-stack.loop.tick % MENDED_TICKS)
    at(stack.mailbox.folder / files.STOP, mischief)
    touches = Touches(monkeypatch)
    while stack.loop.state[SETTLED].out_flags & OutFlag.ENABLE:
        stack.loop.run(1)
        stack.gateway.beat(stack.clock.now_ns())
        assert touches.seen == []
    stack.loop.run(3)
    assert touches.seen != []
    monkeypatch.undo()
    assert not stack.mailbox.stop_word.pressed


def test_press_stands_until_no_force_acts_and_then_the_word_is_another_file(
    stack: LockStep,
) -> None:
    """What the presser has open is never written: he may hold its inode as long as he likes."""
    path = stack.mailbox.folder / files.STOP
    with path.open("r+b", buffering=0) as held:
        held.write(b"press me")
        for _ in range(FADE_TICKS):
            assert stack.mailbox.stop_word.pressed
            assert states(stack, 1) == [State.STOPPED]
        assert stack.loop.state[SETTLED].out_flags & OutFlag.ENABLE == 0
        stack.run(1)
        assert stop_taken(stack.mailbox.folder)
        assert os.pread(held.fileno(), 9, 0) == b"press me"
        assert os.fstat(held.fileno()).st_nlink == 0


def test_press_into_a_word_that_was_just_renamed_over_is_made_again(
    servo: ServoMailbox, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Else it would be lost in a file that nobody reads any more."""
    write = os.pwrite

    def late(*transfer: object) -> int:
        monkeypatch.setattr(os, "pwrite", write)
        servo.stop_word.take_back()
        return write(*transfer)  # type: ignore[arg-type]

    monkeypatch.setattr(os, "pwrite", late)
    press_stop(tmp_path)
    assert servo.stop_word.pressed


def test_press_of_a_servo_without_force_is_taken_back_at_once(stack: LockStep) -> None:
    press_stop(stack.mailbox.folder)
    stack.run(FADE_TICKS + 1)
    press_stop(stack.mailbox.folder)
    assert not stop_taken(stack.mailbox.folder)
    stack.run(1)
    assert stop_taken(stack.mailbox.folder)


def test_word_that_is_written_all_the_time_only_stops(stack: LockStep) -> None:
    for _ in range(50):
        press_stop(stack.mailbox.folder)
        assert states(stack, 1) == [State.STOPPED]
    stack.run(FADE_TICKS)
    assert not stack.mailbox.stop_word.pressed
    stack.run(HELD_TICKS)
    assert stack.do(Command.RESET).result is Result.APPLIED


def test_press_between_reset_and_enable_keeps_the_servo_stopped(stack: LockStep) -> None:
    press_stop(stack.mailbox.folder)
    stack.run(50)
    stack.command(Command.RESET)
    stack.command(Command.ENABLE)
    press_stop(stack.mailbox.folder)
    assert states(stack, 3)[-1] == State.STOPPED


# --- who presses ----------------------------------------------------------------------------------


@pytest.fixture
def servo(tmp_path: Path) -> Iterator[ServoMailbox]:
    mailbox = ServoMailbox(tmp_path, 1000.0, "", True, 5_000)
    mailbox.publish()
    yield mailbox
    mailbox.close()


def test_press_is_taken_back_by_whoever_obeys(servo: ServoMailbox, tmp_path: Path) -> None:
    assert not servo.stop_word.pressed
    press_stop(tmp_path)
    assert servo.stop_word.pressed
    assert not stop_taken(tmp_path)
    servo.stop_word.take_back()
    assert stop_taken(tmp_path)


def test_word_of_a_dead_servo_says_so(tmp_path: Path) -> None:
    (tmp_path / files.STOP).write_bytes(NOT_PRESSED)  # as a killed process leaves it
    assert not servo_lives(tmp_path)
    with pytest.raises(
        MailboxError, match=r"stop: its servo has ended, and the board stopped with it"
    ):
        press_stop(tmp_path)


def test_word_is_held_as_soon_as_it_has_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[bool] = []
    replace = Path.replace

    def watched(self: Path, target: Path) -> Path:
        moved = replace(self, target)
        seen.append(servo_lives(tmp_path))
        return moved

    monkeypatch.setattr(Path, "replace", watched)
    word = StopWord(tmp_path)
    assert seen == [True]
    word.close()
    assert not servo_lives(tmp_path)


@pytest.mark.parametrize(
    ("mischief", "said"),
    [
        (made_a_pipe, "is not a file; remove it"),
        (made_a_folder, "Is a directory"),
        (made_a_link, "Too many levels of symbolic links"),
        (removed, "No such file or directory; no servo runs there"),
    ],
)
def test_what_is_no_word_is_refused_without_waiting(
    tmp_path: Path, mischief: Mischief, said: str
) -> None:
    (tmp_path / files.STOP).write_bytes(NOT_PRESSED)
    mischief(tmp_path / files.STOP)
    with pytest.raises(MailboxError, match=said):
        press_stop(tmp_path)
    assert not servo_lives(tmp_path)
    assert not stop_taken(tmp_path)


# --- rights of every file -------------------------------------------------------------------------


def test_group_may_write_the_stop_word_and_no_other_file(runtime: Path) -> None:
    """Even with a umask that leaves the group every right; sockets are how it commands."""
    folder = files.prepare_folder(files.runtime_folder())
    before = os.umask(0)
    try:
        supervisor.write(folder, load(shipped("config") / "hapticd.toml"), "default")
        with GatewayRig(folder) as rig:
            rig.servo.mailbox.report({"a": 1})
            modes = {path.name: path.lstat().st_mode for path in folder.iterdir()}
    finally:
        os.umask(before)
    plain = {name: stat.S_IMODE(mode) for name, mode in modes.items() if stat.S_ISREG(mode)}
    assert plain.pop(files.STOP) == MODE
    assert {files.MAILBOX, files.REPORT, files.ENDPOINTS, files.SERVO_JSON} <= set(plain)
    assert not {name: oct(mode) for name, mode in plain.items() if mode & 0o027}
