"""Events: a code with fields for programs, and one sentence made of them for people."""

import ast
from collections.abc import Iterator
from string import Formatter
from typing import Any, get_args, get_type_hints

import pytest
from support.tree import ROOT

from hapticd.client.formatting import event_words
from hapticd.core.faults import BY_CODE
from hapticd.gateway.publisher import described
from hapticd.protocol.answers import Event, answer_of
from hapticd.protocol.journal import EVENTS, EventCode, Journal, sentence

FAULT = BY_CODE["overspeed"]
HAND = {"text": "a mass of 120 g, at 34 Hz", "growth": "its motion doubles in 40 ms"}
SWEEP = {"what": "environment", "actor": 17, "name": "sweep"}


def noted(code: EventCode, **fields: Any) -> Event:
    """The event as a client reads it."""
    journal = Journal(lambda: 0)
    journal.note(code, **fields)
    (event,) = journal.drain()
    return answer_of(Event, event)


@pytest.mark.parametrize(
    ("code", "fields", "words"),
    [
        (
            "state",
            {"before": "disabled", "state": "enabled", "name": "sweep"},
            "disabled -> enabled (by sweep)",
        ),
        ("state", {"before": "enabled", "state": "disabled", "name": ""}, "enabled -> disabled"),
        (
            "fault",
            {
                "before": "enabled",
                "state": "fault",
                "fault": FAULT.code,
                "name": "",
                **described(FAULT),
            },
            f"enabled -> fault: overspeed: {FAULT.cause}; {FAULT.remedy}",
        ),
        (
            "flight",
            {"path": "/a/b.h5", "reason": "overspeed"},
            "flight recording of overspeed: /a/b.h5",
        ),
        ("gap", {"lost": 40}, "40 ticks were overwritten before telemetry had read them"),
        ("answers_lost", {"reason": "the disk is full"}, "warning: the disk is full"),
        (
            "answered",
            {"cmd": "set", "name": "sweep", "result": "applied"},
            "set of sweep: applied",
        ),
        (
            "refused",
            {"cmd": "set", "name": "sweep", "result": "refused", "reason": "not passive"},
            "set of sweep: not passive",
        ),
        (
            "damping_late",
            {"cmd": "set", "name": "sweep", "reported_ns_per_m": 0.0, "needed_ns_per_m": 1.5},
            "set of sweep: the next stage waited too long: the board reports 0 of 1.5 N s/m; the"
            " environment in force stays",
        ),
        (
            "hand",
            {"hand": HAND},
            "guard: a hand that would shake the device: a mass of 120 g, at 34 Hz; its motion"
            " doubles in 40 ms",
        ),
        (
            "lease_silent",
            {**SWEEP, "ttl_s": 5.0},
            "lease: the lease of environment by sweep (actor 17) ended: its holder was silent for"
            " 5 s",
        ),
        (
            "listener_refused",
            {"address": "10.0.0.7", "reason": "it has no key", "times": 3},
            "warning: telemetry refused to 10.0.0.7: it has no key, 3 times; add a client with"
            " `hapticd keys client`",
        ),
        (
            "listener_refused",
            {"address": "", "reason": "it has no key"},
            "warning: telemetry refused: it has no key; add a client with `hapticd keys client`",
        ),
        (
            "mark",
            {"text": "block 2", "name": "sweep", "tick": 7},
            "mark: block 2 (by sweep, tick 7)",
        ),
    ],
)
def test_an_event_reads_as_a_sentence(code: EventCode, fields: dict[str, Any], words: str) -> None:
    event = noted(code, **fields)
    assert event_words(event) == words
    assert (event.kind, event.code) == (EVENTS[code][0], code)


def test_an_event_of_a_newer_daemon_is_shown_by_its_text_or_its_fields() -> None:
    newer = {"kind": "of tomorrow", "code": "unheard_of", "path": "x", "actor": 17}
    assert event_words(answer_of(Event, newer)) == "of tomorrow: path x"
    told = answer_of(Event, {**newer, "text": "x is full"})
    assert event_words(told) == "of tomorrow: x is full"


def test_there_is_a_sentence_for_each_code() -> None:
    assert set(EVENTS) == set(get_args(EventCode))


def fields_of(part: str) -> set[str]:
    return {name.partition("[")[0] for _, name, _, _ in Formatter().parse(part) if name}


def test_sentences_are_made_of_fields_of_an_event() -> None:
    for code, (_, *parts) in EVENTS.items():
        for part in parts:
            assert fields_of(part) <= set(get_type_hints(Event)), code


def literal_notes() -> Iterator[tuple[str, str, set[str]]]:
    """(module, code, fields) of each event whose code and fields stand in the source."""
    for path in sorted((ROOT / "hapticd").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            match node:
                case ast.Call(
                    func=ast.Attribute(attr="note" | "cancel"),
                    args=[ast.Constant(value=str(code)), *_],
                    keywords=fields,
                ) if all(one.arg for one in fields):
                    yield path.name, code, {str(one.arg) for one in fields}


def test_whoever_notes_an_event_gives_what_its_sentence_needs() -> None:
    """A field that is missing would end the gateway."""
    found = list(literal_notes())
    assert {"publisher.py", "terms.py", "stages.py", "lease_server.py"} <= {
        one for one, *_ in found
    }
    for module, code, fields in found:
        needed = fields_of(EVENTS[code][1])  # type: ignore[index]
        assert needed <= fields, (module, code)


def test_a_sentence_without_what_it_needs_is_an_error() -> None:
    with pytest.raises(KeyError, match="lost"):
        sentence("gap")
