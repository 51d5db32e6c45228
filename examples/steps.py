"""A whole protocol of an experiment in one call: a spring, force on, active damping on and off at
exact times, a stiffer spring, force off; and the result of each step.
"""

import argparse
import sys

from connect import arguments, connected

from hapticd.client import SequenceError, step


def main(asked: argparse.Namespace) -> None:
    """Print each step with its tick and revision, by which recordings are joined to it."""
    pause_s = asked.pause
    steps = [
        step("set", K=100, B=1),
        step("damping", value="off"),
        step("enable"),
        step("damping", value="on", after_s=pause_s),
        step("set", K=300, ramp_s=0.1, after_s=pause_s),
        step("damping", value="off", after_s=pause_s),
        step("disable", after_s=pause_s),
    ]
    with (
        connected(asked, "steps") as device,
        device.lease("environment", ttl_s=10, at_end="disable"),
    ):
        try:
            done = device.sequence(steps, lead_s=pause_s)
        except SequenceError as error:
            sys.exit(f"{error}")
    for one in done:
        guard = f"; {one.guard.text}" if one.guard else ""
        print(f"tick {one.tick}, revision {one.revision}: {one.step}{guard}")


if __name__ == "__main__":
    parser = arguments("A protocol as one call.")
    parser.add_argument("--pause", type=float, default=0.5, metavar="S", help="between two steps")
    main(parser.parse_args())
