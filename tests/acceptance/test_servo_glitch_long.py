"""One bad encoder sample moves less than 1 N; a struck handle is no glitch; a burst is a fault."""

import math

import numpy as np
import pytest
from support.flight import enabled
from support.models import COUNT_M
from support.servo_glitch import FELT, params_with

from hapticd.mailbox.layout import Flag, Value
from hapticd.servo.safety import State


def tap(duration_s, gain_m_per_s, start_s):
    """Position [m] at each tick that a half-sine push adds."""
    at = np.arange(60) * 1e-3 - start_s
    inside = np.clip(at / duration_s, 0.0, 1.0)
    moved = 0.5 * gain_m_per_s * duration_s * (inside - np.sin(np.pi * inside) / np.pi)
    return moved + gain_m_per_s * np.clip(at - duration_s, 0.0, None)


@pytest.mark.parametrize("duration_ms", [0.2, 0.5, 1.0, 2.0, 3.0, 5.0])
@pytest.mark.parametrize("gain_m_per_s", [0.3, 1.0, 2.5, 4.6])
def test_a_struck_handle_is_not_a_glitch(duration_ms, gain_m_per_s):
    """Half-sine taps up to the speed limit: 4.6 m/s in 0.2 ms are 36,000 m/s^2, 290 N on 8 g. Every
    sample reaches the law; the force waits for two ticks at most.
    """
    for phase in np.linspace(0.0, 0.95, 20):
        path = tap(duration_ms * 1e-3, gain_m_per_s, 5e-3 + phase * 1e-3)
        handle = enabled(params_with(), {**FELT, Value.STIFFNESS: 20.0})
        trusting = enabled(params_with(math.inf), {**FELT, Value.STIFFNESS: 20.0})
        waits = []
        for position in path[:25]:
            encoder = round(position / COUNT_M)
            out = handle.fly(1, encoder=encoder)
            true = trusting.fly(1, encoder=encoder)
            waits.append(bool(out[9] & Flag.DOUBTED))
            assert not out[9] & Flag.GLITCH
            assert handle.plan.state is State.ENABLED
            if not waits[-1]:
                assert handle.state[1] == trusting.state[1]
                assert out[:9] == true[:9]
        assert sum(waits) <= math.ceil(duration_ms) + 2
        assert not any(a and b and c for a, b, c in zip(waits, waits[1:], waits[2:], strict=False))
        assert not any(waits[-5:])


@pytest.mark.parametrize("lost", [1, 4, 8])
@pytest.mark.parametrize("duration_ms", [0.2, 1.0, 3.0, 5.0])
@pytest.mark.parametrize("gain_m_per_s", [0.3, 1.0, 2.5, 4.6])
def test_nor_is_one_of_which_samples_are_lost(duration_ms, gain_m_per_s, lost):
    """Slots are lost at any time of the tap."""
    handle = enabled(params_with(), {**FELT, Value.STIFFNESS: 20.0})
    start = handle.tick, handle.state
    for phase in (0.24, 0.48, 0.71):
        path = tap(duration_ms * 1e-3, gain_m_per_s, 5e-3 + phase * 1e-3)
        for at in range(2, 14):
            handle.tick, handle.state = start
            waits = []
            for tick in (*range(at), *range(at + lost, 30)):
                handle.tick = start[0] + tick
                arrival = lost if tick == at + lost else 0
                out = handle.fly(1, encoder=round(path[tick] / COUNT_M), arrival=arrival)
                waits.append(bool(out[9] & Flag.DOUBTED))
                assert not out[9] & Flag.GLITCH
                assert handle.plan.state is State.ENABLED
            assert sum(waits) <= math.ceil(duration_ms) + 3
            assert not any(waits[-5:])
