"""Figure of the trials of a map: the largest and smallest passive |Z| (or |Y|) and phase, drawn as those of the paper are."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from hapticd.analysis.arrays import Floats
from hapticd.analysis.envelope import admittance
from hapticd.analysis.predict import frequencies
from hapticd.measure.outcomes import Conditions, Outcome, envelope_of, kept_frequencies
from hapticd.report import figures
from hapticd.report.envelopes import Drawn, Guess, draw_edges, draw_strip, guess_of, rendered
from hapticd.report.looks import INTERVAL, Look, grey_patch, not_judged, of_levels, words_of
from hapticd.report.owners import NOTHING, patches
from hapticd.report.paper_impedance import interval_patch
from hapticd.report.paper_style import SMALL_PT
from hapticd.report.zwidth import ADMITTANCE, IMPEDANCE, plain_log

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Levels = Sequence[tuple[float, Sequence[Outcome]]]
SHOWN_HZ = (2.0, 1000.0)


def envelope_figure(conditions: Conditions, levels: Levels, inverse: bool = False) -> "Figure":
    """Largest and smallest |Z| [N s/m] and phase [deg] of the trials that pass, a strip of owners for each level; dotted what is
    predicted of the same trials. AnalysisError for a level of which none passes.

    `levels`: (added damping [N s/m], its trials). `inverse`: of the admittance, whose largest values are owned by the smallest |Z|.
    """
    view, looks = ADMITTANCE if inverse else IMPEDANCE, of_levels([level for level, _ in levels])
    shown = [_drawn(conditions, *level, look, inverse) for level, look in zip(levels, looks, strict=True)]
    with figures.style():
        ratios = [3.0, *([0.36] * len(shown)), 1.9]
        figure, grid = figures.axes(2 + len(shown), 1, 8.0, 6.6 + 0.45 * len(shown), sharex=True, height_ratios=ratios)
        size, phase = grid[0], grid[-1]
        plain_log(size)
        figures.hertz_axis(phase, float(shown[0].envelope.frequency_hz[0]), float(shown[0].envelope.frequency_hz[-1]))
        draw_edges(size, phase, shown)
        for below, drawn in zip(grid[1:-1], shown, strict=True):
            draw_strip(below, drawn)
        not_judged((size, phase), conditions.band_hz)
        size.set_ylabel(f"|{view.symbol}| at the probe ({view.unit})")
        phase.set(ylabel=f"phase of {view.symbol} (degrees)", ylim=(-105, 105), yticks=range(-90, 91, 45))
        for edge in (-90.0, 90.0):
            phase.axhline(edge, color=figures.BLACK, linewidth=0.8)
        handles, words = size.get_legend_handles_labels()
        more = [interval_patch(shown[-1].look), grey_patch()]
        size.legend(
            [*handles, *more], [*words, f"{INTERVAL} of the owning trial", "not judged"], fontsize=SMALL_PT,
            loc="upper center" if not inverse else "lower center",
        )  # fmt: skip
        figure.legend(
            handles=patches(rendered(shown), NOTHING), fontsize=SMALL_PT, ncols=6, loc="outside lower center", frameon=False
        )
        what = "Z-width envelope as admittance" if inverse else "Z-width envelope"
        size.set_title(f"{what}\nSIMULATED {conditions.scene.device}, {conditions.seconds:g} s of noise a trial", loc="left")
        return figure


def _drawn(conditions: Conditions, level: float, trials: Sequence[Outcome], look: Look, inverse: bool) -> Drawn:
    passed = [trial for trial in trials if trial.passes]
    points = np.array([trial.environment for trial in passed]).reshape(-1, 3)
    found, guess = envelope_of(passed), _guess(conditions, level, points, inverse)
    return Drawn(admittance(found) if inverse else found, points, look, words_of(level), guess)


def _guess(conditions: Conditions, level: float, points: Floats, inverse: bool) -> Guess:
    """What is predicted of the same environments, where the figure shows it."""
    f = np.union1d(frequencies(conditions.band_hz, conditions.display.perturbation), kept_frequencies())
    z = conditions.display.impedances(points, level, f)
    inside = (f >= SHOWN_HZ[0]) & (f <= SHOWN_HZ[1])
    return guess_of(f[inside], 1.0 / z[:, inside] if inverse else z[:, inside])
