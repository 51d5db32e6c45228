"""guard.json: what a measurement says, for which device it counts, and what of it is believed."""

import hashlib
from dataclasses import replace
from typing import Any

import pytest
from support.guard_device import change, setup_of, shipped_setup

from hapticd.core.params import ServoParams
from hapticd.guard.judge import Judge
from hapticd.model.params import GuardSetup, MeasuredParams
from hapticd.settings.build import servo_params
from hapticd.settings.load import load
from hapticd.settings.scene import measured_params
from hapticd.settings.toml import shipped

DEVICE_FILE = b"the device file"
LEVEL = 1.74


@pytest.fixture(scope="module")
def servo() -> ServoParams:
    return servo_params(load(shipped("config") / "hapticd.toml"), "guard")


def limit(axis: int, level: float, lower: float | None, value: float) -> dict[str, Any]:
    return {
        "scan": {"axis": axis, "active_damping_ns_per_m": level, "amplitude": 1.0},
        "value": value,
        "lower": lower,
        "upper": 1.1 * value,
    }


def content(**conditions: Any) -> dict[str, Any]:
    """A Z-width summary of K, B and M with 1.74 N s/m, and of K without."""
    return {
        "device": "a display",
        "device_file_sha256": hashlib.sha256(DEVICE_FILE).hexdigest(),
        "conditions": {
            "rate_hz": 1000.0,
            "filters_hz": [100.0, 72.0],
            "perturbation": {"psd_n2_per_hz": 2.5e-5},
        }
        | conditions,
        "limits": [
            limit(0, 0.0, 50.0, 60.0),
            limit(0, LEVEL, 400.0, 500.0),
            limit(1, LEVEL, 4.0, 5.0),
            limit(2, LEVEL, -0.02, -0.022),
            limit(0, LEVEL, None, 900.0) | {"scan": {"axis": 0, "amplitude": 2.0}},
        ],
    }


def judge_of(measured: MeasuredParams) -> Judge:
    return Judge(setup_of(None, measured=measured))


def safe(judge: Judge, asked: dict[str, Any], added: float = LEVEL) -> bool | None:
    answer = change(judge, asked, basis="measured", now={"active_damping": added})
    found: bool | None = answer["verdict"]["safe"]
    return found


def test_a_measurement_counts_for_its_device_file_and_rate_alone(servo: ServoParams) -> None:
    found = measured_params("a.zwidth", content(), DEVICE_FILE, servo)
    assert found.refused == ""
    other_file = measured_params("a.zwidth", content(), b"edited", servo)
    assert "another device file" in other_file.refused
    other_rate = measured_params("a.zwidth", content(rate_hz=2000.0), DEVICE_FILE, servo)
    assert "2000 Hz" in other_rate.refused
    for refused in (other_file, other_rate):
        answer = change(judge_of(refused), {"K": 1.0}, basis="measured", policy="warn")
        assert answer["verdict"]["safe"] is None
        assert refused.refused in answer["verdict"]["text"]


def test_inside_the_hull_of_measured_limits_is_safe(servo: ServoParams) -> None:
    judge = judge_of(measured_params("a.zwidth", content(), DEVICE_FILE, servo))
    verdict = change(judge, {"K": 390.0}, basis="measured", now={"active_damping": LEVEL})[
        "verdict"
    ]
    assert verdict["safe"]
    assert verdict["basis"] == "measured a.zwidth"
    assert verdict["margin_ns_per_m"] is None
    # the end of the interval that is nearer to 0 counts, not the value
    assert not safe(judge, {"K": 410.0})
    assert safe(judge, {"K": 190.0, "B": 2.0})
    assert not safe(judge, {"K": 210.0, "B": 2.0})
    assert safe(judge, {"M": -0.019})
    assert not safe(judge, {"M": 0.001})  # nobody looked
    assert not safe(judge, {"K": -1.0})


def test_limits_count_at_their_level_or_above(servo: ServoParams) -> None:
    judge = judge_of(measured_params("a.zwidth", content(), DEVICE_FILE, servo))
    assert safe(judge, {"K": 300.0}, LEVEL + 1.0)
    assert not safe(judge, {"K": 300.0}, LEVEL - 0.1)
    assert safe(judge, {"K": 40.0}, LEVEL - 0.1)  # as without damping


def test_limits_count_for_their_filters(servo: ServoParams) -> None:
    judge = judge_of(measured_params("a.zwidth", content(), DEVICE_FILE, servo))
    assert not safe(judge, {"K": 40.0, "filters": {"velocity_hz": 60.0}})


def test_a_file_without_what_is_needed_does_not_count(servo: ServoParams) -> None:
    path = "no_such.zwidth"
    setup: GuardSetup = replace(shipped_setup(), measured=MeasuredParams(path, "no such file"))
    answer = change(Judge(setup), {"K": 1.0}, basis="measured")
    assert answer["action"] == "refuse"
    assert answer["verdict"]["safe"] is None


def test_predicted_counts_on_friction_and_theorem_does_not() -> None:
    """The display of the paper owes much of its damping to dry friction."""
    judge = Judge(shipped_setup())
    theorem = change(judge, {"K": 90.0})["verdict"]
    predicted = change(judge, {"K": 90.0}, basis="predicted")["verdict"]
    assert theorem["safe"] is False
    assert predicted["safe"] is True
    assert predicted["basis"] == "predicted"
    assert not change(judge, {"K": 400.0}, basis="predicted")["verdict"]["safe"]
