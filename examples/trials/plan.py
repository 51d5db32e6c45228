"""The thirty trials: device, environment, and truth of each.

Virtual damping, mass and active damping of a trial are chosen. Its stiffness is a share of the
edge, the minimum stiffness predicted not to be passive with these. Shares within NEAR of 1 are near
the edge, on either side. For each device two trials are clearly passive, two are near the edge, one
is clearly not passive but stable, and one is unstable.

The truth is that of the exact linear theory of the scene:

    unstable      the spectral radius of one tick of the loop is 1 or more, without dry friction
    passive       stable, and Re Z of the recorded channels is above 0 all over BAND_HZ
    not passive   stable, and Re Z is below 0 somewhere in it
    margin        the minimum Re Z there [N s/m]; an unstable trial has none

Dry friction is nonlinear. It counts as its equivalent damping under the perturbation of the trial
(`hapticd.model.linearise`). Re Z of simulated trials of 600 s is within 0.15 N s/m of that, and
within 0.1 N s/m near the edge. No margin of a device with friction is smaller than 0.1
(tests/acceptance/test_example_trials.py). Counts of encoder and converter are left out: they add
noise, but no force that follows the motion.

No truth may depend on friction: no trial may be stable with it and unstable without it. A test
checks this.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from random import Random
from typing import Any

import numpy as np

from hapticd import load_scene
from hapticd.core.units import DEFAULT_BAND_HZ
from hapticd.model.loop import spectral_radius
from hapticd.model.scene import Excitation, Scene
from hapticd.zwidth.limits import predicted_limit
from hapticd.zwidth.sources import Display, display

__all__ = ["BAND_HZ", "SECONDS", "TrialSpec", "known", "specs", "truth_json", "truth_of"]

BAND_HZ = DEFAULT_BAND_HZ
SECONDS = 12.288
NEAR = 0.05
ROUNDED = 1e-9
DIGITS = 3  # of a stiffness
SEED = 20081  # of the order of the trials, and of their noise
SCENES = Path(__file__).parent / "scenes"
FORCE_GAINS = {"blind": 1.044}  # ratio of the force of a device to the commanded force, if not 1
# by device: share of the edge; B [N s/m], M [kg], active damping [N s/m]
CHOSEN = {
    "paper": (
        (0.45, 0.5, 0.005, 0.0),
        (0.5, 2.0, 0.0, 4.0),
        (0.95, 0.5, 0.005, 0.0),
        (1.05, 2.0, 0.0, 2.0),
        (1.5, 0.5, 0.005, 4.0),
        (8.0, 1.0, 0.0, 0.0),
    ),
    "light": (
        (0.5, 0.0, 0.0, 0.0),
        (0.6, 1.0, -0.002, 2.0),
        (0.95, 0.5, 0.0, 1.0),
        (1.05, 1.0, 0.0, 1.0),
        (1.8, 2.0, 0.0, 1.0),
        (2.0, 0.0, 0.0, 2.0),
    ),
    "heavy": (
        (0.5, 1.0, 0.0, 0.0),
        (0.6, 6.0, 0.0, 4.0),
        (0.95, 0.0, 0.02, 4.0),
        (1.05, 3.0, 0.0, 2.0),
        (1.5, 1.0, 0.02, 4.0),
        (8.0, 1.0, 0.0, 0.0),
    ),
    "flexible": (
        (0.5, 0.5, 0.005, 0.0),
        (0.6, 1.0, 0.0, 2.0),
        (0.95, 1.0, 0.0, 0.0),
        (1.03, 0.5, 0.005, 1.0),
        (1.5, 1.0, 0.0, 2.0),
        (4.0, 0.5, 0.0, 0.0),
    ),
    "blind": (
        (0.5, 0.5, 0.0, 0.0),
        (0.5, 0.0, 0.005, 2.0),
        (0.95, 0.5, 0.005, 2.0),
        (1.05, 0.0, 0.005, 2.0),
        (1.5, 0.0, 0.005, 1.0),
        (4.0, 1.0, 0.0, 1.0),
    ),
}


@dataclass(frozen=True)
class TrialSpec:
    """One trial. `environment`: K [N/m], B [N s/m], M [kg] as commanded; `share`: of the edge."""

    name: str
    device: str
    share: float
    environment: tuple[float, float, float]
    active_damping_ns_per_m: float
    seed: int

    @property
    def rendered(self) -> tuple[float, float, float]:
        """K, B, M as rendered by the device."""
        gain = FORCE_GAINS.get(self.device, 1.0)
        stiffness, virtual_damping, mass = self.environment
        return gain * stiffness, gain * virtual_damping, gain * mass

    @property
    def scene(self) -> Scene:
        """The scene of its device."""
        return scene_of(self.device)

    @property
    def excitation(self) -> Excitation:
        """The noise of its probe."""
        return replace(self.scene.noise, seed=self.seed)


def scene_of(device: str) -> Scene:
    """The scene of a device by its name in CHOSEN."""
    return load_scene(str(SCENES / f"{device}.toml"))


@cache
def known(device: str) -> Display:
    """Return the predictions for the device."""
    return display(scene_of(device))


def specs() -> tuple[TrialSpec, ...]:
    """Return the thirty trials, in the order of their names, which is independent of
    the devices.
    """
    found = list(drawn())
    Random(SEED).shuffle(found)
    return tuple(
        replace(spec, name=f"trial-{number:02d}", seed=SEED + number)
        for number, spec in enumerate(found, 1)
    )


def drawn() -> Iterator[TrialSpec]:
    """Yield the trials of CHOSEN, without name and seed."""
    for device, chosen in CHOSEN.items():
        gain = FORCE_GAINS.get(device, 1.0)
        for share, virtual_damping, mass, level in chosen:
            base = (0.0, gain * virtual_damping, gain * mass)
            edge = predicted_limit(known(device), level, 0, base, BAND_HZ) / gain
            stiffness = float(f"{share * edge:.{DIGITS}g}")
            yield TrialSpec("", device, share, (stiffness, virtual_damping, mass), level, 0)


def truth_of(spec: TrialSpec) -> dict[str, Any]:
    """Return the truth of the trial: its entry in truth.json."""
    device = known(spec.device)
    point = np.array([spec.rendered])
    level = spec.active_damping_ns_per_m
    stable = spectral_radius(device.model, point, level, device.filters)[0] < 1.0
    found = device.predicted(point, level, BAND_HZ)
    margin = float(found.margin_ns_per_m[0])
    answer = ("passive" if margin > 0.0 else "not_passive") if stable else "unstable"
    return {
        "truth": answer,
        "margin_n_s_per_m": round(margin, 5) if stable else None,
        "worst_hz": round(float(found.worst_hz[0]), 1) if stable else None,
        "near_edge": abs(spec.share - 1.0) <= NEAR + ROUNDED,
        "share_of_edge": spec.share,
        "device": spec.device,
    }


def truth_json(chosen: tuple[TrialSpec, ...]) -> dict[str, Any]:
    """Return the content of truth.json."""
    return {
        "band_hz": list(BAND_HZ),
        "trials": {spec.name: truth_of(spec) for spec in chosen},
    }
