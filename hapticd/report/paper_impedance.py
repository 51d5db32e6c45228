"""Figs. 4 and 7: |Z| and phase of single trials, beside what was predicted for them; and the axes that all impedances share."""

from typing import TYPE_CHECKING, Any

import numpy as np

from hapticd.analysis.linearise import Perturbation
from hapticd.analysis.predict import predicted_impedance
from hapticd.measure.reproduce import ReproduceResult, Single
from hapticd.measure.reproduce_read import MIDDLE_HZ, compared
from hapticd.measure.reproduce_trials import MAIN, subject
from hapticd.report import figures
from hapticd.report.looks import INTERVAL, PREDICTED, averaged, not_judged
from hapticd.report.paper_style import LOOKS, SMALL_PT, WIDTH_IN, WORDS, simulated

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SHOWN_HZ = (2.0, 1000.0)
TRUSTED_HZ = (2.0, 500.0)


def single_figure(result: ReproduceResult, places: tuple[int, ...], title: str) -> "Figure":
    """|Z| and phase of single trials of the first seed; of two, the phase that the second gains over the first."""
    figure, (size, phase) = figures.axes(2, 1, WIDTH_IN, 5.8, sharex=True, gridspec_kw={"height_ratios": [3.0, 2.4]})
    shown = [result.singles[MAIN][place] for place in places]
    for single in shown:
        _single(size, phase, single, LOOKS[single.level > 0.0], WORDS[single.level > 0.0])
    if any(single.shown for single in shown):
        size.plot([], [], label="predicted", **PREDICTED)
    if len(shown) == 2:
        _advantage(phase, float(compared(shown[0], shown[1], MAIN).mean(axis=0)[1]))
    dressed(size, phase, title, result)
    _finely(size)
    handles, words = size.get_legend_handles_labels()
    if any(single.shown for single in shown):
        handles, words = [*handles, interval_patch(LOOKS[shown[-1].level > 0.0])], [*words, INTERVAL]
    size.legend(handles, words, loc="upper left", fontsize=SMALL_PT)
    return figure


def _single(size: "Axes", phase: "Axes", single: Single, look: dict[str, Any], words: str) -> None:
    device, f, shown = subject(MAIN), np.geomspace(*SHOWN_HZ, 400), single.shown
    z = predicted_impedance(device.model, single.point, f, single.level, device.filters, Perturbation())
    if shown is None:
        size.plot(f, np.abs(z), label=f"{words}, predicted", **look)
        phase.plot(f, np.degrees(np.angle(z)), **look)
        return
    inside = shown.frequency_hz >= SHOWN_HZ[0] - 0.1
    at, spread = shown.frequency_hz[inside], figures.INTERVAL * shown.relative_sd[inside]
    absolute, angle = np.abs(shown.impedance_ns_per_m)[inside], shown.phase_deg[inside]
    band: dict[str, Any] = {"color": look["color"], "alpha": 0.3, "linewidth": 0}
    size.fill_between(at, absolute * np.exp(-spread), absolute * np.exp(spread), **band)
    size.plot(at, absolute, label=words, **look)
    size.plot(f, np.abs(z), **PREDICTED)
    phase.fill_between(at, angle - np.degrees(spread), angle + np.degrees(spread), **band)
    phase.plot(at, angle, **look)
    phase.plot(f, np.degrees(np.angle(z)), **PREDICTED)


def _advantage(phase: "Axes", degrees: float) -> None:
    averaged(phase, MIDDLE_HZ, 0.14)
    middle = float(np.sqrt(MIDDLE_HZ[0] * MIDDLE_HZ[1]))
    words = f"{degrees:.0f} degrees\nfarther\nfrom +90"
    phase.text(middle, -45.0, words, fontsize=SMALL_PT, ha="center", va="center")


def _finely(axis: "Axes") -> None:
    """Ticks at 1, 2 and 5 of each decade."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    axis.yaxis.set_major_locator(LogLocator(10.0, subs=(1.0, 2.0, 5.0)))
    axis.yaxis.set_major_formatter(FuncFormatter(lambda value, place: f"{value:g}"))
    axis.yaxis.set_minor_locator(NullLocator())


def interval_patch(look: dict[str, Any]) -> Any:
    """The mark of an interval in a legend."""
    from matplotlib.patches import Patch

    return Patch(color=look["color"], alpha=0.35, linewidth=0)


def dressed(size: "Axes", phase: "Axes", title: str, result: ReproduceResult) -> None:
    """Labels, ranges, the passive range of phases, what is not judged."""
    size.set_yscale("log")
    size.yaxis.set_major_formatter(lambda value, place: f"{value:g}")
    size.set_ylabel("|Z| at the probe (N s/m)")
    size.set_title(f"{title}\n{simulated(MAIN, len(result.plan.seeds))}", loc="left")
    figures.hertz_axis(phase, *SHOWN_HZ)
    phase.set(xlabel="frequency (Hz)", ylabel="phase of Z (degrees)", ylim=(-105, 105), yticks=range(-90, 91, 45))
    for limit in (-90, 90):
        phase.axhline(limit, color=figures.BLACK, linewidth=0.8)
    not_judged((size, phase), TRUSTED_HZ)
    middle = float(np.sqrt(TRUSTED_HZ[1] * SHOWN_HZ[1]))
    phase.text(middle, -45, "not\njudged", fontsize=SMALL_PT, color="#444444", ha="center", va="center")
