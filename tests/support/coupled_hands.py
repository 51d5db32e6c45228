"""Every environment called passive and stable stays stable in 1,000 random passive hands (Colgate
and Hogan 1988).

Not pair by pair: 1,701 environments in 1,000 hands are a minute of eigenvalues (made once,
ADR-0017). Instead, as `model.coupled` says, a circle at each angle that no hand leaves (all
1,000 are tried, by the exact pulse transfer of device and hand), and which no called environment's
-1/C enters (all are tried). Eigenvalues then check that this is so: of environments at the edge in
all hands, and of random pairs, inside and outside. And it can fail: 5 % outside a hand shakes the
display.
"""

from functools import cache

import pytest

from examples.weir2008.paper import LEVELS
from examples.weir2008.run import POINTS, conditions
from hapticd.model.loop import spectral_radius
from hapticd.model.theorem import lifted_passive, lifted_system
from support.passive_hands import Hand, random_hands

ROUNDING = 1e-9  # of an eigenvalue of a mode without loss
LEVEL = pytest.mark.parametrize("level", LEVELS)


@cache  # not when it is imported: each worker collects all tests
def hands() -> list[Hand]:
    """A thousand random passive hands."""
    return random_hands(1000)


def called(name, level):
    """(model, filters, lifted, points): what safety decides, without friction."""
    device = conditions(name).display
    lifted = lifted_system(device.model, level, device.filters)
    points = POINTS[lifted_passive(lifted, POINTS)]
    stable = spectral_radius(device.model, points, level, device.filters) < 1.0
    return device.model, device.filters, lifted, points[stable]
