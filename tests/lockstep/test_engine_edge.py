"""The edge of stability: growth of simulated trials against the spectral radius of one tick, on
both sides.

Boundaries of Gil, Hulin and others for an isolated device come from the z-plane (`model.loop`,
no step of the engine in it): 1 % inside a trial must decay, 1 % outside it must grow.
"""

import numpy as np
import pytest
from support.devices import STAR, device, rigid

from hapticd.model.loop import PAPER_FILTERS, spectral_radius
from hapticd.model.scene import Excitation
from hapticd.zwidth.engine.batch import simulate

RAW = (None, None)
STILL = Excitation("none")
MASS = 0.008
T = 1e-3


def stiffness_at_edge(model, damping, filters=RAW, radius=1.0):
    """Lowest K above the calmest one at which the spectral radius passes `radius`, by bisection."""

    def radii(stiffness):
        rest = np.full(len(stiffness), damping), np.zeros(len(stiffness))
        return spectral_radius(model, np.column_stack([stiffness, *rest]), filters=filters)

    grid = np.geomspace(1.0, 4.0 * MASS / T**2, 400)
    found = radii(grid)
    calm = int(np.argmin(found))
    first = calm + int(np.argmax(found[calm:] > radius))
    low = grid[first - 1]
    high = grid[first]
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if radii(np.array([middle]))[0] <= radius else (low, middle)
    return low


def growth_per_tick(model, trials, seconds, filters):
    """Factor per tick of each trial, from the level of the force in the third and the fourth
    quarter.

    A Hann window takes the ripple at twice the frequency out of the square.
    """
    result = simulate(
        model, trials, seconds, excitation=STILL, start=(1e-3, 0.0), filters=filters, keep="ticks"
    )
    assert not result.diverged.any()
    quarter = result.force_n.shape[1] // 4
    window = np.hanning(quarter)
    third, fourth = (
        np.sqrt(result.force_n[:, k * quarter : (k + 1) * quarter] ** 2 @ window) for k in (2, 3)
    )
    return (fourth / third) ** (1.0 / quarter)


@pytest.mark.parametrize("offset", [2.4e-5, -2.4e-5, 1e-3, -1e-3])
def test_growth_equals_spectral_radius_on_both_sides(offset):
    """The paper's device and filters with a stiffness near its edge: growth of 24 parts in a
    million per tick is seen.
    """
    model = device(*STAR)
    stiffness = stiffness_at_edge(model, 1.0, filters=PAPER_FILTERS, radius=1.0 + offset)
    seconds = 60.0 if abs(offset) < 1e-4 else 4.0
    grown = growth_per_tick(model, [[stiffness, 1.0, 0.0]], seconds, PAPER_FILTERS)[0]
    assert grown - 1.0 == pytest.approx(offset, rel=2e-3)


@pytest.mark.parametrize("delay", [0.0, 0.125, 0.5, 1.0, 1.6, 2.0])
@pytest.mark.parametrize(
    ("physical", "virtual"), [(0.0, 0.1), (0.01, 0.01), (0.01, 0.15), (0.1, 0.05)]
)
def test_boundary_of_gil_and_hulin_is_met_within_one_percent(delay, physical, virtual):
    """delta = b T / m, beta = B T / m: unfiltered spring and damper on an isolated mass with
    delay.
    """
    model = rigid(physical * MASS / T, delay=delay)
    damping = virtual * MASS / T
    edge = stiffness_at_edge(model, damping)
    grown = growth_per_tick(
        model, [[0.99 * edge, damping, 0.0], [1.01 * edge, damping, 0.0]], 4.0, RAW
    )
    assert grown[0] < 1.0 < grown[1]


@pytest.mark.parametrize(
    ("beta", "alpha"),
    [(0.1, 0.180952), (0.4, 0.533333), (2 * 2**0.5 - 2, 0.686292), (1.2, 0.6), (1.8, 0.189474)],
)
def test_undamped_mass_without_delay_meets_the_jury_boundary(beta, alpha):
    """alpha = 2 beta (2 - beta) / (2 + beta), its peak 4 (3 - 2 sqrt 2)."""
    model = rigid(0.0)
    damping = beta * MASS / T
    edge = alpha * MASS / T**2
    grown = growth_per_tick(
        model, [[0.99 * edge, damping, 0.0], [1.01 * edge, damping, 0.0]], 2.0, RAW
    )
    assert grown[0] < 1.0 < grown[1]


@pytest.mark.parametrize(("delay", "upper"), [(0.0, 2.0), (1.0, 5**0.5 - 1)])
def test_virtual_mass_is_stable_below_its_known_limit(delay, upper):
    """Unfiltered: -m < M < 2 m without delay, M < (sqrt 5 - 1) m with one tick. A free mass
    drifts, so its speed is judged.
    """
    trials = [[0.0, 0.0, factor * upper * MASS] for factor in (0.99, 1.01)]
    result = simulate(
        rigid(0.0, delay=delay),
        trials,
        2.0,
        excitation=STILL,
        start=(0.0, 0.01),
        filters=RAW,
        keep="records",
    )
    late = np.abs(np.diff(result.velocity_m_per_s[:, -400::4])).max(axis=1)
    early = np.abs(np.diff(result.velocity_m_per_s[:, :400:4])).max(axis=1)
    assert late[0] < early[0]
    assert result.diverged[1] or late[1] > 2.0 * early[1]


def test_negative_virtual_mass_grows_as_the_map_says():
    """physics: (50, 0, -0.03) through the filters is unstable; it is reported as diverged, at
    the time that the radius tells.
    """
    model = rigid(0.36, delay=0.125)
    radius = spectral_radius(model, np.array([[50.0, 0.0, -0.03]]))[0]
    assert radius > 1.01
    result = simulate(
        model, [[50.0, 0.0, -0.03]], 5.0, excitation=STILL, start=(1e-6, 0.0), keep="records"
    )
    _, velocity = result.record(0)
    assert result.diverged[0]
    crest = np.maximum.accumulate(
        np.abs(velocity[: len(velocity) // 4 * 4]).reshape(-1, 4).max(axis=1)
    )
    late = np.arange(len(crest) // 3, len(crest))
    rate = np.polyfit(late, np.log(crest[late]), 1)[0]
    assert np.exp(rate) - 1.0 == pytest.approx(radius - 1.0, rel=0.02)
