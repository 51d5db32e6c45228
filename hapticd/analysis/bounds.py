"""What a device renders passively of K, B and M, each alone.

The theorem says it, for every input and without friction; what is measured or predicted may reach
further by a few times, not by the factor of a mistaken unit.

What would break it: a device that renders nothing of one axis alone and much of it beside another.
"""

from hapticd.analysis.allowed import Judgement
from hapticd.analysis.bases import Theorem, model_of
from hapticd.environment import Environment, FilterParams
from hapticd.mailbox.environment_limits import WIDEST
from hapticd.params import GuardSetup
from hapticd.plant.model import Model

Ranges = dict[str, list[float] | None]  # of K, B and M, from and to; None: nothing is passive


def passive_ranges(
    model: Model, filters: tuple[FilterParams, FilterParams], level_ns_per_m: float
) -> Ranges:
    """What `model` renders passively at that level of active damping, within WIDEST.

    `filters` are those of velocity and acceleration.
    """
    free = Environment(
        velocity_filter=filters[0],
        acceleration_filter=filters[1],
        active_damping_ns_per_m=level_ns_per_m,
    )
    judgement = Judgement(Theorem(model), model.delay_periods, 0.0)
    return judgement.allowed(free, WIDEST.lowest, WIDEST.highest)


def ranges_of(setup: GuardSetup) -> Ranges:
    """Those of the guard's device with the most active damping that its file allows."""
    if setup.model is None:
        return {}
    rendered = setup.environment
    filters = rendered.velocity_filter, rendered.acceleration_filter
    return passive_ranges(model_of(setup.model), filters, setup.active_damping_limit_ns_per_m)
