"""The map that takes a laboratory 13 days: 6,384 environments, undamped and damped, by prediction
alone. CPU time of its thread.

The yardstick is numpy's einsum over the same environments, frequencies and ports: the sums of the
loop's admittances, once, and the maximum number of sums over the perturbation's band for a friction
fit. Both in turns, minimum of the rounds of each.
"""

import time
from collections.abc import Callable, Iterator

import numpy as np

from benchmarks import targets
from benchmarks.figures import Figure, compared
from hapticd.model.compose import compose
from hapticd.model.linearise import Perturbation
from hapticd.model.loop import port_states
from hapticd.model.model import Model
from hapticd.model.predict import coulomb, frequencies, predict
from hapticd.settings.scene import load_scene
from hapticd.zwidth.passive_set import grid

TARGETS = targets.of("predict_map")
AXES = (np.linspace(0.0, 1100.0, 12), np.linspace(-1.0, 8.0, 19), np.linspace(-0.024, 0.03, 28))
LEVELS_NS_PER_M = (0.0, 1.74)
SCENE = "fig7"
# repetitions of the sums in a round: for about the same time
ROUNDS = 7
TIMES = 5
FITTING = 40  # sums over the band for each body with friction
TOGETHER = 1024  # environments at once: fits into the cache, for both


def measure() -> Iterator[Figure]:
    """Yield the seconds of CPU for both levels; linearised friction, stability and margin of every
    environment.
    """
    model = compose(load_scene(SCENE))
    points = grid(AXES)
    assert len(points) == 6384
    sums = _einsum(model, points)
    taken: dict[str, list[float]] = {"ours": [], "einsum": []}
    for _ in range(ROUNDS):
        begin = time.thread_time()
        for level in LEVELS_NS_PER_M:
            predict(model, points, level, perturbation=Perturbation())
        middle = time.thread_time()
        for _ in range(TIMES * len(LEVELS_NS_PER_M)):
            sums()
        taken["ours"].append(middle - begin)
        taken["einsum"].append((time.thread_time() - middle) / TIMES)
    yield compared(
        "predict_map_ratio",
        TARGETS["predict_map_ratio"],
        min(taken["ours"]),
        "s",
        min(taken["einsum"]),
    )


def _einsum(model: Model, points: np.ndarray) -> Callable[[], None]:
    """Return sums of the same shapes, without physics, for one level."""
    band = frequencies(perturbation=Perturbation()).size
    ports = len(port_states(model))
    rubbing = int((coulomb(model) > 0.0).sum())
    draw = np.random.default_rng(1)
    basis = draw.standard_normal((1 + ports**2, 4, band)) + 1j
    kbm = np.column_stack((np.ones(len(points)), points))
    weight = draw.random(band)

    def run() -> None:
        for first in range(0, len(points), TOGETHER):
            found = np.einsum("nk,pkf->pnf", kbm[first : first + TOGETHER], basis)
            power = found[0].real ** 2
            for _ in range(FITTING * rubbing):
                np.einsum("nf,nf,f->n", power, power, weight)

    return run
