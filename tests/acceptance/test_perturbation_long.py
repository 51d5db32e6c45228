"""A perturbation is limited like force, at the last place before the wire, and plays as asked."""

from dataclasses import replace
from pathlib import Path

from support.gateway_rig import START_NS, packed
from support.gateway_stand_in import StandInServo, setup

from hapticd.core.params import GatewaySetup, ScaleParams
from hapticd.core.units import VirtualClock
from hapticd.gateway.server import GatewayServer, run
from hapticd.mailbox.layout import GATEWAY_BEAT_WORD


def other(base: GatewaySetup) -> GatewaySetup:
    """Another device file: its probe makes four times the force of a count."""
    device = replace(base.servo.device, probe_torque=ScaleParams(4e-3))
    return replace(base, servo=replace(base.servo, device=device, config_hash="d" * 64))


def test_a_gateway_reads_the_configuration_of_a_servo_that_started_with_another(
    tmp_path: Path,
) -> None:
    clock = VirtualClock(START_NS)
    servo = StandInServo(tmp_path, clock, config_hash="d" * 64)
    setups = [setup(), setup(), other(setup())]
    reads = []

    def read() -> GatewaySetup:
        reads.append(setups.pop(0))
        return reads[-1]

    def ended() -> bool:
        servo.tick(20)
        return servo.mailbox.load(GATEWAY_BEAT_WORD) > 0 or servo.ticks > 4000

    run(tmp_path, read, clock, ended)
    assert [one.servo.config_hash[0] for one in reads] == ["c", "c", "d"]
    gateway = GatewayServer(tmp_path, reads[-1], clock)
    gateway.step(0)
    message = [b"a", packed(cmd="perturb", action="load", samples_n=[0.4])]
    gateway._commands.serve([message], clock.now_ns())
    gateway.close()
    assert servo.mailbox.waveform[0] == 100  # 0.4 N at 4 mN/count
