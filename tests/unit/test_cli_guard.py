"""What the command line says of the guard: refusals and warnings with what is allowed and the hand,
and, with real processes, that a refused change moves nothing while a worker that dies comes back.
"""

import json
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from support.client_double import ClientDouble
from support.daemon import Daemon
from support.guard_device import change, shipped_judge

from hapticd.cli import change as guard_verb
from hapticd.cli.app import main
from hapticd.client import GuardVerdict, Receipt
from hapticd.client.formatting import guard_line, objection_lines, receipt_text, timing_words
from hapticd.core.errors import CommandError, GuardWarning
from hapticd.protocol.answers import Event, GuardStatus, Timing, answer_of

VERDICT = {
    "safe": False,
    "policy": "refuse",
    "basis": "theorem",
    "number": 4,
    "margin_ns_per_m": -1.01,
    "allowed": {"K": [0.0, 320.0], "B": [-0.5, 1.25], "M": None},
    "least_active_damping_ns_per_m": 1.43,
    "clamped": False,
    "outcome": "refused",
    "reasons": [{"code": "short", "text": "1.01 N s/m short; at 112 Hz"}],
    "remedies": [{"code": "less", "text": "ask for less"}],
    "text": "refused: 1.01 N s/m short; at 112 Hz; ask for less",
    "cmd": "damping",
}
EVENT = {
    "hand": {"text": "a mass of 120 g, at 34 Hz", "mass_kg": 0.12},
    "text": "a hand that would shake the device: a mass of 120 g, at 34 Hz",
}
WRONG = "1.01 N s/m short; at 112 Hz"  # a mark that joined sentences once
REMEDY = "ask for less"
SAYS = [
    "allowed, each with the others as asked: K 0 to 320 N/m, B -0.5 to 1.25 N s/m",
    "least level of active damping tried that is enough: 1.43 N s/m",
    EVENT["text"],
]
GUARD = {
    "policy": "clamp",
    "basis": "theorem",
    "margin_ns_per_m": 0.1,
    "mode": "auto",
    "measuring": False,
    "delay_periods": 0.1875,
    "worker": "up",
    "trouble": "",
    "verdict": VERDICT,
}


def says(**changed: Any) -> GuardVerdict:
    """The verdict with `changed` fields, as clients have it."""
    return answer_of(GuardVerdict, {**VERDICT, **changed})


class GuardDouble(ClientDouble):
    """A daemon whose guard has an opinion."""

    def hand(self, verdict: GuardVerdict) -> Event | None:
        return answer_of(Event, {**EVENT, "number": verdict.number})

    def guard(self, *what: Any, **more: Any) -> GuardStatus:
        self._ask("guard", (what, more))
        return answer_of(GuardStatus, GUARD)

    def call(self, cmd: str) -> dict[str, Any]:
        return {"result": GUARD} if cmd == "guard" else super().call(cmd)


@pytest.fixture
def double(monkeypatch: pytest.MonkeyPatch) -> GuardDouble:
    double = GuardDouble()
    monkeypatch.setattr("hapticd.cli.change.connect", lambda instance: double)
    return double


def test_refusal_says_what_is_allowed_and_which_hand_would_shake(
    double: GuardDouble, capsys: pytest.CaptureFixture[str]
) -> None:
    double.error = CommandError("guard", f"damping: {VERDICT['text']}", None, says())
    assert main(["damping", "off"]) == 4
    told = capsys.readouterr().err.splitlines()
    lines = (f"damping: refused: {WRONG}", *SAYS, REMEDY)
    assert told == [f"hapticd: {line}" for line in lines]


def test_refusal_carries_verdict_and_hand_in_json(
    double: GuardDouble, capsys: pytest.CaptureFixture[str]
) -> None:
    double.error = CommandError("guard", "no", None, says())
    assert main(["damping", "off", "--json"]) == 4
    error = json.loads(capsys.readouterr().out)["error"]
    assert error["guard"] == error["guard"] | {**VERDICT, "hand": error["guard"]["hand"]}
    assert error["guard"]["hand"] == error["guard"]["hand"] | EVENT["hand"]


def test_warning_goes_to_stderr_beside_the_receipt(
    double: GuardDouble, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    warned = Receipt(
        "applied", "enabled", 7, 3, 3, {"K": 9.0}, says(policy="warn", outcome="safer")
    )
    monkeypatch.setattr(double, "_ask", lambda verb, what=None: warned)
    assert main(["set", "K=9"]) == 0
    found = capsys.readouterr()
    assert found.out == "enabled: applied at tick 3, revision 7: K 9 N/m\n"
    assert found.err.splitlines() == [f"hapticd: {line}" for line in (WRONG, *SAYS, REMEDY)]


@pytest.mark.parametrize(("verb", "words"), [("set", "set K=9"), ("guard", "guard --mode off")])
def test_verb_says_in_its_own_words_what_a_script_is_warned_about(
    double: GuardDouble,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    verb: str,
    words: str,
) -> None:
    do = getattr(double, verb)

    def warned(*what: Any, **more: Any) -> Any:
        warnings.warn(GuardWarning("applied, and not safe"), stacklevel=1)
        return do(*what, **more)

    monkeypatch.setattr(double, verb, warned)
    assert main(words.split()) == 0
    assert "not safe" not in capsys.readouterr().err


def test_receipt_says_what_is_to_spare(
    double: GuardDouble, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    verdict = says(safe=True, clamped=True, margin_ns_per_m=0.25)
    done = Receipt("applied", "enabled", 7, 3, 3, {"K": 9.0}, verdict)
    monkeypatch.setattr(double, "_ask", lambda verb, what=None: done)
    assert main(["set", "K=99"]) == 0
    found = capsys.readouterr()
    assert found.out.endswith("; reduced to a safe value, 0.25 N s/m to spare, by theorem\n")
    assert found.err == ""


def test_more_damping_is_the_remedy_only_where_some_level_would_do() -> None:
    judge = shipped_judge()
    far, near = (
        answer_of(GuardVerdict, change(judge, asked, policy="warn")["verdict"])
        for asked in ({"K": 5000.0, "B": 20.0}, {"K": 150.0, "B": 1.0})
    )
    assert far is not None
    assert near is not None
    told = objection_lines(far)
    assert "no active damping of this device is enough" in told
    assert "ask for less" in told
    remedy = "ask for less, or for more active damping"
    assert remedy in objection_lines(near)
    assert [one.code for one in far.remedies] == ["less"]
    assert [one.code for one in near.remedies] == ["less", "more_damping"]


def test_guard_changes_and_shows(double: GuardDouble, capsys: pytest.CaptureFixture[str]) -> None:
    words = "guard clamp --basis theorem --margin 0.1 --mode auto"
    assert main(words.split()) == 0
    asked = {"basis": "theorem", "margin_ns_per_m": 0.1, "mode": "auto"}
    assert double.asked[0] == ("guard", (("clamp",), asked))
    first, *rest = capsys.readouterr().out.splitlines()
    assert first == (
        "clamp, by theorem, at least 0.1 N s/m to spare; active damping auto; delay 0.1875 periods"
    )
    assert rest == [VERDICT["text"], *SAYS[:2]]


def test_guard_waits_for_the_verdict_on_what_is_in_force(
    double: GuardDouble, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    answers = [GUARD | {"verdict": None}, GUARD | {"verdict": None}, GUARD]
    told = (answer_of(GuardStatus, one) for one in answers)
    monkeypatch.setattr(double, "guard", lambda *what, **more: next(told))
    monkeypatch.setattr("hapticd.cli.change.time.sleep", lambda seconds: None)
    assert main(["guard"]) == 0
    assert list(told) == []
    assert VERDICT["text"] in capsys.readouterr().out


def test_guard_without_a_worker_says_why_there_is_no_verdict(
    double: GuardDouble, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    found = GUARD | {"verdict": None, "worker": "down", "trouble": "it died", "unjudged": "nothing"}
    monkeypatch.setattr(double, "guard", lambda *what, **more: answer_of(GuardStatus, found))
    assert main(["guard"]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == "nothing"


@pytest.mark.parametrize(
    ("counted", "measured", "says"),
    [
        (
            (0.25, True),
            0.375,
            "0.25 periods, measured (p99 of the last minute: 0.375, the model assumes 0.125)",
        ),
        (
            (0.125, False),
            None,
            "0.125 periods, assumed by the model (p99 of the last minute: not known yet, the model"
            " assumes 0.125)",
        ),
    ],
)
def test_delays_are_named_and_which_one_is_counted_on(
    counted: tuple[float, bool], measured: float | None, says: str
) -> None:
    delays = {
        "counted_periods": counted[0],
        "measured": counted[1],
        "measured_p99_periods": measured,
        "model_periods": 0.125,
    }
    lines = guard_verb.guard_lines(answer_of(GuardStatus, GUARD | {"delays": delays}))
    assert f"delay counted on: {says}" in lines


WITHOUT = {
    "level_ns_per_m": 0.0,
    "stiffness_n_per_m": 292.3,
    "ideal_stiffness_n_per_m": 719.6,
    "lost_share": 0.594,
}
WITH = WITHOUT | {
    "level_ns_per_m": 1.74,
    "stiffness_n_per_m": 1705.6,
    "ideal_stiffness_n_per_m": 4198.3,
}
NOTHING = WITHOUT | {"stiffness_n_per_m": 0.0, "ideal_stiffness_n_per_m": 0.0, "lost_share": None}


@pytest.mark.parametrize(
    ("without", "damped", "measured", "says"),
    [
        (
            WITHOUT,
            WITH,
            True,
            "delay 0.6875 periods, measured: K up to 292.3 instead of 719.6 N/m without it (59 %"
            " less); with 1.74 N s/m of active damping 1706 instead of 4198 (theorem)",
        ),
        (
            WITHOUT,
            WITHOUT,
            False,
            "delay 0.6875 periods, assumed by the model: K up to 292.3 instead of 719.6 N/m"
            " without it (59 % less) (theorem)",
        ),
        (
            NOTHING,
            NOTHING,
            True,
            "delay 0.6875 periods, measured: no K is passive, with or without it (theorem)",
        ),
    ],
)
def test_cost_of_the_delay_is_one_line(
    without: dict[str, Any], damped: dict[str, Any], measured: bool, says: str
) -> None:
    timing = {"delay_periods": 0.6875, "ideal_delay_periods": 0.0, "measured": measured}
    timing |= {"without_active_damping": without, "with_active_damping": damped}
    assert timing_words(answer_of(Timing, timing)) == says


def test_unknown_cost_of_the_delay_is_no_line() -> None:
    assert timing_words(None) == ""


def test_measuring_is_shown() -> None:
    measuring = {**GUARD, "measuring": True, "worker": "down", "trouble": "gone"}
    line = guard_line(answer_of(GuardStatus, measuring))
    assert line.startswith("off: a measurement is running")
    assert line.endswith("; gone")


# --- real processes -------------------------------------------------------------------------------


@pytest.fixture
def daemon(runtime: Path) -> Iterator[Daemon]:
    """With the rights that it gets, for without them a busy machine has delays of many periods."""
    with Daemon(runtime, settings="") as daemon:
        yield daemon


def test_receipt_of_a_change_in_stages_says_where_it_leads() -> None:
    given = {"K": 500.0, "B": 2.0, "M": 0.0, "active_damping": 1.74}
    verdict = says(safe=True, margin_ns_per_m=0.367, given=given, stages=2)
    now = {"K": 100.0, "B": 1.0, "M": 0.0, "active_damping": 1.74}
    receipt = Receipt("staged", "enabled", 5, 900, 900, now, verdict)
    text = receipt_text(receipt)
    assert text.startswith("enabled: stage 1 of 2 at tick 900")
    assert "K 100 N/m" in text
    assert text.index("on the way to K 500 N/m, B 2 N s/m") < text.index("0.367 N s/m to spare")
