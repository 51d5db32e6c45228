"""What the firmware of the Pico states about the board is true, and fits the template of a device
file as docs/pico.md tells.
"""

from pathlib import Path

from support.pico_image import SERIAL, hello
from support.tree import ROOT

from hapticd.settings.build import device_params
from hapticd.settings.load import load
from hapticd.usb.frames import Capability
from hapticd.usb.search import differences

TEMPLATE = ROOT / "config" / "devices" / "example-board.toml"


def test_board_states_only_what_it_has() -> None:
    told = hello()
    inputs = Capability.EMERGENCY_STOP | Capability.AMPLIFIER_READY | Capability.EVENT
    assert told.capabilities == inputs | Capability.RESISTANCE | Capability.SAMPLE_PHASE
    assert told.axis_count == 1
    assert told.watchdog_ms == 20
    assert told.force_limit_n <= told.force_full_scale_n


def test_board_whose_damping_is_a_voltage_states_no_trim() -> None:
    told = hello((("DAMPING_PART", "DAC8563"),))
    assert told == hello()._replace(capabilities=hello().capabilities & ~Capability.RESISTANCE)


def test_template_as_the_page_changes_it_agrees_with_the_board(tmp_path: Path) -> None:
    text = TEMPLATE.read_text().replace("CHANGE-ME", SERIAL)
    asked = 'relies_on = ["probe", "temperature"]'
    assert asked in text
    (tmp_path / "devices").mkdir()
    (tmp_path / "devices" / "pico.toml").write_text(text.replace(asked, "relies_on = []"))
    (tmp_path / "hapticd.toml").write_text('device = "pico"\n')
    device = device_params(load(tmp_path / "hapticd.toml").device)
    assert differences(hello()._replace(force_limit_n=2.0), device) == ()
