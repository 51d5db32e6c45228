"""Files that somebody edited badly: each is taken, or refused by one clear error."""

import random
import re
from contextlib import suppress
from pathlib import Path

import pytest

from hapticd.assembly.lockstep import scene_params
from hapticd.errors import ConfigError
from hapticd.settings.build import board_params, gateway_params, servo_params
from hapticd.settings.load import load
from hapticd.settings.toml import shipped

CONFIG = shipped("config")
DEVICES = sorted((CONFIG / "devices").glob("*.toml"))
SCENES = sorted((CONFIG / "scenes").glob("*.toml"))
NUMBER = re.compile(r"(?m)(?<=[=\[,] )[-+]?\d[\d_.]*(?:e[-+]?\d+)?")
TINY = ["1e-308", "5e-324", "2.3e-308", "1e-300", "1e-160", "1e-30", "-1e-308"]
HUGE = ["1e30", "1e160", "1e300", "1.7e308", "9223372036854775807", "inf", "-inf", "nan"]
VALUES = [*TINY, *HUGE, "0", "-0.0", "-1", "1", "3", "1e-3", "1e3", "true", '"x"', "[]"]
# what a longer run found: a division by zero, an overflow, eigenvalues of infinities
FOUND = [
    ("weir2008_probe_hp.toml", "torque_constant_nm_per_a", "2.3e-308"),
    ("weir2008_literal.toml", "torque_constant_nm_per_a", "1e-300"),
    ("weir2008_probe_hp.toml", "slider_kg", "2.3e-308"),
    ("ideal.toml", "lever_m", "1e-300"),
    ("shaped.toml", "highpass_hz", "1e-308"),
    ("hot.toml", "level_ns_per_m", "1e308"),
]
SEEDS = 160


def read(path: Path) -> None:
    """Everything that starting with the file at `path` would compute from it."""
    if "effects" in path.read_text() and path.name in {scene.name for scene in SCENES}:
        scene_params(path)
        return
    if path.name in {device.name for device in DEVICES}:
        text = (CONFIG / "hapticd.toml").read_text()
        config = path.with_name("hapticd.toml")
        config.write_text(re.sub(r"(?m)^device = .*$", f'device = "{path}"', text))
        path = config
    settings = load(path)
    servo_params(settings, "default")
    board_params(settings)
    gateway_params(settings)


def mutated(text: str, chance: random.Random) -> str:
    for _ in range(chance.choice((1, 1, 1, 2, 3))):
        numbers = list(NUMBER.finditer(text))
        lines = text.split("\n")
        if numbers and chance.random() < 0.9:
            number = chance.choice(numbers)
            text = text[: number.start()] + chance.choice(VALUES) + text[number.end() :]
        else:
            del lines[chance.randrange(len(lines))]
            text = "\n".join(lines)
    return text


@pytest.mark.parametrize(("name", "key", "value"), FOUND)
def test_number_out_of_reach_is_one_clear_error(
    tmp_path: Path, name: str, key: str, value: str
) -> None:
    source = next(path for path in (*DEVICES, *SCENES) if path.name == name)
    text, count = re.subn(rf"(?m)(^|\b){key} = \S+", f"{key} = {value}", source.read_text())
    assert count
    (tmp_path / name).write_text(text)
    with pytest.raises(ConfigError, match="a number of the device or scene is beyond what double"):
        read(tmp_path / name)


@pytest.mark.parametrize("part", range(8))
def test_mutated_files_are_taken_or_refused_by_name(tmp_path: Path, part: int) -> None:
    files = [CONFIG / "hapticd.toml", *DEVICES, *SCENES]
    for seed in range(part, SEEDS, 8):
        chance = random.Random(seed)
        source = chance.choice(files)
        path = tmp_path / source.name
        path.write_text(mutated(source.read_text(), chance))
        with suppress(ConfigError):
            read(path)
