"""The terms of the guard (policy, basis, margin, mode), kept across a restart of the gateway.

A client may change the terms while the daemon runs; they apply to the servo life in which they were
requested. A gateway that restarts next to the same servo finds the same environment in force. With
the configured terms alone it might judge by a laxer policy than the operator expects. The terms are
therefore kept in the runtime folder with the epoch of the servo. After a restart they apply again
if they are no laxer than the configured ones (ADR-0018).

Terms end with their servo; a laxer one ends with its gateway.
"""

import json
from math import isfinite
from pathlib import Path
from typing import Any, NamedTuple, get_args

from hapticd.core.errors import MailboxError
from hapticd.core.params import STRICT_POLICIES, BasisName, Policy
from hapticd.core.units import NS_PER_S
from hapticd.mailbox.files import GUARD_TERMS, write_whole
from hapticd.protocol.journal import Journal
from hapticd.protocol.view import ServoView

RETRY_NS = NS_PER_S  # after a failed write
STRICTNESS = {"off": 0, "warn": 1} | dict.fromkeys(STRICT_POLICIES, 2)


class Terms(NamedTuple):
    """The terms of a judgement."""

    policy: str
    basis: str
    margin_ns_per_m: float  # required
    auto: bool = False  # the guard selects the level of active damping


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
                asked=before._asdict(),
                configured=self._configured._asdict(),
                terms=terms._asdict(),
                mode="auto" if terms.auto else "",
            )
        return terms
