"""Timing of a running daemon: the share of a period that a tick takes, and causes of late ticks.

Each cause has its remedy.
"""

from hapticd.mailbox.layout import LateCause
from hapticd.protocol.answers import Room, Status
from hapticd.run.doctor.checks import CheckResult
from hapticd.run.doctor.probes import OK, WARN

__all__ = ["judge", "judge_room"]

NAME = "late ticks"
RARE = 1e-4  # share of the ticks; typical limit of a quiet computer without isolated cores


ABOVE = "see the lines above: rtprio limit, governor, C-state latency, isolation"
OWN = "the servo's own work takes too long; see the interpreter above, or lower realtime.rate_hz"
ADVICE = {  # causes of late ticks, and remedies
    LateCause.WAKE: ("another process occupied the servo's core when the tick was due", ABOVE),
    LateCause.SUBMISSION: ("the kernel took the transfers late", ABOVE),
    LateCause.BUS: (
        "the board got its frame late, or sent none",
        "use a root port, and check the other devices on the board's bus",
    ),
    LateCause.COMPLETION: (
        "the frame was there in time; the interrupt or the wake-up after it was late",
        "move other interrupts off the servo's core; with threaded interrupts raise the USB"
        " controller's",
    ),
    LateCause.TRANSFER: (
        "a transfer took long, one after the other",
        "set usb.in_flight = true, which also separates the parts of a transfer",
    ),
    LateCause.STEP: ("computing the force took long", OWN),
    LateCause.PUBLISH: ("what follows the frame took long", OWN),
}


def judge_room(room: Room | None) -> CheckResult:
    """Judge the share of its period that a tick takes."""
    if room is None or not room.tick_us:
        return CheckResult("tick", OK, "not measured yet")
    text = (
        f"{room.tick_us:.0f} us of {room.period_us:g} us, transfers included; a quarter of the"
        f" period is left up to {room.highest_rate_hz:g} Hz"
    )
    if room.short:
        fix = f"set realtime.rate_hz to {room.highest_rate_hz:g} or less"
        return CheckResult("tick", WARN, text, "whatever holds up such a tick makes it late", fix)
    return CheckResult("tick", OK, text)


def judge(status: Status, words: str) -> CheckResult:
    """Judge the late ticks of a running servo from its `status`; `words` are the counts as text."""
    counts = {name: one.count for name, one in status.late.items()}
    late = sum(counts.values())
    if not late:
        return CheckResult(NAME, OK, "none")
    ticks = status.counters.get("ticks", 0)
    text = f"{late} of {ticks}: {words}"
    if late <= RARE * ticks:
        return CheckResult(NAME, OK, text)
    why, fix = ADVICE[LateCause[max(counts, key=counts.__getitem__).upper()]]
    return CheckResult(NAME, WARN, text, f"most often {why}", fix)
