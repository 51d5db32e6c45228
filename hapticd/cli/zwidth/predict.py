"""One environment without a trial: the prediction of theory, in a second."""

from math import isfinite, log, sqrt
from typing import Annotated, Any

import typer

from hapticd.cli import terminal
from hapticd.cli.deferred import deferred_imports
from hapticd.cli.zwidth import common

with deferred_imports():
    import numpy as np

    from hapticd.model import coupled, linearise, predict
    from hapticd.zwidth import sources, store


DEVICE_OF = "fig4"  # default of --scene
LEFT_OUT = "Source of values that you omit (default: the device of fig4, and 0)."
UNITS = {"-K": "N/m", "-B": "N s/m", "-M": "kg", "--active-damping": "N s/m"}


def command(
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
                f"{option} {value:g}: a finite number of {UNITS[option]} is needed"
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
        return "none is needed: it is unstable without a hand" if not found.stable else "not sought"
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
