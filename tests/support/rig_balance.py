"""The balance of forces: its closed forms, and synthetic records of a handle with known
parameters.
"""

import numpy as np

from hapticd.rig.excitation import noise
from hapticd.rig.steps.mechanics import Facts
from support.shaken_handle import shaken

FACTS = Facts(
    1000.0,
    dict.fromkeys(("motor", "probe", "encoder"), 0.0),
    (None, None),
    {"torque_constant_nm_per_a": 1.65, "lever_m": 1.0, "resistance_ohm": 1.6, "reference_c": 20.0},
)


def runs_of(truth, seed=0):
    """The handle shaken softly and hard under a weak spring, and hard under a stiff one."""
    free = np.concatenate((noise(5.0, 0.3, 3 * seed), noise(5.0, 0.7, 3 * seed + 1)))
    return (
        shaken(truth, free, 20.0, 0.3, seed),
        shaken(truth, noise(6.0, 0.7, 3 * seed + 2), 200.0, 0.2, seed + 1000),
    )
