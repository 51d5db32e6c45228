"""What may be asked of the simulated board, so that it is as unkind as a real one can be."""

from hapticd.settings.scene import schema
from hapticd.sim.injection import IN_FAULTS, OUT_FAULTS
from pages.markdown import table
from pages.schemas import described, resolved

INTRODUCTION = """# The simulated board

Without a word it is a board that does what it should. A configuration asks for more in
`[simulation]`, live and in lock-step alike: traits last, and injections strike at a tick or at
random. The same seed and the same transfers give the same faults.

## Traits: keys of `[simulation]`
"""
INJECTIONS = """## Injections: `[[simulation.injections]]`

An injection has a `kind`, a `tick` (or a `probability` at each tick; 1 is always), a `count` of
ticks for which it lasts, and a `value`. Ticks count the OUT frames that the host tries to send.
"""


def simulated_board_page() -> str:
    """Every trait and every injection: its name, the meaning of its value, its unit."""
    root = schema("config")
    simulation = resolved(root, root["properties"]["simulation"])
    traits = [
        (f"`{name}`", *described(root, field, False))
        for name, field in simulation["properties"].items()
        if name != "injections"
    ]
    strikes = [
        (f"`{kind}`", "OUT" if kind in OUT_FAULTS else "IN", fault.what, fault.value)
        for kind, fault in sorted((OUT_FAULTS | IN_FAULTS).items())
    ]
    return "\n".join(
        (
            INTRODUCTION,
            table(("key", "unit", "takes", "default", "meaning"), traits),
            INJECTIONS,
            table(("kind", "strikes", "what happens", "value (default)"), strikes),
        )
    )
