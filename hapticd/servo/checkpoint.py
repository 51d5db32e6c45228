"""The servo's whole state as nested plain tuples and back, exactly: what a re-flight starts from.

Every number stays the number it is, so a flight from a checkpoint gives the same bits as the flight
that left it. Plain tuples are cheap to marshal (some 10 us, only when the gateway asks, after the
record was published) and survive JSON. The order of the places is that of the first checkpoints
ever written, which stay readable. What would break it: a field of Plan or ServoState that is added
there and not here (the tests fly and compare).
"""

from collections.abc import Sequence
from typing import Any

from hapticd.params import FilterParams
from hapticd.render.ramp import Ramp
from hapticd.servo.plan import Plan, Scheduled
from hapticd.servo.safety import State
from hapticd.servo.state import ServoState, Settled


def flatten(state: ServoState) -> tuple[Any, ...]:
    """`state` as tuples, numbers and text."""
    settled, law, ledger, held = state
    plan = settled.plan
    s = settled
    plain = plan._asdict() | {
        "state": int(plan.state),
        "gain": tuple(plan.gain),
        "fade": tuple(plan.fade),
        "values": tuple((place, tuple(ramp)) for place, ramp in plan.values.items()),
        "filters": tuple(
            (one.frequency_hz, one.damping_ratio, one.mapping) for one in plan.filters
        ),
        "scheduled": tuple(tuple(one) for one in plan.scheduled),
    }
    before = s.wake_tick, s.environment, s.coefficients, s.out_flags, s.damping_count, s.blob.hex()
    return (*before, law, ledger, s.origin, s.added, held, s.host, tuple(plain.values()))


def unflatten(plain: Sequence[Any]) -> ServoState:
    """The state in `plain`, whose tuples may have become lists on the way."""
    wake, environment, coefficients, flags, damping, blob, *others, plan = map(_tuples, plain)
    fields = dict(zip(Plan._fields, plan, strict=True))
    first, second = (FilterParams(*one) for one in fields["filters"])
    renewed = fields | {
        "state": State(fields["state"]),
        "gain": Ramp(*fields["gain"]),
        "fade": Ramp(*fields["fade"]),
        "values": {place: Ramp(*ramp) for place, ramp in fields["values"]},
        "filters": (first, second),
        "scheduled": tuple(Scheduled(*one) for one in fields["scheduled"]),
    }
    law, ledger, origin, added, held, host = others
    before = wake, environment, coefficients, flags, damping, bytes.fromhex(blob)
    whole = Plan(**renewed)
    return Settled(*before, origin, added, host, whole.wave, whole), law, ledger, held


def _tuples(item: Any) -> Any:
    return tuple(map(_tuples, item)) if isinstance(item, list | tuple) else item
