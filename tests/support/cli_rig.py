"""`hapticd rig` from the command line, on a simulated rig in place of a daemon."""

from contextlib import contextmanager

from hapticd.cli.rig import steps
from hapticd.core.params import ScaleParams
from hapticd.model.params import TouchParams
from support.rig_hand import Hand

FREE = {"lower_stop_m": -0.5, "upper_stop_m": 0.5, "touch": TouchParams(0.0, 0.0, 0.03, 0.03)}
EMF = ScaleParams(2.0 / 32767)  # as simulated.toml has it


def at_the_rig(monkeypatch, file):
    with Hand({**file, "emf_velocity": EMF, "probe_limit_n": 2.0}, **FREE) as found:

        @contextmanager
        def connected(instance):
            yield found.bench

        monkeypatch.setattr(steps, "connect", connected)
        monkeypatch.setattr(steps, "PAUSE_S", 0.0)
        yield found
