"""The verdict of a measurement through the probe's velocity channel. The channel of the rival
device is AC-coupled at 0.1 Hz.
"""

import pytest

from examples.weir2008.paper import LEVELS
from examples.weir2008.run import conditions
from hapticd.core.units import DEFAULT_BAND_HZ
from hapticd.model.linearise import Perturbation
from hapticd.model.predict import predict

WHITE = Perturbation()
RIVAL = "weir2008_probe_hp"
LEVEL = pytest.mark.parametrize("level", LEVELS)


def both(name, points, level, band_hz=DEFAULT_BAND_HZ):
    device = conditions(name).display
    return [
        predict(device.model, points, level, device.filters, WHITE, band_hz, recorded=seen)
        for seen in (False, True)
    ]
