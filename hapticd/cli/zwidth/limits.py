"""Verbs of `zwidth` for limits: one environment, the axes K, B and M, and virtual walls.

Environment (`predict_command`). Theory predicts one environment in a second, without a trial.

Axes (`limits_command`). Limits of K, B and M are predicted, then found by simulated trials.

Walls (`walls_command`). Impacts on a wall give its maximum stiffness without oscillation, at each
damping.
"""

from functools import partial
from math import isfinite, log, sqrt
from typing import Annotated, Any

import typer

from hapticd.cli import terminal
from hapticd.cli.zwidth import common
from hapticd.core.errors import AnalysisError

with terminal.deferred_imports():
    import numpy as np

    from hapticd.model import coupled, linearise, predict
    from hapticd.zwidth import executors, limits, outcomes, passive_set, sources, store, walls
    from hapticd.zwidth.engine import contact as engine_contact
    from hapticd.zwidth.report import paper
    from hapticd.zwidth.report import passive_set as figures

DEVICE_OF = "fig4"  # default of --scene
LEFT_OUT = "Source of values that you omit (default: the device of fig4, and 0)."
OPTION_UNITS = {"-K": "N/m", "-B": "N s/m", "-M": "kg", "--active-damping": "N s/m"}


def predict_command(
    scene: Annotated[str, typer.Option("--scene", metavar="NAME|FILE", help=LEFT_OUT)] = "",
    stiffness: common.VirtualStiffness = None,
    viscous: common.VirtualDamping = None,
    mass: common.VirtualMass = None,
    active_damping: common.OneDamping = None,
    band: common.Band = (2.0, 500.0),
    as_json: terminal.Json = False,
) -> None:
    """Predict whether one environment is passive: for every input, in a trial, and held by a
    passive hand.

    The theorem (Colgate and Schenkel, for all images of a composed device) leaves friction out and
    holds for every input. The prediction counts friction at the amplitude of the trials, which
    fades as the motion grows. Where the theorem finds too little damping, the command builds and
    tries the passive hand that makes the display unstable. K < 0 is always refused.
    """
    shown = sources.display(common.scene_of(scene or DEVICE_OF))
    asked = sources.given(
        (stiffness, viscous, mass), active_damping, shown.scene if scene else None, bool(scene)
    )
    k, b, m = asked.free
    level = asked.active_damping_ns_per_m
    _require_finite({"-K": k, "-B": b, "-M": m, "--active-damping": level})
    common.require_within(
        scene or DEVICE_OF, shown, {"K": k, "B": b, "M": m, "active_damping": level}
    )
    found = coupled.forecast(shown.model, (k, b, m), level, shown.filters, shown.perturbation, band)
    drive = shown.model.drive
    about: dict[str, Any] = {"simulated": True, "device": shown.scene.device}
    lines = [
        f"SIMULATED {shown.scene.device}: K {k:g} N/m, B {b:g} N s/m, M {1e3 * m:g} g, active"
        f" damping {level:g} N s/m"
    ]
    lines += [f"{name:11} {words}" for name, words in _lines(found, shown.perturbation)]
    if drive:
        about["amplifier_limit_n"] = drive.limit_n
        lines.append(f"not covered an amplifier at its limit, {drive.limit_n:.3g} N in all")
    terminal.show({**about, **_forecast_json(found, (k, b, m), level)}, lines, as_json)


def _require_finite(values: dict[str, float]) -> None:
    for option, value in values.items():
        if not isfinite(value):
            raise typer.BadParameter(
                f"{option} {value:g}: a finite number of {OPTION_UNITS[option]} is needed"
            )


def _lines(
    found: "coupled.Forecast", perturbation: "linearise.Perturbation"
) -> list[tuple[str, str]]:
    motion = _motion(found.radius, found.period_s)
    prediction = f"{_least(found.true)}, {_friction(found.true)}"
    return [
        ("verdict", _verdict(found)),
        ("stability", f"spectral radius {found.radius:.6f} without friction: {motion}"),
        ("theorem", _theorem(found)),
        ("prediction", f"{prediction}\n{'':11} {_amplitude(perturbation)}"),
        ("a trial", f"would record {_least(found.recorded)}"),
        ("hand", _hand(found)),
    ]


def _verdict(found: "coupled.Forecast") -> str:
    prediction = found.true
    if found.refused:
        seen = "" if prediction.margin_ns_per_m[0] < 0.0 else ", though Re Z >= 0 all over the band"
        return f"refused: a negative K is active at low frequencies under any damping{seen}"
    if not found.passive:
        if prediction.margin_ns_per_m[0] < 0.0:
            return "not passive"
        why = "the loop is unstable" if prediction.calm[0] else "a burst of motion does not die out"
        return f"not passive: Re Z >= 0 all over the band, but {why}"
    if found.theorem_passive:
        return "passive, for every input and in every passive hand"
    return "passive at the amplitude of a trial, not for every input: the theorem differs"


def _motion(radius: float, period_s: float) -> str:
    if radius == 1.0 or radius <= 0.0:
        return "motion neither grows nor dies out" if radius else "motion ends at once"
    seconds = period_s * log(2.0) / abs(log(radius))
    how = "dies out, halving" if radius < 1.0 else "grows, doubling"
    return f"motion {how} in {seconds:.3g} s"


def _theorem(found: "coupled.Forecast") -> str:
    if found.refused or not found.stable:
        return "no answer: it presumes K >= 0 and a stable loop"
    if found.theorem_passive:
        return f"{found.theorem_margin:.3g} N s/m to spare for every input, without friction"
    return f"{-found.theorem_margin:.3g} N s/m missing without friction"


def _least(prediction: "predict.Prediction") -> str:
    return (
        f"least Re Z {prediction.margin_ns_per_m[0]:+.3g} N s/m at {prediction.worst_hz[0]:.3g} Hz"
    )


def _friction(prediction: "predict.Prediction") -> str:
    counts = prediction.friction_ns_per_m[0]
    return f"friction counting for {counts:.3g} N s/m" if counts else "no friction"


def _amplitude(perturbation: "linearise.Perturbation") -> str:
    density, band_hz = perturbation.psd_n2_per_hz, perturbation.band_hz
    force_n = sqrt(density * band_hz)
    return f"for noise of {density:.3g} N^2/Hz up to {band_hz:g} Hz, {force_n:.2g} N rms"


def _hand(found: "coupled.Forecast") -> str:
    if found.refused or not found.stable:
        return "none is needed: it is unstable by itself" if not found.stable else "not sought"
    if found.withstands:
        return "no passive hand brings it to oscillate, even without friction"
    if found.shaker is None:
        return "one exists that brings it to oscillate without friction; none was built"
    shaker = found.shaker
    grows = _motion(shaker.radius, found.period_s)
    return f"{_named(shaker.hand)} shakes it at about {shaker.hz:.3g} Hz without friction: {grows}"


def _named(hand: "coupled.Hand") -> str:
    """Describe its largest part; the tuned masses only serve images."""
    mass = float(hand.mass_kg[0])
    grounded = float(hand.stiffness_n_per_m[0].sum())
    main = (
        f"a mass of {1e3 * mass:.3g} g" if mass else f"a spring of {grounded:.3g} N/m to the wall"
    )
    return f"{main} with {hand.mass_kg.size - 1} small tuned masses"


def _forecast_json(
    found: "coupled.Forecast", point: tuple[float, float, float], level: float
) -> dict[str, Any]:
    perturbation = found.true.perturbation
    numbers: dict[str, Any] = {
        "environment": point,
        "active_damping_ns_per_m": level,
        "verdict": _verdict(found),
        "passive": found.passive,
        "refused": found.refused,
        "spectral_radius": found.radius,
        "theorem": {"margin_ns_per_m": found.theorem_margin, "passive": found.theorem_passive},
        "prediction": _judged(found.true),
        "recorded": _judged(found.recorded),
        "perturbation": (
            perturbation
            and {"psd_n2_per_hz": perturbation.psd_n2_per_hz, "band_hz": perturbation.band_hz}
        ),
        "withstands_every_hand": found.withstands,
        "hand": _built(found),
    }
    return {name: store.to_json(value) for name, value in numbers.items()}


def _judged(prediction: "predict.Prediction") -> dict[str, Any]:
    names = (
        "margin_ns_per_m",
        "margin_deg",
        "worst_hz",
        "friction_ns_per_m",
        "velocity_sd",
        "spectral_radius",
    )
    return {
        "passive": bool(prediction.passive[0]),
        **{name: float(getattr(prediction, name)[0]) for name in names},
    }


def _built(found: "coupled.Forecast") -> dict[str, Any] | None:
    if found.shaker is None:
        return None
    hand = found.shaker.hand
    return {
        "hz": found.shaker.hz,
        "impedance_ns_per_m": hand.impedance(np.array([2j * np.pi * found.shaker.hz]))[0],
        "spectral_radius": found.shaker.radius,
        "mass_kg": hand.mass_kg.tolist(),
        "damping_ns_per_m": hand.damping_ns_per_m.tolist(),
        "stiffness_n_per_m": hand.stiffness_n_per_m.tolist(),
    }


# --- axes -----------------------------------------------------------------------------------------
UNITS = {"K": ("N/m", 1.0), "B": ("N s/m", 1.0), "M": ("g", 1e3)}  # printed unit, units per SI unit
COLUMNS = (
    "limit",
    "active N s/m",
    "N^2/Hz",
    "predicted",
    "trials say",
    "passive up to",
    "not passive from",
    "worst Hz",
    "v rms mm/s",
    "trials",
)
NOTE = (
    "predicted to not passive from: in the unit of the limit; trials say: the last that passed"
    " before the first that failed; passive up to, not passive from: by the interval;\nworst Hz:"
    " where the first that failed has its least Re Z; v rms: of the last that passed"
)


def limits_command(
    scene: common.SceneName = "fig4",
    active_damping: common.Damping = "0,1.74",
    amplitudes: Annotated[
        int,
        typer.Option(
            "--amplitudes",
            metavar="N",
            min=1,
            max=9,
            help="Number of perturbation amplitudes, each twice the one before.",
        ),
    ] = 1,
    axis: Annotated[
        str, typer.Option("--axis", metavar="KBM", help="Parameters to search: K, B, M.")
    ] = "KBM",
    seeds: Annotated[
        int,
        typer.Option("--seeds", metavar="N", min=1, help="Number of noise seeds, for the scatter."),
    ] = 1,
    *,
    trials: common.TrialsOptions,
    confidence: common.Confidence = 0.95,
    results: common.ResultsOptions,
) -> None:
    """Find how far K, B and M each go alone before the display is not passive: by prediction, then
    by simulated trials.

    With --amplitudes 3 also at 2 and 4 times the perturbation's force: with friction, a limit
    depends on the amplitude.

    Ctrl-C is safe: the same command with the same --out continues where it ended. With --json each
    new outcome is a line, with its limit, amplitude and seed, and the last line is the result.
    """
    terminal.need_engine(results.plot)
    if not axis or set(axis) - set(passive_set.AXES):
        raise typer.BadParameter(f"--axis {axis!r}: use one or more of the letters K, B, M")
    conditions = common.conditions(
        common.scene_of(scene), trials.seconds, trials.seed, trials.band, confidence
    )
    factors = tuple(2.0**doubling for doubling in range(amplitudes))
    wanted = tuple(passive_set.AXES.index(name) for name in axis)
    params = limits.LimitsParams(conditions, common.levels(active_damping), factors, wanted, seeds)
    folder = common.folder(results.out, "limits")
    kept = store.TrialStore(folder / "trials.jsonl")

    def follow(
        scan: "limits.Scan", given: "outcomes.Conditions", new: "list[outcomes.Outcome]"
    ) -> None:
        if results.as_json:
            limit = passive_set.AXES[scan.axis]
            seed = given.excitation.seed
            common.print_outcomes(new, limit=limit, amplitude=scan.amplitude, seed=seed)

    with (
        common.keeping(kept, folder),
        executors.executor(trials.where) as pool,
        terminal.progress() as tell,
    ):
        result = limits.run_limits(limits.plan_limits(params), kept, tell, pool, follow)
    rows = [{"name": limit.name, **store.to_json(limit)} for limit in result.limits]
    about = {"kind": "limits", "scene": scene, "seconds": trials.seconds, "limits": rows}
    common.write_summary(folder, about, seed=trials.seed)
    figure = partial(figures.limits_figure, result, results.figure_width)
    paths = common.drawn(folder, "limits", figure, results.plot)
    judged = "; ".join(sorted({limit.judged.words for limit in result.limits}))
    lines = [paper.text(_table(result)), NOTE, judged, f"{result.made} trials made"]
    common.show_result({"made": result.made, "limits": rows}, lines, folder, paths, results.as_json)


def _table(result: "limits.LimitsResult") -> "paper.Table":
    params = result.plan.params
    scattered = params.seeds > 1
    rows = [_row(limit, scattered) for limit in result.limits]
    device = params.conditions.scene.device
    title = f"SIMULATED {device}: axis limits, the other two being 0"
    return paper.table((*COLUMNS, "scatter") if scattered else COLUMNS, rows, title)


def _row(limit: "limits.AxisLimit", scattered: bool) -> tuple[str | float, ...]:
    unit, factor = UNITS[limit.name]
    found = (limit.scan.predicted, limit.value, limit.lower, limit.upper)
    return (
        f"{limit.name} {unit}",
        limit.scan.active_damping_ns_per_m,
        f"{limit.perturbation_psd:.2g}",
        *(factor * value for value in found),
        limit.worst_hz,
        1e3 * limit.velocity_sd,
        limit.trials,
        *((factor * limit.sd,) if scattered else ()),
    )


# --- walls ----------------------------------------------------------------------------------------
Stiffness = Annotated[
    common.Range,
    typer.Option(
        "--stiffness",
        metavar="LOW HIGH N",
        help="Stiffness of the walls, N/m, evenly spaced in ln K.",
    ),
]


def walls_command(
    scene: common.SceneName = "wall",
    active_damping: common.Damping = "0,1.74",
    stiffness: Stiffness = (20.0, 3000.0, 18),
    viscous: Annotated[
        common.Range,
        typer.Option(
            "--viscous", metavar="LOW HIGH N", help="Virtual damping of the walls, N s/m."
        ),
    ] = (0.0, 8.0, 13),
    settle_s: Annotated[
        float, typer.Option("--settle-s", metavar="S", help="Time allowed to come to rest.")
    ] = 1.5,
    still: Annotated[
        float, typer.Option("--still", metavar="M/S", help="Oscillation speed that counts as rest.")
    ] = 2e-3,
    approach: Annotated[
        float | None,
        typer.Option(
            "--approach",
            metavar="MM",
            min=0.0,
            help="Raise the active damping from MM mm before the wall on (default: everywhere).",
        ),
    ] = None,
    slew: Annotated[
        float,
        typer.Option(
            "--slew",
            metavar="N",
            min=1.0,
            help="Fastest change of the active damping with --approach, N s/m per s.",
        ),
    ] = 2000.0,
    out: common.Out = None,
    plot: common.Plot = True,
    figure_width: terminal.FigureWidth = None,
    as_json: terminal.Json = False,
) -> None:
    """Find how stiff a virtual wall may be at each virtual damping before an impact makes it
    oscillate: the K-B plot of one device.

    With --approach, free motion has no active damping, and the wall is rendered only as far as the
    active damping has risen. This is a simulation: the servo does not do it.
    """
    terminal.need_engine(plot)
    stiffnesses, dampings = _grid(stiffness, viscous)
    params = walls.WallMapParams(
        common.scene_of(scene),
        stiffnesses,
        dampings,
        common.levels(active_damping),
        settle_s,
        still,
        None if approach is None else engine_contact.ContactDamping(1e-3 * approach, slew),
    )
    plan = walls.plan_walls(params)
    with common.interruptible(), terminal.progress() as tell:
        result = walls.run_walls(plan, tell)
    folder = common.folder(out, "walls")
    about = {"kind": "walls", "scene": scene, "contact": params.contact, "lines": result.lines}
    common.write_summary(folder, about)
    figure = partial(figures.walls_figure, result, width_mm=figure_width)
    paths = common.drawn(folder, "walls", figure, plot)
    found = {"lines": store.to_json(result.lines)}
    common.show_result(found, [paper.text(_walls_table(result, dampings))], folder, paths, as_json)


def _grid(
    stiffness: common.Range, viscous: common.Range
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return stiffnesses [N/m] and dampings [N s/m] of the walls. AnalysisError unless K is above
    0.
    """
    low, high, count = common.ranged("--stiffness", stiffness, 1)
    if low <= 0.0:
        raise AnalysisError("wall stiffnesses: an ascending list above 0 N/m is needed")
    dampings = np.linspace(*common.ranged("--viscous", viscous, 1))
    return tuple(np.geomspace(low, high, count).tolist()), tuple(dampings.tolist())


def _walls_table(result: "walls.WallResult", dampings: tuple[float, ...]) -> "paper.Table":
    """Return a row for each damping of the wall, a column for each level of active damping."""
    params = result.plan.params
    rows: list[tuple[str | float, ...]] = []
    for place, damping in enumerate(dampings):
        lines = result.lines[place :: len(dampings)]
        rows.append(
            (damping, *(f"{'>' if one.open else ''}{one.highest_n_per_m:.3g}" for one in lines))
        )
    columns = ("wall B N s/m", *(f"K N/m at {level:g} N s/m" for level in params.levels))
    title = f"SIMULATED {params.scene.device}: stiffest stable wall, by active damping"
    return paper.table(columns, rows, title)
