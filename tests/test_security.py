"""What SECURITY.md says of the code: nothing that is read is run, and commands have no network
address.
"""

import ast
import re
from collections.abc import Iterator
from functools import cache

import pytest
from support.tree import ROOT

PACKAGE = ROOT / "hapticd"
# what can make a program of data, and where it is let in: all inside one user's own processes
RUNS_DATA = {
    "pickle": (),
    "cPickle": (),
    "_pickle": (),
    "shelve": (),
    "dill": (),
    "cloudpickle": (),
    "joblib": (),
    "yaml": (),
    "code": (),
    "xmlrpc": (),
    "marshal": ("mailbox/client_side.py", "mailbox/servo_side.py"),
    "multiprocessing": ("zwidth/executors.py",),
    "distributed": ("zwidth/executors.py",),
}
UNPICKLES = ("recv_pyobj", "send_pyobj", "read_pickle", "to_pickle")


@cache
def sources() -> dict[str, list[ast.AST]]:
    """What every module of the package is made of, by its place in it."""
    paths = sorted(PACKAGE.rglob("*.py"))
    return {
        path.relative_to(PACKAGE).as_posix(): list(ast.walk(ast.parse(path.read_text())))
        for path in paths
    }


def imported(nodes: list[ast.AST]) -> Iterator[str]:
    """The first word of everything that is imported, by statement or by name."""
    for node in nodes:
        if isinstance(node, ast.Import):
            yield from (alias.name.partition(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            yield (node.module or "").partition(".")[0]
        elif isinstance(node, ast.Call) and called(node) in ("import_module", "__import__"):
            yield str(getattr(node.args[0], "value", "")).partition(".")[0]


def called(node: ast.Call) -> str:
    """The last word of what is called."""
    return getattr(node.func, "attr", "") or getattr(node.func, "id", "")


def importers(name: str) -> list[str]:
    """The modules that import `name`."""
    return [place for place, nodes in sources().items() if name in imported(nodes)]


def calls(*names: str) -> list[tuple[str, ast.Call]]:
    """Every call of one of `names`, with its module."""
    return [
        (place, node)
        for place, nodes in sources().items()
        for node in nodes
        if isinstance(node, ast.Call) and called(node) in names
    ]


@pytest.mark.parametrize(("name", "places"), RUNS_DATA.items())
def test_what_can_run_data_is_imported_where_one_user_owns_both_ends(
    name: str, places: tuple[str, ...]
) -> None:
    assert importers(name) == list(places)


def test_nothing_is_unpickled_by_the_way() -> None:
    assert calls(*UNPICKLES) == []
    for place, node in calls("load"):
        if ast.unparse(node.func).startswith("np."):
            words = {word.arg: ast.unparse(word.value) for word in node.keywords}
            assert words.get("allow_pickle") == "False", f"{place}: {ast.unparse(node)}"


def test_text_is_made_a_program_in_one_place() -> None:
    """Of numbers that a device file was read into, and of nothing in its own words."""
    assert [place for place, _ in calls("eval", "exec")] == ["plant/composed.py"]


def test_no_shell_reads_what_a_program_is_started_with() -> None:
    shells = [
        f"{place}: {ast.unparse(node)}"
        for place, node in calls("run", "Popen", "call", "check_call", "check_output")
        if any(word.arg == "shell" for word in node.keywords)
    ]
    assert shells == []
    assert calls("popen", "create_subprocess_shell", "getoutput") == []
    systems = [node for _, node in calls("system") if ast.unparse(node.func) != "platform.system"]
    assert systems == []


def test_gateway_has_a_network_address_for_telemetry_alone() -> None:
    """One place binds TCP, and it gives what it bound to telemetry or its relay."""
    tree = ast.parse((PACKAGE / "gateway/addresses.py").read_text())
    binding = [place for place, node in calls("create_server") if place.startswith("gateway/")]
    assert binding == ["gateway/addresses.py"]
    # files; and, behind keys, the relay's line to itself and the listener it was handed
    bound = [place for place, _ in calls("bind") if place.startswith("gateway/")]
    assert bound == ["gateway/addresses.py", "gateway/relay.py", "gateway/relay.py"]
    users = [
        function
        for function in ast.walk(tree)
        if isinstance(function, ast.FunctionDef)
        and any(isinstance(n, ast.Call) and called(n) == "bound_tcp" for n in ast.walk(function))
        and function.name != "bound_tcp"
    ]
    assert [function.name for function in users] == ["_bound"]
    listens = re.findall(r"self\.(\w+)\.listen\(listener\)", ast.unparse(users[0]))
    assert listens == ["telemetry"]


@pytest.mark.parametrize("page", ["README.md", "docs/index.md", "docs/service.md"])
def test_the_page_on_security_is_found(page: str) -> None:
    found = re.search(r"SECURITY\.md|^security$", (ROOT / page).read_text(), re.MULTILINE)
    assert found is not None
    assert (ROOT / "docs/security.md").read_text().startswith("```{include} ../SECURITY.md")


def test_the_page_names_the_tests_and_pages_that_exist() -> None:
    text = (ROOT / "SECURITY.md").read_text()
    named = re.findall(r"\]\(([\w/.-]+)(?:#[\w-]+)?\)", text) + re.findall(
        r"`(tests/[\w.]+)`", text
    )
    assert named
    assert [place for place in named if not (ROOT / place).exists()] == []
