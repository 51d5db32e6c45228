"""Faults in the environment of a daemon: disk, memory, its runtime folder, another local user.

A read-only folder and a full disk are mounted where private mounts are permitted (`unshare`).
Elsewhere a folder that cannot be created and a limit on file size replace them; the figure
`true_mounts` tells which. Only the user number of another user is needed, so root can take it.
Without root, the modes of all files are checked instead (`true_user`).
"""

import os
import resource
import shutil
import socket
import stat
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from random import Random

from hapticd.core.errors import CommandError, DaemonDown
from hapticd.mailbox import files
from hapticd.mailbox.daemons import press_stop
from support.attacks.live import LiveDaemon, Watch, until, usage
from support.attacks.peers import REQUESTS, Peers, framed, send
from support.attacks.rows import Losses, Outcome
from support.attacks.stage import Stage, settings, shared

NOBODY = 65534
PATIENCE_S = 60.0
ROOM = 4 << 20  # bytes of memory beyond the current use of the gateway
SMALL = 64 << 10  # bytes of a disk that is too small for the rings


# --- disk and runtime folder ----------------------------------------------------------------------


def mounts_permitted() -> bool:
    """Return whether this user may mount file systems in a private namespace."""
    command = ["unshare", "-rm", "mount", "-t", "tmpfs", "none", "/mnt"]
    try:
        return subprocess.run(command, capture_output=True, check=False).returncode == 0
    except OSError:
        return False


class Refusal:
    """The output of `hapticd WORDS` where it cannot work."""

    def __init__(self, words: list[str], runtime: Path, mount: str = "") -> None:
        command = [sys.executable, "-m", "hapticd", *words]
        if mount:
            command = ["unshare", "-rm", "sh", "-c", f'{mount} && exec "$@"', "-", *command]
        done = subprocess.run(
            command,
            env={**os.environ, "XDG_RUNTIME_DIR": str(runtime)},
            preexec_fn=None if mount else _small_files,
            capture_output=True,
            text=True,
            timeout=PATIENCE_S,
            check=False,
        )
        self.code = done.returncode
        self.said = done.stdout + done.stderr

    def check(self, named: str) -> None:
        """AssertionError unless it ended with an error that names `named`."""
        assert self.code not in (0, -9), f"exit code {self.code}"
        assert "Traceback" not in self.said, self.said[-300:]
        assert named in self.said, f"{named} is not named: {self.said[-300:]}"


def _small_files() -> None:
    resource.setrlimit(resource.RLIMIT_FSIZE, (SMALL, SMALL))


RUN = ["run", "--no-console", "--instance", "refused"]


def runtime_folder(times: int, seed: int) -> Outcome:
    """`times` starts in a runtime folder that is missing, read-only, a file, a link or open."""
    mounts = mounts_permitted()
    cases: list[Callable[[Path], None]] = [_missing, _beneath_a_file, _linked, _open_to_all]
    cases += [_read_only] if mounts else []
    return _cases(cases, times, seed, true_mounts=float(mounts))


def _missing(folder: Path) -> None:
    """It is made."""
    runtime = folder / "not" / "there"
    with LiveDaemon(settings(bool(shared)), runtime=runtime) as daemon:
        assert stat.S_IMODE(daemon.folder.stat().st_mode) == 0o700


def _beneath_a_file(folder: Path) -> None:
    (folder / "file").write_text("")
    Refusal(RUN, folder / "file").check(str(folder / "file"))


def _linked(folder: Path) -> None:
    (folder / "elsewhere").mkdir()
    (folder / "hapticd").symlink_to(folder / "elsewhere")
    instance = folder / "hapticd" / "instance-refused"
    instance.symlink_to(folder / "elsewhere")
    Refusal(RUN, folder).check("is a link")
    assert [one.name for one in (folder / "elsewhere").iterdir()] == ["instance-refused"]


def _open_to_all(folder: Path) -> None:
    (folder / "hapticd").mkdir()
    (folder / "hapticd").chmod(0o777)
    Refusal(RUN, folder).check("may be written by others")


def _read_only(folder: Path) -> None:
    mount = f"mount -t tmpfs -o ro none {folder}"
    Refusal(RUN, folder, mount).check("Read-only file system")


def disk(times: int, seed: int) -> Outcome:
    """`times` times no room: for the rings, for a flight recording, for a recording."""
    mounts = mounts_permitted()
    cases = [_no_room_for_rings, _no_room_for_flight, _no_room_for_recording]
    return _cases(cases, times, seed, true_mounts=float(mounts))


def _tmpfs(folder: Path, size: int) -> str:
    return f"mount -t tmpfs -o size={size} none {folder}" if mounts_permitted() else ""


def _no_room_for_rings(folder: Path) -> None:
    Refusal(RUN, folder, _tmpfs(folder, SMALL)).check("free some space")


def _no_room_for_flight(folder: Path) -> None:
    """The gateway continues, and reports that the recording was not written."""
    with _under_force() as (daemon, watch):
        gateway = daemon.processes()["gateway"]
        before = resource.prlimit(gateway, resource.RLIMIT_FSIZE, (SMALL, resource.RLIM_INFINITY))
        daemon.client.call("dump")

        def told() -> bool:
            events = daemon.client.status().events
            return any("could not be written" in one.text for one in events)

        until(told, "it is told that the flight could not be written")
        resource.prlimit(gateway, resource.RLIMIT_FSIZE, before)
        assert daemon.processes()["gateway"] == gateway, "the gateway ended"
        _still_whole(daemon, watch)


def _no_room_for_recording(folder: Path) -> None:
    """The recorder ends with an error; the daemon continues."""
    with _under_force() as (daemon, watch):
        target = folder / "disk"
        target.mkdir()
        words = ["rec", str(target / "full.h5"), "--seconds", "5", "--instance", daemon.instance]
        Refusal(words, daemon.runtime, _tmpfs(target, SMALL)).check("full")
        _still_whole(daemon, watch)


# --- memory ---------------------------------------------------------------------------------------


def memory(times: int, seed: int) -> Outcome:
    """Run `times` rounds in which a process gets no more memory, with requests that need memory."""
    losses = Losses()
    with _under_force() as (daemon, watch):
        for number in range(times):
            name = ("gateway", "guard", "servo")[number % 3]
            try:
                _starved(daemon, watch, name, Random(seed + number))
            except AssertionError as error:
                losses.add(f"{name} without memory: {error}")
        return losses.outcome(times, stop_longest_ms=watch.stop_longest_ms)


def _starved(daemon: LiveDaemon, watch: Watch, name: str, random: Random) -> None:
    servo = daemon.processes()["servo"]
    pid = until(lambda: daemon.processes().get(name), f"{name} is there")
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[0])
    limit = pages * resource.getpagesize() + (ROOM if name != "servo" else 0)
    before = resource.prlimit(pid, resource.RLIMIT_AS, (limit, resource.RLIM_INFINITY))
    peers = Peers(daemon.folder, random.randrange(1 << 30))
    for _ in range(20):
        line = peers.open(files.COMMAND_SOCKET, b"DEALER")
        if line is not None:
            send(line, framed(random.choice(REQUESTS)) * 50 + framed(bytes(60_000)))
    for cmd in ("dump", "get", "status"):
        with suppress(CommandError, DaemonDown):
            daemon.client.call(cmd)
    peers.close()
    with suppress(ProcessLookupError):
        resource.prlimit(pid, resource.RLIMIT_AS, before)
    until(daemon.state, "it answers")
    assert daemon.processes()["servo"] == servo, "the servo ended"
    _still_whole(daemon, watch)


# --- files of the runtime folder ------------------------------------------------------------------


def folder_files(times: int, seed: int) -> Outcome:
    """Truncate, overwrite, remove or replace `times` files of a running daemon by a program of the
    same user. The force never returns by itself, and a restart repairs everything.
    """
    losses = Losses()
    random = Random(seed)
    for _ in range(times):
        with Stage(patient=bool(shared)) as stage:
            daemon = stage.daemon
            watch = stage.watch
            daemon.to_force()
            there = sorted(one for one in daemon.folder.iterdir() if one.is_file())
            path = random.choice(there)
            way = random.choice(list(DAMAGE))
            try:
                DAMAGE[way](path, random)
                _survived(daemon, watch)
            except AssertionError as error:
                losses.add(f"{path.name} {way}: {error}")
    return losses.outcome(times)


def _cut(path: Path, random: Random) -> None:
    os.truncate(path, random.randrange(path.stat().st_size + 1) // 2)


def _overwrite(path: Path, random: Random) -> None:
    size = path.stat().st_size
    with path.open("r+b") as file:
        for _ in range(random.choice((1, 20, 200))):
            file.seek(random.randrange(max(1, size)))
            file.write(random.randbytes(random.choice((1, 8, 64))))


def _replace(path: Path, random: Random) -> None:
    fresh = path.with_name("hostile")
    fresh.write_bytes(random.randbytes(random.choice((0, 8, 5000))))
    fresh.replace(path)


def _remove(path: Path, random: Random) -> None:
    path.unlink()


DAMAGE: dict[str, Callable[[Path, Random], None]] = {
    "cut short": _cut,
    "overwritten": _overwrite,
    "replaced": _replace,
    "removed": _remove,
}


def _survived(daemon: LiveDaemon, watch: Watch) -> None:
    """AssertionError if a restarted servo has force, or if a restart does not repair the daemon."""
    lives = watch.lives
    time.sleep(0.5)
    if watch.lives > lives:
        time.sleep(0.3)
        assert not watch.live_in_this_life, "force came back by itself"
    with suppress(Exception):
        press_stop(daemon.folder)
    daemon.process.terminate()
    try:
        daemon.process.wait(PATIENCE_S)
    except subprocess.TimeoutExpired:
        raise AssertionError("it did not end") from None
    lives = watch.lives
    daemon.restart()
    until(lambda: daemon.state() == "disabled", "it answers after a new start")
    until(lambda: watch.lives > lives, "the next servo")
    assert not watch.live_in_this_life, "force came back by a new start"
    daemon.to_force()


# --- another user ---------------------------------------------------------------------------------


def local_user(times: int, seed: int) -> Outcome:
    """Run `times` rounds of another user that tries every name and floods the telemetry by TCP."""
    losses = Losses()
    true_user = os.geteuid() == 0
    with _under_force() as (daemon, watch):
        for _ in range(times):
            try:
                _modes(daemon.folder)
                if true_user:
                    _as_nobody(daemon)
                _still_whole(daemon, watch)
            except AssertionError as error:
                losses.add(str(error))
        longest_ms = watch.stop_longest_ms
    return losses.outcome(times, true_user=float(true_user), stop_longest_ms=longest_ms)


def _modes(folder: Path) -> None:
    """AssertionError for a folder that others may enter, or a file that they may write."""
    assert stat.S_IMODE(folder.stat().st_mode) & 0o077 == 0
    for one in folder.iterdir():
        assert stat.S_IMODE(one.stat().st_mode) & 0o002 == 0 or one.is_socket(), one.name


def _as_nobody(daemon: LiveDaemon) -> None:
    host, _, port = daemon.client.hello().endpoints["telemetry"][1][6:].rpartition(":")
    names = [*daemon.folder.iterdir(), daemon.folder]
    child = os.fork()
    if child == 0:
        code = 1
        try:
            daemon.runtime.chmod(0o755)  # as /dev/shm is
            os.setgroups([])
            os.setgid(NOBODY)
            os.setuid(NOBODY)
            code = _trespasses(names) or _flooded(host, int(port))
        finally:
            os._exit(code)
    _, status = os.waitpid(child, 0)
    assert os.waitstatus_to_exitcode(status) == 0, "another user got in"


def _trespasses(names: list[Path]) -> int:
    """How many of `names` can be reached."""
    reached = 0
    for one in names:
        for flags in (os.O_RDONLY, os.O_RDWR):
            with suppress(OSError):
                os.close(os.open(one, flags))
                reached += 1
        with suppress(OSError), socket.socket(socket.AF_UNIX) as line:
            line.connect(str(one))
            reached += 1
        with suppress(OSError):
            one.unlink()
            reached += 1
    return reached


def _flooded(host: str, port: int) -> int:
    """0, after subscriptions and requests to the telemetry's port."""
    for _ in range(50):
        with suppress(OSError), socket.socket() as line:
            line.settimeout(1.0)
            line.connect((host, port))
            line.sendall(Random(1).randbytes(5000))
    return 0


# --- helpers --------------------------------------------------------------------------------------


@contextmanager
def _under_force() -> Iterator[tuple[LiveDaemon, Watch]]:
    if shared:
        shared[0].daemon.to_force()
        yield shared[0].daemon, shared[0].watch
        return
    with Stage() as stage:
        stage.daemon.to_force()
        yield stage.daemon, stage.watch


def _still_whole(daemon: LiveDaemon, watch: Watch) -> None:
    """AssertionError unless it ticks, answers and obeys a stop."""
    ticks = watch.ticks
    until(lambda: watch.ticks > ticks, "it ticks")
    since_ns = time.monotonic_ns()
    press_stop(daemon.folder)
    watch.stopped_ms(since_ns)
    daemon.to_force()
    assert usage(daemon.processes()["servo"]).threads == 1


def _cases(cases: list[Callable[[Path], None]], times: int, seed: int, **figures: float) -> Outcome:
    losses = Losses()
    for number in range(times):
        case = cases[(seed - 1 + number) % len(cases)]
        folder = Path(tempfile.mkdtemp(prefix="hapticd-attack-"))
        try:
            case(folder)
        except AssertionError as error:
            losses.add(f"{case.__name__.strip('_')}: {error}")
        finally:
            shutil.rmtree(folder, ignore_errors=True)
    return losses.outcome(times, **figures)
