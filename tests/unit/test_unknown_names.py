"""An unknown name is an error wherever hapticd takes names."""

import json
from typing import Any

import pytest
from support.gateway_stand_in import setup

from benchmarks.guard_attack import shipped_judge
from hapticd.console.browser import EXCITE, Asker
from hapticd.core.environment import Environment
from hapticd.core.errors import AnalysisError, ConfigError, HapticdError
from hapticd.protocol.commands import values_given
from hapticd.protocol.limits import CommandLimits

STRANGE: list[dict[str, Any]] = [{"k": 1.0}, {"damping": 1.0}, {"wall": {"stiffness": 1.0}}]


@pytest.mark.parametrize("change", STRANGE)
def test_environment_takes_no_unknown_field(change: dict[str, Any]) -> None:
    with pytest.raises(ConfigError, match="no field of an environment; there are K, B, M"):
        Environment().changed({"K": 5.0, **change})
    with pytest.raises(ConfigError, match="no field of an environment"):
        Environment().fields(change)


def test_environment_takes_no_number_for_a_table() -> None:
    with pytest.raises(ConfigError, match="wall: no field"):
        Environment().changed({"wall": 3.0})
    with pytest.raises(ConfigError, match=r"K\.high: no field"):
        Environment().changed({"K": {"high": 3.0}})


@pytest.mark.parametrize("change", STRANGE)
def test_limits_know_every_name_that_they_are_asked_about(change: dict[str, Any]) -> None:
    limits = CommandLimits.announced(setup().servo)
    with pytest.raises(ConfigError, match="no limit is known of it; there are K, B, M"):
        limits.broken_by(change)


@pytest.mark.parametrize("change", STRANGE)
def test_no_number_of_a_change_is_left_out_of_the_command(change: dict[str, Any]) -> None:
    with pytest.raises(HapticdError, match="no value of a command"):
        values_given(change)


def test_judge_refuses_a_request_with_an_unknown_field() -> None:
    target = Environment().message()
    asked = {"ask": "look", "n": 1, "target": target, "level_on": 0.0, "basis": "theorem"}
    with pytest.raises(AnalysisError, match="'margin'"):
        shipped_judge().answer({**asked, "margin_ns_per_m": 0.0, "margin": 1.0})


def test_page_excites_only_with_the_field_on() -> None:
    replies: list[str] = []
    asker = Asker("nobody-here", "page", lambda: 0)
    asker.ask({"cmd": EXCITE, "ask": 1, "active": True}, replies.append)
    asker.close()
    asker._thread.shutdown()
    found = json.loads(replies[0])
    assert found["code"] == "invalid"
    assert "active" in found["text"]
