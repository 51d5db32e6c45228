"""A live daemon, the records of all its ticks, and its processes.

`Watch` reads the telemetry ring from the file that the servo maps. It needs no gateway, so it also
records the servo while the gateway is stopped, killed or flooded. A tick that took longer than its
period shows as a jump of `slot` over `tick`. A tick that a fault of the board made late (the read
waits for a missing frame) contains no information on the machine. Ticks within NEAR_TICKS of a
disturbed one are therefore counted separately.
"""

import ctypes
import json
import os
import resource
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np

from hapticd.client import Client
from hapticd.client.blocks import BlockDecoder
from hapticd.core.errors import CommandError, DaemonDown, HapticdError
from hapticd.core.faults import BY_NUMBER
from hapticd.core.units import NS_PER_MS
from hapticd.mailbox import files, layout
from hapticd.mailbox.layout import State
from hapticd.servo.plan import LINK_UP

PR_SET_PDEATHSIG = 1
LIBC = ctypes.CDLL(None)
DTYPE = np.dtype([tuple(field) for field in layout.TELEMETRY])
LOOK_S = 0.02
NEAR_TICKS = 30
PATIENCE_S = 60.0
PROCESSES = ("servo", "gateway", "guard", "console")
MODULES = {
    b"hapticd.run.servo_main": "servo",
    b"hapticd.run.gateway_main": "gateway",
    b"hapticd.guard.worker": "guard",
    b"console": "console",
}


def until(condition: Callable[[], Any], what: str, patience_s: float = PATIENCE_S) -> Any:
    """The first true value of `condition`. AssertionError after `patience_s`."""
    deadline = time.monotonic() + patience_s
    while not (found := condition()):
        assert time.monotonic() < deadline, f"not within {patience_s:g} s: {what}"
        time.sleep(0.01)
    return found


class Change(NamedTuple):
    """A tick whose state or fault differs from the preceding one."""

    time_ns: int
    state: int
    fault: int


class Watch(threading.Thread):
    """Reads the ring of the daemon in `folder` until `close`."""

    def __init__(self, folder: Path) -> None:
        super().__init__(name="watch")
        self._path = folder / files.TELEMETRY
        self._ending = threading.Event()
        # read into private memory: SIGBUS kills a process that maps a truncated file
        self._ring = memoryview(bytearray(layout.TELEMETRY_BYTES))
        self._file = -1  # descriptor
        self._inode = 0
        self._head = 0
        self._rows: Any = None
        self._last: Any = None  # the newest record
        self._since_disturbed = NEAR_TICKS
        self.changes: list[Change] = []
        self.faults: Counter[str] = Counter()
        self.lives = 0  # of servos
        self.ticks = self.quiet_ticks = self.late_quiet = self.late = self.unread = 0
        self.enabled_ticks = 0
        self.forced_ticks = 0
        self.live_in_this_life = 0  # ticks of the servo that runs now, enabled or with force
        self.newest_ns = 0
        self.stop_longest_ms = 0.0
        self.error = ""
        self._look()  # an existing life is not a new one
        self.start()

    def run(self) -> None:
        """Poll until the end."""
        try:
            while not self._ending.wait(LOOK_S):
                self._look()
        except Exception as error:
            self.error = repr(error)
            raise

    def close(self) -> None:
        """End the thread."""
        self._ending.set()
        self.join()
        if self._file >= 0:
            os.close(self._file)

    def stopped_ms(self, since_ns: int) -> float:
        """From `since_ns` to the first tick that is stopped (or in fault) with no force. Waits."""

        def gone() -> int:
            rows = self._rows
            if rows is None:  # it has not looked yet
                return 0
            ended = (rows["state"] == State.STOPPED) | (rows["state"] == State.FAULT)
            times = rows["time_ns"][ended & (rows["force_n"] == 0.0)]
            times = times[times >= since_ns]
            return int(times.min()) - since_ns if len(times) else 0

        took_ms = float(until(gone, "a stop is obeyed")) / NS_PER_MS
        self.stop_longest_ms = max(self.stop_longest_ms, took_ms)
        return took_ms

    def _look(self) -> None:
        try:
            inode = os.stat(self._path).st_ino
        except FileNotFoundError:
            inode = 0
        if self._file >= 0:
            self._read()
        if inode and inode != self._inode:
            self._open(inode)

    def _open(self, inode: int) -> None:
        descriptor = os.open(self._path, os.O_RDONLY)
        if os.fstat(descriptor).st_size != layout.TELEMETRY_BYTES:
            os.close(descriptor)
            return  # it is being made
        if self._file >= 0:
            os.close(self._file)
        self._file = descriptor
        self._inode = inode
        os.preadv(descriptor, [self._ring], 0)
        self._head = max(0, self._written() - layout.RING_RECORDS // 2)
        self._last = None
        self.live_in_this_life = 0
        self._rows = np.frombuffer(self._ring, DTYPE, layout.RING_RECORDS, layout.TELEMETRY_OFFSET)
        self._read()
        self.lives += 1

    def _written(self) -> int:
        """Return the number of records written, from the head of the ring."""
        return int.from_bytes(os.pread(self._file, 8, 0), "little")

    def _read(self) -> None:
        head = self._written()
        first = max(self._head, head - layout.RING_RECORDS // 2)
        self.unread += first - self._head
        self._head = head
        if head <= first:
            return
        begin = first % layout.RING_RECORDS
        end = begin + head - first
        for part in (
            slice(begin, min(end, layout.RING_RECORDS)),
            slice(0, end - layout.RING_RECORDS),
        ):
            self._fetch(part)
        self._take(self._rows[np.arange(begin, end) % layout.RING_RECORDS])

    def _fetch(self, part: slice) -> None:
        """Bring the records in these places of the ring."""
        if part.stop > part.start:
            size = layout.RECORD.size
            place = layout.TELEMETRY_OFFSET + part.start * size
            os.preadv(
                self._file, [self._ring[place : place + (part.stop - part.start) * size]], place
            )

    def _take(self, rows: Any) -> None:
        before = self._last if self._last is not None else rows[0]
        joined = np.concatenate(([before], rows))
        lost = np.diff(joined["slot"].astype(np.int64)) > np.diff(joined["tick"].astype(np.int64))
        # a gap of the watch itself is not a slot
        disturbed = (rows["arrival"] != 0) | (rows["host"] & LINK_UP == 0)
        quiet = self._quiet(disturbed)
        self.ticks += len(rows)
        self.quiet_ticks += int(quiet.sum())
        self.late += int(lost.sum())
        self.late_quiet += int((lost & quiet).sum())
        self.enabled_ticks += int((rows["state"] == State.ENABLED).sum())
        self.forced_ticks += int((rows["force_n"] != 0.0).sum())
        live = (rows["state"] == State.ENABLED) | (rows["force_n"] != 0.0)
        self.live_in_this_life += int(live.sum())
        changed = np.diff(joined["state"].astype(int)) != 0
        changed |= np.diff(joined["fault"].astype(int)) != 0
        for row in rows[changed]:
            self.changes.append(Change(int(row["time_ns"]), int(row["state"]), int(row["fault"])))
            fault = BY_NUMBER.get(int(row["fault"]))  # none where the ring was written over
            self.faults[fault.code if fault else "unknown"] += int(row["fault"]) != 0
        self._last = rows[-1].copy()
        self.newest_ns = int(self._last["time_ns"])

    def _quiet(self, disturbed: Any) -> Any:
        """Ticks with no disturbed one among the NEAR_TICKS before them."""
        places = np.where(disturbed, np.arange(len(disturbed)), -self._since_disturbed - 1)
        since = np.arange(len(disturbed)) - np.maximum.accumulate(places)
        self._since_disturbed = min(int(since[-1]), 1 << 30)
        return since > NEAR_TICKS


class Subscriber(threading.Thread):
    """A client that reads every message of `servo.raw` and counts the missing ones."""

    def __init__(self, instance: str) -> None:
        super().__init__(name="subscriber")
        self._instance = instance
        self._ending = threading.Event()
        self.records = self.gap = self.messages = self.restarts = 0
        self.start()

    def run(self) -> None:
        """Read until the end."""
        decoder = BlockDecoder()
        with Client(self._instance) as client:
            for came in client.messages(["servo.raw"]):
                if self._ending.is_set():
                    return
                if came is not None:
                    block = decoder.decode(came[1])
                    self.messages += 1
                    self.records += len(block.records)
                    self.restarts += block.restarted
                    self.gap += block.gap

    def close(self) -> None:
        """End the thread."""
        self._ending.set()
        self.join()


class Usage(NamedTuple):
    """Resources of a process."""

    private_kb: int
    descriptors: int
    threads: int
    cpu_s: float


def usage(pid: int) -> Usage:
    """Of the process `pid`. OSError: it is gone."""
    place = Path(f"/proc/{pid}")
    rollup = (place / "smaps_rollup").read_text()
    private = sum(
        int(line.split()[1])
        for line in rollup.splitlines()
        if line.startswith(("Private_Clean", "Private_Dirty"))
    )
    after_name = (place / "stat").read_text().rpartition(")")[2].split()
    cpu = (int(after_name[11]) + int(after_name[12])) / os.sysconf("SC_CLK_TCK")
    return Usage(private, len(list((place / "fd").iterdir())), int(after_name[17]), cpu)


def children(pid: int) -> list[int]:
    """Children of a process, and theirs."""
    try:
        listed = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    except OSError:
        return []
    found = [int(one) for one in listed]
    return found + [deeper for one in found for deeper in children(one)]


class LiveDaemon:
    """`hapticd run` with the configuration `text`, in a separate runtime folder in memory."""

    def __init__(
        self, text: str, name: str = "attack", console: bool = False, runtime: Path | None = None
    ) -> None:
        base = "/dev/shm" if os.access("/dev/shm", os.W_OK) else None
        self._base = tempfile.TemporaryDirectory(prefix="hapticd-attack-", dir=base)
        self.instance = f"{name}-{os.getpid()}"
        own = Path(self._base.name)
        self.runtime = runtime or own
        self.folder = self.runtime / "hapticd" / f"instance-{self.instance}"
        config = own / "hapticd.toml"
        config.write_text(text)
        self.log = own / "log"
        self._before = {
            key: os.environ.get(key) for key in ("XDG_RUNTIME_DIR", "RUNTIME_DIRECTORY")
        }
        os.environ["XDG_RUNTIME_DIR"] = str(self.runtime)
        os.environ.pop("RUNTIME_DIRECTORY", None)
        self._arguments = ["--instance", self.instance, "--config", str(config), "--json"]
        self._arguments += [] if console else ["--no-console"]
        self.process = self._started()

    def _started(self) -> "subprocess.Popen[bytes]":
        with self.log.open("wb") as log:
            return subprocess.Popen(
                [sys.executable, "-m", "hapticd", "run", *self._arguments],
                stdout=log,
                stderr=subprocess.STDOUT,
                env={**os.environ, "XDG_STATE_HOME": str(self.runtime / "state")},
                preexec_fn=_as_child,
            )

    def restart(self) -> None:
        """Start it again, in the same folder, after it has ended."""
        self.process.wait()
        self.process = self._started()
        self.await_ready(1)

    def __enter__(self) -> Self:
        try:
            self.await_ready(1)
            self.client = Client(self.instance, timeout_s=10.0, name="attack")
            until(self.state, "it answers")
        except BaseException:
            self._end()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.client.close()
        self._end()

    def _end(self) -> None:
        pids = children(self.process.pid)
        if self.process.poll() is None:
            for pid in (self.process.pid, *pids):
                _signalled(pid, signal.SIGCONT)
            self.process.terminate()
            try:
                self.process.wait(PATIENCE_S)
            except subprocess.TimeoutExpired:
                self.process.kill()
                self.process.wait()
        for pid in pids:
            if str(self.folder).encode() in _command_line(pid):
                _signalled(pid, signal.SIGKILL)
        for key, value in self._before.items():
            if value is None:
                os.environ.pop(key, None)
            else:
                os.environ[key] = value
        self._base.cleanup()

    def events(self) -> list[dict[str, Any]]:
        """Return the events of the supervisor."""
        lines = self.log.read_text(errors="replace").splitlines()
        return [json.loads(one) for one in lines if one.startswith("{") and one.endswith("}")]

    def await_ready(self, count: int) -> None:
        """Wait until the daemon has been ready `count` times."""

        def ready() -> bool:
            assert self.process.poll() is None, self.log.read_text(errors="replace")
            return [one["event"] for one in self.events()].count("ready") >= count

        until(ready, f"ready, {count} times")

    def processes(self) -> dict[str, int]:
        """Process ids by name; those that are there."""
        found = {"supervisor": self.process.pid}
        for pid in children(self.process.pid):
            words = _command_line(pid).split(b"\0")
            found |= {name: pid for module, name in MODULES.items() if module in words}
        return found

    def state(self) -> str:
        """Return the state of the servo; empty without a reply."""
        try:
            return str(self.client.call("get")["state"])
        except HapticdError:
            return ""

    def to_force(self) -> None:
        """From any state to `enabled`."""

        def enabled() -> bool:
            for cmd in ("reset", "zero", "enable"):
                try:
                    self.client.call(cmd)
                except (CommandError, DaemonDown):
                    pass
            return self.state() == "enabled"

        until(enabled, "enabled")


def _as_child() -> None:
    """No core files, and no end later than ours, however that comes."""
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    LIBC.prctl(PR_SET_PDEATHSIG, signal.SIGTERM)


def _signalled(pid: int, number: int) -> None:
    try:
        os.kill(pid, number)
    except ProcessLookupError:
        pass


def _command_line(pid: int) -> bytes:
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes()
    except OSError:
        return b""
