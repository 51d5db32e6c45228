"""Events in words."""

import pytest

from hapticd.client.formatting import event_words
from hapticd.core.faults import BY_CODE
from hapticd.gateway.publisher import described
from hapticd.protocol.answers import Event, answer_of

FAULT = BY_CODE["overspeed"]


@pytest.mark.parametrize(
    ("event", "words"),
    [
        (
            {"kind": "state", "before": "disabled", "state": "enabled", "name": "sweep"},
            "disabled -> enabled (by sweep)",
        ),
        (
            {
                "kind": "state",
                "before": "enabled",
                "state": "fault",
                "fault": FAULT.code,
                "name": "",
                **described(FAULT),
            },
            f"enabled -> fault: overspeed: {FAULT.cause}; {FAULT.remedy}",
        ),
        (
            {"kind": "flight", "path": "/a/b.h5", "reason": "overspeed"},
            "flight recording of overspeed: /a/b.h5",
        ),
        ({"kind": "gap", "lost": 40}, "40 ticks were overwritten before telemetry had read them"),
        ({"kind": "warning", "text": "the disk is full"}, "warning: the disk is full"),
        (
            {"kind": "answer", "cmd": "set", "name": "sweep", "result": "applied"},
            "set of sweep: applied",
        ),
        (
            {
                "kind": "answer",
                "cmd": "set",
                "name": "sweep",
                "result": "refused",
                "text": "not passive",
            },
            "set of sweep: not passive",
        ),
        ({"kind": "of tomorrow", "path": "x", "actor": 17}, "of tomorrow: path x"),
    ],
)
def test_an_event_reads_as_a_sentence(event, words):
    assert event_words(answer_of(Event, event)) == words
