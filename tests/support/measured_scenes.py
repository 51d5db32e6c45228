"""Small scenes for the tests of procedures, and a stopwatch that no machine can disturb."""

from collections.abc import Callable
from typing import Any

from hapticd.core.environment import Environment
from hapticd.model.effects import Coulomb, Effect, Masses, Motor, Viscous
from hapticd.model.scene import DampingStep, Excitation, Scene
from hapticd.studies.scene import SceneResult, plan_scene, run_scene

MOTOR = Motor(torque_constant_nm_per_a=0.0165, lever_m=0.01, resistance_ohm=1.6)
# options of `zwidth map`: 27 points about the set of the calibrated display
GRID_OF_27 = [
    "--stiffness",
    "0",
    "900",
    "3",
    "--viscous",
    "0",
    "6",
    "3",
    "--mass",
    "-0.01",
    "0.01",
    "3",
]
MASS_KG = 0.008
VISCOUS_NS_PER_M = 1.0
PARTS: tuple[Effect, ...] = (
    Masses(rotor_kg=MASS_KG),
    MOTOR,
    Viscous(rotor_ns_per_m=VISCOUS_NS_PER_M),
)
DRY = (Masses(rotor_kg=MASS_KG), MOTOR, Viscous(rotor_ns_per_m=0.4), Coulomb(rotor_n=0.03))

RIGID = """
title = "a rigid display"
device = "ideal"
effects = ["probe", "viscous"]
[environment]
stiffness_n_per_m = 100.0
virtual_damping_ns_per_m = 1.0
mass_kg = 0.002
[excitation]
kind = "noise"
"""


def scene(
    effects: tuple[Effect, ...] = PARTS,
    level: float = 0.0,
    seconds: float = 6.0,
    kbm: Any = (0, 0, 0),
    **more: Any,
) -> Scene:
    """Return a rigid device under noise by default; it renders `kbm`."""
    more = {"excitation": Excitation("noise"), **more}
    rendered = Environment(float(kbm[0]), float(kbm[1]), float(kbm[2]))
    return Scene(
        "small",
        "a small scene",
        "none",
        effects,
        rendered,
        (DampingStep(0.0, level),),
        seconds=seconds,
        **more,
    )


def stopwatch() -> Callable[[], int]:
    """Return a clock that advances by 1 ms per reading, so every timed call takes 1 ms."""
    now = iter(range(0, 10**15, 1_000_000))
    return lambda: next(now)


def noisy_scene() -> SceneResult:
    """Two trials of 8 s under noise, for figures and tables."""
    return run_scene(plan_scene(scene(seconds=8.0, kbm=(100.0, 0.5, 0.0))))
