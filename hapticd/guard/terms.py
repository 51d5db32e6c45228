"""Inputs of the guard's judgements: terms, delay of the loop, and the environment in force.

Terms (`Terms`). They are policy, basis, margin and mode. A client may change them while the daemon
runs; they apply to the servo life in which they were requested. A gateway that restarts next to the
same servo finds the same environment in force. With the configured terms alone it might judge by a
laxer policy than the operator expects. The terms are therefore kept in the runtime folder with the
epoch of the servo (`TermsKeeper`). After a restart they apply again if they are no laxer than the
configured ones (ADR-0018). Terms end with their servo; a laxer one ends with its gateway.

Delay (`DelayHistogram`). Each record contains `delay_us`, the delay from a sample to its force, for
the force in effect when the record's own sample was taken. The delays of the last minute are
counted by second, in steps of 1/16 period. The guard uses the 99th percentile, rounded up to the
next step. A longer delay counts at once; a shorter one counts after 10 s, because each new delay
costs the worker 0.5 s. The theorem assumes a constant delay, and every verdict includes this
limitation. The delay must be rounded up, and a minute without records must not count the one
before.

Environment in force (`EnvironmentInForce`). It is determined from the newest record and the last
answer of the servo. `target` is the end of the ramps in progress, `now` the environment that acts
in the newest record. Records do not contain the wall's damping during a ramp, nor its side once it
is rounded to 0. For these `now` has the value that may still act and is furthest from the target.
`wall_virtual_dampings` has both extreme values of the wall's virtual damping, that value first.

Limitations: record and answers may belong to different revisions for a moment, and ramps that began
before this gateway may move a wall from an unknown value (see `known`).
"""

import json
from math import isfinite
from pathlib import Path
from typing import Any, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray

from hapticd.core.arrays import Records
from hapticd.core.environment import FIELDS, Environment
from hapticd.core.errors import MailboxError
from hapticd.core.params import STRICT_POLICIES, BasisName, Policy
from hapticd.core.units import NS_PER_S, US_PER_S
from hapticd.mailbox.client_side import Answer
from hapticd.mailbox.files import GUARD_TERMS, write_whole
from hapticd.mailbox.layout import Flag, Value, newer
from hapticd.protocol.commands import rendered
from hapticd.protocol.journal import Journal
from hapticd.protocol.view import ServoView

# --- terms ----------------------------------------------------------------------------------------

RETRY_NS = NS_PER_S  # after a failed write
STRICTNESS = {"off": 0, "warn": 1} | dict.fromkeys(STRICT_POLICIES, 2)


class Terms(NamedTuple):
    """The terms of a judgement."""

    policy: str
    basis: str
    margin_ns_per_m: float  # required
    auto: bool = False  # the guard selects the level of active damping

    def plain(self) -> dict[str, Any]:
        """Return the terms as the fields of an event."""
        return self._asdict() | {"mode": "auto" if self.auto else "as set"}


def stricter_of(chosen: Terms, configured: Terms) -> Terms:
    """Return `chosen`, with each term that is laxer than in `configured` replaced.

    A chosen basis applies if it is the theorem, the most conservative one. Mode auto always
    applies: without it the level in force would stay when the delay grows.
    """
    stricter = STRICTNESS[chosen.policy] >= STRICTNESS[configured.policy]
    return Terms(
        policy=chosen.policy if stricter else configured.policy,
        basis=chosen.basis if chosen.basis == "theorem" else configured.basis,
        margin_ns_per_m=max(chosen.margin_ns_per_m, configured.margin_ns_per_m),
        auto=chosen.auto,
    )


def write_terms(folder: Path, epoch: int, terms: Terms) -> None:
    """Store `terms` for the servo life that began at `epoch`. MailboxError: no space, no
    permission.
    """
    write_whole(folder / GUARD_TERMS, json.dumps({"epoch": epoch, **terms._asdict()}))


def read_terms(folder: Path, epoch: int) -> Terms | None:
    """Return the terms stored for the servo life that began at `epoch`; None without valid ones."""
    try:
        plain: dict[str, Any] = json.loads((folder / GUARD_TERMS).read_text())
        theirs = plain.pop("epoch")
        found = Terms(**plain)
        sound = isfinite(found.margin_ns_per_m) and found.margin_ns_per_m >= 0.0
    except (OSError, ValueError, TypeError, KeyError, AttributeError):
        return None
    known = found.policy in get_args(Policy) and found.basis in get_args(BasisName)
    return found if theirs == epoch and sound and known and isinstance(found.auto, bool) else None


class TermsKeeper:
    """Stores the terms for the servo of `view`, and restores those of an earlier gateway."""

    def __init__(self, view: ServoView, journal: Journal, configured: Terms) -> None:
        self._view = view
        self._journal = journal
        self._configured = configured
        self._kept = configured
        self._life = 0  # servo life of the stored terms
        self._failed: Terms | None = None  # terms whose last write failed
        self._retry_ns = 0

    def follow(self, terms: Terms, now_ns: int) -> Terms:
        """Store `terms` if they are new; return the terms to apply from now on.

        At the first servo life, terms of an earlier gateway are restored as far as they are no
        laxer, unless a client has already changed those of this gateway.
        """
        view = self._view
        if view.mailbox is None or (self._life == view.life and self._kept == terms):
            return terms
        if terms == self._failed and now_ns < self._retry_ns:
            return terms
        epoch = view.mailbox.header.start_ns
        if self._life == 0 and terms == self._configured:
            terms = self._found(epoch)
        try:
            write_terms(view.folder, epoch, terms)
        except MailboxError as error:
            if terms != self._failed:
                self._journal.note("terms_not_kept", reason=str(error))
            self._failed = terms
            self._retry_ns = now_ns + RETRY_NS
            return terms
        self._life = view.life
        self._kept = terms
        self._failed = None
        return terms

    def _found(self, epoch: int) -> Terms:
        before = read_terms(self._view.folder, epoch) or self._configured
        terms = stricter_of(before, self._configured)
        if before != self._configured:
            self._journal.note(
                "terms_after_restart",
                asked=before.plain(),
                configured=self._configured.plain(),
                terms=terms.plain(),
            )
        return terms


# --- delay ----------------------------------------------------------------------------------------

STEPS = 16  # of a period
MOST_PERIODS = 16
BINS = STEPS * MOST_PERIODS + 1  # the last bin includes all longer delays
KEPT_S = 60
SHARE = 0.99
LEAST_RECORDS = 500  # before the first percentile
SHORTER_S = 10


class DelayHistogram:
    """Histogram of the delays of the last KEPT_S seconds, at a servo rate [Hz]."""

    def __init__(self, rate_hz: float) -> None:
        self._steps_per_us = STEPS * rate_hz / US_PER_S
        self.clear()

    def clear(self) -> None:
        """Start again, for another servo life."""
        self._counts = np.zeros((KEPT_S, BINS), np.int64)  # by second, modulo KEPT_S
        self._total = np.zeros(BINS, np.int64)  # over all seconds
        self._newest = -KEPT_S  # s
        self.periods: float | None = None  # a multiple of 1/16; None: not yet known
        self._shorter_since: int | None = None  # s

    def add(self, records: Records) -> None:
        """Count the records whose delay is known."""
        delay_us = records["delay_us"]
        known = delay_us >= 0
        seconds = records["time_ns"][known] // NS_PER_S
        if not seconds.size:
            return
        # tolerate floating-point rounding at a step
        steps = np.ceil(delay_us[known] * self._steps_per_us - 1e-6).astype(np.int64)
        for second in sorted(set(seconds.tolist())):
            self._count(second, np.minimum(steps[seconds == second], BINS - 1))
        self._follow()

    def _count(self, second: int, steps: NDArray[np.int64]) -> None:
        if second <= self._newest - KEPT_S:
            return  # too old: a clock was set back
        for begun in range(max(self._newest, second - KEPT_S) + 1, second + 1):
            self._total -= self._counts[begun % KEPT_S]
            self._counts[begun % KEPT_S] = 0
        counts = np.bincount(steps, minlength=BINS)
        self._counts[second % KEPT_S] += counts
        self._total += counts
        self._newest = max(self._newest, second)

    def _follow(self) -> None:
        """Update the delay that 99 % of the ticks did not exceed, in periods; shorter
        ones later.
        """
        below = np.cumsum(self._total)
        if below[-1] < LEAST_RECORDS:
            return
        measured = float(np.searchsorted(below, SHARE * below[-1]) / STEPS)
        if self.periods is None or measured >= self.periods:
            self.periods = measured
            self._shorter_since = None
            return
        since = self._newest if self._shorter_since is None else self._shorter_since
        self._shorter_since = since
        if self._newest - since >= SHORTER_S:
            self.periods = measured
            self._shorter_since = None


# --- environment in force -------------------------------------------------------------------------

IN_MOTION = Flag.RAMPING | Flag.EASED | Flag.PAUSED
# columns with the acting values; side and active damping need more than the record
COLUMNS = {
    one.path: one.column
    for one in FIELDS
    if one.column and one.path not in ("wall.side", "active_damping_ns_per_m")
}


class WallSide:
    """The side of a wall that may still act: it ramps to 0, and records round it."""

    def __init__(self) -> None:
        self.value = 0

    def follow(self, records: Any) -> None:
        """Take `records`: a side counts until a record shows 0 without motion."""
        walled = np.flatnonzero(records["wall_side"])
        if walled.size:
            self.value = int(records["wall_side"][walled[-1]])
        after = records[walled[-1] + 1 :] if walled.size else records
        if after.size and not bool((after["flags"] & int(IN_MOTION)).all()):
            self.value = 0


class EnvironmentInForce:
    """The environment in force at the servo of `view`."""

    def __init__(self, view: ServoView) -> None:
        self._view = view
        self._wall_damping = {0.0}  # extreme ends of its ramps since nothing moved
        self._side = WallSide()
        self._settled_life = 0  # newest servo life of which a record without motion was seen

    def begin(self) -> None:
        """Start a new servo life."""
        self._side.value = 0

    def follow(self, records: Any) -> None:
        """Take telemetry `records`, each once and in order."""
        self._side.follow(records)

    def tend(self) -> None:
        """Follow the newest record. Call it in every pass."""
        if self._agrees and not self._moving:
            self._settled_life = self._view.life
            self._wall_damping = {self.target().wall.virtual_damping_ns_per_m}

    def hear(self, answer: Answer) -> None:
        """Take an answer of the servo, each once and in order."""
        ends = {*self._wall_damping, answer.effective[Value.WALL_VIRTUAL_DAMPING]}
        self._wall_damping = {min(ends), max(ends)}

    @property
    def known(self) -> bool:
        """Whether record and answers belong to the same environment, and no ramp is in progress
        that began before this gateway: no record contains the whole of a wall during it.
        """
        return self._agrees and self._settled_life == self._view.life

    @property
    def _agrees(self) -> bool:
        same = self._answered_revision == self.revision
        return self._view.alive and not self._view.unsure and same

    @property
    def _moving(self) -> bool:
        return bool(int(self._view.record.get("flags", 0)) & IN_MOTION)

    @property
    def ahead_of_answers(self) -> bool:
        """Whether the newest record has an environment whose answer is not yet known."""
        return self._view.alive and newer(self.revision, self._answered_revision)

    @property
    def _answered_revision(self) -> int:
        return int(self._view.targets[Value.ENVIRONMENT_REVISION])

    @property
    def revision(self) -> int:
        """Revision of the environment in the newest record; -1 before the first."""
        return int(self._view.record.get("environment_revision", -1))

    @property
    def controlled(self) -> bool:
        """Whether the energy controller of the servo holds more damping, or less K and B, than
        requested.
        """
        return bool(int(self._view.record.get("flags", 0)) & Flag.CONTROLLED)

    def target(self) -> Environment:
        """Return the end of the ramps in progress."""
        return rendered(self._view.targets)

    @property
    def wall_virtual_dampings(self) -> list[float]:
        """Extreme values of the wall's virtual damping [N s/m] that may act, the furthest from the
        target first.
        """
        target = self.target().wall.virtual_damping_ns_per_m
        return sorted(self._wall_damping, key=lambda end: -abs(end - target))

    def now(self) -> Environment:
        """Return the environment that acts in the newest record."""
        record = self._view.record
        target = self.target()
        effect = record["active_damping_effect_ns_per_m"]
        return target.with_values(
            {path: record[column] for path, column in COLUMNS.items()}
            | {
                "wall.virtual_damping_ns_per_m": self.wall_virtual_dampings[0],
                "wall.side": record["wall_side"] or (self._side.value if self._moving else 0),
                # NaN: the board did not report it
                "active_damping_ns_per_m": max(effect, 0.0) if effect == effect else 0.0,
            }
        )

    @property
    def empty(self) -> bool:
        """Whether nothing is rendered: K, B, M and the wall are 0, now and at the end of
        the ramps.
        """
        return self.now().empty and self.target().empty

    @property
    def level(self) -> float:
        """Active damping that `damping on` would set, N s/m."""
        return float(self._view.targets[Value.ACTIVE_DAMPING])
