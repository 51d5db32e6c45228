"""Devices of the guard's tests: a rigid mass with known damping, and shipped ones."""

from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

from hapticd.core.environment import Environment
from hapticd.core.params import EnvironmentLimits, GuardParams, from_plain
from hapticd.guard.judge import Judge
from hapticd.mailbox import files
from hapticd.model.effects import (
    DampingCircuit,
    Delay,
    Effect,
    Masses,
    Motor,
    PassiveHand,
    Viscous,
    WindingTemperature,
)
from hapticd.model.params import GuardSetup, ModelParams, OutputParams
from hapticd.run import supervisor
from hapticd.settings.load import load
from hapticd.settings.scene import model_params

Rows = tuple[tuple[float, ...], ...]
MASS_KG = 0.08
VISCOUS_NS_PER_M = 2.0
FREE = {"K": 0.0, "B": 0.0, "M": 0.0, "active_damping": 0.0}


def rigid(
    viscous_ns_per_m: float = VISCOUS_NS_PER_M, delay_periods: float = 0.0, rate_hz: float = 1000.0
) -> ModelParams:
    """One rigid mass on a viscous slide, driven by an ideal motor."""
    effects: tuple[Effect, ...] = (
        Masses(rotor_kg=MASS_KG),
        Motor(torque_constant_nm_per_a=1.0, lever_m=1.0, resistance_ohm=1.0),
        Viscous(rotor_ns_per_m=viscous_ns_per_m),
        Delay(periods=delay_periods),
    )
    return model_params("rigid", effects, rate_hz)


def sprung(stiffness_n_per_m: float = 100.0) -> ModelParams:
    """Return a rigid device with a spring that holds it in place."""
    effects: tuple[Effect, ...] = (
        Masses(rotor_kg=MASS_KG),
        Motor(torque_constant_nm_per_a=1.0, lever_m=1.0, resistance_ohm=1.0),
        Viscous(rotor_ns_per_m=VISCOUS_NS_PER_M),
        PassiveHand(
            mass_kg=0.01,
            damping_ns_per_m=1.0,
            stiffness_n_per_m=stiffness_n_per_m,
            grip_stiffness_n_per_m=1e4,
            grip_damping_ns_per_m=10.0,
        ),
    )
    return model_params("sprung", effects, 1000.0)


def with_hidden_growth(model: ModelParams, rate_per_s: float = 10.0) -> ModelParams:
    """Return the same device with a growing state that neither probe nor law observes."""

    def wider(rows: Rows, corner: float | None) -> Rows:
        n = len(rows[0])
        last = (0.0,) * n if corner is None else (*(0.0,) * n, corner)
        return (*(row if corner is None else (*row, 0.0) for row in rows), last)

    def blind(output: OutputParams) -> OutputParams:
        return replace(output, c0=(*output.c0, 0.0), c1=(*output.c1, 0.0))

    seen = ("encoder", "position", "velocity", "recorded_velocity", "recorded_travel")
    return replace(
        model,
        states=(*model.states, "hidden"),
        a0=wider(model.a0, rate_per_s),
        a1=wider(model.a1, 0.0),
        b0=wider(model.b0, None),
        b1=wider(model.b1, None),
        **{name: blind(getattr(model, name)) for name in seen},
    )


def over_compensated(residual_c: float) -> ModelParams:
    """Return a circuit that overestimates the winding's temperature by `residual_c`."""
    effects: tuple[Effect, ...] = (
        Masses(rotor_kg=0.005),
        Motor(torque_constant_nm_per_a=0.0165, lever_m=0.01, resistance_ohm=1.6),
        Viscous(rotor_ns_per_m=0.3),
        DampingCircuit(bandwidth_hz=1000.0),
        WindingTemperature(temperature_c=20.0, compensated_c=20.0 + residual_c),
    )
    return model_params("over-compensated", effects, 1000.0)


def setup_of(model: ModelParams | None, ceiling: float = 10.0, **changes: Any) -> GuardSetup:
    """Return a guard of that model, with the other numbers of a shipped configuration."""
    plain: dict[str, Any] = {
        "guard": GuardParams(),
        "config_hash": "hash of the servo",
        "environment": Environment(),
        "active_damping_ns_per_m": 1.74,
        "active_damping_limit_ns_per_m": ceiling,
        "active_damping_count_ns_per_m": 10.0 / 65535,
        "limits": EnvironmentLimits((-1e4, -1e2, -1e1), (1e5, 1e3, 1e1)),
        "model": model,
        "model_hash": "" if model is None else "hash of the model",
    }
    return GuardSetup(**(plain | changes))


@lru_cache(maxsize=8)
def rigid_judge(viscous_ns_per_m: float = VISCOUS_NS_PER_M, delay_periods: float = 0.0) -> Judge:
    """A judge of a rigid device."""
    return Judge(setup_of(rigid(viscous_ns_per_m, delay_periods)))


@lru_cache(maxsize=2)
def shipped_setup(device: str = "weir2008") -> GuardSetup:
    """guard.json of a configuration with that shipped device."""
    path = Path(__file__).parent / "data" / f"guard_{device}.toml"
    plain = supervisor.resolve(load(path), "guard")[files.GUARD_JSON]
    return from_plain(GuardSetup, plain)


@lru_cache(maxsize=2)
def shipped_judge(device: str = "weir2008") -> Judge:
    """A judge of that shipped device."""
    return Judge(shipped_setup(device))


def request(asked: dict[str, Any], **more: Any) -> dict[str, Any]:
    """Return a request to the worker about a change, from a free display under `refuse` unless
    `more` differs.
    """
    now = FREE | more.pop("now", {})
    return {
        "ask": "change",
        "n": 1,
        "now": now,
        "target": FREE | more.pop("target", now),
        "state": "enabled",
        "enable": False,
        "change": asked,
        "before": [],
        "after": [],
        "policy": "refuse",
        "basis": "theorem",
        "margin_ns_per_m": 0.0,
        "mode": "off",
        "level": 0.0,
        "delay_periods": None,
        "ramp_s": 0.05,
        **more,
    }


def change(judge: Judge, asked: dict[str, Any], **more: Any) -> dict[str, Any]:
    """Return the answer to a change with the fields of `request`."""
    return judge.answer(request(asked, **more))
