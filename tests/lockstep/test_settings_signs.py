"""The signs of a device file are verified as long as they are those that somebody has seen."""

from dataclasses import replace

import numpy as np
from support.boards import board_params
from support.models import servo_params

from hapticd.mailbox.layout import Command, Value
from hapticd.model.params import HandParams, TouchParams
from hapticd.protocol.view import as_records
from hapticd.run.lockstep import LockStep
from hapticd.settings.build import device_params
from hapticd.settings.device import signs_hash
from hapticd.settings.load import load_device
from hapticd.settings.toml import shipped

SEEN = signs_hash("SIM0001", "1.0", 1, 1)
HELD = TouchParams(hands=(HandParams("hold", stiffness_n_per_m=2e4, damping_ns_per_m=50.0),))
EDITED = {
    "force": ("[force]", "[force]\nsign = -1"),
    "position": ("[position]", "[position]\nsign = -1"),
    "firmware": ('firmware = "1.0"', 'firmware = "1.7"'),
    "firmware left out": ('firmware = "1.0"\n', ""),
    "hash of others": (SEEN, signs_hash("SIM0001", "1.0", -1, 1)),
    "no hash": (f'signs = "{SEEN}"\n', ""),
}


def device_with(folder, old="", new=""):
    """The simulated device with signs that somebody has seen, and then `new` in place of `old`."""
    text = (shipped("config") / "devices" / "simulated.toml").read_text()
    table = 'signs_verified = true\nserial = "SIM0001"\nfirmware = "1.0"\n' + f'signs = "{SEEN}"\n'
    text = f"{text}\n[commissioning]\n{table}"
    assert old in text
    path = folder / "own.toml"
    path.write_text(text.replace(old, new) if old else text)
    return device_params(load_device(path))


def greatest_force_n(device):
    """What the servo commands with K = 100 N/m, the handle held 30 mm off."""
    off = replace(device.position, offset_count=-0.03 / device.position.per_count)
    servo = servo_params(device=replace(device, position=off))
    with LockStep(servo, board_params(touch=HELD)) as stack:
        stack.run(5)
        stack.do(Command.SET, {Value.STIFFNESS: 100.0, Value.RAMP_S: 0.0})
        stack.do(Command.ENABLE)
        return np.abs(as_records(stack.run(1500))["force_n"]).max()


def test_signs_that_were_seen_have_the_whole_force(tmp_path):
    device = device_with(tmp_path)
    assert not device.commissioning
    assert greatest_force_n(device) > 2.0
