"""`hapticd rig identify`: what moves, what resists, and how late force comes."""

from hapticd.cli.deferred import deferred_imports
from hapticd.cli.rig import steps

with deferred_imports():
    from hapticd.rig.steps import identify as identify_step


def identify(options: steps.StepOptions) -> None:
    """Moving mass, viscous and Coulomb friction, delay and smoothing of the force, by shaking the
    free handle with the probe for half a minute; and which assumption the residuals contradict.

    Writes the tables `model` of the device file, with which `zwidth predict`, the guard and
    `zwidth search` calculate. Signs have to be verified.
    """
    steps.run(options, identify_step.measure)
