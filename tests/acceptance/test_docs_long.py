"""The documentation repeats the program's tables, all of them; the table of faults is complete;
the site builds.
"""

import importlib.util
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path

import pytest
import typer.main
from playwright.sync_api import sync_playwright
from support.console_page import ARGUMENTS, CHROMIUM
from support.docs import CODES, broken, page
from support.tree import ROOT
from test_docs import STATUS_KEYS, names_that_do_not_exist

from hapticd.cli.app import command_line
from hapticd.client import Client
from hapticd.core.faults import BY_CODE
from hapticd.core.units import unit_of
from hapticd.mailbox.layout import TELEMETRY
from hapticd.model.effects import ALWAYS, KINDS, PROVENANCE
from hapticd.model.params import HandParams, TouchParams
from hapticd.protocol.schemas import MODELS
from hapticd.protocol.telemetry import TOPICS
from hapticd.settings.config import Simulation, keys_of, leaves
from hapticd.settings.load import load
from hapticd.settings.scene import schema
from hapticd.settings.toml import shipped
from hapticd.sim.injection import IN_FAULTS, OUT_FAULTS

SCENE_TABLES = ("SceneFile", "Excitation", "DampingStepTable", "Start")


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
            "## Checks",
        )
    )
    assert f"[`{code}`]({code}.md)" in page(site, "faults/index.md")


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
        "| `core` |  | integer >= 0 | not set | Default: the last core that this process may"
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
    rows = re.findall(r"^\| `(\w+)` \| [^|]* \| `([^` ]+)[^|]*` \| [^|]+ \|$", text, re.MULTILINE)
    assert not [field[0] for field in TELEMETRY if (field[0], field[1]) not in rows]
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


def test_simulated_board_page_lists_every_trait_and_injection(site: Path) -> None:
    text = page(site, "simulated-board.md")
    names = [
        *keys_of(Simulation),
        *keys_of(TouchParams),
        *keys_of(HandParams),
        *OUT_FAULTS,
        *IN_FAULTS,
    ]
    missing = [name for name in names if f"| `{name}` |" not in text]
    assert missing == ["injections", "touch", "hands"]


def test_every_module_that_is_named_anywhere_exists() -> None:
    """In pages, docstrings, comments and settings."""
    settings = {".".join(map(str, path)) for path, _ in leaves(load(None).plain())}
    settings |= STATUS_KEYS | {topic.name for topic in TOPICS}
    pages = [ROOT / "README.md", ROOT / "pyproject.toml", ROOT / "Makefile"]
    for folder, pattern in (
        ("docs", "**/*.md"), ("docs", "pages/*.py"), ("hapticd", "**/*.py"), ("tests", "*.py"),
        ("benchmarks", "*.py"), ("examples", "**/*"), ("config", "**/*.toml"), ("systemd", "*"),
    ):  # fmt: skip
        pages += sorted(ROOT.joinpath(folder).glob(pattern))
    missing = [
        f"{page.relative_to(ROOT)}:{number}: {name}"
        for page in pages
        if page != Path(__file__) and page.is_file() and page.suffix != ".pyc"
        for number, line in enumerate(page.read_text(encoding="utf-8").splitlines(), 1)
        for name in names_that_do_not_exist(line, settings)
    ]
    assert missing == []
