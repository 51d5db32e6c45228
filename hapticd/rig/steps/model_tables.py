"""The tables of [model] that a measured device gets in its file.

Friction is the rotor's, for it was felt there; the mass is in two parts where the transmission was
seen to yield; a smoothing stands for itself where it was told from delay. Converters and limits are
those of the device file.

What would break it: an effect of the plant that becomes part of every model without being written.
"""

from math import pi

from hapticd.core.units import US_PER_S
from hapticd.rig.result import Change, Value
from hapticd.rig.steps.force_balance import Balance
from hapticd.rig.steps.mechanics import CommandPath, Facts, Mechanics, Motor


def changes_of(
    found: Balance, mechanics: Mechanics, path: CommandPath, facts: Facts
) -> list[Change]:
    """What is written, table by table."""
    tables: dict[str, dict[str, float | str]] = {
        **_masses(found, mechanics.mass),
        "motor": motor_table(facts.motor),
        "viscous": {"rotor_ns_per_m": max(0.0, mechanics.viscous.rounded)},
        "coulomb": {"rotor_n": max(0.0, mechanics.coulomb.rounded)},
        "delay": {"periods": round(path.delay.value / facts.period_us, 5)},
    }
    if path.parted:
        corner_hz = US_PER_S / (2.0 * pi * path.smoothing.value)
        tables["smoothing"] = {"corner_hz": float(f"{corner_hz:.6g}")}
    converters = ("encoder", "force_dac", "damping_dac", "probe_adc", "saturation")
    names = tuple(name for name in tables if name not in ("masses", "motor"))
    changes = [Change("model", "effects", (*names, *converters))]
    for table, numbers in tables.items():
        changes += [Change(f"model.{table}", key, value) for key, value in numbers.items()]
    return changes


def _masses(found: Balance, mass: Value) -> dict[str, dict[str, float | str]]:
    """Tables of what moves, with the transmission where it yields."""
    handle = found.handle
    if not handle.slider_kg:
        return {"masses": {"rotor_kg": mass.rounded, "slider_kg": 0.0}}
    slider = mass.value * handle.slider_kg / (handle.mass_kg + handle.slider_kg)
    rate = handle.slider_rad_s
    damping = 2.0 * handle.slider_ratio * rate * slider
    return {
        "masses": {"rotor_kg": _digits(mass.value - slider), "slider_kg": _digits(slider)},
        "coupling": {
            "stiffness_n_per_m": _digits(slider * rate**2),
            "damping_ns_per_m": _digits(damping),
        },
    }


def _digits(value: float) -> float:
    return float(f"{value:.5g}")


def motor_table(motor: Motor) -> dict[str, float | str]:
    """Torque per ampere [N m/A] and its lever [m]. Where nobody measured them, numbers that say so:
    the table has to stand, and nothing of it is predicted with.
    """
    found: dict[str, float | str] = {
        "torque_constant_nm_per_a": _digits(motor.n_per_a * motor.lever_m) or 1.0,
        "lever_m": motor.lever_m,
        "resistance_ohm": motor.ohm or 1.0,
        "reference_c": motor.reference_c,
    }
    if not motor.n_per_a:
        note = "not measured: `hapticd rig motor` with a current; no prediction depends on it"
        found |= {"source": "inferred", "note": note}
    return found
