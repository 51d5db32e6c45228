"""What SECURITY.md says of the code: nothing that is read is run, and commands have no network
address.
"""

import ast
from collections.abc import Iterator

import pytest
from support.security import called, sources
from test_security import calls

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


def imported(nodes: list[ast.AST]) -> Iterator[str]:
    """The first word of everything that is imported, by statement or by name."""
    for node in nodes:
        if isinstance(node, ast.Import):
            yield from (alias.name.partition(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            yield (node.module or "").partition(".")[0]
        elif isinstance(node, ast.Call) and called(node) in ("import_module", "__import__", "need"):
            yield str(getattr(node.args[0], "value", "")).partition(".")[0]


def importers(name: str) -> list[str]:
    """The modules that import `name`."""
    return [place for place, nodes in sources().items() if name in imported(nodes)]


@pytest.mark.parametrize(("name", "places"), RUNS_DATA.items())
def test_what_can_run_data_is_imported_where_one_user_owns_both_ends(
    name: str, places: tuple[str, ...]
) -> None:
    assert importers(name) == list(places)


UNPICKLES = ("recv_pyobj", "send_pyobj", "read_pickle", "to_pickle")


def test_nothing_is_unpickled_by_the_way() -> None:
    assert calls(*UNPICKLES) == []
    for place, node in calls("load"):
        if ast.unparse(node.func).startswith("np."):
            words = {word.arg: ast.unparse(word.value) for word in node.keywords}
            assert words.get("allow_pickle") == "False", f"{place}: {ast.unparse(node)}"


def test_text_is_made_a_program_in_one_place() -> None:
    """Of numbers that a device file was read into, and of nothing in its own words."""
    assert [place for place, _ in calls("eval", "exec")] == ["model/composed.py"]
