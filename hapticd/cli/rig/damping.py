"""Verbs of `hapticd rig` about active damping: measured, trimmed and looked at while it works.

What would break it: as in `steps`.
"""

from hapticd.cli import terminal
from hapticd.cli.rig import steps


def damping(
    yes: steps.Yes = False,
    config: terminal.ConfigFile = None,
    instance: terminal.Instance = terminal.INSTANCE,
    as_json: terminal.Json = False,
) -> None:
    """Polarity of the active damping, N s/m per count, physical damping, and what the compensation
    leaves of the winding's resistance, by pushes and free glides with a tenth of the force.

    Let go of the handle. Writes the table `damping` and `limits.physical_damping_ns_per_m` of the
    device file.
    """
    from hapticd.rig.damping import measure
    from hapticd.settings.load import load

    step = steps.perform(
        instance, load(config), lambda client: measure(client, steps.asking(yes)), yes
    )
    steps.show(step, as_json)
