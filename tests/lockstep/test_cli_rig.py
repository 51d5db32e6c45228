"""`hapticd rig` from the command line, on a simulated rig in place of a daemon."""

import datetime
import json
import socket
import threading
from pathlib import Path

import pytest
from support.cli_rig import at_the_rig
from support.models import COUNT_N

from hapticd.cli.app import main
from hapticd.cli.rig import guided, steps
from hapticd.core.errors import AnalysisError, DaemonDown
from hapticd.core.params import ScaleParams
from hapticd.rig.certificate import write_changes
from hapticd.rig.result import Change, Request
from hapticd.settings.load import load
from hapticd.settings.toml import shipped

DAY = datetime.date(2026, 3, 4)


@pytest.fixture
def config(tmp_path: Path) -> Path:
    (tmp_path / "devices").mkdir()
    text = (shipped("config") / "devices" / "simulated.toml").read_text()
    text = text.replace("[force]\n", "[force]\nsign = -1\n")  # which is wrong
    (tmp_path / "devices" / "own.toml").write_text(text + "\n[commissioning]\n# not yet\n")
    file = tmp_path / "hapticd.toml"
    file.write_text('device = "own"\n')
    return file


@pytest.fixture
def hand(monkeypatch: pytest.MonkeyPatch):
    yield from at_the_rig(monkeypatch, {"force": ScaleParams(COUNT_N, -1), "commissioning": True})


def test_ctrl_c_leaves_the_device_file_and_ends_the_force(config, hand, monkeypatch):
    before = load(config).device_file.read_bytes()

    def interrupted(text):
        raise KeyboardInterrupt

    monkeypatch.setattr(steps, "asking", lambda yes: interrupted)
    assert main(["rig", "motor", "--yes", "--config", str(config)]) != 0
    assert load(config).device_file.read_bytes() == before
    assert hand.bench.status().state == "disabled"


def test_a_file_of_another_device_is_refused_before_anything_moves(config, hand, capsys):
    file = config.parent / "devices" / "own.toml"
    file.write_text(file.read_text().replace('"SIM0001"', '"SIM0002"'))
    assert main(["rig", "motor", "--yes", "--config", str(config)]) == 78
    assert "SIM0002" in capsys.readouterr().err
    assert not (config.parent / "devices" / "rig").exists()


def test_what_a_step_wrote_has_to_be_read_before_the_next_one(config, hand, capsys):
    """With the daemon's old sign of the position the pushes would verify the wrong sign of the
    force.
    """
    file = config.parent / "devices" / "own.toml"
    file.write_text(file.read_text().replace("[position]\n", "[position]\nsign = -1\n"))
    assert main(["rig", "motor", "--yes", "--config", str(config)]) == 78
    assert "another position than the daemon" in capsys.readouterr().err
    assert not hand.bench.newest["force_n"]
    assert not (config.parent / "devices" / "rig").exists()


def test_a_shipped_device_file_is_not_measured_into(hand, capsys):
    config = shipped("config") / "hapticd.toml"
    assert main(["rig", "motor", "--yes", "--config", str(config)]) == 78
    assert "copy it" in capsys.readouterr().err


def test_what_is_measured_says_how_old_it_is(config):
    """A date that somebody typed is no measurement; neither is a table that is not there."""
    file = load(config).device_file
    assert guided.measured("position", load(config).device) == ""
    assert guided.measured("commissioning", load(config).device) == ""
    week_ago = datetime.date.today() - datetime.timedelta(7)
    write_changes(
        file, [Change("position", "m_per_count", 0.5e-6)], "rig encoder", week_ago, "0.5 um"
    )
    told = guided.measured("position", load(config).device)
    assert told == f"measured {week_ago.isoformat()}, 7 days ago"


def test_a_table_that_outlived_its_newton_is_offered_again(config):
    file = load(config).device_file
    real = {"simulated": False}
    for full_scale_n, doubted in ((7.4, True), (8.0, False)):
        written = [
            Change("active_damping", "full_scale_ns_per_m", 10.0),
            Change("active_damping", "with_force_full_scale_n", full_scale_n),
        ]
        write_changes(file, written, "rig damping", datetime.date.today())
        said = guided.in_doubt("active_damping", load(config).device.model_copy(update=real))
        assert said.startswith("it was found with a scale of force of 7.4 N") == doubted


def test_the_path_waits_until_the_daemon_has_read_what_was_written(config, hand, monkeypatch):
    where = steps.StepOptions(instance="default", config=config)
    monkeypatch.setattr(guided, "connect", steps.connect)
    write_changes(
        load(config).device_file, [Change("force", "full_scale_n", 9.0)], "rig motor", DAY
    )
    assert "force" in guided._stale(where)
    reasons = iter(["no daemon runs", "the device file has a new force", ""])
    monkeypatch.setattr(guided, "_stale", lambda where: next(reasons))
    asked = []
    monkeypatch.setattr(steps, "answer", asked.append)
    guided._await_restart(where)
    assert len(asked) == 2
    assert all("start the daemon again" in one for one in asked)


def test_a_program_can_be_the_hand(tmp_path, monkeypatch):
    """It gets the action with its amount, and what it cannot do ends the step."""
    seen = []
    door = socket.socket(socket.AF_UNIX)
    door.bind(str(tmp_path / "hand"))
    door.listen()

    def hand():
        for answer in ({"done": True}, {"error": "no such mass"}):
            line, _ = door.accept()
            with line:
                seen.append(json.loads(line.makefile("rb").readline()))
                line.sendall(json.dumps(answer).encode() + b"\n")

    thread = threading.Thread(target=hand)
    thread.start()
    monkeypatch.setenv("HAPTICD_HAND", str(tmp_path / "hand"))
    ask = steps.asking(False)
    ask(Request("hang", "hang 50 g", 0.05))
    with pytest.raises(AnalysisError, match="no such mass"):
        ask(Request("hang", "hang 60 g", 0.06))
    thread.join()
    door.close()
    assert [(one["action"], one["amount"]) for one in seen] == [("hang", 0.05), ("hang", 0.06)]
    with pytest.raises(DaemonDown, match="HAPTICD_HAND"):
        ask(Request("let go", "let go"))
