"""`rig verify`: known parts as the probe sees them, and the certificate."""

from hapticd.cli.app import main
from hapticd.core.params import ScaleParams, TouchParams
from hapticd.rig.steps.verify import KnownParts

FREE = {"lower_stop_m": -0.5, "upper_stop_m": 0.5, "touch": TouchParams(0.0, 0.0, 0.02, 0.02)}
EMF = ScaleParams(2.0 / 32767)  # as config/devices/simulated.toml has it
SHORT = KnownParts(seconds=6.0)


def nothing(request):
    """Whatever is asked of a person is done already."""


def verified(config, *more):
    return main(["rig", "verify", "--yes", "--seconds", "6", "--config", str(config), *more])
