"""The record of another acquisition system, aligned sample by sample with the daemon's record of
the same trial.

The daemon's own record contains the rendered environment of every tick, the largest command, and
the lost slots; the other system has the better sensors. `zwidth.alignment` finds the start, the
clock and the gaps of the file from the mark at the start of the perturbation. The file's channels
are then interpolated at the times of the daemon's samples, so that sample i of the result is sample
`first_sample` + i of the own record. Samples that the file lost are filled and counted as in a live
trial (`watch`).

Each channel is compared with the daemon's own. An inverted channel is flipped, with a note. A
channel that resembles the other one more, or neither, is refused by name.

Limitations: a force sensor away from the probe, with mass between them. The two forces then differ
by that mass, and the verdict is for the port of the file's sensor.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from hapticd.core.arrays import Flags, Floats
from hapticd.core.errors import AnalysisError
from hapticd.core.units import PROBE_RATE_HZ
from hapticd.zwidth.alignment import FASTEST, LEAST, NO_MARK, Mark, Track, align, find_marks
from hapticd.zwidth.matching import Gap, fitting, interpolated
from hapticd.zwidth.recorded import ForeignSamples, read_file, read_foreign
from hapticd.zwidth.store import MARK_SAMPLE, TrialRecord
from hapticd.zwidth.watch import GapFiller, in_even_time

__all__ = ["read_aligned"]

GAPS_SAID = 4  # listed in text; all are in the summary
CERTAINTY = 1.96  # standard deviations of a 95 % interval
COUNTED = ("lost_slots", "slots")  # of the own record, still valid


@dataclass(frozen=True, slots=True)
class Likeness:
    """A channel of the file compared with the daemon's own."""

    coefficient: float  # of correlation; the sign is that of the file
    gain: float  # the file's over the daemon's, both in N or m/s

    def __str__(self) -> str:
        inverted = " (inverted: turned)" if self.coefficient < 0.0 else ""
        return f"gain {abs(self.gain):.4g}, coefficient {abs(self.coefficient):.3f}{inverted}"


@dataclass(frozen=True, slots=True)
class Alignment:
    """Position and clock of a file relative to the daemon's own record, for the run's summary."""

    own: str  # origin of the daemon's record
    offset: int  # number of the file's sample (counter or row) at the own sample 0 ...
    offset_fraction: float  # ... and the fraction of a sample
    clock_ppm: float  # how fast the file's clock runs
    clock_ppm_sd: float  # standard deviation of it
    residual_s: float  # rms of pieces of a quarter of a second about that clock
    first_sample: int  # sample of the own record at which this one begins
    mark: Mark
    gaps: tuple[Gap, ...]  # in addition to those of the file's counter or times
    force: Likeness
    velocity: Likeness

    def __str__(self) -> str:
        return (
            f"aligned with {self.own}: its sample 0 is sample"
            f" {self.offset}.{int(1e3 * self.offset_fraction):03d} of the file; clock"
            f" {self.clock_ppm:+.3f} ppm (+-{CERTAINTY * self.clock_ppm_sd:.2g}), residual"
            f" {1e6 * self.residual_s:.2g} us rms; {_gaps(self.gaps)}; force:"
            f" {self.force}; velocity: {self.velocity}"
        )


def read_aligned(
    path: Path,
    own_path: Path,
    force: str = "",
    velocity: str = "",
    rate_hz: float | None = None,
    counter: str = "",
) -> TrialRecord:
    """Return the record in `path`, of any system at 4 kHz, on the samples of hapticd's own record
    of the same trial in `own_path`; names and rate as for `read_file`.

    AnalysisError for an own record without a mark, and for a file without it, of another trial or
    rate, or with channels that are not force and velocity; otherwise as `read_file`.
    """
    own = read_file(own_path)
    mark_at = own.more.get(MARK_SAMPLE)
    if own.rendered is None or mark_at is None:
        raise AnalysisError(f"{own_path}: no marked trial of hapticd's own; {NO_MARK}")
    foreign = read_foreign(path, force, velocity, rate_hz, counter)
    if abs(foreign.rate_hz / PROBE_RATE_HZ - 1.0) > FASTEST:
        raise AnalysisError(
            f"{path}: a rate of {foreign.rate_hz:.9g} Hz; files at {PROBE_RATE_HZ} Hz +-"
            f" {1e6 * FASTEST:g} ppm are aligned: record at that rate"
        )
    even, came = GapFiller().filled(foreign.place, np.stack((foreign.force, foreign.velocity)))
    try:
        track = align(own.force_n, int(mark_at), even[0])
    except AnalysisError as error:
        raise AnalysisError(f"{path}: {error}{_marked_instead(foreign)}") from error
    return _beside(path, own, foreign, track, (even, came))


def _marked_instead(foreign: ForeignSamples) -> str:
    """Describe which other column shows the mark best; "" if the force shows one."""
    if find_marks(foreign.force):
        return ""
    strength = {
        name: max((abs(mark.coefficient) for mark in find_marks(values.ravel())), default=0.0)
        for name, values in foreign.columns.items()
        if values.size == foreign.force.size
    }
    best = max(strength, key=strength.__getitem__)
    return f"; the mark is in column {best}" if strength[best] else ""


def _beside(
    path: Path, own: TrialRecord, foreign: ForeignSamples, track: Track, even: tuple[Floats, Flags]
) -> TrialRecord:
    (force, velocity), known = _on_own_samples(track, *even)
    part = slice(track.first, track.after)
    known = fitting(own.force_n[part], force, known)
    channels = np.stack((own.force_n, own.velocity_m_per_s))[:, part]
    likeness = _likeness(path, np.stack((force, velocity))[:, known], channels[:, known])
    signs = [np.copysign(1.0, one.coefficient) for one in likeness]
    place = np.flatnonzero(known)
    clock = track.clock
    offset = int(np.floor(clock.offset_rows))
    alignment = Alignment(
        own=own.origin,
        offset=foreign.first + offset,
        offset_fraction=clock.offset_rows - offset,
        clock_ppm=clock.ppm,
        clock_ppm_sd=clock.ppm_sd,
        residual_s=clock.residual_samples / PROBE_RATE_HZ,
        first_sample=track.first + int(place[0]),
        mark=track.mark,
        gaps=track.gaps,
        force=likeness[0],
        velocity=likeness[1],
    )
    counts = {name: own.more[name] for name in COUNTED if name in own.more}
    recorded = replace(
        own,
        force_n=signs[0] * force[known],
        velocity_m_per_s=signs[1] * velocity[known],
        origin=f"{path.name} beside {own.origin}",
        more={**counts, "alignment": alignment},
    )
    return in_even_time(recorded, place)


def _on_own_samples(track: Track, channels: Floats, came: Flags) -> tuple[Floats, Flags]:
    """Return channels (2, n) of the file at the own samples of `track`, and which exist."""
    even, _ = GapFiller().filled(track.place, channels[:, track.rows])
    measured = np.zeros(even.shape[1], dtype=bool)
    measured[track.place - track.place[0]] = came[track.rows]
    at = track.clock.at(np.arange(track.first, track.after)) - track.place[0]
    below = np.floor(at).astype(np.int64)
    inside = (below >= 0) & (below + 1 < measured.size)
    below = np.clip(below, 0, measured.size - 2)
    known = inside & measured[below] & measured[below + 1]
    return np.stack([interpolated(channel, at) for channel in even]), known


def _likeness(path: Path, channels: Floats, own: Floats) -> list[Likeness]:
    """Compare force and velocity of the file (2, n) with the daemon's (2, n). AnalysisError if one
    is not the named channel.
    """
    table = np.asarray(np.corrcoef(np.concatenate((channels, own))))[:2, 2:]
    found = []
    for number, (name, other) in enumerate((("force", "velocity"), ("velocity", "force"))):
        mine, others = np.abs(table[number, [number, 1 - number]])
        if not mine >= LEAST or others > mine:
            raise AnalysisError(
                f"{path}: the column of the {name} is not the daemon's {name} (coefficient"
                f" {mine:.2g}, {LEAST:g} is needed; with its {other} {others:.2g}); name the"
                f" right one with --{name}-column"
            )
        gain = float(channels[number] @ own[number]) / float(own[number] @ own[number])
        found.append(Likeness(float(table[number, number]), gain))
    return found


def _gaps(gaps: tuple[Gap, ...]) -> str:
    if not gaps:
        return "no gaps"
    said = [
        f"{abs(gap.lost)} {'lost' if gap.lost > 0 else 'too many'} at"
        f" {gap.own_sample / PROBE_RATE_HZ:.4g} s"
        for gap in gaps[:GAPS_SAID]
    ]
    more = f" and {len(gaps) - GAPS_SAID} more" if len(gaps) > GAPS_SAID else ""
    return f"{len(gaps)} {'gap' if len(gaps) == 1 else 'gaps'}: {', '.join(said)}{more}"
