"""docs/development/new-effect.md, followed to the letter in a copy of the package."""

import ast
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from scipy.special import ellipk
from support.tree import ROOT

PAGE = (ROOT / "docs" / "development" / "new-effect.md").read_text()
FENCE = re.compile(r"```(?:python|toml)\n# ([^\s,]+)(?:, after class (\w+))?\n(.*?)```", re.DOTALL)
BLOCKS = {name: text for name, _, text in FENCE.findall(PAGE)}
AFTER = {name: neighbour for name, neighbour, _ in FENCE.findall(PAGE)}
CODE = {name: text for name, text in BLOCKS.items() if name.startswith("hapticd/")}
STIFFNESS_N_PER_M = 200.0
DOUBLING_M = 0.005
MASS_KG = 0.008
START_M = 0.01


@pytest.fixture(scope="module")
def copy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The package with what the page adds to it."""
    root = tmp_path_factory.mktemp("copy")
    for folder in ("hapticd", "config"):
        shutil.copytree(ROOT / folder, root / folder, ignore=shutil.ignore_patterns("__pycache__"))
    for name, text in BLOCKS.items():
        place = root / name
        before = place.read_text() if place.exists() else ""
        place.write_text(with_piece(before, text, AFTER[name]))
    return root


def with_piece(before: str, piece: str, neighbour: str) -> str:
    """`before` with the piece behind the class `neighbour`, or at the end where none is named."""
    if not neighbour:
        return f"{before}\n\n{piece}"
    found = next(node for node in ast.parse(before).body if getattr(node, "name", "") == neighbour)
    lines = before.splitlines(keepends=True)
    return "".join([*lines[: found.end_lineno], "\n\n", piece, *lines[found.end_lineno :]])


def run(copy: Path, *command: str) -> str:
    environment = {**os.environ, "PYTHONPATH": str(copy), "XDG_CACHE_HOME": str(copy / "cache")}
    done = subprocess.run(
        [sys.executable, *command], cwd=copy, env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def exact_period_s() -> float:
    """Duffing's equation from rest, undamped: 4 K(n) / w (Landau and Lifshitz, Mechanics,
    section 28, to all orders).
    """
    cubic = STIFFNESS_N_PER_M / DOUBLING_M**2
    at_start = STIFFNESS_N_PER_M + cubic * START_M**2
    return float(4.0 * ellipk(cubic * START_M**2 / (2.0 * at_start)) / (at_start / MASS_KG) ** 0.5)


def test_page_touches_the_catalogue_once_and_each_backend_once() -> None:
    assert list(CODE) == [
        "hapticd/model/effects.py",
        "hapticd/model/composed.py",
        "hapticd/zwidth/engine/source.py",
    ]


@pytest.mark.slow
def test_effect_of_the_page_moves_as_physics_says(copy: Path) -> None:
    found: dict[str, Any] = json.loads(run(copy, "look.py"))
    assert found["board_s"] == pytest.approx(exact_period_s(), rel=1e-4)
    assert found["engine_s"] == pytest.approx(exact_period_s(), rel=1e-4)


def test_effect_of_the_page_is_explained_and_in_the_schema(copy: Path) -> None:
    schema = run(copy, "-m", "hapticd", "config", "schema", "--device")
    assert '"doubling_m"' in schema
    source = "from hapticd.model.effects import KINDS; print([kind.key for kind in KINDS])"
    assert "'ends', 'flexure', 'coulomb'" in run(copy, "-c", source)
