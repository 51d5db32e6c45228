"""The first day at rigs whose truth is hidden from the steps: what they find is true, what is
broken is refused by name, and the path knows no simulated board.
"""

import ast
import functools
import subprocess
import sys

import pytest
from support.blind_rig import REFUSED, STEPS, BlindRig, first_day
from support.blind_truth import drawn
from support.tree import ROOT

PACKAGE = ROOT / "hapticd"
# seeds of the benchmark begin at 1000
SEED = 3  # both signs are wrong in the template, and the motor is weaker
MORE_SEEDS = (2, 5)
QUICK = "motor gain"  # the step until which a day is quick
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


@functools.cache
def seen(seed, until=""):
    """The day at the rig `seed`, what is true, the device as it was written, and the force."""
    with BlindRig(seed) as rig:
        day = first_day(rig, until=until)
        known = [
            (one, true)
            for result in day.results
            for one in result.values
            if (true := rig.true(one.name, result.step)) is not None
        ]
        return day, known, rig.settings.device, rig.worst_share


def agrees(seed, until=""):
    """Within twice the interval: one chance in 10 000, and the seed makes it none."""
    day, known, _, worst_share = seen(seed, until)
    assert day.refused is None
    assert not day.error
    for one, true in known:
        half = (one.high - one.low) / 2.0
        assert abs(one.value - true) <= 2.0 * half, f"{one}, true {true}"
    assert 0.0 < worst_share <= 0.1


def test_what_the_first_day_finds_is_what_is_true():
    agrees(SEED, QUICK)


@pytest.mark.slow
@pytest.mark.parametrize("seed", MORE_SEEDS)
def test_the_first_day_comes_to_its_end(seed):
    """Every step is done; how often intervals hold the truth is what benchmarks/blind.py counts."""
    day, known, _, worst_share = seen(seed)
    assert day.refused is None
    assert not day.error
    assert len(day.results) == len(STEPS)
    assert sum(one.low <= true <= one.high for one, true in known) >= 0.6 * len(known)
    assert 0.0 < worst_share <= 0.1


def test_the_written_signs_are_the_true_ones():
    device = seen(SEED, QUICK)[2]
    assert device.position.sign == drawn(SEED).position_sign
    assert device.force.sign == drawn(SEED).force_sign


@pytest.mark.slow
@pytest.mark.parametrize("broken", REFUSED)
def test_a_broken_rig_is_refused_by_name(broken):
    with BlindRig(4, broken) as rig:
        day = first_day(rig)
    assert day.refused is not None
    step, finding = day.refused
    expected, word = REFUSED[broken]
    assert step == expected
    assert word in f"{finding.what}; {finding.remedy}"


def test_a_push_stays_below_a_tenth_also_with_a_stronger_motor_that_sticks():
    with BlindRig(1, force_gain=1.3, coulomb_n=2.0) as rig:
        day = first_day(rig)
        assert day.refused is not None
        assert 0.05 < rig.worst_share <= 0.1


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
        "import pkgutil, sys, importlib, hapticd.rig, hapticd.cli.rig\n"
        "for package in (hapticd.rig, hapticd.cli.rig):\n"
        "    for one in pkgutil.iter_modules(package.__path__, package.__name__ + '.'):\n"
        "        importlib.import_module(one.name)\n"
        "print(*(name for name in sys.modules if name.startswith('hapticd.')))\n"
    )
    told = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    loaded = told.stdout.split()
    assert "hapticd.rig.motor" in loaded, told.stderr
    simulators = ("hapticd.sim", "hapticd.engine", "hapticd.assembly", "hapticd.plant.tables")
    assert not [name for name in loaded if name.startswith(simulators)]
