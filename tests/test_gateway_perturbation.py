"""Newtons into probe counts: every sample checked before any is written."""

from pathlib import Path

import numpy as np
import pytest
from gateway_rig import DeskRig

from hapticd.mailbox.layout import PERTURBATION_SAMPLES


@pytest.fixture
def rig(tmp_path: Path) -> DeskRig:
    return DeskRig(tmp_path)


def load(rig: DeskRig, samples: object, **more: object) -> dict[str, object]:
    return rig.ask(cmd="perturb", action="load", samples_n=samples, **more)


def test_samples_become_counts_of_this_device(rig: DeskRig) -> None:
    # count = sign * value / per_count + offset = -value / 1e-3 + 2, halves upwards
    assert load(rig, [0.0, 0.5, -1.0, 1.0, 0.0005])["result"] == {"samples": 5}
    assert rig.servo.mailbox.waveform[:5].tolist() == [2, -498, 1002, -998, 2]


def test_bytes_and_numbers_load_the_same(rig: DeskRig) -> None:
    force_n = np.linspace(-0.9, 0.9, 100, dtype="<f4")
    load(rig, force_n.astype(float).tolist())
    first = rig.servo.mailbox.waveform[:100].tolist()
    load(rig, force_n.tobytes())
    assert rig.servo.mailbox.waveform[:100].tolist() == first


def test_chunks_follow_each_other(rig: DeskRig) -> None:
    load(rig, [0.1] * 10)
    assert load(rig, [0.2] * 5, offset=10)["result"] == {"samples": 15}
    assert rig.servo.mailbox.waveform[9:12].tolist() == [-98, -198, -198]
    error = load(rig, [0.3], offset=14)["error"]
    assert error["message"] == "offset = 14 samples: 15 are loaded; send the chunks in order"


def test_chunk_of_another_client_is_refused(rig: DeskRig) -> None:
    """Two that load at once would play a mixture."""
    load(rig, [0.1] * 10, client=b"a")
    load(rig, [0.2] * 10, client=b"b")
    error = load(rig, [0.1] * 5, offset=10, client=b"a")["error"]
    assert error["message"] == "offset = 10 samples: another client's are loaded; begin with offset 0"
    assert load(rig, [0.2] * 5, offset=10, client=b"b")["result"] == {"samples": 15}


@pytest.mark.parametrize("bad", [1.001, -1.001])
def test_sample_beyond_limit_is_named(rig: DeskRig, bad: float) -> None:
    load(rig, [0.0] * 4)
    error = load(rig, [0.5, bad], offset=4)["error"]
    assert error["code"] == "invalid"
    assert error["detail"] == [
        {
            "loc": "samples_n.5",
            "msg": f"samples_n[5] = {bad} N: beyond the limit -1..1 N (the device file sets it); ask for a value inside",
        }
    ]
    assert rig.servo.mailbox.waveform[4] == 0


def test_sample_that_is_no_number_is_named(rig: DeskRig) -> None:
    error = load(rig, np.array([0.0, np.nan], "<f4").tobytes())["error"]
    assert error["detail"][0]["loc"] == "samples_n.1"


def test_broken_bytes_are_refused(rig: DeskRig) -> None:
    message = load(rig, b"\0\0\0")["error"]["message"]
    assert message == "samples_n has 3 bytes: not whole little-endian float32; send 4 bytes a sample"


def test_too_long_a_waveform_is_refused(rig: DeskRig) -> None:
    rig.desk._waveform._life, rig.desk._waveform._samples = rig.view.life, PERTURBATION_SAMPLES
    message = load(rig, [0.1], offset=PERTURBATION_SAMPLES)["error"]["message"]
    assert message == "samples_n: 524289 samples are beyond the limit 524288 samples (131 s); shorten it or play it in a loop"


def test_start_tells_the_length(rig: DeskRig) -> None:
    load(rig, [0.1] * 7)
    rig.ask(cmd="enable")
    assert rig.ask(cmd="perturb", action="start", loop=True)["ok"]
    assert rig.servo.played == (7.0, 1.0)
    assert rig.servo.perturbing


def test_playing_waveform_is_not_overwritten(rig: DeskRig) -> None:
    load(rig, [0.1] * 7)
    rig.ask(cmd="enable")
    rig.ask(cmd="perturb", action="start")
    assert load(rig, [0.2])["error"]["code"] == "busy"
    rig.ask(cmd="perturb", action="stop")
    assert load(rig, [0.2])["ok"]


def test_waveform_does_not_outlive_its_servo(rig: DeskRig) -> None:
    load(rig, [0.1] * 7)
    rig.view.life += 1
    assert rig.ask(cmd="perturb", action="start")["error"]["message"].startswith("perturb start: no waveform is loaded")
