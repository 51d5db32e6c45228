"""One bad encoder sample moves less than 1 N; a struck handle is not a glitch; a burst
is a fault.
"""

from hapticd.core.params import SafetyParams
from hapticd.mailbox.layout import Value
from support.models import device_params, servo_params

FELT = {Value.STIFFNESS: 200.0, Value.VIRTUAL_DAMPING: 1.0, Value.MASS: 0.010, Value.RAMP_S: 0.0}
LIMIT = 500.0  # m/s^2, the default of a device file
SPEED = 5.0  # m/s


def params_with(limit=LIMIT, **safety):
    device = device_params(acceleration_limit_m_per_s2=limit, speed_limit_m_per_s=SPEED)
    return servo_params(device=device, safety=SafetyParams(**safety))
