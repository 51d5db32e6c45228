"""The monitor that ends a trial early, and the treatment of lost samples and slots.

The monitor ends a running trial for

    escape        the velocity of a second is four times that of the calm ones, it grew faster
                  than a noise-driven resonance (the rules of `signal.findings`), and the force
                  did not grow with it; or it is faster than the device's own limit, where that is
                  known; or the commanded force reached its limit in a motion that the
                  perturbation does not explain, as in a loop that ran away before the record began.
                  Speed alone is not an escape: a linear device moves as fast as it is driven
    saturation    a channel is at its end in more than a hundredth of a second's samples, or the
                  commanded force reached its limit: the rendered force then differs from the
                  request. The next second is still checked, because a loop that runs away reaches
                  the limit first
    travel        the device is at an end of its travel, so the stop is measured
    heat          the winding is hotter than its limit
    decided       the verdict is final (with `until_decided`); a verdict that only the whole record
                  can confirm (`signal.resolved`) is not final yet

and can report at any time how many seconds the requested confidence would need. It checks whole
seconds, so a record that it ends contains the second in question, and the verdict on that record
repeats the finding.

Limitations: a perturbation that is not stationary, such as a stepped sine; do not use it there.
Under a periodic force it gives no intermediate verdict (`random` is False), because its spectra are
those of noise.

Lost samples of the probe and lost slots of the servo are filled, counted and reported. A record
with closed gaps jumps at every one of them, and a jump is noise at all frequencies. Half a per cent
lost in groups of six removed more than half of |Z| at 2 Hz over a spring of 500 N/m. Missing
samples therefore keep their place in time:

    up to 10 ms       a straight line in both channels: 1 % lost in groups of six changes the
                      window's |Z| by at most 3 %; for a spring of 500 N/m judged again on its
                      record, 0.5 % remove a tenth at 2 Hz
    longer            zero in both: a line would be a force that never existed

A lost slot is different: the servo skipped a tick, the previous command was held longer, and the
rendered force differed from the request. No analysis can correct that. A record that lost more than
a hundredth of either decides nothing.

A file whose column of times shows missing rows (`timestamps`) is treated in the same way.

Limitations of the filling: gaps that correlate with the motion (a board that loses fast samples);
normal gaps correlate with the host's load.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from math import inf, nan
from typing import Any

import numpy as np

from hapticd.core.arrays import Flags, Floats, Integers
from hapticd.core.units import percent
from hapticd.signal.assess import Criteria, LoopModel, MeasuredTrial, assess
from hapticd.signal.findings import ESCAPE_RATIO, Finding, outgrows_walk
from hapticd.signal.spectra import DEFAULT_LAG, Spectra, SpectralStream
from hapticd.signal.verdict import LEAST_FREEDOM, needed
from hapticd.zwidth.store import LOSSES_BY, EndReason, TrialEnd, TrialRecord

__all__ = ["CENTRING_N_PER_M", "Watch"]

BRIDGED = 40  # samples at most: 10 ms
MOST_LOST = 0.01  # share of samples or slots above which nothing is decided
# names in the run's summary
COUNTS = ("lost_samples", "samples", "lost_slots", "slots", "limited_ticks", "ticks")
REMEDY_OF_FILES = {
    "counter": "rows are missing by the counter in the file, record again without gaps",
    "times": "rows are missing by the times in the file, record again without gaps",
}
REMEDY = "close other programs on this computer, see `hapticd doctor`"
CALM_SECONDS = 4  # minimum seconds for a calm reference
SATURATED_SHARE = 0.01
AT_LIMIT = 1e-9  # of a limit, below which it counts as reached
# unexplained over explained power, times limit over perturbation: stable displays have 2 at most,
# escapes 40
OWN = 4.0
LOOK_S = 5.0  # between verdicts
CENTRING_N_PER_M = (
    20.0  # a stiffness that holds a free display against the paper's noise within a few millimetres
)


class GapFiller:
    """Put blocks of numbered samples into even time; one instance per stream."""

    def __init__(self) -> None:
        self._last: tuple[int, Floats] | None = None  # number and values of the last sample

    def filled(self, index: Integers, values: Floats) -> tuple[Floats, Flags]:
        """Return `values` (channels, n) of the samples numbered `index` (n,), with the missing ones
        between them and since the previous block filled, and which are measured (m,). A number that
        falls restarts the numbering.
        """
        whole = index.astype(np.int64)
        known = values
        if self._last is not None and self._last[0] < whole[0]:
            whole = np.concatenate(([self._last[0]], whole))
            known = np.column_stack((self._last[1], known))
        skip = whole.size - index.size
        self._last = int(index[-1]), values[:, -1]
        place = whole - whole[0]
        at = np.arange(place[-1] + 1)
        came = np.isin(at, place)
        silent = np.repeat(np.diff(place) > BRIDGED + 1, np.diff(place))
        full = np.stack([np.interp(at, place, channel) for channel in known])
        full[:, 1:][:, silent & ~came[1:]] = 0.0
        return full[:, skip:], came[skip:]


def in_even_time(recorded: TrialRecord, place: Integers) -> TrialRecord:
    """Return `recorded`, its samples those at `place` (n,), missing ones filled and counted."""
    (force, velocity), came = GapFiller().filled(
        place, np.stack((recorded.force_n, recorded.velocity_m_per_s))
    )
    lost = {"lost_samples": int((~came).sum()), "samples": came.size}
    return replace(
        recorded, force_n=force, velocity_m_per_s=velocity, more={**recorded.more, **lost}
    )


def loss_findings(counts: Mapping[str, Any]) -> Iterator[Finding]:
    """Yield lost samples and slots from `counts` (`COUNTS`, the known ones), each with value, share
    and remedy; or the fact that losses are unknown.
    """
    if counts.get(LOSSES_BY) == "nothing":
        yield Finding(
            "losses_unknown",
            "lost rows were not looked for: neither times nor a counter of samples show them; name"
            " the counter's column with --counter",
        )
        return
    remedy = REMEDY if "slots" in counts else REMEDY_OF_FILES[counts.get(LOSSES_BY, "times")]
    if "alignment" in counts:
        remedy = "rows are missing in the file, record again without gaps"
    filled = "they were filled in, and lower the coherence"
    stood = "the command before them stood longer than asked"
    better = f"{remedy}; h_force reads |Z| better than spa"
    yield from _lost(counts, "samples", f"samples of the probe lost: {{}}; {filled}", better)
    yield from _lost(counts, "slots", f"slots of the servo lost: {{}}; {stood}", REMEDY)


def _lost(counts: Mapping[str, Any], name: str, words: str, remedy: str) -> Iterator[Finding]:
    if lost := counts.get(f"lost_{name}"):
        share = lost / counts[name]
        void = f"; above {100 * MOST_LOST:g} % nothing is decided" if share > MOST_LOST else ""
        said = words.format(f"{lost} of {counts[name]}, {percent(share)}")
        yield Finding(f"lost_{name}", f"{said}{void}: {remedy}", voids=share > MOST_LOST)


def limit_findings(counts: Mapping[str, Any]) -> Iterator[Finding]:
    """Yield the ticks of a simulated trial with the amplifier at a limit, from `counts`."""
    if limited := counts.get("limited_ticks"):
        share = limited / counts["ticks"]
        void = share > SATURATED_SHARE
        more = f"; above {percent(SATURATED_SHARE)} nothing is decided" if void else ""
        yield Finding(
            "amplifier_limited",
            f"amplifier at its limit of current or voltage in {percent(share)} of the ticks, which"
            f" no prediction covers{more}; lower the perturbation, the stiffness or the active"
            " damping",
            voids=void,
        )


def summed(parts: list[Mapping[str, Any]]) -> dict[str, int]:
    """Sum the counts of several records; a count missing in one of them is omitted."""
    return {
        name: sum(part[name] for part in parts)
        for name in COUNTS
        if all(name in part for part in parts)
    }


@dataclass(frozen=True, slots=True)
class Watch:
    """The limits that end a trial, those of the channels; inf for none."""

    criteria: Criteria = field(default_factory=Criteria)
    model: LoopModel = field(default_factory=LoopModel)
    force_limit_n: float = inf
    velocity_limit_m_per_s: float = inf
    winding_limit_c: float = inf
    command_limit_n: float = inf  # of the force that the servo commands
    travel_m: tuple[float, float] = (-inf, inf)  # usable positions
    speed_limit_m_per_s: float = inf  # of the device: faster motion is impossible
    until_decided: bool = False
    random: bool = True  # the perturbation is noise


class TrialMonitor:
    """Fed with a record as it arrives; `ended` is the reason to end the trial, otherwise None."""

    def __init__(self, watch: Watch, rate_hz: float) -> None:
        self.ended: TrialEnd | None = None
        self.seconds_needed = (
            nan  # of a record like this one, for a decision; nan before there is a verdict
        )
        self.max_command_n = 0.0  # largest so far
        self._watch = watch
        self._rate_hz = rate_hz
        self._at_limit = False  # whether the command was, at the end of the previous second
        self._stream = SpectralStream(rate_hz)
        self._rms: list[tuple[float, float]] = []  # of force and velocity, a second each
        self._rest = np.empty((2, 0))  # force and velocity of less than a second
        self._next_look_s = LEAST_FREEDOM * 0.375 * DEFAULT_LAG / rate_hz + 1.0

    @property
    def seconds(self) -> float:
        """Whole seconds seen."""
        return self._stream.n_samples / self._rate_hz

    @property
    def outlook(self) -> str:
        """Description of the state of the recording."""
        if np.isnan(self.seconds_needed):
            return "recording"
        if self.seconds_needed <= self.seconds:
            return "recording; the verdict is final"
        return f"recording; {needed(self.seconds_needed, self.seconds)}"

    def see(
        self,
        force_n: Floats,
        velocity_m_per_s: Floats,
        winding_c: float = nan,
        command_n: float = 0.0,
        between_m: tuple[float, float] = (nan, nan),
    ) -> TrialEnd | None:
        """Check the next samples, both (n,); return the reason to end, or None. `command_n` is the
        largest command meanwhile, and `between_m` the range of positions.
        """
        self.max_command_n = max(self.max_command_n, command_n)
        self._rest = np.column_stack((self._rest, np.stack((force_n, velocity_m_per_s))))
        second = round(self._rate_hz)
        while self._rest.shape[1] >= second and not self.ended:
            force, velocity = self._rest[:, :second]
            self._rest = self._rest[:, second:]
            self._look_at(force, velocity)
        if not self.ended:
            self.ended = self._at_end(*between_m)
        if winding_c > self._watch.winding_limit_c:
            self.ended = TrialEnd(
                EndReason.HEAT,
                f"the winding is at {winding_c:.3g} degC, limit"
                f" {self._watch.winding_limit_c:g}; let it cool",
            )
        return self.ended

    def _at_end(self, least_m: float, most_m: float) -> TrialEnd | None:
        lower_m, upper_m = self._watch.travel_m
        if not (least_m < lower_m or most_m > upper_m):
            return None
        at_m = least_m if least_m < lower_m else most_m
        return TrialEnd(
            EndReason.TRAVEL,
            f"the device stands at {1e3 * at_m:.3g} mm, its travel ends at"
            f" {1e3 * lower_m:.3g} and {1e3 * upper_m:.3g} mm; centre it, and render a small"
            f" stiffness that holds it there (-K {CENTRING_N_PER_M:g})",
        )

    def _look_at(self, force: Floats, velocity: Floats) -> None:
        self._stream.add(force, velocity)
        pushed = float(np.std(force))
        rms = float(np.std(velocity))
        for name, signal, limit in (
            ("torque", force, self._watch.force_limit_n),
            ("velocity", velocity, self._watch.velocity_limit_m_per_s),
        ):
            share = float(np.mean(np.abs(signal) >= limit))
            if share > SATURATED_SHARE:
                self.ended = TrialEnd(
                    EndReason.SATURATION,
                    f"{name} at its end of {limit:.4g} in {percent(share)} of the"
                    " samples of a second",
                )
        if self._at_limit:
            self.ended = self._at_its_limit(pushed)
        self._at_limit = self.max_command_n >= self._watch.command_limit_n * (1.0 - AT_LIMIT)
        if rms > self._watch.speed_limit_m_per_s or self._ran_away(pushed, rms):
            self.ended = TrialEnd(
                EndReason.ESCAPE,
                f"velocity of {rms:.3g} m/s rms after {self.seconds:.0f} s; the loop is not"
                " stable there",
            )
        self._rms.append((pushed, rms))
        if not self.ended and self._watch.random and self.seconds >= self._next_look_s:
            self._next_look_s += LOOK_S
            self._decide()

    def _at_its_limit(self, pushed: float) -> TrialEnd:
        """Return the end for a command at its limit: of a loop that moves by itself, or of one
        driven too hard.
        """
        limit_n = self._watch.command_limit_n
        if self._watch.random and _own(self._stream.spectra()) * limit_n > OWN * pushed:
            return TrialEnd(
                EndReason.ESCAPE,
                f"the command reached its limit of {limit_n:.3g} N in a motion of its own;"
                " the loop is not stable there",
            )
        return TrialEnd(EndReason.SATURATION, f"the command reached its limit of {limit_n:.3g} N")

    def _ran_away(self, pushed: float, rms: float) -> bool:
        """Whether a second of that force and velocity ends an escape; a stronger force moves a
        stable device proportionally faster.
        """
        if len(self._rms) < CALM_SECONDS:
            return False
        seconds = np.array([*self._rms, (pushed, rms)])
        usual, calm = (float(value) for value in np.quantile(seconds[:-1], 0.25, axis=0))
        if not usual > 0.0:
            return False
        moved = seconds[:, 1] / np.maximum(1.0, seconds[:, 0] / usual)
        return bool(moved[-1] > ESCAPE_RATIO * calm) and outgrows_walk(moved)

    def _decide(self) -> None:
        watch = self._watch
        found = assess(MeasuredTrial(self._stream.spectra()), watch.criteria, watch.model)
        self.seconds_needed = found.verdict.seconds_needed
        final = found.verdict.answer != "undecided" and not found.needed.any()
        if watch.until_decided and final:
            self.ended = TrialEnd(
                EndReason.DECIDED, f"the verdict is final after {self.seconds:.0f} s"
            )


def _own(trial: Spectra) -> float:
    """Return the unexplained power of the velocity over the explained power."""
    explained = float((trial.velocity * trial.coherence).sum())
    return float(trial.velocity.sum()) / explained - 1.0 if explained > 0.0 else inf
