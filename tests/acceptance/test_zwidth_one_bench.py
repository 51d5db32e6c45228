"""One bench: trials are judged in one function, limits searched in one, batches run by one, and
nobody else does it.
"""

import ast
from functools import cache
from pathlib import Path

import pytest

import hapticd
from examples.weir2008 import run
from examples.weir2008.run import SCENES, SECONDS, conditions
from hapticd.cli.zwidth import common
from hapticd.zwidth.store import fingerprint

PACKAGE = Path(hapticd.__file__).parent
REPRODUCTION = Path(run.__file__).parent
ONLY = {  # what may be called from where: {called: {module: functions}}
    "judge": {"signal.assess": {"_judged"}},
    "assess": {
        "zwidth.outcomes": {"run_trials"},  # trials of batches
        "zwidth.trial": {"judged"},  # records
        "zwidth.watch": {"_decide"},  # whether a record that grows is decided already
    },
    "axis_limit": {
        "zwidth.limits": {"predicted_limit"},
        "studies.remedies": {"largest_stiffness", "stiffest", "set_volume"},  # by the theorem
    },
    "bracket": {"zwidth.limits": {"_rounds", "_together"}},
    "search_limit": {"zwidth.limits": {"counted"}},
    "run_all": {
        "zwidth.limits": {"run_plans"},
        "zwidth.map": {"run_map"},
        "zwidth.search": {"run_search"},
        "zwidth.outcomes": {"outcomes_of"},
    },
    "run_trials": {"zwidth.outcomes": {"goes_on"}},
}
HOME = {
    "judge": "signal.verdict",
    "assess": "signal.assess",
    "axis_limit": "zwidth.passive_set",
    "bracket": "zwidth.limits",
    "search_limit": "zwidth.limits",
    "run_all": "zwidth.outcomes",
    "run_trials": "zwidth.outcomes",
}


def users(package: Path, name: str, home: str) -> dict[str, set[str]]:
    """{module: innermost functions} that mention `name` of the module `home`, by whatever name
    they imported it.
    """
    found: dict[str, set[str]] = {}
    for file in package.rglob("*.py"):
        module = ".".join(file.relative_to(package).with_suffix("").parts)
        for function, used in _mentions(_parsed(file), module, name, home):
            if used:
                found.setdefault(module, set()).add(function)
    return found


@cache
def _parsed(file: Path) -> ast.Module:
    return ast.parse(file.read_text())


def _mentions(tree: ast.Module, module: str, name: str, home: str) -> list[tuple[str, bool]]:
    direct, modules = _names(tree, module, name, home)

    def mentions(node: ast.AST) -> bool:
        if isinstance(node, ast.Name):
            return node.id in direct and isinstance(node.ctx, ast.Load)
        return (
            isinstance(node, ast.Attribute)
            and node.attr == name
            and ast.unparse(node.value) in modules
        )

    found: list[tuple[str, bool]] = []

    def walk(node: ast.AST, function: str) -> None:
        inner = node.name if isinstance(node, ast.FunctionDef) else function
        found.append((inner, mentions(node)))
        for child in ast.iter_child_nodes(node):
            walk(child, inner)

    walk(tree, "")
    return found


def _names(tree: ast.Module, module: str, name: str, home: str) -> tuple[set[str], set[str]]:
    """Names of the function itself, and of the module that it lies in."""
    direct = {name} if module == home else set()
    modules = {f"hapticd.{home}"}
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module == f"hapticd.{home}":
            direct |= {item.asname or item.name for item in node.names if item.name == name}
        elif (
            isinstance(node, ast.ImportFrom)
            and f"{node.module}" == f"hapticd.{home}".rpartition(".")[0]
        ):
            modules |= {
                item.asname or item.name
                for item in node.names
                if f"{node.module}.{item.name}" == f"hapticd.{home}"
            }
        elif isinstance(node, ast.Import):
            modules |= {
                item.asname for item in node.names if item.asname and item.name == f"hapticd.{home}"
            }
    return direct, modules


@pytest.mark.parametrize("name", ONLY)
def test_one_implementation(name: str) -> None:
    assert users(PACKAGE, name, HOME[name]) == ONLY[name]
    assert users(REPRODUCTION, name, HOME[name]) == {}


PLANTED = {
    "judge": (
        "from hapticd.signal.verdict import judge as rule\n\ndef passes(trial):\n    return"
        " rule(trial).within_90_deg\n"
    ),
    "axis_limit": (
        "from hapticd.zwidth import passive_set\n\ndef searched(flown):\n    return"
        " passive_set.axis_limit(flown, 0, 2e4)\n"
    ),
    "run_trials": (
        "def mine(pool, given):\n    from hapticd.zwidth.outcomes import run_trials\n\n    return"
        " pool.map(run_trials, given)\n"
    ),
}


@pytest.mark.parametrize("name", PLANTED)
def test_a_second_implementation_is_seen(name: str, tmp_path: Path) -> None:
    (tmp_path / "zwidth").mkdir()
    (tmp_path / "zwidth" / "planted.py").write_text(PLANTED[name])
    (function,) = users(tmp_path, name, HOME[name])["zwidth.planted"]
    assert function in PLANTED[name]


def test_nobody_simulates_for_spectra_beside_the_bench() -> None:
    """Trials are judged by spectra of batches: only `outcomes.run_trials` asks the engine for
    them.
    """
    asking = {
        file.relative_to(PACKAGE.parent)
        for folder in (PACKAGE / "zwidth", PACKAGE / "studies", REPRODUCTION)
        for file in folder.rglob("*.py")
        for call in ast.walk(_parsed(file))
        if isinstance(call, ast.Call)
        for given in (*call.args, *(keyword.value for keyword in call.keywords))
        if isinstance(given, ast.Constant) and given.value == "spectra"
    }
    assert asking == {Path("hapticd/zwidth/outcomes.py")}


@pytest.mark.parametrize("device", SCENES)
def test_reproduce_and_limits_ask_for_the_same_trials(device: str) -> None:
    """So limits of paired seeds are the same but for the tolerance of the search; the key of a
    trial is all it depends on.
    """
    asked = common.conditions(common.scene_of(SCENES[device]), SECONDS, seed=1)
    assert fingerprint(asked) == fingerprint(conditions(device))
    assert fingerprint(asked.perturbed(more_seed=2)) == fingerprint(
        common.conditions(asked.scene, SECONDS, seed=3)
    )
