"""A wall at x = 1 mm: find the maximum stiffness that the guard permits, with and without active
damping, and render it.
"""

import argparse

from connect import arguments, connected, judged, permitted

from hapticd.client import Client


def greatest(device: Client, damping: float) -> float:
    """Return the maximum stiffness [N/m] of the wall, by bisection with the guard's verdicts."""
    low = 0.0
    high = 5000.0
    judged(lambda: device.damping(damping))
    while high - low > 10.0:
        middle = 0.5 * (low + high)
        wall = {"stiffness_n_per_m": middle, "position_m": 1e-3, "side": 1}
        if permitted(device, wall=wall):
            low = middle
        else:
            high = middle
    return low


def main(asked: argparse.Namespace) -> None:
    """Find and render the wall without and with damping."""
    with (
        connected(asked, "wall", strict=True) as device,
        device.lease("environment", at_end="disable"),
    ):
        device.set(K=0, B=0, M=0, ramp_s=0)  # at once: force on begins without an environment
        judged(device.enable)
        for damping in (0.0, 1.74):
            stiffness = greatest(device, damping)
            print(f"with {damping:g} N s/m of active damping: a wall of {stiffness:.0f} N/m")
        device.disable()
        device.set(wall={"stiffness_n_per_m": 0.0})


if __name__ == "__main__":
    main(arguments("The stiffest wall that is passive.").parse_args())
