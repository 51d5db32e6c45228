"""The servo with transfers in flight on the model of full speed: delay, STOP, a stuck OUT, the last
frame.
"""

from dataclasses import replace

import pytest
from support.boards import board_params
from support.models import servo_params

from hapticd.core.params import UsbParams
from hapticd.mailbox.layout import Command, Flag, Result, Value
from hapticd.model.params import BusParams, InjectionParams
from hapticd.protocol.view import as_records
from hapticd.run.lockstep import LockStep
from hapticd.servo.safety import State
from hapticd.sim.bus import BAND
from hapticd.usb import codec
from hapticd.usb.frames import OutFlag

ROOT_PORT = BusParams()
IN_TURN, IN_FLIGHT = UsbParams(in_flight=False), UsbParams(in_flight=True)
STEADY = [name for name in BAND if "hub" not in name and name not in ("interrupt", "other devices")]


class Bench:
    """A servo on a bus, and the OUT frames that reach its board."""

    def __init__(self, usb, bus=ROOT_PORT, **traits):
        self.stack = LockStep(servo_params(usb=usb), board_params(bus=bus, **traits))
        self.arrived = []
        deliver = self.stack.backend.deliver

        def noted(data, t_ns):
            deliver(data, t_ns)
            self.arrived.append((t_ns, codec.decode_out(bytes(data))))

        self.stack.backend.deliver = noted

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.stack.close()

    def enable(self):
        self.stack.run(5)
        assert self.stack.do(Command.ENABLE).result is Result.APPLIED
        self.stack.do(Command.SET, {Value.STIFFNESS: 200.0, Value.RAMP_S: 0.0})


@pytest.mark.parametrize("name", STEADY)
def test_every_tick_has_its_sample_and_the_delay_is_shorter(name):
    """One after the other and in flight, on the same bus."""
    delays_us = {}
    for usb in (IN_TURN, IN_FLIGHT):
        with Bench(usb, BAND[name]) as bench:
            bench.enable()
            ticks = as_records(bench.stack.run(1000))[50:]
        assert set(ticks["state"]) == {State.ENABLED}
        assert not ticks["arrival"].any()
        assert ticks["lost_slots"][-1] == 0
        delays_us[usb] = sorted(ticks["delay_us"])[len(ticks) // 2]
    assert delays_us[IN_FLIGHT] < 0.85 * delays_us[IN_TURN]


def test_stop_reaches_the_board_as_soon_as_one_after_the_other():
    """In OUTs that are sent from its command on, until one has no ENABLE."""
    found = []
    for usb in (IN_TURN, IN_FLIGHT):
        with Bench(usb) as bench:
            bench.enable()
            bench.stack.run(600)
            sent = codec.decode_out(bytes(bench.stack.device.out_buffer)).seq
            bench.stack.command(Command.STOP)
            bench.stack.run(60)
            after = [frame for _, frame in bench.arrived if frame.seq > sent]
            found.append([frame.flags & OutFlag.ENABLE for frame in after].index(0))
    assert found[1] == found[0]


def test_out_that_nobody_takes_is_followed_by_none_and_the_boards_watchdog_ends_the_force():
    hang = (InjectionParams("hang", tick=1000, value=0.06),)
    with Bench(IN_FLIGHT, watchdog_ms=20.0, injections=hang) as bench:
        bench.enable()
        bench.stack.run(700)
        port = bench.stack.backend._port
        while port.tick <= 1000:
            bench.stack.run(1)
        sent = bench.stack.device.counts["write_errors"]
        bench.arrived.clear()
        ticks = as_records(bench.stack.run(30))
        assert bench.arrived == []
        assert bench.stack.device.counts["write_errors"] > sent
        assert (ticks["flags"] & Flag.WRITE_FAILED).any()
        assert State.FAULT in set(ticks["state"])
        assert port.board._axis.force_n == 0.0
        bench.stack.run(200)
        assert len(bench.arrived) > 100
        first, second = (frame.seq for _, frame in bench.arrived[:2])
        assert second - first == 1  # none in between was on its way


def test_out_that_is_on_its_way_for_more_than_a_period_costs_one_sample():
    """The tick that sends none counts none as sent, so the sample of the one before is no old
    one.
    """
    with Bench(IN_FLIGHT) as bench:
        bench.enable()
        bench.stack.run(100)
        out = bench.stack.backend._bus.out
        held_ns = [1_500_000]

        def completed_late(t_ns, size):
            board_ns, host_ns = out(t_ns, size)
            return board_ns, host_ns + (held_ns.pop() if held_ns else 0)

        bench.stack.backend._bus.out = completed_late
        ticks = as_records(bench.stack.run(50))
    assert ticks["arrival"].tolist().count(-1) == 1
    assert ticks["arrival"].min() == -1
    assert ticks["lost_slots"][-1] == 0


@pytest.mark.parametrize("usb", [IN_TURN, IN_FLIGHT])
def test_last_frame_without_authority_arrives_behind_the_one_before(usb):
    bench = Bench(usb)
    bench.enable()
    bench.stack.run(300)
    bench.stack.close()
    before, last = (frame for _, frame in bench.arrived[-2:])
    assert last.seq == before.seq + 1
    assert last.flags == OutFlag.FIFO_CLEAR
    assert last.torque == 0


def test_no_tick_waits_for_its_out():
    """Two submissions and nothing else: neither the wire, nor an interrupt, nor a wake-up."""
    for usb, longest_us in ((IN_TURN, 200), (IN_FLIGHT, 40)):
        bus = replace(ROOT_PORT, submit_us=4.0)
        with Bench(usb, bus) as bench:
            bench.enable()
            ticks = as_records(bench.stack.run(200))
        assert ticks["write_ns"].max() < 1000 * longest_us
        assert (ticks["write_ns"].min() > 40_000) == (usb is IN_TURN)
