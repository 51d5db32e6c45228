"""The first day at rigs whose parameters are hidden from the steps. Measured values are correct,
faults are refused by name, and the path does not depend on a simulated board.
"""

import functools

from support.blind_rig import BlindRig, first_day

# seeds of the benchmark begin at 1000
SEED = 3  # both signs are wrong in the template, and the motor is weaker
QUICK = "motor gain"  # the step until which a day is quick


@functools.cache
def seen(seed, until=""):
    """Return the day at the rig `seed`, the truth, the device as written, and the force."""
    with BlindRig(seed) as rig:
        day = first_day(rig, until=until)
        known = [
            (one, true)
            for result in day.results
            for one in result.values
            if (true := rig.true(one.name, result.step)) is not None
        ]
        return day, known, rig.settings.device, rig.worst_share
