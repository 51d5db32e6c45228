"""The composed device as straight-line Python: the same motion as the model's own maps, and
nothing that it does not have.
"""

from random import Random

import numpy as np
import pytest
from support.plant_composed import EXACT, MODELS, board, forces

from hapticd.model.step import make_plant


@pytest.mark.parametrize("level", [0.0, EXACT], ids=["undamped", "damped"])
@pytest.mark.parametrize("name", MODELS)
def test_played_motion_is_the_models(name, level):
    model = MODELS[name]
    random = Random(1)
    plant = make_plant(board(model, (level,)))
    state = plant.rest(0.0)
    x = largest = np.zeros(len(model.states))
    stuck = 0
    for tick in range(60):
        force = random.gauss(0.0, 0.1)
        torque = random.gauss(0.0, 0.1)
        if tick >= 40:
            force = torque = 0.0
        u = np.zeros(model.inputs.width)
        u[[model.inputs.command, model.inputs.torque]] = force, torque
        if model.inputs.estimate is not None:
            u[model.inputs.estimate] = model.estimate_offset_m_per_s
        for count in (4, 4, 3, 1, 2, 2):
            state = plant.step(state, force, torque, level, count)
            for _ in range(count):
                x = forces(model, level, x, u)
        stuck += any(x[c.velocity] == 0.0 for c in model.contacts)
        largest = np.maximum(largest, abs(x))
        assert (abs(np.array(state) - x) <= 1e-10 * largest).all()
        assert [v == 0.0 for v in state] == [v == 0.0 for v in x]
    assert stuck > 0 or not model.contacts
    outputs = model.outputs
    for view, row in (
        ("encoder", outputs.encoder),
        ("travel", outputs.recorded_travel),
        ("motor_force", outputs.motor_force),
    ):
        expected = row.row(level) @ x + row.through(level)[0] * 0.5
        assert getattr(plant, view)(state, 0.5, level) == pytest.approx(
            expected, rel=1e-9, abs=1e-15
        )
    assert (plant.impulse is None) is (outputs.recorded_impulse is None)
