"""The engine compared with the same model in long double, step by step: exact for linear and for
nonlinear effects.
"""

import numpy as np

from hapticd.zwidth.engine.batch import simulate
from support.straight import Straight

TRIALS = [[100.0, 1.0, 0.010], [50.0, 2.0, 0.0], [0.0, 0.0, 0.0], [600.0, 0.5, -0.002]]
TORQUE = 0.3 * np.random.default_rng(3).standard_normal(400)


def largest_error(
    model, level=0.0, substeps=1, torque=TORQUE, environment=None, start=(0.0, 0.0), **options
):
    """Of velocity, force and position, each relative to its largest value over a trial."""
    result = simulate(
        model,
        TRIALS,
        len(torque) / 4000,
        excitation=torque,
        active_damping=level,
        substeps=substeps,
        environment=environment,
        start=start,
        keep="ticks",
        **options,
    )
    worst = 0.0
    for trial, kbm in enumerate(TRIALS):
        expected = Straight(model, kbm, environment, level, substeps, start).play(torque)
        for ours, theirs in zip(
            (result.velocity_m_per_s, result.force_n, result.position_m), expected, strict=True
        ):
            worst = max(
                worst, float(abs(ours[trial] - theirs).max() / max(abs(theirs).max(), 1e-9))
            )
    return worst
