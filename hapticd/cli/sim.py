"""Verbs of simulation: scenes, and the simulated board on a real USB bus.

Scenes (`sim_run`). They are run and explained, with their effects, damping, accuracy and remedies.

Board (`sim_board`). `hapticd sim-board` serves the simulated board from a separate process.
"""

import time
from typing import Annotated, Any, Literal

import typer

from hapticd.cli import terminal
from hapticd.cli.zwidth import common
from hapticd.core.errors import ConfigError
from hapticd.core.process import on_stop
from hapticd.core.units import MonotonicClock

with terminal.deferred_imports():
    from hapticd.model import compose, discrete
    from hapticd.model import scene as model_scene
    from hapticd.settings import build, load
    from hapticd.settings import scene as scenes
    from hapticd.sim import board, injection, usb_device, usbip
    from hapticd.studies import accuracy as accuracies
    from hapticd.studies import effects as effect_studies
    from hapticd.studies import port_energy, report, report_methods
    from hapticd.studies import remedies as remedy_studies
    from hapticd.studies import scene as scene_studies
    from hapticd.zwidth import sources as displays
    from hapticd.zwidth import store
    from hapticd.zwidth.report import paper

QUESTIONS = (
    "limits: passive K, B, M; phase: of Z in the band; peak: of |Z| near 100 Hz, as in Fig. 8."
)


sim_app = typer.Typer(
    no_args_is_help=True,
    help="Simulate scenes: run, explain, find necessary effects and the highest active damping.",
)
studies_app = typer.Typer(no_args_is_help=True, help="Compare many simulated displays.")
REMEDIES_NOTE = (
    "K in N/m, B in N s/m, volume in N/m N s/m kg. By theory, without an interval: up to noise;"
    " predicted: with friction;\nby trials: the scatter is that between seeds, passive up to and"
    " not from are the ends of the interval\nIn every hand: no passive hand of a family gets more"
    " than 0.01 mJ; in a draw: median, 5 % and 95 % of 32 draws of\nhands; given out: the most that"
    " a hand gets at K asked"
)


@terminal.verb(sim_app, "run")
def sim_run(
    scene: terminal.SceneName,
    plot: terminal.Plot = False,
    figure_width: terminal.FigureWidth = None,
    seconds: Annotated[
        float | None,
        typer.Option(
            "--seconds",
            metavar="S",
            min=0.001,
            help="Length of the simulation (default: the scene's).",
        ),
    ] = None,
    out: terminal.Out = terminal.HERE,
    as_json: terminal.Json = False,
) -> None:
    """Simulate a scene with and without its active damping: traces, and impedance and
    verdict where noise moves it.
    """
    terminal.need_engine(plot)
    plan = scene_studies.plan_scene(scenes.load_scene(scene), seconds)
    with terminal.progress(as_json) as tell:
        result = scene_studies.run_scene(plan, tell)
    paths = []
    if plot:
        figure = report.scene_figure(result, figure_width)
        paths = terminal.save_figure(figure, out, plan.scene.name, as_json)
    trials = [_trial_json(trial) for trial in result.trials]
    lines = [
        f"{plan.scene.title}: {plan.seconds:g} s, SIMULATED {plan.scene.device}\n",
        paper.text(report.scene_table(result)),
    ]
    for trial in result.trials:
        if trial.judged is not None:
            lines.append(f"\n{trial.case.name}: {trial.judged.verdict}")
    found = {"seconds": plan.seconds, "trials": trials, "figures": paths}
    terminal.show({**_about(plan.scene), **found}, lines, as_json)


def _about(scene: "model_scene.Scene") -> dict[str, Any]:
    return {"simulated": True, "scene": scene.name, "title": scene.title, "device": scene.device}


def _head(scene: "model_scene.Scene") -> str:
    return f"{scene.title}: SIMULATED {scene.device}"


def _trial_json(trial: "scene_studies.SceneTrial") -> dict[str, Any]:
    found = {
        "leg": trial.case,
        **trial.numbers,
        "verdict": trial.judged and trial.judged.verdict,
        "winding_c": trial.winding_c,
        "impedance": report.impedance_rows(trial),
    }
    return {name: store.to_json(value) for name, value in found.items()}


@terminal.verb(sim_app, "explain")
def sim_explain(scene: terminal.SceneName, as_json: terminal.Json = False) -> None:
    """Explain what a scene simulates: states, nonlinearities, time constants, step, the
    reason for each, and its measured cost.
    """
    loaded = scenes.load_scene(scene)
    levels = sorted({step.level_ns_per_m for step in loaded.active_damping})
    found = discrete.explain(compose.compose(loaded), levels)
    spent = effect_studies.cost(loaded, scene, time.process_time_ns)
    size = f"{len(found.states)} states, {len(found.nonlinearities)} nonlinearities"
    lines = [
        f"{_head(loaded)}, {size}",
        *(f"\n{paper.text(part)}" for part in report.explained(found)),
        "",
        *report.step_words(found, loaded, displays.SUBSTEPS),
        *report.cost_words(spent),
    ]
    costs = {"cost": store.to_json(spent), "substeps": displays.SUBSTEPS}
    terminal.show({**_about(loaded), **store.to_json(found), **costs}, lines, as_json)


@terminal.verb(sim_app, "effects")
def sim_effects(
    scene: terminal.SceneName,
    question: Annotated[
        Literal["limits", "phase", "peak"], typer.Option("--for", help=QUESTIONS)
    ] = "limits",
    tolerance: Annotated[
        str,
        typer.Option(
            "--tolerance", metavar="SHARE", help="Largest change that does not matter: 2% or 0.02."
        ),
    ] = "2%",
    seconds: Annotated[
        float, typer.Option("--seconds", metavar="S", min=5.0, help="Length of simulated trials.")
    ] = 90.0,
    plot: terminal.Plot = True,
    figure_width: terminal.FigureWidth = None,
    out: terminal.Out = terminal.HERE,
    as_json: terminal.Json = False,
) -> None:
    """Leave effects out one at a time, compare the answers, and propose the cheapest
    set that is enough.
    """
    terminal.need_engine(plot)
    loaded = scenes.load_scene(scene)
    asked = effect_studies.EffectsParams(loaded, question, share(tolerance), seconds)
    plan = effect_studies.plan_effects(asked)
    with terminal.progress(as_json) as tell:
        result = effect_studies.run_effects(plan, time.process_time_ns, tell)
    paths = []
    if plot:
        name = f"{loaded.name}-effects-{question}"
        figure = report_methods.effects_figure(result, figure_width)
        paths = terminal.save_figure(figure, out, name, as_json)
    found = {
        "simulated": True,
        "scene": loaded.name,
        "question": question,
        "tolerance": plan.params.tolerance,
        **store.to_json(result, skip=("plan",)),
        "figures": paths,
    }
    effects = paper.text(report_methods.effects_table(result))
    terminal.show(
        found, [f"{_head(loaded)}\n\n{effects}\n", report_methods.effects_words(result)], as_json
    )


def share(text: str) -> float:
    """Parse 2% or 0.02."""
    number = text.rstrip().removesuffix("%")
    percent = text.rstrip().endswith("%")
    try:
        return float(number) / (100.0 if percent else 1.0)
    except ValueError:
        raise typer.BadParameter(f"--tolerance {text!r}: write 2% or 0.02") from None


@terminal.verb(sim_app, "ceiling")
def sim_ceiling(scene: terminal.SceneName, as_json: terminal.Json = False) -> None:
    """Compute the largest stable active damping: of the device alone, with the scene's
    environment, and hot or cold.
    """
    loaded = scenes.load_scene(scene)
    found = scene_studies.ceiling(loaded)
    lines = [f"{_head(loaded)}\n", *report.ceiling_words(found)]
    if found.warmer:
        lines.append(f"\n{paper.text(report.ceiling_table(found))}")
    about = {"simulated": True, "scene": loaded.name, "unit": "N s/m"}
    terminal.show({**about, **store.to_json(found)}, lines, as_json)


def accuracy(
    scene: terminal.SceneName,
    quick: Annotated[
        bool, typer.Option("--quick", help="Coarse: shorter trials, fewer settings.")
    ] = False,
    plot: terminal.Plot = True,
    figure_width: terminal.FigureWidth = None,
    out: terminal.Out = terminal.HERE,
    as_json: terminal.Json = False,
) -> None:
    """Measure error against time for methods, sub-steps, precision, length and window, and with
    each effect left out.

    The first run of a scene also compiles its kernels, which are kept.
    """
    terminal.need_engine(plot)
    loaded = scenes.load_scene(scene)
    explicit = scene_studies.compare_integrators(loaded)
    plan = accuracies.plan_accuracy(loaded, scene, quick)
    with terminal.progress(as_json) as tell:
        result = accuracies.run_accuracy(plan, time.process_time_ns, tell)
    paths = []
    if plot:
        figures = {
            "accuracy": report_methods.accuracy_figure(result, figure_width),
            "integrators": report.integrators_figure(explicit, loaded.title, figure_width),
        }
        for name, figure in figures.items():
            paths += terminal.save_figure(figure, out, f"{loaded.name}-{name}", as_json)
    found = {
        "simulated": True,
        "scene": loaded.name,
        "title": loaded.title,
        "quick": quick,
        **store.to_json(result, skip=("plan",)),
        "integrators": store.to_json(explicit),
        "figures": paths,
    }
    measured = paper.text(report_methods.accuracy_table(result))
    lines = [f"{_head(loaded)}\n\n{measured}\n", *report_methods.accuracy_words(result)]
    terminal.show(found, lines, as_json)


@terminal.verb(studies_app, "remedies")
def remedies(
    names: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[SCENE...]", help="Scenes or devices (default: the five shipped ones)."
        ),
    ] = None,
    quick: Annotated[
        bool, typer.Option("--quick", help="Without trials, on coarser grids and in fewer hands.")
    ] = False,
    seconds: common.Seconds = 90.0,
    seeds: Annotated[
        int,
        typer.Option(
            "--seeds",
            metavar="N",
            min=0,
            help="Noise realisations for each search of K; 0: no trials.",
        ),
    ] = 4,
    out: common.Out = None,
    as_json: terminal.Json = False,
) -> None:
    """Compare what makes a display render more: a faster loop, a shorter delay, another velocity
    filter, active damping, pairs of them, and a virtual coupling; also FOAW, Levant's
    differentiator, PO/PC and an energy tank, by the energy that the display gives out in passive
    hands.

    Ctrl-C is safe: the same command with the same --out continues with the remaining trials and
    energy rows.
    """
    terminal.need_engine()
    scenes_asked = tuple(common.scene_of(name) for name in names or remedy_studies.SCENES)
    params = remedy_studies.RemediesParams(scenes_asked, quick=quick, seconds=seconds, seeds=seeds)
    folder = common.folder(out, "remedies")
    kept = store.TrialStore(folder / "trials.jsonl")
    with common.keeping(kept, folder), terminal.progress(as_json) as tell:
        rows = remedy_studies.run_remedies(params, kept, tell)
        energies = port_energy.run_port_energy(params, rows, kept, tell)
    found = {"simulated": True, "quick": quick, "seconds": seconds, "seeds": seeds}
    found |= {"rows": store.to_json(rows), "energy": store.to_json(energies)}
    common.write_summary(folder, {"kind": "remedies", **found})
    tables = report_methods.remedies_table(rows), report_methods.port_energy_table(energies)
    lines = [*map(paper.text, tables), REMEDIES_NOTE]
    common.show_result(found, lines, folder, (), as_json)


# --- the simulated board --------------------------------------------------------------------------
LOOPBACK = "127.0.0.1"
MOST_PORT = 65535


def sim_board(
    where: Annotated[
        str,
        typer.Option(
            "--usbip",
            metavar="[HOST:]PORT",
            help="Address for USB/IP clients; 3240 is the standard port, 0 any free one.",
        ),
    ],
    config: terminal.ConfigFile = None,
    transfer: Annotated[
        Literal["bulk", "interrupt"], typer.Option("--transfer", help="Transport of the frames.")
    ] = "bulk",
    as_json: terminal.JsonLines = False,
) -> None:
    """Offer the simulated board to the USB bus of any Linux machine by USB/IP, until Ctrl-C.

    USB/IP has no authentication: any client that reaches the port can attach the board. It is
    offered to this machine alone unless you give a HOST.
    """
    host, port = address(where)
    settings = load.load(config)
    params = build.board_params(settings)
    if params is None:
        raise ConfigError(
            f"{settings.device_file}: not a simulated device; name one with `device` in"
            f" {settings.config_file}"
        )
    usb_device.check_traits(params)

    def tell(event: str, text: str) -> None:
        if as_json:
            terminal.data_json({"event": event, "text": text, "address": server.address})
        else:
            terminal.data(text)

    simulated = injection.with_injections(board.make_board(params), params)
    device = usb_device.UsbDevice(simulated, transfer, params.hello_s)
    server = usbip.UsbipServer(
        device, MonotonicClock(), host, port, lambda text: tell("peer", text)
    )
    on_stop(server.stop)
    place, _, place_port = server.address.rpartition(":")
    tell(
        "ready",
        f"SIMULATED board {params.serial} at {server.address}; attach it with\n"
        f"  usbip --tcp-port {place_port} attach -r {place.strip('[]')} -b {usbip.BUS_ID}",
    )
    server.serve()


def address(text: str) -> tuple[str, int]:
    """Return host and port of [HOST:]PORT, a HOST of IPv6 in brackets. BadParameter."""
    host, _, port = text.rpartition(":")
    if not port.isdecimal() or int(port) > MOST_PORT:
        raise typer.BadParameter(f"--usbip {text!r}: write PORT or HOST:PORT, PORT 0..{MOST_PORT}")
    bracketed = host.startswith("[") and host.endswith("]")
    if ":" in host and not bracketed:
        raise typer.BadParameter(f"--usbip {text!r}: write an IPv6 address as [HOST]:PORT")
    return host.strip("[]") or LOOPBACK, int(port)
