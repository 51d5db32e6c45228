"""Settings of the simulated board that make it as difficult as a real one."""

from typing import Any

from hapticd.settings.scene import schema
from hapticd.sim.injection import IN_FAULTS, OUT_FAULTS
from pages.markdown import table
from pages.schemas import described, resolved

INTRODUCTION = """# The simulated board

By default the simulated board has no faults. The table `[simulation]` of the configuration adds
them, live and in lock-step alike: traits last, and injections act at a tick or at random. The same
seed and the same transfers give the same faults.

## Traits: keys of `[simulation]`
"""
TOUCH = """## Contacts of the device: `[simulation.touch]`

Its stops yield, its bearing sticks, a hand holds, pushes or strikes the handle. All of these forces
act on the rotor. Any stiffness is stable: the force of a contact satisfies its law at the end of a
sixteenth of a tick.
"""
HANDS = """## Hands: `[[simulation.touch.hands]]`

`hold` is a spring and a damper from the position at which the handle is grasped, `push` a constant
force, `strike` half a sine. The time of a hand starts with the first frame, and continues when the
board restarts.
"""
INJECTIONS = """## Injections: `[[simulation.injections]]`

An injection has a `kind`, a `tick` (or a `probability` at each tick; 1 is always), a `count` of
ticks that it lasts, and a `value`. Ticks count the OUT frames that the host tries to send.
"""


def simulated_board_page() -> str:
    """Return every trait and every injection: its name, the meaning of its value, its unit."""
    root = schema("config")
    simulation = resolved(root, root["properties"]["simulation"])
    touch = resolved(root, simulation["properties"]["touch"]["anyOf"][0])
    hand = resolved(root, touch["properties"]["hands"]["items"])
    heads = ("key", "unit", "takes", "default", "meaning")
    strikes = [
        (f"`{kind}`", "OUT" if kind in OUT_FAULTS else "IN", fault.what, fault.value)
        for kind, fault in sorted((OUT_FAULTS | IN_FAULTS).items())
    ]
    return "\n".join(
        (
            INTRODUCTION,
            table(heads, _rows(root, simulation, ("injections", "touch"))),
            TOUCH,
            table(heads, _rows(root, touch, ("hands",))),
            HANDS,
            table(heads, _rows(root, hand, ())),
            INJECTIONS,
            table(("kind", "strikes", "what happens", "value (default)"), strikes),
        )
    )


def _rows(
    root: dict[str, Any], entry: dict[str, Any], elsewhere: tuple[str, ...]
) -> list[tuple[str, ...]]:
    """Return a row for every key of the table `entry` that is not described `elsewhere`."""
    return [
        (f"`{name}`", *described(root, field, name in entry.get("required", ())))
        for name, field in entry["properties"].items()
        if name not in elsewhere
    ]
