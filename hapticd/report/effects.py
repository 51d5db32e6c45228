"""Which effects a question needs, as a table, a figure with one bar for each effect, and a sentence."""

from math import inf, isnan
from typing import TYPE_CHECKING

from hapticd.measure.effects import EffectsResult, Left
from hapticd.measure.scenes import candidates
from hapticd.report import figures
from hapticd.report.table import Table, duration, percent, table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LEAST, MOST = 1e-4, 20.0  # ends of the axis of changes
TITLES = {"limits": "what its passivity limits need", "phase": "what the phase of Z needs", "peak": "what the peak of |Z| needs"}
TICKS = (1e-4, 1e-3, 1e-2, 0.1, 1.0, 10.0)


def effects_table(result: EffectsResult) -> Table:
    """The whole scene, every effect left out, and the proposal."""
    names = list(result.whole[0].numbers)
    rows = [_row("all effects", row, names) for row in result.whole]
    rows += [_row(f"without {row.effect}", row, names) for row in result.rows]
    rows.append(_row("proposal", result.proposal, names))
    return table(["scene", *names, "change", "method", "engine, per simulated s"], rows)


def effects_words(result: EffectsResult) -> str:
    """The proposal."""
    params, kept = result.plan.params, result.kept
    if all(isnan(number) for number in result.whole[0].numbers.values()):
        return f"Without any environment the scene is not passive already, so it has no {params.question}; ask --for phase."
    left_out = [key for key in candidates(params.scene) if key not in kept]
    if not left_out:
        return f"Every effect changes {params.question} by more than {percent(params.tolerance)}: keep them all."
    before, after = result.whole[1].cost_s, result.proposal.cost_s
    return (
        f"For {params.question} within {percent(params.tolerance)} keep {', '.join(kept) or 'none'}. Without {', '.join(left_out)} "
        f"the answer changes by {percent(result.proposal.change)} together, and a simulated second costs {duration(after)} instead "
        f"of {duration(before)}."
    )


def effects_figure(result: EffectsResult) -> "Figure":
    """Change of the answer, effect by effect. ConfigError without matplotlib."""
    params, rows = result.plan.params, result.rows[::-1]
    with figures.style():
        figure, (axis,) = figures.axes(1, 1, 8.5, 1.6 + 0.3 * len(rows))
        for place, row in enumerate(rows):
            shown = min(max(row.change, LEAST), MOST)
            keep = row.effect in result.kept
            axis.barh(place, shown, color=figures.BLUE if keep else "#c8d7e6", hatch="" if row.method == "predicted" else "///",
                      edgecolor="white", linewidth=0.0)  # fmt: skip
            axis.text(shown * 1.08, place, _told(row), va="center", fontsize=8.5)
        axis.axvline(params.tolerance, color=figures.RED)
        axis.text(
            params.tolerance * 1.05,
            len(rows) - 0.45,
            f"tolerance {percent(params.tolerance)}",
            color=figures.RED,
            va="bottom",
            fontsize=8.5,
        )
        axis.set(
            xscale="log", xlim=(LEAST, 4 * MOST), ylim=(-0.6, len(rows) + 0.2), xlabel=f"change of {params.question} when left out",
            yticks=range(len(rows)), yticklabels=[row.effect for row in rows],
        )  # fmt: skip
        axis.set_title(f"{params.scene.title}: {TITLES[params.question]}")
        axis.set_xticks(TICKS, [percent(tick) for tick in TICKS])
        axis.grid(visible=False, axis="y")
        _legend(axis)
    return figure


def _legend(axis: object) -> None:
    from matplotlib.axes import Axes
    from matplotlib.patches import Patch

    assert isinstance(axis, Axes)
    looks = (
        ("kept", figures.BLUE, ""),
        ("left out", "#c8d7e6", ""),
        ("by prediction", figures.GREY, ""),
        ("by simulation", figures.GREY, "///"),
    )
    handles = [Patch(facecolor=colour, hatch=hatch, edgecolor="white", linewidth=0.0, label=name) for name, colour, hatch in looks]
    axis.legend(handles=handles, loc="lower right")


def _told(row: Left) -> str:
    if row.note:
        return "cannot be left out"
    return "the answer is gone" if row.change == inf else percent(row.change)


def _row(name: str, row: Left, names: list[str]) -> list[str | float]:
    numbers: list[str | float] = [row.numbers.get(each, float("nan")) for each in names]
    change = row.note or percent(row.change)
    return [name, *numbers, change, row.method, duration(row.cost_s)]
