"""`rig damping`: the balance of momentum compared with closed forms, intervals, and a board whose
damping differs from its device file.
"""

from hapticd.model.params import TouchParams
from hapticd.rig.steps.coast_down import Row
from support.models import COUNT_N, COUNT_NS_PER_M

FRICTION = TouchParams(coulomb_n=0.03, static_n=0.03)
FREE = {"lower_stop_m": -0.5, "upper_stop_m": 0.5, "viscous_ns_per_m": 0.4}
RATE_HZ = 1000.0
N_PER_A = 1.65
TRUTH = {"gain": 1.13, "loop": 0.03, "physical": 0.36, "friction": 0.03, "gravity": 0.004}


def nothing(request):
    """Ignore the request: no person is present."""


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


def made_up(random, current, gain=TRUTH["gain"], loop=TRUTH["loop"]):
    """Return rows as a step makes them, with errors in time and force."""
    rows = []
    for level in (0.0, 0.0, 0.3125, 0.625, 1.25, 2.5, 5.0, 10.0):
        for seconds, way in ((0.05, 4e-3), (0.3, 1.5e-3)):
            for side in (1.0, -1.0):
                true_s = seconds * random.uniform(0.8, 1.2)
                load = TRUTH["physical"] * way + true_s * (
                    TRUTH["friction"] - side * TRUTH["gravity"]
                )
                impulse = gain * level * way + load * (1.0 + loop * level)
                rows.append(
                    Row(
                        impulse * (1.0 + 0.002 * random.standard_normal()),
                        way,
                        true_s + 3e-4 * random.standard_normal(),
                        level * way,
                        current * load / N_PER_A * (1.0 + 0.002 * random.standard_normal()),
                        level,
                        side,
                    )
                )
    return rows
