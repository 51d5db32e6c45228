"""Words that are nearly right: they are taken, or the message has the word to type."""

import json
from typing import Any

import pytest
from support.client_double import ClientDouble

from hapticd.cli import change, daemon
from hapticd.cli.app import main
from hapticd.protocol.answers import GuardStatus


@pytest.fixture
def client(monkeypatch: pytest.MonkeyPatch) -> ClientDouble:
    double = ClientDouble()
    for module in (change, daemon, change):
        monkeypatch.setattr(module, "connect", lambda instance, timeout_s=2.0: double)
    return double


# --- taken ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("words", "value"),
    [
        ("damping ON", "on"),
        ("damping Off", "off"),
        ("damping AUTO", "auto"),
        ("damping -1", -1),
        ("damping -1.5 --instance left", -1.5),
        ("damping --json -1e-3", -1e-3),
        ("damping -- -2", -2),
        ("damping --instance -1 2", 2),
    ],
)
def test_damping_takes_any_case_and_a_sign(client: ClientDouble, words: str, value: Any) -> None:
    """A level below zero reaches the daemon, which answers with the limits of its device."""
    assert main(words.split()) == 0
    assert client.asked[0] == ("damping", value)


def test_guard_takes_any_case(client: ClientDouble, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Any] = []

    def answer(policy: str | None = None, **more: Any) -> GuardStatus:
        asked.append((policy, more["basis"], more["mode"]))
        return GuardStatus(worker="down")

    monkeypatch.setattr(client, "guard", answer, raising=False)
    assert main(["guard", "Refuse", "--basis", "THEOREM", "--mode", "Auto", "--json"]) == 0
    assert asked == [("refuse", "theorem", "auto")]


# --- explained ------------------------------------------------------------------------------------

MISTAKES = {  # words: what the message has, value, unit and remedy of the JSON error
    "set K=100N/m": ("write it in N/m, without unit: K=100", "100N/m", "N/m", "K=100"),
    "set B=2Ns/m": ("write it in N s/m, without unit: B=2", "2Ns/m", "N s/m", "B=2"),
    "set M=10g": ("write it in kg, without unit", "10g", "kg", None),
    "set K=1N/mm": ("write it in N/m, without unit", "1N/mm", "N/m", None),
    "set K=1,5": ("write a decimal point: K=1.5", "1,5", "N/m", "K=1.5"),
    "set K=-0,5": ("write a decimal point: K=-0.5", "-0,5", "N/m", "K=-0.5"),
    "set K=1,000": ("write a decimal point, not a comma", "1,000", "N/m", None),
    "set K=nan": ("K: 'nan' is not a finite number, in N/m", "nan", "N/m", None),
    "set K=-inf": ("K: '-inf' is not a finite number, in N/m", "-inf", "N/m", None),
    "set wall.side=1m": ("wall.side: '1m' is not a number", "1m", "", None),
    "set stiffness=100": ("did you mean 'K'?", "stiffness", "", "K=100"),
    "set Virtual-Damping=1": ("did you mean 'B'?", "Virtual-Damping", "", "B=1"),
    "set mass=0.01": ("did you mean 'M'?", "mass", "", "M=0.01"),
    "set k=1": ("did you mean 'K'?", "k", "", "K=1"),
    "damping 1,74": ("write a decimal point: damping 1.74", "1,74", "N s/m", "damping 1.74"),
    "damping nan": ("'nan' is not a finite number", "nan", "N s/m", None),
    "damping -inf": ("'-inf' is not a finite number", "-inf", "N s/m", None),
    "damping onn": ("'onn' is not on, off, auto or a level in N s/m", "onn", "N s/m", None),
}


@pytest.mark.parametrize("words", MISTAKES)
def test_message_says_what_to_type(
    client: ClientDouble, capsys: pytest.CaptureFixture[str], words: str
) -> None:
    says, value, unit, remedy = MISTAKES[words]
    assert main([*words.split(), "--json"]) == 2
    error = json.loads(capsys.readouterr().out)["error"]
    assert error["code"] == "usage"
    assert says in error["message"]
    found = error["detail"]
    assert (found["value"], found["unit"], found["remedy"]) == (value, unit, remedy)
    assert client.asked == []


def test_digits_without_end_are_no_finite_number(
    client: ClientDouble, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["set", f"K={'9' * 5000}", "--json"]) == 2
    message = json.loads(capsys.readouterr().out)["error"]["message"]
    assert message.endswith("...' is not a finite number, in N/m")
