"""The parts whose size is known, by which a display is verified: rendered, or attached by a hand.

Each is beside one environment that stays the same (BESIDE), so that the difference of two runs is
the part alone. A rendered one rests on the scales of force and position and on those of the probe
that sees it, an attached one on those of the probe alone.

What would break it: a part so large that the display with it is not passive.
"""

from dataclasses import dataclass

from hapticd.core.environment import Environment
from hapticd.rig.excitation import CENTRE
from hapticd.rig.hand import Request

__all__ = ["KnownParts"]

BESIDE = CENTRE  # what is rendered beside
SECONDS = 20.0
UNIT_N_PER_M = "N/m"
RENDERED = ("force", "position")  # tables of the device file
PROBED = ("probe_torque", "probe_velocity")


@dataclass(frozen=True)
class KnownParts:
    """What is rendered beside the environment BESIDE, and what is attached by hand (0: nothing)."""

    stiffness_n_per_m: float = 60.0
    damping_ns_per_m: float = 1.0
    mass_kg: float = 0.004
    attached_kg: float = 0.0
    spring_n_per_m: float = 0.0
    seconds: float = SECONDS  # of each run


USUAL = KnownParts()


@dataclass(frozen=True)
class Part:
    """One known part, in `unit`, and how it comes to the handle."""

    name: str
    size: float
    unit: str
    environment: Environment  # that is rendered meanwhile
    request: Request | None = None  # what a person does; None: it is rendered

    @property
    def scales(self) -> tuple[str, ...]:
        """The calibrations on which it rests."""
        return PROBED if self.request else RENDERED + PROBED


def parts_of(known: KnownParts) -> list[Part]:
    """The parts that are asked for, in their order."""
    stiffness, damping, mass = BESIDE.free
    k = known.stiffness_n_per_m
    b = known.damping_ns_per_m
    m = known.mass_kg
    found = [
        Part("rendered spring", k, UNIT_N_PER_M, Environment(stiffness + k, damping, mass)),
        Part("rendered damper", b, "N s/m", Environment(stiffness, damping + b, mass)),
        Part("rendered mass", m, "kg", Environment(stiffness, damping, mass + m)),
    ]
    if kg := known.attached_kg:
        words = f"fix {kg:g} kg firmly to the handle, and let go of it"
        found.append(Part("attached mass", kg, "kg", BESIDE, Request("attach", words, kg)))
    if spring := known.spring_n_per_m:
        words = f"put a spring of {spring:g} N/m between handle and frame, and let go"
        request = Request("spring", words, spring)
        found.append(Part("attached spring", spring, UNIT_N_PER_M, BESIDE, request))
    return found
