"""Figs. 3, 8 and 11: envelopes of |Z| and phase over all passive trials of the grid, and who owns them (`report.envelopes`)."""

from typing import TYPE_CHECKING

from hapticd.measure.reproduce import ReproduceResult
from hapticd.measure.reproduce_grid import CALMED, Found
from hapticd.measure.reproduce_trials import MAIN
from hapticd.report import figures
from hapticd.report.envelopes import Drawn, Guess, draw_edges, draw_strip, rendered
from hapticd.report.looks import INTERVAL
from hapticd.report.owners import NOTHING, patches
from hapticd.report.paper_impedance import SHOWN_HZ, dressed, interval_patch
from hapticd.report.paper_style import LOOKS, SMALL_PT, WIDTH_IN, WORDS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SIZE_RANGE = (0.08, 200.0)  # N s/m, the same for all that are compared


def envelope_figure(result: ReproduceResult, places: tuple[int, ...], title: str) -> "Figure":
    """|Z| and phase envelopes of damping levels, with the owners' strips."""
    strips = len(places)
    ratios = [3.0, *([0.36] * strips), 1.9]
    height = 6.3 + 0.4 * strips
    figure, grid = figures.axes(2 + strips, 1, WIDTH_IN, height, sharex=True, gridspec_kw={"height_ratios": ratios})
    size, phase = grid[0], grid[-1]
    size.set_yscale("log")
    figures.hertz_axis(phase, *SHOWN_HZ)
    shown = [drawn(result, place) for place in places]
    draw_edges(size, phase, shown)
    for below, one in zip(grid[1:-1], shown, strict=True):
        draw_strip(below, one)
    figure.legend(handles=patches(rendered(shown), NOTHING), fontsize=SMALL_PT, ncols=5, loc="outside lower center", frameon=False)
    if places == (1,):
        _peak(size, result.found[1])
    dressed(size, phase, title, result)
    size.set_ylim(*SIZE_RANGE)
    handles, words = size.get_legend_handles_labels()
    if any(result.found[place].flown for place in places):
        handles, words = [*handles, interval_patch(shown[-1].look)], [*words, f"{INTERVAL} of the owning trial"]
    size.legend(handles, words, loc="upper center", fontsize=SMALL_PT)
    return figure


def drawn(result: ReproduceResult, place: int) -> Drawn:
    """The envelope of one damping level, 0 or 1, with its prediction where it was made by trials."""
    found, predicted = result.found[place], result.predicted[MAIN][place]
    guess = _guess(predicted) if predicted is not None and found.flown else None
    return Drawn(found.envelope, found.environments, LOOKS[place], WORDS[place], guess, CALMED if found.flown else 1)


def _guess(found: Found) -> Guess:
    e = found.envelope
    return Guess(e.frequency_hz, (e.upper.value, e.lower.value), (e.phase_upper.value, e.phase_lower.value))


def _peak(axis: "Axes", found: Found) -> None:
    peak = found.peak()
    if peak is None:
        return
    axis.annotate(
        f"{peak.frequency_hz:.0f} Hz: M = {1e3 * peak.owner[2]:g} g\n(paper: near 100 Hz)",
        (peak.frequency_hz, peak.size_ns_per_m), (peak.frequency_hz, 2.6 * peak.size_ns_per_m),
        ha="center", fontsize=SMALL_PT, arrowprops={"arrowstyle": "-|>", "color": figures.BLACK, "linewidth": 0.8},
    )  # fmt: skip
