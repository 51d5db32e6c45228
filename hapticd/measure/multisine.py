"""A trial by multisines: several realisations of a force that repeats, each settled for one period and measured for some.

The multisine has the period of the window's grid (4096 samples), every harmonic with one amplitude, and random phases, other
ones for every realisation; its density is that of the noise it stands for, so friction acts alike. It ends where the judged band
ends: the loop is sampled, and what shakes it above half of its rate is folded back into the band (1e-3 of Z at 1 kHz).

For a device without friction 2 s of it know Z better than 90 s of noise. Friction distorts, the same way in every period: only
more realisations average that, and only they show how much it is (`analysis.periodic`).

The record holds the realisations one after the other, each with the period in which it settles, as it was flown from rest. One
whose force did not repeat, because a stalled host let the board run out of samples, is flown again.

What would break it: a loop so lightly damped that it rings for more than a period.
"""

from dataclasses import dataclass, replace
from math import sqrt

import numpy as np

from hapticd.analysis.periodic import CHANGING, PeriodicSpectra, changing, periodic
from hapticd.analysis.spa import DEFAULT_LAG
from hapticd.errors import AnalysisError
from hapticd.measure.progress import Progress, Steps, silent
from hapticd.measure.recorded import Recorded, nearer
from hapticd.measure.sources import Source, Trial
from hapticd.measure.watch import summed
from hapticd.plant.scene import Excitation
from hapticd.units import PROBE_RATE_HZ

PERIOD = 2 * DEFAULT_LAG  # samples
SPARE_S = 0.01  # periods need not be whole ticks
TRIES = 8  # of a realisation


@dataclass(frozen=True, slots=True)
class Layout:
    """`realisations` of the force, each of `periods` that are measured, after one that is not."""

    realisations: int = 8
    periods: int = 2

    @property
    def samples(self) -> int:
        """Of one realisation."""
        return (self.periods + 1) * PERIOD

    @property
    def seconds(self) -> float:
        """Of all realisations."""
        return self.realisations * self.samples / PROBE_RATE_HZ


def checked(layout: Layout) -> Layout:
    """`layout`. AnalysisError for one without an interval: less than two of whatever is averaged."""
    if min(layout.realisations, layout.periods) < 1 or max(layout.realisations, layout.periods) < 2:
        raise AnalysisError(
            f"{layout.realisations} realisations of {layout.periods} periods have no scatter to learn from; ask for two or more "
            "realisations"
        )
    return layout


def multisine_like(noise: Excitation, highest_hz: float) -> Excitation:
    """The multisine of the density and seed of `noise`, up to `highest_hz`."""
    band_hz = min(noise.band_hz, highest_hz)
    force_n = sqrt(noise.psd_n2_per_hz * band_hz)
    return replace(noise, kind="multisine", band_hz=band_hz, force_n=force_n, period_s=PERIOD / PROBE_RATE_HZ)


def realised(trial: Trial, layout: Layout, source: Source, tell: Progress = silent) -> Recorded:
    """Every realisation by `source`, until one ends early. AnalysisError if not even the first was whole, or if one never
    repeated; else as the source.
    """
    steps, whole, again = Steps(tell, layout.realisations), [], 0
    asked = replace(trial, seconds=layout.samples / PROBE_RATE_HZ + SPARE_S, watch=replace(trial.watch, random=False))
    for number in range(layout.realisations):
        steps.next(f"realisation {number + 1} of {layout.realisations}")
        excitation = replace(trial.excitation, seed=trial.excitation.seed + number)
        found, tries = _flown(replace(asked, excitation=excitation), layout, source)
        again += tries - 1
        if found.force_n.size >= layout.samples:
            whole.append(found)
        if found.ended:
            break
    steps.end()
    if not whole:
        raise AnalysisError(f"ended after {found.seconds:.3g} s ({found.ended}): too short for a verdict{nearer(found.ended)}")
    return _joined(whole, layout, found.ended, again)


def _flown(asked: Trial, layout: Layout, source: Source) -> tuple[Recorded, int]:
    """One realisation, and how often it took."""
    for tries in range(1, TRIES + 1):
        found = source(asked, silent)
        if found.ended or changing(found.force_n[: layout.samples].reshape(1, -1, PERIOD)) <= CHANGING:
            return found, tries
    raise AnalysisError(
        f"the force did not repeat in {TRIES} tries of a realisation: the host stalls for milliseconds or samples are lost; see "
        "`hapticd doctor`, take fewer --periods, or noise"
    )


def laid_out(recorded: Recorded, layout: Layout) -> PeriodicSpectra:
    """Spectra of as many whole realisations as there are in a record of that layout. AnalysisError if there is none."""
    count = recorded.force_n.size // layout.samples
    if not count:
        raise AnalysisError(
            f"record of {recorded.seconds:.3g} s: a realisation of 1 + {layout.periods} periods of {PERIOD} samples takes "
            f"{layout.samples / recorded.rate_hz:.3g} s; record it whole, or say its --periods"
        )
    force, velocity = (
        channel[: count * layout.samples].reshape(count, layout.periods + 1, PERIOD)[:, 1:]
        for channel in (recorded.force_n, recorded.velocity_m_per_s)
    )
    return periodic(force, velocity, recorded.rate_hz)


def _joined(parts: list[Recorded], layout: Layout, ended: str, again: int) -> Recorded:
    force, velocity = (
        np.concatenate([channel[: layout.samples] for channel in channels])
        for channels in zip(*((part.force_n, part.velocity_m_per_s) for part in parts), strict=True)
    )
    commands = [part.max_command_n for part in parts if part.max_command_n is not None]
    more = {**parts[-1].more, "flown_again": again, **summed([part.more for part in parts])}
    return replace(
        parts[-1], force_n=force, velocity_m_per_s=velocity, ended=ended, max_command_n=max(commands, default=None), more=more
    )
