"""The engine against the whole product on virtual time: servo, wire, pyusb, firmware and the
board's own generated plant.

The wire carries counts, so rounding cannot be switched off there; the engine has the same counts.
Then every command and every encoder count of 10 s must be the same, and the motion between them
equal to rounding.
"""

from dataclasses import replace

import numpy as np
import pytest
from support.boards import board_params
from support.devices import COUNTS, DRY, STAR, device
from support.models import COUNT_N, servo_params

from hapticd.mailbox import layout
from hapticd.mailbox.layout import Command, Result, Value
from hapticd.model.compose import board_fields
from hapticd.model.effects import DampingDac, ForceDac, Saturation
from hapticd.run import lockstep
from hapticd.run.lockstep import LockStep
from hapticd.servo.safety import State
from hapticd.sim.backend import SimulatedBackend
from hapticd.sim.board import BoardModel
from hapticd.usb import codec
from hapticd.zwidth.engine.batch import simulate

DTYPE = np.dtype([tuple(field) for field in layout.TELEMETRY])
LEVEL_COUNT = 10.0 / 65535
WIRE = (
    COUNTS,
    ForceDac(quantum_n=COUNT_N),
    Saturation(limit_n=8.0),
    DampingDac(quantum_ns_per_m=LEVEL_COUNT),
)
LATCH_US = 875
KBM = (100.0, 1.0, 0.010)
TICKS = 10_000
RAMP_TICKS = 600


class Watched(BoardModel):
    """Remembers the sub-step and the rotor's position whenever an OUT arrives: at every tick."""

    def __init__(self, params):
        super().__init__(params)
        self.seen = []

    def on_out(self, data, t_ns):
        super().on_out(data, t_ns)
        self.seen.append((self._axis.now, self._axis.state[0]))


def flown(model, level, monkeypatch):
    """(records, perturbation counts at 4 kHz from power-up, plant states at ticks) of `TICKS`
    ticks under noise.
    """
    boards = []

    def watched(params, clock):
        boards.append(Watched(params))
        return SimulatedBackend(boards[0], clock)

    monkeypatch.setattr(lockstep, "simulated_backend", watched)
    settings = {
        Value.STIFFNESS: KBM[0],
        Value.VIRTUAL_DAMPING: KBM[1],
        Value.MASS: KBM[2],
        Value.RAMP_S: 0.0,
    }
    damping = {Value.ACTIVE_DAMPING: level, Value.ACTIVE_DAMPING_ON: 1.0 if level else 0.0}
    params = replace(board_params(), **board_fields(model, [level], 10.0))
    with LockStep(servo_params(), params) as stack:
        stack.run(5)
        for command, values in (
            (Command.SET, settings),
            (Command.ENABLE, None),
            (Command.DAMPING, damping),
        ):
            assert stack.do(command, values).result is Result.APPLIED
        stack.run(RAMP_TICKS)
        stack.load_waveform(np.random.default_rng(5).integers(-6000, 6001, 8000).tolist())
        assert (
            stack.do(Command.PERTURB_START, {Value.SAMPLES: 8000.0, Value.LOOP: 1.0}).result
            is Result.APPLIED
        )
        stack.run(TICKS)
        records = np.frombuffer(b"".join(stack.blocks), DTYPE)
    assert set(records["state"][-TICKS:]) == {State.ENABLED}
    assert not records["flags"][-TICKS:].any()
    counts = {}
    for frame in records["in_frame"]:
        heard = codec.decode_in(bytes(frame))
        counts.update({heard.probe_index + n: pair[0] for n, pair in enumerate(heard.pairs)})
    return (
        records,
        np.array([counts.get(index, 0) for index in range(max(counts) + 1)]),
        np.array(boards[0].seen),
    )


@pytest.mark.parametrize(
    ("extra", "level"),
    [((), 0.0), ((), 1.74), ((DRY,), 1.74)],
    ids=["linear", "damped", "friction"],
)
def test_engine_and_whole_stack_agree_over_ten_seconds(extra, level, monkeypatch):
    model = device(*STAR, *extra, *WIRE)
    records, counts, seen = flown(model, level, monkeypatch)
    # ticks begin there: the board's clock starts with the hello
    first_us = int(records["board_us"][-1] - LATCH_US) % 1000
    counts = counts[first_us // 250 :]
    ticks = len(counts) // 4
    torque = counts[: 4 * ticks] * board_params().probe_torque_n_per_count
    result = simulate(
        model,
        [KBM],
        ticks / 1000,
        excitation=torque,
        active_damping=level,
        substeps=4,
        keep="ticks",
    )
    assert np.count_nonzero(counts) > 4 * (TICKS - 50)

    at = (
        records["board_us"] - LATCH_US - first_us
    ) // 1000  # the tick in which the sample was latched
    used = (at >= 0) & (at < ticks)
    assert used.sum() > TICKS
    assert np.array_equal(records["position_m"][used], result.position_m[0][at[used]])
    assert np.array_equal(records["force_n"][used], result.force_n[0][at[used]])
    assert np.abs(result.force_n).max() > 0.05

    position = np.concatenate([[0.0], np.cumsum(result.velocity_m_per_s[0])[3::4] / 4000])
    size = np.abs(position).max()
    begins = seen[:, 0].astype(int) // 16 - first_us // 1000
    inside = (begins >= 0) & (begins < ticks) & (seen[:, 0] * 1000 % 16000 == first_us * 16)
    assert size > 1e-4
    assert inside.sum() > TICKS
    assert np.abs(seen[inside, 1] - position[begins[inside]]).max() < 1e-9 * size
