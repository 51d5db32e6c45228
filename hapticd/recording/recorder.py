"""Recording a running daemon: an ordinary client that writes every tick, every probe sample and
every event into one file.

Received data are written and flushed every 100 ms, so a killed recorder loses no more than that.
Once a second a thread syncs the file to the disk, so a power failure loses about a second. A slow
disk delays the flush: data then wait in ZeroMQ's queue (10,000 messages, minutes), and a queue that
overflows appears as a gap with its size. Before the disk is full the recording ends normally. After
a write error it ends at once, and the flushed data remain for `hapticd rec recover`.

The loop itself must not call `fdatasync`, which a slow disk delays for seconds. No write may follow
a failed one (see `live`).
"""

import os
from collections.abc import Callable, Generator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hapticd.client.blocks import BlockDecoder
from hapticd.client.client import Client
from hapticd.core.errors import ConfigError, DaemonDown, HapticdError
from hapticd.core.units import NS_PER_S, Clock, MonotonicClock
from hapticd.protocol.answers import Hello, Status
from hapticd.recording import live, pack
from hapticd.recording.provenance import of_recording

__all__ = ["RecordingParams", "RecordingProgress", "record"]

FLUSH_PERIOD_S = 0.1  # period of writing and flushing
SYNC_PERIOD_NS = NS_PER_S  # period of syncing the disk and checking its free space
RESERVE_BYTES = 64 << 20  # the disk counts as full below this free space
SILENCE_NS = 10 * NS_PER_S  # a daemon that is silent for longer has ended

Message = tuple[str, bytes]  # topic and payload
Answers = tuple[Hello, Status]  # the daemon's hello and status


@dataclass(frozen=True)
class RecordingParams:
    """The content and the file of a recording."""

    file: Path  # the final one (.h5)
    seconds: float | None = None  # of recorded time; None: until stopped
    note: str = ""  # the operator's words

    @property
    def part(self) -> Path:
        """The live file."""
        return self.file.with_name(self.file.name.removesuffix(pack.FINAL) + live.SUFFIX)


@dataclass(frozen=True)
class RecordingProgress:
    """The progress of a recording."""

    records: int  # ticks
    seconds: float  # of recorded time
    missing: int  # ticks
    file_bytes: int


def record(
    source: Client,
    params: RecordingParams,
    should_stop: Callable[[], bool],
    tell: Callable[[RecordingProgress], None] = lambda progress: None,
    clock: Clock | None = None,
    free_bytes: Callable[[Path], int] = pack.free_bytes,
) -> dict[str, Any]:
    """Record until `seconds` are recorded, `should_stop()`, the disk is nearly full or the daemon
    has ended; then pack. Return the reason in `ended`, and the result of `pack.pack`.

    ConfigError if the file exists. HapticdError if it cannot be written, or there is no room for
    packing; the recorded data are then in the live file. DaemonDown if nothing was received.
    """
    check_free(params)
    ended = Recorder(source, params, clock or MonotonicClock(), free_bytes).run(should_stop, tell)
    return {"ended": ended, **pack.pack(params.part, params.file, free_bytes=free_bytes)}


def check_free(params: RecordingParams) -> None:
    """Raise ConfigError if a file is in the way or the folder is missing."""
    if params.file.suffix != pack.FINAL:
        raise ConfigError(f"{params.file}: a recording is called NAME{pack.FINAL}")
    for path, remedy in (
        (params.file, "choose another name"),
        (params.part, f"`hapticd rec recover {params.part}` first"),
    ):
        if path.exists():
            raise ConfigError(f"{path} exists; {remedy}")
    if not params.file.parent.is_dir():
        raise ConfigError(f"{params.file.parent}: no such folder; make it first")


class Recorder:
    """The loop of one recording."""

    def __init__(
        self,
        source: Client,
        params: RecordingParams,
        clock: Clock,
        free_bytes: Callable[[Path], int],
    ) -> None:
        self._source = source
        self._params = params
        self._clock = clock
        self._free_bytes = free_bytes
        self._writer: live.Writer | None = None
        self._early: list[Message] = []  # for replays: messages before the first records

    def run(
        self, should_stop: Callable[[], bool], tell: Callable[[RecordingProgress], None]
    ) -> str:
        """Record into the live file; return the reason for the end."""
        answers = (self._source.hello(), self._source.status())
        try:
            with (
                closing(self._source.messages(live.TOPICS, FLUSH_PERIOD_S)) as messages,
                ThreadPoolExecutor(1) as disk,
            ):
                ended = self._loop(messages, answers, disk, should_stop, tell)
            if self._writer is None:
                raise DaemonDown("record: the daemon published nothing; see `hapticd status`")
        except OSError as error:
            part = self._params.part
            raise HapticdError(
                f"{part}: {error}; the data flushed before are safe: free some space, then `hapticd"
                f" rec recover {part}`"
            ) from error
        finally:
            if self._writer is not None:
                with suppress(OSError):  # the failed write has reported the error
                    self._writer.file.close()
        return ended

    def _loop(
        self,
        messages: Generator[Message | None, None, None],
        answers: Answers,
        disk: ThreadPoolExecutor,
        should_stop: Callable[[], bool],
        tell: Callable[[RecordingProgress], None],
    ) -> str:
        received_ns = self._clock.now_ns()
        synced_ns = received_ns
        ended = ""
        while not ended:
            message = next(messages)
            now_ns = self._clock.now_ns()
            if message is not None:
                received_ns = now_ns
                self._take(*message, answers)
                continue
            if writer := self._writer:
                writer.write()
                if now_ns - synced_ns >= SYNC_PERIOD_NS:
                    synced_ns = now_ns
                    # if this fails, the next write raises the error
                    disk.submit(os.fdatasync, writer.file.descriptor)
                    tell(self._progress(writer))
                    free_bytes = self._free_bytes(self._params.part.parent)
                    ended = "disk nearly full" if free_bytes < RESERVE_BYTES else ""
            ended = ended or self._over(now_ns - received_ns, should_stop)
        return ended

    def _progress(self, writer: live.Writer) -> RecordingProgress:
        size = self._params.part.stat().st_size
        return RecordingProgress(writer.records, writer.seconds, writer.missing["servo.raw"], size)

    def _take(self, topic: str, payload: bytes, answers: Answers) -> None:
        if self._writer is not None:
            self._writer.take(topic, payload)
        elif topic == "flight":
            # a checkpoint of one of the first records may arrive before them
            self._early.append((topic, payload))
        elif topic == "servo.raw":
            header = BlockDecoder().decode(payload).header
            attributes = of_recording(*answers, header, self._params.note)
            self._writer = live.Writer(self._params.part, attributes, self._params.seconds)
            for message in ((topic, payload), *self._early):
                self._writer.take(*message)

    def _over(self, silent_ns: int, should_stop: Callable[[], bool]) -> str:
        if should_stop():
            return "stopped"
        if silent_ns >= SILENCE_NS:
            return "daemon ended"
        return "complete" if self._writer and self._writer.beyond else ""
