"""`rig motor --winding`: force per ampere, ohm and back-EMF of rigs with hidden parameters."""

import numpy as np


def rests(force_n_per_a=1.65, ohm=1.6):
    current = np.linspace(-0.5, 0.5, 9)
    celsius = np.full(9, 21.0)
    return np.stack([force_n_per_a * current, current, ohm * current + 0.01, celsius], axis=1)
