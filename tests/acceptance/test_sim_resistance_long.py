"""The simulated board's resistance DAC: what the circuit believes in, and who may move it."""

from pathlib import Path

from hapticd.settings.build import board_params
from hapticd.settings.load import Override, load
from hapticd.sim.board import hello
from hapticd.usb.frames import Capability


def test_shipped_device_that_warms_up_is_compensated(tmp_path: Path):
    (tmp_path / "hapticd.toml").write_text('device = "warming"\n')
    board = board_params(load(tmp_path / "hapticd.toml"))
    assert board is not None
    assert board.trim_full_scale_ohm == 0.8
    assert hello(board).capabilities & Capability.RESISTANCE
    lacking = Override(("simulation", "board", "lacks"), ["resistance"], "-")
    other = board_params(load(tmp_path / "hapticd.toml", (lacking,)))
    assert other is not None
    assert not hello(other).capabilities & Capability.RESISTANCE
