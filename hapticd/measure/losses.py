"""What a trial lost on its way: samples of the probe, slots of the servo. Filled, counted and named.

A record whose gaps are closed up jumps at every one of them, and a jump is noise at all frequencies: half a per cent lost by
sixes took more than half of |Z| at 2 Hz over a spring of 500 N/m. So what is missing keeps its place in time:

    up to 10 ms       a straight line in both channels: 1 % lost by sixes changes |Z| by 3 % where it is worst
    longer            silence in both: a line would be a push that never was

A lost slot is another matter: the servo left out a tick, the command before stood longer, and what was rendered was not what
was asked. No analysis puts that right. A record that lost more than a hundredth of either decides nothing.

A file whose column of times shows that rows are missing (`times`) is treated alike.

What would break it: gaps that come with the motion (a board that loses what is fast); they come with the host's load.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from hapticd.analysis.arrays import Flags, Floats, Integers
from hapticd.analysis.diagnostics import Finding

BRIDGED = 40  # samples at most: 10 ms
MOST_LOST = 0.01  # share of samples or slots above which nothing is decided
COUNTS = ("lost_samples", "samples", "lost_slots", "slots")  # as the run's summary names them
LOST_SLOTS = 1 << 32  # where the count of lost slots begins anew
REMEDY_OF_FILES = "rows are missing by the times in the file, record again without gaps"
REMEDY = "close other programs on this computer, see `hapticd doctor`"


class Filler:
    """Puts blocks of numbered samples into even time; one for each stream."""

    def __init__(self) -> None:
        self._last: tuple[int, Floats] | None = None  # number and values of the last sample

    def filled(self, index: Integers, values: Floats) -> tuple[Floats, Flags]:
        """`values` (channels, n) of the samples numbered `index` (n,), with those that are missing between them and since the
        block before; beside them which came (m,). Numbers that fall back begin anew.
        """
        whole, known = index.astype(np.int64), values
        if self._last is not None and self._last[0] < whole[0]:
            whole = np.concatenate(([self._last[0]], whole))
            known = np.column_stack((self._last[1], known))
        skip = whole.size - index.size
        self._last = int(index[-1]), values[:, -1]
        place = whole - whole[0]
        at = np.arange(place[-1] + 1)
        came, silent = np.isin(at, place), np.repeat(np.diff(place) > BRIDGED + 1, np.diff(place))
        full = np.stack([np.interp(at, place, channel) for channel in known])
        full[:, 1:][:, silent & ~came[1:]] = 0.0
        return full[:, skip:], came[skip:]


def loss_findings(counts: Mapping[str, Any]) -> tuple[Finding, ...]:
    """Lost samples and slots by `counts` (`COUNTS`, those that are known), each with value, share and remedy."""
    lost_samples, samples, lost_slots, slots = (int(counts.get(name, 0)) for name in COUNTS)
    found = []
    if lost_samples:
        words = f"samples of the probe {_share(lost_samples, samples)}; they were filled in, and lower the coherence"
        remedy = REMEDY if "slots" in counts else REMEDY_OF_FILES
        found.append(_named("lost_samples", words, lost_samples / samples, f"{remedy}; h_force reads |Z| better than spa"))
    if lost_slots:
        words = f"slots of the servo {_share(lost_slots, slots)}; the command before them stood longer than asked"
        found.append(_named("lost_slots", words, lost_slots / slots, REMEDY))
    return tuple(found)


def summed(parts: list[Mapping[str, Any]]) -> dict[str, int]:
    """Counts of several records together; none where the records have none."""
    return {name: sum(part[name] for part in parts) for name in COUNTS if all(name in part for part in parts)}


def _share(lost: int, total: int) -> str:
    return f"lost: {lost} of {total}, {100.0 * lost / total:.2g} %"


def _named(code: str, words: str, share: float, remedy: str) -> Finding:
    void = f"; above {100 * MOST_LOST:g} % nothing is decided" if share > MOST_LOST else ""
    return Finding(code, f"{words}{void}: {remedy}", voids=share > MOST_LOST)
