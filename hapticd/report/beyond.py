"""Figures of a run of `beyond` over frequency: the lower edge, free motion. Those over a corner or a level are in `beyond_axes`.

Colours and lines are those of `looks`; the envelope with negative virtual damping has its colour, forest. Bands are 95 % intervals
of the mean over seeds, by Student's t; the bracket at the foot spans the frequencies of the means in dB. A strip below an envelope
says which parameter of the lower edge's owner weighs most at that frequency: that of K/w, |B| and |M| w which is largest, its sign.
"""

from typing import TYPE_CHECKING, Any

import numpy as np

from hapticd.analysis.arrays import Floats
from hapticd.analysis.envelope import Edge
from hapticd.measure.beyond import BeyondResult
from hapticd.measure.beyond_display import shown_hz
from hapticd.measure.beyond_envelope import LOW_HZ, Bounds
from hapticd.measure.beyond_motion import Motion
from hapticd.measure.reproduce_trials import ADDED_NS_PER_M, MAIN
from hapticd.report import figures
from hapticd.report.looks import FOREST, OFF, ON, PARTS, PREDICTED, Look, averaged, of_mean
from hapticd.report.owners import NOTHING, patches, strip, weightiest
from hapticd.report.paper_style import WIDTH_IN

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

NEGATIVE: Look = {"color": FOREST, "linestyle": "-", "linewidth": 1.6}
WITH_MASS: Look = {"color": figures.PURPLE, "linestyle": "-", "linewidth": 2.2}  # B < 0 and M < 0
CASES = (
    ("off", OFF, "no added damping"),
    ("on", ON, f"{ADDED_NS_PER_M:g} N s/m added, B ≥ 0"),
    ("on_negative_B", NEGATIVE, f"{ADDED_NS_PER_M:g} N s/m added, any B"),
)


def edge_figure(result: BeyondResult) -> "Figure":
    """Envelopes undamped, damped and with B < 0: by the paper's rule, and without counting on friction."""
    ratios = {"height_ratios": [3.4, 0.3, 0.3, 0.3]}
    figure, grid = figures.axes(4, 2, WIDTH_IN, 5.9, sharex=True, sharey="row", gridspec_kw=ratios)
    kinds = (("", "passive at the perturbation of the trials"), ("_safe", "passive without counting on dry friction"))
    for column, (kind, words) in enumerate(kinds):
        bounds = [result.envelopes[f"{name}{kind}"] for name, _, _ in CASES]
        _edges(grid[column], bounds, words, len(result.plan.seeds))
        for row, (found, (_, _, label)) in enumerate(zip(bounds, CASES, strict=True)):
            _strip(grid[2 * (row + 1) + column], found, f"{label}: {found.lower_db().mean():+.1f} dB")
    for axis in grid[-2:]:
        figures.hertz_axis(axis, *_ends())
    grid[0].set_ylabel("|Z| at the probe (N s/m)")
    figures.plain_axis(grid[0].yaxis)
    grid[0].set_ylim(None, 300.0)
    for axis in grid[:2]:
        averaged(axis, LOW_HZ)
    grid[1].legend(*_keys(result), loc="upper center", fontsize=8)
    low, high = LOW_HZ
    figure.legend(
        handles=patches(PARTS, NOTHING), fontsize=8, ncols=6, loc="outside lower center", frameon=False, title_fontsize=8,
        title=f"strips: owner of the lower edge, weightiest part; its mean over {low:g}-{high:g} Hz (bracket), dB re 1 N s/m",
    )  # fmt: skip
    figure.suptitle(
        f"Negative virtual damping and the lower edge of the Z-width\n{made_how(result)}", x=0.01, ha="left", fontsize=10
    )
    return figure


def _keys(result: BeyondResult) -> Any:
    from matplotlib.lines import Line2D

    handles = [Line2D([], [], **look) for _, look, _ in CASES]
    words = [label for _, _, label in CASES]
    if result.plan.seeds:
        handles.append(Line2D([], [], **PREDICTED))
        words.append("lower edge, predicted")
    return handles, words


def _edges(axis: "Axes", bounds: list[Bounds], words: str, seeds: int) -> None:
    axis.set_yscale("log")
    for found, (_, look, _) in zip(bounds, CASES, strict=True):
        for edge, width in ((found.lower, 1.8), (found.upper, 0.8)):
            _line(axis, found.frequency_hz, edge, {**look, "linewidth": width}, seeds)
        if found.flown:
            axis.plot(found.frequency_hz, found.predicted_lower, **{**PREDICTED, "color": look["color"]})
    axis.set_title(words, fontsize=9, loc="left")


def _line(axis: "Axes", frequency_hz: Floats, edge: Edge, look: Look, seeds: int) -> None:
    spread = np.exp(of_mean(seeds) * edge.sd)
    axis.fill_between(frequency_hz, edge.value / spread, edge.value * spread, color=look["color"], alpha=0.28, linewidth=0)
    axis.plot(frequency_hz, edge.value, **look)


def _strip(axis: "Axes", found: Bounds, words: str) -> None:
    which = weightiest(found.frequency_hz, found.points[found.lower.owner])
    strip(axis, found.frequency_hz, [which], PARTS, NOTHING)
    axis.set_yticks([])
    axis.set_title(words, fontsize=7.5, loc="left", pad=2)


def free_figure(result: BeyondResult) -> "Figure":
    """|Z| of the device that renders no stiffness, for each way of making it lighter."""
    figure, (axis,) = figures.axes(1, 1, WIDTH_IN, 4.4)
    axis.set_yscale("log")
    for motion, look in zip(result.free.motions, (OFF, ON, NEGATIVE, WITH_MASS), strict=True):
        _motion(axis, motion, look)
    axis.plot([], [], label="predicted", **PREDICTED)
    axis.plot([], [], color=figures.BLACK, marker="|", markersize=7, linewidth=1.0, label=f"{_band()}: mean, dB re 1 N s/m")
    figures.hertz_axis(axis, *_ends())
    figures.plain_axis(axis.yaxis)
    averaged(axis, LOW_HZ)
    axis.set_ylabel("|Z| at the probe, K = 0 (N s/m)")
    figure.legend(*axis.get_legend_handles_labels(), loc="outside lower center", ncols=2, fontsize=8, frameon=False)
    axis.set_title(f"Free motion: passive for any input, friction not counted\n{made_how(result)}", loc="left")
    return figure


def _motion(axis: "Axes", motion: Motion, look: Look) -> None:
    added = f"{motion.level:g} N s/m added" if motion.level else "no added damping"
    rendered = f", B = {motion.damping:.2f} N s/m" if motion.damping else ""
    rendered += f", M = {1e3 * motion.mass_kg:.1f} g" if motion.mass_kg else ""
    label = f"{added}{rendered}: {motion.low_db().mean():.1f} dB"
    f = shown_hz()
    if not len(motion.runs):
        axis.plot(f, motion.predicted, label=label, **look)
        return
    logs = np.log(motion.runs)
    spread = logs.std(axis=0, ddof=1) if len(logs) > 1 else np.zeros(f.size)
    _line(axis, f, Edge(np.exp(logs.mean(axis=0)), spread, np.zeros(f.size, np.int64)), {**look, "label": label}, len(logs))
    axis.plot(f, motion.predicted, **{**PREDICTED, "color": look["color"]})


def _band() -> str:
    return f"{LOW_HZ[0]:g}-{LOW_HZ[1]:g} Hz"


def _ends() -> tuple[float, float]:
    f = shown_hz()
    return float(f[0]), float(f[-1])


def made_how(result: BeyondResult, trials: str = "") -> str:
    """Line below a title; `trials` says what of the figure is trials where not all of it is."""
    count = len(result.plan.seeds)
    return f"SIMULATED {MAIN}, {f'{trials}90 s of noise a trial, {count} seeds' if count else 'predicted'}"
