"""`rig verify`: known parts measured by the probe, and the certificate."""

from hapticd.cli.app import main
from hapticd.core.params import ScaleParams
from hapticd.model.params import TouchParams
from hapticd.rig.steps.verify import KnownParts

FREE = {"lower_stop_m": -0.5, "upper_stop_m": 0.5, "touch": TouchParams(0.0, 0.0, 0.02, 0.02)}
EMF = ScaleParams(2.0 / 32767)  # as config/devices/simulated.toml has it
SHORT = KnownParts(seconds=6.0)


def nothing(request):
    """Ignore the request: it is already fulfilled."""


def verified(config, *more):
    return main(["rig", "verify", "--yes", "--seconds", "6", "--config", str(config), *more])
