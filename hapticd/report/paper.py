"""The figures of the paper, drawn from a run of `reproduce`: Figs. 2, 3, 4, 7-11 and two of our own.

As in the paper added damping is a solid line and none a dashed one. Bands are 95 % of the estimate (the owner's, in an envelope);
dotted lines are predicted. Below an envelope a strip says which parameter of the owner weighs most at that frequency: that of
K/w, B and |M| w which is largest, and whether that M is negative.
"""

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from hapticd.analysis.arrays import Floats
from hapticd.analysis.envelope import Edge
from hapticd.analysis.linearise import Perturbation
from hapticd.analysis.predict import predicted_impedance
from hapticd.measure.reproduce import ReproduceResult, Single
from hapticd.measure.reproduce_grid import Found
from hapticd.measure.reproduce_trials import LEVELS, MAIN, subject
from hapticd.report import figures
from hapticd.report.paper_maps import edges_figure, limits_figure, set_figure, walls_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SHOWN_HZ = (2.0, 1000.0)
TRUSTED_HZ = (2.0, 500.0)
OFF: dict[str, Any] = {"color": figures.RED, "linestyle": (0, (4, 1.5))}
ON: dict[str, Any] = {"color": figures.BLUE, "linestyle": "-"}
PREDICTED: dict[str, Any] = {"color": figures.BLACK, "linestyle": (0, (1, 1.3)), "linewidth": 1.0}
WORDS = ("without added damping", "with 1.74 N s/m of added damping")
PARTS = (("K", figures.ORANGE), ("B", figures.GREEN), ("M > 0", figures.SKY), ("M < 0", figures.PURPLE))


def paper_figures(result: ReproduceResult) -> "Iterator[tuple[str, Figure]]":
    """(name, figure) one after the other; Fig. 2 only where walls were hit. ConfigError without matplotlib."""
    drawn: list[tuple[str, Callable[[], Figure]]] = [
        ("fig03", lambda: envelope_figure(result, (0,), "Fig. 3: Z-width without added damping")),
        ("fig04", lambda: single_figure(result, (0,), "Fig. 4: one trial, K = 100 N/m, B = 1 N s/m, M = 10 g")),
        ("fig07", lambda: single_figure(result, (1, 2), "Fig. 7: K = 50 N/m, B = 2 N s/m, M = 0")),
        ("fig08", lambda: envelope_figure(result, (1,), "Fig. 8: Z-width with 1.74 N s/m of added damping")),
        ("fig09", lambda: set_figure(result.found[0], "Fig. 9: passive environments without added damping")),
        ("fig10", lambda: set_figure(result.found[1], "Fig. 10: passive environments with 1.74 N s/m of added damping")),
        ("fig11", lambda: envelope_figure(result, (0, 1), "Fig. 11: both envelopes")),
        ("limits", lambda: limits_figure(result)),
        ("band_edge", lambda: edges_figure(result)),
    ]
    if result.walls:
        drawn.insert(0, ("fig02", lambda: walls_figure(result)))
    for name, draw in drawn:
        with figures.style():
            yield name, draw()


def envelope_figure(result: ReproduceResult, places: tuple[int, ...], title: str) -> "Figure":
    """|Z| and phase envelopes of damping levels, with the owners' strips."""
    strips = len(places)
    ratios = [3.0, *([0.3] * strips), 1.9]
    figure, grid = figures.axes(2 + strips, 1, 6.8, 6.4 + 0.3 * strips, sharex=True, gridspec_kw={"height_ratios": ratios})
    size, phase = grid[0], grid[-1]
    for place in places:
        found, look = result.found[place], (OFF, ON)[place]
        _band(size, found, found.envelope.upper, found.envelope.lower, look, WORDS[place], logarithmic=True)
        _band(phase, found, found.envelope.phase_upper, found.envelope.phase_lower, look, "", logarithmic=False)
        guess = result.predicted[MAIN][place]
        if guess is not None and found.flown:
            _predicted(size, phase, guess, last=place == places[-1])
    for place, strip in zip(places, grid[1:-1], strict=True):
        _strip(strip, result.found[place], WORDS[place] if strips > 1 else "")
    figure.legend(
        handles=_patches(), title="owner of the envelope, weightiest part", title_fontsize=8, fontsize=8, ncols=5,
        loc="outside lower center", frameon=False,
    )  # fmt: skip
    if places == (1,):
        _peak(size, result.found[1])
    _dressed(size, phase, title, result)
    return figure


def single_figure(result: ReproduceResult, places: tuple[int, ...], title: str) -> "Figure":
    """|Z| and phase of single trials."""
    figure, (size, phase) = figures.axes(2, 1, 6.8, 5.8, sharex=True, gridspec_kw={"height_ratios": [3.0, 2.4]})
    for place in places:
        single = result.singles[MAIN][place]
        _single(size, phase, single, (OFF, ON)[single.level > 0.0], WORDS[single.level > 0.0], last=place == places[-1])
    _dressed(size, phase, title, result)
    _finely(size)
    return figure


def _single(size: "Axes", phase: "Axes", single: Single, look: dict[str, Any], words: str, last: bool) -> None:
    device, f = subject(MAIN), np.geomspace(*SHOWN_HZ, 400)
    z = predicted_impedance(device.model, single.point, f, single.level, device.filters, Perturbation())
    shown = single.shown
    if shown is not None:
        inside = shown.frequency_hz >= SHOWN_HZ[0] - 0.1
        at, spread = shown.frequency_hz[inside], 1.96 * shown.relative_sd[inside]
        absolute, angle = np.abs(shown.impedance_ns_per_m)[inside], shown.phase_deg[inside]
        size.plot(at, absolute, label=words, **look)
        size.fill_between(at, absolute * np.exp(-spread), absolute * np.exp(spread), color=look["color"], alpha=0.25, linewidth=0)
        phase.plot(at, angle, **look)
        phase.fill_between(at, angle - np.degrees(spread), angle + np.degrees(spread), color=look["color"], alpha=0.25, linewidth=0)
    else:
        size.plot([], [], label=words, **look)
    style = PREDICTED if shown is not None else look
    size.plot(f, np.abs(z), label="predicted" if last and shown is not None else None, **style)
    phase.plot(f, np.degrees(np.angle(z)), **style)


def _band(axis: "Axes", found: Found, upper: Edge, lower: Edge, look: dict[str, Any], words: str, logarithmic: bool) -> None:
    f = found.envelope.frequency_hz
    axis.fill_between(f, lower.value, upper.value, color=look["color"], alpha=0.10, linewidth=0)
    for edge, label in ((upper, words), (lower, None)):
        spread = 1.96 * edge.sd
        ends = (
            (edge.value * np.exp(-spread), edge.value * np.exp(spread))
            if logarithmic
            else (edge.value - spread, edge.value + spread)
        )
        axis.fill_between(f, *ends, color=look["color"], alpha=0.30, linewidth=0)
        axis.plot(f, edge.value, label=label, **look)


def _predicted(size: "Axes", phase: "Axes", guess: Found, last: bool) -> None:
    e = guess.envelope
    for axis, edges in ((size, (e.upper, e.lower)), (phase, (e.phase_upper, e.phase_lower))):
        for edge in edges:
            axis.plot(e.frequency_hz, edge.value, **PREDICTED)
    if last:
        size.plot([], [], label="predicted", **PREDICTED)


def _strip(axis: "Axes", found: Found, words: str) -> None:
    """Which part of the owner weighs most, for the largest (upper row) and the smallest |Z|."""
    f = found.envelope.frequency_hz
    rows = [_weighty(f, found.owners(edge.owner)) for edge in (found.envelope.upper, found.envelope.lower)]
    edges = np.concatenate((f[:1], np.sqrt(f[1:] * f[:-1]), f[-1:]))
    from matplotlib.colors import ListedColormap

    colours = ListedColormap(["#f2f2f2", *(colour for _, colour in PARTS)])
    axis.pcolormesh(edges, [0.0, 1.0, 2.0], np.array(rows[::-1]), cmap=colours, vmin=-1.5, vmax=3.5, rasterized=True)
    axis.set_yticks([0.5, 1.5], ["min", "max"], fontsize=7)
    axis.grid(visible=False)
    axis.tick_params(length=0)
    if words:
        axis.set_title(f"owner {words}", fontsize=7.5, loc="left", pad=2)


def _patches() -> list[Any]:
    from matplotlib.patches import Patch

    return [Patch(color=colour, label=name) for name, colour in PARTS] + [Patch(color="#f2f2f2", label="none")]


def _weighty(frequency_hz: Floats, owners: Floats) -> Floats:
    """(F,) index into PARTS, -1 where nothing is rendered."""
    w = 2.0 * np.pi * frequency_hz
    parts = np.stack((owners[:, 0] / w, owners[:, 1], owners[:, 2] * w))
    which = np.abs(parts).argmax(axis=0).astype(float)
    which[(which == 2) & (owners[:, 2] < 0.0)] = 3
    which[~parts.any(axis=0)] = -1
    return np.asarray(which)


def _peak(axis: "Axes", found: Found) -> None:
    peak = found.peak()
    if peak is None:
        return
    at, size, owner = peak
    axis.annotate(
        f"{at:.0f} Hz: M = {1e3 * owner[2]:g} g\n(paper: near 100 Hz)", (at, size), (at, 3.2 * size),
        ha="center", fontsize=8.5, arrowprops={"arrowstyle": "-|>", "color": figures.BLACK, "linewidth": 0.8},
    )  # fmt: skip


def _finely(axis: "Axes") -> None:
    """Ticks at 1, 2 and 5 of each decade."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    axis.yaxis.set_major_locator(LogLocator(10.0, subs=(1.0, 2.0, 5.0)))
    axis.yaxis.set_major_formatter(FuncFormatter(lambda value, place: f"{value:g}"))
    axis.yaxis.set_minor_locator(NullLocator())


def _dressed(size: "Axes", phase: "Axes", title: str, result: ReproduceResult) -> None:
    size.set_xscale("log")
    size.set_yscale("log")
    size.set_xlim(*SHOWN_HZ)
    size.set_ylabel("|Z| at the probe (N s/m)")
    size.legend(loc="upper left" if title.startswith("Fig. 4") else "best")
    how = "predicted" if not result.plan.seeds else f"simulated, 90 s of noise a trial, {MAIN}"
    size.set_title(f"{title}\n{how}", loc="left")
    phase.set_ylabel("phase (degrees)")
    phase.set_xlabel("frequency (Hz)")
    phase.set_ylim(-105, 105)
    phase.set_yticks(range(-90, 91, 45))
    for limit in (-90, 90):
        phase.axhline(limit, color=figures.BLACK, linewidth=0.8)
    for axis in (size, phase):
        axis.axvspan(TRUSTED_HZ[1], SHOWN_HZ[1], color=figures.GREY, alpha=0.12, linewidth=0)
    middle = float(np.sqrt(TRUSTED_HZ[1] * SHOWN_HZ[1]))
    phase.text(middle, -45, "not\njudged", fontsize=7.5, color="#555555", ha="center")
    phase.set_xticks([2, 5, 10, 20, 50, 100, 200, 500, 1000], ["2", "5", "10", "20", "50", "100", "200", "500", "1000"])
    phase.minorticks_off()


__all__ = ["LEVELS", "envelope_figure", "paper_figures", "single_figure"]
