"""The changes that the servo holds for later ticks; a new change is judged together with them.

A bounded change counts as two: the requested values, and their restoration at its end. The end has
the negative number of the command.

A change must not be kept after its servo has ended: every later verdict would count it.
"""

from typing import Any, NamedTuple

__all__ = ["Fields", "ScheduledChanges"]

Fields = dict[str, Any]  # of an environment, nested as in `set`


class ScheduledChange(NamedTuple):
    """A scheduled change."""

    tick: int
    seq: int
    fields: Fields


class ScheduledChanges:
    """The scheduled changes of one servo life, by the sequence number of their command."""

    def __init__(self) -> None:
        self._changes: dict[int, ScheduledChange] = {}

    def clear(self) -> None:
        """Forget all changes: a new servo holds none."""
        self._changes.clear()

    def add(self, tick: int, seq: int, fields: Fields) -> None:
        """Note that command `seq` changes `fields` at `tick`."""
        self._changes[seq] = ScheduledChange(tick, seq, fields)

    def close(self, seq: int, applied: bool) -> None:
        """Remove command `seq` after its second answer; if it was not `applied`, remove its end
        too.
        """
        self._changes.pop(seq, None)
        if not applied:
            self._changes.pop(-seq, None)

    def ends(self, at_tick: int, until_tick: int) -> list[Fields]:
        """Return the values that ends of changes in force at `at_tick` restore up to
        `until_tick`.
        """
        waiting = {one.seq for one in self._changes.values() if one.tick > at_tick}
        return [
            one.fields
            for one in self._in_order()
            if one.seq < 0 and -one.seq not in waiting and at_tick < one.tick <= until_tick
        ]

    def around(self, at_tick: int, tick: int) -> tuple[list[Fields], list[Fields]]:
        """Return the changes due up to `at_tick`, and those after it. Changes due at the present
        `tick` or earlier are forgotten.
        """
        self._changes = {seq: one for seq, one in self._changes.items() if one.tick > tick}
        booked = self._in_order()
        before = [one.fields for one in booked if one.tick <= at_tick]
        return before, [one.fields for one in booked[len(before) :]]

    def _in_order(self) -> list[ScheduledChange]:
        return sorted(self._changes.values(), key=lambda one: (one.tick, abs(one.seq)))
