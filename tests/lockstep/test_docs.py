"""The documentation repeats the program's tables, all of them; the table of faults is complete;
the site builds.
"""

import ast
import importlib.util
import re
import shutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest
from support.docs import CODES, broken
from support.tree import ROOT, path_of_test

import hapticd
from hapticd.core.faults import BY_CODE, BY_NUMBER, FAULTS


@pytest.fixture
def layers(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The module that draws the layers."""
    monkeypatch.syspath_prepend(ROOT / "docs")
    return importlib.import_module("pages.layers")


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the documentation's sources with its generated pages."""
    root = tmp_path_factory.mktemp("site")
    for folder in ("docs", "examples", "firmware_iface"):
        shutil.copytree(
            ROOT / folder, root / folder, ignore=shutil.ignore_patterns("generated", "__pycache__")
        )
    for file in ("CHANGELOG.md", "CITATION.cff", "SECURITY.md", "pyproject.toml"):
        shutil.copy(ROOT / file, root)
    subprocess.run([sys.executable, "-B", "docs/generate.py"], cwd=root, check=True)
    return root / "docs"


# --- the table of faults --------------------------------------------------------------------------


def raised_codes() -> set[str]:
    """Keys of BY_CODE that the package names."""
    found = set()
    texts = [path.read_text() for path in (ROOT / "hapticd").rglob("*.py")]
    for text in (one for one in texts if "BY_CODE" in one):
        for node in ast.walk(ast.parse(text)):
            if (
                isinstance(node, ast.Subscript)
                and isinstance(node.value, ast.Name)
                and node.value.id == "BY_CODE"
            ):
                found.add(ast.literal_eval(node.slice))
    return found


def test_every_fault_is_raised_and_every_raise_is_a_fault() -> None:
    assert raised_codes() == set(CODES)


def test_numbers_and_codes_are_unique() -> None:
    assert len(BY_CODE) == len(BY_NUMBER) == len(FAULTS)
    numbers = [fault.number for fault in FAULTS]
    assert numbers == sorted(numbers)


def test_every_fault_says_what_to_do() -> None:
    assert not [
        fault.code for fault in FAULTS if not (fault.cause and fault.action and fault.remedy)
    ]
    assert not [fault.code for fault in FAULTS[1:] if "reset" not in fault.remedy]


def test_no_note_is_left_of_a_fault_that_is_gone() -> None:
    assert sorted(path.stem for path in (ROOT / "docs" / "faults").glob("*.md")) == sorted(CODES)


def test_link_that_leads_nowhere_is_found(tmp_path: Path) -> None:
    (tmp_path / "a.html").write_text('<p id="x"><a href="#x"></a><a href="b.html#y"></a>')
    (tmp_path / "b.html").write_text('<a href="a.html#x"></a><img src="c.png">')
    assert broken(tmp_path) == ["a.html: b.html#y", "b.html: c.png"]


PAGES = [
    path
    for pattern in ("*.md", "docs/**/*.md", "examples/*.md", "firmware_iface/*.md")
    for path in sorted(ROOT.glob(pattern))
    if "generated" not in path.parts
]


def anchors(page: Path) -> set[str]:
    """The places of `page` to which a link can lead, as code hosts name them."""
    headings = re.findall(r"^#+ (.*)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", one.strip().lower()).replace(" ", "-") for one in headings}


def lost_links(page: Path) -> list[str]:
    """Links of `page` that lead to no file of the checkout, or to no heading; a file that is
    generated is in no checkout.
    """
    text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL | re.M)
    found = []
    for target in re.findall(r"\]\(([^)\s]+)", text):
        if "://" in target:
            continue
        name, _, place = target.partition("#")
        to = (page.parent / name).resolve() if name else page
        made = "generated" in to.parts
        if made or not to.exists() or (place and place not in anchors(to)):
            found.append(target)
    return found


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_link_of_a_page_leads_somewhere_on_a_code_host(page: Path) -> None:
    assert lost_links(page) == []


def test_link_into_generated_files_and_to_a_missing_heading_is_found(tmp_path: Path) -> None:
    (tmp_path / "b.md").write_text("# A heading, here\n")
    page = tmp_path / "a.md"
    page.write_text("[](generated/c.md) [](b.md#a-heading-here) [](b.md#none) [](d.md)\n")
    assert lost_links(page) == ["generated/c.md", "b.md#none", "d.md"]


def test_every_page_is_in_the_contents() -> None:
    """And is so found on the site and on a code host."""
    listed = re.findall(r"^- \[[^\]]*\]\(([^)]+)\)$", (ROOT / "docs/index.md").read_text(), re.M)
    pages = [path for path in PAGES if path.parent.name in ("docs", "development")]
    known = {(ROOT / "docs" / name).resolve() for name in listed}
    missing = [page.name for page in pages if page not in known and not is_wrapper(page)]
    assert missing == ["index.md"]


def is_wrapper(page: Path) -> bool:
    """Whether `page` only includes a file of another folder, for the site."""
    return page.read_text(encoding="utf-8").startswith("```{include}")


# --- names of modules -----------------------------------------------------------------------------

MODULES = {
    ".".join(file.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): file
    for file in (ROOT / "hapticd").rglob("*.py")
}
PACKAGES = {name.split(".")[1] for name in MODULES if "." in name} | {"measure"}  # one that was
FILE_ENDINGS = {"conf", "csv", "h5", "json", "limits", "mat", "rules", "schema", "service"} | {
    "sysusers", "target", "tmpfiles", "toml",
}  # fmt: skip
# of `hapticd status --json`
STATUS_KEYS = {"gateway.outside", "guard.timing", "servo.realtime", "servo.report"}
ELSEWHERE = ("model.masses.", "usb.core.")  # a table of device files; pyusb


def names_that_do_not_exist(text: str, settings: set[str]) -> list[str]:
    """Dotted names behind `hapticd.`, those in backticks that begin with a package, and paths, of
    which nothing is there; `settings`: dotted names that mean something else.
    """
    found = re.findall(r"(?<![\w/.-])hapticd\.([a-z]\w*(?:\.\w+)*)", text)
    quoted = re.findall(rf"`((?:{'|'.join(PACKAGES)})(?:\.\w+)+)`", text)
    own = [name for name in quoted if not f"{name}.".startswith(ELSEWHERE)]
    found += [name for name in own if name not in settings]
    for first, more in re.findall(r"`(?:hapticd\.)?([\w.]+)\.\w+`((?:, `\.\w+`)+)", text):
        found += [f"{first}{rest}" for rest in re.findall(r"\.\w+", more)]
    paths = re.findall(r"(?<![\w/])hapticd/[\w/]+\.py", text)
    return [name for name in found if not exists(name)] + [
        path for path in paths if not (ROOT / path).exists()
    ]


def exists(name: str) -> bool:
    """Whether `name` is a module, or is written in the module that its beginning names."""
    parts = re.sub(r"\.(__\w+|NAME)$", "", f"hapticd.{name}").split(".")
    if parts[-1] in FILE_ENDINGS or parts[1] in FILE_ENDINGS - {"limits"}:
        return True
    if parts[1] in hapticd.__all__:
        return True
    for count in range(len(parts), 1, -1):
        file = MODULES.get(".".join(parts[:count]))
        if file is not None:
            # the docstring of a package names much that is one layer further down
            code = file.read_text(encoding="utf-8").removeprefix('"""').partition('"""')[2]
            return count == len(parts) or bool(re.search(rf"\b{parts[count]}\b", code))
    return False


@pytest.mark.parametrize(
    ("line", "missing"),
    [
        ("from `hapticd.signal.spa`", ["signal.spa"]),
        ("| `hapticd.zwidth.trial`, `.limits`, `.campaign` | |", ["zwidth.campaign"]),
        ("see `measure.trial` and `zwidth.trial`", ["measure.trial"]),
        ("`model.theorem.damping_floor`", ["model.theorem.damping_floor"]),
        (
            "in hapticd/sim/engine/job.py, not hapticd/zwidth/engine/job.py",
            ["hapticd/sim/engine/job.py"],
        ),
        ("`servo.realtime` of 70-hapticd.rules and hapticd.toml", []),
    ],
)
def test_name_of_a_module_that_is_gone_is_found(line: str, missing: list[str]) -> None:
    assert names_that_do_not_exist(line, STATUS_KEYS) == missing


def test_overview_names_only_files_that_are_there() -> None:
    """Whole paths in its tables, and paths below `hapticd/` in the ways through the files."""
    page = (ROOT / "docs" / "architecture.md").read_text()
    whole = re.findall(r"`(hapticd/[\w/]+(?:\.py|/))`", page)
    ways = re.findall(r"(?<![\w/`.])([a-z][a-z0-9_]*/[a-z0-9_/]+\.py)\b", page)
    assert len(whole) > 30
    assert len(ways) > 30
    missing = [name for name in whole if not (ROOT / name).exists()]
    missing += [
        name for name in ways if not any((top / name).exists() for top in (ROOT, ROOT / "hapticd"))
    ]
    assert not missing


def test_every_package_stands_in_the_overview(layers: ModuleType) -> None:
    page = (ROOT / "docs" / "architecture.md").read_text()
    assert not [name for name in layers.imports() if f"`{name}`" not in page]


def test_drawing_of_the_layers_is_that_of_the_imports(layers: ModuleType) -> None:
    """When this fails: `python docs/generate.py` draws it anew."""
    assert layers.DRAWING.read_text() == layers.drawing()


def test_drawing_leaves_out_what_a_longer_way_implies(
    layers: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = {"cli": {"client", "errors"}, "client": {"errors"}, "errors": set()}
    monkeypatch.setattr(layers, "imports", lambda: {k: frozenset(v) for k, v in found.items()})
    layers.below.cache_clear()
    assert layers.nearest("cli") == ["client"]
    assert "imports client<" in layers.drawing()
    layers.below.cache_clear()


SAFETY = (ROOT / "docs" / "safety.md").read_text()
SHOWN = re.findall(r"`(test_\w+\.py)::(test_\w+)`", SAFETY)


@pytest.mark.parametrize(("file", "test"), sorted(set(SHOWN)))
def test_every_promise_is_shown_by_a_test_that_exists(file: str, test: str) -> None:
    source = path_of_test(file).read_text()
    assert re.search(rf"^def {test}\(", source, re.MULTILINE)


def test_every_promise_names_a_test() -> None:
    lines = [line for line in SAFETY.splitlines() if line.startswith("| ")]
    rows = [line for line in lines if not line.startswith("| promise | by whom |")]
    assert len(rows) > 140
    assert all(re.search(r"`test_\w+\.py::test_\w+` \|$", row) for row in rows)
