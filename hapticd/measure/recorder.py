"""Recording a running daemon: an ordinary client that writes every tick, every probe sample and every event into one file.

What has come is written and flushed every 100 ms, so a recorder that is killed loses no more of what it was sent; once a
second a thread has the operating system put it on the disk, so a power failure loses about a second. A slow disk delays the
flush: what comes meanwhile waits in ZeroMQ's queue (10,000 messages, minutes) and a full one shows as a gap with its size.
Before the disk is full the recording ends in order; after a write error it ends at once and what was flushed stays for
`hapticd rec recover`.
"""

import os
import shutil
import threading
from collections.abc import Callable, Generator, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from hapticd.client.blocks import BlockDecoder
from hapticd.clock import Clock, MonotonicClock
from hapticd.errors import ConfigError, DaemonDown, HapticdError
from hapticd.measure.recording import live, pack
from hapticd.measure.recording.live import TOPICS, Writer
from hapticd.measure.recording.pack import packed
from hapticd.measure.recording.provenance import of_recording
from hapticd.units import NS_PER_S

LOOK_S = 0.1  # between two looks for what has come, each written and flushed at once
SYNC_NS = NS_PER_S  # between two looks at the disk
RESERVE_BYTES = 64 << 20  # the disk is taken for full when so little is left
SILENCE_NS = 10 * NS_PER_S  # a daemon that says nothing for so long has ended

Message = tuple[str, bytes]


class Synchroniser:
    """A thread that has the operating system write a file to its disk; a request while it is busy is dropped."""

    def __init__(self) -> None:
        self._wanted, self._ending = threading.Event(), threading.Event()
        self._descriptor = -1
        self._thread: threading.Thread | None = None

    def request(self, descriptor: int) -> None:
        """Write `descriptor` out soon; it stays open until `stop` has returned."""
        self._descriptor = descriptor
        self._wanted.set()
        if self._thread is None:
            self._thread = threading.Thread(target=self._run)
            self._thread.start()

    def _run(self) -> None:
        while self._wanted.wait() and not self._ending.is_set():
            self._wanted.clear()
            try:
                os.fdatasync(self._descriptor)
            except OSError:
                pass  # the next write says so, with a message

    def stop(self) -> None:
        """End the thread; may be called twice."""
        self._ending.set()
        self._wanted.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None


class Source(Protocol):
    """What is used of hapticd.client.Client."""

    def hello(self) -> dict[str, Any]: ...
    def status(self) -> dict[str, Any]: ...
    def messages(self, topics: Sequence[str], look_s: float = ...) -> Generator[Message | None, None, None]: ...


@dataclass(frozen=True)
class RecordingParams:
    """`file`: the final file (.h5); `seconds` of recorded time, None: until stopped; `note`: the operator's words."""

    file: Path
    seconds: float | None = None
    note: str = ""

    @property
    def part(self) -> Path:
        """The live file."""
        return self.file.with_name(self.file.name.removesuffix(pack.FINAL) + live.SUFFIX)


@dataclass(frozen=True)
class Progress:
    """How far a recording is."""

    records: int
    seconds: float
    missing: int
    file_bytes: int


@dataclass(frozen=True)
class RecordingResult:
    """`ended`: why it ended; `summary` as `pack.summary`, with the final file and its size."""

    ended: str
    summary: dict[str, Any]


def record(
    source: Source,
    params: RecordingParams,
    should_stop: Callable[[], bool],
    tell: Callable[[Progress], None] = lambda progress: None,
    clock: Clock | None = None,
    free_bytes: Callable[[Path], int] = lambda folder: shutil.disk_usage(folder).free,
) -> RecordingResult:
    """Record until `seconds` are recorded, `should_stop()`, the disk is nearly full or the daemon has ended; then pack.

    ConfigError: the file exists. HapticdError: it cannot be written; what was flushed is in the live file. DaemonDown: nothing
    came.
    """
    check_free(params)
    recorder = Recorder(source, params, clock or MonotonicClock(), free_bytes)
    ended = recorder.run(should_stop, tell)
    return RecordingResult(ended, packed(params.part, params.file))


def check_free(params: RecordingParams) -> None:
    """ConfigError when a file is in the way or the folder is missing."""
    if params.file.suffix != pack.FINAL:
        raise ConfigError(f"{params.file}: a recording is called NAME{pack.FINAL}")
    for path, remedy in ((params.file, "choose another name"), (params.part, f"`hapticd rec recover {params.part}` first")):
        if path.exists():
            raise ConfigError(f"{path} exists; {remedy}")
    if not params.file.parent.is_dir():
        raise ConfigError(f"{params.file.parent}: no such folder; make it first")


class Recorder:
    """The loop of one recording."""

    def __init__(self, source: Source, params: RecordingParams, clock: Clock, free_bytes: Callable[[Path], int]) -> None:
        self._source, self._params, self._clock, self._free_bytes = source, params, clock, free_bytes
        self._writer: Writer | None = None
        self._sync = Synchroniser()

    def run(self, should_stop: Callable[[], bool], tell: Callable[[Progress], None]) -> str:
        """Record; why it ended."""
        hello, status = self._source.hello(), self._source.status()
        with closing(self._source.messages(TOPICS, LOOK_S)) as messages:
            try:
                ended = self._loop(messages, hello, status, should_stop, tell)
            except (OSError, RuntimeError) as error:
                raise self._spoilt(error) from error
            finally:
                self._sync.stop()
        if self._writer is None:
            raise DaemonDown("record: the daemon published nothing; see `hapticd status`")
        return ended

    def _loop(
        self,
        messages: Generator[Message | None, None, None],
        hello: dict[str, Any],
        status: dict[str, Any],
        should_stop: Callable[[], bool],
        tell: Callable[[Progress], None],
    ) -> str:
        heard_ns = synced_ns = self._clock.now_ns()
        ended = ""
        while not ended:
            message, now_ns = next(messages), self._clock.now_ns()
            if message is not None:
                heard_ns = now_ns
                self._take(*message, hello, status)
                continue
            if writer := self._writer:
                writer.write()
                if now_ns - synced_ns >= SYNC_NS:
                    synced_ns = now_ns
                    self._sync.request(writer.file.descriptor)
                    ended = "disk nearly full" if self._free_bytes(self._params.part.parent) < RESERVE_BYTES else ""
                    tell(Progress(writer.records, writer.seconds, writer.missing["servo.raw"], self._params.part.stat().st_size))
            ended = ended or self._over(now_ns - heard_ns, should_stop)
        self._sync.stop()
        if self._writer:
            self._writer.file.close()
        return ended

    def _take(self, topic: str, payload: bytes, hello: dict[str, Any], status: dict[str, Any]) -> None:
        if self._writer is None:
            if topic != "servo.raw":
                return
            header = BlockDecoder().decode(payload).header
            self._writer = Writer(self._params.part, of_recording(hello, status, header, self._params.note))
        self._writer.take(topic, payload, self._end_ns())

    def _end_ns(self) -> int | None:
        if self._params.seconds is None or self._writer is None or not self._writer.first_ns:
            return None
        return self._writer.first_ns + round(self._params.seconds * NS_PER_S)

    def _over(self, silent_ns: int, should_stop: Callable[[], bool]) -> str:
        if should_stop():
            return "stopped"
        if silent_ns >= SILENCE_NS:
            return "daemon ended"
        return "complete" if self._writer and self._writer.beyond else ""

    def _spoilt(self, error: Exception) -> HapticdError:
        part = self._params.part
        reason = f"{part}: {error}; what was flushed before is safe: free some space, then `hapticd rec recover {part}`"
        return HapticdError(reason)
