"""What a batch of trials gives back: records or only sums of them, never a NaN."""

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import numpy.typing as npt

Values = npt.NDArray[np.floating[Any]]


@dataclass(frozen=True, eq=False)
class BatchResult:
    """n trials of `ticks` servo ticks at 4 kHz. The caller owns the arrays.

    A trial whose speed passed 1,000 m/s (rms over a tick), or was no number, has diverged: its sums and records end before that
    tick, `samples` says where, and what follows in its row of a record is 0.
    """

    params: Values  # (n, 3): stiffness N/m, damping Ns/m, mass kg
    sigma_v_m_per_s: Values  # (n,) rms of the recorded velocity
    max_force_n: Values  # (n,) largest command
    work_j: Values  # (n,) work of the perturbation on the device
    min_energy_j: Values  # (n,) lowest value of that work at the end of a tick: below 0 the device has given energy away
    samples: npt.NDArray[np.int64]  # (n,) that count
    rate_hz: float  # of the records
    seconds: float
    winding_c: Values | None = None  # (n,) temperature at the end, where the winding heats up
    torque_n: Values | None = None  # (samples,) if all trials share it, else (n, samples): interval means
    velocity_m_per_s: Values | None = None  # (n, samples), interval means
    position_m: Values | None = None  # (n, ticks) as the law saw it
    force_n: Values | None = None  # (n, ticks) as it was commanded

    @property
    def diverged(self) -> npt.NDArray[np.bool_]:
        """(n,)"""
        return self.samples < round(self.seconds * self.rate_hz)

    @property
    def diverged_at_s(self) -> Values:
        """(n,) time of divergence [s], infinite for a trial that ran to its end."""
        return np.where(self.diverged, self.samples / self.rate_hz, np.inf)

    def record(self, trial: int) -> tuple[Values, Values]:
        """(torque, velocity) of one trial up to its end. ValueError if records were not kept."""
        if self.torque_n is None or self.velocity_m_per_s is None:
            raise ValueError("only sums were kept; simulate with keep='records'")
        end = int(self.samples[trial])
        torque = self.torque_n if self.torque_n.ndim == 1 else self.torque_n[trial]
        return torque[:end], self.velocity_m_per_s[trial, :end]


SHARED = ("rate_hz", "seconds")


def joined(parts: list[BatchResult]) -> BatchResult:
    """One result from the parts of a batch, in order."""

    def together(name: str) -> Any:
        values = [getattr(part, name) for part in parts]
        if name in SHARED or values[0] is None or len(values) == 1:
            return values[0]
        return np.concatenate(values)

    return BatchResult(**{item.name: together(item.name) for item in fields(BatchResult)})
