"""Figures, comparison and export of kept results."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from hapticd.cli import terminal
from hapticd.cli.zwidth import common
from hapticd.cli.zwidth.map import draw_map
from hapticd.cli.zwidth.trial import draw_trial
from hapticd.core.errors import ConfigError

with terminal.deferred_imports():
    import numpy as np

    from hapticd.model import scene as model_scene
    from hapticd.recording import provenance as certificates
    from hapticd.signal import verdict
    from hapticd.zwidth import limits as axis_limits
    from hapticd.zwidth import map as maps
    from hapticd.zwidth import portable, simulated, sources, store
    from hapticd.zwidth import trial as trials
    from hapticd.zwidth.report import comparison, passive_set, style
    from hapticd.zwidth.report import paper as tables


What = Annotated[
    str,
    typer.Argument(
        metavar="DEVICE|RUN", help="A simulated device or scene, or the folder of a trial or a map."
    ),
]


@dataclass(frozen=True)
class DrawnReport:
    """Files written by a report, and the frequency range of the verdicts."""

    files: list[Path]
    judged: "verdict.Judged"


def report(
    what: What,
    active_damping: common.Damping = "0,1.74",
    seconds: common.Seconds = 90.0,
    seed: common.Seed = 1,
    out: common.Out = None,
    figure_width: terminal.FigureWidth = None,
    as_json: terminal.Json = False,
) -> None:
    """Draw all figures of a simulated device and write NAME.zwidth, its portable summary; or redraw
    those of a run folder, there or in --out.
    """
    terminal.need_figures(True)
    folder = Path(what)
    if (folder / "run.json").is_file():
        drawn = _of_run(folder, out or folder, figure_width)
    else:
        terminal.need_engine()
        drawn = _of_device(what, active_damping, seconds, seed, out, figure_width)
    files = [str(path) for path in drawn.files]
    found = {"files": files, "judged": store.to_json(drawn.judged)}
    terminal.show(found, [drawn.judged.words, *files], as_json)


def _named(what: str) -> "model_scene.Scene":
    """Return the scene of that name.

    ConfigError describes a folder without a run, and its possible uses.
    """
    try:
        return common.scene_of(what)
    except ConfigError:
        if not Path(what).is_dir():
            raise
        raise ConfigError(f"{what}: {_instead(Path(what))}") from None


def _instead(folder: Path) -> str:
    if (folder / "trials.jsonl").is_file():
        return (
            "an unfinished run, whose trials are kept; repeat the command that began it with"
            f" --out {folder} to finish and draw it"
        )
    return (
        "no run folder: it has no run.json; name a simulated device, a scene, or the folder of a"
        " trial or a map"
    )


def _of_run(folder: Path, out: Path, width_mm: float | None) -> DrawnReport:
    kept = store.read_summary(folder)
    if kept["kind"] == "trial":
        result = trials.kept_trial(folder, kept, _same_scene(kept))
        return DrawnReport(draw_trial(result, out, width_mm), result.verdict.judged)
    if kept["kind"] != "map":
        kind = f"a run of kind {kept['kind']!r}"
        raise ConfigError(
            f"{folder}: {kind} can only be redrawn by the command that made it (--out {folder});"
            " this verb redraws trials and maps"
        )
    found = maps.kept_map(
        maps.plan_map(_map_params(kept)), store.TrialStore(folder / "trials.jsonl")
    )
    return DrawnReport(draw_map(found, out, width_mm), found.judged)


def _same_scene(kept: dict[str, Any]) -> "model_scene.Scene | None":
    """Return the scene of the run, for its prediction, if it has not changed."""
    try:
        found = common.scene_of(kept["scene"]) if kept["scene"] else None
    except ConfigError:
        return None
    return found if found and store.fingerprint(found) == kept["scene_hash"] else None


def _map_params(kept: dict[str, Any]) -> "maps.MapParams":
    scene = common.scene_of(kept["scene"])
    asked = kept["parameters"]
    low, high = asked["band_hz"]
    conditions = common.conditions(scene, asked["seconds"], asked["seed"], (low, high))
    stiffness, damping, mass = (np.asarray(axis) for axis in kept["axes"])
    return maps.MapParams(
        conditions,
        (stiffness, damping, mass),
        tuple(level["active_damping_ns_per_m"] for level in kept["levels"]),
        asked["near"],
        asked["everywhere"],
        asked["refine"],
    )


def _of_device(
    what: str,
    active_damping: str,
    seconds: float,
    seed: int,
    out: Path | None,
    width_mm: float | None,
) -> DrawnReport:
    scene = _named(what)
    name = Path(scene.device).stem
    conditions = common.conditions(scene, seconds, seed)
    folder = common.folder(out, f"report-{name}")
    kept = store.TrialStore(folder / "trials.jsonl")
    params = axis_limits.LimitsParams(conditions, common.levels(active_damping))
    with common.keeping(kept, folder), terminal.progress() as tell:
        limits = axis_limits.run_limits(axis_limits.plan_limits(params), kept, tell)
        found = maps.run_map(maps.plan_map(maps.params_about(limits)), kept, tell)
    device_file = portable.device_path(what if what.endswith(".toml") else scene.device)
    _write(folder, name, device_file, limits, found)
    paths = _own_trial(scene, seconds, folder, width_mm)
    paths += style.save(passive_set.limits_figure(limits, width_mm), folder, "limits")
    paths += draw_map(found, folder, width_mm)
    return DrawnReport([*paths, folder / f"{name}{portable.SUFFIX}"], found.judged)


def _write(
    folder: Path,
    name: str,
    device_file: Path,
    limits: "axis_limits.LimitsResult",
    found: "maps.MapResult",
) -> None:
    """Write run.json and NAME.zwidth, the summary for `zwidth compare`."""
    conditions = limits.plan.params.conditions
    about = portable.conditions_of(conditions, found.judged)
    provenance = common.provenance_now(seed=conditions.excitation.seed)
    drawn = [(level.active_damping_ns_per_m, level.envelope) for level in found.levels]
    numbers = [portable.numbers_of(level, conditions.display) for level in found.levels]
    file_hash = portable.device_hash(str(device_file))
    certified = certificates.certificate_beside(device_file, file_hash)
    content = portable.portable(name, file_hash, drawn, limits.limits, about, numbers, certified)
    text = json.dumps({**content, "provenance": provenance}) + "\n"
    summary = {"kind": "report", "device": name, **about, "provenance": provenance}
    store.write_run(folder, summary, texts={f"{name}{portable.SUFFIX}": text})


def _own_trial(
    scene: "model_scene.Scene", seconds: float, folder: Path, width_mm: float | None
) -> list[Path]:
    """Draw a trial of the environment that the scene itself describes."""
    asked = sources.Trial(scene.environment.free, scene.level_ns_per_m, seconds, scene.noise)
    plan = trials.plan_trial(trials.TrialParams(asked, scene))
    return draw_trial(trials.run_trial(plan, simulated.engine_source(scene)), folder, width_mm)


Files = Annotated[
    list[Path],
    typer.Argument(
        metavar="A.zwidth B.zwidth ...", help="Summaries written by `hapticd zwidth report`."
    ),
]


def compare(
    files: Files,
    allow: Annotated[
        str,
        typer.Option(
            "--allow",
            metavar="NAME[,NAME...]",
            help="Conditions that may differ; the result lists them.",
        ),
    ] = "",
    out: common.Out = None,
    plot: common.Plot = True,
    figure_width: terminal.FigureWidth = None,
    as_json: terminal.Json = False,
) -> None:
    """Compare displays fairly: envelopes and limits as they are, and divided by the moving mass, so
    that a larger display has no advantage.

    Files of unlike conditions (band, judged frequencies, perturbation, length of a trial,
    confidence) are refused, with the unlike ones listed; --allow judged_hz,seconds compares them
    anyway, with a note.
    """
    found = portable.compare(files, [name for name in allow.split(",") if name])
    folder = common.folder(out, "compare")
    with common.drawing(folder):
        figure = comparison.comparison_figure(found, figure_width) if plot else None
        drawn = [str(path) for path in style.save(figure, folder, "compare")] if figure else []
    lines = [
        f"{display.name}: {verdict.Judged(*display.conditions.judged_hz).words}"
        for display in found.displays
    ]
    lines += [tables.text(one) for one in comparison.comparison_tables(found)]
    lines += [f"kept in {folder}", *drawn] if drawn else []
    terminal.show({**_comparison_json(found), "figures": drawn}, lines, as_json)


def _comparison_json(found: "portable.Comparison") -> dict[str, Any]:
    displays = [
        {
            "name": display.name,
            "conditions": store.to_json(display.conditions),
            "levels": [
                {
                    "active_damping_ns_per_m": one.active_damping_ns_per_m,
                    "limits": store.to_json(one.limits),
                    "numbers": store.to_json(dict(one.numbers)),
                }
                for one in display.levels
            ],
        }
        for display in found.displays
    ]
    return {"displays": displays, "unlike": list(found.unlike)}


def export(
    form: Annotated[
        Literal["npz", "mat", "csv"],
        typer.Argument(
            metavar="npz|mat|csv",
            help="Format: python-control, `frd` of MATLAB or Octave, or comma-separated values.",
        ),
    ],
    run: Annotated[
        Path, typer.Argument(metavar="RUN", callback=terminal.there, help="Folder of a trial.")
    ],
    out: Annotated[
        Path | None,
        typer.Argument(
            metavar="[OUT]",
            help="Output file (default: impedance-frd in the folder).",
            show_default=False,
        ),
    ] = None,
    as_json: terminal.Json = False,
) -> None:
    """Write the impedance of a trial with the interval of Re Z for python-control, MATLAB or a
    table: `hapticd zwidth export npz RUN`.

    The least Re Z of the band is the input feedforward passivity index that these tools compute.
    """
    kept = store.read_summary(run)
    if kept["kind"] != "trial":
        raise ConfigError(f"{run}: a run of kind {kept['kind']!r} has no impedance; name a trial's")
    target = out or run / f"impedance-frd.{form}"
    if target.exists():
        raise ConfigError(f"{target} exists; name another file")
    written = portable.write_response(trials.kept_trial(run, kept, None), target, form)
    terminal.show({"files": [str(written)]}, [str(written)], as_json)
