"""`rig damping`: the balance of momentum against closed forms, intervals, and a board whose damping
is another than its device file's.
"""

from hapticd.core.params import TouchParams
from support.models import COUNT_N, COUNT_NS_PER_M

FRICTION = TouchParams(coulomb_n=0.03, static_n=0.03)
FREE = {"lower_stop_m": -0.5, "upper_stop_m": 0.5, "viscous_ns_per_m": 0.4}
RATE_HZ = 1000.0


def nothing(request):
    """Nobody is there who would do what is asked."""


def device(loop_limit=10.0, half=None):
    scale = {"per_count": COUNT_N, "sign": 1, "offset_count": 0.0, "half_width_95": half}
    return {
        "force": scale,
        "position": scale,
        "active_damping": {"per_count": COUNT_NS_PER_M},
        "current": {"per_count": 1e-5},
        "active_damping_limit_ns_per_m": loop_limit,
        "motor_n_per_a": 0.0,
    }
