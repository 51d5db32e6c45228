"""Every environment judged passive and stable stays stable in 1,000 random passive hands (Colgate
and Hogan 1988).

The pairs are not tested one by one: 1,701 environments in 1,000 hands take a minute of eigenvalues
(computed once, ADR-0017). Instead, as in `model.coupled`, each angle has a circle that contains all
hands. All 1,000 are tested, by the exact pulse transfer of device and hand. No -1/C of a judged
environment is inside it; all are tested. Eigenvalues then verify the method: of environments at the
edge in all hands, and of random pairs, inside and outside. The test can fail: 5 % outside, a hand
destabilises the display.
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
    """Return (model, filters, lifted, points) of the safety analysis, without friction."""
    device = conditions(name).display
    lifted = lifted_system(device.model, level, device.filters)
    points = POINTS[lifted_passive(lifted, POINTS)]
    stable = spectral_radius(device.model, points, level, device.filters) < 1.0
    return device.model, device.filters, lifted, points[stable]
