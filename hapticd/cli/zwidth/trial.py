"""One trial: perturb, record, judge."""

from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hapticd.cli import options, output
from hapticd.cli.progress import progress
from hapticd.cli.zwidth import common
from hapticd.cli.zwidth.trial_words import asked_for, compared, needed

if TYPE_CHECKING:
    from hapticd.analysis.impedance import Estimator
    from hapticd.measure.progress import Progress
    from hapticd.measure.referee import Referee
    from hapticd.measure.sources import Source
    from hapticd.measure.store import Recorded
    from hapticd.measure.trial import TrialPlan, TrialResult
    from hapticd.plant.scene import Scene

LIVE = ("engine", "lockstep", "live")
FROM = "engine: simulate; lockstep: the whole stack on virtual time; live: the daemon's device, ENABLED by this; else a FILE."
ENGINE_SCENE = "fig4"  # of engine and lockstep where none is named


def command(
    source: Annotated[str, typer.Argument(metavar="engine|lockstep|live|FILE", help=FROM)] = "engine",
    scene: Annotated[
        str, typer.Option("--scene", metavar="NAME|FILE", help="Device and environment; engine, lockstep: else fig4.")
    ] = "",
    stiffness: Annotated[float | None, typer.Option("-K", "--stiffness", metavar="N/M", help="Virtual stiffness.")] = None,
    viscous: Annotated[float | None, typer.Option("-B", "--viscous", metavar="NS/M", help="Virtual damping.")] = None,
    mass: Annotated[float | None, typer.Option("-M", "--mass", metavar="KG", help="Virtual mass.")] = None,
    damping: Annotated[float | None, typer.Option("--damping", metavar="NS/M", help="Electrical damping.", min=0)] = None,
    excitation: Annotated[str, typer.Option("--excitation", metavar="noise|multisine", help="Of the probe.")] = "noise",
    seconds: Annotated[float, typer.Option("--seconds", metavar="S", help="Length of a trial by noise.")] = 90.0,
    realisations: Annotated[int, typer.Option("--realisations", metavar="N", help="Multisines of other phases.", min=1)] = 8,
    periods: Annotated[int, typer.Option("--periods", metavar="N", help="Of each that count, after one to settle.", min=1)] = 2,
    seed: common.Seed = 1,
    psd: Annotated[
        float | None, typer.Option("--psd", metavar="N2/HZ", help="Of the perturbation; else the scene's.", min=0)
    ] = None,
    band: common.Band = (2.0, 500.0),
    confidence: common.Confidence = 0.95,
    estimator: Annotated[
        str, typer.Option("--estimator", metavar="spa|h_force", help="Input: velocity (paper, noise) or force (multisine).")
    ] = "",
    lag: Annotated[int, typer.Option("--lag", metavar="N", help="Window, samples (noise).", min=64)] = 2048,
    behind: Annotated[float, typer.Option("--behind-mass", metavar="KG", help="Mass of the probe to take out.", min=0)] = 0.0,
    sine: Annotated[bool, typer.Option("--stepped-sine", help="Also by single sines at 12 frequencies, as a referee.")] = False,
    until_decided: Annotated[bool, typer.Option("--until-decided", help="End when the verdict stands.")] = False,
    hottest: Annotated[float, typer.Option("--hottest", metavar="C", help="Winding temperature that ends the trial.")] = 100.0,
    force: Annotated[str, typer.Option("--force-column", metavar="NAME", help="Of FILE.")] = "",
    velocity: Annotated[str, typer.Option("--velocity-column", metavar="NAME", help="Of FILE.")] = "",
    rate_hz: Annotated[float | None, typer.Option("--rate-hz", metavar="HZ", help="Of FILE, where it does not say.")] = None,
    skew: Annotated[
        float, typer.Option("--skew", metavar="S", help="Known delay of the velocity channel behind the force, taken out.")
    ] = 0.0,
    high_pass: Annotated[
        float, typer.Option("--high-pass", metavar="HZ", help="Known corner of an AC-coupled velocity channel, taken out.", min=0)
    ] = 0.0,
    instance: options.Instance = options.INSTANCE,
    out: common.Out = None,
    plot: common.Plot = False,
    admittance: common.Admittance = False,
    as_json: options.Json = False,
) -> None:
    """One trial of one environment: the probe shakes, impedance by spectral analysis, passive or not.

    White noise and spectral analysis, the paper's way, or multisines (period 1.024 s): better for a device without friction, and
    with friction only as good as the number of realisations. Of K, B and M what is not given is that of the scene that --scene
    names, else 0; with none of the three given they are those of fig4, live without --scene they are 0, and of a record of
    hapticd's own what it says. Electrical damping and perturbation are the scene's unless given. `live` enables the daemon's
    device by itself, says so, shakes it, and disables it at the end and on Ctrl-C; give a K that holds it in its travel (-K 20).
    A FILE is .csv, .npz, .mat or .h5; one of multisines holds whole realisations, each with its settling period.
    """
    from dataclasses import replace

    from hapticd.measure import scenes
    from hapticd.measure.referee import may_follow, stepped_sine
    from hapticd.measure.sources import Trial, file_source, given
    from hapticd.measure.trial import Layout, TrialParams, multisine_like, plan_trial
    from hapticd.measure.watch import Watch

    _check(source, excitation, estimator, sine, until_decided)
    named = scene or (ENGINE_SCENE if source in ("engine", "lockstep") else "")
    loaded = common.scene_of(named) if named and source in LIVE else None
    recorded = None if source in LIVE else read(source, force, velocity, rate_hz)
    asked = given((stiffness, viscous, mass), damping, loaded, bool(scene), recorded)
    force_of = scenes.noise(loaded) if loaded else Trial().excitation
    force_of = replace(force_of, seed=seed, psd_n2_per_hz=force_of.psd_n2_per_hz if psd is None else psd)
    repeats = Layout(realisations, periods) if excitation == "multisine" else None
    watch = Watch(until_decided=until_decided, winding_limit_c=hottest)
    shaken = multisine_like(force_of, band[1]) if repeats else force_of
    trial = Trial(asked.environment, asked.damping_ns_per_m, seconds, shaken, watch)
    chosen: Estimator = "h_force" if estimator == "h_force" or (repeats and not estimator) else "spa"
    model = loaded if source != "live" else None
    params = TrialParams(
        trial, model, band, confidence, chosen, behind, lag=lag, multisine=repeats, skew_s=skew, high_pass_hz=high_pass
    )
    plan = plan_trial(params)
    with common.interruptible(), ExitStack() as stack:
        if source == "live":
            plan, recorder = _live(plan, loaded, instance, stack)
        else:
            output.talk(asked_for(source, trial, loaded, recorded))
            recorder = file_source(recorded) if recorded else _source(source, named, loaded, stack)
        tell = stack.enter_context(progress())
        result = _flown(plan, recorder, source in LIVE, tell)
        referee = stepped_sine(trial, recorder, tell) if sine and may_follow(result.recorded) else None
    _show(result, referee, common.folder(out, "trial"), plot or admittance, admittance, as_json)


def read(name: str, force: str, velocity: str, rate_hz: float | None) -> "Recorded":
    """The record in a file or run folder."""
    from hapticd.measure.recorded import read_file

    return read_file(Path(name), force, velocity, rate_hz)


def _check(source: str, excitation: str, estimator: str, sine: bool, until_decided: bool) -> None:
    if estimator not in ("", "spa", "h_force"):
        raise typer.BadParameter(f"--estimator {estimator!r}: use spa or h_force")
    if excitation not in ("noise", "multisine"):
        raise typer.BadParameter(f"--excitation {excitation!r}: use noise or multisine")
    if sine and source not in LIVE:
        raise typer.BadParameter("--stepped-sine: a record that exists cannot be perturbed again; use engine, lockstep or live")
    if until_decided and excitation == "multisine":
        raise typer.BadParameter("--until-decided: multisines are judged at their end; ask for fewer --realisations, or for noise")


def _flown(plan: "TrialPlan", recorder: "Source", flies: bool, tell: "Progress") -> "TrialResult":
    """A file of multisines is there already, realisation after realisation."""
    from hapticd.measure.trial import judged, run_trial

    return run_trial(plan, recorder, tell) if flies else judged(plan, recorder(plan.params.trial, tell))


def _live(plan: "TrialPlan", scene: "Scene | None", instance: str, stack: ExitStack) -> "tuple[TrialPlan, Source]":
    """The plan with the curve of the daemon's device, and the source. Whether the loop is stable is seen, not predicted."""
    from dataclasses import replace

    from hapticd.cli.zwidth.live import announce, rig
    from hapticd.measure.bench import bench_source
    from hapticd.measure.trial import plan_trial

    found = rig(instance, stack)
    announce(found, plan.params.trial, scene)
    return replace(plan_trial(replace(plan.params, scene=found.model)), spectral_radius=None), bench_source(
        found.client, found.origin
    )


def _source(name: str, scene: str, loaded: Any, stack: ExitStack) -> "Source":
    from hapticd.assembly.scene import scene_params
    from hapticd.measure.bench import bench_source
    from hapticd.measure.lockstep import LockStepBench
    from hapticd.measure.sources import engine_source

    if name == "engine":
        return engine_source(loaded)
    return bench_source(stack.enter_context(LockStepBench(*scene_params(scene))), f"lock-step, scene {loaded.name}")


def _show(result: "TrialResult", referee: "Referee | None", folder: Path, plot: bool, admittance: bool, as_json: bool) -> None:
    from hapticd.measure.store import plain
    from hapticd.measure.trial import summary, write

    write(folder, result, common.told(), referee)
    with common.drawing(folder):
        paths = draw(result, folder, referee, admittance) if plot else []
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
    output.data(f"the interval covers {result.covers}")
    if result.recorded.ended:
        output.data(f"ended early: {result.recorded.ended}")
    if result.verdict.answer == "undecided":
        output.data(needed(result))
    if referee is not None:
        output.data(compared(result, referee))
    common.kept(folder, paths)


def draw(result: "TrialResult", folder: Path, referee: "Referee | None" = None, admittance: bool = True) -> list[Path]:
    """The figure of the trial, and that of its admittance if asked."""
    from hapticd.report import style
    from hapticd.report.trial import trial_figure

    paths = [*style.save(trial_figure(result, referee), folder, "trial")]
    if admittance:
        paths += style.save(trial_figure(result, referee, admittance=True), folder, "trial_admittance")
    return paths
