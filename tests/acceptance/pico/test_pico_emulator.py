"""The emulator itself: what it is installed from, and that it says when something of it is gone."""

import json
import os
import subprocess

import pytest
from support.pico_modules import EMULATOR, REMEDY, modules, needed, node
from support.tree import ROOT

LOOK = """\
import { missingNames, NAMES } from './rp2040.mjs';
const gone = { '': ['findPeripheral', 'noSuchName'], 'pio.0': ['machines', 'neither'] };
console.log(JSON.stringify([missingNames(), missingNames(gone), Object.keys(NAMES).length]));
"""


def test_inner_names_of_rp2040js_are_there_and_missed_when_gone() -> None:
    done = subprocess.run(
        [node(), "--input-type=module", "-e", LOOK],
        cwd=EMULATOR,
        env={**os.environ, "HAPTICD_NODE_MODULES": str(modules())},
        capture_output=True,
        text=True,
        check=True,
    )
    missing, gone, places = json.loads(done.stdout)
    assert missing == []
    assert gone == [".noSuchName", "pio.0.neither"]
    assert places > 10


def test_lock_file_names_the_version_by_its_hash_and_no_host() -> None:
    text = (EMULATOR / "package-lock.json").read_text()
    packages = json.loads(text)["packages"]
    others = {name: one for name, one in packages.items() if name}
    assert {one["version"] for one in others.values()} == {"1.4.1"}
    assert all(one["integrity"].startswith("sha512-") for one in others.values())
    assert "://" not in text


def test_missing_program_fails_with_the_line_to_type() -> None:
    with pytest.raises(AssertionError) as failed:
        needed("no-such-program")
    assert REMEDY in str(failed.value)
    installed = (ROOT / ".ci" / "deps").read_text()
    assert all(package in installed for package in ("nodejs", "npm", "gcc-arm-none-eabi"))
