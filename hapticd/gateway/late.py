"""How many ticks were late, by cause, and the latest of each (`mailbox.layout.LateCause`)."""

from typing import Any

from hapticd.core.units import NS_PER_S, NS_PER_US
from hapticd.mailbox.layout import LateCause
from hapticd.protocol.view import Records

CAUSES = [cause for cause in LateCause if cause]


class LateCounts:
    """The late ticks of one servo life that came after its grace."""

    def __init__(self, grace_s: float) -> None:
        self._grace_ns = round(grace_s * NS_PER_S)
        self.begin(0)

    def begin(self, start_ns: int) -> None:
        """Begin anew, for a servo life that began at `start_ns`."""
        self._settled_ns = start_ns + self._grace_ns
        self._found = {cause: {"count": 0, "latest_ns": 0} for cause in CAUSES}

    def add(self, records: Records) -> None:
        """Take the next `records`: each tells of the tick before it."""
        late = records["late_cause"] != LateCause.NONE
        if not late.any():
            return
        for record in records[late & (records["time_ns"] >= self._settled_ns)]:
            found = self._found.get(int(record["late_cause"]))  # type: ignore[call-overload]
            if found:
                found["count"] += 1
                found["latest_ns"] = max(found["latest_ns"], int(record["late_ns"]))

    def summary(self) -> dict[str, dict[str, Any]]:
        """{cause: {count, latest_us}}: how long after its deadline the latest one ended."""
        return {
            cause.name.lower(): {
                "count": found["count"],
                "latest_us": found["latest_ns"] / NS_PER_US,
            }
            for cause, found in self._found.items()
        }
