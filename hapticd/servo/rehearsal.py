"""A tick without effect: on dummy data at the start of the spin it warms the caches (see `wait`).

A rehearsal must have no effect. The loop must have no closure (a variable that it shares with one
costs a tick more than a local).
"""

import os
from collections.abc import Callable

from hapticd.mailbox import layout
from hapticd.mailbox.servo_side import ServoMailbox
from hapticd.mailbox.stop_word import READ_BYTES
from hapticd.servo.plan import SETTLED, ServoState
from hapticd.servo.step import Step
from hapticd.usb.codec import HEAD_ENCODER, HEAD_STATUS, HEAD_TEMPERATURE
from hapticd.usb.device import Device

_BLANK = [one.unpack(bytes(one.size)) for one in (layout.STEPPED, layout.MEASURED)]


def rehearsal(
    device: Device,
    step: Step,
    mailbox: ServoMailbox,
    now: Callable[[], tuple[ServoState, int, int]],
) -> Callable[[], None]:
    """Return the function that the loop calls while it waits. `now` returns state, tick and slot of
    the next tick.
    """
    words = mailbox.words
    stop_word = mailbox.stop_word.descriptor
    pack_stepped = layout.STEPPED.pack_into
    pack_measured = layout.MEASURED.pack_into
    behind = layout.STEPPED.size
    stepped, measured = _BLANK
    ring = mailbox.ring
    in_bytes = device.in_buffer.tobytes
    size = layout.RECORD.size
    places = layout.RING_RECORDS

    def rehearse() -> None:
        head = device.rehearse()
        sample = (head[HEAD_ENCODER], head[HEAD_STATUS], head[HEAD_TEMPERATURE])
        state, tick, slot = now()
        settled = state[SETTLED]
        # not the slow path: with cold caches it takes longer than the spin
        if slot < settled.wake_tick:
            step(state, (), (*sample, 0, settled.host, 0, 0.0, 0, 0), slot)
        _ = (
            os.pread(stop_word, READ_BYTES, 0),
            words[layout.COMMAND_HEAD_WORD],
            words[layout.GATEWAY_BEAT_WORD],
            in_bytes(),
        )
        # the oldest record, which the tick replaces anyway
        place = layout.TELEMETRY_OFFSET + tick % places * size
        pack_stepped(ring, place, *stepped)
        pack_measured(ring, place + behind, *measured)

    return rehearse
