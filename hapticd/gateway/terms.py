"""What the guard goes by, and what is left of it when the gateway starts anew.

A client may change policy, basis, margin and mode while the daemon runs. They are for the servo
life in which they were asked for: a gateway that dies and starts again beside the same servo finds
the same environment in force, and would otherwise judge it by a laxer policy than its operator
believes in. So the terms are kept in the runtime folder with the epoch of the servo, and what was
asked for counts again where it is no laxer than what is configured (ADR 0131).

What would break it: terms that outlive their servo, or a laxer one that survives its gateway.
"""

import json
from math import isfinite
from pathlib import Path
from typing import Any, NamedTuple, get_args

from hapticd.mailbox.files import GUARD_TERMS, write_whole
from hapticd.params import STRICT_POLICIES, BasisName, Policy

LAXEST_FIRST = ("off", "warn")  # then those of STRICT_POLICIES, which are all as strict


class Terms(NamedTuple):
    """By what the guard judges."""

    policy: str
    basis: str
    margin_ns_per_m: float  # that has to be left
    auto: bool = False  # the guard chooses the level of active damping

    def words(self) -> str:
        """For people."""
        mode = ", damping auto" if self.auto else ""
        return f"{self.policy} by {self.basis}, margin {self.margin_ns_per_m:g} N s/m{mode}"


def _strictness(policy: str) -> int:
    return len(LAXEST_FIRST) if policy in STRICT_POLICIES else LAXEST_FIRST.index(policy)


def no_laxer(chosen: Terms, configured: Terms) -> Terms:
    """`chosen` as far as each of them is no laxer than `configured`, which counts for the rest.

    A basis counts again if it is the theorem, which counts on least; mode auto does in any case:
    without it the level in force would stay when the delay grows.
    """
    stricter = _strictness(chosen.policy) >= _strictness(configured.policy)
    return Terms(
        policy=chosen.policy if stricter else configured.policy,
        basis=chosen.basis if chosen.basis == "theorem" else configured.basis,
        margin_ns_per_m=max(chosen.margin_ns_per_m, configured.margin_ns_per_m),
        auto=chosen.auto,
    )


def keep(folder: Path, epoch: int, terms: Terms) -> None:
    """Keep `terms` for the servo life that began at `epoch`. MailboxError: no room, no right."""
    write_whole(folder / GUARD_TERMS, json.dumps({"epoch": epoch, **terms._asdict()}))


def kept(folder: Path, epoch: int) -> Terms | None:
    """The terms kept for the servo life that began at `epoch`; None without any that are whole."""
    try:
        plain: dict[str, Any] = json.loads((folder / GUARD_TERMS).read_text())
        theirs = plain.pop("epoch")
        found = Terms(**plain)
        sound = isfinite(found.margin_ns_per_m) and found.margin_ns_per_m >= 0.0
    except (OSError, ValueError, TypeError, KeyError, AttributeError):
        return None
    known = found.policy in get_args(Policy) and found.basis in get_args(BasisName)
    return found if theirs == epoch and sound and known and isinstance(found.auto, bool) else None
