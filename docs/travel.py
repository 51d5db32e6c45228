"""Largest excursion of trials, and the cost of a spring that holds the handle.

Fills two tables of docs/reproduction.md. Run `python docs/travel.py` (one minute) or
`make reproduction-docs`.

The trials are those of the paper on weir2008: 90 s of noise, from the middle of the travel. Their
scene has no ends, like that of every limit on the page, so a handle is never stopped. The limits
with a spring are predicted.

Limitations: an environment in which the device runs away; those here are passive.
"""

import tomllib
from pathlib import Path

import numpy as np
from pages.markdown import replaced, table

from examples.weir2008.paper import ADDED_NS_PER_M, LEVELS, MAIN
from examples.weir2008.run import conditions
from hapticd.core.arrays import Floats
from hapticd.settings.toml import shipped
from hapticd.zwidth.engine.batch import simulate
from hapticd.zwidth.limits import predicted_limit
from hapticd.zwidth.outcomes import Point

PAGE = Path(__file__).parent / "reproduction.md"
SEEDS = range(1, 17)
NEAR_ORIGIN: tuple[Point, ...] = (
    (0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (5.0, 0.0, 0.0), (20.0, 0.0, 0.0),
)  # fmt: skip
PLACES: dict[float, tuple[Point, ...]] = {  # K, B, M; the last ones near the limits
    0.0: (*NEAR_ORIGIN, (95.0, 0.0, 0.0), (0.0, 3.0, 0.0),
          (0.0, 0.0, -0.007), (5.0, 0.0, -0.007)),
    ADDED_NS_PER_M: (*NEAR_ORIGIN, (550.0, 0.0, 0.0), (0.0, 7.5, 0.0),
                     (0.0, 0.0, -0.022), (5.0, 0.0, -0.022)),
}  # fmt: skip
HEADINGS = (
    "active damping [N s/m]", "K [N/m]", "B [N s/m]", "M [g]", "farthest, mean [mm]",
    "farthest, all trials [mm]", "beyond the travel",
)  # fmt: skip
SPRINGS_N_PER_M = (0.0, 1.0, 5.0, 20.0)
BESIDE = ("K [N/m]", "B off [N s/m]", "M off [g]", "B on [N s/m]", "M on [g]")


def travel_m() -> float:
    """Return the assumed travel to each side of the middle."""
    device = (shipped("config") / "devices" / f"{MAIN}.toml").read_text()
    return float(tomllib.loads(device)["travel"]["upper_m"])


def farthest_m(level: float, seed: int) -> Floats:
    """Return the largest distance from the start (n,) in a trial of each of PLACES."""
    given = conditions(MAIN)
    found = simulate(
        given.scene, PLACES[level], given.seconds, seed, active_damping=level, start=(0.0, 0.0),
        excitation=given.excitation, substeps=given.substeps, keep="ticks",
    )  # fmt: skip
    return np.array([abs(found.traces(trial)[0]).max() for trial in range(len(PLACES[level]))])


def measured() -> list[tuple[str, ...]]:
    """Return a line for each environment."""
    lines: list[tuple[str, ...]] = []
    for level in LEVELS:
        found = np.array([farthest_m(level, seed) for seed in SEEDS])
        for (k, b, m), one in zip(PLACES[level], found.T, strict=True):
            far = (f"{1e3 * one.mean():.1f}", f"{1e3 * one.min():.1f}-{1e3 * one.max():.1f}")
            beyond = f"{(one > travel_m()).sum()} of {one.size}"
            lines.append((f"{level:g}", f"{k:g}", f"{b:g}", f"{1e3 * m:g}", *far, beyond))
    return lines


def beside_spring(stiffness_n_per_m: float) -> tuple[str, ...]:
    """Return a line of the predicted limits of B and M, with that K."""
    base = (stiffness_n_per_m, 0.0, 0.0)
    device = conditions(MAIN).display
    cells = [f"{stiffness_n_per_m:g}"]
    for level in LEVELS:
        cells.append(f"{predicted_limit(device, level, 1, base):.2f}")
        cells.append(f"{1e3 * predicted_limit(device, level, 2, base):.2f}")
    return tuple(cells)


if __name__ == "__main__":
    held = table(BESIDE, [beside_spring(one) for one in SPRINGS_N_PER_M])
    page = replaced(PAGE.read_text(), "travel", table(HEADINGS, measured()))
    PAGE.write_text(replaced(page, "held", held))
