"""`rig identify` on simulated boards whose mass, friction and delay are hidden from the step."""

from hapticd.model.params import TouchParams
from hapticd.run.lockstep import LockStepClient
from support.boards import board_params
from support.models import device_params, servo_params

STOPS = {"lower_stop_m": -0.05, "upper_stop_m": 0.05}
MASS_KG = 0.0093
VISCOUS = 0.41
COULOMB_N = 0.045


def nothing(request):
    """Ignore the request: no person is present."""


def bench(device=None, **board):
    touch = TouchParams(coulomb_n=COULOMB_N, static_n=1.1 * COULOMB_N)
    given = {"mass_kg": MASS_KG, "viscous_ns_per_m": VISCOUS, "touch": touch, **STOPS, **board}
    return LockStepClient(
        servo_params(device=device_params(**(device or {}))), board_params(**given)
    )
