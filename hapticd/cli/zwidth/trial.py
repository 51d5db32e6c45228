"""One trial: perturb, record, judge; by the simulator, by the whole stack, on a daemon's device, or
from a file.

Before a daemon's device moves, it is said which one it is, what is known of it and what will
happen; whoever ends the process meanwhile ends the trial with force off. Beside the verdict it is
said what would decide an undecided trial, and how single sines compare with the noise.
"""

import signal
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hapticd.cli import terminal
from hapticd.cli.terminal import progress
from hapticd.cli.zwidth import common

if TYPE_CHECKING:
    from hapticd.analysis.impedance import Estimator
    from hapticd.client import Client
    from hapticd.measure.referee import Referee
    from hapticd.measure.sources import Source, Trial
    from hapticd.measure.store import Progress, Recorded
    from hapticd.measure.trial import TrialPlan, TrialResult
    from hapticd.plant.scene import Scene


def asked_for(
    source: str, trial: "Trial", scene: "Scene | None", recorded: "Recorded | None"
) -> str:
    """What is about to be flown or read, environment and all."""
    k, b, m = trial.environment
    what = f"K {k:g} N/m, B {b:g} N s/m, M {m:g} kg, added damping {trial.damping_ns_per_m:g} N s/m"
    if recorded is not None:
        return (
            f"reads {recorded.origin}, {recorded.seconds:.4g} s at {recorded.rate_hz:.6g} Hz, as"
            f" recorded in {what}"
        )
    device = f", device {scene.device} of scene {scene.name}" if scene else ""
    return f"flies {what} by the {source}{device}"


def needed(result: "TrialResult") -> str:
    """What would decide, as far as it can be said."""
    from math import ceil

    from hapticd.analysis import verdict as outlook

    verdict = result.verdict
    layout = result.plan.params.multisine
    voiding = sorted({finding.code for finding in verdict.findings if finding.voids})
    if voiding:
        return f"no length of a record decides with {' and '.join(voiding)} in it: mend that first"
    if layout is None:
        return outlook.needed(verdict.seconds_needed, verdict.seconds)
    more = verdict.seconds_needed / verdict.seconds
    if not more <= outlook.FORESEEABLE:
        return (
            f"many more than {layout.realisations} realisations would be needed; use noise"
            " (--excitation noise)"
        )
    distorted = any(finding.code == "distortion" for finding in verdict.findings)
    remedy = "; where friction distorts, noise decides sooner" if distorted else ""
    return (
        f"some {outlook.two_digits(ceil(layout.realisations * more))} realisations would"
        f" decide{remedy}"
    )


def compared(result: "TrialResult", referee: "Referee") -> str:
    """Sines and noise side by side, each frequency of `referee` a line."""
    import numpy as np

    from hapticd.report.table import table, text

    rows = []
    moved = 1e3 * referee.velocity_rms_m_per_s
    for f, speed, sine in zip(referee.frequency_hz, moved, referee.impedance_ns_per_m, strict=True):
        noise = result.measured.impedance_ns_per_m[
            int(np.argmin(np.abs(result.measured.frequency_hz - f)))
        ]
        sizes = (
            part(z)
            for part in (abs, lambda z: float(np.degrees(np.angle(z))))
            for z in (sine, noise)
        )
        rows.append((float(f), float(speed), *sizes))
    columns = (
        "Hz",
        "sine mm/s rms",
        "sine |Z| N s/m",
        "noise |Z|",
        "sine phase deg",
        "noise phase",
    )
    title = f"stepped sine of {referee.force_n:g} N rms beside the noise"
    return f"{text(table(columns, rows, title))}\n{_amplitudes(result, moved[np.isfinite(moved)].tolist())}"


def _amplitudes(result: "TrialResult", sines_mm_per_s: list[float]) -> str:
    """Why sines and noise may differ, and which of them is judged."""
    noise = 1e3 * result.verdict.amplitude.velocity_sd_m_per_s
    between = (
        f"{min(sines_mm_per_s):.3g} to {max(sines_mm_per_s):.3g}" if sines_mm_per_s else "unknown"
    )
    return (
        f"the sines move the device at {between} mm/s rms, the noise at {noise:.3g} mm/s at all"
        " frequencies together; dry friction is another damping at each amplitude, so with it the"
        " two differ and a sine may leave +-90 deg alone; the verdict is the noise's"
    )


@dataclass(frozen=True)
class Rig:
    """A daemon's device by the name in its device file; `model`: the scene of the
    device of that name, if one is known.
    """

    client: "Client"
    instance: str
    device: str
    simulated: bool
    model: "Scene | None"

    @property
    def origin(self) -> str:
        """Of its records."""
        return f"daemon {self.instance!r}, device {self.device!r}"


def open_rig(instance: str, stack: ExitStack) -> Rig:
    """Connect for as long as `stack`; what ends this process meanwhile ends the trial
    with force off. DaemonDown.
    """
    from hapticd.cli.change import connect
    from hapticd.measure.scenes import scene_of_device
    from hapticd.params import EnvironmentParams, from_plain

    stack.enter_context(_signals_end_with_force_off())
    client = stack.enter_context(connect(instance))
    servo = client.hello()["servo"]
    name = servo["device"]["name"]
    model = scene_of_device(servo["device"]["name"])
    if model is not None:
        own = from_plain(EnvironmentParams, servo["environment"])
        filtered = replace(
            model.environment,
            velocity_filter=own.velocity_filter,
            acceleration_filter=own.acceleration_filter,
        )
        model = replace(model, environment=filtered)
    return Rig(client, instance, name, servo["simulated"], model)


def announce(rig: Rig, trial: "Trial", scene: "Scene | None") -> None:
    """What is about to happen, on stderr, before it does. `scene` is the one that was named."""
    from hapticd.measure.watch import CENTRING_N_PER_M

    k, b, m = trial.environment
    kind = "simulated" if rig.simulated else "real, it moves"
    terminal.talk(
        f"enables the device {rig.device!r} of daemon {rig.instance!r} ({kind}) in K {k:g} N/m, B"
        f" {b:g} N s/m, M {m:g} kg, added damping {trial.damping_ns_per_m:g} N s/m, and shakes it;"
        " Ctrl-C ends it, force off"
    )
    if k == 0.0:
        terminal.talk(
            f"with K = 0 nothing holds the device in its travel; -K {CENTRING_N_PER_M:g} would"
        )
    if rig.model is None:
        terminal.talk(f"no model of a device {rig.device!r} is known, so nothing is predicted")
    if scene is not None and (rig.model is None or scene.device != rig.model.device):
        terminal.talk(
            f"scene {scene.name!r} is of the device {scene.device!r}, the daemon has"
            f" {rig.device!r}: what the scene says is rendered on that"
        )


@contextmanager
def _signals_end_with_force_off() -> Iterator[None]:
    """Whoever ends this process, or closes its terminal, gets what Ctrl-C gets: force
    off. Exit 128 + the signal's number.
    """

    def leave(number: int, frame: object) -> None:
        raise SystemExit(128 + number)

    heard = [
        number
        for number in (signal.SIGTERM, signal.SIGHUP)
        if signal.getsignal(number) == signal.SIG_DFL
    ]
    for number in heard:
        signal.signal(number, leave)
    try:
        yield
    finally:
        for number in heard:
            signal.signal(number, signal.SIG_DFL)


LIVE = ("engine", "lockstep", "live")
FROM = (
    "engine: simulate; lockstep: the whole stack on virtual time; live: the daemon's device,"
    " ENABLED by this; else a FILE."
)
ENGINE_SCENE = "fig4"  # of engine and lockstep where none is named


def trial(
    source: Annotated[
        str, typer.Argument(metavar="engine|lockstep|live|FILE", help=FROM)
    ] = "engine",
    scene: Annotated[
        str,
        typer.Option(
            "--scene",
            metavar="NAME|FILE",
            help="Device and environment; engine, lockstep: else fig4.",
        ),
    ] = "",
    stiffness: Annotated[
        float | None, typer.Option("-K", "--stiffness", metavar="N/M", help="Virtual stiffness.")
    ] = None,
    viscous: Annotated[
        float | None, typer.Option("-B", "--viscous", metavar="NS/M", help="Virtual damping.")
    ] = None,
    mass: Annotated[
        float | None, typer.Option("-M", "--mass", metavar="KG", help="Virtual mass.")
    ] = None,
    damping: Annotated[
        float | None, typer.Option("--damping", metavar="NS/M", help="Electrical damping.", min=0)
    ] = None,
    excitation: Annotated[
        str, typer.Option("--excitation", metavar="noise|multisine", help="Of the probe.")
    ] = "noise",
    seconds: Annotated[
        float, typer.Option("--seconds", metavar="S", help="Length of a trial by noise.")
    ] = 90.0,
    realisations: Annotated[
        int, typer.Option("--realisations", metavar="N", help="Multisines of other phases.", min=1)
    ] = 8,
    periods: Annotated[
        int,
        typer.Option(
            "--periods", metavar="N", help="Of each that count, after one to settle.", min=1
        ),
    ] = 2,
    seed: common.Seed = 1,
    psd: Annotated[
        float | None,
        typer.Option(
            "--psd", metavar="N2/HZ", help="Of the perturbation; else the scene's.", min=0
        ),
    ] = None,
    band: common.Band = (2.0, 500.0),
    confidence: common.Confidence = 0.95,
    estimator: Annotated[
        str,
        typer.Option(
            "--estimator",
            metavar="spa|h_force",
            help="Input: velocity (paper, noise) or force (multisine).",
        ),
    ] = "",
    lag: Annotated[
        int, typer.Option("--lag", metavar="N", help="Window, samples (noise).", min=64)
    ] = 2048,
    behind: Annotated[
        float,
        typer.Option("--behind-mass", metavar="KG", help="Mass of the probe to take out.", min=0),
    ] = 0.0,
    sine: Annotated[
        bool,
        typer.Option(
            "--stepped-sine", help="Also by single sines at 12 frequencies, as a referee."
        ),
    ] = False,
    until_decided: Annotated[
        bool, typer.Option("--until-decided", help="End when the verdict stands.")
    ] = False,
    hottest: Annotated[
        float,
        typer.Option("--hottest", metavar="C", help="Winding temperature that ends the trial."),
    ] = 100.0,
    force: Annotated[str, typer.Option("--force-column", metavar="NAME", help="Of FILE.")] = "",
    velocity: Annotated[
        str, typer.Option("--velocity-column", metavar="NAME", help="Of FILE.")
    ] = "",
    rate_hz: Annotated[
        float | None,
        typer.Option("--rate-hz", metavar="HZ", help="Of FILE, where it does not say."),
    ] = None,
    skew: Annotated[
        float,
        typer.Option(
            "--skew",
            metavar="S",
            help="Known delay of the velocity channel behind the force, taken out.",
        ),
    ] = 0.0,
    high_pass: Annotated[
        float,
        typer.Option(
            "--high-pass",
            metavar="HZ",
            help="Known corner of an AC-coupled velocity channel, taken out.",
            min=0,
        ),
    ] = 0.0,
    instance: terminal.Instance = terminal.INSTANCE,
    out: common.Out = None,
    plot: common.Plot = False,
    admittance: common.Admittance = False,
    as_json: terminal.Json = False,
) -> None:
    """One trial of one environment: the probe shakes, impedance by spectral analysis, passive or
    not.

    White noise and spectral analysis, the paper's way, or multisines (period 1.024 s): better for a
    device without friction, and with friction only as good as the number of realisations. Of K, B
    and M what is not given is that of the scene that --scene names, else 0; with none of the three
    given they are those of fig4, live without --scene they are 0, and of a record of hapticd's own
    what it says. Electrical damping and perturbation are the scene's unless given. `live` enables
    the daemon's device by itself, says so, shakes it, and disables it at the end and on Ctrl-C;
    give a K that holds it in its travel (-K 20). A FILE is .csv, .npz, .mat or .h5; one of
    multisines holds whole realisations, each with its settling period.
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
    force_of = replace(
        force_of, seed=seed, psd_n2_per_hz=force_of.psd_n2_per_hz if psd is None else psd
    )
    repeats = Layout(realisations, periods) if excitation == "multisine" else None
    watch = Watch(until_decided=until_decided, winding_limit_c=hottest)
    shaken = multisine_like(force_of, band[1]) if repeats else force_of
    trial = Trial(asked.environment, asked.damping_ns_per_m, seconds, shaken, watch)
    chosen: Estimator = (
        "h_force" if estimator == "h_force" or (repeats and not estimator) else "spa"
    )
    model = loaded if source != "live" else None
    params = TrialParams(
        trial,
        model,
        band,
        confidence,
        chosen,
        behind,
        lag=lag,
        multisine=repeats,
        skew_s=skew,
        high_pass_hz=high_pass,
    )
    plan = plan_trial(params)
    with common.interruptible(), ExitStack() as stack:
        if source == "live":
            plan, recorder = _live(plan, loaded, instance, stack)
        else:
            terminal.talk(asked_for(source, trial, loaded, recorded))
            recorder = file_source(recorded) if recorded else _source(source, named, loaded, stack)
        tell = stack.enter_context(progress())
        result = _flown(plan, recorder, source in LIVE, tell)
        referee = (
            stepped_sine(trial, recorder, tell) if sine and may_follow(result.recorded) else None
        )
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
        raise typer.BadParameter(
            "--stepped-sine: a record that exists cannot be perturbed again; use engine, lockstep"
            " or live"
        )
    if until_decided and excitation == "multisine":
        raise typer.BadParameter(
            "--until-decided: multisines are judged at their end; ask for fewer --realisations, or"
            " for noise"
        )


def _flown(plan: "TrialPlan", recorder: "Source", flies: bool, tell: "Progress") -> "TrialResult":
    """A file of multisines is there already, realisation after realisation."""
    from hapticd.measure.trial import judged, run_trial

    return (
        run_trial(plan, recorder, tell)
        if flies
        else judged(plan, recorder(plan.params.trial, tell))
    )


def _live(
    plan: "TrialPlan", scene: "Scene | None", instance: str, stack: ExitStack
) -> "tuple[TrialPlan, Source]":
    """The plan with the curve of the daemon's device, and the source. Whether the loop
    is stable is seen, not predicted.
    """
    from dataclasses import replace

    from hapticd.measure.bench import bench_source
    from hapticd.measure.trial import plan_trial

    found = open_rig(instance, stack)
    announce(found, plan.params.trial, scene)
    return replace(
        plan_trial(replace(plan.params, scene=found.model)), spectral_radius=None
    ), bench_source(found.client, found.origin)


def _source(name: str, scene: str, loaded: Any, stack: ExitStack) -> "Source":
    from hapticd.assembly.lockstep import scene_params
    from hapticd.measure.bench import bench_source
    from hapticd.measure.lockstep import LockStepBench
    from hapticd.measure.sources import engine_source

    if name == "engine":
        return engine_source(loaded)
    return bench_source(
        stack.enter_context(LockStepBench(*scene_params(scene))), f"lock-step, scene {loaded.name}"
    )


def _show(
    result: "TrialResult",
    referee: "Referee | None",
    folder: Path,
    plot: bool,
    admittance: bool,
    as_json: bool,
) -> None:
    from hapticd.measure.store import plain
    from hapticd.measure.trial import summary, write

    write(folder, result, common.told(), referee)
    with common.drawing(folder):
        paths = draw_trial(result, folder, referee, admittance) if plot else []
    if as_json:
        terminal.data_json(
            {
                "ok": True,
                **plain(summary(result, referee)),
                "folder": str(folder),
                "figures": [str(path) for path in paths],
            }
        )
        return
    k, b, m = result.plan.params.trial.environment
    who = "SIMULATED " if result.recorded.simulated else ""
    terminal.data(
        f"{who}{result.recorded.origin}: K {k:g} N/m, B {b:g} N s/m, M {m:g} kg, "
        f"added damping {result.plan.params.trial.damping_ns_per_m:g} N s/m"
    )
    terminal.data(str(result.verdict))
    terminal.data(f"the interval covers {result.covers}")
    if result.recorded.ended:
        terminal.data(f"ended early: {result.recorded.ended}")
    if result.verdict.answer == "undecided":
        terminal.data(needed(result))
    if referee is not None:
        terminal.data(compared(result, referee))
    common.kept(folder, paths)


def draw_trial(
    result: "TrialResult", folder: Path, referee: "Referee | None" = None, admittance: bool = True
) -> list[Path]:
    """The figure of the trial, and that of its admittance if asked."""
    from hapticd.report import style
    from hapticd.report.trial import trial_figure

    paths = [*style.save(trial_figure(result, referee), folder, "trial")]
    if admittance:
        paths += style.save(
            trial_figure(result, referee, admittance=True), folder, "trial_admittance"
        )
    return paths


RecordFile = Annotated[
    Path,
    typer.Argument(
        metavar="FILE",
        help=(
            ".csv, .npz, .mat or .h5 with force in N and velocity in m/s; a recording, its export,"
            " a run folder."
        ),
    ),
]


def import_record(
    file: RecordFile,
    stiffness: Annotated[
        float | None, typer.Option("-K", "--stiffness", metavar="N/M", help="What was rendered.")
    ] = None,
    viscous: Annotated[
        float | None, typer.Option("-B", "--viscous", metavar="NS/M", help="What was rendered.")
    ] = None,
    mass: Annotated[
        float | None, typer.Option("-M", "--mass", metavar="KG", help="What was rendered.")
    ] = None,
    damping: Annotated[
        float | None, typer.Option("--damping", metavar="NS/M", help="Electrical damping.", min=0)
    ] = None,
    force: Annotated[str, typer.Option("--force-column", metavar="NAME", help="Of FILE.")] = "",
    velocity: Annotated[
        str, typer.Option("--velocity-column", metavar="NAME", help="Of FILE.")
    ] = "",
    rate_hz: Annotated[
        float | None, typer.Option("--rate-hz", metavar="HZ", help="Where FILE does not say.")
    ] = None,
    skew: Annotated[
        float,
        typer.Option("--skew", metavar="S", help="Known delay of the velocity channel, taken out."),
    ] = 0.0,
    high_pass: Annotated[
        float,
        typer.Option(
            "--high-pass",
            metavar="HZ",
            help="Known corner of an AC-coupled velocity channel, taken out.",
            min=0,
        ),
    ] = 0.0,
    band: common.Band = (2.0, 500.0),
    out: common.Out = None,
    plot: common.Plot = False,
    as_json: terminal.Json = False,
) -> None:
    """Bring in a record of any other system: a run folder with the record, its verdict and summary
    (run.json) and impedance.csv, as `trial` makes them. A recording, its exports and a run folder
    say themselves what was rendered.
    """
    trial(
        source=str(file),
        stiffness=stiffness,
        viscous=viscous,
        mass=mass,
        damping=damping,
        force=force,
        velocity=velocity,
        rate_hz=rate_hz,
        skew=skew,
        high_pass=high_pass,
        band=band,
        out=out,
        plot=plot,
        as_json=as_json,
    )
