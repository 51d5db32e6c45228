"""Fair comparison of displays: two of them bolted together have twice the K, B and M, and are not a
better display.

"Has performance really improved, or is this simply a larger device?" (Weir, Colgate and Peshkin
2008, section 2). Divided by the mass that moves, impedances [1/s], stiffness [1/s^2] and damping
[1/s] of the pair and of the single one are the same; the envelope in decibels was the same from the
start, since maximum and minimum double together. Friction and perturbation scale with the mass too,
so the density that belongs to it is per mass squared.

Envelopes measured under unlike conditions are not laid over each other unless the difference is
named.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, fields, replace

from hapticd.analysis.envelope import Edge, Envelope
from hapticd.errors import AnalysisError

CLOSE = 0.02  # relative difference of numbers that counts as none


@dataclass(frozen=True, slots=True)
class Conditions:
    """Under which an envelope was found. `mass_kg` is all that moves at the port; it and
    `device` may differ freely.
    """

    device: str
    mass_kg: float
    port: str = "probe"
    probe_mass_kg: float = 0.0
    rate_hz: float = 1000.0
    filters: str = "100 Hz, 72 Hz"
    band_hz: tuple[float, float] = (2.0, 500.0)
    estimator: str = "spa"
    grip: str = "free"
    perturbation_psd_n2_per_hz: float = 0.0
    judged_hz: tuple[float, float] = (2.0, 500.0)  # first and last frequency that was
    confidence: float = 0.95
    seconds: float = 90.0  # of a trial
    simulated: bool = True


FREE = ("device", "mass_kg")
PER_MASS = {
    "probe_mass_kg": 1,
    "perturbation_psd_n2_per_hz": 2,
}  # compared divided by that power of the mass


def differences(one: Conditions, other: Conditions) -> tuple[str, ...]:
    """Names of the conditions that are not alike, those proportional to the mass compared per
    mass.
    """
    return tuple(
        item.name
        for item in fields(Conditions)
        if item.name not in FREE and not _alike(item.name, one, other)
    )


def check_alike(conditions: Sequence[Conditions], allow: Collection[str] = ()) -> tuple[str, ...]:
    """What is unlike the first of them. AnalysisError unless `allow` names all of it.

    Alike is also what is so in itself and only unlike per mass: displays of other masses at the
    same probe, shaken alike.
    """
    first = conditions[0]
    unlike = list[str]()
    for other in conditions[1:]:
        same = [name for name in PER_MASS if _close(getattr(first, name), getattr(other, name))]
        found = [name for name in differences(first, other) if name not in same]
        unlike += found
        if refused := [name for name in found if name not in allow]:
            said = "; ".join(
                f"{name}: {getattr(first, name)!r} and {getattr(other, name)!r}" for name in refused
            )
            raise AnalysisError(
                f"{first.device} and {other.device} were measured under unlike conditions: {said}; "
                f"measure them alike, or say that it is meant: allow {', '.join(refused)}"
            )
    return tuple(dict.fromkeys(unlike))


def normalised(found: Envelope, mass_kg: float) -> Envelope:
    """`found` per kilogram of moving mass: Z/m [1/s], or Y m [s]. AnalysisError without a mass."""
    if not mass_kg > 0.0:
        raise AnalysisError(
            f"mass {mass_kg} kg: the mass that moves at the port must be positive to divide by it"
        )
    factor = 1.0 / mass_kg if found.kind == "impedance" else mass_kg
    upper, lower = (
        Edge(factor * edge.value, edge.sd, edge.owner) for edge in (found.upper, found.lower)
    )
    return replace(found, upper=upper, lower=lower)


def _alike(name: str, one: Conditions, other: Conditions) -> bool:
    a = getattr(one, name)
    b = getattr(other, name)
    if not isinstance(a, float):
        return bool(a == b)
    power = PER_MASS.get(name, 0)
    return _close(a / one.mass_kg**power, b / other.mass_kg**power)


def _close(a: float, b: float) -> bool:
    return bool(abs(a - b) <= CLOSE * max(abs(a), abs(b)))
