"""A bus whose measurement failed was not measured: no force before another one has succeeded."""

import errno

import pytest
from support.boards import board_params
from support.models import servo_params

from hapticd.core.params import UsbParams
from hapticd.mailbox.layout import Command, Result
from hapticd.protocol.view import as_records
from hapticd.run import lockstep
from hapticd.run.lockstep import LockStep
from hapticd.servo.safety import State
from hapticd.sim.bus import TransferTime, usb_error
from hapticd.usb.frames import Request

IN_TURN = UsbParams(in_flight=False)  # a pair of 0.8 ms is too slow for 1 kHz
# which requests fail, of those to a board from its start on; the first HELLO greets it
FAILURES = [
    (Request.HELLO, range(1, 2)),
    (Request.HELLO, range(3, 4)),
    (Request.SAMPLE_PHASE, range(1)),
    (Request.SAMPLE_PHASE, range(3)),
]


def far_board(pair_us, **changes):
    """A board whose pair of transfers takes `pair_us`, two fifths of it on the way out."""
    return board_params(out_transport_us=0.4 * pair_us, in_transport_us=0.6 * pair_us, **changes)


def failing(monkeypatch, kind, which, number=errno.EPIPE):
    """Boards that are made from now on fail at these requests of that kind."""
    made = lockstep.simulated_backend

    def make(board, clock):
        backend = made(board, clock)
        transfer = backend.ctrl_transfer
        asked = []

        def control(handle, request_type, request, *others):
            if request == kind.value:
                asked.append(request)
                if len(asked) - 1 in which:
                    raise usb_error(number)
            return transfer(handle, request_type, request, *others)

        backend.ctrl_transfer = control
        return backend

    monkeypatch.setattr(lockstep, "simulated_backend", make)


@pytest.mark.parametrize("number", [errno.EPIPE, errno.ETIMEDOUT])
@pytest.mark.parametrize(("kind", "which"), FAILURES)
def test_a_slow_bus_is_barred_though_its_first_measurement_fails(monkeypatch, kind, which, number):
    """0.8 ms a pair."""
    failing(monkeypatch, kind, which, number)
    with LockStep(servo_params(usb=IN_TURN), far_board(800.0)) as stack:
        assert stack.do(Command.ENABLE).result in (Result.REFUSED_DEVICE, Result.REFUSED_RATE)
        stack.run(3000)
        assert stack.do(Command.ENABLE).result is Result.REFUSED_RATE
        assert stack.loop.connection.check.report()["transport"]["rate_hz"] == 820.0
        assert State.ENABLED not in set(as_records(b"".join(stack.blocks))["state"])


@pytest.mark.parametrize(("kind", "which"), FAILURES)
def test_a_bus_that_is_fast_enough_is_used_after_the_next_measurement(monkeypatch, kind, which):
    failing(monkeypatch, kind, which)
    with LockStep(servo_params(usb=IN_TURN, simulated=False), far_board(360.0)) as stack:
        stack.run(3000)
        assert stack.do(Command.ENABLE).result is Result.APPLIED
        ticks = as_records(stack.run(2000))
        assert stack.loop.connection.check.report()["differences"] == []
    assert set(ticks["state"]) == {State.ENABLED}
    assert ticks["lost_slots"][-1] == 0
    assert set(ticks["delay_us"][10:]) == {625}


def uneven(monkeypatch, share_quick):
    """Buses on which that share of transfers takes 0.1 ms."""
    made = lockstep.simulated_backend

    def make(board, clock):
        backend = made(board, clock)
        bus = backend._bus
        out_usually, received_usually = bus.out, bus.received_ns
        done = [0]

        def quick():
            before = int(share_quick * done[0])
            done[0] += 1
            return int(share_quick * done[0]) > before

        def out(t_ns, size):
            return (
                TransferTime(t_ns + 100_000, t_ns + 100_000) if quick() else out_usually(t_ns, size)
            )

        bus.out = out
        bus.received_ns = lambda t_ns: t_ns + 100_000 if quick() else received_usually(t_ns)
        return backend

    monkeypatch.setattr(lockstep, "simulated_backend", make)


# share of quick transfers, what a pair of the others takes [us]
UNEVEN = [(0.2, 800.0, Result.REFUSED_RATE), (0.9, 1600.0, Result.APPLIED)]


@pytest.mark.parametrize(("share_quick", "pair_us", "result"), UNEVEN)
def test_the_bus_is_judged_by_its_median_not_its_best_pair(
    monkeypatch, share_quick, pair_us, result
):
    """Slow pairs among which some are quick, and the other way round."""
    uneven(monkeypatch, share_quick)
    with LockStep(servo_params(usb=IN_TURN), far_board(pair_us)) as stack:
        stack.run(5)
        assert stack.do(Command.ENABLE).result is result
