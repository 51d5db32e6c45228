"""What a device renders passively of K, B and M, each alone, and what of K its delay costs.

The theorem says it, for every input and without friction; what is measured or predicted may reach
further by a few times, not by the factor of a mistaken unit.

What would break it: a device that renders nothing of one axis alone and much of it beside another.
"""

from dataclasses import replace
from typing import Any

from hapticd.core.environment import FilterParams
from hapticd.core.params import GuardSetup
from hapticd.guard.bases import Theorem, model_of
from hapticd.guard.environments import nothing_rendered
from hapticd.guard.safe_region import SafeRegion
from hapticd.mailbox.environment_limits import WIDEST
from hapticd.model.model import Model

__all__ = ["passive_ranges", "ranges_of"]

IDEAL_PERIODS = 0.0  # a force that acts at its sample: of the delay, the hold alone is left

Ranges = dict[str, list[float] | None]  # of K, B and M, from and to; None: nothing is passive


def passive_ranges(
    model: Model, filters: tuple[FilterParams, FilterParams], level_ns_per_m: float
) -> Ranges:
    """What `model` renders passively at that level of active damping, within WIDEST.

    `filters` are those of velocity and acceleration.
    """
    free = replace(nothing_rendered(filters), active_damping_ns_per_m=level_ns_per_m)
    region = SafeRegion(Theorem(model), model.delay_periods, 0.0)
    return region.allowed(free, WIDEST.lowest, WIDEST.highest)


def timing_cost(
    theorem: Theorem,
    filters: tuple[FilterParams, FilterParams],
    level_ns_per_m: float,
    delays: tuple[float, float],
) -> dict[str, Any]:
    """The largest K with B = M = 0 at that level of active damping, where the delay is between
    `delays` [periods], least first, beside the largest K without any delay.

    A delay that varies is outside the theorem: that both ends are passive is a convention.
    """
    free = replace(nothing_rendered(filters), active_damping_ns_per_m=level_ns_per_m)

    def stiffest(least: float, most: float) -> float:
        region = SafeRegion(theorem, most, 0.0, least)
        ends = region.allowed(free, WIDEST.lowest, WIDEST.highest)["K"]
        return ends[1] if ends else 0.0

    stiffness = stiffest(*delays)
    ideal = stiffest(IDEAL_PERIODS, IDEAL_PERIODS)
    return {
        "level_ns_per_m": level_ns_per_m,
        "stiffness_n_per_m": stiffness,
        "ideal_stiffness_n_per_m": ideal,
        "lost_share": 1.0 - stiffness / ideal if ideal else None,
    }


def ranges_of(setup: GuardSetup) -> Ranges:
    """Those of the guard's device with the most active damping that its file allows."""
    if setup.model is None:
        return {}
    rendered = setup.environment
    filters = rendered.velocity_filter, rendered.acceleration_filter
    return passive_ranges(model_of(setup.model), filters, setup.active_damping_limit_ns_per_m)
