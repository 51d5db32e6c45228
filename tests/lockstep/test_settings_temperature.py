"""A limit of the winding's temperature that its converter cannot read is refused; any other ends
force.
"""

import re

import pytest
from support.boards import board_params
from support.models import servo_params

from hapticd.core.errors import ConfigError
from hapticd.core.faults import BY_CODE
from hapticd.mailbox.layout import Command, Result
from hapticd.model.params import InjectionParams
from hapticd.protocol.view import as_records
from hapticd.run.lockstep import LockStep
from hapticd.settings.build import device_params
from hapticd.settings.load import load
from hapticd.settings.toml import shipped

OWN = (shipped("config") / "devices" / "simulated.toml").read_text()


def loaded(folder, limit_c, c_per_count, sign=1, offset=0.0):
    """The device whose temperature is read and limited so."""
    scale = f"[temperature]\nsign = {sign}\noffset_count = {offset}\nc_per_count = {c_per_count}"
    text, once = re.subn(r"\[temperature\]\nc_per_count = \S+", scale, OWN)
    assert once == 1
    text, once = re.subn(r"(?m)^temperature_c = \S+", f"temperature_c = {limit_c}", text)
    assert once == 1
    (folder / "device.toml").write_text(text)
    (folder / "hapticd.toml").write_text('device = "./device.toml"\n')
    return device_params(load(folder / "hapticd.toml").device)


REFUSED = [  # degC, degC a count, sign, offset, the most that is read
    (120.0, 0.003, 1, 0.0, "98.298"),
    (98.3, 0.003, 1, 0.0, "98.298"),
    (120.0, 0.003, -1, 0.0, "98.301"),
    (120.0, 0.01, 1, 22768.0, "99.98"),
    (120.0, 0.01, -1, -22767.0, "100"),
]


@pytest.mark.parametrize(("limit_c", "per_count", "sign", "offset", "most"), REFUSED)
def test_a_limit_that_the_converter_cannot_read_is_refused_with_what_it_can(
    tmp_path, limit_c, per_count, sign, offset, most
):
    with pytest.raises(ConfigError) as refused:
        loaded(tmp_path, limit_c, per_count, sign, offset)
    assert f"limits.temperature_c = {limit_c} degC: must be at most {most} degC" in str(
        refused.value
    )


@pytest.mark.parametrize(("sign", "most_c"), [(1, 98.298), (-1, 98.301)])
def test_the_highest_limit_that_is_taken_ends_force_beyond(tmp_path, sign, most_c):
    """The sensor goes to its end: one count beyond the limit."""
    device = loaded(tmp_path, most_c, 0.003, sign)
    extreme = InjectionParams("sensor_extreme", tick=100, value=32767 if sign > 0 else -32768)
    with LockStep(servo_params(device=device), board_params(injections=(extreme,))) as stack:
        stack.run(5)
        assert stack.do(Command.ENABLE).result is Result.APPLIED
        assert as_records(stack.run(200))["fault"][-1] == BY_CODE["over_temperature"].number
