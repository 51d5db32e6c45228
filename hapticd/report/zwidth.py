"""Figures of trials: impedance or admittance with its interval, its coherence, and what was predicted."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from hapticd.analysis.arrays import Complexes, Flags, Floats
from hapticd.analysis.confidence import student_quantile
from hapticd.analysis.impedance import Impedance, relative_sd
from hapticd.analysis.periodic import PeriodicSpectra
from hapticd.measure.referee import Referee
from hapticd.measure.trial import TrialResult
from hapticd.report import figures
from hapticd.report.looks import INTERVAL, PREDICTED, Look, grey_patch, not_judged, of_levels
from hapticd.report.paper_style import SMALL_PT
from hapticd.report.zwidth_escape import escape_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PROBABILITY = 0.975  # each side of the bands that are drawn
FEWEST = 2.0  # degrees of freedom that an interval takes
SHOWN_HZ = (1.0, 1000.0)
TITLE_WIDTH = 95  # characters of a line


@dataclass(frozen=True)
class View:
    """What is drawn of an impedance: it or its inverse, whose logarithm and phase are the same with the other sign."""

    symbol: str
    unit: str
    sign: int

    def size(self, z: Complexes) -> Floats:
        """|Z| or |Y| (F,)."""
        return np.asarray(np.abs(z) ** self.sign)

    def phase(self, z: Complexes) -> Floats:
        """Phase [deg] (F,)."""
        return np.asarray(self.sign * np.degrees(np.angle(z)))


IMPEDANCE = View("Z", "N s/m", 1)
ADMITTANCE = View("Y", "m/(N s) = s/kg", -1)


def trial_figure(result: TrialResult, referee: Referee | None = None, admittance: bool = False) -> "Figure":
    """Size, phase and coherence of Z (or Y) of one trial, with the stepped sine's as points. ConfigError without matplotlib.

    Of a trial that escaped force and velocity.
    """
    view = ADMITTANCE if admittance else IMPEDANCE
    with figures.style():
        if result.recorded.ended.startswith("escape"):
            return escape_figure(result, _title(result, view).rsplit("\n", 1)[0])
        figure, (size, phase, known) = figures.axes(3, 1, 7.2, 8.4, sharex=True, height_ratios=(2.2, 2.2, 1.0))
        figure.suptitle(_title(result, view), fontsize=9.5, x=0.01, ha="left")
        look, z = of_levels([result.plan.params.trial.damping_ns_per_m])[0], result.measured
        seen = (z.frequency_hz >= SHOWN_HZ[0]) & (z.frequency_hz <= SHOWN_HZ[1]) & (z.coherence > 0.0)
        f, values, spread = z.frequency_hz[seen], z.impedance_ns_per_m[seen], _interval(z)[seen]
        size.set_ylabel(f"|{view.symbol}| ({view.unit})")
        phase.set_ylabel(f"phase of {view.symbol} (degrees)")
        plain_log(size)
        low, high = view.size(values) * np.exp(-spread), view.size(values) * np.exp(spread)
        _curve(size, f, view.size(values), (low, high), spread < 1.0, look)
        turn = np.degrees(spread)
        _curve(phase, f, view.phase(values), (view.phase(values) - turn, view.phase(values) + turn), spread < 1.0, look)
        if result.predicted is not None:
            _both(size, phase, view, f, result.predicted[seen], label="predicted", **PREDICTED)
        if referee is not None:
            point: Look = {"color": figures.BLACK, "linestyle": "", "marker": "D", "markersize": 4}
            _both(size, phase, view, referee.frequency_hz, referee.impedance_ns_per_m, **point, label="stepped sine")
        known.semilogx(f, z.coherence[seen], **look)
        known.set(ylabel="coherence", ylim=(0.0, 1.03))
        figures.hertz_axis(known, max(SHOWN_HZ[0], float(f[0])), min(SHOWN_HZ[1], float(f[-1])))
        _finish(result, (size, phase, known), view)
        figure.align_ylabels([size, phase, known])
        return figure


def plain_log(axis: "Axes") -> None:
    """A logarithmic value axis with plain numbers at 1, 2, 5."""
    from matplotlib.ticker import LogLocator, NullFormatter

    axis.set_yscale("log")
    axis.yaxis.set_major_locator(LogLocator(10.0, subs=(1.0, 2.0, 5.0)))
    axis.yaxis.set_major_formatter(lambda value, place: f"{value:g}")
    axis.yaxis.set_minor_formatter(NullFormatter())


def _interval(z: Impedance) -> Floats:
    """Half of the 95 % interval (F,) of ln|Z|, and of the phase in radians; Student's t, for realisations may be few."""
    freedom = z.degrees_of_freedom - 2.0
    if freedom < FEWEST:
        return np.full(z.frequency_hz.size, np.inf)
    return student_quantile(PROBABILITY, freedom) * relative_sd(z.coherence, freedom)


def _curve(axis: "Axes", f: Floats, value: Floats, ends: tuple[Floats, Floats], known: Flags, look: Look) -> None:
    name = f"{INTERVAL} at each frequency"
    axis.fill_between(f, *ends, where=known, color=look["color"], alpha=0.25, linewidth=0, label=name)
    axis.plot(f, value, label="measured", **look)


def _both(size: "Axes", phase: "Axes", view: View, f: Floats, z: Complexes, **look: Any) -> None:
    size.plot(f, view.size(z), **look)
    phase.plot(f, view.phase(z), **look)


def _finish(result: TrialResult, places: "tuple[Axes, Axes, Axes]", view: View) -> None:
    verdict, (_, phase, _) = result.verdict, places
    not_judged(places, verdict.band_hz)
    for edge in (-90.0, 90.0):
        phase.axhline(edge, color=figures.BLACK, linewidth=0.8)
    phase.set(ylim=(-125.0, 125.0), yticks=range(-90, 91, 45))
    worst = verdict.margin_deg
    at = int(np.argmin(np.abs(result.measured.frequency_hz - worst.frequency_hz)))
    phase.plot(
        worst.frequency_hz,
        view.phase(result.measured.impedance_ns_per_m[at : at + 1]),
        "o",
        color=figures.BLACK,
        label=f"worst: margin {worst.value:.2g} degrees",
    )
    handles, words = phase.get_legend_handles_labels()
    places[0].figure.legend(
        [*handles, grey_patch()], [*words, "not judged"], loc="outside lower center", ncols=3, fontsize=SMALL_PT, frameon=False
    )


def _title(result: TrialResult, view: View) -> str:
    k, b, m = result.plan.params.trial.environment
    verdict, simulated = result.verdict, "SIMULATED, " if result.recorded.simulated else ""
    low, high = verdict.band_hz
    who, level = f"{simulated}{result.recorded.origin}:", result.plan.params.trial.damping_ns_per_m
    what = f"K = {k:g} N/m, B = {b:g} N s/m, M = {1e3 * m:g} g, added damping {level:g} N s/m"
    judged = (
        f"{verdict.answer.replace('_', ' ')} in {low:g}..{high:g} Hz at {100 * verdict.confidence:g} %, "
        f"{view.symbol} at the {verdict.port} by {result.measured.estimator!r}, {_excited(result)}"
    )
    between = " " if len(who) + len(what) < TITLE_WIDTH else "\n"
    return f"{who}{between}{what}\n{judged}"


def _excited(result: TrialResult) -> str:
    if isinstance(result.spectra, PeriodicSpectra):
        return f"multisine: {result.spectra.realisations} realisations of {result.spectra.periods} periods"
    return f"{result.verdict.seconds:.3g} s of noise"
