"""Why a trial ended before its time: an enumerated reason, and beside it a sentence for people.

The reason and the code of the fault decide what follows: the verdict, another trial, an exit code.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

__all__ = ["EndReason"]


class EndReason(StrEnum):
    """What ended a trial. The values are those of run.json."""

    ESCAPE = "escape"
    SATURATION = "saturation"
    TRAVEL = "travel"
    HEAT = "heat"
    DECIDED = "decided"
    SLOW_START = "slow_start"
    CHANGED = "changed"
    DISABLED = "disabled"
    STOPPED = "stopped"
    FAULT = "fault"
    SERVO_DOWN = "servo_down"


RUNAWAY_FAULTS = ("overspeed", "energy", "force_at_limit")  # codes of `faults`


@dataclass(frozen=True, slots=True)
class TrialEnd:
    """An early end of a trial. `fault`: the code of the servo's fault, "" without one."""

    reason: EndReason
    text: str
    fault: str = ""

    def __str__(self) -> str:
        return f"{self.reason.replace('_', ' ')}: {self.text}"

    @property
    def ran_away(self) -> bool:
        """Whether the motion grew by itself, as the monitor or the servo saw."""
        return self.reason is EndReason.ESCAPE or self.fault in RUNAWAY_FAULTS


def end_of_plain(plain: Mapping[str, Any] | None) -> TrialEnd | None:
    """The end that `store.to_json` wrote. ValueError or KeyError for anything else."""
    return TrialEnd(EndReason(plain["reason"]), plain["text"], plain["fault"]) if plain else None
