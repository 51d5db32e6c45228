"""docs/development/new-parameter.md, followed to the letter in a copy of the checkout."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from support.tree import ROOT

PAGE = (ROOT / "docs" / "development" / "new-parameter.md").read_text()
DIFFS = re.findall(r"```diff\n(.*?)```", PAGE, re.DOTALL)
ADDED_TEST = "tests/lockstep/test_cubic_spring.py"
COPIED = ("hapticd", "config", "tests", "benchmarks")
ENGINE = """
import sys
from dataclasses import replace
sys.path += ["tests"]
from support.devices import COUNTS, DRY, TWO_MASSES, device
from support.models import environment_tuple
from hapticd.zwidth.engine.batch import simulate
from hapticd.core.environment import Environment
from hapticd.render.law import at_rest, design_coefficients, render

cubic = Environment(cubic_stiffness_n_per_m3=1e9)
model = device(*TWO_MASSES, DRY, COUNTS)
result = simulate(model, [[100, 1, 0]], 2.0, environment=cubic, dtype="f64", keep="ticks")
whole = replace(cubic, stiffness_n_per_m=100.0, virtual_damping_ns_per_m=1.0)
numbers = environment_tuple(whole, float("inf"))
coefficients = design_coefficients(*cubic.filters, 1000.0)
state, same = at_rest(0.0), []
for x, force in zip(result.position_m[0].tolist(), result.force_n[0].tolist()):
    found, *_, state = render(x, state, numbers, coefficients)
    same.append(found == force)
print(all(same), 1e9 * max(abs(result.position_m[0])) ** 3 > 1e-4)
"""


@pytest.fixture(scope="module")
def copy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The checkout with the diffs of the page applied."""
    root = tmp_path_factory.mktemp("copy")
    for folder in COPIED:
        shutil.copytree(ROOT / folder, root / folder, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", root)
    for text in DIFFS:
        applied = subprocess.run(
            ["git", "apply", "-"], input=text, cwd=root, capture_output=True, text=True
        )
        assert applied.returncode == 0, applied.stderr
    return root


def run(copy: Path, *command: str) -> str:
    environment = {**os.environ, "PYTHONPATH": str(copy), "XDG_CACHE_HOME": str(copy / "cache")}
    done = subprocess.run(
        [sys.executable, *command], cwd=copy, env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def added(diff: str) -> list[str]:
    lines = diff.splitlines()
    return [line[1:] for line in lines if line.startswith("+") and not line.startswith("+++")]


def test_page_adds_a_row_a_term_of_the_law_and_a_test() -> None:
    """One statement for the row; of the law a name and the line that uses it."""
    names = [re.search(r"^\+\+\+ b/(\S+)$", one, re.MULTILINE) for one in DIFFS]
    assert [found and found[1] for found in names] == [
        "hapticd/core/environment.py",
        "hapticd/render/law.py",
        ADDED_TEST,
    ]
    row, law, _ = map(added, DIFFS)
    assert [line for line in row if re.match(r"    \w", line)] == row[:1]
    assert [line.strip() for line in law] == [
        "cubic,",
        "spring = -(stiffness + cubic * x * x) * x",
    ]


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("name", [ADDED_TEST, "tests/lockstep/test_environment_fields.py"])
def test_tests_of_the_copy_pass(copy: Path, name: str) -> None:
    assert " passed" in run(copy, "-m", "pytest", "-q", "-p", "no:cacheprovider", name)


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_engine_renders_the_parameter_as_the_law_does(copy: Path) -> None:
    """The kernels are compiled from the same law and take the parameter from the environment."""
    assert run(copy, "-c", ENGINE).split() == ["True", "True"]


def test_parameter_is_in_the_schemas_of_the_copy(copy: Path) -> None:
    assert '"cubic_stiffness_n_per_m3"' in run(copy, "-m", "hapticd", "config", "schema")
    source = "from hapticd.protocol.schemas import ADAPTER; print(ADAPTER.json_schema())"
    assert "'K3'" in run(copy, "-c", source)
