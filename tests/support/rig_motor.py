"""`rig motor` on a board whose true sign, gain and offset differ from its device file."""

from hapticd.model.params import TouchParams
from hapticd.rig.steps.motor import (
    Masses,
)

FRICTION = TouchParams(coulomb_n=0.03, static_n=0.03)
FREE = {"lower_stop_m": -0.5, "upper_stop_m": 0.5}
HUNG = Masses((0.0, 0.025, 0.05, 0.075, 0.1))


def nothing(request):
    """Ignore the request: no person is present."""
