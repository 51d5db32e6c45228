"""Files that somebody edited badly: each is taken, or refused by one clear error."""

import random
import re
from contextlib import suppress
from pathlib import Path

import pytest
from support.attacks.documents import CONFIG, DEVICES, SCENES, mutated_toml, read_settings

from hapticd.core.errors import ConfigError

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


@pytest.mark.parametrize(("name", "key", "value"), FOUND)
def test_number_out_of_reach_is_one_clear_error(
    tmp_path: Path, name: str, key: str, value: str
) -> None:
    source = next(path for path in (*DEVICES, *SCENES) if path.name == name)
    text, count = re.subn(rf"(?m)(^|\b){key} = \S+", f"{key} = {value}", source.read_text())
    assert count
    (tmp_path / name).write_text(text)
    with pytest.raises(ConfigError, match="a number of the device or scene is beyond what double"):
        read_settings(tmp_path / name)


@pytest.mark.parametrize("part", range(8))
def test_mutated_files_are_taken_or_refused_by_name(tmp_path: Path, part: int) -> None:
    files = [CONFIG / "hapticd.toml", *DEVICES, *SCENES]
    for seed in range(part, SEEDS, 8):
        chance = random.Random(seed)
        source = chance.choice(files)
        path = tmp_path / source.name
        path.write_text(mutated_toml(source.read_text(), chance))
        with suppress(ConfigError):
            read_settings(path)
