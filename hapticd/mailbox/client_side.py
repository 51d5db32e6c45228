"""The gateway's side of the mailbox: it posts commands and reads answers and telemetry."""

import marshal
import os
import zlib
from pathlib import Path
from typing import Any, NamedTuple

from hapticd.core.errors import MailboxError
from hapticd.mailbox import files, layout
from hapticd.mailbox.daemons import Report

__all__ = ["Answer", "Checkpoint", "GatewayMailbox", "Noted"]

SAFE_DISTANCE = 64  # records that a reader keeps clear of the writer


class Header(NamedTuple):
    """The servo of this mailbox."""

    pid: int
    start_ns: int
    rate_hz: float
    config_hash: str
    simulated: bool


class Answer(NamedTuple):
    """The servo's answer to command `seq` (layout.Result). `effective` are values after
    quantisation, by layout.Value.
    """

    seq: int
    result: layout.Result
    fault: int
    revision: int
    first_tick: int
    ramp_end_tick: int
    effective: tuple[float, ...]


class Noted(NamedTuple):
    """A request that the servo obeyed at `tick`; `kind` is layout.Command or an event of the servo
    itself.
    """

    tick: int
    seq: int
    kind: int
    actor: int
    apply_tick: int
    values: tuple[float, ...]


class Checkpoint(NamedTuple):
    """The servo's state before `tick`, as nested plain tuples (servo.plan.flatten)."""

    tick: int
    state: tuple[Any, ...]


class GatewayMailbox:
    """The gateway's side. One per folder: a second one is refused.

    A gateway that outlives servos holds the claim of files.GATEWAY_LOCK itself (`claimed`) and
    opens one of these per life. No other one of that life has the same `number`.
    """

    def __init__(self, folder: Path, claimed: bool = False) -> None:
        self.folder = folder
        self._report = Report(folder)
        self._path = os.fspath(folder / files.MAILBOX)  # checked in every pass
        if not folder.is_dir():
            raise MailboxError(
                f"{folder}: no such folder; no servo runs there, start one with `hapticd run`"
            )
        self._claim = None if claimed else files.claim(folder, files.GATEWAY_LOCK)
        try:
            self._map_all()
        except MailboxError:
            self.close()
            raise

    def _map_all(self) -> None:
        # before the map: a file replaced in between is then not current
        self._inode = self._inode_now()
        self._map = files.open_map(self.folder / files.MAILBOX, layout.MAILBOX_BYTES)
        self.words = memoryview(self._map).cast("Q")
        self.store, self.load = files.word_access(self.words)
        magic, layout_hash, pid, start_ns, rate_hz, config_hash, simulated = (
            layout.HEADER.unpack_from(self._map, 0)
        )
        if magic != layout.MAGIC or layout_hash != layout.LAYOUT_HASH:
            raise MailboxError(
                f"{self.folder}: mailbox of another version; restart servo and gateway together"
            )
        self.epoch = self.load(layout.EPOCH_WORD)
        if self.epoch == 0 or self.epoch != start_ns:
            raise MailboxError(
                f"{self.folder}: the servo has ended or is still starting; wait or run `hapticd"
                " run`"
            )
        if not (0 < rate_hz <= 100_000):
            raise MailboxError(
                f"{self.folder}: rate {rate_hz} Hz out of range 0..100000; restart the servo"
            )
        self.header = Header(
            pid,
            start_ns,
            rate_hz,
            config_hash.rstrip(b"\0").decode(errors="replace"),
            bool(simulated),
        )
        self._ring = files.open_map(self.folder / files.TELEMETRY, layout.TELEMETRY_BYTES)
        self.ring = memoryview(self._ring)
        _, self.load_head = files.word_access(self.ring.cast("Q"))
        self._wave = files.open_map(
            self.folder / files.PERTURBATION,
            layout.PERTURBATION_HEADER + 2 * layout.PERTURBATION_SAMPLES,
        )
        self.waveform = memoryview(self._wave)[layout.PERTURBATION_HEADER :].cast("h")
        self.words[layout.GATEWAY_PID_WORD] = os.getpid()
        # commands of an earlier gateway in the ring enable no force
        self.store(layout.INHERITED_WORD, self.words[layout.COMMAND_HEAD_WORD])
        self.number = self.words[layout.GATEWAYS_WORD] = self.words[layout.GATEWAYS_WORD] + 1

    @property
    def current(self) -> bool:
        """Whether the mapped mailbox is still the one in the folder; otherwise close this and open
        a new one.

        A servo that was killed leaves its epoch behind, so the file itself is compared as well.
        """
        return self._inode_now() == self._inode and self.load(layout.EPOCH_WORD) == self.epoch

    def _inode_now(self) -> int | None:
        try:
            return os.stat(self._path).st_ino
        except OSError:
            return None

    @property
    def backlog(self) -> int:
        """Commands that the servo has not yet taken."""
        return self.words[layout.COMMAND_HEAD_WORD] - self.load(layout.COMMAND_TAIL_WORD)

    @property
    def servo_beat_ns(self) -> int:
        """Monotonic time of the servo's last tick; 0 before the first."""
        return self.load(layout.SERVO_BEAT_WORD)

    def beat(self, now_ns: int) -> None:
        """Write the gateway's heartbeat."""
        self.store(layout.GATEWAY_BEAT_WORD, now_ns)

    @property
    def last_actor(self) -> int:
        """The largest client number that a gateway has assigned in this servo life."""
        return self.words[layout.LAST_ACTOR_WORD]

    @last_actor.setter
    def last_actor(self, number: int) -> None:
        self.words[layout.LAST_ACTOR_WORD] = number

    @property
    def perturbation_lease(self) -> int:
        """The actor that holds the lease of the perturbation, 0: none."""
        return self.words[layout.PERTURBATION_LEASE_WORD]

    @perturbation_lease.setter
    def perturbation_lease(self, actor: int) -> None:
        self.words[layout.PERTURBATION_LEASE_WORD] = actor

    def counters(self) -> dict[str, int]:
        """Return the servo's counters by name."""
        return {
            name: self.words[layout.COUNTER_WORD + index]
            for index, name in enumerate(layout.COUNTERS)
        }

    def report(self) -> dict[str, Any]:
        """Return the servo's report: granted rights, board, device; not to be modified. It is
        parsed once, and empty while it is being replaced.
        """
        return self._report.content()

    def post(self, kind: int, actor: int, apply_tick: int, values: tuple[float, ...]) -> int | None:
        """Post a command of doubles (layout.Value); return its sequence number, or None if the ring
        is full (`busy`).
        """
        head = self.words[layout.COMMAND_HEAD_WORD]
        if not 0 <= self.backlog < layout.RING_SLOTS:
            return None
        self._write(head + 1, kind, actor, apply_tick, values)
        self.store(layout.COMMAND_HEAD_WORD, head + 1)
        return head + 1

    def withdraw(self, seq: int) -> bool:
        """Withdraw command `seq` from the ring; return False if the servo has already taken it.

        A servo that reads it at this moment takes the former one, the new one, or finds it damaged.
        """
        if waits := seq > self.load(layout.COMMAND_TAIL_WORD):
            self._write(seq, layout.Command.WITHDRAWN, 0, 0, layout.values_of({}))
        return waits

    def _write(
        self, seq: int, kind: int, actor: int, apply_tick: int, values: tuple[float, ...]
    ) -> None:
        offset = layout.COMMAND_OFFSET + (seq - 1) % layout.RING_SLOTS * layout.COMMAND.size
        crc = zlib.crc32(
            layout.COMMAND.pack(seq, kind, actor, apply_tick, *values, 0, 0)[
                : layout.COMMAND_CRC_OFFSET
            ]
        )
        layout.COMMAND.pack_into(self._map, offset, seq, kind, actor, apply_tick, *values, crc, 0)

    def answers(self) -> list[Answer]:
        """Return all answers since the last call, in order."""
        found = []
        tail = self.words[layout.ANSWER_TAIL_WORD]
        head = self.load(layout.ANSWER_HEAD_WORD)
        if not 0 <= head - tail <= layout.RING_SLOTS:
            self.store(layout.ANSWER_TAIL_WORD, head)
            raise MailboxError(
                f"{self.folder}: {head - tail} answers in a ring of {layout.RING_SLOTS}; they are"
                " skipped"
            )
        while tail != head:
            offset = layout.ANSWER_OFFSET + tail % layout.RING_SLOTS * layout.ANSWER.size
            seq, result, fault, revision, first, end, *values, crc, _ = layout.ANSWER.unpack_from(
                self._map, offset
            )
            intact = zlib.crc32(self._map[offset : offset + layout.ANSWER.size - 8]) == crc
            tail += 1
            self.store(layout.ANSWER_TAIL_WORD, tail)
            if not intact:
                raise MailboxError(
                    f"{self.folder}: answer {tail} is damaged; restart servo and gateway"
                )
            found.append(
                Answer(seq, layout.Result(result), fault, revision, first, end, tuple(values))
            )
        return found

    def records(self, tail: int, most: int) -> tuple[bytes, int, int]:
        """Return up to `most` whole records after number `tail`: (bytes, new tail, records lost
        before them). Never waits.
        """
        head = self.load_head(layout.TELEMETRY_HEAD_WORD)
        first = max(tail, head - layout.RING_RECORDS + SAFE_DISTANCE)
        count = min(most, head - first)
        if count <= 0:
            return b"", tail, 0
        size = layout.RECORD.size
        slot = first % layout.RING_RECORDS
        until_wrap = min(count, layout.RING_RECORDS - slot)
        begin = layout.TELEMETRY_OFFSET + slot * size
        block = bytes(self.ring[begin : begin + until_wrap * size])
        block += bytes(
            self.ring[
                layout.TELEMETRY_OFFSET : layout.TELEMETRY_OFFSET + (count - until_wrap) * size
            ]
        )
        overwritten = self.load_head(layout.TELEMETRY_HEAD_WORD) - layout.RING_RECORDS + 1 - first
        spoiled = max(0, min(count, overwritten))
        return block[spoiled * size :], first + count, first - tail + spoiled

    def journal(self, tail: int) -> tuple[list[Noted], int, int]:
        """Return the requests obeyed after number `tail`: (requests, new tail, number overwritten
        before they were read).
        """
        head = self.load(layout.JOURNAL_HEAD_WORD)
        first = max(tail, head - layout.JOURNAL_SLOTS)
        found = [self._noted(number) for number in range(first, head)]
        whole = [request for request in found if request is not None]
        return whole, head, head - tail - len(whole)

    def _noted(self, number: int) -> Noted | None:
        offset = layout.JOURNAL_OFFSET + number % layout.JOURNAL_SLOTS * layout.JOURNAL.size
        begin, tick, seq, kind, actor, apply_tick, *values, end = layout.JOURNAL.unpack_from(
            self._map, offset
        )
        if not begin == end == number:
            return None
        return Noted(tick, seq, kind, actor, apply_tick, tuple(values))

    def ask_checkpoint(self) -> None:
        """Request a checkpoint; the servo writes it within 256 ticks."""
        self.words[layout.CHECKPOINT_ASKED_WORD] = self.checkpoints + 1

    @property
    def checkpoints(self) -> int:
        """Checkpoints that the servo has written in this life."""
        return self.load(layout.CHECKPOINT_HEAD_WORD)

    def checkpoint(self) -> Checkpoint | None:
        """Return the newest checkpoint; None before the first, or while it is being overwritten."""
        number = self.checkpoints - 1
        if number < 0:
            return None
        offset = layout.CHECKPOINT_OFFSET + number % 2 * layout.CHECKPOINT_SLOT
        found, tick, length, crc = layout.CHECKPOINT.unpack_from(self._map, offset)
        begin = offset + layout.CHECKPOINT.size
        data = self._map[begin : begin + min(length, layout.CHECKPOINT_SLOT)]
        if found != number or zlib.crc32(data) != crc:
            return None
        return Checkpoint(tick, marshal.loads(data))

    def close(self) -> None:
        """Release the claim; the maps are released with the object."""
        if self._claim is not None:
            files.release(self.folder, files.GATEWAY_LOCK, self._claim)
