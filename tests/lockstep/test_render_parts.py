"""Estimators of the velocity, PO/PC and the tank: what their authors say of them, exact energies,
and the same bits in a kernel.
"""

from fractions import Fraction
from math import floor

import numpy as np
import pytest
from support.devices import COUNTS, DRY, LIMIT, TWO_MASSES, device
from support.models import environment_tuple

from hapticd.core.environment import Environment
from hapticd.render.law import at_rest, design_coefficients, render
from hapticd.zwidth.engine.batch import simulate
from hapticd.zwidth.engine.parts import CONTROLLERS, ESTIMATORS, PERIODS, WINDOW, LawPart

RATE_HZ = 1000.0
COUNT_M = 1e-6
TIME_S = np.arange(2000) / RATE_HZ
SINE_M = 1e-3 * np.sin(2.0 * np.pi * 3.0 * TIME_S)
SINE_M_PER_S = 1e-3 * 6.0 * np.pi * np.cos(2.0 * np.pi * 3.0 * TIME_S)
FASTEST_M_PER_S2 = 1e-3 * (6.0 * np.pi) ** 2
SETTLED = slice(500, None)


def counted(position_m):
    return np.floor(position_m / COUNT_M + 0.5) * COUNT_M


def velocities(part: LawPart, positions):
    """Of the part over `positions`, from rest at the first one."""
    memory = part.at_rest(float(positions[0]))
    found = []
    for x in positions:
        v, memory = ESTIMATORS[part.kind](float(x), memory, part.numbers)
        found.append(v)
    return np.array(found)


def longest_window(positions, at, bound):
    """The window of FOAW in whole numbers, by its definition: (slope a period, periods)."""
    exact = [Fraction(float(x)) for x in positions[: at + 1]]
    found = Fraction(0), 0
    for n in range(1, PERIODS + 1):
        slope = (exact[at] - exact[max(at - n, 0)]) / n
        line = [exact[at] - j * slope for j in range(n + 1)]
        misses = [abs(line[j] - exact[max(at - j, 0)]) for j in range(n + 1)]
        if max(misses) > Fraction(bound):
            break
        found = slope, n
    return found


def test_window_is_the_longest_that_misses_no_sample():
    rng = np.random.default_rng(1)
    positions = counted(np.cumsum(rng.normal(0.0, 3e-7, 300)) + SINE_M[:300])
    positions -= positions[0]
    bound = 1.0001 * COUNT_M  # off the grid: rounding decides nothing
    found = velocities(LawPart.foaw(bound, RATE_HZ), positions)
    expected = [longest_window(positions, at, bound) for at in range(300)]
    assert found == pytest.approx([float(slope) * RATE_HZ for slope, _ in expected], abs=1e-12)
    lengths = {n for _, n in expected}
    assert min(lengths) < 4
    assert max(lengths) == PERIODS


def test_window_gives_the_slope_of_a_ramp():
    found = velocities(LawPart.foaw(COUNT_M, RATE_HZ), 0.05 * TIME_S)
    assert found[PERIODS:] == pytest.approx(0.05)


def test_window_is_finer_than_a_difference_where_motion_is_slow():
    """A ramp of a third of a count a period: the difference is 0 or a whole count."""
    slow_m_per_s = COUNT_M * RATE_HZ / 3.0
    positions = counted(slow_m_per_s * TIME_S)
    found = velocities(LawPart.foaw(COUNT_M, RATE_HZ), positions)[PERIODS:]
    assert abs(found - slow_m_per_s).max() <= COUNT_M * RATE_HZ / PERIODS
    assert abs(np.diff(positions) * RATE_HZ - slow_m_per_s).max() > 0.6 * COUNT_M * RATE_HZ


def test_window_shrinks_to_a_difference_when_the_velocity_jumps():
    positions = np.where(TIME_S < 1.0, 0.0, 0.1 * (TIME_S - 1.0))
    found = velocities(LawPart.foaw(COUNT_M, RATE_HZ), positions)
    assert found[1000] == 0.0
    assert found[1001] == pytest.approx(0.1)


def test_differentiator_follows_the_equations_of_its_author():
    """Euler's rule on Levant's equations, with l = 1.5 sqrt C and a = 1.1 C."""
    c = 2.0
    found = velocities(LawPart.levant(c, RATE_HZ), SINE_M[:200])
    z = u = 0.0
    expected = []
    for x in SINE_M[:200]:
        v = u - 1.5 * c**0.5 * abs(z - x) ** 0.5 * np.sign(z - x)
        expected.append(v)
        z, u = z + v / RATE_HZ, u - 1.1 * c * np.sign(z - x) / RATE_HZ
    assert found == pytest.approx(expected, rel=1e-9, abs=1e-15)


def test_differentiator_is_exact_but_for_sampling():
    found = velocities(LawPart.levant(1.2 * FASTEST_M_PER_S2, RATE_HZ), SINE_M)
    assert abs(found - SINE_M_PER_S)[SETTLED].max() < 0.05 * SINE_M_PER_S.max()
    slower = velocities(LawPart.levant(0.2 * FASTEST_M_PER_S2, RATE_HZ), SINE_M)
    assert abs(slower - SINE_M_PER_S)[SETTLED].max() > 0.5 * SINE_M_PER_S.max()


@pytest.mark.parametrize("counts", [1.0, 16.0])
def test_error_of_the_differentiator_grows_with_the_root_of_the_noise(counts):
    """Levant 1998, theorem 2: for noise e the error is of the order of sqrt(C e)."""
    coarse_m = counts * COUNT_M
    c = 1.2 * FASTEST_M_PER_S2
    positions = np.floor(SINE_M / coarse_m + 0.5) * coarse_m
    found = velocities(LawPart.levant(c, RATE_HZ), positions)
    error = abs(found - SINE_M_PER_S)[SETTLED].max()
    assert 0.5 * (c * 0.5 * coarse_m) ** 0.5 < error < 6.0 * (c * 0.5 * coarse_m) ** 0.5


# --- PO/PC ----------------------------------------------------------------------------------------


def controlled(part: LawPart, positions, law, limit=np.inf):
    """(forces, W after each tick) of an environment `law` with the part, from rest at the first
    position.
    """
    memory = part.at_rest(float(positions[0]))
    forces = []
    energies = []
    for place, x in enumerate(positions):
        force, memory = CONTROLLERS[part.kind](float(x), law(place), limit, memory, part.numbers)
        forces.append(force)
        energies.append(memory[1])
    return np.array(forces), np.array(energies)


def generator(place):
    """An environment that pushes along with the sine, and so gives energy."""
    return 0.5 * SINE_M_PER_S[place]


@pytest.mark.parametrize("limit", [np.inf, 1e-3])
def test_observer_books_force_times_displacement(limit):
    def law(place):
        return float(np.clip(generator(place), -limit, limit))

    forces, energies = controlled(LawPart.observer(), SINE_M, law, limit)
    moved = np.diff(SINE_M, prepend=SINE_M[0])
    assert energies == pytest.approx(-np.cumsum(forces * moved), abs=1e-15)
    assert abs(forces).max() <= limit


def test_observer_of_the_held_force_books_it_with_the_displacement_to_come():
    forces, energies = controlled(LawPart.held_observer(), SINE_M, generator)
    assert energies[1:] == pytest.approx(-np.cumsum(forces[:-1] * np.diff(SINE_M)), abs=1e-15)


def test_controller_takes_back_what_the_environment_gives():
    _, energies = controlled(LawPart.observer(), SINE_M, generator)
    given = np.cumsum([generator(n) for n in range(2000)] * np.diff(SINE_M, prepend=0.0))
    assert given[-1] > 1e-5
    assert energies.min() > -1e-15
    _, taken = controlled(LawPart.held_observer(), SINE_M, generator)
    assert taken[-1] > -0.05 * given[-1]


@pytest.mark.parametrize(
    "part", [LawPart.observer(), LawPart.held_observer()], ids=lambda p: p.kind
)
def test_controller_leaves_a_damper_alone(part):
    forces, _ = controlled(part, SINE_M, lambda n: -0.5 * SINE_M_PER_S[n])
    assert forces == pytest.approx(-0.5 * SINE_M_PER_S)


def test_observer_sees_the_leak_of_a_held_spring_only_by_the_held_force():
    """A spring that is held for a period gives energy in every swing: W of the force at the end of
    the displacement grows, W of the held force falls.
    """
    stiffness = 100.0
    springs = -stiffness * SINE_M
    before, after = np.diff(SINE_M) * springs[:-1], np.diff(SINE_M) * springs[1:]
    assert before.sum() > 1e-6  # given out
    assert after.sum() < -1e-6  # booked as taken up
    forces, _ = controlled(LawPart.observer(), SINE_M, lambda n: springs[n])
    assert forces == pytest.approx(springs)
    held, _ = controlled(LawPart.held_observer(), SINE_M, lambda n: springs[n])
    assert abs(held - springs).max() > 1e-4


def damped_then_driven(place):
    """A damper in the first half, then an environment that pushes along."""
    return generator(place) * (1.0 if place >= 1000 else -1.0)


def test_a_window_forgets_what_was_taken_up_before_it():
    moved = np.diff(SINE_M, prepend=0.0)
    later = slice(1000 + int(WINDOW), None)
    given = {}
    for window in (np.inf, WINDOW):
        forces, _ = controlled(LawPart.observer(window), SINE_M, damped_then_driven)
        given[window] = float((forces * moved)[later].sum())
    assert given[np.inf] > 1e-5
    assert given[WINDOW] < 1e-15


# --- tank -----------------------------------------------------------------------------------------


def test_tank_books_the_held_force_and_is_never_deep_in_debt():
    forces, energies = controlled(LawPart.tank(1e-5, 0.1, RATE_HZ), SINE_M, generator)
    taken = -np.cumsum(forces[:-1] * np.diff(SINE_M))
    assert energies[1:] == pytest.approx(taken, abs=1e-15)
    given = np.cumsum([generator(n) for n in range(2000)] * np.diff(SINE_M, prepend=0.0))
    assert energies.min() > -0.01 * given[-1]


def test_an_empty_tank_lets_no_force_through_that_would_give_energy():
    forces, _ = controlled(LawPart.tank(1e-9, 0.0, RATE_HZ), SINE_M, generator)
    moved = np.diff(SINE_M, prepend=0.0)
    assert (forces * moved).max() < 1e-15


def test_tank_lets_a_spring_give_back_what_it_has_taken():
    there_and_back = 0.5e-3 * (1.0 - np.cos(2.0 * np.pi * 0.5 * TIME_S))
    springs = -100.0 * there_and_back
    forces, _ = controlled(LawPart.tank(1e-12, 0.0, RATE_HZ), there_and_back, lambda n: springs[n])
    full = there_and_back > 0.05e-3
    assert forces[full] == pytest.approx(springs[full])


def test_tank_is_filled_to_its_level_by_a_damper_that_fades():
    level_j = 1e-6
    forces, energies = controlled(LawPart.tank(level_j, 0.2, RATE_HZ), SINE_M, lambda n: 0.0)
    velocity = np.diff(SINE_M, prepend=0.0) * RATE_HZ
    assert forces[1] == pytest.approx(-0.2 * velocity[1])
    assert energies[-1] == pytest.approx(level_j, rel=1e-3)
    assert abs(forces[-300:]).max() < 0.01 * abs(forces).max()


# --- in a kernel ----------------------------------------------------------------------------------

PARTS = [
    LawPart.foaw(0.5e-6, RATE_HZ),
    LawPart.levant(50.0, RATE_HZ),
    LawPart.observer(WINDOW),
    LawPart.held_observer(),
    LawPart.tank(1e-5, 0.1, RATE_HZ),
]
TRIALS = [[100.0, 1.0, 0.010], [50.0, 2.0, 0.0], [600.0, 0.5, -0.002], [5000.0, 8.0, 0.001]]


def replayed(part, kbm, positions, scalar):
    """Forces of the law with the part in CPython, all numbers of type `scalar`."""
    k, b, m = kbm
    environment = Environment()
    coefficients = tuple(map(scalar, design_coefficients(*environment.filters, RATE_HZ)))
    numbers = tuple(map(scalar, part.numbers))
    estimates = part.kind in ESTIMATORS
    rendered = Environment(k, 0.0 if estimates else b, m)
    inputs = [scalar(value) for value in environment_tuple(rendered, 8.0)]
    state = tuple(map(scalar, at_rest(0.0)))
    memory = tuple(map(scalar, part.at_rest(0.0)))
    forces = []
    for x in map(scalar, positions):
        if estimates:
            v, memory = ESTIMATORS[part.kind](x, memory, numbers)
            inputs[3] = -scalar(b) * scalar(v)
        force, *_, state = render(x, state, tuple(inputs), coefficients)
        if not estimates:
            force, memory = CONTROLLERS[part.kind](x, force, scalar(8.0), memory, numbers)
        memory = tuple(map(scalar, memory))
        forces.append(force)
    return np.array(forces, dtype=scalar)


@pytest.mark.parametrize(("dtype", "scalar"), [("f64", np.float64), ("f32", np.float32)])
@pytest.mark.parametrize("part", PARTS, ids=lambda part: part.kind)
def test_forces_of_a_kernel_equal_cpython_to_the_bit(part, dtype, scalar):
    model = device(*TWO_MASSES, DRY, COUNTS, LIMIT)
    result = simulate(model, TRIALS, 2.0, dtype=dtype, keep="ticks", parts=(part,))
    for kbm, positions, forces in zip(TRIALS, result.position_m, result.force_n, strict=True):
        expected = replayed(part, kbm, positions, scalar)
        assert forces.tobytes() == expected.tobytes()
        assert abs(expected).max() > 1e-3


def test_an_estimator_starts_at_rest_where_the_device_starts():
    model = device(*TWO_MASSES, COUNTS)
    start_m = 0.0123456
    for part in PARTS[:2]:
        still = simulate(
            model, [[0.0, 5.0, 0.0]], 0.2, excitation=np.zeros(800), start=(start_m, 0.0),
            keep="ticks", parts=(part,),
        )  # fmt: skip
        assert abs(still.force_n).max() == 0.0
        shown_m = floor(start_m / 0.5e-6 + 0.5) * 0.5e-6
        assert part.at_rest(shown_m)[0] == shown_m


def test_trials_without_a_part_are_compiled_without_one():
    from support.engine_kernels import ALL, shape

    from hapticd.zwidth.engine.source import kernel_source

    assert "compiled_part(" not in kernel_source(shape(ALL))
