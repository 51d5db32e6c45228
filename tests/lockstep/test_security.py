"""What SECURITY.md says of the code: nothing that is read is run, and commands have no network
address.
"""

import ast
import re

import pytest
from support.security import PACKAGE, called, sources
from support.tree import ROOT


def calls(*names: str) -> list[tuple[str, ast.Call]]:
    """Every call of one of `names`, with its module."""
    return [
        (place, node)
        for place, nodes in sources().items()
        for node in nodes
        if isinstance(node, ast.Call) and called(node) in names
    ]


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
    tree = ast.parse((PACKAGE / "gateway/server.py").read_text())
    binding = [place for place, node in calls("create_server") if place.startswith("gateway/")]
    assert binding == ["gateway/server.py"]
    # files; and, behind keys, the relay's line to itself and the listener it was handed
    bound = [place for place, _ in calls("bind") if place.startswith("gateway/")]
    assert bound == ["gateway/relay.py", "gateway/relay.py", "gateway/server.py"]
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
