"""Active damping at a wall in the batch engine: the same bits as the law and the rule in CPython,
and as a constant level where the rule has only one.
"""

from dataclasses import replace

import numpy as np
import pytest
from support.devices import COUNTS, DRY, LIMIT, TWO_MASSES, device
from support.models import environment_tuple

from hapticd.core.environment import Environment, WallParams
from hapticd.core.errors import ConfigError
from hapticd.model.effects import DampingDac
from hapticd.render.law import at_rest, design_coefficients, render
from hapticd.zwidth.engine.batch import BatchResult, simulate
from hapticd.zwidth.engine.contact import ContactDamping

RATE_HZ = 1000.0
LIMIT_N = 8.0
WALL = WallParams(800.0, 1.5, position_m=0.002, side=1)
RULE = ContactDamping(contact_ns_per_m=1.74, approach_m=0.0005, slew_ns_per_m_s=200.0)
MODEL = device(*TWO_MASSES, DRY, COUNTS, LIMIT, DampingDac(quantum_ns_per_m=1e-4))


def pushed(rule: ContactDamping | None, wall: WallParams = WALL, level: float = 0.0) -> BatchResult:
    return simulate(
        MODEL, [[0.0, 0.0, 0.0]], 0.5, active_damping=level, environment=Environment(wall=wall),
        excitation=np.full(400, 0.5), start=(0.0, 0.1), keep="ticks", contact=rule,
    )  # fmt: skip


def test_forces_are_those_of_law_and_rule_in_cpython_to_the_bit() -> None:
    result = pushed(RULE)
    coefficients = design_coefficients(*Environment().filters, RATE_HZ)
    state = at_rest(0.0)
    level = RULE.free_ns_per_m
    seen = set()
    expected = []
    for x in result.position_m[0].tolist():
        share = RULE.share(level)
        seen.add(share)
        part = replace(
            WALL,
            stiffness_n_per_m=share * WALL.stiffness_n_per_m,
            virtual_damping_ns_per_m=share * WALL.virtual_damping_ns_per_m,
        )
        inputs = environment_tuple(Environment(wall=part), LIMIT_N)
        force, *_, state = render(x, state, inputs, coefficients)
        expected.append(force)
        level = RULE.next_level(x, WALL, level, 1.0 / RATE_HZ)
    assert result.force_n[0].tobytes() == np.array(expected).tobytes()
    assert {0.0, 1.0} < seen
    assert min(expected) < -0.5


def test_a_rule_of_one_level_gives_the_bytes_of_that_level() -> None:
    constant = pushed(None, level=1.74)
    followed = pushed(ContactDamping(contact_ns_per_m=1.74, free_ns_per_m=1.74))
    for name in ("position_m", "force_n", "velocity_m_per_s", "work_j", "min_energy_j"):
        assert getattr(followed, name).tobytes() == getattr(constant, name).tobytes()


def test_away_from_the_wall_the_device_moves_as_without_active_damping() -> None:
    far = replace(WALL, position_m=1.0)
    free, followed = pushed(None, far), pushed(RULE, far)
    assert followed.velocity_m_per_s.tobytes() == free.velocity_m_per_s.tobytes()
    damped = pushed(None, far, level=1.74)
    assert abs(damped.velocity_m_per_s).max() < 0.5 * abs(free.velocity_m_per_s).max()


def test_trials_follow_their_own_place() -> None:
    points = [[0.0, 0.0, 0.0], [0.0, 5.0, 0.0]]
    more = {
        "seconds": 0.2, "environment": Environment(wall=WALL), "excitation": np.full(400, 0.5),
        "start": (0.0, 0.1), "keep": "ticks", "contact": RULE,
    }  # fmt: skip
    both = simulate(MODEL, points, **more)
    for place, point in enumerate(points):
        alone = simulate(MODEL, [point], **more)
        assert both.position_m[place].tobytes() == alone.position_m[0].tobytes()


def test_a_rule_without_a_wall_is_refused() -> None:
    with pytest.raises(ConfigError, match="give the environment a wall"):
        pushed(RULE, WallParams())
