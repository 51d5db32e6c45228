"""The guard's worker: what it starts from, what it says, and that it outlives a bad request."""

import json

import msgpack
from support.assembly_guard import REQUEST
from support.guard_device import (
    change,
    over_compensated,
    setup_of,
    shipped_judge,
    shipped_setup,
)

from hapticd.core.params import from_plain, to_plain
from hapticd.guard.judge import Judge
from hapticd.guard.worker import answered
from hapticd.model.bases import model_of
from hapticd.model.compose import compose
from hapticd.model.loop import spectral_radius
from hapticd.model.params import GuardSetup
from hapticd.zwidth.sources import device_scene


def test_setup_survives_json_to_the_last_bit() -> None:
    setup = shipped_setup()
    assert from_plain(GuardSetup, json.loads(json.dumps(to_plain(setup)))) == setup


def test_model_in_numbers_is_the_model_of_the_bench() -> None:
    """The same eigenvalues to the last bit, from guard.json and from the device file."""
    scene = device_scene("weir2008")
    params = shipped_setup().model
    assert scene is not None
    assert params is not None
    point = [(100.0, 1.0, 0.003)]
    ours = spectral_radius(model_of(params), point, 1.74)
    assert ours.tolist() == spectral_radius(compose(scene), point, 1.74).tolist()


def test_a_failing_request_is_an_answer_and_the_judge_goes_on() -> None:
    judge = shipped_judge()
    wrong = answered(judge, msgpack.packb(REQUEST | {"basis": "hearsay"}))
    assert wrong["n"] == 7
    assert "hearsay" in wrong["error"]
    assert "error" in answered(judge, b"\xc1")
    assert answered(judge, msgpack.packb(REQUEST))["action"] == "apply"


def test_every_answer_fits_into_a_message() -> None:
    answer = change(shipped_judge(), {"K": 150.0, "B": 1.0, "active_damping": 1.74})
    assert len(msgpack.packb(answer)) < 64 << 10


def test_an_unstable_circuit_is_never_safe() -> None:
    """Compensated for far more resistance than there is: it oscillates without a display."""
    judge = Judge(setup_of(over_compensated(400.0)))
    verdict = change(judge, {}, now={"active_damping": 10.0})["verdict"]
    assert verdict["safe"] is False
    assert verdict["allowed"] == {"K": None, "B": None, "M": None}
