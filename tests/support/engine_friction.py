"""Dry friction, counts and the 8 N limit: where trials come to rest, and where they do not."""

import numpy as np

from hapticd.model.effects import Coulomb, Viscous
from support.devices import RIGID

BELOW_FRICTION_N = 0.003 * np.random.default_rng(2).standard_normal(4000)
FIG4 = [[100.0, 1.0, 0.010]] * 3


RIGID_DRY = (*RIGID, Viscous(rotor_ns_per_m=0.3), Coulomb(rotor_n=0.0293))
