"""Careless arguments of the client end in an error that names value and limit, at once."""

import math
from pathlib import Path

import pytest

from hapticd.client.blocks import Excerpt
from hapticd.client.client import Client
from hapticd.core.errors import CommandError, ConfigError
from hapticd.core.params import Leased


@pytest.mark.parametrize("seconds", [-1.0, 0.0, math.nan, math.inf])
def test_seconds_that_are_no_time_are_refused(seconds: float) -> None:
    with pytest.raises(ConfigError, match=r"seconds = .* s: must be above 0 and finite"):
        Excerpt("servo.raw", seconds, None)


def test_recording_of_no_time_is_refused_before_a_daemon_is_asked(tmp_path: Path) -> None:
    """With value, limit and remedy."""
    said = r"seconds = -1 s: must be above 0 and finite; ask for more, such as seconds=1\.0"
    with Client(folder=tmp_path) as client, pytest.raises(ConfigError, match=said):
        client.record(seconds=-1)


@pytest.mark.parametrize("count", [-1, 0])
def test_counts_that_are_none_are_refused(count: int) -> None:
    with pytest.raises(ConfigError, match=f"count = {count}: must be above 0"):
        Excerpt("servo.raw", None, count)


def test_unknown_topic_is_refused_with_those_there_are(tmp_path: Path) -> None:
    with (
        Client(folder=tmp_path) as client,
        pytest.raises(ConfigError, match=r"'nosuch' is unknown; topics are event, .*servo\.raw"),
    ):
        next(client.listen("nosuch"))


@pytest.mark.parametrize("what", ["measuring", "perturbation"])
def test_only_environment_and_damping_are_kept_alive(tmp_path: Path, what: Leased) -> None:
    """What shakes or is not judged ends with a script that hangs."""
    said = f"lease of {what}: keep_alive is for environment and active_damping"
    with Client(folder=tmp_path) as client, pytest.raises(CommandError, match=said):
        client.lease(what, keep_alive=True)
