"""The flight recorder: the last minute at every tick with raw frames, and the data for a replay.

It is dumped at faults and on request. It keeps the blocks read from the telemetry ring, the
requests noted by the servo, and a checkpoint of the servo's state every 10 s. A replay starts at a
checkpoint, so it keeps 10 s more than configured. A fault is written 1 s later, with its aftermath;
the records of a servo that fell silent under force are written at once. A separate thread writes
files from immutable bytes, so a slow disk delays the file and not the heartbeat. The newest
FILES_KEPT files are kept. One file is written at a time: a further request is refused meanwhile,
and a fault waits.

A file contains records and everything to replay them, and is written completely or not at all:

    hapticd-flight/1 LF | bytes of header, u64 little-endian | header, JSON | records of `descr`

header: reason, written_utc, version, simulated, rate_hz, epoch, mono_unix_offset_ns, descr, servo
(params.ServoParams), report (rights granted, board), leases {what: holder} at the dump, gaps [[row,
lost]], checkpoints [[tick, state]], requests [[tick, seq, kind, actor, apply_tick, values]], breaks
[tick]: requests were lost there, so no replay continues across it.
"""

import json
import os
import struct
import threading
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import hapticd
from hapticd.core.arrays import Records
from hapticd.core.errors import CommandError, ConfigError
from hapticd.core.faults import BY_NUMBER, FAULTS
from hapticd.core.params import GatewaySetup, to_plain
from hapticd.core.units import NS_PER_S
from hapticd.mailbox.client_side import Checkpoint, Noted
from hapticd.mailbox.files import DEFAULT_INSTANCE
from hapticd.mailbox.layout import State
from hapticd.protocol.journal import EventCode, Journal
from hapticd.protocol.leases import Leases
from hapticd.protocol.telemetry import TICK_DESCR, Origin, RingBlock
from hapticd.protocol.view import ServoView

__all__ = [
    "SUFFIX",
    "FlightRecorder",
    "dtype_of",
    "flights_folder",
    "read_flight",
    "read_header",
    "with_header",
]

SUFFIX = ".flight"
_MAGIC = b"hapticd-flight/1\n"
_LENGTH = struct.Struct("<Q")


class Flight(NamedTuple):
    """The content of a flight recording."""

    header: dict[str, Any]
    records: Records


def write_flight(path: Path, header: dict[str, Any], blocks: Iterable[bytes]) -> None:
    """Write `header` and the records in `blocks` to `path`; create its folder.

    OSError: no space, no permission.
    """
    path.parent.mkdir(mode=0o750, parents=True, exist_ok=True)
    fresh = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        with fresh.open("wb") as file:
            file.write(with_header(_MAGIC, header))
            file.writelines(blocks)
        fresh.replace(path)
    finally:
        fresh.unlink(missing_ok=True)


def with_header(magic: bytes, header: Mapping[str, Any]) -> bytes:
    """Return the beginning of a file of raw records: `magic`, the length of the header,
    `header`.
    """
    text = _header_text(header).encode()
    return magic + _LENGTH.pack(len(text)) + text


def read_header(data: bytes | memoryview, magic: bytes) -> tuple[dict[str, Any], int]:
    """Return the header of a file of raw records that starts with `magic`, and the offset [bytes]
    of the first record. struct.error or ValueError: the file is damaged.
    """
    (length,) = _LENGTH.unpack_from(data, len(magic))
    begin = len(magic) + _LENGTH.size
    return json.loads(bytes(data[begin : begin + length])), begin + length


def _header_text(header: Mapping[str, Any]) -> str:
    """Return `header` as JSON, with lists encoded item by item: encoding blocks all
    other threads.
    """
    fields = (f"{json.dumps(name)}: {_value_text(value)}" for name, value in header.items())
    return "{" + ", ".join(fields) + "}"


def _value_text(value: Any) -> str:
    if isinstance(value, list):
        return "[" + ", ".join(map(json.dumps, value)) + "]"
    return json.dumps(value)


def dtype_of(descr: Iterable[Sequence[Any]]) -> np.dtype[Any]:
    """Return the dtype of records, from its description in a header."""
    return np.dtype([(name, kind, *map(tuple, shape)) for name, kind, *shape in descr])


def read_flight(path: Path) -> Flight:
    """Return the flight in `path`. ConfigError if it is not one, or truncated."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}; check the path") from error
    if len(data) < len(_MAGIC) + _LENGTH.size or not data.startswith(_MAGIC):
        raise ConfigError(
            f"{path} is not a flight recording; they are made by `hapticd dump` and at faults"
        )
    try:
        header, offset = read_header(data, _MAGIC)
        return Flight(header, np.frombuffer(data, dtype_of(header["descr"]), offset=offset))
    except (ValueError, KeyError, TypeError) as error:
        raise ConfigError(f"{path} is damaged: {error}") from error


CHECKPOINT_S = 10
AFTERMATH_NS = NS_PER_S
FILES_KEPT = 20
REQUESTS_KEPT = 20_000  # about 18 MB; no replay continues across dropped ones
UNDER_FORCE = (State.ENABLED, State.HOMING)


class FlightRecorder:
    """Keep the last `setup.gateway.flight_s` seconds of `view`'s servo; dumps go into `folder`."""

    def __init__(
        self,
        view: ServoView,
        journal: Journal,
        setup: GatewaySetup,
        folder: Path,
        unix_ns: Callable[[], int],
        leases: Leases,
    ) -> None:
        self._view = view
        self._leases = leases
        self._journal = journal
        self._setup = setup
        self._folder = folder
        self._unix_ns = unix_ns
        self._kept_ticks = round(
            (setup.gateway.flight_s + CHECKPOINT_S) * setup.servo.realtime.rate_hz
        )
        self._threads: list[threading.Thread] = []
        self._written: deque[tuple[EventCode, dict[str, Any]]] = deque()
        self._origin: Origin | None = None
        self._clear()

    def _clear(self) -> None:
        self._blocks: deque[RingBlock] = deque()
        self._records = 0
        self._requests: deque[Noted] = deque()
        self._checkpoints: deque[Checkpoint] = deque()
        self._breaks: deque[int] = deque()
        self._journal_tail = self._checkpoints_read = 0
        self._asked_ns = -CHECKPOINT_S * NS_PER_S
        # time and reason of the next dump
        self._state = 0
        self._due = (0, "")
        self._report: dict[str, Any] = {}

    def begin(self, origin: Origin) -> None:
        """Start another servo life."""
        self._write_if_silent()
        self._clear()
        self._origin = origin
        if self._view.mailbox:
            _, self._journal_tail, _ = self._view.mailbox.journal(0)
            self._checkpoints_read = self._view.mailbox.checkpoints
            self._report = self._view.mailbox.report()

    def ask(self) -> None:
        """Request a checkpoint soon, for a recording that starts here."""
        self._asked_ns = -CHECKPOINT_S * NS_PER_S

    def follow(self, now_ns: int) -> dict[str, Any] | None:
        """Read the notes of the servo; request a checkpoint when due.

        Return new notes as a payload; None without any.
        """
        mailbox = self._view.mailbox
        self._tell()
        if not self._view.alive:
            self._write_if_silent()
        if mailbox is None or self._origin is None:
            return None
        if now_ns - self._asked_ns >= CHECKPOINT_S * NS_PER_S:
            self._asked_ns = now_ns
            mailbox.ask_checkpoint()
        requests, self._journal_tail, lost = mailbox.journal(self._journal_tail)
        self._requests.extend(requests)
        if lost:
            self._breaks.append(self._view.tick)
        checkpoint = mailbox.checkpoint() if mailbox.checkpoints != self._checkpoints_read else None
        if checkpoint is not None:
            self._checkpoints_read = mailbox.checkpoints
            self._checkpoints.append(checkpoint)
        if not (requests or lost or checkpoint):
            return None
        return {
            **self._origin.header,
            "requests": requests,
            "break": self._view.tick if lost else None,
            "checkpoint": checkpoint,
        }

    def _write_if_silent(self) -> None:
        if self._state in UNDER_FORCE:
            self._state = State.DISABLED
            self.dump("servo_silent")

    def add(self, block: RingBlock, now_ns: int) -> None:
        """Keep `block`, forget blocks that are too old, and note a fault in it."""
        self._blocks.append(block)
        self._records += len(block.records)
        while self._records - len(self._blocks[0].records) >= self._kept_ticks:
            self._records -= len(self._blocks.popleft().records)
        self._forget_before(
            int(self._blocks[0].records["tick"][0]) if len(self._blocks[0].records) else 0
        )
        states = block.records["state"]
        fallen = np.flatnonzero(
            (states == State.FAULT) & (np.concatenate(([self._state], states[:-1])) != State.FAULT)
        )
        if fallen.size and not self._due[0]:
            number = int(block.records["fault"][fallen[0]])
            self._due = now_ns + AFTERMATH_NS, BY_NUMBER.get(number, FAULTS[0]).code
        self._state = int(states[-1]) if len(states) else self._state

    def _forget_before(self, tick: int) -> None:
        while self._requests and self._requests[0].tick < tick:
            self._requests.popleft()
        if len(self._requests) > REQUESTS_KEPT:
            while len(self._requests) > REQUESTS_KEPT:
                oldest = self._requests.popleft()
            self._breaks.append(oldest.tick)
        while self._checkpoints and self._checkpoints[0].tick < tick:
            self._checkpoints.popleft()
        while self._breaks and self._breaks[0] < tick:
            self._breaks.popleft()

    def dump_if_due(self, now_ns: int) -> None:
        """Write the recording of a fault once its aftermath is complete."""
        due_ns, reason = self._due
        if due_ns and now_ns >= due_ns and not self._writing:
            self._due = 0, ""
            self.dump(reason)

    @property
    def _writing(self) -> bool:
        return any(one.is_alive() for one in self._threads)

    def dump_asked(self) -> dict[str, Any]:
        """Call `dump` for a client. CommandError also while a recording is being written."""
        if self._writing:
            raise CommandError(
                "busy", "dump: a recording is being written; its event `flight` tells when it is"
            )
        return self.dump("asked")

    def dump(self, reason: str) -> dict[str, Any]:
        """Start to write the kept records; return {path, records, reason}.

        An event `flight` reports the end. CommandError if there are no records.
        """
        if not self._records:
            raise CommandError(
                "refused", "dump: nothing has been recorded yet; is a servo running?"
            )
        stamp = datetime.fromtimestamp(self._unix_ns() / NS_PER_S, UTC)
        path = self._folder / f"{stamp:%Y%m%d-%H%M%S.%f}-{reason}{SUFFIX}"
        blocks = [block.data for block in self._blocks]
        header = self._header(reason, stamp.isoformat())
        thread = threading.Thread(
            target=self._write, args=(path, header, blocks, reason), daemon=False
        )
        self._threads = [one for one in self._threads if one.is_alive()] + [thread]
        thread.start()
        return {"path": str(path), "records": self._records, "reason": reason}

    def _header(self, reason: str, written_utc: str) -> dict[str, Any]:
        gaps = []
        row = 0
        for block in self._blocks:
            gaps += [[row, block.lost]] if block.lost and row else []
            row += len(block.records)
        return {
            "reason": reason,
            "written_utc": written_utc,
            "version": hapticd.__version__,
            "rate_hz": self._setup.servo.realtime.rate_hz,
            **(self._origin.header if self._origin else {}),
            "descr": TICK_DESCR,
            "servo": to_plain(self._setup.servo),
            "report": self._report,
            "leases": self._leases.named(),
            "gaps": gaps,
            "checkpoints": list(self._checkpoints),
            "requests": list(self._requests),
            "breaks": list(self._breaks),
        }

    def _write(self, path: Path, header: dict[str, Any], blocks: list[bytes], reason: str) -> None:
        """Write the file, in a thread: only the queue of results is shared."""
        event: tuple[EventCode, dict[str, Any]] = "flight", {"reason": reason, "path": str(path)}
        try:
            write_flight(path, header, blocks)
            for old in sorted(path.parent.glob(f"*{SUFFIX}"))[:-FILES_KEPT]:
                old.unlink(missing_ok=True)
        except OSError as error:
            failed = {"reason": error.strerror, "path": str(path)}
            event = "flight_not_written", failed
        self._written.append(event)

    def _tell(self) -> None:
        while self._written:
            code, fields = self._written.popleft()
            self._journal.note(code, **fields)

    def close(self) -> None:
        """Finish the recordings being written."""
        for thread in self._threads:
            thread.join()
        self._tell()


def flights_folder(instance: str) -> Path:
    """Return the folder for flight recordings of `instance`. It is in $STATE_DIRECTORY (systemd),
    $XDG_STATE_HOME/hapticd, or ~/.local/state/hapticd.
    """
    service = os.environ.get("STATE_DIRECTORY")
    state = (
        Path(service.split(":")[0])
        if service
        else Path(os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state") / "hapticd"
    )
    return (
        state / "flights"
        if instance == DEFAULT_INSTANCE
        else state / f"instance-{instance}" / "flights"
    )
