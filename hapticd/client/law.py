"""A law of one's own: a callable moves the proxy of the virtual spring, from any process.

At each step the law reads handle and proxy (`Coupling`), and returns where the proxy goes next. The
servo keeps it within its bounds (`servo.proxy`). A law that is late skips steps.

The spring gives `Coupling.force_n` to the law's own bodies. The delay t from the handle to the
proxy is 1.5 steps of the law and a tick. A mass without any damping gains energy as from a damping
of -K t. Give it at least K t of its own.

With `AsyncClient` the law runs in the event loop: keep it short.
"""

from collections.abc import Callable

from hapticd.client.commands import Ask, Exchange, Pause, reply_or_raise
from hapticd.core.errors import CommandError
from hapticd.protocol.answers import Coupling, answer_of

__all__ = ["Law"]

Law = Callable[[Coupling], float | None]


def followed(
    law: Law, rate_hz: float, duration_s: float | None, now_s: Callable[[], float]
) -> Exchange[Coupling]:
    """Run `law` at `rate_hz` for `duration_s`, or until it returns None; return the last Coupling.

    A position that the servo could not take yet is left out: the next one replaces it. CommandError
    `invalid` for a rate that is not above 0.
    """
    if not rate_hz > 0.0:
        raise CommandError("invalid", f"follow_law: rate_hz = {rate_hz:g} Hz must be above 0")
    due_s = now_s()
    first_s = None
    while True:
        felt = answer_of(Coupling, reply_or_raise((yield Ask("proxy")))["result"])
        first_s = felt.time_s if first_s is None else first_s
        if duration_s is not None and felt.time_s - first_s >= duration_s:
            return felt
        target_m = law(felt)
        if target_m is None:
            return felt
        answer = yield Ask("proxy", {"position_m": float(target_m)})
        if not (isinstance(answer, CommandError) and answer.code == "busy"):
            reply_or_raise(answer)
        left_s = due_s + 1.0 / rate_hz - now_s()
        due_s += 1.0 / rate_hz - min(left_s, 0.0)
        yield Pause(max(left_s, 0.0))
