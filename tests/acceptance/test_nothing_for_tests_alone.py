"""Nothing stands in the package for the sake of its tests.

Every function, class, method and constant of a module has to be named somewhere in the package,
its examples, its benchmarks or the scripts of its documentation, outside its own definition. The
same is asked of the paper's reproduction (examples/weir2008). Names are compared, not what they
stand for: two things of one name cover for each other.

What a framework calls is left out: what has a decorator that registers it, the methods of a class
with a base from outside the package (pyusb's backend), and the effects, which the catalogue finds
by their base.
"""

import ast
from collections import Counter
from collections.abc import Iterable, Iterator
from typing import NamedTuple

import pytest
from support.tree import ROOT

PACKAGE = "hapticd"
REPRODUCTION = "examples.weir2008"
USERS = ("examples", "benchmarks", "docs")
PLAIN = {"staticmethod", "classmethod", "property", "abstractmethod", "dataclass", "cache"}

FOUND_BY_BASE = {"Effect"}

ALLOWED = {
    "usb.frames.CRC_POLYNOMIAL": "every constant of the C header has its twin",
    "zwidth.engine.compiled.compiled_part": "named in the text of a kernel",
    "zwidth.engine.compiled.law_f32": "named in the text of a kernel, with its type",
    "zwidth.engine.compiled.law_f64": "named in the text of a kernel, with its type",
}


class Definition(NamedTuple):
    """One named thing of a module: its place, and the syntax that is its own."""

    place: str  # module.name or module.Class.name
    name: str
    body: ast.AST


def definitions(module: str, tree: ast.Module) -> Iterator[Definition]:
    """What the module defines, methods included, as far as no framework calls it."""
    for node in tree.body:
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)) and not registered(node):
            yield Definition(f"{module}.{node.name}", node.name, node)
        elif isinstance(node, ast.ClassDef) and not registered(node):
            if not FOUND_BY_BASE & {*map(head, node.bases)}:
                yield Definition(f"{module}.{node.name}", node.name, node)
            yield from methods(module, node)
        elif isinstance(node, (ast.Assign, ast.AnnAssign)):
            for name in bound(node):
                yield Definition(f"{module}.{name}", name, node)


def methods(module: str, node: ast.ClassDef) -> Iterator[Definition]:
    for item in node.body:
        if isinstance(item, ast.FunctionDef) and not registered(item):
            yield Definition(f"{module}.{node.name}.{item.name}", item.name, item)


def registered(node: ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef) -> bool:
    """Whether a decorator hands it to someone who calls it."""
    heads = (item.func if isinstance(item, ast.Call) else item for item in node.decorator_list)
    return any(ast.unparse(head).rpartition(".")[2] not in PLAIN for head in heads)


def bound(node: ast.Assign | ast.AnnAssign) -> Iterator[str]:
    targets = node.targets if isinstance(node, ast.Assign) else [node.target]
    for target in targets:
        found = (item for item in ast.walk(target) if isinstance(item, ast.Name))
        yield from (item.id for item in found if isinstance(item.ctx, ast.Store))


def named(tree: ast.AST) -> Counter[str]:
    """Names that the syntax reads; a text that is one word, or one behind a module's, may be a name
    that is looked up.
    """
    count: Counter[str] = Counter()
    for node in ast.walk(tree):
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load):
            count[node.id] += 1
        elif isinstance(node, ast.Attribute):
            count[node.attr] += 1
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            count[node.value.rpartition(".")[2]] += 1
    return count


def outside_bases(trees: Iterable[ast.Module]) -> set[str]:
    """Classes of the package that derive from a class of another one."""
    classes = [node for tree in trees for node in ast.walk(tree) if isinstance(node, ast.ClassDef)]
    ours = {node.name for node in classes}
    return {node.name for node in classes if not {*map(head, node.bases)} <= ours}


def head(base: ast.expr) -> str:
    """Name of a base class, without its module and what stands in brackets."""
    return ast.unparse(base).partition("[")[0].rpartition(".")[2]


def unused(package: dict[str, ast.Module], others: Iterable[ast.Module]) -> list[str]:
    """Places of the definitions in `package` that neither it nor `others` name."""
    count = sum((named(tree) for tree in (*package.values(), *others)), Counter())
    foreign = outside_bases(package.values())
    found = [item for module, tree in package.items() for item in definitions(module, tree)]
    own: Counter[str] = Counter()
    for item in found:
        own[item.name] += named(item.body)[item.name]
    idle = [item for item in found if count[item.name] <= own[item.name]]
    return [item.place for item in idle if not called_from_outside(item, foreign)]


def called_from_outside(item: Definition, foreign: set[str]) -> bool:
    owner = set(item.place.split(".")[:-1])
    return item.name.startswith("__") or not owner.isdisjoint(foreign)


def trees(folder: str) -> dict[str, ast.Module]:
    """Syntax by module, as `client.client` for hapticd/client/client.py."""
    files = sorted((ROOT / folder).rglob("*.py"))
    names = (file.relative_to(ROOT / folder).with_suffix("").parts for file in files)
    texts = (ast.parse(file.read_text()) for file in files)
    return {".".join(parts): tree for parts, tree in zip(names, texts, strict=True)}


@pytest.fixture(scope="module")
def idle() -> set[str]:
    """What only tests name, or nobody."""
    users = {f"{folder}.{name}": tree for folder in USERS for name, tree in trees(folder).items()}
    looked_at = trees(PACKAGE)
    for name in [name for name in users if name.startswith(REPRODUCTION)]:
        looked_at[name] = users.pop(name)
    return set(unused(looked_at, users.values()))


def test_everything_in_the_package_is_used_outside_its_tests(idle: set[str]) -> None:
    assert idle - ALLOWED.keys() == set()


def test_what_is_allowed_needs_it(idle: set[str]) -> None:
    assert ALLOWED.keys() <= idle


SAMPLE = """
import usb
LIMIT, SPARE = 1, 2
def used(x): return x + LIMIT
def recursive(x): return recursive(x - 1)
@app.command()
def verb(): used(1)
class Board(usb.Backend):
    def write(self): pass
class Plain:
    def read(self): return self.read()
    def called(self): pass
    @property
    def looked_at(self): pass
Plain().called()
Board()
"""


@pytest.mark.parametrize(
    ("user", "expected"),
    [
        ("", ["m.SPARE", "m.recursive", "m.Plain.read", "m.Plain.looked_at"]),
        ("m.SPARE", ["m.recursive", "m.Plain.read", "m.Plain.looked_at"]),
        ("m.recursive(1); board.read(); getattr(x, 'looked_at')", ["m.SPARE"]),
    ],
)
def test_sample_shows_what_counts_as_use(user: str, expected: list[str]) -> None:
    assert unused({"m": ast.parse(SAMPLE)}, [ast.parse(user)]) == expected
