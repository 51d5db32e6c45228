"""Limits: pure checks with the limit as an argument. Floats in, floats out; NaN never passes."""


def clamp(force: float, limit: float) -> float:
    """`force` [N] held inside +-limit; NaN becomes 0."""
    if force > limit:
        return limit
    if force < -limit:
        return -limit
    if force != force:
        return 0.0
    return force


def approach(value: float, target: float, step: float) -> float:
    """`value` moved towards `target` by at most `step` >= 0."""
    if target > value + step:
        return value + step
    if target < value - step:
        return value - step
    return target
