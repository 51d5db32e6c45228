"""A device file with electronics from the netlist: weir2008's mechanics, and the circuit's numbers
with the interval of 95 % of circuits whose parts are within tolerance.

`measured` determines these numbers of one circuit, like a laboratory on the bench:

    bandwidth of the estimate, of the amplifier   -3 dB
    dR + s dL                                     back-EMF of a held rotor per ampere, at 200 Hz
    full scale of damping                         current per estimate
    offset of estimate and force                  at rest
"""

from collections.abc import Iterable
from math import tau
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit

from firmware_iface.hardware.netlist import VALUES, deck, draw, run
from firmware_iface.hardware.studies import (
    FULL_NS_PER_M,
    K_F,
    R_HAT_OHM,
    V_PER_V,
    amplifier_gain,
    corner_hz,
    driven,
    estimate_gain,
    residual_ohm,
)

__all__ = ["CIRCUITS", "NAME", "intervals", "measured", "written"]

NAME = "weir2008_circuit"
CIRCUITS = 100
SEED = 33
HZ = np.geomspace(10.0, 1e5, 81)
AT_HZ = 200.0  # where dR and dL are read: above the mechanics, below the lags
ROOT = Path(__file__).parents[2]
BASE = ROOT / "config" / "devices" / "weir2008.toml"
SERIES = ("r_sense", "r_wire", "r_on", "r_drop")  # ohm in addition to the winding
SWITCH_OHM = 0.01  # of the enabled output in power_amplifier.sub
INDUCTIVE = ("l_motor", "l_eddy", "l_wire", "l_sense")  # H that the current meets at low frequency
Measured = dict[str, float]
ABOUT = """\
# The mechanics of weir2008.toml with the circuit of firmware_iface/hardware. Written by
# `python -m firmware_iface.hardware`: electronics from ngspice, not fitted to the paper's limits.
"""


def measured(values: dict[str, float] | None = None) -> Measured:
    """Return the numbers of one circuit, in SI units."""
    given = dict(values or {})
    k_f = given.get("k_f", K_F)
    estimate = estimate_gain(HZ, given)
    amplifier = amplifier_gain(HZ, given) * k_f / K_F
    left = residual_ohm(np.array([AT_HZ]), given)[0]
    at_rest = run(deck([".op"], ["v(estimate)", "v(force)"], {**given, "b_rotor": 1e6}))[0]
    per_speed = abs(estimate[0])
    return {
        "bandwidth_hz": corner_hz(HZ, estimate),
        "amplifier_hz": corner_hz(HZ, amplifier),
        "residual_ohm": float(left.real),
        "error_h": float(left.imag / (tau * AT_HZ)),
        "full_ns_per_m": k_f * per_speed * _sum_a_per_v(given),
        "velocity_offset_m_per_s": float(at_rest["v(estimate)"][0] / per_speed),
        "force_offset_n": float(at_rest["v(force)"][0]),
    }


def _sum_a_per_v(given: dict[str, float]) -> float:
    """Return the current per volt of the scale factor's output [A/V], from its resistors and
    converter.
    """
    value = {name: given.get(name, VALUES[name].value) for name in VALUES}
    sense = value["g_ina"] * value["r_sense"]
    return value["g_dac"] * value["r_i"] / value["r_b"] / sense


def noise_psd() -> float:
    """Return the one-sided density [(m/s)^2/Hz] of the estimate at 100 Hz, with the rotor held and
    no damping.
    """
    text = deck(
        [".noise v(estimate) Vdac lin 1 100 100"],
        ["all"],
        {"b_rotor": 1e6},
        {"dac": "dc {v_ref/2} ac 1"},
    )
    spectrum = next(plot for plot in run(text) if "onoise_spectrum" in plot)
    return float((spectrum["onoise_spectrum"][0] / (K_F * V_PER_V)) ** 2)


def intervals(circuits: int = CIRCUITS, seed: int = SEED) -> dict[str, tuple[float, float]]:
    """Return the ends of the central 95 % of `circuits`, by name of `measured`."""
    rng = np.random.default_rng(seed)
    found = [measured(draw(rng)) for _ in range(circuits)]
    return {name: _ends(one[name] for one in found) for name in found[0]}


def _ends(numbers: Iterable[float]) -> tuple[float, float]:
    low, high = np.quantile(list(numbers), (0.025, 0.975))
    return float(low), float(high)


def written(nominal: Measured, spread: dict[str, tuple[float, float]], circuits: int) -> str:
    """Return the text of the device file."""
    schema, *lines = BASE.read_text().split("\n")
    body = "\n".join(line for line in lines if not line.startswith("# "))
    document: Any = tomlkit.parse(f"{schema}\n{ABOUT}{body}")
    document["name"] = "Weir 2008 display, circuit of the netlist"
    document["serial"] = "SIM-CIRCUIT"
    full_n = abs(driven(0.0, 0.0, 0.0))
    _put(document["force"], "full_scale_n", full_n, "N at 32767 counts")
    document["force"]["source"] = _text(
        "netlist, 2.5 V of the torque DAC; offset", spread["force_offset_n"], "N", circuits
    )
    _put(document["active_damping"], "full_scale_ns_per_m", FULL_NS_PER_M, "N s/m at 65535 counts")
    document["active_damping"]["source"] = _text(
        "netlist, full scale of the multiplying DAC", spread["full_ns_per_m"], "N s/m", circuits
    )
    low, high = spread["full_ns_per_m"]
    half = tomlkit.inline_table()
    half["full_scale_ns_per_m"] = float(f"{0.5 * (high - low):.3g}")
    document["active_damping"]["half_width_95"] = half
    for scale in (document["force"], document["active_damping"]):
        scale.pop("measured_by", None)  # computed from parts, not measured
    _put(document["limits"], "active_damping_ns_per_m", 9.9, "N s/m")
    _model(document["model"], nominal, spread, circuits)
    return tomlkit.dumps(document)


def _model(
    model: Any, nominal: Measured, spread: dict[str, tuple[float, float]], circuits: int
) -> None:
    model["effects"].append("inductance")
    cold = VALUES["r_motor"].value
    compensated_c = 20.0 + (R_HAT_OHM / cold - 1.0) / VALUES["tc_cu"].value
    value = {name: one.value for name, one in VALUES.items()}
    numbers = (
        ("amplifier", "bandwidth_hz", nominal["amplifier_hz"], "Hz, -3 dB"),
        ("damping_circuit", "bandwidth_hz", nominal["bandwidth_hz"], "Hz, -3 dB"),
        ("inductance", "error_h", nominal["error_h"], "H that the circuit leaves uncancelled"),
        ("amplifier_limits", "max_current_a", value["i_limit"], "A"),
        ("amplifier_limits", "max_voltage_v", value["v_supply"] - value["v_drop"], "V"),
        ("amplifier_limits", "series_ohm", _total(value, SERIES) + SWITCH_OHM, "ohm"),
        ("amplifier_limits", "inductance_h", _total(value, INDUCTIVE), "H"),
        ("winding", "temperature_c", 20.0, "degC"),
        ("winding", "compensated_c", compensated_c, "degC: the coldest winding less tolerances"),
        ("multiplier", "gain_error", 0.0, "full scale is stated in [active_damping]"),
        ("multiplier", "noise_psd", noise_psd(), "(m/s)^2/Hz, white noise of the parts alone"),
    )
    for table, key, value, comment in numbers:
        _put(model[table], key, value, comment)
    notes = (
        ("amplifier", "amplifier_hz", "Hz"),
        ("damping_circuit", "bandwidth_hz", "Hz"),
        ("inductance", "error_h", "H"),
        ("winding", "residual_ohm", "ohm left"),
        ("multiplier", "velocity_offset_m_per_s", "m/s of velocity offset"),
    )
    model["amplifier_limits"]["note"] = "netlist: values.inc"
    for table, name, unit in notes:
        model[table]["source"] = "inferred"
        model[table]["note"] = _text("netlist", spread[name], unit, circuits)
        model[table].pop("sources", None)


def _total(value: dict[str, float], names: Iterable[str]) -> float:
    return sum(value[name] for name in names)


def _text(what: str, ends: tuple[float, float], unit: str, circuits: int) -> str:
    """Return an interval as text, for a number whose table has no field for it."""
    low, high = ends
    return f"{what}: {low:.4g} to {high:.4g} {unit} in 95 % of {circuits} circuits"


def _put(table: Any, key: str, value: float, comment: str) -> None:
    """Set one number with six digits and its comment."""
    if key in table:
        table[key] = tomlkit.item(float(f"{value:.6g}"))
    else:
        table.add(key, tomlkit.item(float(f"{value:.6g}")))
    table[key].comment(comment)
