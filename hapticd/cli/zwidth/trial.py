"""One trial: perturb, record, judge."""

from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hapticd.cli import options, output
from hapticd.cli.zwidth import common

if TYPE_CHECKING:
    from hapticd.measure.referee import Referee
    from hapticd.measure.sources import Source
    from hapticd.measure.trial import TrialResult

FROM = "engine: simulate; lockstep: the whole stack on virtual time; live: the daemon's probe stream; else a FILE with a record."


def command(
    source: Annotated[str, typer.Argument(metavar="engine|lockstep|live|FILE", help=FROM)] = "engine",
    scene: common.SceneName = "fig4",
    stiffness: Annotated[float | None, typer.Option("-K", "--stiffness", metavar="N/M", help="Virtual stiffness.")] = None,
    damping: Annotated[float | None, typer.Option("-B", "--damping", metavar="NS/M", help="Virtual damping.")] = None,
    mass: Annotated[float | None, typer.Option("-M", "--mass", metavar="KG", help="Virtual mass.")] = None,
    added: Annotated[float | None, typer.Option("--added-damping", metavar="NS/M", help="Electrical damping.", min=0)] = None,
    seconds: common.Seconds = 90.0,
    seed: common.Seed = 1,
    psd: Annotated[float | None, typer.Option("--psd", metavar="N2/HZ", help="Of the perturbation; else the scene's.")] = None,
    band: common.Band = (2.0, 500.0),
    confidence: common.Confidence = 0.95,
    estimator: Annotated[str, typer.Option("--estimator", metavar="spa|h_force", help="Input: velocity (paper) or force.")] = "spa",
    behind: Annotated[float, typer.Option("--behind-mass", metavar="KG", help="Mass of the probe to take out.", min=0)] = 0.0,
    sine: Annotated[bool, typer.Option("--stepped-sine", help="Also by single sines at 12 frequencies, as a referee.")] = False,
    until_decided: Annotated[bool, typer.Option("--until-decided", help="End when the verdict stands.")] = False,
    hottest: Annotated[float, typer.Option("--hottest", metavar="C", help="Winding temperature that ends the trial.")] = 100.0,
    force: Annotated[str, typer.Option("--force-column", metavar="NAME", help="Of FILE.")] = "",
    velocity: Annotated[str, typer.Option("--velocity-column", metavar="NAME", help="Of FILE.")] = "",
    rate_hz: Annotated[float | None, typer.Option("--rate-hz", metavar="HZ", help="Of FILE, where it does not say.")] = None,
    instance: options.Instance = options.INSTANCE,
    out: common.Out = None,
    plot: common.Plot = False,
    as_json: options.Json = False,
) -> None:
    """One trial of one environment: white noise at the probe, impedance by spectral analysis, passive or not.

    What is left out is the scene's: its K, B, M, electrical damping and perturbation. A FILE is .csv, .npz, .mat or .h5.
    """
    from dataclasses import replace

    from hapticd.measure import scenes
    from hapticd.measure.referee import stepped_sine
    from hapticd.measure.sentinel import Watch
    from hapticd.measure.sources import Trial
    from hapticd.measure.trial import TrialParams, plan_trial, run_trial

    if estimator not in ("spa", "h_force"):
        raise typer.BadParameter(f"--estimator {estimator!r}: use spa or h_force")
    if sine and source not in ("engine", "lockstep", "live"):
        raise typer.BadParameter("--stepped-sine: a record that exists cannot be perturbed again; use engine, lockstep or live")
    simulated = source in ("engine", "lockstep")
    loaded = common.scene_of(scene) if simulated else None
    given = scenes.point(loaded) if loaded else (0.0, 0.0, 0.0)
    point = [own if own is not None else default for own, default in zip((stiffness, damping, mass), given, strict=True)]
    noise = scenes.noise(loaded) if loaded else Trial().excitation
    noise = replace(noise, seed=seed, psd_n2_per_hz=psd or noise.psd_n2_per_hz)
    level = added if added is not None else scenes.level(loaded) if loaded else 0.0
    watch = Watch(until_decided=until_decided, winding_limit_c=hottest)
    trial = Trial((point[0], point[1], point[2]), level, seconds, noise, watch)
    plan = plan_trial(TrialParams(trial, loaded, band, confidence, "h_force" if estimator == "h_force" else "spa", behind))
    with ExitStack() as stack, common.progress() as tell:
        recorder = _source(source, scene, loaded, instance, (force, velocity, rate_hz), stack)
        result = run_trial(plan, recorder, tell)
        referee = stepped_sine(trial, recorder, tell) if sine else None
    _show(result, referee, common.folder(out, "trial"), plot, as_json)


def _source(
    name: str, scene: str, loaded: Any, instance: str, columns: tuple[str, str, float | None], stack: ExitStack
) -> "Source":
    from hapticd.measure.sources import bench_source, engine_source, file_source

    if name == "engine":
        return engine_source(loaded)
    if name == "lockstep":
        from hapticd.assembly.scene import scene_params
        from hapticd.measure.lockstep_bench import LockStepBench

        return bench_source(stack.enter_context(LockStepBench(*scene_params(scene))), f"lock-step, scene {loaded.name}")
    if name == "live":
        from hapticd.cli.change import connect

        return bench_source(stack.enter_context(connect(instance)), f"daemon {instance!r}")
    from hapticd.measure.recorded import read_file

    return file_source(read_file(Path(name), *columns))


def _show(result: "TrialResult", referee: "Referee | None", folder: Path, plot: bool, as_json: bool) -> None:
    from hapticd.measure.plain import plain
    from hapticd.measure.trial_run import summary, write

    write(folder, result, common.told(), referee)
    paths = _draw(result, referee, folder) if plot else []
    if as_json:
        output.data_json(
            {"ok": True, **plain(summary(result, referee)), "folder": str(folder), "figures": [str(path) for path in paths]}
        )
        return
    k, b, m = result.plan.params.trial.environment
    who = "SIMULATED " if result.recorded.simulated else ""
    output.data(
        f"{who}{result.recorded.origin}: K {k:g} N/m, B {b:g} N s/m, M {m:g} kg, "
        f"added damping {result.plan.params.trial.damping_ns_per_m:g} N s/m"
    )
    output.data(str(result.verdict))
    if result.recorded.ended:
        output.data(f"ended early: {result.recorded.ended}")
    if result.verdict.answer == "undecided":
        output.data(f"a record like it of {result.verdict.seconds_needed:.0f} s would decide at this confidence")
    if referee is not None:
        output.data(_compared(result, referee))
    output.data(f"kept in {folder}")
    for path in paths:
        output.data(str(path))


def _compared(result: "TrialResult", referee: "Referee") -> str:
    import numpy as np

    from hapticd.report.table import table, text

    rows = []
    for f, sine in zip(referee.frequency_hz, referee.impedance_ns_per_m, strict=True):
        noise = result.measured.impedance_ns_per_m[int(np.argmin(np.abs(result.measured.frequency_hz - f)))]
        rows.append((float(f), *(part(z) for part in (abs, lambda z: float(np.degrees(np.angle(z)))) for z in (sine, noise))))
    columns = ("Hz", "sine |Z| N s/m", "noise |Z|", "sine phase deg", "noise phase")
    return text(table(columns, rows, f"stepped sine of {referee.force_n:g} N rms beside the noise"))


def _draw(result: "TrialResult", referee: "Referee | None", folder: Path) -> list[Path]:
    from hapticd.report import figures
    from hapticd.report.zwidth import trial_figure

    return list(figures.save(trial_figure(result, referee), folder, "trial"))
