"""What `reproduce` has to fly, as a list of tasks on every core.

The kernels and the analysis leave the interpreter free, so threads suffice. Tasks of one seed follow each other, so its noise is
made once. A result is kept under a key:

    ("axis" | "set", device, level, axis, seed)    a limit
    ("edge", device, level, seed)                  K limits for each lower band edge
    ("single", device, place in SHOWN, seed)       spectra of Figs. 4 and 7
    ("grid", level, first, count)                  passive trials of a part of the grid
    ("walls",)                                     Fig. 2
"""

from collections.abc import Callable
from concurrent.futures import as_completed
from functools import partial
from itertools import product
from typing import Any

import numpy as np

from hapticd.analysis.spectra import Spectra
from hapticd.measure import reproduce_grid as grids
from hapticd.measure import reproduce_limits as searches
from hapticd.measure.executors import threads
from hapticd.measure.progress import Progress, Steps
from hapticd.measure.reproduce_limits import Limit
from hapticd.measure.reproduce_rows import FIG_4, FIG_7
from hapticd.measure.reproduce_trials import LEVELS, MAIN, SECONDS, Point, flown, subject
from hapticd.measure.walls import WallParams, plan_walls, run_walls
from hapticd.settings.scene import load_scene

GRID_PART = 64
SET_SEEDS = EDGE_SEEDS = 4
WALL_SCENE = "wall"
WALL_DAMPINGS = (0.0, 0.25, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 5.0, 6.0, 7.0, 8.0)  # Ns/m
WALL_STIFFNESSES = tuple(np.geomspace(20.0, 3000.0, 22).tolist())  # N/m
SHOWN = ((FIG_4, 0.0), (FIG_7, 0.0), (FIG_7, LEVELS[1]))  # environment and damping of the single trials

Key = tuple[Any, ...]
Task = tuple[Key, str, Callable[[], Any]]


def worked(
    devices: tuple[str, ...], seeds: tuple[int, ...], axis: list[Limit], whole: list[Limit], tell: Progress
) -> dict[Key, Any]:
    """All tasks, the longest first, on every core; `axis` and `whole` are what was predicted."""
    _compiled(devices, tell)
    tasks = [*_grid_tasks(), _walls_task()]
    for seed in seeds:
        tasks += _seed_tasks(devices, seed, axis, whole)
    done: dict[Key, Any] = {}
    with threads() as pool:
        running = {pool.submit(call): (key, what) for key, what, call in tasks}
        for ended in as_completed(running):
            key, what = running[ended]
            done[key] = ended.result()
            tell(what, len(done), len(tasks))
    return done


def _compiled(devices: tuple[str, ...], tell: Progress) -> None:
    """Every kernel, once, before there are threads that would wait for it."""
    kernels = list(product(devices, LEVELS, ("f64", "f32")))
    steps = Steps(tell, len(kernels))
    for name, level, dtype in kernels:
        steps.next(f"compiling, {name}")
        next(iter(flown(subject(name), np.zeros((1, 3)), level, seed=1, seconds=2.0, dtype=dtype)))


def _grid_tasks() -> list[Task]:
    device = subject(MAIN)
    tasks: list[Task] = []
    for level in LEVELS:
        places = grids.candidates(device, level)
        for first in range(0, len(places), GRID_PART):
            part = places[first : first + GRID_PART]
            tasks.append((("grid", level, first, len(part)), "grid search", partial(grids.searched, device, level, part)))
    return tasks


def _walls_task() -> Task:
    plan = plan_walls(WallParams(load_scene(WALL_SCENE), WALL_STIFFNESSES, WALL_DAMPINGS, LEVELS))
    return ("walls",), "walls", partial(run_walls, plan)


def _seed_tasks(devices: tuple[str, ...], seed: int, axis: list[Limit], whole: list[Limit]) -> list[Task]:
    tasks: list[Task] = []
    for reading, limits, most in (("axis", axis, seed), ("set", whole, SET_SEEDS)):
        tasks += [
            ((reading, limit.device, limit.level, limit.axis, seed), f"limits, {limit.device}", partial(_limit, limit, seed))
            for limit in limits
            if seed <= most
        ]
    for limit in axis:
        if limit.axis == 0 and seed <= EDGE_SEEDS:
            call = partial(searches.edge_limits, limit.device, limit.level, limit.predicted, seed)
            tasks.append((("edge", limit.device, limit.level, seed), "lower band edge", call))
    for name in devices:
        for place, (point, level) in enumerate(SHOWN):
            tasks.append((("single", name, place, seed), "Figs. 4 and 7", partial(_flown_one, name, point, level, seed)))
    return tasks


def _limit(limit: Limit, seed: int) -> float:
    near = limit.predicted - limit.base[limit.axis]
    return searches.simulated_limit(limit.device, limit.level, limit.axis, limit.base, near, seed)


def _flown_one(name: str, point: Point, level: float, seed: int) -> Spectra | None:
    return next(iter(flown(subject(name), np.array([point]), level, seed, SECONDS)))
