"""Force fields beside K-B-M: a unilateral wall and the soft ends of the workspace. Floats in,
newtons out.

Written for CPython and for numba alike: no attribute access, no defaults, no keyword arguments.
"""


def wall_force(
    x: float, v: float, stiffness: float, damping: float, position: float, side: float
) -> float:
    """Force [N] of a wall that is solid where (x - position) * side > 0: spring and damper,
    never pulling (Colgate 1994).
    """
    depth = (x - position) * side
    if depth > 0.0:
        push = stiffness * depth + damping * v * side
        if push > 0.0:
            return -push * side
    return 0.0


def end_force(x: float, lower: float, upper: float, stiffness: float) -> float:
    """Force [N] of the springs that begin at the ends of the workspace; 0 between them."""
    if x > upper:
        return -stiffness * (x - upper)
    if x < lower:
        return -stiffness * (x - lower)
    return 0.0
