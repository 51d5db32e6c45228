"""Ours against programs of other people: tests/oracles/make_foreign.py asked them, and says with
which versions.
"""

import json
from typing import Any

import numpy as np
import pytest
from support.tree import TESTS

from hapticd.model.theorem import PAPER_FILTERS, required_damping
from hapticd.signal.assess import periodic
from hapticd.signal.impedance import impedance

ORACLES: dict[str, Any] = json.loads(
    (TESTS / "support" / "data" / "foreign_oracles.json").read_text()
)
NEEDED = ORACLES["needed"]
NAMED = [f"{one['environment']} filters {one['filters']}" for one in NEEDED]


def test_answers_name_the_versions_that_gave_them() -> None:
    assert ORACLES["control"] == "0.10.2"
    assert ORACLES["best_linear_approximation"] == "0.1.1"


def test_multisine_has_the_value_and_variance_of_best_linear_approximation() -> None:
    asked = ORACLES["approximation"]
    velocity = np.array(asked["velocity_m_per_s"])
    force = np.repeat(np.array(asked["force_n"])[:, None], velocity.shape[1], 1)
    found = periodic(force, velocity, asked["rate_hz"]).part(np.array(asked["lines"]))
    admittance = np.array(asked["real"]) + 1j * np.array(asked["imaginary"])
    z = impedance(found, "h_force").impedance_ns_per_m
    assert np.abs(z * admittance - 1.0).max() < 1e-5  # force was rounded to a micronewton
    unexplained = (1.0 - found.coherence) / found.coherence / (found.realisations - 1)
    variance = np.array(asked["variance"]) / np.abs(admittance) ** 2
    assert unexplained == pytest.approx(variance, rel=1e-3)
    assert variance.min() > 1e-6  # there is something to compare: noise and distortion


@pytest.mark.parametrize("one", NEEDED, ids=NAMED)
def test_required_damping_is_the_passivity_index_of_python_control(one: dict[str, Any]) -> None:
    filters = PAPER_FILTERS if one["filters"] else (None, None)
    needed, _ = required_damping([one["environment"]], filters=filters)
    assert float(needed[0]) == pytest.approx(one["needed_ns_per_m"], rel=1e-4)


@pytest.mark.parametrize("one", NEEDED, ids=NAMED)
def test_python_control_finds_the_edge_where_it_is(one: dict[str, Any]) -> None:
    assert one["passive_with_2_percent_more"]
    assert not one["passive_with_2_percent_less"]
