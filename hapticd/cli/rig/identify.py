"""`hapticd rig identify`: what moves, what resists, and how late force comes."""

from hapticd.cli import terminal
from hapticd.cli.rig.steps import Yes, asking, perform, show


def identify(
    yes: Yes = False,
    config: terminal.ConfigFile = None,
    instance: terminal.Instance = terminal.INSTANCE,
    as_json: terminal.Json = False,
) -> None:
    """Moving mass, viscous and Coulomb friction, delay and smoothing of the force, by shaking the
    free handle with the probe for half a minute; and which assumption the residuals contradict.

    Writes the tables `model` of the device file, with which `zwidth predict`, the guard and
    `zwidth search` calculate. Signs have to be verified.
    """
    from hapticd.rig.steps.identify import measure
    from hapticd.settings.load import load

    found = perform(instance, load(config), lambda client: measure(client, asking(yes)), yes)
    show(found, as_json)
