"""The servo as seen by the gateway: its mailbox, newest record and last answers.

Records (`as_records`). Telemetry records are numpy structured arrays. Their dtype comes from the
one table in mailbox.layout.

View (`ServoView`). A servo may die and another start; each life has its own mailbox. The view
detects this (the heartbeat stops, or the folder has another file), closes the mailbox and tries
again ten times a second. A servo with another configuration is not served, because scales may
differ. `life` counts the opened mailboxes.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hapticd.core.arrays import Records
from hapticd.core.errors import CommandError, MailboxError
from hapticd.core.faults import BY_NUMBER, FAULTS, Fault
from hapticd.core.params import ServoParams
from hapticd.core.units import NS_PER_MS, NS_PER_S
from hapticd.mailbox.client_side import Answer, GatewayMailbox
from hapticd.mailbox.daemons import FIRST_CLIENT, living_report
from hapticd.mailbox.layout import (
    COMMAND_VALUES,
    RECORD,
    TELEMETRY,
    TELEMETRY_HEAD_WORD,
    State,
    Value,
    newer,
)

__all__ = ["RECORD_DTYPE", "STATES", "ServoView", "as_records", "configured", "joined"]

# --- records --------------------------------------------------------------------------------------


RECORD_DTYPE = np.dtype(list(TELEMETRY))
FIELDS: tuple[str, ...] = tuple(str(field[0]) for field in TELEMETRY)
assert RECORD_DTYPE.itemsize == RECORD.size


def as_records(data: bytes) -> Records:
    """Return the whole records in `data` as a structured array (n,) of DTYPE that shares its
    memory.
    """
    return np.frombuffer(data, RECORD_DTYPE)


def joined(parts: Sequence[Records]) -> Records:
    """Return `parts` concatenated, all of one dtype, in new memory.

    numpy.concatenate would determine the common dtype field by field, which takes longer than the
    copy.
    """
    return np.frombuffer(b"".join(part.tobytes() for part in parts), parts[0].dtype)


def rows(data: bytes) -> list[dict[str, Any]]:
    """Return the whole records in `data` as maps of plain Python values."""
    return [dict(zip(FIELDS, values, strict=True)) for values in as_records(data).tolist()]


def last_torn(records: Records) -> int:
    """Return the number of leading records up to the last torn one; 0 if all are whole.

    Beginning and end of a torn record belong to different ticks.
    """
    torn = np.flatnonzero(records["tick"] != records["tail"])
    return int(torn[-1]) + 1 if torn.size else 0


# --- view -----------------------------------------------------------------------------------------

RETRY_NS = 100 * NS_PER_MS
SILENCE_NS = NS_PER_S  # a servo without a tick for 1 s counts as dead
DOWN = "down"
STARTING = "starting"
STATES = {int(state): state for state in State}


def configured(params: ServoParams) -> tuple[float, ...]:
    """Return the parameters with which a servo starts, by layout.Value."""
    values = params.environment.row() | {
        Value.ACTIVE_DAMPING: params.active_damping_ns_per_m,
        Value.LIMIT_CYCLE_FAULTS: float(params.safety.limit_cycle_faults),
    }
    return tuple(values.get(place, 0.0) for place in range(COMMAND_VALUES))


def _latest(one: int, other: int) -> int:
    return one if newer(one, other) else other


class ServoView:
    """The state of the servo. Call `refresh`, which is cheap, before any other access."""

    def __init__(self, folder: Path, params: ServoParams, unix_ns: Callable[[], int]) -> None:
        self.folder = folder
        self.params = params
        self._unix_ns = unix_ns
        self.mailbox: GatewayMailbox | None = None
        self.life = 0
        self.alive = False
        self._retry_ns = -RETRY_NS
        self.trouble = ""  # why the last attempt to open a mailbox failed
        self.foreign = ""  # configuration hash of a servo that differs from this gateway's
        self._last_actor = FIRST_CLIENT - 1
        self._forget()

    def _forget(self) -> None:
        self.record: dict[str, Any] = {}
        self._effective: tuple[float, ...] | None = None
        self.unix_offset_ns = 0
        self._came_late = False
        self._head = 0
        self._first_head = -1  # at the first read of this life; -1: not yet read
        self._promised = 0
        self.led_by = 0  # actor whose request led to the present state; 0: none, or unknown

    @property
    def ended(self) -> bool:
        """Whether the servo of the open mailbox has ended; its last records are still there."""
        return self.mailbox is not None and not self.mailbox.current

    def refresh(self, now_ns: int) -> None:
        """Open, close or reopen the mailbox as needed; read the newest record."""
        if self.ended:
            self.drop()
        if self.mailbox is None and now_ns - self._retry_ns >= RETRY_NS:
            self._retry_ns = now_ns
            self._open(now_ns)
        beat_ns = self.mailbox.servo_beat_ns if self.mailbox else 0
        self.alive = beat_ns > 0 and abs(now_ns - beat_ns) < SILENCE_NS
        self.look()

    def look(self) -> None:
        """Read the newest record, if there is a new one."""
        head = self.mailbox.load_head(TELEMETRY_HEAD_WORD) if self.mailbox else self._head
        if self.mailbox and head != self._head:
            self._head = head
            newest = rows(self.mailbox.records(head - 1, 1)[0])
            if newest and not self.record:
                self._promised = newest[-1]["revision"]
                self._came_late = self._promised > 0
                self._first_head = head
            if newest and self.record and newest[-1]["state"] != self.record["state"]:
                self.led_by = newest[-1]["actor"]
            self.record = newest[-1] if newest else self.record

    def drop(self) -> None:
        """Close the mailbox, whose servo has ended."""
        if self.mailbox:
            self.mailbox.close()
        self.mailbox = None
        self.alive = False

    def _open(self, now_ns: int) -> None:
        try:
            found = GatewayMailbox(self.folder, claimed=True)
        except MailboxError as error:
            self.trouble = str(error)
            self.foreign = ""
            return
        theirs = found.header.config_hash
        ours = self.params.config_hash
        self.foreign = theirs if theirs != ours else ""
        if self.foreign:
            found.close()
            self.trouble = (
                f"the servo runs configuration {theirs[:12]}, the gateway {ours[:12]}: scales and"
                " limits differ; restart both together"
            )
            return
        self.mailbox = found
        self._keep_last_actor()
        self.life += 1
        self._forget()
        self.unix_offset_ns = (
            self._unix_ns() - now_ns
        )  # once per life: time stamps of one life never jump

    def require_servo(self, cmd: str) -> None:
        """Raise CommandError if no servo can execute `cmd`."""
        if self.foreign:
            raise CommandError("servo_down", f"{cmd}: {self.trouble}")
        if not self.alive:
            raise CommandError(
                "servo_down",
                f"{cmd}: no servo answers; start it with `hapticd run`, see `hapticd status`",
            )

    def answers(self) -> list[Answer]:
        """Return the servo's answers since the last call.

        Each answer, including refusals, contains the parameters in force.
        """
        found = self.mailbox.answers() if self.mailbox else []
        if found:
            self._effective = found[-1].effective
        for answer in found:
            self._promised = _latest(self._promised, answer.revision)
        return found

    @property
    def targets(self) -> tuple[float, ...]:
        """The parameters by layout.Value, at the ends of their ramps: from the last answer, or as
        configured.
        """
        return self._effective or configured(self.params)

    @property
    def unsure(self) -> bool:
        """Whether parameters were changed before this gateway started, so that their values are
        unknown.
        """
        return self._came_late and self._effective is None and self.alive

    @property
    def seen(self) -> int:
        """Records that the servo has written since this gateway first read it."""
        return self._head - self._first_head if self._first_head >= 0 else 0

    def next_actor(self) -> int:
        """Return a client number that no gateway has used in this servo life."""
        self._last_actor += 1
        self._keep_last_actor()
        return self._last_actor

    def _keep_last_actor(self) -> None:
        if self.mailbox is not None:
            self._last_actor = max(self._last_actor, self.mailbox.last_actor)
            self.mailbox.last_actor = self._last_actor

    def newest(self, ticks: int) -> Records:
        """Return the records of the last `ticks` of this servo life, as far as available."""
        first = max(0, self._head - ticks)
        return as_records(self.mailbox.records(first, ticks)[0] if self.mailbox else b"")

    @property
    def head(self) -> int:
        """Records that the servo has written in this life."""
        return self._head

    @property
    def tick(self) -> int:
        """Tick of the newest record; -1 before the first."""
        return int(self.record.get("tick", -1))

    @property
    def revision(self) -> int:
        """Changes accepted in this life."""
        return _latest(self._promised, int(self.record.get("revision", 0)))

    @property
    def state(self) -> State | None:
        """State in the newest record; None while no servo is alive."""
        return STATES.get(self.record.get("state", -1)) if self.alive else None

    @property
    def state_name(self) -> str:
        """The state for users, including `down` and `starting`."""
        if self.state is not None:
            return self.state.name.lower()
        return STARTING if self.mailbox and not self.record else DOWN

    def report(self) -> dict[str, Any]:
        """Return the servo's report about itself and its board; empty without a servo."""
        return self.mailbox.report() if self.mailbox else living_report(self.folder)

    @property
    def fault(self) -> Fault:
        """Row of hapticd.core.faults for the newest record."""
        return BY_NUMBER.get(int(self.record.get("fault", 0)), FAULTS[0])
