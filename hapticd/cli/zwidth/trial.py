"""`zwidth trial` and `zwidth import`: one trial, simulated, on a daemon's device, or from a file.

The options are three dataclasses: the trial and its criteria, the format of a file, and the
results. From them come the parameters of one trial (`hapticd.zwidth.trial`), which is run, kept,
drawn and printed. The action is announced before any simulation or motion. The output also states
how an undecided trial could be decided, and compares single sines with the noise.
"""

import sys
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass, replace
from math import ceil
from pathlib import Path
from typing import Annotated, Literal

import typer

from hapticd.cli import terminal
from hapticd.cli.zwidth import common

with terminal.deferred_imports():
    import numpy as np

    from hapticd.model import scene as model_scene
    from hapticd.run import lockstep
    from hapticd.signal import assess
    from hapticd.signal import verdict as verdicts
    from hapticd.zwidth import aligned, live, simulated, sources, store, watch
    from hapticd.zwidth import recorded as record_files
    from hapticd.zwidth import trial as trials
    from hapticd.zwidth.report import paper, style
    from hapticd.zwidth.report import trial as figures


LIVE = ("engine", "lockstep", "live")  # sources that can be perturbed; all others are files
MARKED = ("lockstep", "live")  # sources whose perturbation can begin with a mark
SOURCES = (
    "engine: simulate; lockstep: the whole stack on virtual time; live: the daemon's device,"
    " which this ENABLES and leaves with these K, B, M; otherwise a FILE."
)
STOPPED = 5  # exit code of a trial after which the device is stopped, or in fault
ENGINE_SCENE = "fig4"  # default of engine and lockstep
FILES = (
    ".csv, .npz, .mat or .h5 with force in N and velocity in m/s; a recording, its export, a run"
    " folder."
)
SceneOfTrial = Annotated[
    str,
    typer.Option(
        "--scene",
        metavar="NAME|FILE",
        help="Device and environment (default for engine and lockstep: fig4).",
    ),
]


@dataclass(frozen=True, kw_only=True)
class TrialOptions:
    """The trial: environment, perturbation, and criteria."""

    source: Annotated[str, typer.Argument(metavar="engine|lockstep|live|FILE", help=SOURCES)] = (
        "engine"
    )
    scene: SceneOfTrial = ""
    stiffness: common.VirtualStiffness = None
    viscous: common.VirtualDamping = None
    mass: common.VirtualMass = None
    active_damping: common.OneDamping = None
    excitation: Annotated[
        Literal["noise", "multisine"],
        typer.Option("--excitation", metavar="noise|multisine", help="Excitation of the probe."),
    ] = "noise"
    seconds: Annotated[
        float, typer.Option("--seconds", metavar="S", help="Length of a trial with noise.")
    ] = 90.0
    realisations: Annotated[
        int,
        typer.Option(
            "--realisations", metavar="N", help="Number of multisines with different phases.", min=1
        ),
    ] = 8
    periods: Annotated[
        int,
        typer.Option(
            "--periods",
            metavar="N",
            help="Measured periods per realisation, after one to settle.",
            min=1,
        ),
    ] = 2
    seed: common.Seed = 1
    psd: Annotated[
        float | None,
        typer.Option(
            "--psd",
            metavar="N2/HZ",
            help="Noise density of the perturbation; default: the scene's.",
            min=0,
        ),
    ] = None
    band: common.Band = (2.0, 500.0)
    confidence: common.Confidence = 0.95
    estimator: Annotated[
        Literal["spa", "h_force"] | None,
        typer.Option(
            "--estimator",
            metavar="spa|h_force",
            help="Input: velocity (paper, noise) or force (multisine).",
        ),
    ] = None
    lag: Annotated[
        int, typer.Option("--lag", metavar="N", help="Window, samples (noise).", min=64)
    ] = 2048
    behind: Annotated[
        float,
        typer.Option("--behind-mass", metavar="KG", help="Probe mass to subtract from Z.", min=0),
    ] = 0.0
    sine: Annotated[
        bool,
        typer.Option(
            "--stepped-sine",
            help="Also measure with single sines at 12 frequencies, as a cross-check.",
        ),
    ] = False
    until_decided: Annotated[
        bool,
        typer.Option("--until-decided", help="Stop as soon as the verdict is statistically clear."),
    ] = False
    mark: Annotated[
        bool,
        typer.Option(
            "--mark",
            help="Start with a marker by which `import --align` finds the trial; live, lockstep.",
        ),
    ] = False
    uncalibrated: Annotated[
        bool,
        typer.Option(
            "--uncalibrated",
            help="live: accept calibrations that are missing, old or of another board.",
        ),
    ] = False
    hottest: Annotated[
        float,
        typer.Option("--hottest", metavar="C", help="Winding temperature at which the trial ends."),
    ] = 100.0


@dataclass(frozen=True, kw_only=True)
class FileOptions:
    """Format of a file, and known facts of its channels."""

    force: Annotated[
        str, typer.Option("--force-column", metavar="NAME", help="Column of the force in FILE.")
    ] = ""
    velocity: Annotated[
        str,
        typer.Option("--velocity-column", metavar="NAME", help="Column of the velocity in FILE."),
    ] = ""
    rate_hz: Annotated[
        float | None,
        typer.Option(
            "--rate-hz", metavar="HZ", help="Sample rate of FILE, if the file does not contain it."
        ),
    ] = None
    counter: Annotated[
        str,
        typer.Option(
            "--counter",
            metavar="COLUMN",
            help="Column of FILE with a sample counter of up to 48 bits; it reveals lost rows.",
        ),
    ] = ""
    skew: Annotated[
        float | None,
        typer.Option(
            "--skew",
            metavar="S",
            help="Known delay of the velocity channel behind the force, to be corrected"
            " (default: that of the device file for a live trial, otherwise 0).",
        ),
    ] = None
    high_pass: Annotated[
        float,
        typer.Option(
            "--high-pass",
            metavar="HZ",
            help="Corner of an AC-coupled velocity channel, to correct for.",
            min=0,
        ),
    ] = 0.0

    @property
    def columns(self) -> tuple[str, str, float | None, str]:
        """Stated facts of the channels of FILE, in the order of its readers."""
        return self.force, self.velocity, self.rate_hz, self.counter


@dataclass(frozen=True, kw_only=True)
class TrialResultOptions:
    """Destination of results, and figures."""

    out: common.Out = None
    plot: common.Plot = False
    figure_width: terminal.FigureWidth = None
    as_json: terminal.Json = False


def trial(
    asked: TrialOptions,
    file: FileOptions,
    *,
    instance: terminal.Instance = terminal.INSTANCE,
    results: TrialResultOptions,
) -> None:
    """Run one trial of one environment: perturb the device, estimate its impedance, and judge
    whether it is passive.

    Excite with white noise, as the paper does, or with multisines (period 1.024 s): better for a
    device without friction, and with friction only as good as the number of realisations. Each of
    K, B and M that you omit comes from --scene, or is 0 without one. If you omit all three, engine
    and lockstep use fig4, live uses 0, and hapticd's own records use their own values. Active
    damping and perturbation default to the scene's. `live` enables the device of the daemon,
    announces it, drives it, and disables it at the end and on Ctrl-C; choose a K that keeps it
    within its travel (-K 20). A FILE is .csv, .npz, .mat or .h5; one of multisines has whole
    realisations, each with its settling period.
    """
    _check(asked)
    if asked.source == "engine":
        terminal.need_engine()
    terminal.need_figures(results.plot)
    recorded = None
    if asked.source not in LIVE:
        recorded = record_files.read_file(common.record_file(asked.source, LIVE), *file.columns)
    _tried(asked, file, recorded, instance, results)


def _tried(
    asked: TrialOptions,
    file: FileOptions,
    recorded: "store.TrialRecord | None",
    instance: str,
    results: TrialResultOptions,
) -> None:
    """Perform the trial, of a record if there is one."""
    name = "" if recorded else _scene_name(asked)
    scene = common.scene_of(name) if name else None
    plan = trials.plan_trial(_params(asked, file, scene, recorded))
    with common.interruptible(), ExitStack() as stack:
        if asked.source == "live":
            plan, source = _live(plan, scene, instance, asked, file, stack)
        else:
            if scene and not recorded:
                _refuse_beyond(name, scene, plan.params.trial)
            terminal.talk(announced(asked.source, plan.params.trial, scene, recorded))
            shown = scene or common.scene_of(ENGINE_SCENE)
            source = sources.file_source(recorded) if recorded else _simulated(asked, shown, stack)
        tell = stack.enter_context(terminal.progress())
        result = _judged(plan, source, recorded, tell)
        wanted = asked.sine and sources.may_follow(result.recorded)
        sines = sources.stepped_sine(plan.params.trial, source, tell) if wanted else None
    _show(result, sines, results)
    ended = result.recorded.ended
    stopped = (store.EndReason.FAULT, store.EndReason.STOPPED)
    if asked.source == "live" and ended and ended.reason in stopped:
        raise typer.Exit(STOPPED)  # the device is left like that


def _check(asked: TrialOptions) -> None:
    """Raise BadParameter for incompatible options."""
    if asked.sine and asked.source not in LIVE:
        raise typer.BadParameter(
            "--stepped-sine: a record that exists cannot be perturbed again; use engine, lockstep"
            " or live"
        )
    if asked.mark and (asked.source not in MARKED or asked.excitation == "multisine"):
        raise typer.BadParameter(
            "--mark: only the noise of live and lockstep trials is marked; omit that option"
        )
    if asked.until_decided and asked.excitation == "multisine":
        raise typer.BadParameter(
            "--until-decided: multisines are judged at their end; ask for fewer --realisations, or"
            " for noise"
        )


def _scene_name(asked: TrialOptions) -> str:
    """Return the scene of the trial; empty if none is given and none is needed."""
    return asked.scene or (ENGINE_SCENE if asked.source in ("engine", "lockstep") else "")


def _params(
    asked: TrialOptions,
    file: FileOptions,
    scene: "model_scene.Scene | None",
    recorded: "store.TrialRecord | None",
) -> "trials.TrialParams":
    layout = None
    if asked.excitation == "multisine":
        layout = trials.MultisineLayout(asked.realisations, asked.periods)
    typed = (asked.stiffness, asked.viscous, asked.mass)
    rendered = sources.given(typed, asked.active_damping, scene, bool(asked.scene), recorded)
    trial = sources.Trial(
        environment=rendered.free,
        active_damping_ns_per_m=rendered.active_damping_ns_per_m,
        seconds=asked.seconds,
        excitation=_excitation(asked, scene, layout),
        watch=watch.Watch(until_decided=asked.until_decided, winding_limit_c=asked.hottest),
        mark=asked.mark,
    )
    criteria = assess.Criteria(
        asked.band,
        asked.confidence,
        # the default for multisines is from force to velocity
        asked.estimator or ("spa" if layout is None else "h_force"),
        asked.behind,
        file.skew or 0.0,
        file.high_pass,
    )
    # a daemon provides its own device
    known = scene if asked.source != "live" else None
    return trials.TrialParams(trial, known, criteria, asked.lag, layout)


def _excitation(
    asked: TrialOptions, scene: "model_scene.Scene | None", layout: "trials.MultisineLayout | None"
) -> "model_scene.Excitation":
    """Return the scene's noise with the requested seed and density, or equivalent multisines."""
    noise = scene.noise if scene else sources.Trial().excitation
    noise = replace(noise, seed=asked.seed)
    if asked.psd is not None:
        noise = replace(noise, psd_n2_per_hz=asked.psd)
    return trials.multisine_like(noise, asked.band[1]) if layout else noise


def _judged(
    plan: "trials.TrialPlan",
    source: "sources.Source",
    recorded: "store.TrialRecord | None",
    tell: "store.Progress",
) -> "trials.TrialResult":
    """Run the plan; a file of multisines already has the record, realisation after realisation."""
    if recorded is None:
        return trials.run_trial(plan, source, tell)
    return trials.judged(plan, source(plan.params.trial, tell))


def _live(
    plan: "trials.TrialPlan",
    scene: "model_scene.Scene | None",
    instance: str,
    asked: TrialOptions,
    file: FileOptions,
    stack: ExitStack,
) -> "tuple[trials.TrialPlan, sources.Source]":
    """Return the plan with the curve of the daemon's device, and the source.

    The stability of its loop is observed, not predicted.
    """
    found = common.open_rig(instance, stack)
    skew_s = found.skew_s if file.skew is None else file.skew
    common.announce(found, plan.params.trial, scene, skew_s)
    criteria = replace(plan.params.criteria, skew_s=skew_s)
    known = trials.plan_trial(replace(plan.params, scene=found.model, criteria=criteria))
    return replace(known, spectral_radius=None), live.daemon_source(
        found.client, found.origin, asked.uncalibrated
    )


def _refuse_beyond(name: str, scene: "model_scene.Scene", trial: "sources.Trial") -> None:
    """Refuse values that a daemon on that scene's device would refuse, as in a live trial."""
    values = dict(zip("KBM", trial.environment, strict=True))
    level = {"active_damping": trial.active_damping_ns_per_m}
    common.require_within(name, sources.display(scene), values | level)
    live.allowed_waveform(trial, common.device_of(name).limits.probe_n)


def _simulated(
    asked: TrialOptions, scene: "model_scene.Scene", stack: ExitStack
) -> "sources.Source":
    """Return the batch engine, or the whole stack on virtual time for as long as
    `stack` is open.
    """
    if asked.source == "engine":
        return simulated.engine_source(scene)
    setup = lockstep.scene_params(_scene_name(asked))
    bench = stack.enter_context(lockstep.LockStepClient(*setup))
    return live.daemon_source(bench, f"lock-step, scene {scene.name}")


def _show(
    result: "trials.TrialResult",
    sines: "sources.ReferenceSines | None",
    results: TrialResultOptions,
) -> None:
    folder = common.folder(results.out, "trial")
    trials.write(folder, result, common.provenance_now(), sines)
    with common.drawing(folder):
        paths = draw_trial(result, folder, results.figure_width, sines) if results.plot else []
    found = store.to_json(trials.summary(result, sines))
    lines = [terminal.wrapped(line, sys.stdout) for line in _lines(result)]
    lines += [compared(result, sines)] if sines else []
    common.show_result(found, lines, folder, paths, results.as_json)


def _lines(result: "trials.TrialResult") -> Iterator[str]:
    """Yield the printed lines of a trial: its environment, the verdict, and its basis."""
    badge = "SIMULATED " if result.recorded.simulated else ""
    what = common.environment_words(result.plan.params.trial)
    yield f"{badge}{result.recorded.origin}: {what}"
    yield str(result.verdict)
    yield f"the interval covers {result.spectra.covers}"
    if "alignment" in result.recorded.more:
        yield str(result.recorded.more["alignment"])
    if result.recorded.ended:
        yield f"ended early: {result.recorded.ended}"
    if result.verdict.answer == "undecided":
        yield needed(result)


def announced(
    source: str,
    trial: "sources.Trial",
    scene: "model_scene.Scene | None",
    recorded: "store.TrialRecord | None",
) -> str:
    """Return the announcement of the simulation or the file, with the environment."""
    what = common.environment_words(trial)
    if recorded is not None:
        return (
            f"reads {recorded.origin}, {recorded.seconds:.4g} s at {recorded.rate_hz:.6g} Hz, as"
            f" recorded in {what}"
        )
    device = f", device {scene.device} of scene {scene.name}" if scene else ""
    return f"simulates {what} by the {source}{device}"


def needed(result: "trials.TrialResult") -> str:
    """Return the conditions for a decision, as far as they are known."""
    verdict = result.verdict
    layout = result.plan.params.multisine
    voiding = sorted({finding.code for finding in verdict.findings if finding.voids})
    if voiding:
        return (
            f"no record, however long, can be judged with {' and '.join(voiding)} in it: fix that"
            " first"
        )
    if layout is None:
        return verdicts.needed(verdict.seconds_needed, verdict.seconds)
    more = verdict.seconds_needed / verdict.seconds
    if not more <= verdicts.FORESEEABLE:
        return (
            f"many more than {layout.realisations} realisations would be needed; use noise"
            " (--excitation noise)"
        )
    distorted = any(finding.code == "distortion" for finding in verdict.findings)
    remedy = "; where friction distorts, noise decides sooner" if distorted else ""
    count = verdicts.two_digits(ceil(layout.realisations * more))
    return f"some {count} realisations would decide{remedy}"


def compared(result: "trials.TrialResult", sines: "sources.ReferenceSines") -> str:
    """Compare sines and noise, in a line for each frequency of `sines`."""
    rows = []
    moved_mm_per_s = 1e3 * sines.velocity_rms_m_per_s
    measured = result.measured
    for f, speed, sine in zip(
        sines.frequency_hz, moved_mm_per_s, sines.impedance_ns_per_m, strict=True
    ):
        noise = measured.impedance_ns_per_m[int(np.argmin(np.abs(measured.frequency_hz - f)))]
        phases = (float(np.degrees(np.angle(z))) for z in (sine, noise))
        rows.append((float(f), float(speed), abs(sine), abs(noise), *phases))
    columns = (
        "Hz",
        "sine mm/s rms",
        "sine |Z| N s/m",
        "noise |Z|",
        "sine phase deg",
        "noise phase",
    )
    title = f"stepped sine of {sines.force_n:g} N rms, added to the noise"
    known_mm_per_s = moved_mm_per_s[np.isfinite(moved_mm_per_s)].tolist()
    return f"{paper.text(paper.table(columns, rows, title))}\n{_amplitudes(result, known_mm_per_s)}"


def _amplitudes(result: "trials.TrialResult", sines_mm_per_s: list[float]) -> str:
    """Explain why sines and noise may differ, and which of them is judged."""
    noise = 1e3 * result.verdict.amplitude.velocity_sd_m_per_s
    between = (
        f"{min(sines_mm_per_s):.3g} to {max(sines_mm_per_s):.3g}" if sines_mm_per_s else "unknown"
    )
    return (
        f"the sines move the device at {between} mm/s rms, the noise at {noise:.3g} mm/s at all"
        " frequencies together; dry friction is another damping at each amplitude, so with it the"
        " two differ and a sine may leave +-90 deg alone; the verdict is the noise's"
    )


def draw_trial(
    result: "trials.TrialResult",
    folder: Path,
    width_mm: float | None,
    sines: "sources.ReferenceSines | None" = None,
) -> list[Path]:
    """Draw the figures of the trial and of its admittance in `folder`; return the files."""
    impedance = figures.trial_figure(result, sines, width_mm=width_mm)
    admittance = figures.trial_figure(result, sines, admittance=True, width_mm=width_mm)
    named = {"trial": impedance, "trial_admittance": admittance}
    return [path for name, figure in named.items() for path in style.save(figure, folder, name)]


def import_record(
    source: Annotated[Path, typer.Argument(metavar="FILE", callback=terminal.there, help=FILES)],
    stiffness: Annotated[
        float | None, typer.Option("-K", "--stiffness", metavar="N/M", help="Rendered K.")
    ] = None,
    viscous: Annotated[
        float | None, typer.Option("-B", "--viscous", metavar="NS/M", help="Rendered B.")
    ] = None,
    mass: Annotated[
        float | None, typer.Option("-M", "--mass", metavar="KG", help="Rendered M.")
    ] = None,
    active_damping: common.OneDamping = None,
    align: Annotated[
        Path | None,
        typer.Option(
            "--align",
            metavar="OWN",
            callback=terminal.there,
            help="hapticd's own marked record of the same trial: it gives clock and gaps of FILE.",
        ),
    ] = None,
    *,
    file: FileOptions,
    band: common.Band = (2.0, 500.0),
    out: common.Out = None,
    plot: common.Plot = False,
    as_json: terminal.Json = False,
) -> None:
    """Import a record of another system into a run folder with the record, its verdict and summary
    (run.json) and impedance.csv, as `trial` writes them. Recordings, their exports and run folders
    contain the rendered environment.

    With --align OWN, the run folder or recording of the same trial by hapticd (`trial live
    --mark`), FILE is aligned with hapticd's samples: its start, its clock and its gaps. The
    rendered environment and the lost slots are then those of OWN.
    """
    asked = TrialOptions(
        source=str(source),
        stiffness=stiffness,
        viscous=viscous,
        mass=mass,
        active_damping=active_damping,
        band=band,
    )
    recorded = (
        aligned.read_aligned(source, align, *file.columns)
        if align
        else record_files.read_file(source, *file.columns)
    )
    _tried(asked, file, recorded, "", TrialResultOptions(out=out, plot=plot, as_json=as_json))
