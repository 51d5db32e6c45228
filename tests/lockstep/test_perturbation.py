"""A perturbation is limited like force, at the last place before the wire, and plays as asked."""

import math
from array import array
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.boards import board_params
from support.gateway_rig import GatewayRig
from support.gateway_stand_in import StandInServo
from support.models import device_params, servo_params

from hapticd.core.params import ScaleParams
from hapticd.mailbox.layout import GATEWAY_BEAT_WORD, TELEMETRY, Command, Result, Value
from hapticd.run.lockstep import LockStep
from hapticd.servo.inbox import Streamer
from hapticd.usb import codec
from hapticd.usb.frames import StatusBit

DTYPE = np.dtype([tuple(field) for field in TELEMETRY])
LONG = 400  # samples


@pytest.fixture
def stack() -> Iterator[LockStep]:
    with LockStep(servo_params(), board_params()) as stack:
        enabled(stack)
        yield stack


def enabled(stack: LockStep) -> None:
    stack.run(5)
    free = {Value.STIFFNESS: 0.0, Value.RAMP_S: 0.0}
    assert stack.do(Command.SET, free).result is Result.APPLIED
    assert stack.do(Command.ENABLE).result is Result.APPLIED
    stack.run(20)


def start(stack: LockStep, counts: list[int], loop: bool = False) -> int:
    stack.load_waveform(counts)
    played = {Value.SAMPLES: float(len(counts)), Value.LOOP: float(loop)}
    return stack.command(Command.PERTURB_START, played)


def played(block: bytes) -> list[int]:
    """What the probe motor was given, count by count, from the first one that is not 0."""
    frames = np.frombuffer(block, DTYPE)["in_frame"]
    torque = [pair[0] for frame in frames for pair in codec.decode_in(bytes(frame)).pairs]
    return torque[int(np.argmax(np.array(torque) != 0)) :]


def test_a_perturbation_is_clamped_in_the_servo(stack: LockStep) -> None:
    """Whatever is in the segment by the time it is played."""
    device = stack.loop.params.device
    scale = device.probe_torque
    low, high = (scale.to_count(side * device.probe_limit_n, -32768, 32767) for side in (-1, 1))
    assert -32768 < low < high < 32767
    start(stack, [32767, -32768, high, low, high + 1, 5] * 40)
    found = played(stack.run(100))
    assert found[:240] == [high, low, high, low, high, 5] * 40
    assert max(map(abs, found)) * scale.per_count <= device.probe_limit_n + scale.per_count / 2


def test_a_perturbation_plays_while_a_device_is_being_commissioned() -> None:
    """It moves the handle, no push of the motor begins, and none of its limits ends it."""
    params = servo_params(device=device_params(commissioning=True))
    # 0.3 N at 10 Hz for 2 s: 8 g go to and fro by some mm
    wave = [round(5000 * math.sin(2.0 * math.pi * n / 400.0)) for n in range(8000)]
    with LockStep(params, board_params()) as stack:
        enabled(stack)
        start(stack, wave)
        block = stack.run(2000)
    found = np.frombuffer(block, DTYPE)
    assert np.ptp(found["position_m"]) > 2e-3
    assert not found["force_n"].any()
    assert not found["fault"].any()
    assert played(block)[:7000] == wave[1:7001]


def test_a_clamp_follows_sign_and_offset_of_the_scale() -> None:
    scale = ScaleParams(1e-3, -1, 100.0)  # N = -(count - 100) / 1000
    device = replace(device_params(), probe_torque=scale, probe_limit_n=2.0)
    counts = memoryview(array("h", [32767, -32768, 2100, -1900, 0]))
    streamer = Streamer(counts, servo_params(device=device))
    _, count, samples = streamer.follow((1, 5, False), 0, 0)
    assert samples[:count] == (2100, -1900, 2100, -1900, 0)


@pytest.mark.parametrize("counts", [[3000], [3000, -1000], [1, 2, 3], list(range(1, 8))])
def test_a_short_loop_plays_as_asked(stack: LockStep, counts: list[int]) -> None:
    start(stack, counts, loop=True)
    block = stack.run(300)
    found = played(block)
    assert len(found) > 1000
    repeated = counts * (len(found) // len(counts) + 1)
    assert found == repeated[: len(found)]
    status = np.frombuffer(block, DTYPE)["status"][20:]
    assert not (status & StatusBit.FIFO_UNDERRUN).any()


@pytest.mark.parametrize("early", range(-3, 4))
def test_a_waveform_that_starts_as_another_ends_is_played(stack: LockStep, early: int) -> None:
    """In every tick around the end, that of the end itself among them."""
    start(stack, [1000] * LONG)
    end = 0
    while stack.loop.streamer.playing or not end:
        stack.run(1)
        end += 1
    begun = stack.loop.tick
    start(stack, [1000] * LONG)
    stack.run(end - 2 + early)
    stack.load_waveform([2000] * LONG)
    seq = start(stack, [2000] * LONG)
    block = stack.run(150)
    assert stack.loop.tick > begun
    assert [one.result for one in stack.gateway.answers() if one.seq == seq] == [Result.APPLIED]
    assert played(block).count(2000) == LONG


# --- whose newtons --------------------------------------------------------------------------------


def test_a_gateway_with_another_configuration_refuses_in_words(tmp_path: Path) -> None:
    """0.4 N asked of it would be 1.6 N at the device."""
    with GatewayRig(tmp_path) as rig:
        rig.servo.mailbox.close()
        rig.servo = StandInServo(tmp_path, rig.clock, config_hash="d" * 64)
        for _ in range(5):
            rig.step(100)
        client = rig.client()
        load: dict[str, Any] = {"action": "load", "samples_n": [0.4]}
        for asked in ({"cmd": "enable"}, {"cmd": "perturb", **load}, {"cmd": "get"}):
            error = rig.ask(client, **asked)["error"]
            assert error["code"] == "servo_down"
            assert error["message"].endswith(
                "the servo runs configuration dddddddddddd, the gateway cccccccccccc: scales and"
                " limits differ; restart both together"
            )
        assert not any(rig.servo.mailbox.waveform[:10])
        assert rig.servo.mailbox.load(GATEWAY_BEAT_WORD) == 0  # and it gives no heartbeat
