"""Running `servo.step` by hand: a tick counter, commands with masks, and a sample that is healthy
by default.
"""

from typing import Any

from hapticd.mailbox import layout
from hapticd.mailbox.layout import Command, Result, Value
from hapticd.servo.plan import GATEWAY_ALIVE, LINK_UP, SETTLED
from hapticd.servo.safety import State
from hapticd.servo.step import initial_state, make_step
from hapticd.usb.device import SEED
from hapticd.usb.frames import OutFlag, StatusBit

HEALTHY = LINK_UP | GATEWAY_ALIVE
ENABLE = int(OutFlag.ENABLE)

AMBIENT_COUNT = 2500


def masked(values: dict[Value, float]) -> tuple[float, ...]:
    """The doubles of a command."""
    packed = [0.0] * layout.COMMAND_VALUES
    packed[Value.MASK] = float(sum(1 << place for place in values))
    for place, value in values.items():
        packed[place] = value
    return tuple(packed)


class Flight:
    """One servo in the air. The first sample seeds the filters."""

    def __init__(self, params: Any, encoder: int = 0) -> None:
        self.params = params
        self.encoder = encoder
        self.tick = 0
        self.step, self.state = make_step(params), initial_state(params)
        self.answers: list[Any] = []
        self._seq = 0
        self.fly(1, arrival=SEED)

    def fly(self, ticks: int = 1, **sample: Any) -> Any:
        """`ticks` ticks with the same sample; the last output."""
        for _ in range(ticks):
            out = self._one((), **sample)
        return out

    def do(
        self,
        kind: int,
        values: dict[Value, float] | None = None,
        at_tick: int = 0,
        actor: int = 9,
        **sample: Any,
    ) -> Result:
        """Run a tick with a command; return its result."""
        self._seq += 1
        request = self._seq, int(kind), actor, at_tick, masked(values or {})
        out = self._one((request,), **sample)
        return Result(next(answer[1] for answer in out[10] if answer[0] == self._seq))

    def event(self, kind: int, number: int) -> Any:
        """An internal event of the loop."""
        return self._one(((0, kind, 0, 0, (float(number),)),))

    def _one(
        self,
        commands: Any,
        encoder: Any = None,
        status: int | None = None,
        celsius: Any = None,
        arrival: int = 0,
        host: int = HEALTHY,
        index: int = 0,
        delay: float = 0.125,
        current: int = 0,
        damping: int = 0,
    ) -> Any:
        if encoder is not None:
            self.encoder = encoder
        if status is None:  # as of a board that grants the request
            status = self.state[SETTLED].out_flags & ENABLE and int(StatusBit.ENABLED)
        temperature = AMBIENT_COUNT if celsius is None else round(celsius * 100)
        sample = (self.encoder, status, temperature, arrival, host, index, delay, current, damping)
        self.state, out = self.step(self.state, commands, sample, self.tick)
        self.tick += 1
        self.answers += out[10]
        self.out = out
        return out

    @property
    def plan(self) -> Any:
        return self.state[SETTLED].plan

    @property
    def blob(self) -> dict[str, Any]:
        """The plan part of the record of this tick."""
        names = [name for name, *_ in layout.PLAN_FIELDS]
        return dict(zip(names, layout.PLAN.unpack(self.state[SETTLED].blob), strict=True))


def enabled(params: Any, settings: dict[Value, float] | None = None, encoder: int = 0) -> Flight:
    """A flight that is enabled with its gain at 1."""
    flight = Flight(params, encoder)
    if settings:
        assert flight.do(Command.SET, {Value.RAMP_S: 0.0, **settings}) is Result.APPLIED
    assert flight.do(Command.ENABLE) is Result.APPLIED
    flight.fly(501)
    assert flight.plan.state is State.ENABLED
    return flight
