"""Flying a recording again: all its legs, one after the other, and what came out."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hapticd.assembly.replay import Difference, Records, difference, replay
from hapticd.errors import ConfigError
from hapticd.mailbox.layout import Value
from hapticd.recording.file import Recording


@dataclass(frozen=True, eq=False)
class Reflight:
    """`recorded` and `flown` row by row (n,); `legs` (first row, row after the last);
    `different`: None if bit-exact.
    """

    recorded: Records
    flown: NDArray[np.void]
    legs: Sequence[tuple[int, int]]
    different: Difference | None

    @property
    def time_s(self) -> NDArray[np.float64]:
        """Seconds from the first record that was flown (n,)."""
        time_ns = self.recorded["time_ns"]
        return np.asarray((time_ns - time_ns[0]) * 1e-9)

    def plain(self) -> dict[str, Any]:
        """What came out, in numbers."""
        recorded = self.recorded["force_n"]
        flown = self.flown["force_n"]
        return {
            "ticks": len(self.flown),
            "legs": len(self.legs),
            "bit_exact": self.different is None,
            "first_difference": None if self.different is None else self.different._asdict(),
            "force_rms_n": {
                "recorded": _rms(recorded),
                "flown": _rms(flown),
                "difference": _rms(flown - recorded),
            },
            "force_peak_n": {
                "recorded": float(np.abs(recorded).max()),
                "flown": float(np.abs(flown).max()),
            },
        }


def refly(recording: Recording, instead: dict[Value, float] | None = None) -> Reflight:
    """Fly all legs of `recording`; `instead`: settings held at other values. ConfigError:
    nothing in it can be flown.
    """
    legs = recording.legs()
    if not legs:
        raise ConfigError(
            f"{recording.path} holds no checkpoint of the servo, from which to fly; record a second"
            " or longer"
        )
    params = recording.params
    flown = [replay(params, leg, instead) for leg in legs]
    ends = np.cumsum([len(leg.records) for leg in legs]).tolist()
    recorded = np.concatenate([leg.records for leg in legs])
    again = np.concatenate(flown)
    return Reflight(
        recorded, again, list(zip([0, *ends[:-1]], ends, strict=True)), difference(recorded, again)
    )


def _rms(values: NDArray[Any]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
