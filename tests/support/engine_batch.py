"""A batch: the same bytes however it is spread, records that agree with sums, divergence with
its time, refusals.
"""

import numpy as np

from support.devices import COUNTS, DRY, LIMIT, STAR, device

WEIR = device(*STAR, DRY, COUNTS, LIMIT)
RNG = np.random.default_rng(1)
PARAMS = np.column_stack(
    [RNG.uniform(0, 100, 70), RNG.uniform(0, 2, 70), RNG.uniform(-0.002, 0.01, 70)]
)
SUMS = ("sigma_v_m_per_s", "max_force_n", "work_j", "min_energy_j", "samples")


def same_bytes(one, other):
    return all(
        np.asarray(getattr(one, name)).tobytes() == np.asarray(getattr(other, name)).tobytes()
        for name in (*SUMS, "velocity_m_per_s", "torque_n")
    )
