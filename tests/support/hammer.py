"""Two processes hammer one mailbox: `hammer.py WRITER FOLDER`. The reader is the test."""

import sys
from pathlib import Path

from hapticd.mailbox import layout
from hapticd.mailbox.files import word_access
from hapticd.mailbox.servo_side import ServoMailbox

STOP_AT = 1 << 40


DERIVED = frozenset(
    (
        "tick",
        "time_ns",
        "board_us",
        "position_m",
        "velocity_m_per_s",
        "stiffness_force_n",
        "force_n",
        "tail",
    )
)


def derived_places() -> list[bool]:
    """For each value of a record: whether it is to follow the tick. The plan is one value, an
    array as many as it has.
    """
    plan = {name for name, *_ in layout.PLAN_FIELDS}
    places: list[bool] = []
    for name, _, *shape in layout.TELEMETRY:
        if name not in plan:
            places += [name in DERIVED] * (shape[0][0] if shape else 1)
    places.insert(3, False)
    return places


def write_records(folder: Path) -> None:
    """Publish records with numbers derived from their tick, as fast as Python can, until the reader
    requests a stop.
    """
    servo = ServoMailbox(folder, 1000.0, "", True, 1)
    servo.publish()
    pack = layout.RECORD.pack_into
    ring = servo.ring
    publish = servo.publish_head
    words = servo.words
    size = layout.RECORD.size
    slots = layout.RING_RECORDS
    first = layout.TELEMETRY_OFFSET
    stop = layout.GATEWAY_BEAT_WORD
    blank = layout.RECORD.unpack(bytes(size))
    follows = derived_places()
    tick = 0
    while words[stop] < STOP_AT:
        for _ in range(1000):
            values = [
                tick if follow else empty for follow, empty in zip(follows, blank, strict=True)
            ]
            pack(ring, first + tick % slots * size, *values)
            tick += 1
            publish(0, tick)
    servo.close()


def write_words(folder: Path) -> None:
    """Store a word that is all zeros or all ones through the release store, as fast as Python
    can.
    """
    servo = ServoMailbox(folder, 1000.0, "", True, 1)
    servo.publish()
    store, _ = word_access(servo.words, sys.argv[3] if len(sys.argv) > 3 else None)
    words = servo.words
    stop = layout.GATEWAY_BEAT_WORD
    target = layout.SERVO_BEAT_WORD
    ones = (1 << 64) - 1
    while words[stop] < STOP_AT:
        for _ in range(1000):
            store(target, 0)
            store(target, ones)
    servo.close()


if __name__ == "__main__":
    {"records": write_records, "words": write_words}[sys.argv[1]](Path(sys.argv[2]))
