"""The first day at rigs whose truth is hidden from the steps: what they find is true, what is
broken is refused by name, and the path knows no simulated board.
"""

import functools

from support.blind_rig import BlindRig, first_day

# seeds of the benchmark begin at 1000
SEED = 3  # both signs are wrong in the template, and the motor is weaker
QUICK = "motor gain"  # the step until which a day is quick


@functools.cache
def seen(seed, until=""):
    """The day at the rig `seed`, what is true, the device as it was written, and the force."""
    with BlindRig(seed) as rig:
        day = first_day(rig, until=until)
        known = [
            (one, true)
            for result in day.results
            for one in result.values
            if (true := rig.true(one.name, result.step)) is not None
        ]
        return day, known, rig.settings.device, rig.worst_share
