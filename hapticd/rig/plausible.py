"""Whether a measured scale can be meant, beside the one that the device file has.

A scale from a data sheet is rarely wrong by more than FACTOR. Beyond it a mass was typed in grams,
or the file is of another sensor, and a step that wrote it would only hide that. A sign may be the
other one: that is what the step is for.

What would break it: a sensor that was exchanged (its data sheet belongs into the file first).
"""

from hapticd.rig.result import Finding

FACTOR = 2.0  # between file and measurement, either way


def count_of(name: str, ratio: float, remedy: str) -> Finding:
    """What is to be thought of a count of the channel `name` that is `ratio` times what the device
    file says, with its sign; `remedy` where that cannot be meant.
    """
    what = f"{name}: a count is {ratio:.4g} of what the device file says"
    if not 1.0 / FACTOR <= abs(ratio) <= FACTOR:
        return Finding(what, "refused", remedy)
    if ratio < 0.0:
        return Finding(what, "warning", "its sign is the other one; the device file gets it")
    return Finding(what, "ok")
