"""Figures of a run of `beyond` over frequency: the lower edge, free motion. Those over a corner or a level are in `beyond_axes`.

As in the figures of the paper added damping is solid blue and none dashed red; negative virtual damping is green. Bands are 95 % of
a trial, by the scatter between seeds; dotted lines are predicted. A strip below an envelope says which parameter of the
lower edge's owner weighs most at that frequency: that of K/w, |B| and |M| w which is largest, and its sign.
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
from hapticd.report.owners import patches, strip, weightiest
from hapticd.report.paper_style import OFF, ON, WIDTH_IN

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

NEGATIVE: dict[str, Any] = {"color": figures.GREEN, "linestyle": "-", "linewidth": 1.8}
LIGHTENED: dict[str, Any] = {"color": figures.PURPLE, "linestyle": (0, (6, 1.2, 1, 1.2))}
CASES = (
    ("off", OFF, "no added damping"),
    ("on", ON, f"{ADDED_NS_PER_M:g} N s/m added, B ≥ 0"),
    ("on_negative_B", NEGATIVE, f"{ADDED_NS_PER_M:g} N s/m added, any B"),
)
PARTS = (
    ("K", figures.ORANGE), ("B > 0", figures.BLUE), ("M > 0", figures.SKY), ("B < 0", figures.GREEN), ("M < 0", figures.PURPLE),
)  # fmt: skip
NOTHING = ("none", "#f2f2f2")


def edge_figure(result: BeyondResult) -> "Figure":
    """Envelopes undamped, damped and with B < 0: by the paper's rule, and without counting on friction."""
    ratios = {"height_ratios": [3.4, 0.3, 0.3, 0.3]}
    figure, grid = figures.axes(4, 2, WIDTH_IN, 5.9, sharex=True, sharey="row", gridspec_kw=ratios)
    kinds = (("", "passive at the perturbation of the trials"), ("_safe", "passive without counting on dry friction"))
    for column, (kind, words) in enumerate(kinds):
        bounds = [result.envelopes[f"{name}{kind}"] for name, _, _ in CASES]
        _edges(grid[column], bounds, words)
        for row, (found, (_, _, label)) in enumerate(zip(bounds, CASES, strict=True)):
            _strip(grid[2 * (row + 1) + column], found, f"{label}: {found.lower_db().mean():+.1f} dB")
    for axis in grid[-2:]:
        figures.hertz_axis(axis, *_ends())
        axis.set_xlabel("frequency (Hz)")
    grid[0].set_ylabel("|Z| at the probe (N s/m)")
    figures.plain_axis(grid[0].yaxis)
    grid[0].set_ylim(0.012, None)
    grid[0].legend(*_keys(result), loc="lower left", fontsize=8)
    low, high = LOW_HZ
    figure.legend(
        handles=patches(PARTS, NOTHING), fontsize=8, ncols=6, loc="outside lower center", frameon=False, title_fontsize=8,
        title=f"strips: owner of the lower edge, weightiest part; its mean over {low:g}-{high:g} Hz (grey), dB re 1 N s/m",
    )  # fmt: skip
    figure.suptitle(f"Negative virtual damping and the lower edge of the Z-width\n{_how(result)}", x=0.01, ha="left", fontsize=10)
    return figure


def _keys(result: BeyondResult) -> Any:
    from matplotlib.lines import Line2D

    handles = [Line2D([], [], **look) for _, look, _ in CASES]
    words = [label for _, _, label in CASES]
    if result.plan.seeds:
        handles.append(Line2D([], [], color=figures.BLACK, linestyle=(0, (1, 1.3)), linewidth=1.0))
        words.append("lower edge, predicted")
    return handles, words


def _edges(axis: "Axes", bounds: list[Bounds], words: str) -> None:
    axis.set_yscale("log")
    axis.axvspan(*LOW_HZ, color=figures.GREY, alpha=0.10, linewidth=0)
    for found, (_, look, _) in zip(bounds, CASES, strict=True):
        for edge, width in ((found.lower, 1.8), (found.upper, 0.8)):
            _line(axis, found.frequency_hz, edge, {**look, "linewidth": width})
        if found.flown:
            axis.plot(found.frequency_hz, found.predicted_lower, color=look["color"], linestyle=(0, (1, 1.3)), linewidth=1.0)
    axis.set_title(words, fontsize=9, loc="left")


def _line(axis: "Axes", frequency_hz: Floats, edge: Edge, look: dict[str, Any]) -> None:
    spread = np.exp(figures.INTERVAL * edge.sd)
    axis.fill_between(frequency_hz, edge.value / spread, edge.value * spread, color=look["color"], alpha=0.28, linewidth=0)
    axis.plot(frequency_hz, edge.value, **look)


def _strip(axis: "Axes", found: Bounds, words: str) -> None:
    which = weightiest(found.frequency_hz, found.points[found.lower.owner])
    strip(axis, found.frequency_hz, [which], PARTS, NOTHING)
    axis.set_yticks([])
    axis.set_title(words, fontsize=7.5, loc="left", pad=2)


def free_figure(result: BeyondResult) -> "Figure":
    """|Z| of the device that renders no stiffness, for each way of making it lighter."""
    figure, (axis,) = figures.axes(1, 1, WIDTH_IN, 4.0)
    axis.set_yscale("log")
    axis.axvspan(*LOW_HZ, color=figures.GREY, alpha=0.10, linewidth=0, label=f"{LOW_HZ[0]:g}-{LOW_HZ[1]:g} Hz: mean, dB re 1 N s/m")
    for motion, look in zip(result.free.motions, (OFF, ON, LIGHTENED, NEGATIVE), strict=True):
        _motion(axis, motion, look)
    axis.plot([], [], color=figures.BLACK, linestyle=(0, (1, 1.3)), linewidth=1.0, label="predicted")
    figures.hertz_axis(axis, *_ends())
    axis.set_xlabel("frequency (Hz)")
    figures.plain_axis(axis.yaxis)
    axis.set_ylabel("|Z| at the probe, K = 0 (N s/m)")
    axis.legend(loc="upper left", fontsize=8)
    axis.set_title(f"Free motion: passive for any input, friction not counted\n{_how(result)}", loc="left")
    return figure


def _motion(axis: "Axes", motion: Motion, look: dict[str, Any]) -> None:
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
    _line(axis, f, Edge(np.exp(logs.mean(axis=0)), spread, np.zeros(f.size, np.int64)), {**look, "label": label})
    axis.plot(f, motion.predicted, color=look["color"], linestyle=(0, (1, 1.3)), linewidth=1.0)


def _ends() -> tuple[float, float]:
    f = shown_hz()
    return float(f[0]), float(f[-1])


def _how(result: BeyondResult) -> str:
    count = len(result.plan.seeds)
    return f"SIMULATED {MAIN}, {f'90 s of noise a trial, {count} seeds' if count else 'predicted'}"
