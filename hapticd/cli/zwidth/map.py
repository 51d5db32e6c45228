"""A grid of K, B and M: which environments are passive, and the envelope over them."""

from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hapticd.cli import terminal
from hapticd.cli.terminal import progress
from hapticd.cli.zwidth import common

if TYPE_CHECKING:
    from hapticd.analysis.arrays import Floats
    from hapticd.measure.campaign import LevelMap, MapResult
    from hapticd.measure.outcomes import Conditions, Outcome

REDRAW_S = 5.0


def command(
    scene: common.SceneName = "fig4",
    damping: common.Damping = "0,1.74",
    stiffness: Annotated[
        common.Range, typer.Option("--stiffness", metavar="LOW HIGH N", help="Grid of K, N/m.")
    ] = (
        0.0,
        1400.0,
        15,
    ),
    viscous: Annotated[
        common.Range, typer.Option("--viscous", metavar="LOW HIGH N", help="Grid of B, N s/m.")
    ] = (0.0, 9.0, 10),
    mass: Annotated[
        common.Range, typer.Option("--mass", metavar="LOW HIGH N", help="Grid of M, kg.")
    ] = (-0.030, 0.024, 10),
    near: Annotated[
        float,
        typer.Option(
            "--near", help="Share about the predicted boundary that is tried.", min=0.0, max=0.9
        ),
    ] = 0.15,
    everywhere: Annotated[
        bool, typer.Option("--everywhere", help="Try every point, the paper's way.")
    ] = False,
    refine: Annotated[
        int,
        typer.Option(
            "--refine", metavar="N", help="Then halve the grid at the boundary.", min=0, max=1
        ),
    ] = 0,
    where: common.Where = "thread",
    seconds: common.Seconds = 90.0,
    seed: common.Seed = 1,
    band: common.Band = (2.0, 500.0),
    out: common.Out = None,
    plot: common.Plot = True,
    as_json: common.JsonOutcomes = False,
) -> None:
    """Map the passive set of a simulated display. Predicted first; trials where the prediction
    leaves doubt.

    Ctrl-C is safe: the same command with the same --out goes on where it ended. With --json each
    new outcome is a line, and the last line is the result; trials that --out had kept already are
    in its trials.jsonl.
    """
    import numpy as np

    from hapticd.measure.campaign import MapParams, plan_map, run_map
    from hapticd.measure.executors import executor
    from hapticd.measure.store import TrialStore, plain, write_run

    conditions = common.conditions(common.scene_of(scene), seconds, seed, band)
    axes: tuple[Floats, Floats, Floats] = (
        np.linspace(*common.ranged("--stiffness", stiffness)),
        np.linspace(*common.ranged("--viscous", viscous)),
        np.linspace(*common.ranged("--mass", mass)),
    )
    folder = common.folder(out, "map")
    store = TrialStore(folder / "trials.jsonl")
    redraw = _Redrawn(conditions, folder)

    def hear(new: "list[Outcome]") -> None:
        if as_json:
            common.follow(new)
        if plot:
            redraw(new)

    with common.keeping(store, folder), executor(where) as pool:
        plan = plan_map(
            MapParams(conditions, axes, common.levels(damping), near, everywhere, refine)
        )
        points = len(plan.levels) * axes[0].size * axes[1].size * axes[2].size
        terminal.talk(f"{points} points predicted, {plan.trials} to be tried")
        with progress() as tell:
            result = run_map(plan, store, tell, pool, hear)
    told = [_told(level) for level in result.levels]
    asked = {
        "seconds": seconds,
        "seed": seed,
        "band_hz": band,
        "near": near,
        "everywhere": everywhere,
        "refine": refine,
    }
    write_run(
        folder,
        {
            "kind": "map",
            "scene": scene,
            "axes": axes,
            "parameters": asked,
            "levels": told,
            "provenance": common.told(seed=seed),
        },
    )
    with common.drawing(folder):
        paths = draw_map(result, folder) if plot else []
    if as_json:
        names = [str(path) for path in paths]
        terminal.data_json(
            {
                "ok": True,
                "made": result.made,
                "levels": plain(told),
                "folder": str(folder),
                "figures": names,
            }
        )
        return
    _print(result, told)
    terminal.data(f"{result.made} trials made, kept in {folder}")
    for path in paths:
        terminal.data(str(path))


class _Redrawn:
    """Draws the envelope again as trials arrive, at most every few seconds."""

    def __init__(self, conditions: "Conditions", folder: Path) -> None:
        self._conditions = conditions
        self._folder = folder
        self._drawn_s = monotonic()
        self._passed: dict[float, list[Outcome]] = {}

    def __call__(self, new: "list[Outcome]") -> None:
        from hapticd.report import style
        from hapticd.report.envelope import envelope_figure

        for outcome in new:
            if outcome.passes:
                self._passed.setdefault(outcome.damping_ns_per_m, []).append(outcome)
        if self._passed and monotonic() - self._drawn_s > REDRAW_S:
            self._drawn_s = monotonic()
            style.save(
                envelope_figure(self._conditions, list(self._passed.items())),
                self._folder,
                "envelope_so_far",
            )


def _told(level: "LevelMap") -> dict[str, Any]:
    from hapticd.analysis.boundary import open_ends, set_limits, volume
    from hapticd.analysis.metrics import widths_db
    from hapticd.measure.outcomes import judged

    found: dict[str, Any] = {
        "judged": judged(level.outcomes),
        "added_damping_ns_per_m": level.damping_ns_per_m,
        "points": level.found.margin.size,
        "passive": int(level.found.passive.sum()),
        "tried": int(level.tried.sum()),
        "unlike_prediction": level.disagreements,
        "set_limits": set_limits(level.found) if level.found.passive.any() else None,
        "open_ends": open_ends(level.found),
        "volume": volume(level.found),
        "widths_db": widths_db(level.envelope) if level.envelope else (),
    }
    return found


def _print(result: "MapResult", told: list[dict[str, Any]]) -> None:
    from hapticd.report.table import table, text

    rows = []
    for level in told:
        limits = level["set_limits"]
        extremes = (
            (limits.stiffness[1], limits.damping[1], 1e3 * limits.mass[0])
            if limits
            else (float("nan"),) * 3
        )
        width = level["widths_db"][1].width_db if level["widths_db"] else float("nan")
        counts = (level[name] for name in ("points", "tried", "unlike_prediction", "passive"))
        rows.append((level["added_damping_ns_per_m"], *counts, *extremes, width))
    columns = (
        "added N s/m",
        "points",
        "tried",
        "unlike predicted",
        "passive",
        "K max N/m",
        "B max N s/m",
        "M min g",
        "width at 10-50 Hz dB",
    )
    terminal.data(
        text(
            table(
                columns,
                rows,
                f"SIMULATED {result.plan.params.conditions.scene.device}: the set on the grid",
            )
        )
    )
    terminal.data(result.judged.words)
    terminal.data(
        "unlike predicted: trials that came out otherwise; K max, B max, M min: extremes over the"
        " set, not alone on their axis"
    )
    for level in told:
        if level["open_ends"]:
            terminal.talk(
                f"at {level['added_damping_ns_per_m']:g} N s/m the set goes beyond the grid:"
                f" {', '.join(level['open_ends'])}"
            )


def draw_map(result: "MapResult", folder: Path) -> list[Path]:
    """The set, and the envelopes of impedance and admittance where a trial passed."""
    from hapticd.report import style
    from hapticd.report.envelope import envelope_figure
    from hapticd.report.passive_set import set_figure

    paths = [*style.save(set_figure(result), folder, "set")]
    drawn = [(level.damping_ns_per_m, level.outcomes) for level in result.levels if level.envelope]
    if drawn:
        paths += style.save(
            envelope_figure(result.plan.params.conditions, drawn), folder, "envelope"
        )
        paths += style.save(
            envelope_figure(result.plan.params.conditions, drawn, inverse=True),
            folder,
            "envelope_admittance",
        )
    return paths
