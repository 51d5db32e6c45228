"""What a batch of trials gives back: records, spectra or only sums, never a NaN."""

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import numpy.typing as npt

from hapticd.analysis.arrays import Complexes, Floats, Values
from hapticd.analysis.spa import DEFAULT_LAG as LAG
from hapticd.analysis.spectra import Spectra, grid_frequencies


@dataclass(frozen=True, eq=False)
class BatchResult:
    """n trials of `ticks` servo ticks at 4 kHz. The caller owns the arrays.

    A trial whose speed passed 1,000 m/s (rms over a tick), or was no number, has diverged: its sums
    and records end before that tick, `samples` says where, and what follows in its row of a record
    is 0.
    """

    params: Values  # (n, 3): stiffness N/m, damping Ns/m, mass kg
    sigma_v_m_per_s: Values  # (n,) rms of the recorded velocity
    max_force_n: Values  # (n,) largest command
    work_j: Values  # (n,) work of the perturbation on the device
    # (n,) lowest value of that work at the end of a tick: below 0 the device has given energy away
    min_energy_j: Values
    samples: npt.NDArray[np.int64]  # (n,) that count
    rate_hz: float  # of the records
    seconds: float
    winding_c: Values | None = None  # (n,) temperature at the end, where the winding heats up
    force_spectrum: Floats | None = (
        None  # (F,) or (n, F) [N^2], with keep="spectra", at k 4000/4096 Hz; as `analysis.spa`
    )
    velocity_spectrum: Floats | None = None  # (n, F) [(m/s)^2]
    cross_spectrum: Complexes | None = None  # (n, F) [N m/s]
    section_rms_m_per_s: Values | None = None  # (n, sections) of 2,048 samples
    torque_n: Values | None = (
        None  # (samples,) if all trials share it, else (n, samples): interval means
    )
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

    def traces(self, trial: int) -> tuple[Floats, Floats]:
        """(position, command) float64 of one trial at each tick up to its end. ValueError if
        they were not kept.
        """
        if self.position_m is None or self.force_n is None:
            raise ValueError("no ticks were kept; simulate with keep='ticks'")
        end = int(self.samples[trial]) * self.force_n.shape[1] // round(self.seconds * self.rate_hz)
        return np.asarray(self.position_m[trial, :end], np.float64), np.asarray(
            self.force_n[trial, :end], np.float64
        )

    def spectra(self, trial: int) -> Spectra:
        """Of one trial, as `spa` gives them of its record. ValueError if they were not kept, or
        it diverged.
        """
        if (
            self.force_spectrum is None
            or self.velocity_spectrum is None
            or self.cross_spectrum is None
        ):
            raise ValueError("spectra were not kept; simulate with keep='spectra'")
        if self.diverged[trial]:
            raise ValueError(
                f"trial {trial} diverged after {self.diverged_at_s[trial]:.3g} s: it has no spectra"
            )
        force = np.asarray(
            self.force_spectrum if self.force_spectrum.ndim == 1 else self.force_spectrum[trial]
        )
        samples = int(self.samples[trial])
        f = grid_frequencies(self.rate_hz, LAG)
        return Spectra(
            f,
            self.velocity_spectrum[trial],
            force,
            self.cross_spectrum[trial],
            self.rate_hz,
            samples,
            LAG,
        )


SHARED = ("rate_hz", "seconds")


def joined(parts: list[BatchResult]) -> BatchResult:
    """One result from the parts of a batch, in order."""

    def together(name: str) -> Any:
        values = [getattr(part, name) for part in parts]
        if name in SHARED or values[0] is None or len(values) == 1:
            return values[0]
        return np.concatenate(values)

    return BatchResult(**{item.name: together(item.name) for item in fields(BatchResult)})
