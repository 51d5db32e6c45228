"""Replay of a whole recording, one segment after the other, and its result.

A segment is a stretch of consecutive ticks of one servo life, from its first checkpoint on; within
one, `run.replay` runs the servo's own step on the recorded samples. The motion remains the recorded
one. With other settings a replay shows the commands of the tick law, not the motion of the display.

The result of a tick must depend on the checkpoint, the samples and the requests in the file alone.
Otherwise `first_difference` names that tick.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hapticd.core.errors import ConfigError
from hapticd.core.units import NS_PER_S
from hapticd.mailbox.layout import Value
from hapticd.recording.file import Recording
from hapticd.run.replay import Difference, Records, difference, replay

__all__ = ["ReplayResult", "replay_recording"]


@dataclass(frozen=True, eq=False)
class ReplayResult:
    """A recording and its replay, row by row."""

    recorded: Records  # (n,)
    replayed: NDArray[np.void]  # (n,), the same fields
    segments: Sequence[tuple[int, int]]  # (first row, row after the last) of each
    first_difference: Difference | None  # None: bit-exact
    left_out: int = 0  # recorded ticks before a checkpoint, which cannot be replayed

    @property
    def time_s(self) -> NDArray[np.float64]:
        """Seconds from the first replayed record (n,)."""
        time_ns = self.recorded["time_ns"]
        return np.asarray((time_ns - time_ns[0]) / NS_PER_S)

    @property
    def first_force_tick(self) -> int | None:
        """The first tick at which the force differs; None if it never does."""
        changed = np.flatnonzero(self.recorded["force_n"] != self.replayed["force_n"])
        return int(self.recorded["tick"][changed[0]]) if changed.size else None

    def to_json(self) -> dict[str, Any]:
        """Return counts, the first difference, and rms and peak of both forces [N]."""
        recorded = self.recorded["force_n"]
        replayed = self.replayed["force_n"]
        forces = {"recorded": recorded, "replayed": replayed, "difference": replayed - recorded}
        first = self.first_difference
        return {
            "ticks": len(self.replayed),
            "legs": len(self.segments),
            "left_out": self.left_out,
            "first_force_tick": self.first_force_tick,
            "bit_exact": first is None,
            "first_difference": None if first is None else first._asdict(),
            "force_rms_n": {
                name: float(np.sqrt(np.mean(np.square(force_n))))
                for name, force_n in forces.items()
            },
            "force_peak_n": {
                "recorded": float(np.abs(recorded).max()),
                "replayed": float(np.abs(replayed).max()),
            },
        }


def replay_recording(
    recording: Recording, instead: dict[Value, float] | None = None
) -> ReplayResult:
    """Replay all segments of `recording`; `instead`: settings to replace. ConfigError if it
    contains no segment.
    """
    segments = recording.segments()
    if not segments:
        raise ConfigError(
            f"{recording.path} holds no checkpoint of the servo, from which a replay begins; record"
            " a second or longer"
        )
    recorded = np.concatenate([segment.records for segment in segments])
    params = recording.params
    replayed = np.concatenate([replay(params, segment, instead) for segment in segments])
    edges = np.cumsum([0, *(len(segment.records) for segment in segments)]).tolist()
    left_out = recording.rows["servo"] - len(recorded)
    first = difference(recorded, replayed)
    return ReplayResult(recorded, replayed, list(pairwise(edges)), first, left_out)
