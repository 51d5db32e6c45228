"""Every effect there is, in the order of composition. A scene names them by key; `ALWAYS` are built without being named."""

from collections.abc import Iterable

from hapticd.plant.bodies import Coupling, Hand, Load, MagnetCogging, Masses, Probe, Viscous, WorkspaceEnds
from hapticd.plant.effects import Effect
from hapticd.plant.electrical import (
    Amplifier,
    Crowbar,
    DampingCircuit,
    DampingDac,
    Delay,
    ForceDac,
    Multiplier,
    Saturation,
    Smoothing,
)
from hapticd.plant.friction import Coulomb
from hapticd.plant.sensing import AntiAlias, Encoder, ProbeAdc, SensorNoise, VelocityHighpass
from hapticd.plant.shaped_damping import ShapedDamping
from hapticd.plant.winding import Heating, InductanceError, Motor, WindingTemperature

KINDS: tuple[type[Effect], ...] = (
    Masses, Motor, Probe, Coupling, Viscous, Coulomb, Load, Hand, MagnetCogging, WorkspaceEnds,
    Delay, ForceDac, Saturation, Smoothing, Amplifier, DampingDac, DampingCircuit, ShapedDamping, Multiplier,
    WindingTemperature, Heating, InductanceError, Crowbar,
    Encoder, VelocityHighpass, AntiAlias, ProbeAdc, SensorNoise,
)  # fmt: skip
ALWAYS = (Masses.key, Motor.key)
BY_KEY = {kind.key: kind for kind in KINDS}


def in_order(effects: Iterable[Effect]) -> tuple[Effect, ...]:
    """Sorted as they are composed."""
    keys = list(BY_KEY)
    return tuple(sorted(effects, key=lambda effect: keys.index(effect.key)))
