"""[resistance] of a device file: numbers that could over-compensate the winding are refused."""

import re
from pathlib import Path

import pytest

from hapticd.core.errors import ConfigError
from hapticd.protocol.limits import WIDEST
from hapticd.render.winding import least_residual_ohm, loop_gain, ohm
from hapticd.settings.build import servo_params
from hapticd.settings.load import load
from hapticd.settings.scene import guard_setup
from hapticd.settings.toml import shipped

WARMING = (shipped("config") / "devices" / "warming.toml").read_text()
EXAMPLE = (shipped("config") / "devices" / "example-board.toml").read_text()


def read(tmp_path: Path, text: str, **numbers: object):
    """The device of `text` with other numbers."""
    for key, value in numbers.items():
        text, count = re.subn(rf"(?m)^{key} = \S+", f"{key} = {value}", text)
        assert count >= 1, key
    (tmp_path / "device.toml").write_text(text)
    (tmp_path / "hapticd.toml").write_text('device = "./device.toml"\n')
    return load(tmp_path / "hapticd.toml").device


def test_shipped_numbers_are_taken(tmp_path: Path):
    device = read(tmp_path, WARMING)
    params = device.resistance.params()
    assert params.trim.per_count * 32767 == pytest.approx(0.8)
    assert ohm(params, 80.0) == pytest.approx(1.6 * (1.0 + 0.00393 * 60.0))


def test_commented_table_of_the_template_is_taken(tmp_path: Path):
    lines = EXAMPLE.splitlines()
    first = next(place for place, line in enumerate(lines) if line.startswith("# [resistance]"))
    for place in range(first, lines.index("", first)):
        lines[place] = lines[place].removeprefix("# ")
    device = read(tmp_path, "\n".join(lines) + "\n")
    assert device.resistance.base_ohm == 1.5


@pytest.mark.parametrize(
    ("numbers", "said"),
    [
        (
            {"base_ohm": 1.55},
            r"resistance.base_ohm = 1.55 ohm: must be at most 1.539 ohm, .* 15.0 degC",
        ),
        (
            {"slew_ohm_per_s": 0.05},
            r"resistance.slew_ohm_per_s = 0.05 ohm/s: must be at least 0.066 ohm/s, as fast",
        ),
        (
            {"ambient_high_c": 15.0},
            r"resistance.ambient_high_c = 15.0 degC: must lie between ambient_low_c = 15.0 degC",
        ),
        ({"ambient_low_c": 119.0, "ambient_high_c": 125.0}, r"ambient_low_c = 119.0 degC"),
        ({"tolerance_ohm": 0.0}, r"resistance.tolerance_ohm = 0.0 ohm: must be more than 0.0 ohm"),
        ({"force_n_per_a": 0.0}, r"resistance.force_n_per_a = 0.0 N/A: must be at least 0.001 N/A"),
    ],
)
def test_numbers_that_contradict_each_other_are_refused_by_name(tmp_path: Path, numbers, said):
    with pytest.raises(ConfigError, match=said):
        read(tmp_path, WARMING, **numbers)


def test_loop_gain_below_minus_0_3_is_refused(tmp_path: Path):
    """By the closed form of the steady state: both ends of the model at one current."""
    with pytest.raises(ConfigError) as refused:
        read(tmp_path, WARMING, model_error=0.2)
    said = str(refused.value)
    assert re.search(r"device.toml:\d+: resistance.tolerance_ohm = 0.03 ohm: leaves a loop", said)
    (found,) = re.findall(r"g dR / K\^2 of (-\d\.\d+) at 4\.0 N s/m", said)
    # the current that brings the hot end to 120 degC, and where the cold end is then
    power_per_ohm = 95.0 / (8.0 * 1.2) / (1.6 * (1 + 0.00393 * 100.0))
    cold_c = 15.0
    for _ in range(200):
        cold_c = 15.0 + 8.0 * 0.8 * power_per_ohm * 1.6 * (1 + 0.00393 * (cold_c - 20.0))
    residual_ohm = 1.6 * 0.00393 * (cold_c - 120.0) + 0.03
    assert float(found) == pytest.approx(4.0 * residual_ohm / 1.65**2, rel=2e-3)
    assert float(found) < -0.3
    assert "the limit is -0.3, the circuit latches up at -1: raise it, lower model_error" in said


@pytest.mark.parametrize(
    "numbers", [{"tolerance_ohm": 0.15, "base_ohm": 1.4}, {"active_damping_ns_per_m": 2.0}]
)
def test_each_remedy_of_the_refusal_helps(tmp_path: Path, numbers):
    device = read(tmp_path, WARMING, model_error=0.2, **numbers)
    params = device.resistance.params()
    gain = loop_gain(
        params, least_residual_ohm(params, 120.0), device.limits.active_damping_ns_per_m
    )
    assert -0.3 <= gain < 0.0


def test_guard_judges_the_device_as_the_compensation_keeps_it(tmp_path: Path):
    """Not as cold and uncompensated as it starts: the winding 0.03 ohm above what is believed."""
    read(tmp_path, WARMING)
    settings = load(tmp_path / "hapticd.toml")
    judged = guard_setup(settings, servo_params(settings, "x"), WIDEST).model
    estimate = judged.states.index("velocity_estimate")
    force = judged.states.index("motor_force")
    # v_hat' = w_d (v + dR / K^2 F_a - v_hat)
    per_n = judged.a0[estimate][force] / -judged.a0[estimate][estimate]
    assert per_n * 1.65**2 == pytest.approx(0.03, rel=1e-9)


def test_simulated_device_without_a_winding_that_warms_up_has_nothing_to_compensate(tmp_path: Path):
    with pytest.raises(ConfigError, match=r"resistance: needs a \[model\] with the effect 'heat"):
        read(tmp_path, WARMING.replace('"heating", ', ""))


WEIR = (shipped("config") / "devices" / "weir2008.toml").read_text()


@pytest.mark.parametrize("active_damping_ns_per_m", [10.0, 3.3])
def test_a_simulated_winding_that_could_latch_up_is_refused_with_the_level_it_bears(
    tmp_path: Path, active_damping_ns_per_m
):
    """A compensation for 60 degC on a winding of 20: 0.3 K^2 / dR is 3.24 N s/m."""
    numbers = {"temperature_c": 20.0, "compensated_c": 60.0}
    text = WEIR.replace("temperature_c = 120.0", "temperature_c= 120.0")  # limits keep theirs
    with pytest.raises(ConfigError, match=r"leaves a loop gain .* to 3\.24"):
        read(tmp_path, text, **numbers, active_damping_ns_per_m=active_damping_ns_per_m)
    device = read(tmp_path, text, **numbers, active_damping_ns_per_m=3.2)
    assert device.limits.active_damping_ns_per_m == 3.2
