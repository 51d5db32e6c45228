"""The first day at rigs whose truth is hidden from the steps: what they find is true, what is
broken is refused by name, and the path knows no simulated board.
"""

import ast
import subprocess
import sys

import pytest
from support.blind_rig_helpers import QUICK, SEED, seen
from support.blind_truth import drawn
from support.tree import ROOT

PACKAGE = ROOT / "hapticd"
pytestmark = pytest.mark.timeout(1800)  # a whole day on a machine with other work
SECRETS = {  # names by which a simulated board, or the truth of one, could be reached
    "BoardParams",
    "BOARD_JSON",
    "board_params",
    "board.json",
    "sim",
    "engine",
    "assembly",
    ".backend",
    ".plant",
    ".seed",
    ".simulation",
    ".stack",
    ".truth",
}


def test_the_written_signs_are_the_true_ones():
    device = seen(SEED, QUICK)[2]
    assert device.position.sign == drawn(SEED).position_sign
    assert device.force.sign == drawn(SEED).force_sign


def test_truths_differ_from_seed_to_seed_and_not_from_day_to_day():
    assert drawn(1) == drawn(1)
    assert drawn(1) != drawn(2)
    signs = {(drawn(seed).position_sign, drawn(seed).force_sign) for seed in range(20)}
    assert len(signs) == 4


def names(tree):
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute):
            yield node.attr
            yield f"{'np' if ast.unparse(node.value) == 'np' else ''}.{node.attr}"
        elif isinstance(node, ast.Name):
            yield node.id
        elif isinstance(node, ast.alias):
            yield from node.name.split(".")
        elif isinstance(node, ast.ImportFrom):
            yield from (node.module or "").split(".")
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.value


@pytest.mark.parametrize("folder", ["rig", "cli/rig"])
def test_the_path_names_nothing_by_which_it_could_know_the_truth(folder):
    files = sorted((PACKAGE / folder).rglob("*.py"))
    assert files
    for path in files:
        found = set(names(ast.parse(path.read_text(encoding="utf-8"))))
        assert not found & SECRETS, path


def test_the_whole_path_loads_no_simulator():
    """Steps and verbs in an interpreter of their own."""
    program = (
        "import pkgutil, sys, importlib, hapticd.rig.steps, hapticd.cli.rig\n"
        "for package in (hapticd.rig, hapticd.rig.steps, hapticd.cli.rig):\n"
        "    for one in pkgutil.iter_modules(package.__path__, package.__name__ + '.'):\n"
        "        importlib.import_module(one.name)\n"
        "print(*(name for name in sys.modules if name.startswith('hapticd.')))\n"
    )
    told = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    loaded = told.stdout.split()
    assert "hapticd.rig.steps.motor" in loaded, told.stderr
    simulators = ("hapticd.sim", "hapticd.zwidth.engine", "hapticd.run", "hapticd.model.compose")
    assert not [name for name in loaded if name.startswith(simulators)]
