"""The documentation repeats the program's tables, all of them; the table of faults is complete;
the site builds.
"""

import ast
import importlib.util
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import fields
from html.parser import HTMLParser
from pathlib import Path
from types import ModuleType
from urllib.parse import unquote, urlsplit

import pytest
import typer.main
from playwright.sync_api import sync_playwright
from support.console_page import ARGUMENTS, CHROMIUM
from support.tree import ROOT, path_of_test

from hapticd.cli.app import command_line
from hapticd.client import Client
from hapticd.faults import BY_CODE, BY_NUMBER, FAULTS
from hapticd.gateway.schemas import MODELS
from hapticd.gateway.telemetry import TOPICS
from hapticd.mailbox.layout import TELEMETRY
from hapticd.plant.effects import ALWAYS, KINDS, PROVENANCE
from hapticd.settings.config import Hand, Simulation, Touch
from hapticd.settings.load import load
from hapticd.settings.scene import schema
from hapticd.settings.tables import leaves
from hapticd.settings.toml import shipped
from hapticd.sim.injection import IN_FAULTS, OUT_FAULTS
from hapticd.units import unit_of

SCENE_TABLES = ("SceneFile", "ExcitationTable", "DampingStepTable", "Start")
CODES = [fault.code for fault in FAULTS if fault.number]


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


def page(site: Path, name: str) -> str:
    return (site / "generated" / name).read_text()


# --- the table of faults --------------------------------------------------------------------------


def raised_codes() -> set[str]:
    """Keys of BY_CODE that the package names."""
    found = set()
    for path in (ROOT / "hapticd").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
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


@pytest.mark.parametrize("code", CODES)
def test_every_fault_has_its_page(site: Path, code: str) -> None:
    text = page(site, f"faults/{code}.md")
    fault = BY_CODE[code]
    assert text.startswith(f"# {code}\n")
    assert all(
        part in text
        for part in (
            fault.cause,
            fault.action,
            fault.remedy,
            f"fault == {fault.number}",
            "## What to look at",
        )
    )
    assert f"[`{code}`]({code}.md)" in page(site, "faults/index.md")


def test_no_note_is_left_of_a_fault_that_is_gone() -> None:
    assert sorted(path.stem for path in (ROOT / "docs" / "faults").glob("*.md")) == sorted(CODES)


# --- reference pages ------------------------------------------------------------------------------


def test_every_key_of_a_scene_is_listed_with_its_meaning(site: Path) -> None:
    text = page(site, "scene.md")
    root = schema("scene")
    known = [root, *root["$defs"].values()]
    keys = {key for one in known for key in one.get("properties", {})}
    assert not [key for key in keys if f"| `{key}` |" not in text and f"{key}]`" not in text]
    own = [one for one in known if one["title"] in SCENE_TABLES]
    assert len(own) == len(SCENE_TABLES)
    plain = [field for one in own for field in one["properties"].values() if "$ref" not in field]
    assert not [
        field["title"] for field in plain if not field.get("description", field.get("items"))
    ]


def test_every_effect_is_listed_with_its_numbers_and_its_cost(site: Path) -> None:
    text = page(site, "effects.md")
    for kind in KINDS:
        assert f"## `{kind.key}`\n" in text
        assert kind.why in text
        names = [item.name for item in fields(kind) if item.name not in PROVENANCE]
        assert not [name for name in names if f"| `{name}` |" not in text]
        row = next(line for line in text.splitlines() if line.startswith(f"| [`{kind.key}`]"))
        assert kind.key in ALWAYS or row.count("%") == 2, row


@pytest.mark.parametrize(
    ("name", "part"), [("configuration.md", "config"), ("device.md", "device")]
)
def test_every_key_is_listed_with_its_unit(site: Path, name: str, part: str) -> None:
    plain = load(shipped("config") / "hapticd.toml").plain()
    known = plain.pop("device")
    text = page(site, name)
    for path, _ in leaves(known if part == "device" else plain):
        unit = unit_of(str(path[-1]))
        table = f"## `[{'.'.join(map(str, path))}]`"
        if table in text:  # a list of tables, or a table that is not given
            continue
        assert f"| `{path[-1]}` | {unit} |" in text, path
        assert len(path) == 1 or f"## `[{'.'.join(map(str, path[:-1]))}]`" in text, path


def test_configuration_page_says_range_and_default(site: Path) -> None:
    text = page(site, "configuration.md")
    assert "| `rate_hz` | Hz | number >= 50, <= 20000 | `1000.0` |" in text
    assert '| `on_gateway_loss` |  | `"fault"`, `"hold"` | `"fault"` |' in text
    assert (
        "| `core` |  | integer >= 0 | not set | Left out: the last core that this process may"
        " use. |" in text
    )


def test_every_verb_is_listed(site: Path) -> None:
    text = page(site, "commands.md")
    group = typer.main.get_command(command_line())
    for name, command in group.commands.items():  # type: ignore[attr-defined]
        for verb in (
            [f"{name} {inner}" for inner in command.commands]
            if hasattr(command, "commands")
            else [name]
        ):
            assert f"## `hapticd {verb}`\n" in text


def test_every_message_topic_and_field_is_listed(site: Path) -> None:
    text = page(site, "messages.md")
    assert not [name for name in MODELS if f"### `{name}`\n" not in text]
    assert not [
        topic.name for topic in TOPICS if f"| `{topic.name}` | {topic.content} |" not in text
    ]
    assert not [field[0] for field in TELEMETRY if f"| `{field[0]}` | `{field[1]}" not in text]
    assert "| `K` | N/m | number >= -10000, <= 100000 | virtual stiffness |" in text


# --- the site -------------------------------------------------------------------------------------


BUILD_S = 900.0  # at most, on a machine that is very busy; 30 s of processor time


def of_the_site(test: Callable[..., None]) -> Callable[..., None]:
    """A test that needs the built site; the first of them waits until it is built."""
    return pytest.mark.slow(pytest.mark.timeout(BUILD_S)(test))


@pytest.fixture(scope="module")
def built(site: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site as `make docs` builds it; a warning is an error."""
    needed = ("sphinx", "furo", "sphinx_gallery")
    missing = [name for name in needed if importlib.util.find_spec(name) is None]
    if missing:
        pytest.fail(f"{missing} are missing; `make test` or pip install --group docs brings them")
    out = tmp_path_factory.mktemp("built")
    command = [
        "-m",
        "sphinx",
        "-W",
        "--keep-going",
        "-q",
        "-j",
        "2",
        "-b",
        "html",
        str(site),
        str(out),
    ]
    done = subprocess.run([sys.executable, *command], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    return out


class Links(HTMLParser):
    """What a page refers to, and the places in it that can be referred to."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.targets: set[str] = set()
        self.places: set[str] = {""}
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """A link, a picture, a script, or a place."""
        for name, value in attrs:
            if name in ("href", "src") and value and not value.startswith("data:"):
                self.targets.add(value)
            elif name == "id" and value:
                self.places.add(value)


def broken(root: Path) -> list[str]:
    """Links of the pages below `root` that lead to no file, or to no place in a page."""
    pages = {path: Links(path.read_text(encoding="utf-8")) for path in root.rglob("*.html")}
    found = []
    for path, links in pages.items():
        for target in links.targets:
            url = urlsplit(target)
            if url.scheme or url.netloc:
                continue
            to = (path.parent / unquote(url.path)).resolve() if url.path else path
            lost = to in pages and unquote(url.fragment) not in pages[to].places
            if lost or not to.is_file():
                found.append(f"{path.relative_to(root)}: {target}")
    return sorted(found)


@of_the_site
def test_site_builds_without_a_warning(built: Path) -> None:
    assert (built / "generated/faults/usb_lost.html").is_file()


@of_the_site
@pytest.mark.parametrize("script", sorted((ROOT / "docs" / "tutorials").glob("t*.py")))
def test_tutorial_was_run_and_shows_what_it_printed_and_drew(built: Path, script: Path) -> None:
    page = (built / f"generated/tutorials/{script.stem}.html").read_text()
    assert "sphx-glr-script-out" in page
    assert f"sphx_glr_{script.stem}_001.png" in page


@of_the_site
def test_reference_of_the_python_interface_has_every_verb(built: Path) -> None:
    page = (built / "api.html").read_text()
    verbs = [name for name in dir(Client) if not name.startswith("_")]
    assert len(verbs) > 20
    assert not [name for name in verbs if f'id="hapticd.client.Client.{name}"' not in page]
    assert not re.search(r">[RD]</span>", page)  # what the verbs are generic in


@of_the_site
def test_no_link_of_the_site_leads_nowhere(built: Path) -> None:
    assert broken(built) == []


def test_link_that_leads_nowhere_is_found(tmp_path: Path) -> None:
    (tmp_path / "a.html").write_text('<p id="x"><a href="#x"></a><a href="b.html#y"></a>')
    (tmp_path / "b.html").write_text('<a href="a.html#x"></a><img src="c.png">')
    assert broken(tmp_path) == ["a.html: b.html#y", "b.html: c.png"]


@of_the_site
def test_options_are_shown_as_they_are_typed(built: Path) -> None:
    """Two hyphens are no dash, and quotes are those of the keyboard."""
    page = (built / "generated" / "commands.html").read_text()
    assert "--json" in page
    assert not re.search("[\N{EN DASH}\N{LEFT DOUBLE QUOTATION MARK}]", page)


# what of a page is wider than the window, and tables that are wider than their frame
TOO_WIDE = """() => {
  const root = document.documentElement;
  const page = root.scrollWidth - root.clientWidth;
  const frames = [...document.querySelectorAll("article .table-wrapper")];
  const tables = frames.filter((frame) => frame.scrollWidth > frame.clientWidth + 1);
  return (page > 0 ? [`page by ${page} px`] : []).concat(
    tables.map((frame) => `table ${frame.textContent.trim().slice(0, 40)}`));
}"""


@of_the_site
@pytest.mark.parametrize("width", [1280, 400])
def test_nothing_is_wider_than_the_window(built: Path, width: int) -> None:
    """On a desk and on a phone. Programs and drawings scroll in frames of their own."""
    places = [path for path in sorted(built.rglob("*.html")) if path.parent.name != "adr"]
    found = []
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=list(ARGUMENTS))
        page = browser.new_page(viewport={"width": width, "height": 900})
        for path in places:
            page.goto(path.as_uri())
            found += [f"{path.relative_to(built)}: {what}" for what in page.evaluate(TOO_WIDE)]
        browser.close()
    assert len(places) > 60
    assert found == []


def test_links_between_files_of_a_checkout_lead_somewhere() -> None:
    for name in ("README.md", "examples/README.md", "firmware_iface/README.md"):
        page = ROOT / name
        for target in re.findall(r"\]\(([^)#\s]+)", page.read_text()):
            assert "://" in target or (page.parent / target).exists(), (name, target)


# --- names of modules -----------------------------------------------------------------------------

MODULES = {
    ".".join(file.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): file
    for file in (ROOT / "hapticd").rglob("*.py")
}
PACKAGES = {name.split(".")[1] for name in MODULES if "." in name} | {"measure"}  # one that was
FILE_ENDINGS = {"conf", "h5", "json", "limits", "rules", "schema", "service", "sysusers"} | {
    "target", "tmpfiles", "toml",
}  # fmt: skip
STATUS_KEYS = {"servo.realtime", "servo.report"}  # of `hapticd status --json`


def names_that_do_not_exist(text: str, settings: set[str]) -> list[str]:
    """Dotted names behind `hapticd.`, those in backticks that begin with a package, and paths, of
    which nothing is there; `settings`: dotted names that mean something else.
    """
    found = re.findall(r"(?<![\w/.-])hapticd\.([a-z]\w*(?:\.\w+)*)", text)
    quoted = re.findall(rf"`((?:{'|'.join(PACKAGES)})(?:\.\w+)+)`", text)
    found += [name for name in quoted if name not in settings]
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
    for count in range(len(parts), 1, -1):
        file = MODULES.get(".".join(parts[:count]))
        if file is not None:
            # the docstring of a package names much that is one layer further down
            code = file.read_text(encoding="utf-8").removeprefix('"""').partition('"""')[2]
            return count == len(parts) or bool(re.search(rf"\b{parts[count]}\b", code))
    return False


def test_every_module_that_is_named_anywhere_exists() -> None:
    """In pages, docstrings, comments and settings; CHANGELOG.md alone names what was."""
    settings = {".".join(map(str, path)) for path, _ in leaves(load(None).plain())}
    settings |= STATUS_KEYS | {topic.name for topic in TOPICS}
    pages = [ROOT / "README.md", ROOT / "pyproject.toml", ROOT / "Makefile"]
    for folder, pattern in (
        ("docs", "**/*.md"), ("docs", "pages/*.py"), ("hapticd", "**/*.py"), ("tests", "*.py"),
        ("benchmarks", "*.py"), ("examples", "*"), ("config", "**/*.toml"), ("systemd", "*"),
    ):  # fmt: skip
        pages += sorted(ROOT.joinpath(folder).glob(pattern))
    missing = [
        f"{page.relative_to(ROOT)}:{number}: {name}"
        for page in pages
        if page != Path(__file__) and page.is_file()
        for number, line in enumerate(page.read_text(encoding="utf-8").splitlines(), 1)
        for name in names_that_do_not_exist(line, settings)
    ]
    assert missing == []


def test_every_module_that_moved_is_where_the_changelog_says() -> None:
    table = (ROOT / "CHANGELOG.md").read_text().partition("### Moved")[2].partition("\n#")[0]
    rows = [line.split(" | ") for line in table.splitlines() if line.startswith("| `")]
    assert len(rows) > 80
    assert [name for _, place in rows for name in names_that_do_not_exist(place, set())] == []


@pytest.mark.parametrize(
    ("line", "missing"),
    [
        ("from `hapticd.analysis.spa`", ["analysis.spa"]),
        ("| `hapticd.zwidth.trial`, `.limits`, `.campaign` | |", ["zwidth.campaign"]),
        ("see `measure.trial` and `zwidth.trial`", ["measure.trial"]),
        ("`plant.stability.damping_floor`", ["plant.stability.damping_floor"]),
        ("in hapticd/sim/engine/job.py, not hapticd/engine/job.py", ["hapticd/sim/engine/job.py"]),
        ("`servo.realtime` of 70-hapticd.rules and hapticd.toml", []),
    ],
)
def test_name_of_a_module_that_is_gone_is_found(line: str, missing: list[str]) -> None:
    assert names_that_do_not_exist(line, STATUS_KEYS) == missing


def test_overview_names_only_files_that_are_there() -> None:
    """Whole paths in its tables, and paths below `hapticd/` in the ways through the files."""
    page = (ROOT / "docs" / "OVERVIEW.md").read_text()
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
    page = (ROOT / "docs" / "OVERVIEW.md").read_text()
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


def test_simulated_board_page_lists_every_trait_and_injection(site: Path) -> None:
    text = page(site, "simulated-board.md")
    names = [
        *Simulation.model_fields,
        *Touch.model_fields,
        *Hand.model_fields,
        *OUT_FAULTS,
        *IN_FAULTS,
    ]
    missing = [name for name in names if f"| `{name}` |" not in text]
    assert missing == ["injections", "touch", "hands"]


SAFETY = (ROOT / "docs" / "safety.md").read_text()
SHOWN = re.findall(r"`(test_\w+\.py)::(test_\w+)`", SAFETY)


@pytest.mark.parametrize(("file", "test"), sorted(set(SHOWN)))
def test_every_promise_is_shown_by_a_test_that_exists(file: str, test: str) -> None:
    source = path_of_test(file).read_text()
    assert re.search(rf"^def {test}\(", source, re.MULTILINE)


def test_every_promise_names_a_test() -> None:
    rows = [line for line in SAFETY.splitlines() if line.startswith("| ") and "---" not in line][1:]
    assert rows
    assert all(re.search(r"`test_\w+\.py::test_\w+` \|$", row) for row in rows)
